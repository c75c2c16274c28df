"""How the choice of the capacity moves voltage and SOC: everything redone for every choice.

SOC, OCV and every table refer to one capacity. For each choice the cell is identified again, and
logs that took no part in it are simulated and estimated. The reference is the tester's counter over
one stated capacity, the same for all choices, so that a choice cannot judge itself.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.metrics import drawn_sums
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.estimators import ESTIMATORS
from cellwise.estimate.replay import reference_soc, replay
from cellwise.identify.identification import IdentifySettings, TestLogs
from cellwise.identify.pipeline import Progress, identify_cell
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

STUDIED = tuple(e for e in ("coulomb", "ekf", "ukf", "adaptive") if e in ESTIMATORS)
VOLTAGE = "voltage"


@dataclass(frozen=True, eq=False)
class JudgedLog:
    """A log that no identification has seen, and the SOC at its first row."""

    log: CellLog
    soc0: float


@dataclass(frozen=True, eq=False)
class StudyCell:
    """A cell to study.

    Parameters
    ----------
    name : str
    tests : TestLogs                  what every choice is identified on
    judged : of JudgedLog
    reference_Ah : float              charge between SOC 1 and 0 for the reference
    reference : str                   what that number is
    settings : IdentifySettings       nominal capacity among them
    values_Ah : mapping               further choices, each a number of its own [Ah]
    tests_of : mapping                choices that come with tests of their own, as in a
                                      characterization at one rate
    """

    name: str
    tests: TestLogs
    judged: tuple[JudgedLog, ...]
    reference_Ah: float
    reference: str
    settings: IdentifySettings = field(default_factory=IdentifySettings)
    values_Ah: Mapping[str, float] = field(default_factory=dict)
    tests_of: Mapping[str, TestLogs] = field(default_factory=dict)


@dataclass(frozen=True)
class SocFigures:
    """SOC error of one estimator, as fractions; ``end`` is the signed error where SOC is lowest."""

    rmse: float
    mae: float
    max: float
    end: float


@dataclass(frozen=True, eq=False)
class ChoiceResult:
    """What one choice leads to, over all judged logs.

    ``errors`` holds voltage errors [V] under ``voltage`` and SOC errors under the estimators'
    names, one array per log; ``axis_share`` the part of each estimator's squared SOC error that is
    the SOC scale itself.
    """

    choice: str
    capacity_Ah: float
    fit_rmse_V: float
    voltage_rmse_V: float
    voltage_above_10pct_V: float
    soc: Mapping[str, SocFigures]
    axis_share: Mapping[str, float]
    errors: Mapping[str, tuple[FloatArray, ...]]

    def figure(self, kind: str) -> float:
        """RMSE of the voltage [V], or of SOC by one estimator."""
        return self.voltage_rmse_V if kind == VOLTAGE else self.soc[kind].rmse


@dataclass(frozen=True, eq=False)
class Winner:
    """The best choice by one figure, and how far each other one is behind."""

    kind: str
    choice: str
    value: float
    behind: Mapping[str, Difference]

    @property
    def alike(self) -> tuple[str, ...]:
        """Choices that cannot be separated from the best: their interval holds zero."""
        return tuple(name for name, d in self.behind.items() if d.low <= 0.0)


@dataclass(frozen=True, eq=False)
class CellStudy:
    """All choices of one cell."""

    name: str
    reference_Ah: float
    reference: str
    logs: tuple[str, ...]
    choices: tuple[ChoiceResult, ...]
    seconds: float

    @property
    def kinds(self) -> tuple[str, ...]:
        """What the choices are compared by."""
        return (VOLTAGE, *self.choices[0].soc)

    def order(self, kind: str) -> tuple[str, ...]:
        """Choices from best to worst."""
        return tuple(c.choice for c in sorted(self.choices, key=lambda c: c.figure(kind)))

    def winner(self, kind: str) -> Winner:
        """The best choice by the voltage's RMSE or an estimator's SOC RMSE."""
        best = min(self.choices, key=lambda c: c.figure(kind))
        behind = {
            c.choice: difference(c.errors[kind], best.errors[kind])
            for c in self.choices
            if c is not best
        }
        return Winner(kind, best.choice, best.figure(kind), behind)

    def to_dict(self) -> dict[str, Any]:
        """Every figure as JSON values."""
        return {
            "cell": self.name,
            "reference_Ah": self.reference_Ah,
            "reference": self.reference,
            "logs": list(self.logs),
            "choices": [
                {
                    "choice": c.choice,
                    "capacity_Ah": c.capacity_Ah,
                    "fit_rmse_V": c.fit_rmse_V,
                    "voltage_rmse_V": c.voltage_rmse_V,
                    "voltage_rmse_above_10pct_V": c.voltage_above_10pct_V,
                    "soc": {
                        e: {**vars(s), "axis_share": c.axis_share[e]} for e, s in c.soc.items()
                    },
                }
                for c in self.choices
            ],
            "winners": {
                kind: {
                    "choice": w.choice,
                    "rmse": w.value,
                    "alike": list(w.alike),
                    "behind": {name: vars(d) for name, d in w.behind.items()},
                }
                for kind in self.kinds
                for w in (self.winner(kind),)
            },
            "seconds": self.seconds,
        }


def study_cell(
    cell: StudyCell,
    choices: Sequence[str] | None = None,
    estimators: Sequence[str] = STUDIED,
    progress: Progress | None = None,
) -> CellStudy:
    """Identify and judge a cell once for every capacity choice.

    Parameters
    ----------
    choices : of str or None     None: every choice that the tests offer, and the cell's own values
    estimators : of str

    Raises
    ------
    InputError        nothing to judge on, no counter in a judged log, a choice the tests lack
    """
    if not cell.judged:
        raise InputError("no log to judge on", "at least one", "Give a log with a counter.")
    began = time.perf_counter()
    say = progress or (lambda _: None)
    wanted = _wanted(cell, choices, say)
    found: list[ChoiceResult] = []
    for choice in wanted:
        say(f"{cell.name}, {choice}: identify")
        model, fit = _identified(cell, choice)
        twin = next((c for c in found if _same(c, model, choice, cell)), None)
        if twin is not None:
            found.append(replace(twin, choice=choice))
            continue
        say(f"{cell.name}, {choice}: simulate, estimate")
        found.append(judge(cell, choice, model, fit, estimators))
    return CellStudy(
        cell.name,
        cell.reference_Ah,
        cell.reference,
        tuple(j.log.name for j in cell.judged),
        tuple(found),
        round(time.perf_counter() - began, 1),
    )


def judge(
    cell: StudyCell, choice: str, model: CellModel, fit_rmse_V: float, estimators: Sequence[str]
) -> ChoiceResult:
    """One model on every judged log."""
    voltage: list[FloatArray] = []
    above: list[FloatArray] = []
    soc_errors: dict[str, list[FloatArray]] = {e: [] for e in estimators}
    axes: list[FloatArray] = []
    lowest: list[int] = []
    for judged in cell.judged:
        log = judged.log
        truth = reference_soc(log, judged.soc0, cell.reference_Ah)
        if truth is None:
            raise InputError(
                f"no charge counter in '{log.name}'",
                "the tester's counter in every judged log",
                "SOC has no other reference here: judge on a log that has it.",
            )
        simulated = simulate(model, log, judged.soc0)
        known = np.isfinite(simulated.error_V)
        voltage.append(simulated.error_V[known])
        above.append(simulated.error_V[known & (truth > 0.1)])
        # What the choice's own SOC scale makes of the same counter.
        axes.append((judged.soc0 - truth) * (1.0 - cell.reference_Ah / model.capacity_Ah))
        lowest.append(int(np.nanargmin(truth)))
        for name in estimators:
            found = replay(model, log, name, soc0=judged.soc0, soc0_std=DRAWN.soc0_std)
            soc_errors[name].append(np.asarray(found.trace.soc - truth))
    return ChoiceResult(
        choice=choice,
        capacity_Ah=model.capacity_Ah,
        fit_rmse_V=fit_rmse_V,
        voltage_rmse_V=_rms(voltage),
        voltage_above_10pct_V=_rms(above),
        soc={e: _figures(errors, lowest) for e, errors in soc_errors.items()},
        axis_share={e: axis_share(errors, axes) for e, errors in soc_errors.items()},
        errors={
            VOLTAGE: tuple(voltage),
            **{e: tuple(errors) for e, errors in soc_errors.items()},
        },
    )


def _wanted(cell: StudyCell, choices: Sequence[str] | None, say: Progress) -> tuple[str, ...]:
    if choices is not None:
        return tuple(dict.fromkeys(choices))
    if cell.tests_of:
        return tuple(cell.tests_of)
    say(f"{cell.name}: which choices there are")
    quick = replace(cell.settings, refine=False) if cell.tests.hppc else cell.settings
    offered = identify_cell(cell.tests, quick).capacities
    return (*offered, *cell.values_Ah)


def _identified(cell: StudyCell, choice: str) -> tuple[CellModel, float]:
    tests = cell.tests_of.get(choice, cell.tests)
    if choice in cell.values_Ah:
        # A number of its own goes by the name of the nominal capacity.
        settings = replace(
            cell.settings, nominal_Ah=cell.values_Ah[choice], capacity_choice="nominal"
        )
    else:
        settings = replace(cell.settings, capacity_choice=choice)
    found = identify_cell(tests, settings)
    return found.model, found.fit.rmse_V


def _same(result: ChoiceResult, model: CellModel, choice: str, cell: StudyCell) -> bool:
    """Two names of one number: identified on the same tests, they are one model."""
    tests = cell.tests_of.get(choice) is cell.tests_of.get(result.choice)
    return tests and result.capacity_Ah == model.capacity_Ah


def _rms(errors: Sequence[FloatArray]) -> float:
    together = np.concatenate(errors)
    return float(np.sqrt(np.nanmean(together * together))) if together.size else float("nan")


def _figures(errors: Sequence[FloatArray], lowest: Sequence[int]) -> SocFigures:
    size = np.abs(np.concatenate(errors))
    ends = [float(e[k]) for e, k in zip(errors, lowest, strict=True)]
    return SocFigures(
        rmse=_rms(errors),
        mae=float(np.nanmean(size)),
        max=float(np.nanmax(size)),
        end=float(np.mean(ends)),
    )


class Drawn(NamedTuple):
    """How a study is judged: SOC's deviation at the start, blocks drawn from a log, the seed."""

    soc0_std: float = 0.02
    blocks: int = 20
    seed: int = 1


DRAWN = Drawn()


@dataclass(frozen=True)
class Difference:
    """RMSE of the other less RMSE of the best, with its 95 % interval."""

    value: float
    low: float
    high: float


def difference(
    other: Sequence[FloatArray],
    best: Sequence[FloatArray],
    rng: np.random.Generator | None = None,
) -> Difference:
    """How much larger one RMSE is than another on the same logs.

    The logs are cut into blocks that hold an error for longer than it is remembered, and the blocks
    are drawn again, for both errors together: errors that go up and down together leave a narrow
    interval (paired block bootstrap; H. R. Kuensch, Ann. Statist. 17 (1989) 1217,
    doi:10.1214/aos/1176347265).

    Parameters
    ----------
    other, best : of (rows,) float     errors, one array per log
    """
    errors = np.column_stack((np.concatenate(other), np.concatenate(best)))
    sums = np.column_stack((np.nan_to_num(errors) ** 2, np.isfinite(errors[:, 0])))
    cuts = [np.arange(e.size) * DRAWN.blocks // max(e.size, 1) for e in other]
    block = np.concatenate([DRAWN.blocks * k + cut for k, cut in enumerate(cuts)])

    def between(total: FloatArray) -> FloatArray:
        a, b = np.sqrt(total[..., :2] / total[..., 2:]).T
        return np.asarray(a - b)

    drawn = between(drawn_sums(block, sums, DRAWN.seed if rng is None else rng))
    low, high = np.quantile(drawn, (0.025, 0.975))
    return Difference(float(between(sums.sum(axis=0))), float(low), float(high))


def axis_share(errors: Sequence[FloatArray], axis: Sequence[FloatArray]) -> float:
    """Part of a squared SOC error that goes when the choice's own SOC scale is the reference.

    ``axis`` is what the choice's scale reads on the counter less the reference. 1: the error is
    nothing but the scale; 0: the scale has no part in it; negative: the scale made up for another
    error.
    """
    e, a = np.concatenate(errors), np.concatenate(axis)
    known = np.isfinite(e) & np.isfinite(a)
    whole = float(np.sum(e[known] ** 2))
    rest = float(np.sum((e[known] - a[known]) ** 2))
    return 1.0 - rest / whole if whole > 0.0 else 0.0
