"""A load held over a horizon on the cell's own equations: where it leads, how sure that is."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, part
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    charge_transfer,
    held_in_branches,
    loaded,
    loaded_voltage,
    polarisation,
)
from cellwise.cell.plausibility.validity_kernels import (
    extrapolation_V,
    soc_extrapolation_V,
    widened,
)
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.evidence_kernels import step_constants, variance_about
from cellwise.estimate.noise import NoiseScalars

# Intervals of a horizon: within one the current is constant, and SOC's tables are looked up.
STEPS = 5
# A resistance that follows the current is found by repetition.
REPETITIONS = 2
# What the model has been off by over the longest usual horizon is taken to stay over the next.
BIAS_S = 30.0


class CorrectionCovariance(NamedTuple):
    """Covariance of the three numbers of a correction: common, falling, tail."""

    cc: float
    cf: float
    ct: float
    ff: float
    ft: float
    tt: float


class Correction(NamedTuple):
    """What a cell is seen to differ by from its model.

    R0 I + V1 counts 1 + ``common`` + ``falling`` f times, where f falls with the current from 1 on,
    V2 counts 1 + ``tail`` times. ``bias_V`` is measured less modelled voltage of late, a mean over
    ``seen_s`` of voltages, which is taken to stay over the horizon.
    """

    common: float
    falling: float
    tail: float
    bias_V: float
    seen_s: float
    spread: CorrectionCovariance


# Of each number beforehand: resistances differ by a fifth from cell to cell and over a life.
FACTOR_VARIANCE = 0.2**2
UNSEEN = CorrectionCovariance(FACTOR_VARIANCE, 0.0, 0.0, FACTOR_VARIANCE, 0.0, FACTOR_VARIANCE)
AS_MODEL = Correction(0.0, 0.0, 0.0, 0.0, 0.0, UNSEEN)
LEAST_FACTOR, MOST_FACTOR = 0.2, 5.0


class OperatingPoint(NamedTuple):
    """What is known of a cell now.

    ``soc_variance`` is that of the SOC with what a persistent model error may have brought into it.
    """

    cell: CellState
    soc_variance: float
    temperature_C: float
    but: Correction


class LoadPoint(NamedTuple):
    """A load at one instant: tables, current, terminal voltage, what the current takes off."""

    point: CellPoint
    current_A: float
    voltage_V: float
    polarisation_V: float
    possible: bool


class LoadedState(NamedTuple):
    """A load after a horizon; ``lowest_V`` and ``highest_V`` from its first moment on."""

    end: CellState
    now: LoadPoint
    lowest_V: float
    highest_V: float
    largest_A: float


@inline
def falling_share(cell: CellScalars, current_A: float) -> float:
    """How a resistance falls with the current: as asinh of the C-rate over the C-rate."""
    return charge_transfer(current_A * 3600.0 / cell.charge_As)


@inline
def within(more: float) -> float:
    """A factor on a resistance that is so much more than 1."""
    return min(max(1.0 + more, LEAST_FACTOR), MOST_FACTOR)


@inline
def fast_factor(cell: CellScalars, but: Correction, current_A: float) -> float:
    """Factor on R0 I + V1 at one current."""
    return within(but.common + but.falling * falling_share(cell, current_A))


@inline
def variance_along(
    s: CorrectionCovariance, common_V: float, falling_V: float, tail_V: float
) -> float:
    """Variance of the drop that a correction makes, by what each of its numbers counts [V^2]."""
    common = s.cc * common_V + (2.0 * s.cf * falling_V + 2.0 * s.ct * tail_V)
    falling = s.ff * falling_V + 2.0 * s.ft * tail_V
    return common_V * common + (falling_V * falling + tail_V * (s.tt * tail_V))


@inline
def correction_variance(
    cell: CellScalars, but: Correction, point: CellPoint, x: CellState, current_A: float
) -> float:
    """By how much a correction may make the voltage worse: 0 as long as nothing has been seen.

    What is still not known of it, but no more than what it was moved by.
    """
    fast_V = point.r0_ohm * current_A + x.v1_V
    fallen_V = fast_V * falling_share(cell, current_A)
    left = variance_along(but.spread, fast_V, fallen_V, x.v2_V)
    moved = variance_along(UNSEEN, fast_V, fallen_V, x.v2_V) - left
    return max(min(left, moved), 0.0)


@inline
@unrolled
def corrected_polarisation(
    point: CellPoint, x: ByState, current_A: float, factor: float, but: Correction
) -> float:
    """What the current takes off the OCV, with the factors [V]."""
    fast_V = polarisation(point.r0_ohm, current_A, x.v1_V, 0.0)
    slower_V: float = within(but.tail) * x.v2_V + sum(x.state[i] for i in BRANCHES[2:])
    return factor * fast_V + slower_V


@part
def moment_of(
    tables: CellTables,
    x: CellState,
    load: float,
    power: bool,
    effective_temperature_C: float,
    but: Correction,
) -> LoadPoint:
    r"""A state under a load, at once: a current, or a power.

    .. math:: v = \tfrac12 \left( E + \sqrt{E^2 - 4 R_0 P} \right), \quad I = P / v

    With E the voltage without the ohmic drop; of the two currents of a power P the smaller one.
    """
    current = load
    possible = True
    point = loaded(tables, x.soc, effective_temperature_C, current, x.slow_A)
    if power:
        current = load / point.ocv_V
        for _ in range(REPETITIONS):
            point = loaded(tables, x.soc, effective_temperature_C, current, x.slow_A)
            factor = fast_factor(tables.cell, but, current)
            polarisation_V = corrected_polarisation(point, x, 0.0, factor, but)
            inner = loaded_voltage(point.ocv_V, point.m_V, x.h, polarisation_V) + but.bias_V
            square = inner * inner - 4.0 * factor * point.r0_ohm * load
            possible = square >= 0.0 and inner > 0.0
            if not possible:
                break
            current = load / (0.5 * (inner + math.sqrt(square)))
    factor = fast_factor(tables.cell, but, current)
    polarisation_V = corrected_polarisation(point, x, current, factor, but)
    voltage = loaded_voltage(point.ocv_V, point.m_V, x.h, polarisation_V) + but.bias_V
    return LoadPoint(point, current, voltage, polarisation_V, possible)


@part
def held(
    tables: CellTables,
    start: CellState,
    load: float,
    power: bool,
    horizon_s: float,
    temperature_C: float,
    but: Correction,
) -> LoadedState:
    """Hold a load, positive on discharge: a power [W], else a current [A], over a horizon.

    The current of a power is renewed at the beginning of each of ``STEPS`` even intervals, and at
    the end.
    """
    x = start
    dt_s = horizon_s / STEPS
    now = moment_of(tables, x, load, power, temperature_C + x.heat_K, but)
    lowest = highest = now.voltage_V
    largest = abs(now.current_A)
    for _ in range(STEPS):
        if not now.possible:
            break
        x, _ = advance(tables, x, now.current_A, dt_s, temperature_C)
        now = moment_of(tables, x, load, power, temperature_C + x.heat_K, but)
        lowest = min(lowest, now.voltage_V)
        highest = max(highest, now.voltage_V)
        largest = max(largest, abs(now.current_A))
    return LoadedState(x, now, lowest, highest, largest)


@part
def end_variance(
    tables: CellTables,
    noise: NoiseScalars,
    known: OperatingPoint,
    load: LoadedState,
    slope_V: float,
) -> float:
    """Variance of the voltage at the end of a load [V^2].

    Of the SOC with ``slope_V``, of the model as the filters have it, of the correction.
    """
    x, now = load.end, load.now
    branches = held_in_branches(x)
    more = extrapolation_V(noise.valid, known.temperature_C, now.current_A, now.polarisation_V)
    begun = soc_extrapolation_V(noise.valid, known.cell.soc)
    more += max(soc_extrapolation_V(noise.valid, x.soc) - begun, 0.0)
    point = widened(now.point, abs(more))
    c = step_constants(tables.cell, noise, 1.0)
    model = variance_about(c, noise, point, now.current_A, 0.0, branches)
    seen = correction_variance(tables.cell, known.but, now.point, x, now.current_A)
    return slope_V * slope_V * known.soc_variance + model + seen
