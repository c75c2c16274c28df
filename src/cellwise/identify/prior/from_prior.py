"""The fit where the tests see too little of a cell: a prior, named or chosen, and corrected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
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
from cellwise.identify.prior.seen import error_of, poor_fit, seen_by
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
    data = _usable(checked.tests, capacity)
    notices: list[str] = []
    prior, chosen_by = settings.prior, "named"
    alternatives: tuple[CellModel, ...] = ()
    unlike: tuple[Notice, ...] = ()
    if prior is None:
        say("prior")
        prior, why, alternatives = choose_prior(data)
        chosen_by = "voltage window and fit"
        notices.append(why)
        unlike = (Notice(RANGE_V, why),) if alternatives else ()
    name = str(prior.provenance.get("stock", {}).get("name", "")) or prior.name or "given"
    say(f"update of {name}")
    corrections = data.corrections(prior)
    items = data.started(corrections.prior)
    found = update(corrections, items)
    seen = seen_by(found)
    error, ocv_std = error_of(found, corrections)
    unlike = (*poor_fit(found, name), *unlike)
    notices += seen.notices(name, prior)
    pairs = zip(items, found.soc0, strict=True)
    starts = [Start(item.log, float(soc0), item.compare) for item, soc0 in pairs]
    for log, left_out in data.silent:
        starts.append(Start(log, initial_soc(found.model, log).soc, None, left_out))
        notices.append(f"'{log.name}' is left out: {left_out}")
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
        ocv=curve_from_points(model.soc, warm.ocv_V[0], capacity_Ah=fitted, source=source),
        starts=tuple(starts),
        temperatures=(TemperatureResult(checked.default_C, (), None),),
        measured_soc=np.empty(0),
        choices_Ah={"updated": fitted},
        provenance={"prior": of_prior},
        contradictions=unlike,
        notices=tuple(notices),
    )


class UsableLogs(NamedTuple):
    """The logs that can say anything, and those that are left out, with the reason.

    Of ``laboratory`` tests, which mostly begin full, the discharge is compared.
    """

    driven: tuple[CellLog, ...]
    laboratory: tuple[CellLog, ...]
    silent: tuple[tuple[CellLog, str], ...]
    capacity: MeasuredCapacity

    def logs(self) -> tuple[CellLog, ...]:
        """All of them."""
        return (*self.driven, *self.laboratory)

    def window_V(self) -> tuple[float, float]:
        """Lowest and highest voltage of all logs [V]."""
        levels = [log.voltage_V for log in (*self.logs(), *(log for log, _ in self.silent))]
        return min(map(np.nanmin, levels)), max(map(np.nanmax, levels))

    def corrections(self, prior: CellModel) -> Corrections:
        """The corrections of a prior; its voltage window holds every log."""
        low, high = self.window_V()
        least = prior.ocv_V.min() if prior.voltage_min_V is None else prior.voltage_min_V
        most = prior.ocv_V.max() if prior.voltage_max_V is None else prior.voltage_max_V
        window = np.array([min(low, least), max(high, most)])
        return Corrections(prior, self.capacity.capacity_Ah, self.capacity.ln_std, window)

    def started(self, prior: CellModel) -> list[PriorLog]:
        """Every log with its initial SOC by the prior's OCV; a test may begin full."""
        items = []
        for log in self.logs():
            found = initial_soc(prior, log, whole_log=True)
            item = PriorLog(log, found.soc, found.std, h0=start_hysteresis(found.soc))
            if log.soc0 is None:
                item = PriorLog(log, found.soc, UNKNOWN_STD)
            rows = discharge_rows(log)
            if log in self.laboratory and rows.any():
                anchor = InitialSoc(item.soc0, item.soc0_std, "")
                full = full_before(log, rows, prior.capacity_Ah, anchor)
                if log.soc0 is None and full is not anchor:
                    item = PriorLog(log, full.soc, full.std, h0=1.0)
                item = replace(item, compare=rows)
            items.append(item)
        return items


def _usable(tests: TestLogs, capacity: MeasuredCapacity) -> UsableLogs:
    """The logs of the tests, those that say nothing apart.

    Raises
    ------
    InputError        none says anything
    """
    reasons = {id(log): _says_nothing(log, capacity.capacity_Ah) for log in tests.logs()}
    silent = tuple((log, reasons[id(log)]) for log in tests.logs() if reasons[id(log)])
    if len(silent) == len(reasons):
        raise InputError(
            f"{silent[0][1]} in log '{silent[0][0].name}'",
            f"at least {FEWEST_ROWS} rows, and {LEAST_MOVED:.1%} of the capacity moved",
            "Give a longer log, or check its columns.",
        )
    driven = [log for log, _ in (*tests.hppc, *tests.drive) if not reasons[id(log)]]
    laboratory = [log for log in (*tests.ocv, *tests.capacity) if not reasons[id(log)]]
    return UsableLogs(tuple(driven), tuple(laboratory), silent, capacity)


def _says_nothing(log: CellLog, capacity_Ah: float) -> str:
    """Why a log is no use for a fit; empty for one that is."""
    rows = int(np.count_nonzero(np.isfinite(log.voltage_V)))
    if rows < FEWEST_ROWS:
        return f"{rows} row(s) with a voltage"
    moved = float(np.abs(log.known_current_A()) @ log.interval_s) / 3600.0 / capacity_Ah
    return f"only {moved:.2%} of the capacity moved" if moved < LEAST_MOVED else ""


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


def choose_prior(data: UsableLogs) -> tuple[CellModel, str, tuple[CellModel, ...]]:
    """The most probable stock model for a cell of which only drives are known, and why.

    Returns
    -------
    prior, notice, alternatives : where several kinds of cell explain the logs as well and see the
                                  cell at another SOC, their models: what they differ by is not
                                  known

    Raises
    ------
    InputError        no window holds the logs
    """
    names = [name for name in stock_names() if in_window(name, data.logs())]
    low, high = data.window_V()
    between = f"voltages from {low:.2f} to {high:.2f} V"
    if not names:
        raise InputError(
            f"{between} that no stock model has, and too little of the SOC range for a model",
            f"a cell like one of {', '.join(stock_names())}",
            "Give `prior=MODEL` of such a cell, or a low-rate or pulse test of it.",
        )
    updates = {}
    for name in names:
        corrections = data.corrections(stock_model(name))
        items = data.started(corrections.prior)
        items.sort(key=lambda i: -float(np.ptp(i.log.counted_charge_Ah())))
        updates[name] = update(corrections, items[: LIMITS.logs])
    best, *others = sorted(updates, key=lambda name: updates[name].misfit)
    worst = updates[best].misfit + LIMITS.undecided
    close = [name for name in others if updates[name].misfit < worst]
    began = {name: float(found.soc0[0]) for name, found in updates.items()}
    elsewhere = [name for name in close if abs(began[name] - began[best]) > LIMITS.other_soc]
    said = (
        f"too little was seen for a model of its own: {best} is the prior, "
        f"chosen by its voltage window and fit of {', '.join(names)}"
    )
    said += f"; {', '.join(close)} as probable" if close else ""
    if elsewhere:
        texts = ", ".join(f"{name} at SOC {began[name]:.2f}" for name in (best, *elsewhere))
        said = (
            f"{between} that several kinds of cell show alike ({texts}): {best} is the prior, "
            "and what they differ by its error"
        )
    models = tuple(updates[name].model for name in elsewhere)
    return stock_model(best), f"{said}; `prior=NAME` names another", models
