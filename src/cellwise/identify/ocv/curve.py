"""The open-circuit voltage of a cell over SOC: the record, and how two sources become one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.ocv.ocv_fit import OcvFit, fit_ocv_function
from cellwise.identify.ocv.ocv_functions import OcvFunction, OcvKind, uniform_grid
from cellwise.identify.ocv.ocv_points import MIN_POINTS, leave_out_turns
from cellwise.typing import FloatArray

GRID_INTERVALS = 200
CORRECTION_CELLS = 20
STIFFNESS = 10.0 ** np.arange(-3.0, 3.0)
USUAL_STIFFNESS = 1.0
# Capacity in the low-rate test over that of the cell when it rested: 1 and steps to both sides.
STRETCH_STEP = 0.005
COARSE_STEPS = range(-16, 17, 2)
# What a rest is good for: its voltage, and its SOC by the counter.
REST_ERROR_V, SOC_ERROR = 2e-3, 3e-3
CLEAR_GAIN = 0.9
SLOPE_BELOW_EMPTY_V = 5.0
SAME_CAPACITY = 1e-3


@dataclass(frozen=True, eq=False)
class OcvCurve:
    """Open-circuit voltage over SOC, where it came from and how well it is known.

    Parameters
    ----------
    soc, voltage_V : (n,) float              uniform grid from 0 to 1, voltage strictly rising
    capacity_Ah : float                      the capacity that SOC refers to [Ah]
    fit : OcvFit                             the function, and its residuals at the points
    points_soc, points_V, points_weight : (m,) float     what was fitted
    discharge_V, charge_V : (n,) or None     low-rate branches on the grid, nan where not measured
    source : str                             log or logs, and method
    notes : tuple of str                     what a person should know
    temperature_C : float or None            median over the test
    stretch : float                          by which bends of rests and low rate lie apart, see
                                             :func:`combine_ocv`; nothing is stretched by it
    """

    soc: FloatArray
    voltage_V: FloatArray
    capacity_Ah: float
    fit: OcvFit
    points_soc: FloatArray
    points_V: FloatArray
    points_weight: FloatArray
    discharge_V: FloatArray | None = None
    charge_V: FloatArray | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    temperature_C: float | None = None
    stretch: float = 1.0

    @property
    def function(self) -> OcvFunction:
        """The fitted function of SOC."""
        return self.fit.function

    @property
    def gap_V(self) -> FloatArray | None:
        """Charge branch minus discharge branch [V]: hysteresis and polarisation together."""
        if self.charge_V is None or self.discharge_V is None:
            return None
        return self.charge_V - self.discharge_V

    def grid(self, intervals: int) -> tuple[FloatArray, FloatArray]:
        """SOC and voltage at ``intervals + 1`` uniform steps from 0 to 1."""
        return uniform_grid(self.function, intervals)


def curve_from_points(
    soc: FloatArray,
    voltage_V: FloatArray,
    *,
    capacity_Ah: float,
    weight: FloatArray | None = None,
    kind: OcvKind | None = None,
    discharge_V: FloatArray | None = None,
    charge_V: FloatArray | None = None,
    source: str = "",
    notes: tuple[str, ...] = (),
    temperature_C: float | None = None,
    stretch: float = 1.0,
) -> OcvCurve:
    """Fit points of OCV over SOC and hold the result on the uniform grid.

    ``kind`` None is the spline: over low-rate curves of four chemistries, sampled as rests at
    every 5 % or 10 % or densely, its median error between the points was the smallest each time.
    """
    fit = fit_ocv_function(soc, voltage_V, kind or "spline", weight=weight)
    grid, level = uniform_grid(fit.function, GRID_INTERVALS)
    return OcvCurve(
        soc=grid,
        voltage_V=level,
        capacity_Ah=capacity_Ah,
        fit=fit,
        points_soc=fit.soc,
        points_V=fit.function.evaluate(fit.soc) + fit.residual_V,
        points_weight=fit.weight,
        discharge_V=discharge_V,
        charge_V=charge_V,
        source=source,
        notes=notes,
        temperature_C=temperature_C,
        stretch=stretch,
    )


def combine_ocv(rests: OcvCurve, low_rate: OcvCurve, kind: OcvKind | None = None) -> OcvCurve:
    r"""Shape of the low-rate curve, level and scale of the rests.

    A low-rate branch sees every bend of the OCV but carries polarisation, and half of the
    hysteresis; rests are relaxed but few. So

    .. math:: OCV(s) = L(s) + c(s)

    with the low-rate curve L and a smooth correction, constant beyond the outermost rests. Rests
    left out, level by level, choose how stiff the correction is. There is one SOC scale: where
    bends of the two tests lie apart, as if the cell had held another capacity in the one or its
    current sensor had been off, a note says by how much, and the curve stays as counted.

    Parameters
    ----------
    rests, low_rate : OcvCurve        SOC of both over the same capacity
    kind : str                        form of the result's function, default the spline

    Returns
    -------
    OcvCurve        over the SOC of the rests

    Raises
    ------
    InputError      SOC of the two refers to different capacities
    """
    if abs(rests.capacity_Ah / low_rate.capacity_Ah - 1.0) > SAME_CAPACITY:
        raise InputError(
            f"OCV curves over {rests.capacity_Ah:.4f} Ah and over {low_rate.capacity_Ah:.4f} Ah",
            "one capacity for both",
            "Make both with the same capacity_Ah.",
        )
    apart, _ = _choose_correction(rests, low_rate)
    stiffness = _stiffness(rests, low_rate)
    s = rests.points_soc
    difference = rests.points_V - low_rate.function.evaluate(s)
    weight = _weights(rests)
    nodes, (correction,) = _penalised_lines(s, difference, weight, np.array([stiffness]))
    grid = low_rate.soc
    level = low_rate.function.evaluate(grid) + np.interp(grid, nodes, correction)
    left = weight * (difference - np.interp(s, nodes, correction)) ** 2
    notes = [
        f"low-rate curve moved by {1e3 * correction.min():+.1f} to {1e3 * correction.max():+.1f} mV"
        f" to {s.size} rests, {1e3 * np.sqrt(left.sum() / weight.sum()):.1f} mV RMS left"
    ]
    if apart != 1.0:
        held = low_rate.capacity_Ah / apart
        notes.append(
            f"the rests lie on the low-rate curve as if the cell had held {held:.3f} Ah, not "
            f"{low_rate.capacity_Ah:.3f} Ah: another capacity then, or a current sensor that was "
            "off in one of the tests. SOC stays as counted, and the model is a compromise"
        )
    return curve_from_points(
        grid,
        level,
        capacity_Ah=rests.capacity_Ah,
        kind=kind,
        discharge_V=low_rate.discharge_V,
        charge_V=low_rate.charge_V,
        source=f"{low_rate.source}; {rests.source}",
        notes=(*low_rate.notes, *rests.notes, *notes),
        temperature_C=rests.temperature_C
        if low_rate.temperature_C is None
        else low_rate.temperature_C,
        stretch=apart,
    )


def _stiffness(rests: OcvCurve, low_rate: OcvCurve) -> float:
    """Stiffness of the correction with the least error at rests that are left out."""
    if rests.points_soc.size < MIN_POINTS + 2:
        return USUAL_STIFFNESS
    return float(STIFFNESS[int(np.argmin(_left_out_errors(rests, low_rate, 1.0)))])


def _choose_correction(rests: OcvCurve, low_rate: OcvCurve) -> tuple[float, float]:
    """Stretch and stiffness with the least error at rests that are left out, level by level."""
    if rests.points_soc.size < MIN_POINTS + 2:
        return 1.0, USUAL_STIFFNESS
    errors = {k: _left_out_errors(rests, low_rate, 1.0 + k * STRETCH_STEP) for k in COARSE_STEPS}
    coarse = min(errors, key=lambda k: errors[k].min())
    errors |= {
        k: _left_out_errors(rests, low_rate, 1.0 + k * STRETCH_STEP)
        for k in (coarse - 1, coarse + 1)
    }
    best = min(errors, key=lambda k: errors[k].min())
    if errors[best].min() > CLEAR_GAIN**2 * errors[0].min():
        best = 0
    return 1.0 + best * STRETCH_STEP, float(STIFFNESS[int(np.argmin(errors[best]))])


def _left_out_errors(rests: OcvCurve, low_rate: OcvCurve, stretch: float) -> FloatArray:
    """Mean squared error at left-out rests for every stiffness [V2], shape of ``STIFFNESS``."""
    s = rests.points_soc
    difference = rests.points_V - _stretched(low_rate.function, s, stretch)
    w = _weights(rests)
    turn = leave_out_turns(s, keep_ends=False)
    squares = np.zeros(STIFFNESS.size)
    for fold in range(int(turn.max()) + 1):
        left = turn == fold
        nodes, lines = _penalised_lines(s[~left], difference[~left], w[~left], STIFFNESS)
        for j, line in enumerate(lines):
            squares[j] += np.sum(
                w[left] * (difference[left] - np.interp(s[left], nodes, line)) ** 2
            )
    return squares / float(np.sum(w))


def _weights(rests: OcvCurve) -> FloatArray:
    """Weights of the rests: less where the curve is steep, where SOC errors are volts."""
    by_soc = rests.function.slope(rests.points_soc) * SOC_ERROR
    return np.asarray(rests.points_weight / (1.0 + (by_soc / REST_ERROR_V) ** 2))


def _stretched(function: OcvFunction, soc: FloatArray, stretch: float) -> FloatArray:
    """Low-rate curve at the SOC of a cell with another capacity; gently on below its empty end."""
    at = 1.0 - stretch * (1.0 - soc)
    inside = np.clip(at, 0.0, 1.0)
    return function.evaluate(inside) + SLOPE_BELOW_EMPTY_V * (at - inside)


def _penalised_lines(
    s: FloatArray, y: FloatArray, w: FloatArray, stiffness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Straight lines between uniform nodes, least squares with first differences penalised.

    Returns
    -------
    nodes : (m,) float
    lines : (k, m) float        one per stiffness
    """
    nodes = np.linspace(0.0, 1.0, CORRECTION_CELLS + 1)
    hats = np.maximum(0.0, 1.0 - CORRECTION_CELLS * np.abs(np.clip(s, 0, 1)[:, None] - nodes))
    change = np.diff(np.eye(nodes.size), axis=0)
    weighted = hats.T * (w / np.mean(w))
    penalty = CORRECTION_CELLS * change.T @ change
    normal = weighted @ hats + stiffness[:, None, None] * penalty
    right = np.broadcast_to((weighted @ y)[:, None], (stiffness.size, nodes.size, 1))
    return nodes, np.asarray(np.linalg.solve(normal, right)[:, :, 0])
