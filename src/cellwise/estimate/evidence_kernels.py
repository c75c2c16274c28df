"""What a filter makes of an innovation: gate, recovery, and how much the voltage weighs."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from cellwise.cell.kernels import CellScalars
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    REST_RATE,
    Sample,
    Watch,
    repeated_evidence,
    watch_on,
    watch_voltage,
)
from cellwise.estimate.status import (
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    VOLTAGE_FROZEN,
    VOLTAGE_INVALID,
)

UNDER_LOAD_COUNT = 0.05  # a rejection that wrong resistances could explain
COUNT_ROUNDING = 1e-6  # a sum of thousands of small counts reaches a whole number
FORGIVEN = 0.1  # of the count, by a voltage that passes


class Verdict(NamedTuple):
    """What becomes of a voltage.

    ``inverse`` is one over the variance that weighs it; a rejected one only moves the counts,
    and ``recover`` says that the covariance has to be widened.
    """

    accepted: bool
    recover: bool
    inverse: float
    innovation_V: float
    ratio: float
    rejections: float
    mismatch: float
    watch: Watch
    status: int


@njit(cache=True, error_model="numpy", inline="always")
def weigh(
    cell: CellScalars,
    noise: NoiseScalars,
    watch: Watch,
    s: Sample,
    evidence_s: float,
    rejections: float,
    mismatch: float,
    innovation_V: float,
    state_variance: float,
    one: float,
    r0_ohm: float,
    branches_V: float,
    dt_s: float,
    unsure: bool,
    bent: bool,
) -> Verdict:
    """Gate, count, and weigh one innovation.

    ``state_variance`` is what the state's doubt explains of it, ``one`` the variance of a single
    voltage, ``branches_V`` what the branches hold in absolute value. The first voltage of a resting
    cell is believed at once where the start is ``unsure`` of itself, and looked up instead of
    weighed where the voltage is too ``bent`` over SOC for that.
    """
    status = 0
    variance = state_variance + one
    square = innovation_V * innovation_V
    gate = noise.gate * noise.gate
    ratio = square / (gate * variance)
    reading = watch_voltage(noise, watch, s, innovation_V, r0_ohm)
    status |= reading[3]
    used = False
    accepted = False
    recover = False
    inverse = 0.0
    resting = abs(s.seen_A) * 3600.0 < REST_RATE * cell.charge_As
    if not math.isfinite(innovation_V):
        status |= VOLTAGE_INVALID
        innovation_V = math.nan
        ratio = math.nan
    elif status & VOLTAGE_FROZEN == 0:
        used = True
        # A model of another temperature, age or cell is wrong all the time: evidence weighs less
        # by what the innovations have lately shown beyond their variance.
        if noise.mismatch_cap > 0.0 and noise.slow_s > 0.0:
            lately = min(dt_s / noise.slow_s, 1.0)
            mismatch += lately * (min(square / variance, noise.mismatch_cap) - mismatch)
        if ratio > 1.0:
            status |= INNOVATION_REJECTED
            # Under load the resistances may be what is wrong: what three times the polarisation
            # can explain speaks against the SOC more slowly, and by time: ten samples a second
            # repeat one such error.
            polarisation = abs(r0_ohm * s.seen_A) + branches_V
            if square > gate * variance + 4.0 * polarisation * polarisation:
                rejections += 1.0
            else:
                rejections += UNDER_LOAD_COUNT * min(dt_s, 1.0)
            if unsure and resting and evidence_s < 0.0:
                rejections = noise.recovery_after
            if rejections >= noise.recovery_after - COUNT_ROUNDING:
                status |= GATE_RECOVERY
                recover = True
                rejections = 0.0
                mismatch = 1.0
                evidence_s = 0.0
        elif unsure and bent and resting and evidence_s < 0.0:
            recover = True
            evidence_s = 0.0
        else:
            accepted = True
            rejections = max(rejections - FORGIVEN, 0.0)
            shared = repeated_evidence(noise, evidence_s, dt_s, resting)
            inverse = 1.0 / (state_variance + one * shared * max(mismatch, 1.0))
            evidence_s = max(evidence_s, 0.0)
    if evidence_s >= 0.0:
        evidence_s += dt_s
    after, away = watch_on(noise, s, dt_s, used, evidence_s, watch.no_voltage_s, reading)
    status |= away
    return Verdict(
        accepted, recover, inverse, innovation_V, ratio, rejections, mismatch, after, status
    )
