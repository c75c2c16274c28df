"""Measures every figure that the pages show, on one commit, and writes them where they stand.

python -m benchmarks.publish [--from FILE]

The results go to benchmarks/results/accuracy.json with commit, date and machine; docs/accuracy.md
and the table in README.md are printed from that file. --from prints them from a file that is there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.accuracy.__main__ import PARTS as ACCURACY
from benchmarks.figures import between_marks, describe_machine, measure, report_json
from benchmarks.firmware.__main__ import PARTS as FIRMWARE
from benchmarks.measured_data import HOW, REPOSITORY, data_folder
from cellwise.files import write_atomically

RESULTS = REPOSITORY / "benchmarks" / "results" / "accuracy.json"
PAGE = REPOSITORY / "docs" / "accuracy.md"
README = REPOSITORY / "README.md"
# Not speed: it needs a machine that does nothing else (python -m benchmarks.speed).
PARTS = {**ACCURACY, "target": FIRMWARE["target"]}
MOST_ROWS = 40  # a page that is read to its end
MARKS = "<!-- figures: printed by benchmarks/publish.py -->", "<!-- end of figures -->"
MIDDLE = "under load in the middle, 30 points wrong: SOC RMSE"
README_CELL = "Panasonic"
README_ROWS = {
    f"EKF, {MIDDLE}": "EKF",
    f"fixed step and its C, {MIDDLE}": "the C that is exported",
    f"plain EKF (filterpy), {MIDDLE}": "an EKF as filterpy's users write it",
    "voltage RMSE above 10 % SOC, NN": "voltage of a drive that was left out",
}
ABOUT = """# Accuracy

On measured cells and logs that took no part in the fit. `python -m benchmarks.publish` measures
all of it on one commit and prints this page from `benchmarks/results/accuracy.json`; the measured
cells are in the folder that `$CELLWISE_DATA` names (`datasets/registry.toml`). The reference of a
SOC is the tester's own counter over the laboratory's capacity; of the Panasonic below 0 degC,
which had aged by an unknown part, the nearest of 2.8, 2.9 and 2.997 Ah, for every estimator alike.
What falls short, and where to be careful: [limits](limits.md).
What `diagnose` finds: [criticism](criticism.md).
"""


def commit_here() -> str:
    """The commit that is measured; one with a plus has changes that are in none."""

    def git(*arguments: str) -> str:
        ran = subprocess.run(
            ["git", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=True
        )
        return ran.stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no", "src", "benchmarks/accuracy")
    return git("rev-parse", "--short=8", "HEAD") + ("+" if changed else "")


def measured() -> dict[str, Any]:
    """Every part, with when and on what it was measured."""
    began = time.perf_counter()
    made = {"commit": commit_here(), "date": datetime.now(UTC).date().isoformat()}
    figures = measure(PARTS, PARTS, lambda what: print(f"  {what} ...", file=sys.stderr))
    return {**made, **report_json(figures, describe_machine(), began)}


def headlines(results: dict[str, Any]) -> list[dict[str, Any]]:
    """The figures that the pages show."""
    return [f for f in results["figures"] if f["headline"] and f["value"] is not None]


def page_of(results: dict[str, Any]) -> str:
    """docs/accuracy.md of these results.

    Raises
    ------
    ValueError        more rows than a page has room for
    """
    rows = headlines(results)
    if len(rows) > MOST_ROWS:
        raise ValueError(f"{len(rows)} headlines, at most {MOST_ROWS}: choose")
    lines = [
        ABOUT,
        f"Commit `{results['commit']}`, {results['date']}, {results['machine']['processor']}. "
        "**Bold**: misses its bound.\n",
    ]
    for group in dict.fromkeys(f["group"] for f in rows):
        own = [f for f in rows if f["group"] == group]
        lines += [f"## {group}\n", "| figure | value | bound | |", "|---|---|---|---|"]
        lines += [f"| {f['who']} | {value_of(f)} | {bound_of(f)} | {f['note']} |" for f in own]
        lines.append("")
    return "\n".join(lines)


def value_of(f: dict[str, Any]) -> str:
    """A value with its unit, bold where it misses."""
    text = f"{f['value']:.3g}" if f["value"] < 1000.0 else f"{f['value']:,.0f}"
    return f"**{text}** {f['unit']}" if f["passed"] is False else f"{text} {f['unit']}"


def bound_of(f: dict[str, Any]) -> str:
    """What was asked for."""
    if f["target"] is None:
        return ""
    return f"{'at least' if f['at_least'] else 'at most'} {f['target']:g} {f['unit']}"


def readme_table(results: dict[str, Any]) -> str:
    """The table of README.md: a hard case at five temperatures."""
    rows = [f for f in headlines(results) if f["group"].startswith(README_CELL)]
    groups = list(dict.fromkeys(f["group"] for f in rows if f["who"] in README_ROWS))
    warm = [group.removeprefix(README_CELL).partition(",")[0].strip() for group in groups]
    lines = [
        f"| | {' | '.join(warm)} |",
        f"|---|{'---|' * len(warm)}",
    ]
    for who, called in README_ROWS.items():
        own = {f["group"]: f for f in rows if f["who"] == who}
        lines.append(f"| {called} | {' | '.join(value_of(own[g]) for g in groups)} |")
    note = f"Commit `{results['commit']}`, {results['date']}; **bold**: misses its bound."
    return "\n".join((*lines, "", note))


def main(arguments: list[str] | None = None) -> int:
    """Measure, or read, and print the pages."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--from", dest="source", type=Path, help="results that are there")
    chosen = parser.parse_args(arguments)
    if chosen.source is None and data_folder() is None:
        parser.error(f"no measured cells: {HOW}")
    if chosen.source:
        results = json.loads(chosen.source.read_text(encoding="utf-8"))
    else:
        results = measured()
        write_atomically(RESULTS, json.dumps(results, indent=1) + "\n")
    write_atomically(PAGE, page_of(results))
    readme = README.read_text(encoding="utf-8")
    write_atomically(README, between_marks(readme, MARKS, readme_table(results)))
    print(f"{len(headlines(results))} figures of commit {results['commit']} in {PAGE.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
