"""Measures every figure that the pages show, and writes them where they stand.

python -m benchmarks.publish [--only cold,lfp,...] [--again] [--from FILE]

Each part goes to benchmarks/results/accuracy.json as soon as it is measured, each row with its
commit and date; a part that stands there of the code that is here is not measured again (but with
--again), so that a run that was stopped goes on. docs/accuracy.md and the table in README.md are
printed from that file; --from prints them from a file that is there and measures nothing. The exit
code is 1 where a case broke off: its rows are left out, and it is said which.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.accuracy.__main__ import PARTS as ACCURACY
from benchmarks.accuracy_page import headlines, print_pages
from benchmarks.figures import Figure, describe_machine
from benchmarks.firmware.__main__ import PARTS as FIRMWARE
from benchmarks.measured_data import HOW, REPOSITORY, data_folder
from benchmarks.parts import chosen_parts, measure, say_so
from cellwise.files import write_atomically

RESULTS = REPOSITORY / "benchmarks" / "results" / "accuracy.json"
# Not speed: it needs a machine that does nothing else (python -m benchmarks.speed). What power and
# remaining time cost on a target no page shows: python -m benchmarks.firmware --only calls.
PARTS = {**ACCURACY, "target": FIRMWARE["target"]}
# What the figures depend on; the results themselves are none of it.
CODE = ("src", "benchmarks", "firmware_ref", ":!benchmarks/results")


def git(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Git in this repository."""
    return subprocess.run(
        ["git", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )


def commit_here() -> str:
    """The commit that is measured; one with a plus has changes that are in none."""
    changed = git("status", "--porcelain", "--untracked-files=no", "--", *CODE).stdout.strip()
    return git("rev-parse", "--short=8", "HEAD").stdout.strip() + ("+" if changed else "")


def of_this_code(commit: str) -> bool:
    """Whether nothing that is measured has changed since a commit."""
    return git("diff", "--quiet", commit, "--", *CODE).returncode == 0


def results_there() -> dict[str, Any]:
    """What was measured before; empty where nothing was."""
    if not RESULTS.exists():
        return {"machine": {}, "cpu_s": {}, "figures": []}
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def to_measure(wanted: Sequence[str], results: dict[str, Any], again: bool) -> list[str]:
    """The parts wanted that do not stand in the results, whole and of this code."""
    if again:
        return list(wanted)
    rows = {part: [f for f in results["figures"] if f["part"] == part] for part in wanted}
    current = {commit: of_this_code(commit) for own in rows.values() for commit in _commits(own)}

    def stands(own: list[dict[str, Any]]) -> bool:
        return bool(own) and all(current[f["commit"]] and not f["failed"] for f in own)

    return [part for part in wanted if not stands(rows[part])]


def _commits(rows: list[dict[str, Any]]) -> set[str]:
    return {f["commit"] for f in rows}


def with_part(
    results: dict[str, Any], part: str, figures: Sequence[Figure], commit: str, cpu_s: float
) -> dict[str, Any]:
    """The results with the rows of one part in place of those that were there, in order."""
    made = {"part": part, "commit": commit, "date": datetime.now(UTC).date().isoformat()}
    rows = [f for f in results["figures"] if f["part"] != part]
    rows += [{**f.to_dict(), **made} for f in figures]
    order = list(PARTS)
    return {
        "machine": describe_machine(),
        "cpu_s": {**results["cpu_s"], part: round(cpu_s, 1)},
        "figures": sorted(rows, key=lambda f: order.index(f["part"])),
    }


def measure_part(part: str, results: dict[str, Any]) -> dict[str, Any]:
    """Measure one part, and write it at once."""
    say_so(part)
    commit, began = commit_here(), cpu_seconds()
    figures = measure(PARTS, [part], say_so)
    results = with_part(results, part, figures, commit, cpu_seconds() - began)
    write_atomically(RESULTS, json.dumps(results, indent=1) + "\n")
    return results


def cpu_seconds() -> float:
    """CPU time of this process and of the emulators and compilers that it ran [s]."""
    return sum(os.times()[:4])


def main(arguments: list[str] | None = None) -> int:
    """Measure, or read, and print the pages."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--only", default=",".join(PARTS), help="comma-separated parts")
    parser.add_argument("--again", action="store_true", help="also parts that stand there")
    parser.add_argument("--from", dest="source", type=Path, help="results that are there")
    chosen = parser.parse_args(arguments)
    wanted = chosen_parts(parser, PARTS, chosen.only)
    if chosen.source:
        results = json.loads(chosen.source.read_text(encoding="utf-8"))
    elif data_folder() is None:
        parser.error(f"no measured cells: {HOW}")
    else:
        results = results_there()
        for part in to_measure(wanted, results, chosen.again):
            results = measure_part(part, results)
    print_pages(results)
    return told(results)


def told(results: dict[str, Any]) -> int:
    """Say what is on the pages and what broke off; the exit code."""
    print(f"{len(headlines(results))} figures on the pages")
    broken = [f for f in results["figures"] if f["failed"]]
    for f in broken:
        print(f"broke off, left out: {f['part']}, {f['group']}: {f['note']}", file=sys.stderr)
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
