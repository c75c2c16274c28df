"""A diagnosis judged against what was changed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.physics_laboratory.changes import CHANGES, INSEPARABLE
from benchmarks.physics_laboratory.stored import Case
from cellwise import CellModel

# Of `undetermined`, no more may compete for it to be an answer.
MOST_COMPETING = 3
NOTHING = "nothing"


@dataclass(frozen=True)
class Judged:
    """One case and what was said of it."""

    label: str
    kind: str
    changes: tuple[str, ...]
    with_baseline: bool
    verdict: str
    named: tuple[str, ...]
    competing: tuple[tuple[str, ...], ...]
    seconds: float
    likeliest: tuple[str, ...] = ()
    cell: str = ""
    seed: int = 0
    probability: dict[str, float] = field(default_factory=dict)

    @property
    def exact(self) -> bool:
        """The first cause is what was done; nothing where nothing was."""
        if not self.changes:
            return self.verdict == "none"
        return self.verdict in {CHANGES[c].exact for c in self.changes}

    @property
    def acceptable(self) -> bool:
        """The first cause is right; or it is undetermined within a group declared beforehand."""
        if not self.changes:
            return self.verdict == "none"
        if any(self.verdict in CHANGES[c].acceptable for c in self.changes):
            return True
        return self.rightly_open

    @property
    def rightly_open(self) -> bool:
        """Undetermined between few, the right one among them, all of one group."""
        if self.verdict != "undetermined" or not 1 < len(self.competing) <= MOST_COMPETING:
            return False
        rivals = {name for causes in self.competing for name in causes}
        right = any(CHANGES[c].exact in rivals for c in self.changes)
        return right and any(rivals <= group for group in INSEPARABLE)

    @property
    def all_named(self) -> bool:
        """Every change has a cause that describes it."""
        return all(CHANGES[c].acceptable & set(self.named) for c in self.changes)

    @property
    def false_names(self) -> tuple[str, ...]:
        """Causes named that are not there."""
        there = frozenset[str]().union(*(CHANGES[c].there for c in self.changes))
        return tuple(n for n in self.named if n not in there)

    def line(self) -> str:
        """For people."""
        mark = "ok " if self.acceptable else "NO "
        said = " + ".join(self.named) or self.verdict
        if self.competing:
            said += " between " + " | ".join(" + ".join(c) for c in self.competing)
        base = " baseline" if self.with_baseline else ""
        false = f"  FALSE {', '.join(self.false_names)}" if self.false_names else ""
        first = f"; likeliest alone {', '.join(self.likeliest)}" if self.likeliest else ""
        return f"{mark}{self.label}{base} -> {said}{false}{first} ({self.seconds:.0f} s)"


def judge(case: Case, model: CellModel, diagnose: Callable[..., Any]) -> Judged:
    """Diagnose a case and compare."""
    began = time.perf_counter()
    said = diagnose(model, case.logs, holdout=case.holdout, baseline=case.baseline, soc0=case.soc0)
    competing = getattr(said, "competing", ())
    likeliest = sorted(said.candidates, key=lambda c: -c.score)
    return Judged(
        case.label,
        case.kind,
        case.changes,
        bool(case.baseline),
        said.verdict,
        tuple(c.name for c in said.causes),
        tuple(tuple(_names(c)) for c in competing),
        time.perf_counter() - began,
        tuple(f"{c.name} {c.score:.0f}" for c in likeliest[:4]),
        case.cell,
        case.seed,
        _probability(competing),
    )


def _probability(competing: Iterable[Any]) -> dict[str, float]:
    """What the sets that hold a cause weigh together; ``nothing``: the empty set."""
    found: dict[str, float] = {}
    for one in competing:
        for name in _names(one) or (NOTHING,):
            found[name] = found.get(name, 0.0) + float(one.probability)
    return found


def _names(one: Any) -> Sequence[str]:
    """Names of a competing set, whatever the form of the record."""
    return one["causes"] if isinstance(one, dict) else getattr(one, "causes", one)


def report(judged: Iterable[Judged]) -> str:
    """The figures that the project is measured by, and every case that went wrong."""
    every = list(judged)
    lines = []
    for kind in dict.fromkeys(j.kind for j in every):
        part = [j for j in every if j.kind == kind]
        n = len(part)
        if kind == "pairs":
            both = sum(j.all_named for j in part)
            lines.append(f"{kind}: both named in {both} of {n}")
        lines.append(
            f"{kind}: first cause acceptable in {sum(j.acceptable for j in part)} of {n}, "
            f"exact in {sum(j.exact for j in part)}, "
            f"undetermined {sum(j.verdict == 'undetermined' for j in part)}, "
            f"none {sum(j.verdict == 'none' for j in part)}"
        )
    named = sum(len(j.named) for j in every)
    false = sum(len(j.false_names) for j in every)
    lines.append(f"causes named: {named}, of them not there: {false}")
    lines += [j.line() for j in every]
    return "\n".join(lines)
