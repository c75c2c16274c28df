"""State, covariance and hypotheses after an interval's voltage, whatever became of it."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import CellState, with_soc
from cellwise.cell.point_kernels import CellPoint
from cellwise.estimate.equations.covariance import scaled
from cellwise.estimate.equations.weighing import (
    Innovation,
    contradicted_after,
    persistent_after,
)
from cellwise.estimate.evidence_kernels import GateResult, StepConstants, slow_variance
from cellwise.estimate.filters.capacity_kernels import (
    Free,
    FreeRules,
    capacity_soc,
    informed_capacity,
)
from cellwise.estimate.filters.covariance_kernels import (
    Covariance,
    corrected,
    moved,
)
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.filters.offset_kernels import Drift, drift_step
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import CheckedReading
from cellwise.estimate.slopes_kernels import VoltageSlopes
from cellwise.estimate.status import CURRENT_INVALID, OUTSIDE


class Predicted(NamedTuple):
    """State, covariance and slopes at the end of an interval, before its voltage is used.

    ``state`` is what was carried; ``drift`` and ``free`` have counted the interval, ``bias_soc`` is
    by how much SOC what was believed of them had moved the estimate before it. ``free`` is None
    unless the filter is the adaptive one.
    """

    state: EkfState
    x: CellState
    p: Covariance
    point: CellPoint
    slopes: VoltageSlopes
    effective_temperature_C: float
    evidence_s: float
    drift: Drift
    free: Free | None
    bias_soc: float
    status: int


class Estimate(NamedTuple):
    """State and covariance after a voltage, and what is stated of the SOC's error beside P."""

    x: CellState
    p: Covariance
    persistent: float
    contradicted: float
    drift: Drift
    free: Free | None


@inline
def without_voltage(predicted: Predicted) -> Estimate:
    """An interval without a voltage: what is believed of offset and capacity goes on."""
    old = predicted.state
    bias_soc = predicted.drift.believed * predicted.drift.reach + capacity_soc(predicted.free)
    x = with_soc(predicted.x, predicted.x.soc + (bias_soc - predicted.bias_soc))
    return Estimate(
        x, predicted.p, old.persistent, old.contradicted, predicted.drift, predicted.free
    )


@inline
def update(
    c: StepConstants,
    noise: NoiseScalars,
    rules: FreeRules | None,
    reading: CheckedReading,
    predicted: Predicted,
    innovation: Innovation,
    gate_result: GateResult,
) -> Estimate:
    """After an accepted voltage."""
    old, slope = predicted.state, innovation.slope_V
    gain = scaled(innovation.column, gate_result.inverse)
    x = moved(predicted.x, gain, gate_result.innovation_V)
    p = corrected(predicted.p, gain, innovation.column)
    since = max(old.watch.evidence_s, 0.0)
    contradicted = contradicted_after(c, old, innovation, gate_result.innovation_V, since)
    # Beyond its data a voltage may contradict the counted charge, but confirms nothing.
    if predicted.status & OUTSIDE and abs(contradicted) < abs(old.contradicted):
        contradicted = old.contradicted
    error_V2 = slow_variance(noise, 0.0, predicted.point)
    persistent = persistent_after(c, old, innovation, error_V2, gate_result.mismatch, gain.s)

    # Offset and capacity: how far each would have led, and what the voltage says of it by the
    # innovation of the filter's own estimate.
    own_V = gate_result.innovation_V + innovation.bias_V
    informs = 0.0 if reading.status & CURRENT_INVALID else gate_result.inverse
    drift = drift_step(predicted.drift, innovation.of_offset_V, own_V, gain.s, gate_result.inverse)
    free, drift = informed_capacity(
        rules,
        predicted.free,
        drift,
        innovation.of_offset_V,
        slope,
        own_V,
        gain.s,
        informs,
        predicted.p.ss,
    )
    bias_soc = drift.believed * drift.reach + capacity_soc(free)
    x = with_soc(x, x.soc + (gain.s * innovation.bias_V + (bias_soc - predicted.bias_soc)))
    return Estimate(x, p, persistent, contradicted, drift, free)
