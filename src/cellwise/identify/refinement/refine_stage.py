"""The refinement of a cell: which logs, from where, over which temperatures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import start_hysteresis
from cellwise.errors import InputError
from cellwise.identify.assemble import refined_model
from cellwise.identify.capacity.half_cycles import discharge_rows
from cellwise.identify.identification import IdentifySettings, PulseSet, TestLogs
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.refinement.effects import (
    QUICK_ITERATIONS,
    QUICK_ROWS,
    Decided,
    Decision,
    decide,
)
from cellwise.identify.refinement.held_out import held_out_residuals, residual_log
from cellwise.identify.refinement.left_out import activation_std_K
from cellwise.identify.refinement.model_error import estimate_model_error
from cellwise.identify.refinement.refine import (
    RefineResult,
    RefineSettings,
    StartTables,
    refine,
)
from cellwise.identify.refinement.refine_data import RefineLog, inverse_K
from cellwise.identify.refinement.splines import TABLE_KNOTS, greville, spline_rows, spline_values
from cellwise.identify.refinement.sustained import unseen_shares
from cellwise.identify.soc_anchor import SocAnchor, anchor_soc
from cellwise.identify.tables import PulseTables
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

SLOW_FROM_S = 1800.0  # a log must be this long to show the slow branch
HYSTERESIS_FROM_V = 0.004  # half gap between the low-rate branches, polarisation taken out
# Tests at constant current cannot separate hysteresis from OCV and resistance: there the low-rate
# branches count, whose polarisation is known to about a third.
M_SHARE, LEAST_M_STD_V = 0.33, 0.003
LARGEST_SOC_ERROR = 0.05
LARGEST_OCV_MOVE_V = 0.03
OUTSIDE_SOC = 0.1
REFERENCE_C = 25.0
USUAL_ACTIVATION_K = 3000.0
BALANCE = 1.5
SMOOTH_OF_SEVERAL = 0.003  # their logs are fitted worse, and what holds scales with that
REST_MOVES = 0.01  # of the capacity: what a test may move before its discharge begins
LIKELY_FULL = 0.8
FULL_STD = 0.01
# Pulses alone leave a few rests to set against hundreds of rows of a low-rate test, whose SOC
# suffers most from a current sensor that is off: hours of a small current.
LIGHT = 0.8
DEEP = 0.3  # of the capacity: what a drive must move to show every SOC under load and at rest
LEAST_INSIDE = 0.5  # of a test's discharge, else it began elsewhere
# Of the capacity: scripts that finish a charge or discharge with small steps show no OCV, and begin
# near an end where a per cent of SOC is many millivolts.
LEAST_DISCHARGE = 0.1
# What a discharge says of slow resistances grows when it is carried to colder tables, and
# activations of cells differ by 2,000 K and more: a quarter over 10 K. The other way it shrinks.
FAR_K = 10.0


class Start(NamedTuple):
    """A log, the SOC at which it begins, and the rows that were compared (None: all)."""

    log: CellLog
    soc0: float
    rows: BoolArray | None = None


@dataclass(frozen=True, eq=False)
class Refined:
    """The refined model, its refinement, and what was taken and decided on the way.

    ``starts`` holds the SOC at which each log was taken to begin and the rows that were compared
    (None: all), ``decided`` which effects the cell needs and which it does not.
    """

    model: CellModel
    result: RefineResult
    starts: tuple[Start, ...]
    decided: tuple[Decided, ...] = ()


@dataclass(frozen=True, eq=False)
class Group:
    """The tests of one temperature and what their pulses gave."""

    temperature_C: float
    tests: TestLogs
    pulse_sets: tuple[PulseSet, ...]
    tables: PulseTables | None


def refine_cell(
    groups: Sequence[Group],
    ocv: OcvCurve,
    capacity_Ah: float,
    settings: IdentifySettings,
    notices: list[str],
) -> Refined:
    """Refine the tables of all temperatures on every log whose SOC is known.

    Low-rate and capacity tests take part with their discharge: it is what the SOC scale and the OCV
    near empty are known from.

    Raises
    ------
    InputError        no log whose SOC is known well enough
    """
    tests = [g.tests for g in groups]
    grid = np.array([g.temperature_C for g in groups])
    found = next((g.tables for g in groups if g.tables is not None), None)
    resistance = _rough_resistance(found, tests)
    anchors = {id(s.log): s.anchor for g in groups for s in g.pulse_sets}
    driven = any(_is_deep(log, capacity_Ah) for g in groups for log, _ in g.tests.drive)
    light = {id(log) for g in groups for log in g.tests.ocv}
    logs: list[RefineLog] = []
    starts: list[Start] = []
    for g in groups:
        for log, drive, part in _candidates(g, driven, capacity_Ah, grid, notices):
            anchor = anchors.get(id(log)) or anchor_soc(log, ocv, capacity_Ah, resistance)
            if part is not None and log.soc0 is None and part.any():
                anchor = _full_before(log, part, capacity_Ah, anchor)
            if anchor.std > LARGEST_SOC_ERROR:
                notices.append(
                    f"'{log.name}' left out of the refinement: its SOC at the start is known to "
                    f"+-{100 * anchor.std:.0f} % only"
                )
                continue
            soc = anchor.soc - log.counted_charge_Ah() / capacity_Ah
            inside = (soc >= 0.0) & np.isfinite(log.voltage_V)
            if part is not None and np.mean(inside[part]) < LEAST_INSIDE:
                notices.append(
                    f"'{log.name}' left out of the refinement: its discharge would begin at SOC "
                    f"{float(soc[np.argmax(part)]):.2f}"
                )
                continue
            notices.append(f"'{log.name}' begins at SOC {anchor.soc:.3f} ({anchor.how})")
            _note_outside(log, soc, capacity_Ah, notices)
            starts.append(Start(log, anchor.soc, part))
            logs.append(
                RefineLog(
                    log,
                    soc,
                    skewed=drive,
                    h0=start_hysteresis(anchor.soc),
                    compare=part,
                    weight=LIGHT if id(log) in light else 1.0,
                    temperature_C=g.temperature_C,
                )
            )
    if all(item.compare is not None for item in logs):
        raise InputError(
            "no log whose SOC at the start is known",
            "a log with a rest where the OCV is steep, or one that begins full",
            "Let the cell rest before the test, or log the charge before it.",
        )
    start, hysteresis = _start(groups, ocv, resistance, capacity_Ah, settings, driven)
    long = any(item.log.duration_s >= SLOW_FROM_S for item in logs)
    several = len(groups) > 1
    plain = RefineSettings(
        branches=settings.branches if long else 2,
        hysteresis=hysteresis,
        activation_std_K=settings.activation_std_K,
        skew=any(item.skewed for item in logs),
        balance=BALANCE if several else 0.0,
        smooth=SMOOTH_OF_SEVERAL if several else RefineSettings.smooth,
    )
    reference = float(grid[int(np.argmin(np.abs(grid - REFERENCE_C)))])
    decision = decide(logs, start, plain, capacity_Ah, reference, grid)
    result = decision.result
    loads = [item for item in decision.logs if item.compare is None]
    alone = result
    if not several and len(loads) < len(logs):
        # Low-rate tests hold the OCV; what the loads alone say of it must not differ.
        quick = replace(decision.settings, iterations=QUICK_ITERATIONS)
        alone = refine(loads, start, settings=quick, capacity_Ah=capacity_Ah,
                       reference_C=reference, theta=result.theta, most_rows=QUICK_ROWS,
                       with_errors=False)  # fmt: skip
    _note_moved_ocv(alone, notices)
    hot = any(item.log.temperature_C is not None for item in logs)
    model = refined_model(result, start, capacity_Ah, plain.skew, hot)
    for effect in decision.effects:
        model = model.with_effect(effect)
    error = replace(
        _error(decision, start, model, starts, plain.skew, hot),
        activation_std_K=activation_std_K(decision, start, model, capacity_Ah, grid),
    )
    model = replace(model, error=error)
    return Refined(model, result, tuple(starts), decision.decided)


def _candidates(
    group: Group, driven: bool, capacity_Ah: float, grid_C: FloatArray, notices: list[str]
) -> list[tuple[CellLog, bool, BoolArray | None]]:
    """Logs of a temperature, whether their current may lag, and the rows to compare (None: all).

    Where no drive goes deep, the charges and rests of capacity tests are the only ones there are.
    Beside pulses a capacity test much warmer than the tables is left out.
    """
    found: list[tuple[CellLog, bool, BoolArray | None]] = []
    found += [(log, False, None) for log, _ in group.tests.hppc]
    found += [(log, True, None) for log, _ in group.tests.drive]
    for log in group.tests.ocv:
        part = discharge_rows(log)
        if not part.any():
            continue
        share = _discharged_Ah(log, part) / capacity_Ah
        if share >= LEAST_DISCHARGE:
            found.append((log, False, part))
        else:
            notices.append(
                f"'{log.name}' left out of the refinement: its discharge moves "
                f"{100 * share:.1f} % of the capacity"
            )
    for log in group.tests.capacity:
        began_C = _began_C(log)
        pulses = bool(group.tests.hppc)
        if pulses and began_C is not None and began_C > float(np.max(grid_C)) + FAR_K:
            notices.append(
                f"'{log.name}' left out of the refinement: it began at {began_C:.0f} degC, the "
                f"warmest pulses are of {np.max(grid_C):.0f} degC"
            )
            continue
        part = discharge_rows(log) if driven else np.ones(len(log), dtype=np.bool_)
        found.append((log, False, part))
    return found


def _began_C(log: CellLog) -> float | None:
    """Temperature at which a log began, if it was measured: its own load warms a cell."""
    warm = log.temperature_C
    known = np.empty(0) if warm is None else warm[np.isfinite(warm)]
    return float(known[0]) if known.size else None


def _discharged_Ah(log: CellLog, part: BoolArray) -> float:
    """What flows out of the cell in some rows [Ah]."""
    out_Ah = np.diff(log.counted_charge_Ah(), prepend=0.0)
    return float(np.sum(np.maximum(out_Ah[part], 0.0)))


def _is_deep(log: CellLog, capacity_Ah: float) -> bool:
    return float(np.ptp(log.counted_charge_Ah())) >= DEEP * capacity_Ah


def _full_before(log: CellLog, part: BoolArray, capacity_Ah: float, anchor: SocAnchor) -> SocAnchor:
    """The start of a test that begins full: what SOC means is that its discharge begins at 1."""
    first = int(np.argmax(part & discharge_rows(log)))
    before = float(log.counted_charge_Ah()[first]) / capacity_Ah
    if abs(before) > REST_MOVES or anchor.soc < LIKELY_FULL:
        return anchor
    return SocAnchor(1.0, min(anchor.std, FULL_STD), "a test of the capacity: full")


def _note_outside(log: CellLog, soc: FloatArray, capacity_Ah: float, notices: list[str]) -> None:
    low, high = float(np.nanmin(soc)), float(np.nanmax(soc))
    if low < -OUTSIDE_SOC or high > 1.0 + OUTSIDE_SOC:
        notices.append(
            f"'{log.name}' would run from SOC {low:.2f} to {high:.2f}: check the capacity of "
            f"{capacity_Ah:.4g} Ah and the unit of the current"
        )


def _note_moved_ocv(result: RefineResult, notices: list[str]) -> None:
    """Note where the logs contradict the OCV they were given: mostly a wrong initial SOC."""
    seen = np.concatenate([p.soc[p.evaluate] for p in result.logs])
    soc = np.linspace(max(seen.min(), 0.1), min(seen.max(), 0.9), 81)
    rows = spline_rows(soc, result.ocv_knots)
    moved = spline_values(rows, result.theta[: result.layout.knots_ocv])
    size = float(np.sqrt(np.mean(moved**2)))
    if size > LARGEST_OCV_MOVE_V:
        notices.append(
            f"the logs under load would have the OCV moved by {1e3 * size:.0f} mV RMS: check at "
            "which SOC they begin, and whether OCV and logs are of one cell and temperature"
        )


def _rough_resistance(tables: PulseTables | None, tests: Sequence[TestLogs]) -> float:
    """R0 + R1 of the pulses, else the steepest answer of voltage to current in a drive."""
    if tables is not None:
        return float(np.median(tables.values["r0_ohm"] + tables.values["r1_ohm"]))
    slopes = []
    loads = [log for t in tests for log, _ in t.drive]
    for log in loads or [log for t in tests for log in t.capacity]:
        di, dv = np.diff(log.known_current_A()), np.diff(log.voltage_V)
        strong = (np.abs(di) > 0.2 * np.max(np.abs(di))) & np.isfinite(dv)
        if strong.any():
            slopes.append(-float(np.sum(dv[strong] * di[strong]) / np.sum(di[strong] ** 2)))
    return max(float(np.median(slopes)), 1e-5) if slopes else 1e-3


def _start(
    groups: Sequence[Group],
    ocv: OcvCurve,
    resistance: float,
    capacity_Ah: float,
    settings: IdentifySettings,
    driven: bool,
) -> tuple[StartTables, bool]:
    """Start of the refinement: the pulses' tables, or one rough resistance shared out.

    A temperature without pulses takes those of the nearest one that has some, carried over with a
    usual activation energy.
    """
    at = greville(TABLE_KNOTS)
    known = [g for g in groups if g.tables is not None]

    def on_knots(name: str, otherwise: float) -> FloatArray:
        rows = []
        for g in groups:
            source = min(known, key=lambda k: abs(k.temperature_C - g.temperature_C), default=None)
            if source is None or source.tables is None:
                home, row = REFERENCE_C, np.full(at.size, otherwise)
            else:
                table = np.log(source.tables.values[name])
                home, row = source.temperature_C, np.exp(np.interp(at, source.tables.soc, table))
            usual = 0.0 if name.startswith("tau") else USUAL_ACTIVATION_K
            if source is None and len(groups) == 1:
                usual = 0.0  # the resistance is that of this temperature
            rows.append(row * np.exp(usual * inverse_K(g.temperature_C, home)))
        return np.array(rows)

    r0 = on_knots("r0_ohm", resistance)
    r2 = on_knots("r2_ohm", 0.5 * resistance)
    tau2 = np.clip(on_knots("tau2_s", 60.0), 5.0, 600.0)
    tau1 = np.minimum(on_knots("tau1_s", 3.0), 0.4 * tau2)
    half = half_gap(ocv, resistance, capacity_Ah)
    wanted = settings.hysteresis
    if wanted is None:
        wanted = half is not None and float(np.median(half)) > HYSTERESIS_FROM_V
    m = m_std = None
    if wanted and half is None:
        m = np.full(at.size, 0.005)
    elif wanted and half is not None:
        m = np.interp(at, ocv.soc, half)
        if not driven and not known:
            m_std = np.maximum(M_SHARE * m, LEAST_M_STD_V)
    start = StartTables(
        ocv=ocv.function.evaluate,
        r0_ohm=r0,
        r_ohm=(on_knots("r1_ohm", 0.4 * resistance), r2, 0.5 * resistance * r0 / np.median(r0)),
        tau_s=(tau1, tau2, np.maximum(1200.0, 4.0 * tau2)),
        m_V=m,
        m_std_V=m_std,
    )
    return start, wanted


def half_gap(ocv: OcvCurve, resistance: float, capacity_Ah: float) -> FloatArray | None:
    """Half the gap between the low-rate branches with polarisation taken out [V], shape of soc.

    None without two whole branches. The current of a low-rate test is taken as C/20 at most, its
    resistance as three times the short-time one.
    """
    gap = ocv.gap_V
    middle = (ocv.soc > 0.05) & (ocv.soc < 0.95)
    if gap is None or not np.all(np.isfinite(gap[middle])):
        return None  # an incomplete charge branch says nothing of hysteresis
    known = np.isfinite(gap)
    filled = np.interp(ocv.soc, ocv.soc[known], gap[known])
    polarisation = 3.0 * resistance * capacity_Ah / 20.0
    return np.clip(0.5 * filled - polarisation, 0.0, 0.2)


def _error(
    decision: Decision,
    start: StartTables,
    model: CellModel,
    starts: Sequence[Start],
    skewed: bool,
    hot: bool,
) -> ModelError:
    """What a filter under load must expect: loads that a fit has left out, low-rate tests do not.

    But where no load has been at a SOC, tests at constant current are all there is to go by.
    """
    soc0 = [s.soc0 for s in starts]
    held = held_out_residuals(decision, start, soc0, model.capacity_Ah, skewed, hot)
    others = [
        residual_log(model, item, first)
        for item, first in zip(decision.logs, soc0, strict=True)
        if item.compare is not None
    ]
    return estimate_model_error(held, others, unseen_shares(model, [s.log for s in starts]))
