"""Laboratory tests in, CellModel out: capacity, OCV, pulses, tables, refinement."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import pairwise
from typing import Any

import numpy as np

from cellwise.cell.metrics import error_metrics
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import Notice, in_order
from cellwise.errors import InputError
from cellwise.identify.assemble import GRID_POINTS, plain_model, table_summary
from cellwise.identify.by_temperature import (
    grouped_by_temperature,
    low_rate_tests,
    nearest_test,
    without_offsets,
)
from cellwise.identify.capacity.capacity_choice import capacity_choices, choose_capacity
from cellwise.identify.capacity.capacity_test import CapacityTest, measure_capacities
from cellwise.identify.capacity.hppc_capacity import whole_hppc_Ah
from cellwise.identify.contradictions import (
    capacity_notices,
    check_possible,
    check_serves,
    contradictions,
    own_log_notices,
    reading_notices,
    rest_notices,
)
from cellwise.identify.hppc.pulses import Pulse, find_pulses, pulses_to_fit
from cellwise.identify.identification import (
    REFERENCE_C,
    Identification,
    IdentifySettings,
    PulseSet,
    TemperatureResult,
    TestLogs,
    log_temperature_C,
)
from cellwise.identify.ocv.curve import OcvCurve, combine_ocv, curve_from_points
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.identify.ocv.sample_check import sample_notice
from cellwise.identify.own_logs import simulate_back
from cellwise.identify.prior.from_prior import identify_from_prior, needs_prior
from cellwise.identify.pulse_fit.fit_pulse import fit_pulses
from cellwise.identify.pulse_fit.pulse_window import (
    cut_pulses,
    has_enough_rows,
    slow_rows_notice,
)
from cellwise.identify.refinement.refine_stage import Group, Refined, Start, refine_cell
from cellwise.identify.soc_anchor import anchor_soc
from cellwise.identify.stack import stack_models
from cellwise.identify.tables import pulse_tables
from cellwise.identify.validity import identified_validity
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.sign import verify_sign
from cellwise.threads import one_blas_thread

Progress = Callable[[str], None]
FAR_FROM_NOMINAL = 2.5  # an aged cell keeps a third, a wrong unit is a thousand
LARGEST_PULSE = 1.0 / 3.0  # of the capacity: a discharge beyond it has no parameters of one SOC


@one_blas_thread
def identify_cell(
    tests: TestLogs, settings: IdentifySettings | None = None, progress: Progress | None = None
) -> Identification:
    """Identify a cell from its laboratory tests.

    Parameters
    ----------
    tests : TestLogs          at least one HPPC or drive log
    settings : IdentifySettings or None
    progress : callable or None       called with what is being done

    Returns
    -------
    Identification

    Raises
    ------
    InputError        no usable log; a log whose current has the wrong sign or unit; no pulse and
                      no drive; no open-circuit voltage; an unknown capacity choice
    """
    began = time.perf_counter()
    settings = IdentifySettings() if settings is None else settings
    say = progress or (lambda _: None)
    _check(tests, settings)
    if settings.prior is not None or needs_prior(tests, settings):
        return identify_from_prior(tests, settings, progress)
    default = REFERENCE_C if settings.temperature_C is None else settings.temperature_C
    found_wrong = contradictions(tests, default, settings.nominal_Ah)
    tests, notices = without_offsets(tests, settings.nominal_Ah, default)
    say("capacity")
    caps, choice, capacity, measured = _capacity(tests, settings, notices)
    found_wrong += capacity_notices(tests, capacity, choice, settings.nominal_Ah)
    say("OCV")
    low_rate = nearest_test(low_rate_tests(tests.ocv, default), default)
    ocv, unlike = _ocv(replace(tests, ocv=low_rate), capacity, notices)
    found_wrong += rest_notices(tests, ocv, capacity)
    say("pulses")
    groups = [
        _group(temperature, part, ocv, capacity, settings)
        for temperature, part in grouped_by_temperature(tests, settings).items()
    ]
    slow_rows = (slow_rows_notice(p.log, p.fitted) for g in groups for p in g.pulse_sets)
    notices.extend(notice for notice in slow_rows if notice)
    refined = None
    if settings.refine:
        say("refinement")
        refined = refine_cell(groups, ocv, capacity, settings, notices)
        model = refined.model
    else:
        model = stack_models([_plain(g, ocv, capacity) for g in groups])
    found = [
        TemperatureResult(
            g.temperature_C,
            g.pulse_sets,
            None if refined is None else refined.result.at(g.temperature_C),
        )
        for g in groups
    ]
    model = replace(
        model,
        name=settings.name,
        chemistry=settings.chemistry,
        voltage_min_V=_limit(tests, measured, low=True),
        voltage_max_V=_limit(tests, measured, low=False),
    )
    check_possible(model, found_wrong)
    say("validation on its own logs")
    own = simulate_back(model, tests, ocv, _starts(groups, refined))
    used = [o for o in own if o.used]
    contradictory = in_order([*found_wrong, *unlike])
    notices = [
        *contradictory,
        *in_order(
            own_log_notices(model, tests, tuple(o.simulation for o in used)),
            (*notices, *reading_notices(tests)),
        ),
    ]
    notices += [f"'{o.simulation.log.name}': {o.reason}" for o in own if o.used and o.reason]
    fit = error_metrics(np.concatenate([o.compared_V for o in used]))
    check_serves(fit.rmse_V, found_wrong)
    seconds = time.perf_counter() - began
    model = replace(
        model,
        validity=identified_validity(tests, used, ocv, settings.temperature_C),
        provenance=_provenance(tests, settings, choice, caps, ocv, found, seconds),
    )
    return Identification(
        model=model,
        capacity_choice=choice,
        capacities=caps,
        capacity_tests=measured,
        ocv=ocv,
        temperatures=tuple(found),
        own_logs=own,
        decided=() if refined is None else refined.decided,
        fit=fit,
        notices=tuple(dict.fromkeys(notices)),
        seconds=seconds,
        contradictions=contradictory,
    )


def _group(
    temperature_C: float, part: TestLogs, ocv: OcvCurve, capacity: float, settings: IdentifySettings
) -> Group:
    """The pulses of one temperature and their tables."""
    sets = tuple(_pulse_set(log, ocv, capacity, settings) for log, _ in part.hppc)
    fits = [f for s in sets for f in s.fits]
    if part.hppc and not fits and not part.drive:
        raise InputError(
            _counts([(s.log, s.pulses) for s in sets])[0],
            "a healthy pulse after a rest that moves less than a third of the charge",
            "Give an HPPC log whose pulses stay within the voltage limits, or a drive.",
        )
    tables = pulse_tables(fits, GRID_POINTS, settings.tables) if fits else None
    return Group(temperature_C, part, sets, tables)


def _plain(group: Group, ocv: OcvCurve, capacity: float) -> CellModel:
    """A model of the pulses' tables as they are."""
    if group.tables is None:
        raise InputError(
            f"no pulse at {group.temperature_C:g} degC without refinement",
            "an HPPC log with pulses, or refinement",
            "Leave out `refine=False`.",
        )
    return plain_model(group.tables, ocv, capacity, group.temperature_C)


def _check(tests: TestLogs, settings: IdentifySettings) -> None:
    """Refuse what no later step could make sense of."""
    any_serves = settings.prior is not None and (tests.ocv or tests.capacity)
    if not tests.hppc and not tests.drive and not any_serves:
        raise InputError(
            "neither an HPPC nor a drive log",
            "at least one of them",
            "Give `hppc=LOG` or `drive=LOG`.",
        )
    nominal = settings.nominal_Ah
    if nominal is not None and not (np.isfinite(nominal) and nominal > 0.0):
        raise InputError(
            f"a nominal capacity of {nominal:g} Ah", "a number above zero", "Give it in Ah."
        )
    logs = [log for log, _ in (*tests.hppc, *tests.drive)]
    for log in (*logs, *tests.ocv, *tests.capacity):
        found = verify_sign(log)
        if found.verdict == "contradicted":
            raise InputError(
                f"log '{log.name}' whose voltage rises with its discharge current "
                f"({'; '.join(found.evidence[:2])})",
                "positive current on discharge",
                "Give `sign='charge-positive'`, or swap the sign in the file.",
            )


def _capacity(
    tests: TestLogs, settings: IdentifySettings, notices: list[str]
) -> tuple[dict[str, float], str, float, tuple[CapacityTest, ...]]:
    """Every capacity choice, the one taken, and the tests behind them."""
    sources: list[CellLog | tuple[CellLog, ...]] = list(tests.capacity)
    default = REFERENCE_C if settings.temperature_C is None else settings.temperature_C
    # Low-rate logs may be parts of one test: discharge, its last per cent, charge.
    sources[:0] = low_rate_tests(tests.ocv, default)
    measured: tuple[CapacityTest, ...] = ()
    if sources:
        try:
            measured = measure_capacities(sources, nominal_Ah=settings.nominal_Ah)
        except InputError as error:
            if settings.nominal_Ah is None and not tests.hppc:
                raise
            notices.append(f"no capacity test found: {error}")
    total = whole_hppc_Ah([log for log, _ in tests.hppc], settings.nominal_Ah, notices)
    usable: tuple[CapacityTest, ...] = measured
    if measured and not any(t.complete for t in measured):
        notices.append("no capacity test reached the lower limit: none is used")
        usable = ()
    if not usable and total is None and settings.nominal_Ah is None:
        raise InputError(
            "drive logs without a capacity",
            "a capacity test, an HPPC log over the whole range, or a nominal capacity",
            "Add `capacity=LOG`, `hppc=LOG` or `nominal_Ah=X`.",
        )
    notices.extend(f"capacity test {t.left_out}" for t in usable if not t.complete)
    choices = capacity_choices(usable, settings.nominal_Ah, total, temperature_C=default)
    choice, capacity = choose_capacity(choices, settings.capacity_choice)
    nominal = settings.nominal_Ah
    if nominal is not None and not 1.0 / FAR_FROM_NOMINAL < capacity / nominal < FAR_FROM_NOMINAL:
        raise InputError(
            f"a capacity of {capacity:.4g} Ah ({choice}) for a cell of {nominal:g} Ah nominal",
            f"a capacity within a factor of {FAR_FROM_NOMINAL:g} of the nominal one",
            "Check the unit of the current (mA for A?) and `nominal_Ah=...`, or leave that out.",
        )
    return choices, choice, capacity, measured


def _ocv(
    tests: TestLogs, capacity: float, notices: list[str]
) -> tuple[OcvCurve, tuple[Notice, ...]]:
    """OCV from low-rate logs, rests of HPPC logs, or both, and a notice where these differ."""
    low_rate = None
    if tests.ocv:
        low_rate = ocv_from_low_rate(
            tests.ocv if len(tests.ocv) > 1 else tests.ocv[0], capacity_Ah=capacity
        )
        notices.extend(low_rate.notes)
    rests = None
    # The log nearest to the reference temperature: a cold one relaxes too slowly for an OCV.
    order = sorted(
        tests.hppc, key=lambda item: abs(log_temperature_C(item[0], item[1]) - REFERENCE_C)
    )
    for log, _ in order[:1]:
        try:
            rests = ocv_from_rests(
                log, capacity_Ah=capacity, anchor="auto", soc_start=log.soc0, extrapolate=True
            )
        except InputError as error:
            notices.append(f"no OCV from the rests of '{log.name}': {error}")
    if low_rate is not None and rests is not None and rests.points_soc.size >= 4:
        unlike = sample_notice(rests, low_rate, capacity)
        return combine_ocv(rests, low_rate), () if unlike is None else (unlike,)
    if low_rate is not None:
        return low_rate, ()
    if rests is not None:
        notices.extend(rests.notes)
        return rests, ()
    if tests.capacity:
        slowest = ocv_from_low_rate(tests.capacity, capacity_Ah=capacity)
        notices.append("OCV taken from the slowest capacity test: it carries its polarisation")
        return slowest, ()
    if not tests.drive:
        counts, healthy = _counts([(log, find_pulses(log)) for log, _ in tests.hppc])
        raise InputError(
            f"{counts}, and no open-circuit voltage ({notices[-1].partition('; expected')[0]})",
            "a low-rate test beside it" if healthy else "at least one healthy pulse after a rest",
            "Add `ocv=LOG` (a C/20 discharge), or give an HPPC log with rests at several SOC.",
        )
    return _ocv_from_drives(tests, capacity, notices), ()


def _ocv_from_drives(tests: TestLogs, capacity: float, notices: list[str]) -> OcvCurve:
    """A first OCV out of drives that begin full: the median voltage at each SOC."""
    log = max((log for log, _ in tests.drive), key=lambda x: float(np.ptp(x.counted_charge_Ah())))
    soc = (1.0 if log.soc0 is None else log.soc0) - log.counted_charge_Ah() / capacity
    edges = np.linspace(max(float(np.nanmin(soc)), 0.0), 1.0, 31)
    points, level = [], []
    for low, high in pairwise(edges):
        inside = (soc >= low) & (soc < high) & np.isfinite(log.voltage_V)
        if np.count_nonzero(inside) >= 3:
            points.append(float(np.mean(soc[inside])))
            level.append(float(np.percentile(log.voltage_V[inside], 75)))
    if len(points) < 4:
        raise InputError(
            "no OCV test, no rest and too little charge moved",
            "a low-rate discharge or an HPPC log with rests",
            "Add `ocv=LOG` or `hppc=LOG`.",
        )
    begun = "begun full" if log.soc0 is None else f"begun at SOC {log.soc0:g}"
    notices.append(f"no OCV test: first OCV from the voltages of drive '{log.name}', {begun}")
    return curve_from_points(
        np.array(points), np.array(level), capacity_Ah=capacity, source=f"drive {log.name}"
    )


def _pulse_set(
    log: CellLog, ocv: OcvCurve, capacity: float, settings: IdentifySettings
) -> PulseSet:
    pulses = find_pulses(log)
    anchor = anchor_soc(log, ocv, capacity, 0.0)
    soc = anchor.soc - log.counted_charge_Ah() / capacity
    chosen = tuple(
        p
        for p in pulses_to_fit(pulses)
        if -0.02 <= soc[p.start] <= 1.02
        and abs(p.charge_Ah) <= LARGEST_PULSE * capacity
        and has_enough_rows(log, p)
    )
    if not chosen:
        return PulseSet(log, anchor, pulses, (), ())
    fits = fit_pulses(
        cut_pulses(log, chosen, capacity, soc, step_ocv=ocv.function.evaluate), settings.method
    )
    return PulseSet(log, anchor, pulses, chosen, tuple(fits))


def _counts(found: Sequence[tuple[CellLog, Sequence[Pulse]]]) -> tuple[str, int]:
    """The pulses of each log by quality, as text, and how many are healthy."""
    values, healthy = [], 0
    for log, pulses in found:
        counts: dict[str, int] = {}
        for p in pulses:
            counts[p.quality] = counts.get(p.quality, 0) + 1
        listed = ", ".join(f"{n} {quality}" for quality, n in counts.items())
        values.append(f"{listed + ' pulse(s)' if listed else 'no pulse at all'} in '{log.name}'")
        healthy += counts.get("healthy", 0)
    return "; ".join(values), healthy


def _limit(tests: TestLogs, measured: tuple[CapacityTest, ...], *, low: bool) -> float | None:
    """The voltage window that the laboratory tests kept to."""
    logs = [*tests.capacity, *tests.ocv, *(log for log, _ in tests.hppc)]
    if not logs:
        return None
    if low:
        return round(float(min(np.nanmin(log.voltage_V) for log in logs)), 2)
    return round(float(max(np.nanmax(log.voltage_V) for log in logs)), 2)


def _starts(groups: Sequence[Group], refined: Refined | None) -> tuple[Start, ...]:
    """The logs that the model was made of, and where they begin."""
    if refined is not None:
        return refined.starts
    return tuple(Start(p.log, p.anchor.soc) for g in groups for p in g.pulse_sets)


def _provenance(
    tests: TestLogs,
    settings: IdentifySettings,
    choice: str,
    caps: dict[str, float],
    ocv: OcvCurve,
    found: list[TemperatureResult],
    seconds: float,
) -> dict[str, Any]:
    """Where every number came from."""
    return {
        "cellwise_version": version("cellwise"),
        "capacity": {"choice": choice, "choices_Ah": caps},
        "ocv": {"source": ocv.source, "notes": list(ocv.notes), "function": ocv.function.kind},
        "pulses": {
            "method": settings.method,
            "tables": settings.tables,
            "logs": [log.name for log, _ in tests.hppc],
            "fitted": sum(len(s.fits) for t in found for s in t.pulse_sets),
        },
        "refinement": [
            {"temperature_C": t.temperature_C, **table_summary(t.refinement)}
            for t in found
            if t.refinement is not None
        ],
        "logs": tests.sources(),
        "seconds": round(seconds, 3),
    }
