"""What a measured voltage means to the fixed step: prediction, weight, a SOC searched for it."""

from __future__ import annotations

from cellwise.cell.description import BRANCHES
from cellwise.cell.equations.scalar import distance_beyond, exponential_rise
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.equations.covariance import Point, Slopes, column_of, explained, followed
from cellwise.estimate.equations.evidence import (
    Shared,
    bent_variance,
    shared_evidence,
    single_variance,
)
from cellwise.estimate.equations.offset import offset_after, rest_after
from cellwise.estimate.equations.sensors import repeats_after, swings_after
from cellwise.estimate.equations.weighing import Innovation, voltage_at
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.sensing import Reading
from cellwise.estimate.status import OUTSIDE, VOLTAGE_FROZEN


def watch_current(c: Constants, x: State, voltage: float) -> None:
    """How often the voltage has gone up and down under a current that repeats itself."""
    if x.evidence >= FIRST_VOLTAGE:
        x.swings = swings_after(x.swings, voltage - x.voltage_V, c.frozen_V)


def watch_voltage(
    c: Constants,
    x: State,
    voltage: float,
    delayed_current_A: float,
    r0_ohm: float,
    innovation_V: float,
) -> int:
    """Whether the voltage is frozen: CELLWISE_VOLTAGE_FROZEN, or 0."""
    now = repeats_after(
        x.voltage_V,
        x.frozen_A,
        x.repeats,
        voltage,
        delayed_current_A,
        r0_ohm,
        innovation_V,
        c.frozen_V,
    )
    x.voltage_V = now.voltage_V
    x.frozen_A = now.since_A
    x.repeats = now.repeats
    return U(VOLTAGE_FROZEN) if now.repeats >= FOUND_FROZEN else U(0)


def time_of_evidence(x: State) -> float:
    """Steps since the first voltage, or since a recovery."""
    since = U(0)
    if x.evidence >= FIRST_VOLTAGE:
        since = U(x.evidence - FIRST_VOLTAGE)
        since = since if since < EVIDENCE_MOST else EVIDENCE_MOST
    return F(since)


def shared_by(c: Constants, x: State, delayed_current_A: float) -> Shared:
    """How many samples share one model error; the first voltage at rest stands alone."""
    alone = x.evidence < FIRST_VOLTAGE and size_below(delayed_current_A, c.rest_A)
    return shared_evidence(c, time_of_evidence(x), 1.0, alone)


def outside(c: Constants, x: State, reading: Reading) -> int:
    """Whether SOC, current or temperature is beyond the model's data: CELLWISE_OUTSIDE, or 0."""
    status = U(0)
    if not within(x.soc, c.valid_soc_low, c.valid_soc_high):
        status = U(OUTSIDE)
    if not within(reading.delayed_current_A, c.valid_charge_A, c.valid_discharge_A):
        status = U(OUTSIDE)
    if THERMAL and not within(x.temperature_C, c.valid_cold_C, c.valid_warm_C):
        status = U(OUTSIDE)
    return status


def extrapolated(c: Constants, x: State, delayed_current_A: float, polarisation_V: float) -> float:
    """What the model can be off by beyond its data's current and temperature, one deviation.

    The law of the float64 filters: a share of the polarisation, as of an exponential to its third
    order; what lies beyond in SOC is in the table of the error.
    """
    share = c.share_per_A * distance_beyond(
        delayed_current_A, c.valid_charge_A, c.valid_discharge_A
    )
    moved_V = 0.0
    if THERMAL:
        far_K = distance_beyond(x.temperature_C, c.valid_cold_C, c.valid_warm_C)
        share = share + exponential_rise(c.share_per_K * far_K)
        moved_V = c.voltage_per_K * far_K
    return F((share * polarisation_V) + moved_V)


def beyond_data(m: Model, x: State, current: float, held_V: float) -> float:
    """What the model can be off by beyond its data, one deviation [V]."""
    beyond_V = 0.0
    if VALIDITY:
        beyond_V = extrapolated(m.constant, x, current, held_V)
    return beyond_V


def unmeasured(m: Model, x: State) -> float:
    """Mean square of a current that nobody measures [A^2]."""
    return m.constant.lost_A2 if x.no_current > m.constant.hold_steps else 0.0


@unrolled_by_option
def count_offset(c: Constants, x: State, p: Point, reading: Reading, missing: int) -> None:
    """How far an offset leads over one interval: the count, where there was one, and the branches.

    What is believed of it moves the SOC.
    """
    counted = 1.0
    if missing != U(0) or reading.unmeasured_A2 > 0.0:
        counted = 0.0
    moved = counted * c.drift_soc
    x.reach = at_most(x.reach + moved, REACH_MOST)
    x.soc, x.soc_carry = add(x.soc, x.soc_carry, x.believed * moved)
    for i in BRANCHES:
        x.d[i] = followed(x.d[i], p.gain[i], p.r[i] * c.offset_A)
    now = rest_after(x.rest, x.rest_A, reading.current, counted, c.rate_A, c.rest_steps)
    x.rest = now.lasts
    x.rest_A = now.current_A
    if now.weight > 0.0 and c.offset_A > 0.0 and x.information < INFORMATION_MOST - now.weight:
        x.information = x.information + now.weight
        x.score = x.score + ((now.weight * reading.current) / c.offset_A)


@unrolled_by_option
def dropped_by_offset(c: Constants, x: State, p: Point) -> float:
    """By what one deviation of an offset puts the drop over R0 and branches too high [V]."""
    dropped_V = p.r0_ohm * c.offset_A
    for i in BRANCHES:
        dropped_V = dropped_V + x.d[i]
    return F(dropped_V)


def ask_for_offset(
    x: State, innovation: Innovation, innovation_V: float, gain: float, inverse: float
) -> None:
    """What a voltage that has moved the state says of an offset, and where that moves the SOC."""
    before = x.believed * x.reach
    own_V = innovation_V + innovation.bias_V
    now = offset_after(x.score, x.information, innovation.of_offset_V, own_V, inverse)
    x.reach = x.reach - (gain * innovation.of_offset_V)
    x.score = now.score
    x.information = now.information
    x.believed = now.believed
    x.unsure = now.unsure
    more = (gain * innovation.bias_V) + ((x.believed * x.reach) - before)
    x.soc, x.soc_carry = add(x.soc, x.soc_carry, more)


@unrolled_by_option
def innovate(c: Constants, x: State, p: Point, slopes: Slopes, reading: Reading) -> Innovation:
    """Predicted voltage, and the variances of what is measured about it."""
    drop = p.r0_ohm * reading.delayed_current_A
    polarisation_V = magnitude(drop)
    for i in BRANCHES:
        polarisation_V = polarisation_V + magnitude(x.state[i])
    voltage_V = voltage_at(x, p, drop)
    single_V2 = single_variance(
        c, p.noise_V2, reading.delayed_current_A, polarisation_V, reading.unmeasured_A2, p.r0_ohm
    )
    if VALIDITY:
        beyond_V = extrapolated(c, x, reading.delayed_current_A, polarisation_V)
        single_V2 = single_V2 + (beyond_V * beyond_V)
    column = column_of(x, slopes.slope_V, p.m_V)
    explained_V2 = explained(column, slopes.slope_V, p.m_V)
    if WIDE:
        explained_V2 = bent_variance(explained_V2, slopes.bend_V)
    variance_V2 = explained_V2 + single_V2
    of_offset_V = 0.0
    bias_V = 0.0
    if OFFSET:
        # What is believed of an offset has moved the drop, too; what is not known of it may have.
        dropped_V = dropped_by_offset(c, x, p)
        of_offset_V = (slopes.slope_V * x.reach) + dropped_V
        bias_V = x.believed * of_offset_V
        voltage_V = voltage_V + (x.believed * dropped_V)
        variance_V2 = variance_V2 + ((of_offset_V * of_offset_V) * x.unsure)
    return Innovation(
        voltage_V,
        variance_V2,
        explained_V2,
        single_V2,
        slopes.slope_V,
        of_offset_V,
        bias_V,
        column,
    )
