"""A headed part of a page in reading order: markup, pictures, plots of every sample that zoom."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.files import write_atomically
from cellwise.logs.cell_log import CellLog
from cellwise.plotting import Line, Panel
from cellwise.report.page.markup import (
    EMPTY,
    MOST,
    Markup,
    clock_of,
    escape,
    page,
    page_file,
    paragraph,
)
from cellwise.report.page.numerals import listed
from cellwise.report.page.picture import FigureFiles, Picture, inline, save_figures
from cellwise.typing import FloatArray

Blocks = tuple[Markup | Picture, ...]


class Section(NamedTuple):
    """Key and short name for links, heading, and blocks of markup or pictures."""

    key: str
    title: str
    blocks: Blocks
    short: str = ""


def pictures_of(sections: Iterable[Section]) -> tuple[Picture, ...]:
    """All pictures of the sections, in order."""
    return tuple(b for s in sections for b in s.blocks if isinstance(b, Picture))


def rendered(section: Section) -> Markup:
    """The blocks of a section as one piece of HTML."""
    parts = [inline(b) if isinstance(b, Picture) else b for b in section.blocks]
    return Markup("\n".join(p for p in parts if p))


def write_page(
    path: str | Path,
    finding: str,
    about: str,
    sections: Sequence[Section],
    data: Mapping[str, Any],
    *,
    lead: Markup = EMPTY,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Render a page and write it.

    Parameters
    ----------
    path : str or Path            of the HTML file; it appears whole or not at all
    finding, about : str          the first line, and what the page is
    sections : of Section         in reading order
    data : mapping                the figures for machines
    lead : Markup                 between the first line and the sections
    figures : folder or FigureFiles   for the same pictures as PNG and SVG files

    Raises
    ------
    InputError        matplotlib is missing; nothing to show; the path cannot be written
    """
    parts = [(s.key, s.title, s.short or s.title, rendered(s)) for s in sections]
    text = page(
        finding,
        about,
        parts,
        data,
        lead=lead,
        scripts=scripts_for(inside for *_, inside in parts),
    )
    if figures is not None:
        files = figures if isinstance(figures, FigureFiles) else FigureFiles(Path(figures))
        save_figures(pictures_of(sections), *files)
    return write_atomically(path, text)


# What a page holds that needs the program.
NEEDED_BY = {"narrow.js": "<figure ", "zoom.js": "<figure ", "interactive.js": '<div class="trace"',
             "sort.js": 'sort"><thead'}  # fmt: skip


def scripts_for(parts: Iterable[str]) -> list[Markup]:
    """The programs that the parts of a page need."""
    inside = list(parts)
    return [
        script(name) for name, mark in NEEDED_BY.items() if any(mark in part for part in inside)
    ]


def script(name: str) -> Markup:
    """A program as it stands in a page."""
    return Markup(page_file(name).replace("</", "<\\/"))


MISSING = np.iinfo(np.uint16).max
UNEVEN = 1e-3  # of a step


class Traces(NamedTuple):
    """Panels over one time axis, as `Plottable` gives them; ``clock`` as of a `Picture`."""

    x_label: str
    shown: tuple[Panel, ...]
    clock: str = ""

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """As they were given."""
        return self.x_label, self.shown


class HasPanels(Protocol):
    """Whatever can say its panels."""

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Name of the common x axis with its unit, and the panels from top to bottom."""


def simulation_traces(simulation: Simulation) -> Traces:
    """Voltages, their difference, SOC and the current that made them."""
    x_label, panels = simulation.panels()
    hours = panels[0].lines[0].x
    current = Panel("current [A]", (Line("current", hours, simulation.log.current_A),))
    return Traces(x_label, (*panels, current), clock_of(simulation.log))


def trace_section(results: Sequence[tuple[str, HasPanels]], key: str = "trace") -> Section:
    """A section with one plot that zooms for each result, under its name.

    Results beyond three million samples are left out, with a note.
    """
    blocks: list[Markup] = [paragraph("Every sample is here, however many there are.")]
    samples, left_out = 0, []
    for k, (name, result) in enumerate(results):
        samples += result.panels()[1][0].lines[0].x.size
        if samples > MOST.samples and k:
            left_out.append(name)
            continue
        blocks.append(Markup(f"<h3>{escape(name)}</h3>"))
        blocks.append(trace(result, f"{key}-{k + 1}"))
    if left_out:
        blocks.append(paragraph(f"Left out, for the page's size: {listed(left_out)}."))
    return Section(key, "Every sample", tuple(blocks))


def trace(result: HasPanels, key: str) -> Markup:
    """A plot that zooms; `scripts_for` gives its page the program.

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
    clock = f' data-clock="{escape(_clock(result))}"'
    return Markup(
        f'<div class="trace" id="{escape(key)}"{clock} data-source="{escape(key)}-data"></div>\n'
        f'<script type="application/vnd.cellwise.trace" id="{escape(key)}-data">{text}</script>'
    )


def _clock(result: HasPanels) -> str:
    """The log whose time a result is over."""
    if isinstance(result, Traces):
        return result.clock
    log = result if isinstance(result, CellLog) else getattr(result, "log", None)
    return clock_of(log) if isinstance(log, CellLog) else ""


def _axis(x: FloatArray) -> dict[str, Any]:
    if x.size > 1:
        step = float(x[-1] - x[0]) / (x.size - 1)
        if step > 0 and np.max(np.abs(x - x[0] - step * np.arange(x.size))) < UNEVEN * step:
            return {"start": float(x[0]), "step": step}
    return {"data": _packed(np.ascontiguousarray(x, dtype="<f4").tobytes())}


def _line(line: Line) -> dict[str, Any]:
    series: dict[str, Any] = {"label": line.label, **_series(line.y)}
    if line.band is not None:
        series["band"] = _series(line.band)
    return series


def _series(values: FloatArray) -> dict[str, Any]:
    """Values as differences of 16-bit steps, low bytes first: they pack best so."""
    known = np.isfinite(values)
    low, high = (float(f(values[known])) for f in (np.min, np.max)) if known.any() else (0.0, 1.0)
    span = high - low or 1.0
    levels = np.full(values.size, MISSING, dtype=np.uint16)
    levels[known] = np.round((values[known] - low) / span * (MISSING - 1)).astype(np.uint16)
    steps = np.diff(levels, prepend=np.uint16(0)).astype("<u2")
    halves = steps.view(np.uint8).reshape(-1, 2).T
    return {"low": low, "high": low + span, "data": _packed(halves.tobytes())}


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")
