"""What a measured voltage means to the fixed step: prediction, weight, a SOC searched for it."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.description import BRANCHES, H
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.covariance import Column, column_of
from cellwise.estimate.fixed.lookup import Point, Slopes
from cellwise.estimate.fixed.sensing import Reading
from cellwise.estimate.fixed.state import guess_branches
from cellwise.estimate.status import OUTSIDE, VOLTAGE_FROZEN


@unrolled_by_option
def voltage_of(x: State, p: Point, drop: float) -> float:
    """The voltage that the state gives at a point of the tables."""
    voltage = p.ocv_V - drop
    for i in BRANCHES:
        voltage = voltage - x.state[i]
    for i in (H,):
        voltage = voltage + (p.m_V * x.state[i])
    return voltage


def widen(c: Constants, x: State, p: Point, seen: float) -> None:
    """The gate may have locked the truth out: anything is admitted, and the next voltage passes."""
    x.ss = RECOVERY_VARIANCE
    x.evidence = FIRST_VOLTAGE
    guess_branches(c, x, p, seen)


class Innovation(NamedTuple):
    """What the state says of the next voltage, before it is looked at.

    ``variance_V2`` is that of a single innovation, ``explained_V2`` what the state and ``one_V2``
    what the voltage brings to it; ``polarisation_V`` how much of the voltage is current's doing.
    """

    voltage_V: float
    variance_V2: float
    explained_V2: float
    one_V2: float
    polarisation_V: float
    column: Column


class Shared(NamedTuple):
    """How many samples share one model error: ``above / below``, never divided."""

    above: float
    below: float


def watch_current(c: Constants, x: State, voltage: float) -> None:
    """How often the voltage has gone up and down under a current that repeats itself.

    A constant current moves a voltage one way. Where it goes both ways by as much as would call a
    voltage frozen, nobody measures the current.
    """
    moved = voltage - x.voltage_V
    if not size_within(moved, c.frozen_V) and not (x.swings * moved > 0.0):
        count = magnitude(x.swings) + 1.0
        count = count if count < SWINGS_MOST else SWINGS_MOST
        x.swings = count if moved > 0.0 else -count


def watch_voltage(
    c: Constants, x: State, voltage: float, seen: float, r0_ohm: float, innovation: float
) -> int:
    """Whether the voltage is frozen.

    A reading that repeats itself, but for its last digits, is frozen once R0 times the change of
    current says that it must have moved, and the prediction is off by half of that: a held voltage
    repeats itself, too, but the model expects it there. It stays frozen until it changes.
    """
    status = U(0)
    if not size_within(voltage - x.voltage_V, DITHER_V):
        x.voltage_V = voltage
        x.frozen_A = seen
        x.repeats = U(0)
    elif x.repeats == FROZEN:
        status = U(VOLTAGE_FROZEN)
    else:
        moved = magnitude(r0_ohm * (seen - x.frozen_A))
        off = magnitude(innovation) > (0.5 * moved)
        if x.repeats < COUNT_MOST:
            x.repeats = U(x.repeats + 1)
        if x.repeats >= FROZEN_READINGS and moved > c.frozen_V and off:
            x.repeats = FROZEN
            status = U(VOLTAGE_FROZEN)
    return status


def shared_by(c: Constants, x: State, seen: float) -> Shared:
    """How many samples share one model error, as a fraction: at least 1.

    The model's error is a sum of processes with memories of a second to half an hour. The quick
    ones average out first, so the rest of a mean has an ever longer memory. The first voltage
    at rest is evidence by itself.
    """
    seen_before = U(0)
    if x.evidence >= FIRST_VOLTAGE:
        seen_before = U(x.evidence - FIRST_VOLTAGE)
        seen_before = seen_before if seen_before < EVIDENCE_MOST else EVIDENCE_MOST
    since = F(seen_before)
    below = since + c.shared_half
    above = below
    if x.evidence >= FIRST_VOLTAGE or not size_below(seen, c.rest_A):
        above = (c.shared * since) + c.shared_early
    return Shared(above, below)


def outside(c: Constants, x: State, s: Reading) -> int:
    """Whether SOC, current or temperature is beyond the model's data: CELLWISE_OUTSIDE, or 0."""
    status = U(0)
    if not within(x.soc, c.valid_soc_low, c.valid_soc_high):
        status = U(OUTSIDE)
    if not within(s.seen, c.valid_charge_A, c.valid_discharge_A):
        status = U(OUTSIDE)
    if THERMAL and not within(x.temperature_C, c.valid_cold_C, c.valid_warm_C):
        status = U(OUTSIDE)
    return status


def extrapolated(c: Constants, x: State, seen: float, polarisation_V: float) -> float:
    """What the model can be off by beyond its data's current and temperature, one deviation.

    The law of the float64 filters: a share of the polarisation, as of an exponential to its third
    order; what lies beyond in SOC is in the table of the error.
    """
    far_A = at_least(c.valid_charge_A - seen, seen - c.valid_discharge_A)
    share = c.share_per_A * at_least(far_A, 0.0)
    moved_V = 0.0
    if THERMAL:
        far_K = at_least(c.valid_cold_C - x.temperature_C, x.temperature_C - c.valid_warm_C)
        far_K = at_least(far_K, 0.0)
        z = c.share_per_K * far_K
        share = share + (z * (1.0 + (z * (0.5 + (z * SIXTH)))))
        moved_V = c.voltage_per_K * far_K
    return F((share * polarisation_V) + moved_V)


@unrolled_by_option
def innovate(c: Constants, x: State, p: Point, w: Slopes, s: Reading) -> Innovation:
    """Predicted voltage, and the variances of what is measured about it."""
    drop = p.r0_ohm * s.seen
    polarisation_V = magnitude(drop)
    for i in BRANCHES:
        polarisation_V = polarisation_V + magnitude(x.state[i])
    voltage_V = voltage_of(x, p, drop)
    share = c.share_variance if s.seen >= 0.0 else c.charge_variance
    one_V2 = p.noise_V2 + (
        (share * (polarisation_V * polarisation_V))
        + ((c.current_variance_A2 + s.unmeasured_A2) * (p.r0_ohm * p.r0_ohm))
    )
    if VALIDITY:
        beyond_V = extrapolated(c, x, s.seen, polarisation_V)
        one_V2 = one_V2 + (beyond_V * beyond_V)
    # An OCV that bends by c at one standard deviation is off its tangent by c z^2.
    column = column_of(x, p, w.slope_V)
    explained_V2 = column.variance + (3.0 * (w.bend_V * w.bend_V))
    variance_V2 = explained_V2 + one_V2
    return Innovation(voltage_V, variance_V2, explained_V2, one_V2, polarisation_V, column)
