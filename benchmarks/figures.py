"""Measured figures: their tables, the clock, the machine, the command line of a benchmark."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

Progress = Callable[[str], None]
WIDTH = 140  # of the table in a file or a pipe
NAME_WIDTH = 66
PACKAGES = ("cellwise", "numpy", "numba", "scipy", "pyarrow", "filterpy", "pybamm", "thevenin")


@dataclass(frozen=True)
class Figure:
    """One row: who was measured doing what, and how far it is from what was asked for.

    ``value`` is None where nothing could be measured; then ``note`` says why. ``ratio`` is value
    over the group's first row (this project's). ``target`` is the largest value allowed, the
    smallest where ``at_least``.
    """

    group: str
    who: str
    value: float | None
    unit: str
    ratio: float | None = None
    target: float | None = None
    at_least: bool = False
    note: str = ""

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
    if not first:
        return list(figures)
    return [
        Figure(**{**asdict(f), "ratio": None if f.value is None else f.value / first})
        for f in figures
    ]


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
    """One group; empty columns are left out."""
    table = Table(title=group, title_justify="left", title_style="bold", box=SIMPLE, pad_edge=False)
    columns = [("", [f.who for f in rows]), ("value", [_value(f) for f in rows])]
    columns += [
        ("target", [_target(f) for f in rows]),
        ("", [_verdict(f) for f in rows]),
        ("ratio", [_ratio(f) for f in rows]),
        ("", [f.note for f in rows]),
    ]
    columns = [(name, cells) for name, cells in columns if any(cells)]
    for k, (name, cells) in enumerate(columns):
        last = cells == [f.note for f in rows]
        table.add_column(
            name,
            justify="left" if k == 0 or last else "right",
            max_width=NAME_WIDTH if k == 0 else None,
            no_wrap=k > 0 and not last,
            style="dim" if last else None,
        )
    for cells in zip(*(cells for _, cells in columns), strict=True):
        table.add_row(*cells)
    return table


def report_json(
    figures: Sequence[Figure], machine: dict[str, Any], began: float, **more: Any
) -> dict[str, Any]:
    """Everything as one JSON object."""
    judged = [f.passed for f in figures if f.passed is not None]
    return {
        "machine": machine,
        "figures": [f.to_dict() for f in figures],
        "targets": {"judged": len(judged), "met": sum(judged)},
        "seconds": round(time.perf_counter() - began, 1),
        **more,
    }


def write_json(path: Path, report: dict[str, Any]) -> None:
    """Write a report whole or not at all."""
    part = path.with_suffix(path.suffix + ".part")
    part.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    part.replace(path)


def _value(f: Figure) -> str:
    return "-" if f.value is None else f"{_number(f.value)} {f.unit}"


def _target(f: Figure) -> str:
    if f.target is None:
        return ""
    return f"{'>=' if f.at_least else '<='} {_number(f.target)}"


def _verdict(f: Figure) -> str:
    if f.passed is None:
        return ""
    return "[green]met[/green]" if f.passed else "[red]missed[/red]"


def _ratio(f: Figure) -> str:
    if f.ratio is None:
        return ""
    return "1" if f.ratio == 1.0 else f"x {_number(f.ratio)}"


def _number(x: float) -> str:
    if x == 0.0 or not abs(x) < float("inf"):
        return f"{x:g}"
    if abs(x) >= 1000.0:
        return f"{x:,.0f}"
    return f"{x:.3g}"


def describe_machine() -> dict[str, Any]:
    """Processor, cores this process may use, load of others, versions."""
    return {
        "processor": _processor(),
        "cores": usable_cores(),
        "load": _load(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "blas_threads": os.environ.get("OMP_NUM_THREADS", "not set"),
        **{name: _version(name) for name in PACKAGES},
    }


def machine_lines(machine: dict[str, Any]) -> list[str]:
    """The same as text."""
    packages = ", ".join(f"{name} {machine[name]}" for name in PACKAGES if machine[name])
    load = "" if machine["load"] is None else f", load average {machine['load']:.1f}"
    return [
        f"Machine: {machine['processor']}, {machine['cores']} cores{load}, {machine['system']}, "
        f"{machine['blas_threads']} BLAS thread(s)",
        f"Python {machine['python']}, {packages}",
    ]


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _load() -> float | None:
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def judged_run(
    title: str,
    about: str,
    parts: Sequence[str],
    measure: Callable[..., list[Figure]],
    arguments: list[str] | None = None,
    **switches: str,
) -> int:
    """The command line of a benchmark: measures the parts asked for, prints table or JSON.

    ``measure(parts, say)``; each of ``switches`` (name and help) is one of its keywords.
    """
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("--only", default=",".join(parts), help="comma-separated parts")
    for name, help_ in switches.items():
        parser.add_argument(f"--{name}", action="store_true", help=help_)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    parser.add_argument("-o", "--output", type=Path, help="write the JSON to this file as well")
    chosen = parser.parse_args(arguments)
    wanted = [part for part in parts if part in chosen.only.split(",")]
    if not wanted:
        parser.error(f"--only {chosen.only}: name at least one of {', '.join(parts)}")
    began = time.perf_counter()
    machine = describe_machine()
    figures = measure(wanted, _say, **{name: getattr(chosen, name) for name in switches})
    report = report_json(figures, machine, began)
    if chosen.output:
        write_json(chosen.output, report)
    if chosen.json:
        print(json.dumps(report))
        return 0
    met = report["targets"]
    lines = [f"{met['met']} of {met['judged']} targets met"] if met["judged"] else []
    print_figures(figures, title, [*lines, *machine_lines(machine), f"{report['seconds']:.0f} s"])
    return 0


def _say(what: str) -> None:
    """Say on standard error what is being measured."""
    print(f"  {what} ...", file=sys.stderr, flush=True)
