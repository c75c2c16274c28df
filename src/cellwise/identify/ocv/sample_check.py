"""Whether an OCV test and a pulse test are of one cell: the charge between the same two voltages.

Samples of one type differ by some per cent in capacity, and a cell loses some over a campaign. A
low-rate curve of the one and pulses of the other then lie on two SOC scales, and nothing in the
result says so.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.notice import RANGE_V, Notice
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.typing import FloatArray


class _Limits(NamedTuple):
    """What separates two cells from one."""

    between_soc: tuple[float, float] = (0.08, 0.97)  # at the steep ends rests say nothing of charge
    least_rests: int = 5
    other_capacity: float = 0.03  # counters and rests cut short differ by less
    clear: float = 0.7  # error on the better scale over that on one scale
    other_shape_V: float = 0.015  # beyond: another chemistry, or a cell of another age


LIMITS = _Limits()
SCALES = np.arange(0.70, 1.4001, 0.0025)


class SampleCheck(NamedTuple):
    """What lies between the same two voltages in both tests.

    high_V, low_V : first and last rest compared [V]
    ocv_Ah, rests_Ah : charge between them in the low-rate test and in the pulse test [Ah]
    left_V : RMS between rests and low-rate curve on the better scale [V]
    one_cell : whether both may be one cell
    """

    high_V: float
    low_V: float
    ocv_Ah: float
    rests_Ah: float
    left_V: float
    one_cell: bool


def check_samples(rests: OcvCurve, low_rate: OcvCurve) -> SampleCheck | None:
    """Compare the rests of a pulse test with a low-rate curve; None with too few rests.

    The low-rate curve carries half the hysteresis and its polarisation: a constant is allowed
    beside the scale.

    Parameters
    ----------
    rests, low_rate : OcvCurve        SOC of both over one capacity
    """
    order = np.argsort(rests.points_soc)[::-1]
    soc, v = rests.points_soc[order], rests.points_V[order]
    used = (soc >= LIMITS.between_soc[0]) & (soc <= LIMITS.between_soc[1])
    if np.count_nonzero(used) < LIMITS.least_rests:
        return None
    soc, v = soc[used], v[used]
    fits = [_left(soc, v, low_rate, scale) for scale in SCALES]
    errors = np.array([error for error, _ in fits])
    one = float(np.interp(1.0, SCALES, errors))
    best = int(np.argmin(errors))
    scale, moved = float(SCALES[best]), fits[best][1]
    grid = low_rate.soc
    level = np.maximum.accumulate(low_rate.function.evaluate(grid)) + moved
    at = np.interp(np.array([v[0], v[-1]]), level, grid)
    other = abs(scale - 1.0) > LIMITS.other_capacity and errors[best] < LIMITS.clear * one
    return SampleCheck(
        high_V=float(v[0]),
        low_V=float(v[-1]),
        ocv_Ah=float((at[0] - at[1]) * low_rate.capacity_Ah),
        rests_Ah=float((soc[0] - soc[-1]) * rests.capacity_Ah),
        left_V=float(errors[best]),
        one_cell=not other and float(errors[best]) <= LIMITS.other_shape_V,
    )


def sample_notice(rests: OcvCurve, low_rate: OcvCurve, capacity_Ah: float) -> Notice | None:
    """Notice for a person whose OCV test and pulse test are not of one cell."""
    found = check_samples(rests, low_rate)
    if found is None or found.one_cell:
        return None
    apart = 100.0 * (found.rests_Ah / found.ocv_Ah - 1.0) if found.ocv_Ah > 0.0 else float("nan")
    size_V = RANGE_V * abs(math.log(found.rests_Ah / found.ocv_Ah)) if found.ocv_Ah > 0.0 else 0.0
    text = (
        f"'{low_rate.source}' and '{rests.source}' do not look like one cell: from "
        f"{found.high_V:.3f} to {found.low_V:.3f} V the first moves {found.ocv_Ah:.3f} Ah, the "
        f"second {found.rests_Ah:.3f} Ah ({apart:+.1f} %), and {1e3 * found.left_V:.0f} mV RMS "
        f"are left between them. Two samples, two ages, or a current sensor that is off; SOC "
        f"refers to {capacity_Ah:.3f} Ah"
    )
    return Notice(size_V + found.left_V, text)


def _left(soc: FloatArray, v: FloatArray, low_rate: OcvCurve, scale: float) -> tuple[float, float]:
    """RMS between rests and the curve on a scale, and the constant between them [V]."""
    at = np.clip(1.0 - scale * (1.0 - soc), 0.0, 1.0)
    difference = v - low_rate.function.evaluate(at)
    return float(np.std(difference)), float(np.mean(difference))
