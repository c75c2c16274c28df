"""What a load does that lasts for minutes, where the tests had none: how wrong a model may be."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import SHARE_AT_TWICE
from cellwise.logs.cell_log import CellLog

SUSTAINED_S = 300.0  # what builds up within minutes has done so
SHOWN = 2.0  # times the current that lasted: up to there the tests' own errors count
MOST_DOUBLINGS = 3.0  # a resistance that nothing sustained has shown
MIDDLE = (0.1, 0.9)


def sustained_A(log: CellLog) -> float:
    """The largest mean current of a log over SUSTAINED_S, either way [A]; 0 for a shorter log."""
    end_s = log.time_s[log.time_s >= log.time_s[0] + SUSTAINED_S]
    if end_s.size == 0:
        return 0.0
    charge_Ah = log.counted_charge_Ah()
    before_Ah = np.interp(end_s - SUSTAINED_S, log.time_s, charge_Ah)
    moved_Ah = charge_Ah[charge_Ah.size - end_s.size :] - before_Ah
    return float(np.max(np.abs(moved_Ah))) * 3600.0 / SUSTAINED_S


def slow_part(model: CellModel) -> float:
    """The share of a steady polarisation that takes minutes to build up: beyond R0 and R1."""
    rows = (model.soc > MIDDLE[0]) & (model.soc < MIDDLE[1])
    slow = float(model.r2_ohm[:, rows].mean())
    third = np.asarray(model.effect(SlowDiffusion).r3_ohm)
    slow += float(third[..., rows].mean() if third.ndim else third)
    return slow / (slow + float((model.r0_ohm + model.r1_ohm)[:, rows].mean()))


def unseen_share(model: CellModel, logs: Sequence[CellLog]) -> float:
    """By what share the model's polarisation may be wrong because no load lasted.

    Pulses show what a current does within seconds. What it does within minutes is known up to the
    current that was sustained for as long; beyond it, up to 1C if the tests reached that,
    reaction and diffusion follow no straight line, and every doubling may be off by
    SHARE_AT_TWICE of what takes minutes. Within the first nothing is added to what the tests do
    show: a drive's mean is below 1C, and it has loads of every length up to it.
    """
    seen_A = max((sustained_A(log) for log in logs), default=0.0)
    largest_A = max((float(np.max(np.abs(g.known_current_A()))) for g in logs), default=0.0)
    usual_A = min(largest_A, model.capacity_Ah)
    if SHOWN * seen_A >= usual_A:
        return 0.0
    doublings = math.log2(usual_A / seen_A) if seen_A > 0.0 else MOST_DOUBLINGS
    return SHARE_AT_TWICE * min(doublings, MOST_DOUBLINGS) * slow_part(model)
