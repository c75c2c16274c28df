"""Where the joint fit begins: the pulses' tables, or one rough resistance shared out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.identify.fitted_pulses import Group
from cellwise.identify.identification import REFERENCE_C
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.refinement.problem import StartTables
from cellwise.identify.refinement.refine_data import inverse_K
from cellwise.identify.refinement.splines import TABLE_KNOTS, greville
from cellwise.typing import FloatArray

HYSTERESIS_FROM_V = 0.004  # half gap between the low-rate branches, polarisation taken out
USUAL_ACTIVATION_K = 3000.0  # of the resistances of lithium-ion cells, 2000 to 5000


def rough_resistance(groups: Sequence[Group]) -> float:
    """R0 + R1 of the pulses, else the steepest answer of voltage to current in a load [ohm]."""
    tables = next((g.tables for g in groups if g.tables is not None), None)
    if tables is not None:
        return float(np.median(tables.values["r0_ohm"] + tables.values["r1_ohm"]))
    slopes = []
    loads = [log for g in groups for log, _ in g.tests.drive]
    for log in loads or [log for g in groups for log in g.tests.capacity]:
        di, dv = np.diff(log.known_current_A()), np.diff(log.voltage_V)
        strong = (np.abs(di) > 0.2 * np.max(np.abs(di))) & np.isfinite(dv)
        if strong.any():
            slopes.append(-float(np.sum(dv[strong] * di[strong]) / np.sum(di[strong] ** 2)))
    return max(float(np.median(slopes)), 1e-5) if slopes else 1e-3


def start_tables(
    groups: Sequence[Group],
    ocv: OcvCurve,
    resistance_ohm: float,
    capacity_Ah: float,
    hysteresis: bool | None,
) -> tuple[StartTables, bool]:
    """Tables at the knots of every temperature, and whether hysteresis is fitted.

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

    r = resistance_ohm
    r0, r2 = on_knots("r0_ohm", r), on_knots("r2_ohm", 0.5 * r)
    tau2 = np.clip(on_knots("tau2_s", 60.0), 5.0, 600.0)
    tau1 = np.minimum(on_knots("tau1_s", 3.0), 0.4 * tau2)
    half = half_gap(ocv, r, capacity_Ah)
    if hysteresis is None:
        hysteresis = half is not None and float(np.median(half)) > HYSTERESIS_FROM_V
    m = np.full(at.size, 0.005) if half is None else np.interp(at, ocv.soc, half)
    start = StartTables(
        ocv=ocv.function.evaluate,
        r0_ohm=r0,
        r_ohm=(on_knots("r1_ohm", 0.4 * r), r2, 0.5 * r * r0 / np.median(r0)),
        tau_s=(tau1, tau2, np.maximum(1200.0, 4.0 * tau2)),
        m_V=m if hysteresis else None,
    )
    return start, hysteresis


def half_gap(ocv: OcvCurve, resistance_ohm: float, capacity_Ah: float) -> FloatArray | None:
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
    polarisation = 3.0 * resistance_ohm * capacity_Ah / 20.0
    return np.clip(0.5 * filled - polarisation, 0.0, 0.2)
