"""The refinement of one temperature: which logs, from where, with which effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.cell.model import CellModel, ModelError
from cellwise.cell.simulate import start_hysteresis
from cellwise.errors import InputError
from cellwise.identify.assemble import refined_effects, refined_tables
from cellwise.identify.identification import IdentifySettings, PulseSet, TestLogs
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.refinement.model_error import ResidualLog, estimate_model_error
from cellwise.identify.refinement.refine import RefineResult, RefineSettings, StartTables, refine
from cellwise.identify.refinement.refine_data import RefineLog
from cellwise.identify.refinement.splines import TABLE_KNOTS, greville, spline_rows, spline_values
from cellwise.identify.soc_anchor import anchor_soc
from cellwise.identify.tables import PulseTables
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

SLOW_FROM_S = 1800.0  # a log must be this long to show the slow branch
HYSTERESIS_FROM_V = 0.004  # half gap between the low-rate branches, polarisation taken out
LARGEST_SOC_ERROR = 0.05
LARGEST_OCV_MOVE_V = 0.03
OUTSIDE_SOC = 0.1


@dataclass(frozen=True, eq=False)
class Refined:
    """The model of one temperature, its refinement, and the SOC each log was taken to begin at."""

    model: CellModel
    result: RefineResult
    starts: tuple[tuple[CellLog, float], ...]


def refine_temperature(
    tests: TestLogs,
    pulse_sets: tuple[PulseSet, ...],
    ocv: OcvCurve,
    tables: PulseTables | None,
    capacity_Ah: float,
    temperature_C: float,
    settings: IdentifySettings,
    notices: list[str],
) -> Refined:
    """Refine the tables on the HPPC logs and drives of one temperature.

    Without a drive the capacity tests join in: they are the only long loads there are.

    Raises
    ------
    InputError        no log whose SOC is known well enough
    """
    resistance = _rough_resistance(tables, tests)
    anchors = {id(s.log): s.anchor for s in pulse_sets}
    logs: list[RefineLog] = []
    starts: list[tuple[CellLog, float]] = []
    candidates = [(log, False) for log, _ in tests.hppc] + [(log, True) for log, _ in tests.drive]
    if not tests.drive:
        candidates += [(log, False) for log in tests.capacity]
    for log, drive in candidates:
        anchor = anchors.get(id(log))
        if anchor is None:
            anchor = anchor_soc(log, ocv, capacity_Ah, resistance)
        if anchor.std > LARGEST_SOC_ERROR:
            notices.append(
                f"'{log.name}' left out of the refinement: its SOC at the start is known to "
                f"+-{100 * anchor.std:.0f} % only"
            )
            continue
        soc = anchor.soc - log.counted_charge_Ah() / capacity_Ah
        notices.append(f"'{log.name}' begins at SOC {anchor.soc:.3f} ({anchor.how})")
        low, high = float(np.nanmin(soc)), float(np.nanmax(soc))
        if low < -OUTSIDE_SOC or high > 1.0 + OUTSIDE_SOC:
            notices.append(
                f"'{log.name}' would run from SOC {low:.2f} to {high:.2f}: check the capacity of "
                f"{capacity_Ah:.4g} Ah and the unit of the current"
            )
        starts.append((log, anchor.soc))
        logs.append(RefineLog(log, soc, skewed=drive, h0=start_hysteresis(anchor.soc)))
    if not logs:
        raise InputError(
            "no log whose SOC at the start is known",
            "a log with a rest where the OCV is steep, or one that begins full",
            "Let the cell rest before the test, or log the charge before it.",
        )
    start, hysteresis = _start(tables, ocv, resistance, capacity_Ah, settings)
    long = any(item.log.duration_s >= SLOW_FROM_S for item in logs)
    result = refine(
        logs,
        start,
        settings=RefineSettings(
            branches=settings.branches if long else 2,
            hysteresis=hysteresis,
            activation_std_K=settings.activation_std_K,
            skew=bool(tests.drive),
        ),
        capacity_Ah=capacity_Ah,
        reference_C=temperature_C,
    )
    hot = any(item.log.temperature_C is not None for item in logs)
    values = refined_tables(result, start)
    _note_moved_ocv(result, notices)
    model = CellModel(
        capacity_Ah,
        *values,
        temperature_C=np.array([temperature_C]),
        effects=refined_effects(result, bool(tests.drive), hot),
        error=_error(result, float(np.median(values.r0_ohm))),
    )
    return Refined(model, result, tuple(starts))


def _note_moved_ocv(result: RefineResult, notices: list[str]) -> None:
    """Note where the logs contradict the OCV they were given: mostly a wrong initial SOC."""
    seen = np.concatenate([p.soc[p.evaluate] for p in result.logs])
    soc = np.linspace(max(seen.min(), 0.1), min(seen.max(), 0.9), 81)
    rows = spline_rows(soc, result.ocv_knots)
    moved = spline_values(rows, result.theta[: result.layout.knots_ocv])
    size = float(np.sqrt(np.mean(moved**2)))
    if size > LARGEST_OCV_MOVE_V:
        notices.append(
            f"the refinement moved the OCV by {1e3 * size:.0f} mV RMS: check at which SOC the logs "
            "begin, and whether OCV and logs are of one cell and temperature"
        )


def _rough_resistance(tables: PulseTables | None, tests: TestLogs) -> float:
    """R0 + R1 of the pulses, else the steepest answer of voltage to current in a drive."""
    if tables is not None:
        return float(np.median(tables.values["r0_ohm"] + tables.values["r1_ohm"]))
    slopes = []
    for log, _ in tests.drive:
        di, dv = np.diff(log.known_current_A()), np.diff(log.voltage_V)
        strong = (np.abs(di) > 0.2 * np.max(np.abs(di))) & np.isfinite(dv)
        if strong.any():
            slopes.append(-float(np.sum(dv[strong] * di[strong]) / np.sum(di[strong] ** 2)))
    return max(float(np.median(slopes)), 1e-5) if slopes else 1e-3


def _start(
    tables: PulseTables | None,
    ocv: OcvCurve,
    resistance: float,
    capacity_Ah: float,
    settings: IdentifySettings,
) -> tuple[StartTables, bool]:
    """Start of the refinement: the pulses' tables, or one rough resistance shared out."""
    at = greville(TABLE_KNOTS)

    def on_knots(name: str, otherwise: float) -> FloatArray:
        if tables is None:
            return np.full(at.size, otherwise)
        return np.asarray(np.exp(np.interp(at, tables.soc, np.log(tables.values[name]))))

    r2 = on_knots("r2_ohm", 0.5 * resistance)
    tau2 = np.clip(on_knots("tau2_s", 60.0), 5.0, 600.0)
    tau1 = np.minimum(on_knots("tau1_s", 3.0), 0.4 * tau2)
    start = StartTables(
        ocv=ocv.function.evaluate,
        r0_ohm=on_knots("r0_ohm", resistance),
        r_ohm=(on_knots("r1_ohm", 0.4 * resistance), r2, np.full(at.size, 0.5 * resistance)),
        tau_s=(tau1, tau2, np.maximum(1200.0, 4.0 * tau2)),
        m_V=None,
    )
    half = half_gap(ocv, resistance, capacity_Ah)
    wanted = settings.hysteresis
    if wanted is None:
        wanted = half is not None and float(np.median(half)) > HYSTERESIS_FROM_V
    if wanted and half is not None:
        start = StartTables(
            start.ocv, start.r0_ohm, start.r_ohm, start.tau_s, np.interp(at, ocv.soc, half), 50.0
        )
    elif wanted:
        start = StartTables(
            start.ocv, start.r0_ohm, start.r_ohm, start.tau_s, np.full(at.size, 0.005), 50.0
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


def _error(result: RefineResult, r0_ohm: float) -> ModelError:
    logs = [
        ResidualLog(p.time_s, p.soc[p.evaluate], p.current_A[p.evaluate], r)
        for p, r in zip(result.logs, result.residual_V, strict=True)
    ]
    return estimate_model_error(logs, r0_ohm)
