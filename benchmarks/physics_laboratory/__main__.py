"""Cells made by PyBaMM, one thing changed: what `diagnose` says of them.

python -m benchmarks.physics_laboratory make FOLDER [--seed 0 --cases 20 --cells development]
python -m benchmarks.physics_laboratory judge FOLDER

`make` needs PyBaMM and can be run again: cells and cases that are there stay. `judge` needs none.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.physics_laboratory.work import judge_case, make_case, make_cell

KINDS = ("single", "none", "pairs", "faults")


def main(arguments: list[str] | None = None) -> int:
    """Make cases, or judge them."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.physics_laboratory", description=__doc__.splitlines()[0]
    )
    parser.add_argument("what", choices=("make", "judge", "both"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0, help="first seed; 0 draws one")
    parser.add_argument("--cases", type=int, default=10, help="of each kind")
    parser.add_argument("--kinds", default="single,none,pairs", help=f"of {', '.join(KINDS)}")
    parser.add_argument(
        "--cells", default="validation", help="development, validation, all, or a name"
    )
    parser.add_argument("--changes", default="", help="only these, comma-separated")
    parser.add_argument("--no-baseline", action="store_true", help="judge without good logs")
    parser.add_argument("--workers", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("-o", "--output", type=Path, help="write what was judged as JSON")
    chosen = parser.parse_args(arguments)
    if unknown := [k for k in chosen.kinds.split(",") if k not in KINDS]:
        parser.error(f"--kinds {','.join(unknown)}: known are {', '.join(KINDS)}")
    if chosen.what != "judge":
        _make(chosen)
    if chosen.what != "make":
        _judge(chosen)
    return 0


def _make(chosen: argparse.Namespace) -> None:
    from benchmarks.physics_laboratory.published_cells import cells_for

    seed = chosen.seed or int.from_bytes(os.urandom(3)) + 10**6
    print(f"seed {seed}", file=sys.stderr)
    _each(make_cell, [(chosen.folder, c.name) for c in cells_for(chosen.cells)], chosen.workers)
    only = tuple(c for c in chosen.changes.split(",") if c)
    todo = [
        (chosen.folder, seed + k, kind, chosen.cells, only)
        for kind in chosen.kinds.split(",")
        for k in range(chosen.cases)
    ]
    _each(make_case, todo, chosen.workers)


def _judge(chosen: argparse.Namespace) -> None:
    from benchmarks.physics_laboratory.score import Judged, report

    names = sorted(p.parent for p in chosen.folder.glob("*/case.json"))
    tasks = [(p, chosen.no_baseline) for p in names]
    judged = [j for j in _each(judge_case, tasks, chosen.workers) if isinstance(j, Judged)]
    print(report(judged))
    if chosen.output:
        chosen.output.write_text(json.dumps([asdict(j) for j in judged], indent=1))


def _each(work: Callable[[Any], Any], tasks: Iterable[Any], workers: int) -> list[Any]:
    """Every task in a process of its own; a line for each on standard error."""
    done = []
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for result in pool.map(work, tasks):
            line = result if isinstance(result, str) else result.line()
            print(line, file=sys.stderr, flush=True)
            done.append(result)
    return done


if __name__ == "__main__":
    sys.exit(main())
