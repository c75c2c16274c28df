"""Measured figures: their tables, the clock, the machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from cellwise.threads import usable_cores

Progress = Callable[[str], None]
WIDTH = 140  # of the table in a file or a pipe
NAME_WIDTH = 66
PACKAGES = ("cellwise", "numpy", "numba", "scipy", "pyarrow", "filterpy", "pybamm", "thevenin")


@dataclass(frozen=True)
class Figure:
    """One row: who was measured doing what, and how far it is from what was asked for.

    ``value`` is None where nothing could be measured; then ``note`` says why. ``ratio`` is value
    over the group's first row (this project's). ``target`` is the largest value allowed, the
    smallest where ``at_least``. A ``headline`` stands in the docs. ``failed``: its case broke off.
    """

    group: str
    who: str
    value: float | None
    unit: str
    ratio: float | None = None
    target: float | None = None
    at_least: bool = False
    note: str = ""
    headline: bool = False
    failed: bool = False

    @property
    def passed(self) -> bool | None:
        """Whether the target is met; None without one."""
        if self.target is None:
            return None
        if self.value is None:
            return False
        return self.value >= self.target if self.at_least else self.value <= self.target

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {**asdict(self), "passed": self.passed}


def missing(group: str, who: str, unit: str, why: str) -> Figure:
    """The row of somebody who could not be measured."""
    return Figure(group, who, None, unit, note=why)


def with_ratios(figures: Sequence[Figure]) -> list[Figure]:
    """The figures of one group with their ratio to the first one."""
    first = figures[0].value
    return [replace(f, ratio=f.value / first if f.value and first else None) for f in figures]


@dataclass(frozen=True)
class Timing:
    """Wall-clock time of many runs of one thing [s]."""

    best: float
    median: float
    runs: int


def clock(work: Callable[[], object], *, seconds: float = 1.5, most: int = 400) -> Timing:
    """Run ``work`` once unseen, then again for about ``seconds``, and time each run.

    The best run is the figure to keep: whatever else the machine does can only add to it.
    """
    work()
    times: list[float] = []
    until = time.perf_counter() + seconds
    while len(times) < 3 or (time.perf_counter() < until and len(times) < most):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return Timing(min(times), sorted(times)[len(times) // 2], len(times))


def print_figures(figures: Iterable[Figure], title: str, notes: Sequence[str] = ()) -> None:
    """A table for people, one for each group."""
    console = Console()
    if not console.is_terminal:
        console.width = WIDTH
    console.print(f"[bold]{title}[/bold]", highlight=False)
    groups: dict[str, list[Figure]] = {}
    for f in figures:
        groups.setdefault(f.group, []).append(f)
    for group, rows in groups.items():
        console.print()
        console.print(_table(group, rows))
    console.print()
    for note in notes:
        console.print(note, style="dim", highlight=False)


def _table(group: str, rows: Sequence[Figure]) -> Table:
    """One group; what no row says is left out."""
    table = Table(title=group, title_justify="left", title_style="bold", box=SIMPLE, pad_edge=False)
    table.add_column("", max_width=NAME_WIDTH)
    columns: dict[str, Callable[[Figure], str]] = {
        "value": lambda f: "-" if f.value is None else f"{_number(f.value)} {f.unit}",
        "target": lambda f: _target(f) if f.target is not None else "",
        "ratio": lambda f: "" if f.ratio is None else f"x {_number(f.ratio)}",
        "note": lambda f: f.note,
    }
    said = {name: [read(f) for f in rows] for name, read in columns.items()}
    said = {name: cells for name, cells in said.items() if any(cells)}
    for name in said:
        last = name == "note"
        side = "left" if last else "right"
        table.add_column(name, justify=side, no_wrap=not last, style="dim" if last else None)
    for f, *cells in zip(rows, *said.values(), strict=True):
        table.add_row(f.who, *cells)
    return table


def _target(f: Figure) -> str:
    verdict = "[green]met[/green]" if f.passed else "[red]missed[/red]"
    return f"{'>=' if f.at_least else '<='} {_number(f.target or 0.0)} {verdict}"


def report_json(figures: Sequence[Figure], machine: dict[str, Any], began: float) -> dict[str, Any]:
    """Everything as one JSON object."""
    judged = [f.passed for f in figures if f.passed is not None]
    return {
        "machine": machine,
        "figures": [f.to_dict() for f in figures],
        "targets": {"judged": len(judged), "met": sum(judged)},
        "seconds": round(time.perf_counter() - began, 1),
    }


def _number(x: float) -> str:
    if x == 0.0 or not abs(x) < float("inf"):
        return f"{x:g}"
    if abs(x) >= 1000.0:
        return f"{x:,.0f}"
    return f"{x:.3g}"


def describe_machine() -> dict[str, Any]:
    """Processor, cores this process may use, load of others, versions."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    named = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return {
        "processor": next(named, platform.processor() or platform.machine()),
        "cores": usable_cores(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "blas_threads": os.environ.get("OMP_NUM_THREADS", "not set"),
        **{name: version(name) for name in PACKAGES if find_spec(name)},
    }


def machine_lines(machine: dict[str, Any]) -> list[str]:
    """The same as text."""
    packages = ", ".join(f"{name} {machine[name]}" for name in PACKAGES if name in machine)
    return [
        f"Machine: {machine['processor']}, {machine['cores']} cores, load average "
        f"{machine['load']}, {machine['system']}, {machine['blas_threads']} BLAS thread(s)",
        f"Python {machine['python']}, {packages}",
    ]


def between_marks(text: str, marks: tuple[str, str], new: str) -> str:
    """A page with another text between its two marks."""
    begin, end = marks
    before, _, rest = text.partition(begin)
    return f"{before}{begin}\n{new}\n{end}{rest.partition(end)[2]}"
