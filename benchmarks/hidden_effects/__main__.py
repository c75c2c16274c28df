"""Effects hidden in emulated and measured logs: which are named, how well, and from what size on.

python -m benchmarks.hidden_effects [--parts single,none,pairs,real,limit] [--cases 15]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path

from benchmarks.hidden_effects.tables import print_limits, print_report
from benchmarks.hidden_effects.tasks import SIZES_V, Task, limit_tasks, run, tasks

PARTS = ("single", "none", "pairs", "real", "limit")


def main(arguments: list[str] | None = None) -> int:
    """Hide, diagnose, open, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", default="single,none,pairs", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--seed", type=int, default=7000, help="first seed; 0 draws one")
    parser.add_argument(
        "--cases", type=int, default=15, help="cases of each part (limit: of each effect)"
    )
    parser.add_argument("--effects", default="", help="only these effects, comma-separated")
    parser.add_argument("--size-mv", type=float, help="size of every effect; else 10 to 25")
    parser.add_argument("--rows", type=int, default=5000, help="rows of a log at 1 Hz")
    parser.add_argument("--model", choices=("known", "identified"), help="else either")
    parser.add_argument("--workers", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--verbose", action="store_true", help="a line for every case")
    parser.add_argument("-o", "--output", type=Path, help="write every outcome as JSON")
    chosen = parser.parse_args(arguments)
    wanted = chosen.parts.split(",")
    if unknown := [p for p in wanted if p not in PARTS]:
        parser.error(f"--parts {','.join(unknown)}: known are {', '.join(PARTS)}")
    if chosen.seed == 0:
        chosen.seed = int.from_bytes(os.urandom(3)) + 10**6
    print(f"seed {chosen.seed}", file=sys.stderr)
    effects = tuple(e for e in chosen.effects.split(",") if e)
    began = time.perf_counter()
    made = [
        task
        for part in wanted
        if part != "limit"
        for task in tasks(
            part, chosen.seed, chosen.cases, effects, chosen.size_mv, chosen.rows, chosen.model
        )
    ]
    limits = (
        limit_tasks(chosen.seed, chosen.cases, effects, chosen.rows, chosen.model)
        if "limit" in wanted
        else []
    )
    results = _run_all([*made, *limits], chosen.workers, chosen.verbose)
    outcomes = [(task.part, o) for task, found in results for o in found.outcomes if task in made]
    found_at = [(task.effects[0], f.smallest_V, f) for task, f in results if task in limits]
    print_report(outcomes)
    print_limits(found_at, SIZES_V)
    print(f"{time.perf_counter() - began:.0f} s")
    if chosen.output:
        every = [
            {"part": task.part, "smallest_V": f.smallest_V, **asdict(o)}
            for task, f in results
            for o in f.outcomes
        ]
        chosen.output.write_text(json.dumps({"seed": chosen.seed, "outcomes": every}, indent=1))
    return 0


def _run_all(todo: list[Task], workers: int, verbose: bool) -> list:
    """Every task with what came of it, in any order; progress on standard error."""
    done = []
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for task, found in pool.imap_unordered(run, todo):
            done.append((task, found))
            if verbose:
                for outcome in found.outcomes:
                    print(outcome.line(), flush=True)
            if sys.stderr.isatty() or len(done) % 10 == 0:
                end = "\r" if sys.stderr.isatty() else "\n"
                print(f"{len(done)} of {len(todo)} ", end=end, file=sys.stderr, flush=True)
    return done


if __name__ == "__main__":
    sys.exit(main())
