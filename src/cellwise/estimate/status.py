"""Status bits of every estimator, the same values in Python and C."""

from __future__ import annotations

from enum import IntFlag


class Status(IntFlag):
    """What happened in a step; 0 is a plain step."""

    CURRENT_INVALID = 1  # missing or not finite: the last valid current was held
    VOLTAGE_INVALID = 2  # missing or not finite: prediction only
    SEQUENCE_GAP = 4  # the log has a gap here: charge unknown, variance widened
    DUPLICATE = 8  # repeated time stamp: nothing flowed
    INNOVATION_REJECTED = 16  # the innovation gate kept the voltage out
    CLAMPED = 32  # SOC was held at a bound
    STATE_RESET = 64  # the state was not finite and was re-initialised
    GATE_RECOVERY = 128  # too many rejections in a row: variance widened, voltage let in
    TEMPERATURE_INVALID = 256  # not finite or out of range: the last valid temperature was held
    OUT_OF_RANGE = 512  # a reading that no cell of this kind gives: treated as missing
    VOLTAGE_FROZEN = 1024  # the voltage repeats itself while the current changes: not used
    CURRENT_LOST = 2048  # current missing for longer than is held: on voltage alone, variance grows
    VOLTAGE_LOST = 4096  # voltage missing or frozen for as long: counting charge
    OUTSIDE = 8192  # SOC, temperature or current beyond the model's data: variance widened


# Kernels take plain integers.
CURRENT_INVALID = int(Status.CURRENT_INVALID)
VOLTAGE_INVALID = int(Status.VOLTAGE_INVALID)
SEQUENCE_GAP = int(Status.SEQUENCE_GAP)
DUPLICATE = int(Status.DUPLICATE)
INNOVATION_REJECTED = int(Status.INNOVATION_REJECTED)
CLAMPED = int(Status.CLAMPED)
STATE_RESET = int(Status.STATE_RESET)
GATE_RECOVERY = int(Status.GATE_RECOVERY)
TEMPERATURE_INVALID = int(Status.TEMPERATURE_INVALID)
OUT_OF_RANGE = int(Status.OUT_OF_RANGE)
VOLTAGE_FROZEN = int(Status.VOLTAGE_FROZEN)
CURRENT_LOST = int(Status.CURRENT_LOST)
VOLTAGE_LOST = int(Status.VOLTAGE_LOST)
OUTSIDE = int(Status.OUTSIDE)
