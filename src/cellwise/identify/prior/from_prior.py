"""The fit where the tests see too little of a cell: a prior, named or chosen, and corrected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import RANGE_V, Notice
from cellwise.cell.simulate import start_hysteresis
from cellwise.cell.stock import stock_model, stock_names
from cellwise.errors import InputError
from cellwise.identify.capacity.half_cycles import discharge_rows
from cellwise.identify.checked_logs import CheckedLogs
from cellwise.identify.identification import (
    Fitted,
    IdentifySettings,
    Start,
    TemperatureResult,
    TestLogs,
)
from cellwise.identify.measured_capacity import MeasuredCapacity
from cellwise.identify.ocv.curve import curve_from_points
from cellwise.identify.prior.corrections import USUAL, Corrections
from cellwise.identify.prior.seen import error_of, notices_of, poor_fit, seen_by
from cellwise.identify.prior.update import PriorLog, update
from cellwise.identify.refinement.model_error import POINTS
from cellwise.identify.soc_anchor import full_before
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

UNKNOWN_STD = 0.5  # of an initial SOC: the OCV and its correction have to find it in the voltages
# Shares of the SOC range below which the rest is no extrapolation, but a guess: by drives, and by a
# test at constant current.
SEEN_ENOUGH, SEEN_LEAST = 0.8, 0.5
# What says next to nothing that the prior does not: fewer rows with a voltage, a smaller share of
# the capacity moved in and out.
FEWEST_ROWS, LEAST_MOVED = 10, 0.005


def needs_prior(tests: TestLogs, settings: IdentifySettings) -> bool:
    """Whether the tests alone would leave the OCV, or where a drive begins on it, to a guess.

    Tests at constant current of which none goes over most of the SOC range; drives alone whose
    initial SOC nobody states, however far they go: a pack off its charger need not have been full.
    A pulse test has rests: its OCV is measured. Steady currents alone show no time constant.
    """
    nominal = settings.nominal_Ah
    if not settings.refine or tests.hppc:
        return False
    if not tests.drive:
        return True
    if nominal is None:
        return False
    laboratory = [*tests.ocv, *tests.capacity]
    if laboratory:
        return _seen_share(laboratory, nominal) < SEEN_LEAST
    begun = [log for log, _ in tests.drive if log.soc0 is not None]
    return not begun or _seen_share(begun, nominal) < SEEN_ENOUGH


def _seen_share(logs: Sequence[CellLog], capacity_Ah: float) -> float:
    """The most that one of the logs moves, as a share of the capacity."""
    return max(float(np.ptp(log.counted_charge_Ah())) for log in logs) / capacity_Ah


def fit_prior(
    checked: CheckedLogs,
    capacity: MeasuredCapacity,
    settings: IdentifySettings,
    say: Callable[[str], None],
) -> Fitted:
    """The prior, scaled to the cell's capacity and corrected as far as the logs determine.

    Returns
    -------
    Fitted        its ``provenance["prior"]`` says which prior, where the data have been and what is
                  the prior's; the model's error is the prior's spread there

    Raises
    ------
    InputError        no prior that fits; a log with hardly a voltage
    """
    tests, silent = _usable(checked.tests, capacity.capacity_Ah)
    notices: list[str] = []
    reached = _reached_V(tests.logs())

    def corrections_of(prior: CellModel) -> Corrections:
        low, high = prior.voltage_min_V, prior.voltage_max_V
        low = float(prior.ocv_V.min()) if low is None else low
        high = float(prior.ocv_V.max()) if high is None else high
        window = np.array([min(low, reached[0]), max(high, reached[1])])
        return Corrections(prior, capacity.capacity_Ah, capacity.ln_std, window)

    def prepared(corrections: Corrections) -> list[PriorLog]:
        return _prepared(tests, corrections.prior)

    prior, chosen_by = settings.prior, "named"
    alternatives: tuple[CellModel, ...] = ()
    unlike: tuple[Notice, ...] = ()
    if prior is None:
        say("prior")
        chosen = choose_prior(tests.logs(), corrections_of, prepared)
        prior, alternatives, chosen_by = chosen.prior, chosen.alternatives, "voltage window and fit"
        notices.append(chosen.notice)
        if alternatives:
            unlike = (Notice(RANGE_V, chosen.notice),)
    name = str(prior.provenance.get("stock", {}).get("name", "")) or prior.name or "given"
    say(f"update of {name}")
    corrections = corrections_of(prior)
    items = prepared(corrections)
    found = update(corrections, items)
    seen = seen_by(items, found)
    error, ocv_std = error_of(items, found, corrections)
    unlike = (*poor_fit(items, found, name), *unlike)
    notices += notices_of(seen, name, prior)
    pairs = zip(items, found.soc0, strict=True)
    starts = [Start(item.log, float(soc0), item.compare) for item, soc0 in pairs]
    for log, why in silent:
        starts.append(Start(log, initial_soc(found.model, log).soc, None, why))
        notices.append(f"'{log.name}' is left out: {why}")
    fitted = found.model.capacity_Ah
    ln_std = corrections.capacity_std * float(np.sqrt(found.covariance[-1, -1]))
    stock = "stock" in prior.provenance  # a model of somebody else's cell
    std_Ah = fitted * float(np.hypot(ln_std, USUAL.ln_capacity if stock else 0.0))
    if alternatives:
        apart_Ah, apart_V = _apart(found.model, alternatives)
        std_Ah, error = float(np.hypot(std_Ah, apart_Ah)), error.with_slow(apart_V, 0.0)
    notices.append(
        f"capacity {fitted:.4g} +- {2 * std_Ah:.2g} Ah, from {capacity.capacity_Ah:.4g} Ah "
        f"({capacity.choice})"
    )
    model = replace(
        found.model,
        chemistry=prior.chemistry,
        error=error,
        voltage_min_V=prior.voltage_min_V,
        voltage_max_V=prior.voltage_max_V,
    )
    warm = model.at_temperature(checked.default_C)
    source = f"prior {name}, updated on its logs"
    curve = curve_from_points(model.soc, warm.ocv_V[0], capacity_Ah=fitted, source=source)
    grid = np.linspace(0.0, 1.0, 21)
    of_prior = {
        "name": name,
        "chosen_by": chosen_by,
        "scaled_from_Ah": prior.capacity_Ah,
        **seen.to_dict(),
        "capacity_std_Ah": std_Ah,
        "ocv_std_V": [float(f"{v:.3g}") for v in np.interp(grid, model.soc, ocv_std)],
    }
    return Fitted(
        model=model,
        ocv=curve,
        starts=tuple(starts),
        temperatures=(TemperatureResult(checked.default_C, (), None),),
        measured_soc=np.empty(0),
        choices_Ah={"updated": fitted},
        provenance={"prior": of_prior},
        contradictions=unlike,
        notices=tuple(notices),
    )


def _reached_V(logs: Sequence[CellLog]) -> FloatArray:
    """Lowest and highest voltage of all logs [V]."""
    low = min(np.nanmin(log.voltage_V) for log in logs)
    return np.array([low, max(np.nanmax(log.voltage_V) for log in logs)])


def _usable(tests: TestLogs, capacity_Ah: float) -> tuple[TestLogs, list[tuple[CellLog, str]]]:
    """The logs that can say anything, and those that are left out, with the reason.

    Raises
    ------
    InputError        none can
    """
    reasons = {id(log): _says_nothing(log, capacity_Ah) for log in tests.logs()}
    silent = [(log, reasons[id(log)]) for log in tests.logs() if reasons[id(log)]]
    if len(silent) == len(reasons):
        raise InputError(
            f"{silent[0][1]} in log '{silent[0][0].name}'",
            f"at least {FEWEST_ROWS} rows, and {LEAST_MOVED:.1%} of the capacity moved",
            "Give a longer log, or check its columns.",
        )

    def kept(log: CellLog) -> bool:
        return not reasons[id(log)]

    usable = TestLogs(
        hppc=tuple(one for one in tests.hppc if kept(one[0])),
        ocv=tuple(filter(kept, tests.ocv)),
        capacity=tuple(filter(kept, tests.capacity)),
        drive=tuple(one for one in tests.drive if kept(one[0])),
    )
    return usable, silent


def _says_nothing(log: CellLog, capacity_Ah: float) -> str:
    """Why a log is no use for a fit; empty for one that is."""
    rows = int(np.count_nonzero(np.isfinite(log.voltage_V)))
    if rows < FEWEST_ROWS:
        return f"{rows} row(s) with a voltage"
    moved = float(np.abs(log.known_current_A()) @ log.interval_s) / 3600.0 / capacity_Ah
    return f"only {moved:.2%} of the capacity moved" if moved < LEAST_MOVED else ""


def _prepared(tests: TestLogs, prior: CellModel) -> list[PriorLog]:
    """The logs with their starts by the prior; of tests that begin full, the discharge."""
    items = [_started(log, prior) for log, _ in (*tests.hppc, *tests.drive)]
    for log in (*tests.ocv, *tests.capacity):
        rows = discharge_rows(log)
        one = _started(log, prior)
        if not rows.any():
            items.append(one)
            continue
        anchor = InitialSoc(one.soc0, one.soc0_std, "")
        full = full_before(log, rows, prior.capacity_Ah, anchor)
        if log.soc0 is None and full is not anchor:
            one = replace(one, soc0=full.soc, soc0_std=full.std, h0=1.0)
        items.append(replace(one, compare=rows))
    return items


def _started(log: CellLog, prior: CellModel) -> PriorLog:
    """A log with its initial SOC by the prior's OCV: never taken for full because it is a test."""
    found = initial_soc(prior, log, whole_log=True)
    if log.soc0 is not None:
        return PriorLog(log, found.soc, found.std, h0=start_hysteresis(found.soc))
    return PriorLog(log, found.soc, UNKNOWN_STD)


class Choice(NamedTuple):
    """When a stock model may be the prior, and when one of several is chosen.

    Parameters
    ----------
    over_V, under_V : float   beyond its window: charging pulses, and the load in the cold
    tail : float              per cent of the rows that may be anywhere
    logs : int                that the choice is made on, those that move most
    undecided : float         in log likelihood: twenty times as probable
    other_soc : float         two priors that see the cell this far apart are no matter of taste
    """

    over_V: float = 0.1
    under_V: float = 0.3
    tail: float = 1.0
    logs: int = 3
    undecided: float = 3.0
    other_soc: float = 0.15


LIMITS = Choice()


@dataclass(frozen=True, eq=False)
class Candidate:
    """A stock model fitted to the logs, and how badly: minus its log probability."""

    name: str
    misfit: float
    soc0: float
    model: CellModel


class Chosen(NamedTuple):
    """The prior, what it was chosen from, and the models of kinds that see the cell elsewhere."""

    prior: CellModel
    notice: str
    alternatives: tuple[CellModel, ...]


def _apart(model: CellModel, alternatives: Sequence[CellModel]) -> tuple[float, FloatArray]:
    """RMS of what alternatives hold and of their OCV, less the model's [Ah], [V] over POINTS."""
    grid, warm = np.linspace(0.0, 1.0, POINTS), float(model.temperature_C[0])
    own = np.interp(grid, model.soc, model.ocv_at(warm))
    away = [np.interp(grid, r.soc, r.ocv_at(warm)) - own for r in alternatives]
    held = [r.capacity_Ah - model.capacity_Ah for r in alternatives]
    return float(np.sqrt(np.mean(np.square(held)))), np.sqrt(np.mean(np.square(away), axis=0))


def in_window(name: str, logs: Sequence[CellLog]) -> bool:
    """Whether a stock model's voltage window holds the logs."""
    model = stock_model(name)
    if model.voltage_min_V is None or model.voltage_max_V is None:
        return False
    lows = [float(np.nanpercentile(log.voltage_V, LIMITS.tail)) for log in logs]
    highs = [float(np.nanpercentile(log.voltage_V, 100.0 - LIMITS.tail)) for log in logs]
    return (
        min(lows) > model.voltage_min_V - LIMITS.under_V
        and max(highs) < model.voltage_max_V + LIMITS.over_V
    )


def choose_prior(
    logs: Sequence[CellLog],
    corrections_of: Callable[[CellModel], Corrections],
    prepared: Callable[[Corrections], Sequence[PriorLog]],
) -> Chosen:
    """The most probable stock model for a cell of which only drives are known, and why.

    Parameters
    ----------
    logs : sequence of CellLog
    corrections_of : callable     the corrections of a prior
    prepared : callable           the logs with their starts by that prior

    Returns
    -------
    Chosen              where several kinds of cell explain the logs as well and see the cell at
                        another SOC, with their models: what they differ by is not known

    Raises
    ------
    InputError        no window holds the logs
    """
    names = [name for name in stock_names() if in_window(name, logs)]
    low = min(float(np.nanmin(log.voltage_V)) for log in logs)
    high = max(float(np.nanmax(log.voltage_V)) for log in logs)
    between = f"voltages from {low:.2f} to {high:.2f} V"
    if not names:
        raise InputError(
            f"{between} that no stock model has, and too little of the SOC range for a model",
            f"a cell like one of {', '.join(stock_names())}",
            "Give `prior=MODEL` of such a cell, or a low-rate or pulse test of it.",
        )
    found = []
    for name in names:
        corrections = corrections_of(stock_model(name))
        items = sorted(
            prepared(corrections), key=lambda i: -float(np.ptp(i.log.counted_charge_Ah()))
        )
        one = update(corrections, items[: LIMITS.logs])
        found.append(Candidate(name, one.misfit, float(one.soc0[0]), one.model))
    found.sort(key=lambda c: c.misfit)
    best = found[0]
    close = [c for c in found[1:] if c.misfit - best.misfit < LIMITS.undecided]
    elsewhere = [c for c in close if abs(c.soc0 - best.soc0) > LIMITS.other_soc]
    said = (
        f"too little was seen for a model of its own: {best.name} is the prior, "
        f"chosen by its voltage window and fit of {', '.join(names)}"
    )
    said += f"; {', '.join(c.name for c in close)} as probable" if close else ""
    if elsewhere:
        texts = ", ".join(f"{c.name} at SOC {c.soc0:.2f}" for c in (best, *elsewhere))
        said = (
            f"{between} that several kinds of cell show alike ({texts}): {best.name} is the prior, "
            "and what they differ by its error"
        )
    models = tuple(c.model for c in elsewhere)
    return Chosen(stock_model(best.name), f"{said}; `prior=NAME` names another", models)
