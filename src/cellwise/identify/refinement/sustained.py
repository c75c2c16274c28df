"""What a load does that lasts for minutes, where the tests had none: how wrong a model may be."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import SHARE_AT_TWICE
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray

SUSTAINED_S = 300.0  # what builds up within minutes has done so
SHOWN = 1.0  # doublings of the current that lasted: up to there the tests' own errors count
MOST_DOUBLINGS = 3.0  # a resistance that nothing sustained has shown
MIDDLE = (0.1, 0.9)


def sustained_A(log: CellLog, sign: float) -> float:
    """The largest mean current of a log over SUSTAINED_S in one direction [A]; 0 where none is.

    ``sign`` 1 is discharge, -1 charge; a shorter log shows nothing.
    """
    end_s = log.time_s[log.time_s >= log.time_s[0] + SUSTAINED_S]
    if end_s.size == 0:
        return 0.0
    charge_Ah = log.counted_charge_Ah()
    before_Ah = np.interp(end_s - SUSTAINED_S, log.time_s, charge_Ah)
    moved_Ah = charge_Ah[charge_Ah.size - end_s.size :] - before_Ah
    return max(float(np.max(sign * moved_Ah)), 0.0) * 3600.0 / SUSTAINED_S


def charged_for_minutes(log: CellLog) -> BoolArray:
    """Rows before which more charge went in than out over SUSTAINED_S, shape (n,)."""
    charge_Ah = log.counted_charge_Ah()
    before_Ah = np.interp(log.time_s - SUSTAINED_S, log.time_s, charge_Ah)
    whole = log.time_s >= log.time_s[0] + SUSTAINED_S
    return np.asarray(whole & (charge_Ah < before_Ah))


def slow_part(model: CellModel) -> float:
    """The share of a steady polarisation that takes minutes to build up: beyond R0 and R1."""
    rows = (model.soc > MIDDLE[0]) & (model.soc < MIDDLE[1])
    slow = float(model.r2_ohm[:, rows].mean())
    third = np.asarray(model.effect(SlowDiffusion).r3_ohm)
    slow += float(third[..., rows].mean() if third.ndim else third)
    return slow / (slow + float((model.r0_ohm + model.r1_ohm)[:, rows].mean()))


def unseen_shares(model: CellModel, logs: Sequence[CellLog]) -> tuple[float, float]:
    """By what share a polarisation may be wrong because no load lasted: discharge, charge.

    Pulses show what a current does within seconds. What it does within minutes is known up to the
    current that was sustained for as long; beyond it, up to 1C if the tests reached that,
    reaction and diffusion follow no straight line, and every doubling may be off by
    SHARE_AT_TWICE of what takes minutes. Within the first nothing is added to what the tests do
    show: a drive's mean is below 1C, and it has loads of every length up to it. What lasted in the
    other direction counts, too, but a direction of its own is a doubling by itself: a cell that
    is charged meets other concentrations, and other steps of its OCV, than one that is discharged.
    """
    largest_A = max((float(np.max(np.abs(g.known_current_A()))) for g in logs), default=0.0)
    usual_A = min(largest_A, model.capacity_Ah)
    out, into = (max((sustained_A(g, sign) for g in logs), default=0.0) for sign in (1.0, -1.0))
    share = SHARE_AT_TWICE * slow_part(model)
    return share * _doublings(usual_A, out, into), share * _doublings(usual_A, into, out)


def _doublings(usual_A: float, own_A: float, other_A: float) -> float:
    """From what lasted to the usual current, where the first doubling is free in one direction."""
    own, other = (math.log2(usual_A / a) if a > 0.0 else MOST_DOUBLINGS for a in (own_A, other_A))
    if own <= SHOWN:
        return 0.0
    return min(own, max(other, SHOWN), MOST_DOUBLINGS)
