"""Identification that starts at a prior: one flight, thirty drives, a capacity test alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import version

import numpy as np

from cellwise.cell.initial_soc.best_start import best_start_soc
from cellwise.cell.initial_soc.initial_soc import STATED_STD, initial_soc
from cellwise.cell.metrics import error_metrics
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import in_order
from cellwise.cell.plausibility.validity import Validity
from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import capacity_choices, choose_capacity
from cellwise.identify.capacity.capacity_test import CapacityTest, measure_capacities
from cellwise.identify.capacity.half_cycles import discharge_rows
from cellwise.identify.contradictions import (
    check_possible,
    check_serves,
    contradictions,
    own_log_notices,
    reading_notices,
)
from cellwise.identify.identification import (
    REFERENCE_C,
    Identification,
    IdentifySettings,
    OwnLog,
    TemperatureResult,
    TestLogs,
)
from cellwise.identify.ocv.curve import curve_from_points
from cellwise.identify.own_logs import simulate_back
from cellwise.identify.prior.choice import choose_prior
from cellwise.identify.prior.corrections import Corrections
from cellwise.identify.prior.seen import error_of, notices_of, seen_by
from cellwise.identify.prior.update import PriorLog, update_from
from cellwise.identify.refinement.refine_stage import Start
from cellwise.identify.validity import joined, log_validity
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

# Standard deviations of ln(capacity): of a cell in use whose rated capacity is known, and measured
# at a rate whose share of the whole the prior's resistances have to say.
NOMINAL_STD = 0.1
MEASURED_STD = 0.02
CHOSEN_STD = 0.01  # where the nominal capacity was chosen by name
FULL_STD = 0.01  # of a capacity test: SOC 1 is where its discharge begins
LIKELY_FULL = 0.8
STARTS = 51  # initial SOCs that are tried before the fit
MOST_MOVED = 1.5  # of the capacity
UNKNOWN_STD = 0.5  # of an initial SOC: the OCV and its correction have to find it in the voltages
WIDE_WINDOW_V = 0.1
# Shares of the SOC range below which the rest is no extrapolation, but a guess.
SEEN_ENOUGH = 0.8  # by drives
SEEN_LEAST = 0.5  # by a test at constant current
FEWEST_ROWS = 30  # with a voltage: fewer say next to nothing that the prior does not


def needs_prior(tests: TestLogs, settings: IdentifySettings) -> bool:
    """Whether the tests alone would leave the OCV, or where a drive begins on it, to a guess.

    Tests at constant current of which none goes over most of the SOC range; drives alone whose
    initial SOC nobody states, however far they go: a pack off its charger need not have been full.
    A pulse test has rests: its OCV is measured.
    """
    nominal = settings.nominal_Ah
    if nominal is None or not settings.refine or tests.hppc:
        return False
    laboratory = [*tests.ocv, *tests.capacity]
    if laboratory:
        return _seen_share(laboratory, nominal) < SEEN_LEAST
    begun = [log for log, _ in tests.drive if log.soc0 is not None]
    return not begun or _seen_share(begun, nominal) < SEEN_ENOUGH


def _seen_share(logs: Sequence[CellLog], capacity_Ah: float) -> float:
    """The most that one of the logs moves, as a share of the capacity."""
    return max(float(np.ptp(log.counted_charge_Ah())) for log in logs) / capacity_Ah


def identify_from_prior(
    tests: TestLogs,
    settings: IdentifySettings,
    progress: Callable[[str], None] | None = None,
) -> Identification:
    """The prior, scaled to the cell's capacity and corrected as far as the logs determine.

    Parameters
    ----------
    tests : TestLogs          at least one log of any kind
    settings : IdentifySettings      ``prior`` None: the most probable stock model

    Returns
    -------
    Identification        its model's ``provenance["prior"]`` says which prior, where the data have
                          been and what is the prior's; its ``error`` is the prior's spread there

    Raises
    ------
    InputError        no log; no capacity; no prior that fits; contradictory logs
    """
    began = time.perf_counter()
    say = progress or (lambda _: None)
    default = REFERENCE_C if settings.temperature_C is None else settings.temperature_C
    # Without the capacity: the highest and lowest voltages of short drives are not full and empty.
    found_wrong = contradictions(tests, default)
    notices: list[str] = []
    caps, choice, capacity, std, measured = _capacity(tests, settings, default, notices)
    logs = _logs(tests)
    _check_charge(logs, capacity, choice)
    reached = _reached_V(logs)

    def corrections_of(prior: CellModel) -> Corrections:
        window = np.array([min(_low(prior), reached[0]), max(_high(prior), reached[1])])
        return Corrections(prior, capacity, std, window)

    def prepared(corrections: Corrections) -> list[PriorLog]:
        return _prepared(tests, corrections.prior, _by_whole_log)

    prior, chosen_by = settings.prior, "named"
    if prior is None:
        say("prior")
        prior, notice = choose_prior(logs, corrections_of, prepared)
        chosen_by = "voltage window and fit"
        notices.append(notice)
    name = str(prior.provenance.get("stock", {}).get("name", "")) or prior.name or "given"
    say(f"update of {name}")
    corrections = corrections_of(prior)
    items = prepared(corrections)
    found = update_from(corrections, [items, _prepared(tests, corrections.prior, _by_first_minute)])
    seen = seen_by(items, found)
    error, ocv_std = error_of(items, found, corrections)
    notices += notices_of(seen, name, prior)
    for item, soc0, deviation in zip(items, found.soc0, found.soc0_std, strict=True):
        how = "stated" if item.log.soc0 is not None else f"by the OCV of {name}"
        notices.append(f"'{item.log.name}' begins at SOC {soc0:.3f} +- {deviation:.3f} ({how})")
    deviation = corrections.capacity_std * float(np.sqrt(found.covariance[-1, -1]))
    fitted = found.model.capacity_Ah
    caps = {**caps, "updated": fitted}
    notices.append(
        f"capacity {fitted:.4g} +- {deviation * fitted:.2g} Ah, from {capacity:.4g} Ah ({choice})"
    )
    model = replace(
        found.model,
        name=settings.name,
        chemistry=settings.chemistry or prior.chemistry,
        error=error,
        voltage_min_V=prior.voltage_min_V,
        voltage_max_V=prior.voltage_max_V,
    )
    check_possible(model, found_wrong)
    say("validation on its own logs")
    curve = curve_from_points(
        model.soc,
        model.at_temperature(default).ocv_V[0],
        capacity_Ah=fitted,
        source=f"prior {name}, updated on its logs",
    )
    starts = [
        Start(item.log, float(soc0), item.compare)
        for item, soc0 in zip(items, found.soc0, strict=True)
    ]
    own = simulate_back(model, tests, curve, starts)
    model = replace(model, validity=joined(_covered(o) for o in own))
    sims = tuple(o.simulation for o in own)
    fit = error_metrics(np.concatenate([o.compared_V for o in own]))
    contradictory = in_order(found_wrong)
    notices = [
        *contradictory,
        *in_order(own_log_notices(model, tests, sims), (*notices, *reading_notices(tests))),
    ]
    check_serves(fit.rmse_V, found_wrong)
    seconds = time.perf_counter() - began
    provenance = {
        "cellwise_version": version("cellwise"),
        "prior": {
            "name": name,
            "chosen_by": chosen_by,
            "scaled_from_Ah": prior.capacity_Ah,
            **seen.to_dict(),
            "capacity_std_Ah": deviation * fitted,
            "ocv_std_V": [float(f"{v:.3g}") for v in np.interp(
                np.linspace(0.0, 1.0, 21), model.soc, ocv_std)],
        },
        "capacity": {"choice": choice, "choices_Ah": caps},
        "logs": tests.sources(),
        "seconds": round(seconds, 3),
    }  # fmt: skip
    return Identification(
        model=replace(model, provenance=provenance),
        capacity_choice=choice,
        capacities=caps,
        capacity_tests=measured,
        ocv=curve,
        temperatures=(TemperatureResult(default, (), None),),
        own_logs=own,
        decided=(),
        fit=fit,
        notices=tuple(dict.fromkeys(notices)),
        seconds=seconds,
        contradictions=contradictory,
    )


def _covered(own: OwnLog) -> Validity:
    """What one log covered with the rows that were compared: of the prior's data nothing."""
    log, soc = own.simulation.log, own.simulation.soc
    if own.compared is None:
        return log_validity(log, soc)
    return log_validity(log.rows(own.compared), soc[own.compared])


def _capacity(
    tests: TestLogs, settings: IdentifySettings, default_C: float, notices: list[str]
) -> tuple[dict[str, float], str, float, float, tuple[CapacityTest, ...]]:
    """Capacity choices, the one taken, the capacity and its deviation (of ln), the tests."""
    measured: tuple[CapacityTest, ...] = ()
    sources: list[CellLog | tuple[CellLog, ...]] = [*tests.capacity]
    if tests.ocv:
        sources.insert(0, tests.ocv if len(tests.ocv) > 1 else tests.ocv[0])
    if sources:
        try:
            measured = measure_capacities(sources, nominal_Ah=settings.nominal_Ah)
        except InputError as error:
            notices.append(f"no capacity test found: {error}")
    whole = tuple(t for t in measured if t.complete)
    if not whole and settings.nominal_Ah is None:
        raise InputError(
            "a prior, and nothing that says how large the cell is",
            "a complete capacity test or a nominal capacity",
            "Add `nominal_Ah=X` or `capacity=LOG`.",
        )
    choices = capacity_choices(whole, settings.nominal_Ah, None, temperature_C=default_C)
    choice, capacity = choose_capacity(choices, settings.capacity_choice)
    std = MEASURED_STD if choice != "nominal" else NOMINAL_STD
    if settings.capacity_choice == "nominal":
        std = CHOSEN_STD
    return choices, choice, capacity, std, measured


def _check_charge(logs: Sequence[CellLog], capacity_Ah: float, choice: str) -> None:
    """Refuse a log that moves more than a cell of that capacity holds.

    That one moves little from its highest to its lowest voltage says nothing: they are those of a
    part of the SOC range.
    """
    for log in logs:
        moved = float(np.ptp(log.counted_charge_Ah()))
        if moved > MOST_MOVED * capacity_Ah:
            raise InputError(
                f"'{log.name}' that moves {moved:.4g} Ah in a cell of {capacity_Ah:.4g} Ah "
                f"({choice})",
                "no more than the cell holds",
                "Check the unit of the current (mA for A?), `parallel=N`, and `nominal_Ah=X`.",
            )


def _logs(tests: TestLogs) -> list[CellLog]:
    return [*(log for log, _ in (*tests.hppc, *tests.drive)), *tests.ocv, *tests.capacity]


def _reached_V(logs: Sequence[CellLog]) -> FloatArray:
    """Lowest and highest voltage of all logs [V]."""
    return np.array(
        [
            min(np.nanmin(log.voltage_V) for log in logs),
            max(np.nanmax(log.voltage_V) for log in logs),
        ]
    )


def _low(prior: CellModel) -> float:
    return float(prior.ocv_V.min()) if prior.voltage_min_V is None else prior.voltage_min_V


def _high(prior: CellModel) -> float:
    return float(prior.ocv_V.max()) if prior.voltage_max_V is None else prior.voltage_max_V


def _prepared(
    tests: TestLogs, prior: CellModel, guess: Callable[[CellModel, CellLog], float]
) -> list[PriorLog]:
    """The logs with their starts by the prior; of tests that begin full, the discharge."""
    items = [_started(log, prior, guess) for log, _ in (*tests.hppc, *tests.drive)]
    for log in (*tests.ocv, *tests.capacity):
        rows = discharge_rows(log)
        one = _started(log, prior, guess)
        if not rows.any():
            items.append(one)
            continue
        if log.soc0 is None and one.soc0 >= LIKELY_FULL:
            before = float(log.counted_charge_Ah()[int(np.argmax(rows))]) / prior.capacity_Ah
            one = replace(one, soc0=min(1.0 + before, 1.0), soc0_std=FULL_STD, h0_std=0.0)
        items.append(replace(one, compare=rows))
    return items


def _started(
    log: CellLog, prior: CellModel, guess: Callable[[CellModel, CellLog], float]
) -> PriorLog:
    """A log with its initial SOC by the prior's OCV: never taken for full because it is a test."""
    known = int(np.count_nonzero(np.isfinite(log.voltage_V)))
    if known < FEWEST_ROWS:
        raise InputError(
            f"{known} row(s) with a voltage in log '{log.name}'",
            f"at least {FEWEST_ROWS}",
            "Give a longer log, or check the column.",
        )
    if log.soc0 is not None:
        return PriorLog(log, log.soc0, STATED_STD)
    return PriorLog(log, guess(prior, log), UNKNOWN_STD, h0_std=1.0)


def _by_whole_log(prior: CellModel, log: CellLog) -> float:
    """On a plateau the first minute says nothing, the whole log may."""
    return best_start_soc(prior, log, np.linspace(0.0, 1.0, STARTS))[0]


def _by_first_minute(prior: CellModel, log: CellLog) -> float:
    """Where the OCV is steep the first minute is what least else can disturb."""
    return initial_soc(prior, log, likeliest=True).soc
