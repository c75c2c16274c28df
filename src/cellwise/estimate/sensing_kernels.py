"""What a sample goes through before a filter believes it: missing, impossible and frozen readings.

The filters share this so that a fault means the same in each. In names of functions a ``watch`` is
the `SensorMonitor`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import CellTables, delayed_current, needs_temperature
from cellwise.estimate.equations.constants import (
    COLDEST_C,
    FOUND_FROZEN,
    HOTTEST_C,
    LOST_RATE,
)
from cellwise.estimate.equations.sensors import HeldVoltage, is_dead, repeats_after, swings_after
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.status import (
    CURRENT_INVALID,
    CURRENT_LOST,
    DUPLICATE,
    OUT_OF_RANGE,
    SEQUENCE_GAP,
    TEMPERATURE_INVALID,
    VOLTAGE_FROZEN,
    VOLTAGE_LOST,
)

NOT_BEGUN_S = -2.0  # evidence_s before the first sample
NO_VOLTAGE_YET_S = -1.0  # evidence_s until the first voltage


class SensorMonitor(NamedTuple):
    """What is remembered of the sensors from one sample to the next.

    ``evidence_s`` is the time since the first voltage, or since a recovery: the model's error is
    not remembered for longer. NOT_BEGUN_S and NO_VOLTAGE_YET_S stand for what was before.
    ``voltage_V`` is the last reading, seen ``repeats`` times in a row since the current was
    ``frozen_A``. ``no_warm_s`` is how long the temperature has been lost, negative where none was
    ever measured. ``swings`` counts how often the voltage has gone up and down while the current
    repeated itself; its sign is that of the last one.
    """

    current_A: float
    temperature_C: float
    evidence_s: float
    no_current_s: float
    no_voltage_s: float
    voltage_V: float
    frozen_A: float
    repeats: float
    no_warm_s: float
    swings: float


class MeasuredSample(NamedTuple):
    """What the sensors say at the end of an interval of ``dt_s`` seconds; NaN where missing.

    ``gap`` says that nobody knows what flowed within the interval.
    """

    current_A: float
    voltage_V: float
    temperature_C: float
    dt_s: float
    gap: bool


class CheckedReading(NamedTuple):
    """A sample as the filter takes it.

    ``delayed_current_A`` is the current that the voltage has seen, ``counted_current_A`` the one
    whose charge is counted; ``gap_A2`` and ``lost_A`` say how much may have flowed unseen over a
    gap and since the current was lost. ``voltage_V`` is NaN where it must not be used.
    """

    current_A: float
    delayed_current_A: float
    counted_current_A: float
    gap_A2: float
    lost_A: float
    voltage_V: float
    temperature_C: float
    no_current_s: float
    no_warm_s: float
    dt_s: float
    gap: bool
    status: int


@inline
def first_watch(current_A: float) -> SensorMonitor:
    """Nothing seen yet but a current to hold."""
    return SensorMonitor(current_A, math.nan, NOT_BEGUN_S, 0.0, 0.0, math.nan, 0.0, 0.0, -1.0, 0.0)


@inline
def read_sample(
    tables: CellTables,
    noise: NoiseScalars,
    watch: SensorMonitor,
    default_C: float,
    sample: MeasuredSample,
) -> CheckedReading:
    """Readings that are missing or impossible replaced, and flagged in the status."""
    status = 0
    dt_s, gap = sample.dt_s, sample.gap
    held = watch.current_A if math.isfinite(watch.current_A) else 0.0
    current = sample.current_A
    no_current = 0.0
    dead = current == watch.current_A and is_dead(watch.swings)
    if dead or not abs(current) <= noise.current_limit_A:  # catches what is no number, too
        status |= CURRENT_INVALID
        if math.isfinite(current) and not dead:
            status |= OUT_OF_RANGE
        current = held
        no_current = watch.no_current_s + (0.0 if gap else dt_s)
    temperature_C = sample.temperature_C
    no_warm = watch.no_warm_s
    if not COLDEST_C <= temperature_C <= HOTTEST_C:
        temperature_C = watch.temperature_C if math.isfinite(watch.temperature_C) else default_C
        if needs_temperature(tables):
            status |= TEMPERATURE_INVALID
            if no_warm >= 0.0:
                no_warm += dt_s
    else:
        no_warm = 0.0
    voltage = sample.voltage_V
    if not noise.voltage_low_V <= voltage <= noise.voltage_high_V:
        if math.isfinite(voltage):
            status |= OUT_OF_RANGE
        voltage = math.nan
    delayed = delayed_current(tables.cell, current, held, dt_s)
    counted = delayed
    unknown = 0.0
    lost = 0.0
    if no_current > noise.hold_s:
        # Whatever was held is no guide any more: nothing is counted, and as much as half a rate
        # may flow either way.
        status |= CURRENT_LOST
        delayed = 0.0
        counted = 0.0
        lost = LOST_RATE * tables.cell.charge_As / 3600.0
    elif gap:
        # What flowed is not known: no charge is moved, and the branches may hold what the currents
        # on either side can have left there. The voltage is still read under the row's current.
        counted = 0.0
        unknown = delayed * delayed + held * held
    if gap:
        status |= SEQUENCE_GAP
    elif dt_s <= 0.0:
        status |= DUPLICATE
    # fmt: off
    return CheckedReading(
        current, delayed, counted, unknown, lost, voltage, temperature_C, no_current, no_warm,
        dt_s, gap, status,
    )
    # fmt: on


@inline
def watch_current(noise: NoiseScalars, watch: SensorMonitor, reading: CheckedReading) -> float:
    """How often the voltage has gone up and down under a current that repeats itself bit by bit."""
    after = swings_after(watch.swings, reading.voltage_V - watch.voltage_V, noise.frozen_V)
    return after if reading.current_A == watch.current_A else 0.0


@inline
def watch_voltage(
    noise: NoiseScalars,
    watch: SensorMonitor,
    reading: CheckedReading,
    innovation_V: float,
    r0_ohm: float,
) -> tuple[HeldVoltage, float, int]:
    """Is the voltage frozen? Its last reading, swings, status bits."""
    last, status = HeldVoltage(watch.voltage_V, watch.frozen_A, watch.repeats), 0
    if math.isfinite(reading.voltage_V):
        last = repeats_after(
            watch.voltage_V, watch.frozen_A, watch.repeats,
            reading.voltage_V, reading.delayed_current_A, r0_ohm, innovation_V, noise.frozen_V,
        )  # fmt: skip
        if last.repeats >= FOUND_FROZEN:
            status = VOLTAGE_FROZEN
    return last, watch_current(noise, watch, reading), status


@inline
def watch_on(
    noise: NoiseScalars,
    reading: CheckedReading,
    used: bool,
    evidence_s: float,
    no_voltage_s: float,
    last: HeldVoltage,
    swings: float,
) -> tuple[SensorMonitor, int]:
    """The watch after a sample, and the bit of a voltage that has been away for long."""
    away = 0.0
    if not used:
        away = no_voltage_s + (0.0 if reading.gap else reading.dt_s)
    watch = SensorMonitor(
        reading.current_A, reading.temperature_C, evidence_s, reading.no_current_s, away,
        last.voltage_V, last.since_A, last.repeats, reading.no_warm_s, swings,
    )  # fmt: skip
    return watch, VOLTAGE_LOST if away > noise.hold_s else 0
