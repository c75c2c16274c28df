"""The one stylesheet of every page, for day and night, screen and paper."""

from __future__ import annotations

STYLESHEET = """
:root { color-scheme: light dark;
  --paper: #fefefe; --back: #f3f4f6; --ink: #1f2329; --muted: #57606b; --grid: #dfe3e8;
  --line: #d3d8de; --accent: #0b67a3; --mark: #e5f1fa; --warn: #b35900;
  --line-1: #0b67a3; --line-2: #c8501a; --line-3: #1a7f4b; --line-4: #7a4fb5;
  --measured: #77818d; --shade: #00000038;
  --over: multiply;
  --tint-1: #cde8dd; --tint-2: #e7efc9; --tint-3: #fbe3c0; --tint-4: #f4c9b0; }
@media (prefers-color-scheme: dark) { :root {
  --paper: #1b1f25; --back: #12151a; --ink: #e9ecf0; --muted: #a3acb7; --grid: #323943;
  --line: #363d47; --accent: #6cb8ea; --mark: #1c3447; --warn: #f0a85a;
  --line-1: #6cb8ea; --line-2: #f0935a; --line-3: #62c893; --line-4: #b79bea;
  --measured: #9aa4b0; --shade: #ffffff40;
  --over: lighten;
  --tint-1: #1d4638; --tint-2: #3d4622; --tint-3: #55401b; --tint-4: #62331f; }
  figure[id^="figure-pack"] svg image { opacity: .65; } }
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body { margin: 0; background: var(--back); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 28px 20px 40px; }
h1 { font-size: 1.5rem; line-height: 1.32; margin: 0 0 .4rem; text-wrap: balance; }
h2 { font-size: 1.18rem; margin: 0 0 .5rem; }
h3 { font-size: 1rem; margin: 1.3rem 0 .3rem; }
p { margin: .4rem 0 .8rem; max-width: 80ch; }
a { color: var(--accent); }
code { font-family: ui-monospace, "SF Mono", Menlo, Consolas, monospace; font-size: .92em; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: .82rem; }
.about { color: var(--muted); margin-bottom: 1rem; }
nav { display: flex; flex-wrap: wrap; gap: .2rem 1.1rem; margin: 1rem 0; }
nav a { text-decoration: none; } nav a:hover { text-decoration: underline; }
section { background: var(--paper); border: 1px solid var(--line); border-radius: 8px;
  padding: 18px 22px 20px; margin: 0 0 18px; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(140px, 1fr)); gap: 10px;
  margin: 0 0 1rem; }
.tiles div { display: flex; flex-direction: column-reverse;
  justify-content: flex-end; background: var(--paper);
  border: 1px solid var(--line); border-radius: 8px; padding: 8px 12px 9px; }
.tiles dt { color: var(--muted); font-size: .82rem; line-height: 1.3; }
.tiles dd { margin: 0; font-size: 1.22rem; font-weight: 600; font-variant-numeric: tabular-nums; }
figure { margin: 1rem 0 1.2rem; }
figure svg { display: block; width: 100%; height: auto; }
figure svg * { stroke-linejoin: round; stroke-linecap: butt; }
figcaption { color: var(--muted); font-size: .9rem; max-width: 100ch; margin-top: .35rem; }
.scroll { overflow-x: auto; margin: .8rem 0 1rem; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
.note { color: var(--muted); font-size: .9rem; margin: 1rem 0 0; }
.note + .scroll { margin-top: .35rem; }
.beside { display: flex; flex-wrap: wrap; gap: 0 48px; } .beside .note { max-width: 42ch; }
.beside > * { min-width: 0; max-width: 100%; }
li, p, dd, figcaption { overflow-wrap: anywhere; }
th, td { padding: 4px 14px 4px 0; text-align: left; vertical-align: baseline;
  border-bottom: 1px solid var(--grid); }
th { font-weight: 600; white-space: nowrap; border-bottom-color: var(--muted); }
.many th { white-space: normal; vertical-align: bottom; }
.many th, .many td { padding-right: 10px; }
.n { text-align: right; white-space: nowrap; }
tr.marked td { background: var(--mark); font-weight: 600; }
.notices { border-left: 3px solid var(--warn); padding: .1rem 0 .1rem 1.6rem; margin: .6rem 0; }
div.trace { touch-action: pan-y; user-select: none; cursor: crosshair; outline-offset: 4px; }
div.trace canvas { display: block; width: 100%; margin-bottom: 2px; }
.readout { color: var(--muted); font-size: .82rem; font-variant-numeric: tabular-nums;
  min-height: 1.3em; margin: .2rem 0 1.2rem; max-width: none; }
figure[data-axes] svg { touch-action: pan-y; user-select: none; }
figure[data-axes] svg [data-plot] { cursor: crosshair; }
figure[data-axes] svg:focus { outline: 1px solid var(--line); outline-offset: 4px; }
figure svg .grid { stroke: var(--grid); stroke-width: .7; }
figure svg .tick { fill: var(--muted); font: 8.5px "DejaVu Sans", Verdana, sans-serif; }
figure svg .cursor { stroke: var(--muted); stroke-width: .8; pointer-events: none; }
figure svg .alarm { fill: var(--warn); opacity: .25; pointer-events: none; }
figure svg .grip { fill: var(--muted); opacity: .18; }
figure div { position: relative; }
figure .readout { position: absolute; right: 0; bottom: -.8em; margin: 0; min-height: 0;
  background: var(--paper); }
details { margin: .7rem 0; } summary { cursor: pointer; color: var(--accent); }
footer { color: var(--muted); font-size: .85rem; padding: 0 2px; }
@media (max-width: 700px) { main { padding: 16px 10px; } section { padding: 14px 12px; }
  figure { overflow-x: auto; } figure svg { min-width: 620px; mix-blend-mode: var(--over); }
  .scroll, figure { background: linear-gradient(90deg, var(--paper) 30%, transparent) 0 0 / 40px
    100% no-repeat local, linear-gradient(270deg, var(--paper) 30%, transparent) 100% 0 / 40px
    100% no-repeat local, linear-gradient(90deg, var(--shade), transparent) 0 0 / 14px 100%
    no-repeat, linear-gradient(270deg, var(--shade), transparent) 100% 0 / 14px 100% no-repeat;
    }
  figcaption { position: sticky; left: 0; max-width: calc(100vw - 66px); } }
@media print { body { background: none; } section { border: 0; padding: 0; break-inside: auto; }
  figure, .scroll { break-inside: avoid; } nav { display: none; } }
"""
