"""How the choice of the capacity moves voltage and SOC: everything redone for every choice.

SOC, OCV and every table refer to one capacity. For each choice the cell is identified again, and
logs that took no part in it are simulated and estimated. The reference is the tester's counter over
one stated capacity, the same for all choices, so that a choice cannot judge itself.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.metrics import NEAR_EMPTY, drawn_sums
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.data import list_datasets, load_dataset
from cellwise.errors import InputError
from cellwise.estimate.replay import reference_soc, replay, soc_errors
from cellwise.identify.identification import CellTests, IdentifySettings
from cellwise.identify.pipeline import Progress, identify_cell
from cellwise.logs.cell_log import CellLog
from cellwise.studies.published import LFP, NCR18650B
from cellwise.typing import FloatArray

STUDIED = ("coulomb", "ekf", "ukf", "adaptive")
VOLTAGE = "voltage"


@dataclass(frozen=True, eq=False)
class StudyCell:
    """A cell to study.

    Parameters
    ----------
    name : str
    tests : CellTests                  what every choice is identified on
    judged : of CellLog               logs that no identification has seen, their initial SOC stated
    reference_Ah : float              charge between SOC 1 and 0 for the reference
    reference : str                   what that number is
    settings : IdentifySettings       nominal capacity among them
    values_Ah : mapping               further choices, each a number of its own [Ah]
    tests_of : mapping                choices that come with tests of their own, as in a
                                      characterization at one rate
    """

    name: str
    tests: CellTests
    judged: tuple[CellLog, ...]
    reference_Ah: float
    reference: str
    settings: IdentifySettings = field(default_factory=IdentifySettings)
    values_Ah: Mapping[str, float] = field(default_factory=dict)
    tests_of: Mapping[str, CellTests] = field(default_factory=dict)


class SocFigures(NamedTuple):
    """SOC error of one estimator, as fractions; ``end`` is the signed error where SOC is lowest.

    ``axis_share`` is the part of the squared error that is the SOC scale itself.
    """

    rmse: float
    mae: float
    max: float
    end: float
    axis_share: float


class RmseDifference(NamedTuple):
    """RMSE of the other less RMSE of the best, with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class ChoiceResult:
    """What one choice leads to, over all judged logs.

    ``errors`` holds voltage errors [V] under ``voltage`` and SOC errors under the estimators'
    names, one array per log.
    """

    choice: str
    capacity_Ah: float
    fit_rmse_V: float
    voltage_rmse_V: float
    voltage_above_10pct_V: float
    soc: Mapping[str, SocFigures]
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
    behind: Mapping[str, RmseDifference]

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

    def order(self, kind: str) -> list[ChoiceResult]:
        """Choices from best to worst."""
        return sorted(self.choices, key=lambda c: c.figure(kind))

    def winner(self, kind: str) -> Winner:
        """The best choice by the voltage's RMSE or an estimator's SOC RMSE."""
        best, *others = self.order(kind)
        behind = {c.choice: difference(c.errors[kind], best.errors[kind]) for c in others}
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
                    "soc": {e: s._asdict() for e, s in c.soc.items()},
                }
                for c in self.choices
            ],
            "winners": {
                w.kind: {
                    "choice": w.choice,
                    "rmse": w.value,
                    "alike": list(w.alike),
                    "behind": {name: d._asdict() for name, d in w.behind.items()},
                }
                for w in map(self.winner, self.kinds)
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
    if choices is None and cell.tests_of:
        choices = tuple(cell.tests_of)
    elif choices is None:
        say(f"{cell.name}: which choices there are")
        quick = replace(cell.settings, refine=cell.settings.refine and not cell.tests.hppc)
        choices = (*identify_cell(cell.tests, quick).capacities, *cell.values_Ah)
    found = []
    for choice in dict.fromkeys(choices):
        say(f"{cell.name}, {choice}: identify")
        settings = replace(cell.settings, capacity_choice=choice)
        if choice in cell.values_Ah:  # it goes by the name of the nominal capacity
            value = cell.values_Ah[choice]
            settings = replace(cell.settings, nominal_Ah=value, capacity_choice="nominal")
        made = identify_cell(cell.tests_of.get(choice, cell.tests), settings)
        say(f"{cell.name}, {choice}: simulate, estimate")
        found.append(judge(cell, choice, made.model, made.fit.rmse_V, estimators))
    logs = tuple(log.name for log in cell.judged)
    seconds = round(time.perf_counter() - began, 1)
    return CellStudy(cell.name, cell.reference_Ah, cell.reference, logs, tuple(found), seconds)


def judge(
    cell: StudyCell, choice: str, model: CellModel, fit_rmse_V: float, estimators: Sequence[str]
) -> ChoiceResult:
    """One model on every judged log."""
    errors: dict[str, list[FloatArray]] = {kind: [] for kind in (VOLTAGE, *estimators)}
    above, axes, ends = [], [], []
    for log in cell.judged:
        soc0 = 1.0 if log.soc0 is None else log.soc0
        truth = reference_soc(log, soc0, cell.reference_Ah)
        if truth is None:
            raise InputError(
                f"no charge counter in '{log.name}'",
                "the tester's counter in every judged log",
                "SOC has no other reference here: judge on a log that has it.",
            )
        simulated = simulate(model, log, soc0)
        known = np.isfinite(simulated.residual_V)
        errors[VOLTAGE].append(simulated.residual_V[known])
        above.append(simulated.residual_V[known & (truth > NEAR_EMPTY)])
        # What the choice's own SOC scale makes of the same counter.
        axes.append((soc0 - truth) * (1.0 - cell.reference_Ah / model.capacity_Ah))
        ends.append(int(np.nanargmin(truth)))
        for name in estimators:
            trace = replay(model, log, name, soc0=soc0, soc0_std=START_STD).trace
            errors[name].append(np.asarray(trace.soc - truth))
    soc = {}
    for name in estimators:
        whole = soc_errors(np.concatenate(errors[name]))
        end = float(np.mean([e[k] for e, k in zip(errors[name], ends, strict=True)]))
        share = axis_share(errors[name], axes)
        soc[name] = SocFigures(whole.rmse, whole.mae, whole.max, end, share)
    kept = {kind: tuple(own) for kind, own in errors.items()}
    rmse_V, above_V = (
        float(np.sqrt(np.mean(np.square(np.concatenate(e))))) for e in (errors[VOLTAGE], above)
    )
    return ChoiceResult(choice, model.capacity_Ah, fit_rmse_V, rmse_V, above_V, soc, kept)


# How a study is judged.
START_STD = 0.02  # of SOC
BLOCKS = 20  # drawn from a log
SEED = 1


def difference(
    other: Sequence[FloatArray],
    best: Sequence[FloatArray],
    rng: np.random.Generator | None = None,
) -> RmseDifference:
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
    cuts = [np.arange(e.size) * BLOCKS // max(e.size, 1) for e in other]
    block = np.concatenate([BLOCKS * k + cut for k, cut in enumerate(cuts)])

    def between(total: FloatArray) -> FloatArray:
        a, b = np.sqrt(total[..., :2] / total[..., 2:]).T
        return np.asarray(a - b)

    drawn = between(drawn_sums(block, sums, SEED if rng is None else rng))
    low, high = np.quantile(drawn, (0.025, 0.975))
    return RmseDifference(float(between(sums.sum(axis=0))), float(low), float(high))


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


NMC_RATES = {"rate:C/20": "c20", "rate:C/5": "c5", "rate:C/3": "c3"}
NMC_DRIVES = ("nmc_drive_b", "nmc_drive_c")
# The LFP paper's choices over what its cell gave with CC and CV.
LFP_CHOICES_AH = {name: row["capacity_Ah"] for name, row in LFP["errors"].items()}
LFP_WHOLE_AH = LFP_CHOICES_AH.pop("cc-cv-average")
PAPER_RATIOS = {f"as {q:g} of {LFP_WHOLE_AH:g}": q / LFP_WHOLE_AH for q in LFP_CHOICES_AH.values()}


def published_orders() -> dict[str, tuple[str, ...]]:
    """Choices of both papers from the smallest voltage RMSE to the largest."""
    lfp = sorted(LFP["errors"], key=lambda name: LFP["errors"][name]["rms_mV"])
    rates = NCR18650B["residuals"]
    nca = sorted(rates, key=lambda rate: rates[rate]["rmse_mV"])
    return {"lfp": tuple(lfp), "ncr18650b": tuple(f"rate:{rate}" for rate in nca)}


def _embedded(name: str, nominal_Ah: float, judged: Iterable[str], tests: CellTests) -> StudyCell:
    """A cell of the physics models; their catalogue knows its capacity and where its logs begin."""
    entries = {str(e["name"]): e for e in list_datasets()}
    known = {log: float(str(entries[log]["initial_soc"])) for log in judged}
    return StudyCell(
        name=name,
        tests=tests,
        judged=tuple(replace(load_dataset(log), soc0=soc0) for log, soc0 in known.items()),
        reference_Ah=float(str(entries[next(iter(known))]["true_capacity_Ah"])),
        reference="the physics model's own inventory",
        settings=IdentifySettings(nominal_Ah=nominal_Ah, name=name),
    )


def embedded_nmc() -> StudyCell:
    """NMC cell of the physics model: three capacity tests, two drives it has not seen."""
    tests = CellTests(
        hppc=((load_dataset("nmc_hppc"), None),),
        ocv=(load_dataset("nmc_ocv_c20"),),
        capacity=tuple(load_dataset(f"nmc_cap_{tag}") for tag in NMC_RATES.values()),
        drive=((load_dataset("nmc_drive_a"), None),),
    )
    return _embedded("embedded NMC", 5.0, NMC_DRIVES, tests)


def embedded_nmc_rates() -> StudyCell:
    """The same cell characterized at one rate at a time, as in the NCR18650B paper."""
    cell = _embedded("embedded NMC, one rate", 5.0, NMC_DRIVES, CellTests())
    tests = {
        choice: CellTests(
            hppc=((load_dataset(f"nmc_hppc_{tag}"), None),),
            capacity=(load_dataset(f"nmc_cap_{tag}"),),
        )
        for choice, tag in NMC_RATES.items()
    }
    return replace(cell, tests_of=tests)


def embedded_lfp() -> StudyCell:
    """LFP cell of the physics model on a charge-depleting cycle, with the LFP paper's ratios."""
    capacity = tuple(load_dataset(f"lfp_cap_{rate}") for rate in ("0p5c", "1c", "2c", "3c"))
    tests = CellTests(hppc=((load_dataset("lfp_hppc"), None),), capacity=capacity)
    cell = _embedded("embedded LFP", 2.3, ["lfp_cdc"], tests)
    values = {name: ratio * 2.3 for name, ratio in PAPER_RATIOS.items()}
    return replace(cell, settings=replace(cell.settings, chemistry="LFP"), values_Ah=values)


EMBEDDED = {
    "embedded-nmc": embedded_nmc,
    "embedded-nmc-rates": embedded_nmc_rates,
    "embedded-lfp": embedded_lfp,
}


def study_cells(names: tuple[str, ...]) -> tuple[StudyCell, ...]:
    """Embedded cells by name; no name means all.

    Raises
    ------
    InputError        an unknown name
    """
    unknown = [name for name in names if name not in EMBEDDED]
    if unknown:
        raise InputError(
            f"a cell '{unknown[0]}'", f"one of {', '.join(EMBEDDED)}", "Choose one of them."
        )
    return tuple(EMBEDDED[name]() for name in names or EMBEDDED)
