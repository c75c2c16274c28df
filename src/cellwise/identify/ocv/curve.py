"""The open-circuit voltage of a cell over SOC: how two sources become one, or are of two cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from cellwise.cell.plausibility.notice import RANGE_V, Notice
from cellwise.identify.ocv.ocv_function import MonotoneSpline, checked_points, fit_monotone_spline
from cellwise.typing import FloatArray

GRID_INTERVALS = 200


class _Moved(NamedTuple):
    """How a low-rate curve is moved onto rests."""

    cells: int = 20  # of the correction over SOC
    stiffness: float = 0.1  # V^2 of a step over its cell against V^2 of a rest
    # V per unit of SOC: a rest is good for 2 mV and 0.003 of SOC, so beyond this its SOC decides.
    steep_V: float = 0.67


class _Limits(NamedTuple):
    """What separates two cells from one."""

    between_soc: tuple[float, float] = (0.08, 0.97)  # at the steep ends rests say nothing of charge
    least_rests: int = 5
    scales: tuple[float, float] = (0.7, 1.4)  # of the charge of one over that of the other
    other_capacity: float = 0.03  # counters and rests cut short differ by less
    clear: float = 0.7  # error on the better scale over that on one scale
    other_shape_V: float = 0.015  # beyond: another chemistry, or a cell of another age


MOVED, LIMITS = _Moved(), _Limits()


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
        grid,
        function.evaluate(grid),
        capacity_Ah,
        function,
        s,
        v,
        w,
        discharge_V,
        charge_V,
        source,
        notes,
    )


def combine_ocv(rests: OcvCurve, low_rate: OcvCurve) -> OcvCurve:
    r"""Shape of the low-rate curve, level and scale of the rests.

    A low-rate branch sees every bend of the OCV but carries polarisation, and half of the
    hysteresis; rests are relaxed but few. So

    .. math:: OCV(s) = L(s) + c(s)

    with the low-rate curve L and a smooth correction: straight lines between uniform nodes, least
    squares with first differences penalised, constant beyond the outermost rests. There is one SOC
    scale, as counted: whether both tests are of one cell is for `sample_notice`.

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
    nodes = np.linspace(0.0, 1.0, MOVED.cells + 1)
    hats = np.maximum(0.0, 1.0 - MOVED.cells * np.abs(np.clip(s, 0, 1)[:, None] - nodes))
    change = np.diff(np.eye(nodes.size), axis=0)
    weighted = hats.T * (weight / np.mean(weight))
    normal = weighted @ hats + MOVED.stiffness * MOVED.cells * change.T @ change
    correction = np.linalg.solve(normal, weighted @ difference)
    grid = low_rate.soc
    left_V = np.sqrt(np.average((difference - hats @ correction) ** 2, weights=weight))
    note = (
        f"low-rate curve moved by {1e3 * correction.min():+.1f} to {1e3 * correction.max():+.1f} mV"
        f" to {s.size} rests, {1e3 * left_V:.1f} mV RMS left"
    )
    return curve_from_points(
        grid,
        low_rate.function.evaluate(grid) + np.interp(grid, nodes, correction),
        capacity_Ah=rests.capacity_Ah,
        discharge_V=low_rate.discharge_V,
        charge_V=low_rate.charge_V,
        source=f"{low_rate.source}; {rests.source}",
        notes=(*low_rate.notes, *rests.notes, note),
    )


def sample_notice(rests: OcvCurve, low_rate: OcvCurve, capacity_Ah: float) -> Notice | None:
    """Notice for a person whose OCV test and pulse test are not of one cell.

    The rests are laid on the low-rate curve with a scale of their charge, and a constant beside it:
    the curve carries half the hysteresis and its polarisation. None too with too few rests.

    Parameters
    ----------
    rests, low_rate : OcvCurve        SOC of both over one capacity
    """
    inside = (rests.points_soc >= LIMITS.between_soc[0]) & (
        rests.points_soc <= LIMITS.between_soc[1]
    )
    soc, v = rests.points_soc[inside], rests.points_V[inside]
    if soc.size < LIMITS.least_rests:
        return None

    def away_V(scale: float) -> FloatArray:
        at = np.clip(1.0 - scale * (1.0 - soc), 0.0, 1.0)
        return v - low_rate.function.evaluate(at)

    best = minimize_scalar(lambda k: np.std(away_V(k)), bounds=LIMITS.scales, method="bounded")
    scale, left_V = float(best.x), float(best.fun)
    other = abs(scale - 1.0) > LIMITS.other_capacity and left_V < LIMITS.clear * np.std(away_V(1.0))
    if not other and left_V <= LIMITS.other_shape_V:
        return None
    level = np.maximum.accumulate(low_rate.voltage_V) + float(np.mean(away_V(scale)))
    at = np.interp(v[[0, -1]], level, low_rate.soc)
    moved_Ah = max(float(np.ptp(at)) * low_rate.capacity_Ah, 1e-3 * capacity_Ah)
    rests_Ah = float(np.ptp(soc)) * rests.capacity_Ah
    text = (
        f"'{low_rate.source}' and '{rests.source}' do not look like one cell: from "
        f"{v[-1]:.3f} to {v[0]:.3f} V the first moves {moved_Ah:.3f} Ah, the second "
        f"{rests_Ah:.3f} Ah ({100.0 * (rests_Ah / moved_Ah - 1.0):+.1f} %), and "
        f"{1e3 * left_V:.0f} mV RMS are left between them. Two samples, two ages, or a current "
        f"sensor that is off; SOC refers to {capacity_Ah:.3f} Ah"
    )
    return Notice(RANGE_V * abs(math.log(rests_Ah / moved_Ah)) + left_V, text)
