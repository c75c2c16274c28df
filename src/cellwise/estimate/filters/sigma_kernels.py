"""The moments of the unscented filter: sigma points of the whole state, few look-ups.

State x = [soc, v1, v2, v3, h], scaled sigma points (Julier; van der Merwe's scaling) along the
columns of the lower Cholesky factor of P with the SOC first. Only the first column has a component
along the SOC, and at one SOC the model is affine in all else. So every pair of points but the
first goes through the same affine map, and its share of the transform is known without taking it:
the covariance given the SOC, mapped. Three points remain, the centre and the pair along the first
column [P_ss, P_s1, ...] / sqrt(P_ss); the result is that of all eleven, to rounding.

Points are drawn again between predict and update.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES, CELL, SOC
from cellwise.cell.equations import CellState, CellTables, loaded, rc_step, terminal_voltage
from cellwise.cell.point_kernels import CellPoint
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.equations.constants import VARIANCE_FLOOR
from cellwise.estimate.equations.covariance import Column, column_of, explained
from cellwise.estimate.evidence_kernels import StepConstants
from cellwise.estimate.filters.covariance_kernels import (
    Covariance,
    decayed,
    with_outer,
    with_soc_row,
    without_outer,
)
from cellwise.estimate.filters.predict_kernels import (
    PredictedInterval,
    drifted,
    variance_after_gap,
    with_noise,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import CheckedReading
from cellwise.estimate.slopes_kernels import VoltageSlopes, tangent


class SigmaScalars(NamedTuple):
    """Scaled sigma points as the kernels see them.

    ``distance`` is c = sqrt(n + lambda), in standard deviations; ``side`` the
    weight of one outer point, 1 / (2 c^2); ``curve`` what the square of a second difference adds to
    a covariance. While the SOC's variance is below ``wide_variance`` every point has the
    resistances of the centre.
    """

    distance: float
    side: float
    curve: float
    wide_variance: float


class PredictedVoltage(NamedTuple):
    """The voltage's moments over the state: mean, covariance with every state, variance.

    ``slope_V`` is the OCV's over the SOC's band.
    """

    voltage_V: float
    column: Column
    explained_V2: float
    slope_V: float


@inline
@unrolled
def along_soc(p: Covariance, ss: float) -> tuple[float, Column]:
    """SOC's deviation and the first column of the factor; a SOC known exactly keeps some."""
    root = math.sqrt(max(ss, VARIANCE_FLOOR))
    return root, Column(ss / root, *(p[SOC, i] / root for i in CELL[1:]))


@inline
@unrolled
def by_points(
    constant: StepConstants,
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars,
    reading: CheckedReading,
    interval: PredictedInterval,
    p: Covariance,
    no_voltage_s: float,
) -> tuple[CellState, Covariance, VoltageSlopes]:
    """Mean and covariance at the end: first and second differences along the pair, the rest mapped.

    The slopes are those of the centre; their ``spread`` is above zero where the points have their
    own tables.
    """
    t, c = interval.t, sigma.distance
    old: ByState = interval.old
    point: ByState = interval.point
    ss = variance_after_gap(tables, noise, reading, p.ss)
    root, along = along_soc(p, ss)
    # A resistance that is off by a share must not vouch for the SOC: unless the SOC is badly known,
    # every point has the centre's.
    wide = ss > sigma.wide_variance
    up: ByState = point
    low: ByState = point
    if wide:
        up = loaded(
            tables,
            interval.end.soc + c * root,
            interval.effective_temperature_C,
            reading.delayed_current_A,
            interval.end.slow_A,
        )
        low = loaded(
            tables,
            interval.end.soc - c * root,
            interval.effective_temperature_C,
            reading.delayed_current_A,
            interval.end.slow_A,
        )
    x: ByState = interval.end
    per = 0.5 / c
    above: dict[Any, float] = {}
    below: dict[Any, float] = {}
    e: dict[Any, float] = {}
    v: dict[Any, float] = {}
    for i in BRANCHES:
        above[i] = old.state[i] + c * along.row[i]
        below[i] = old.state[i] - c * along.row[i]
        if point.r[i] != 0.0:
            above[i] = rc_step(
                above[i], reading.counted_current_A, up.r[i], up.tau[i], reading.dt_s
            )
            below[i] = rc_step(
                below[i], reading.counted_current_A, low.r[i], low.tau[i], reading.dt_s
            )
        e[i] = (above[i] + below[i]) - 2.0 * x.state[i]
        v[i] = x.state[i] + sigma.side * e[i]
    d = Column(0.0, *((above[i] - below[i]) * per for i in BRANCHES), t.ah * along.h)  # type: ignore[call-arg]
    p = decayed(without_outer(p, along), t)
    p = with_outer(p, d, sigma.curve, Column(0.0, *(e[i] for i in BRANCHES), 0.0))  # type: ignore[call-arg]
    p = with_soc_row(p, drifted(tables, reading, ss), d, root)
    p = with_noise(p, constant, noise, reading, interval, no_voltage_s, tables.cell.charge_As)
    x = CellState(x.soc, *(v[i] for i in BRANCHES), x.h, x.heat_K, x.slow_A)
    return x, p, tangent(point.ocv_slope_V, root if wide else 0.0)


@inline
@unrolled
def voltage_by_points(
    tables: CellTables,
    sigma: SigmaScalars,
    reading: CheckedReading,
    point: CellPoint,
    slopes: VoltageSlopes,
    effective_temperature_C: float,
    x: ByState,
    p: Covariance,
) -> PredictedVoltage:
    """Of the centre and of the pair, drawn again from the prediction."""
    c = sigma.distance
    root, along = along_soc(p, p.ss)
    branches = sum(x.state[i] for i in BRANCHES)
    away = c * sum(along.row[i] for i in BRANCHES)
    up = loaded(
        tables, x.soc + c * root, effective_temperature_C, reading.delayed_current_A, x.slow_A
    )
    low = loaded(
        tables, x.soc - c * root, effective_temperature_C, reading.delayed_current_A, x.slow_A
    )
    r_up = up.r0_ohm if slopes.spread > 0.0 else point.r0_ohm
    r_low = low.r0_ohm if slopes.spread > 0.0 else point.r0_ohm
    centre = terminal_voltage(point, x.h, point.r0_ohm * reading.delayed_current_A + branches)
    above = terminal_voltage(
        up, x.h + c * along.h, r_up * reading.delayed_current_A + branches + away
    )
    below = terminal_voltage(
        low, x.h - c * along.h, r_low * reading.delayed_current_A + branches - away
    )
    first, second = (above - below) * (0.5 / c), (above + below) - 2.0 * centre
    slope_V = ((up.ocv_V - low.ocv_V) - (r_up - r_low) * reading.delayed_current_A) / (
        2.0 * c * root
    )
    # Covariance with the voltage: along the pair, and given the SOC.
    rest = column_of(without_outer(p, along), 0.0, point.m_V)
    column = Column(root * first, *(rest.row[i] + along.row[i] * first for i in CELL[1:]))
    known = explained(Column(0.0, *(rest.row[i] for i in CELL[1:])), 0.0, point.m_V)
    explained_V2 = known + first * first + sigma.curve * second * second
    return PredictedVoltage(centre + sigma.side * second, column, explained_V2, slope_V)
