"""docs/accuracy.md and the table of README.md, printed from benchmarks/results/accuracy.json."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from benchmarks.figures import between_marks
from benchmarks.measured_data import REPOSITORY
from cellwise.files import write_atomically

PAGE = REPOSITORY / "docs" / "accuracy.md"
README = REPOSITORY / "README.md"
LEGEND = "In brackets the bound; **bold**: misses it."
WARM = re.compile(r"\s-?\d+ degC")
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
all of it and prints this page from `benchmarks/results/accuracy.json`; the measured
cells are in the folder that `$CELLWISE_DATA` names (`datasets/registry.toml`). The reference of a
SOC is the tester's own counter over the laboratory's capacity; of the Panasonic below 0 degC,
which had aged by an unknown part, the nearest of 2.8, 2.9 and 2.997 Ah, for every estimator alike.
What falls short, and where to be careful: [limits](limits.md).
What `diagnose` finds: [criticism](criticism.md).
"""


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
    one = len(days(rows)) == 1
    lines = [ABOUT, f"{' '.join(days(rows))} {LEGEND}" if one else LEGEND]
    for family in dict.fromkeys(family_of(f) for f in rows):
        own = [f for f in rows if family_of(f) == family]
        said = [] if one else [f"{' '.join(days(own))}\n"]
        lines += [f"\n## {family}\n", *said, *table_of(own)]
    return "\n".join((*lines, ""))


def family_of(f: dict[str, Any]) -> str:
    """The heading of a figure: its group without the temperature."""
    return " ".join(WARM.sub(" ", f["group"]).split()).replace(" ,", ",")


def warm_of(f: dict[str, Any]) -> str:
    """The temperature in a figure's group; empty without one."""
    found = WARM.search(f["group"])
    return found.group().strip(" ,") if found else ""


def table_of(rows: list[dict[str, Any]]) -> list[str]:
    """One line for each figure, one column for each temperature."""
    columns = list(dict.fromkeys(warm_of(f) for f in rows))
    lines = [f"| | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}"]
    for who in dict.fromkeys(f["who"] for f in rows):
        own = {warm_of(f): f"{value_of(f)}{bound_of(f)}" for f in rows if f["who"] == who}
        lines.append(f"| {who} | {' | '.join(own.get(c, '') for c in columns)} |")
    return lines


def days(rows: Iterable[dict[str, Any]]) -> list[str]:
    """On which commits and days these rows were measured."""
    return list(dict.fromkeys(f"Commit `{f['commit']}`, {f['date']}." for f in rows))


def value_of(f: dict[str, Any]) -> str:
    """A value with its unit, bold where it misses."""
    text = f"{f['value']:.3g}" if f["value"] < 1000.0 else f"{f['value']:,.0f}"
    return f"**{text}** {f['unit']}" if f["passed"] is False else f"{text} {f['unit']}"


def bound_of(f: dict[str, Any]) -> str:
    """What was asked for."""
    if f["target"] is None:
        return ""
    return f" ({'≥' if f['at_least'] else '≤'} {f['target']:g})"


def readme_table(results: dict[str, Any]) -> str:
    """The table of README.md: a hard case at five temperatures."""
    rows = [f for f in headlines(results) if f["who"] in README_ROWS]
    rows = [f for f in rows if f["group"].startswith(README_CELL)]
    groups = list(dict.fromkeys(f["group"] for f in rows))
    warm = [group.removeprefix(README_CELL).partition(",")[0].strip() for group in groups]
    lines = [
        f"| | {' | '.join(warm)} |",
        f"|---|{'---|' * len(warm)}",
    ]
    for who, called in README_ROWS.items():
        own = {f["group"]: value_of(f) for f in rows if f["who"] == who}
        lines.append(f"| {called} | {' | '.join(own.get(g, '') for g in groups)} |")
    note = f"{' '.join(days(rows))} **Bold**: misses its bound."
    return "\n".join((*lines, "", note))


def print_pages(results: dict[str, Any]) -> None:
    """Write the page, and the table into README.md."""
    write_atomically(PAGE, page_of(results))
    readme = README.read_text(encoding="utf-8")
    write_atomically(README, between_marks(readme, MARKS, readme_table(results)))
