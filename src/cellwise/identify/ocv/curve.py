"""The open-circuit voltage of a cell over SOC: how two sources become one, or are of two cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.notice import RANGE_V, Notice
from cellwise.identify.ocv.ocv_function import MonotoneSpline, fit_monotone_spline
from cellwise.identify.ocv.ocv_points import POINTS, checked_points, leave_out_turns
from cellwise.typing import FloatArray

GRID_INTERVALS = 200


class _Moved(NamedTuple):
    """How a low-rate curve is moved onto rests."""

    cells: int = 20  # of the correction over SOC
    stiffness: tuple[float, ...] = (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)  # one is chosen by rests
    usual: float = 1.0  # with too few rests to leave any out
    # V per unit of SOC: a rest is good for 2 mV and 0.003 of SOC, so beyond this its SOC decides.
    steep_V: float = 0.67


MOVED = _Moved()


@dataclass(frozen=True, eq=False)
class OcvCurve:
    """Open-circuit voltage over SOC, where it came from and how well it is known.

    Parameters
    ----------
    soc, voltage_V : (n,) float              uniform grid from 0 to 1, voltage strictly rising
    capacity_Ah : float                      the capacity that SOC refers to [Ah]
    function : MonotoneSpline                through the points
    points_soc, points_V, points_weight : (m,) float     what was fitted
    discharge_V, charge_V : (n,) or None     low-rate branches on the grid, nan where not measured
    source : str                             log or logs, and method
    notes : tuple of str                     what a person should know
    temperature_C : float or None            median over the test
    """

    soc: FloatArray
    voltage_V: FloatArray
    capacity_Ah: float
    function: MonotoneSpline
    points_soc: FloatArray
    points_V: FloatArray
    points_weight: FloatArray
    discharge_V: FloatArray | None = None
    charge_V: FloatArray | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    temperature_C: float | None = None

    @property
    def gap_V(self) -> FloatArray | None:
        """Charge branch minus discharge branch [V]: hysteresis and polarisation together."""
        if self.charge_V is None or self.discharge_V is None:
            return None
        return self.charge_V - self.discharge_V


def curve_from_points(
    soc: FloatArray,
    voltage_V: FloatArray,
    *,
    capacity_Ah: float,
    weight: FloatArray | None = None,
    discharge_V: FloatArray | None = None,
    charge_V: FloatArray | None = None,
    source: str = "",
    notes: tuple[str, ...] = (),
    temperature_C: float | None = None,
) -> OcvCurve:
    """Fit points of OCV over SOC and hold the result on the uniform grid.

    A spline: over low-rate curves of four chemistries, sampled as rests at every 5 % or 10 % or
    densely, its median error between the points was smaller than that of the LFP paper's form.

    Raises
    ------
    InputError    fewer than four points, SOC far outside 0..1, all at one SOC, voltage that does
                  not rise with SOC
    """
    s, v, w = checked_points(soc, voltage_V, weight)
    function = fit_monotone_spline(s, v, w)
    grid = np.linspace(0.0, 1.0, GRID_INTERVALS + 1)
    return OcvCurve(
        soc=grid,
        voltage_V=function.evaluate(grid),
        capacity_Ah=capacity_Ah,
        function=function,
        points_soc=s,
        points_V=v,
        points_weight=w,
        discharge_V=discharge_V,
        charge_V=charge_V,
        source=source,
        notes=notes,
        temperature_C=temperature_C,
    )


def combine_ocv(rests: OcvCurve, low_rate: OcvCurve) -> OcvCurve:
    r"""Shape of the low-rate curve, level and scale of the rests.

    A low-rate branch sees every bend of the OCV but carries polarisation, and half of the
    hysteresis; rests are relaxed but few. So

    .. math:: OCV(s) = L(s) + c(s)

    with the low-rate curve L and a smooth correction, constant beyond the outermost rests. Rests
    left out, level by level, choose how stiff the correction is. There is one SOC scale, as
    counted: whether both tests are of one cell is for `check_samples`.

    Parameters
    ----------
    rests, low_rate : OcvCurve        SOC of both over the same capacity

    Returns
    -------
    OcvCurve        over the SOC of the rests
    """
    s = rests.points_soc
    difference = rests.points_V - low_rate.function.evaluate(s)
    # Unweighted, the steep ends move by up to 90 mV (Samsung) and the middle by 4 (Panasonic).
    weight = rests.points_weight / (1.0 + (rests.function.slope(s) / MOVED.steep_V) ** 2)
    stiffness = _stiffness(s, difference, weight)
    nodes, correction = _correction(s, difference, weight, stiffness)
    grid = low_rate.soc
    level = low_rate.function.evaluate(grid) + np.interp(grid, nodes, correction)
    left = weight * (difference - np.interp(s, nodes, correction)) ** 2
    notes = [
        f"low-rate curve moved by {1e3 * correction.min():+.1f} to {1e3 * correction.max():+.1f} mV"
        f" to {s.size} rests, {1e3 * np.sqrt(left.sum() / weight.sum()):.1f} mV RMS left"
    ]
    return curve_from_points(
        grid,
        level,
        capacity_Ah=rests.capacity_Ah,
        discharge_V=low_rate.discharge_V,
        charge_V=low_rate.charge_V,
        source=f"{low_rate.source}; {rests.source}",
        notes=(*low_rate.notes, *rests.notes, *notes),
        temperature_C=rests.temperature_C
        if low_rate.temperature_C is None
        else low_rate.temperature_C,
    )


def _stiffness(s: FloatArray, difference: FloatArray, weight: FloatArray) -> float:
    """Stiffness of the correction with the least error at rests that are left out."""
    if s.size < POINTS.fewest + 2:
        return MOVED.usual
    turn = leave_out_turns(s)
    squares = np.zeros(len(MOVED.stiffness))
    for left in (turn == fold for fold in range(int(turn.max()) + 1)):
        for j, stiffness in enumerate(MOVED.stiffness):
            nodes, line = _correction(s[~left], difference[~left], weight[~left], stiffness)
            missed = difference[left] - np.interp(s[left], nodes, line)
            squares[j] += np.sum(weight[left] * missed**2)
    return MOVED.stiffness[int(np.argmin(squares))]


def _correction(
    s: FloatArray, y: FloatArray, w: FloatArray, stiffness: float
) -> tuple[FloatArray, FloatArray]:
    """Straight lines between uniform nodes, least squares with first differences penalised.

    Returns
    -------
    nodes, values : (m,) float
    """
    nodes = np.linspace(0.0, 1.0, MOVED.cells + 1)
    hats = np.maximum(0.0, 1.0 - MOVED.cells * np.abs(np.clip(s, 0, 1)[:, None] - nodes))
    change = np.diff(np.eye(nodes.size), axis=0)
    weighted = hats.T * (w / np.mean(w))
    normal = weighted @ hats + stiffness * MOVED.cells * change.T @ change
    return nodes, np.asarray(np.linalg.solve(normal, weighted @ y))


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
    percent = 100.0 * (found.rests_Ah / found.ocv_Ah - 1.0) if found.ocv_Ah > 0.0 else float("nan")
    size_V = RANGE_V * abs(math.log(found.rests_Ah / found.ocv_Ah)) if found.ocv_Ah > 0.0 else 0.0
    text = (
        f"'{low_rate.source}' and '{rests.source}' do not look like one cell: from "
        f"{found.high_V:.3f} to {found.low_V:.3f} V the first moves {found.ocv_Ah:.3f} Ah, the "
        f"second {found.rests_Ah:.3f} Ah ({percent:+.1f} %), and {1e3 * found.left_V:.0f} mV RMS "
        f"are left between them. Two samples, two ages, or a current sensor that is off; SOC "
        f"refers to {capacity_Ah:.3f} Ah"
    )
    return Notice(size_V + found.left_V, text)


def _left(soc: FloatArray, v: FloatArray, low_rate: OcvCurve, scale: float) -> tuple[float, float]:
    """RMS between rests and the curve on a scale, and the constant between them [V]."""
    at = np.clip(1.0 - scale * (1.0 - soc), 0.0, 1.0)
    difference = v - low_rate.function.evaluate(at)
    return float(np.std(difference)), float(np.mean(difference))
