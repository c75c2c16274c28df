"""What a filter makes of an innovation: gate, count of rejections, weight; one way for all."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.point_kernels import CellScalars
from cellwise.estimate.evidence_kernels import mismatch_step, repeated_evidence
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    REST_RATE,
    Sample,
    Watch,
    watch_on,
    watch_voltage,
)
from cellwise.estimate.status import (
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    VOLTAGE_FROZEN,
    VOLTAGE_INVALID,
)

COUNT_ROUNDING = 1e-6  # a sum of thousands of small counts reaches a whole number


class Innovation(NamedTuple):
    """Measured minus predicted voltage, and what it may be due to.

    ``state_variance`` is what the state's uncertainty explains of it, ``one`` the variance of a
    single voltage, ``free_variance`` what an offset or a capacity that is not known explains;
    ``branches_V`` what the branches hold in absolute value. ``unsure`` says that the SOC is badly
    known, ``bent`` that the voltage is no straight line over its band. One deviation of the offset
    moves the voltage by ``of_offset_V``, all that is believed has moved it by ``followed_V``.
    """

    predicted_V: float
    innovation_V: float
    state_variance: float
    one: float
    free_variance: float
    r0_ohm: float
    branches_V: float
    unsure: bool
    bent: bool
    of_offset_V: float
    followed_V: float


class Verdict(NamedTuple):
    """What becomes of a voltage.

    ``inverse`` is one over the variance that weighs it; a rejected one only moves the counts, and
    ``recover`` says that the SOC has to be searched for.
    """

    accepted: bool
    recover: bool
    used: bool
    inverse: float
    innovation_V: float
    variance: float
    ratio: float
    rejections: float
    mismatch: float
    watch: Watch
    status: int


@inline
def gate(
    cell: CellScalars,
    noise: NoiseScalars,
    watch: Watch,
    s: Sample,
    evidence_s: float,
    rejections: float,
    mismatch: float,
    i: Innovation,
) -> Verdict:
    """Gate, count, and weigh one innovation.

    The first voltage of a resting cell is believed at once where the start is ``unsure`` of
    itself, and searched for instead of weighed where the voltage is too ``bent`` over SOC.
    """
    status = 0
    innovation_V = i.innovation_V
    variance = i.state_variance + (i.one + i.free_variance)
    square = innovation_V * innovation_V
    ratio = square / variance * noise.per_gate2
    excess = square / (i.state_variance + i.one)
    reading = watch_voltage(noise, watch, s, innovation_V, i.r0_ohm)
    status |= reading[3]
    used = False
    accepted = False
    recover = False
    inverse = 0.0
    resting = abs(s.seen_A) * 3600.0 < REST_RATE * cell.charge_As
    first = i.unsure and resting and evidence_s < 0.0
    if not math.isfinite(innovation_V):
        status |= VOLTAGE_INVALID
        innovation_V = math.nan
        ratio = math.nan
    elif status & VOLTAGE_FROZEN == 0:
        used = True
        mismatch = mismatch_step(noise, mismatch, excess, s.dt_s)
        if ratio > 1.0:
            status |= INNOVATION_REJECTED
            # Ten samples a second repeat one error: each counts for its time, at most for one.
            rejections += min(s.dt_s, 1.0)
            if first:
                rejections = noise.recovery_after
            if rejections >= noise.recovery_after - COUNT_ROUNDING:
                status |= GATE_RECOVERY
                recover = True
                rejections = 0.0
                mismatch = 1.0
                evidence_s = 0.0
        elif first and i.bent:
            recover = True
            evidence_s = 0.0
        else:
            accepted = True
            rejections = 0.0
            shared = repeated_evidence(noise, evidence_s, s.dt_s, resting)
            inverse = 1.0 / (i.state_variance + i.one * shared * max(mismatch, 1.0))
            evidence_s = max(evidence_s, 0.0)
    if evidence_s >= 0.0:
        evidence_s += s.dt_s
    after, away = watch_on(noise, s, used, evidence_s, watch.no_voltage_s, reading)
    status |= away
    # fmt: off
    return Verdict(
        accepted, recover, used, inverse, innovation_V, variance, ratio, rejections,
        mismatch, after, status,
    )
    # fmt: on
