"""How often what was said with a probability was so: a table of judged cases, and its diagram.

python -m benchmarks.physics_laboratory.reliability [JUDGED.json ...]

With files that `judge -o` wrote the table is made anew; the picture is always drawn from the table.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

from scipy.stats import beta

from benchmarks.measured_data import REPOSITORY
from benchmarks.physics_laboratory.changes import CHANGES
from benchmarks.physics_laboratory.score import NOTHING

TABLE = Path(__file__).parent / "reliability.csv"
PICTURE = REPOSITORY / "docs" / "pictures" / "reliability.png"
EDGES = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)


@dataclass(frozen=True)
class Said:
    """One cause, or nothing, and the probability it had in one case; ``true``: it was there."""

    seed: int
    kind: str
    cell: str
    changes: str
    cause: str
    probability: float
    true: bool


@dataclass(frozen=True)
class Group:
    """What was said between two probabilities: how often, how often it was so, mean probability.

    ``low`` and ``high`` are the 95 % interval of the share that was so (Jeffreys).
    """

    above: float
    up_to: float
    said: int
    true: int
    mean: float
    low: float
    high: float


def said_in(judged: Sequence[dict[str, Any]]) -> list[Said]:
    """Everything that judged cases said, sets of less than two in a hundred left out."""
    found = []
    for one in judged:
        there = frozenset[str]().union(*(CHANGES[c].there for c in one["changes"]))
        for cause, probability in one["probability"].items():
            true = cause in there if cause != NOTHING else not one["changes"]
            found.append(
                Said(
                    one["seed"],
                    one["kind"],
                    one["cell"],
                    " + ".join(one["changes"]),
                    cause,
                    round(min(probability, 1.0), 4),
                    true,
                )
            )
    return found


def groups(said: Sequence[Said]) -> list[Group]:
    """The shares by probability."""
    found = []
    for above, up_to in pairwise(EDGES):
        part = [s for s in said if above < s.probability <= up_to]
        if part:
            n, true = len(part), sum(s.true for s in part)
            low, high = (float(beta.ppf(q, true + 0.5, n - true + 0.5)) for q in (0.025, 0.975))
            mean = sum(s.probability for s in part) / n
            found.append(Group(above, up_to, n, true, mean, low, high))
    return found


def write_table(said: Sequence[Said], path: Path = TABLE) -> None:
    """As CSV, a row for each cause of each case."""
    with path.open("w", newline="") as file:
        rows = csv.DictWriter(file, [f.name for f in fields(Said)], lineterminator="\n")
        rows.writeheader()
        rows.writerows({**asdict(s), "true": int(s.true)} for s in said)


def read_table(path: Path = TABLE) -> list[Said]:
    """What `write_table` wrote."""
    with path.open() as file:
        return [
            Said(
                int(r["seed"]),
                r["kind"],
                r["cell"],
                r["changes"],
                r["cause"],
                float(r["probability"]),
                r["true"] == "1",
            )
            for r in csv.DictReader(file)
        ]


def draw(said: Sequence[Said], path: Path = PICTURE) -> Path:
    """The diagram: share that was so over probability said."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    found = groups(said)
    for g in found:
        share = g.true / g.said
        axes.errorbar(
            g.mean, share, [[max(share - g.low, 0.0)], [max(g.high - share, 0.0)]],
            fmt="o", color="C0", capsize=3,
        )  # fmt: skip
        axes.annotate(
            f"{g.true} of {g.said}",
            (g.mean, g.high),
            (0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
    last = found[-1]
    axes.set(
        xlabel="probability said",
        ylabel="share that was there",
        xlim=(0, 1.05),
        ylim=(-0.03, 1.05),
        title=f"Said with {last.above:g} to {last.up_to:g}: {last.true} of {last.said} are there",
    )
    figure.savefig(path, dpi=110)
    return path


def main(files: Sequence[str]) -> None:
    """Make the table of files that were named, draw what the table says."""
    if files:
        write_table(said_in([one for f in files for one in json.loads(Path(f).read_text())]))
    said = read_table()
    for g in groups(said):
        print(f"{g.above:.2f} to {g.up_to:.2f}: {g.true} of {g.said}, mean said {g.mean:.2f}")
    print(draw(said))


if __name__ == "__main__":
    main(sys.argv[1:])
