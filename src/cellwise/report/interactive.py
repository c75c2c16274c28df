"""Plots that zoom, with every sample in the page: for whatever can say its panels."""

from __future__ import annotations

import base64
import json
import zlib
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from cellwise.plotting import Line, Plottable
from cellwise.report.markup import Markup, escape, paragraph
from cellwise.report.section import Section
from cellwise.typing import FloatArray

LEVELS = 65_534
MISSING = 65_535
UNEVEN = 1e-3  # of a step
USE = (
    "Drag to zoom in, turn the wheel to zoom, double-click to see all again; arrow keys, + and - "
    "work too. Every sample is drawn, however many there are."
)


def trace_section(results: list[tuple[str, Plottable]], key: str = "trace") -> Section:
    """A section with one plot that zooms for each result, under its name."""
    blocks: list[Markup] = [paragraph(USE)]
    for k, (name, result) in enumerate(results):
        blocks.append(Markup(f"<h3>{escape(name)}</h3>"))
        blocks.append(trace(result, f"{key}-{k + 1}"))
    blocks.append(Markup(f"<script>{script()}</script>"))
    return Section(key, "Every sample", tuple(blocks))


def trace(result: Plottable, key: str) -> Markup:
    """A plot that zooms; it needs `script` once on its page.

    Values are kept in 65,534 steps between the lowest and the highest: finer than a screen shows.
    """
    x_label, panels = result.panels()
    x = panels[0].lines[0].x
    plot = {
        "n": int(x.size),
        "xLabel": x_label,
        "x": _axis(x),
        "panels": [
            {"label": panel.y_label, "lines": [_line(line) for line in panel.lines]}
            for panel in panels
        ],
    }
    text = json.dumps(plot, allow_nan=False).replace("<", "\\u003c")
    return Markup(
        f'<div class="trace" id="{escape(key)}" data-source="{escape(key)}-data"></div>\n'
        f'<script type="application/vnd.cellwise.trace" id="{escape(key)}-data">{text}</script>'
    )


@cache
def script() -> str:
    """What draws the plots."""
    text = (files("cellwise.report") / "interactive.js").read_text(encoding="utf-8")
    return text.replace("</", "<\\/")


def _axis(x: FloatArray) -> dict[str, Any]:
    if x.size > 1:
        step = float(x[-1] - x[0]) / (x.size - 1)
        if step > 0 and np.max(np.abs(x - x[0] - step * np.arange(x.size))) < UNEVEN * step:
            return {"start": float(x[0]), "step": step}
    return {"data": _packed(np.ascontiguousarray(x, dtype="<f4").tobytes())}


def _line(line: Line) -> dict[str, Any]:
    told: dict[str, Any] = {"label": line.label, **_series(line.y)}
    if line.band is not None:
        told["band"] = _series(line.band)
    return told


def _series(values: FloatArray) -> dict[str, Any]:
    """Values as differences of 16-bit steps, low bytes first: they pack best so."""
    known = np.isfinite(values)
    low, high = (float(f(values[known])) for f in (np.min, np.max)) if known.any() else (0.0, 1.0)
    span = high - low or 1.0
    levels = np.full(values.size, MISSING, dtype=np.uint16)
    levels[known] = np.round((values[known] - low) / span * LEVELS).astype(np.uint16)
    steps = np.diff(levels, prepend=np.uint16(0)).astype("<u2")
    halves = steps.view(np.uint8).reshape(-1, 2).T
    return {"low": low, "high": low + span, "data": _packed(halves.tobytes())}


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")
