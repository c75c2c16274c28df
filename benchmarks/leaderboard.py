"""The public leaderboard: a row added, the page printed, a suite frozen.

python -m benchmarks.leaderboard add RESULTS/leaderboard.json [--by NAME] [--about TEXT] [--only E]
python -m benchmarks.leaderboard print [--check]
python -m benchmarks.leaderboard freeze SUITE.toml DATA

`add` keeps what a run of a frozen suite wrote below docs/leaderboard, a file for each estimator,
and prints docs/leaderboard.md again. `freeze` prints the [[data]] of a suite: what every log holds.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from textwrap import fill

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cellwise.benchmark.known_logs import known_log
from cellwise.benchmark.leaderboard import Standings, parts_of, read_entries
from cellwise.benchmark.standings import Table, choice_of, markdown
from cellwise.benchmark.suite import read_suite
from cellwise.logs.stated import Stated

WIDTH = 120  # of the docs' lines
DOCS = Path(__file__).resolve().parents[1] / "docs"
# Of everything that a run writes, what a reader compares by.
COLUMNS = (
    "rank [95 %]", "estimator", "interval score", "inside 2σ", "hard runs",
    "ended within 3 points", "against ekf [95 %]", "per row", "by",
)  # fmt: skip
BEGIN, END = (
    "<!-- printed: python -m benchmarks.leaderboard print -->",
    "<!-- printed until here -->",
)


def add(result: Path, by: str, about: str, only: str | None, kept: Path) -> list[Path]:
    """Keep every estimator of a run, each in a file of its own."""
    entries = read_entries(result)
    suite = read_suite(entries[0]["suite"])
    if suite.sha256 != entries[0]["suite_sha256"]:
        raise SystemExit(f"'{result}' is of another version of suite '{suite.name}': run it again")
    written = []
    for entry in entries:
        name = entry["row"]["estimator"]
        if only is not None and name != only:
            continue
        place = kept / suite.name / f"{name.replace(' ', '-')}.json"
        place.parent.mkdir(parents=True, exist_ok=True)
        abouts = entry.pop("about", {})
        said = about or abouts.get(name, "") if isinstance(abouts, dict) else about
        one = {**entry, "by": by, "about": said}
        text = json.dumps(one, sort_keys=True).replace('{"band_width"', '\n{"band_width"')
        place.write_text(text + "\n", encoding="utf-8")
        written.append(place)
    return written


def tables(kept: Path) -> Iterator[str]:
    """The standings of each suite."""
    for folder in sorted(path for path in kept.iterdir() if path.is_dir()):
        entries = [e for path in sorted(folder.glob("*.json")) for e in read_entries(path)]
        suite = read_suite(folder.name)
        yield f"### {folder.name}\n\nSuite's file: SHA-256 `{suite.sha256[:16]}`.\n"
        for part in parts_of(entries):
            yield f"#### {part.title}\n"
            yield "\n".join(markdown(page_table(part)))
            yield fill(choice_of(part.found), WIDTH, break_on_hyphens=False) + "\n"
        yield f"What each row is: `about` in its file of `docs/leaderboard/{folder.name}`.\n"
        said = [f"- **{one.name}**, not run: {one.why}." for one in suite.not_run]
        yield from (
            fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False) for line in said
        )
        yield ""


def page_table(part: Standings) -> Table:
    """What the page shows of a part: columns of its tables of errors and of bands."""
    heads = [name for table in part.tables for name in table.head]
    chosen = [heads.index(name) for name in COLUMNS]
    rows = ([*errors, *bands] for errors, bands in zip(*(t.rows for t in part.tables), strict=True))
    return Table([heads[k] for k in chosen], [[row[k] for k in chosen] for row in rows], (1, 8))


def printed(page: str, kept: Path) -> str:
    """The page with its tables as they are now."""
    before, _, rest = page.partition(BEGIN)
    after = rest.partition(END)[2]
    return f"{before}{BEGIN}\n\n{chr(10).join(tables(kept))}\n{END}{after}"


def freeze(suite_file: Path, data: Path) -> str:
    """The [[data]] tables of a suite's logs, whose original is the folder that they lie in."""
    suite = read_suite(suite_file)
    every = [*(p for c in suite.cells for p in c.tests), *(one.log for one in suite.logs)]
    text = []
    for location in dict.fromkeys(Stated.parse(one).path for one in every):
        known = known_log(location, data / location, location.partition("/")[0])
        values = {f.name: getattr(known, f.name) for f in fields(known)}
        lines = (
            f"{name} = {json.dumps(value) if isinstance(value, str) else _toml(value)}"
            for name, value in values.items()
        )
        text.append("[[data]]\n" + "\n".join(lines) + "\n")
    return "\n".join(text)


def _toml(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6f}"


def main(arguments: list[str] | None = None) -> int:
    """Add, print or freeze."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = parser.add_subparsers(dest="action", required=True)
    one = actions.add_parser("add")
    one.add_argument("result", type=Path)
    one.add_argument("--by", default="cellwise")
    one.add_argument("--about", default="")
    one.add_argument("--only")
    again = actions.add_parser("print")
    again.add_argument("--check", action="store_true", help="say whether it differs, write nothing")
    frozen = actions.add_parser("freeze")
    frozen.add_argument("suite", type=Path)
    frozen.add_argument("data", type=Path)
    chosen = parser.parse_args(arguments)
    kept, page = DOCS / "leaderboard", DOCS / "leaderboard.md"
    if chosen.action == "freeze":
        print(freeze(chosen.suite, chosen.data))
        return 0
    if chosen.action == "add":
        for path in add(chosen.result, chosen.by, chosen.about, chosen.only, kept):
            print(path.relative_to(DOCS.parent))
    before = page.read_text(encoding="utf-8")
    after = printed(before, kept)
    if chosen.action == "print" and chosen.check:
        return int(before != after)
    page.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
