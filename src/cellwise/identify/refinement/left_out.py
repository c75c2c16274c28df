"""How wrong a model is beyond its temperatures: the coldest and the warmest left out of the fit.

Tables that follow one activation energy are fitted again without the logs of an end, and judged on
these: what the held-out voltage errs by, as a share of the polarisation, is what an activation
that is off by so many kelvin makes over that distance. Tables of several temperatures are held
beyond the last one, so there it is the activation between the last two that is missing.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import TOLERANCE_K
from cellwise.identify.assemble import refined_model
from cellwise.identify.refinement.effects import QUICK_ITERATIONS, QUICK_ROWS, Decision
from cellwise.identify.refinement.model_error import SAME_TEMPERATURE_K, polarisation_V
from cellwise.identify.refinement.problem import StartTables
from cellwise.identify.refinement.refine import refine, residuals_of
from cellwise.identify.refinement.refine_data import PreparedLog, inverse_K
from cellwise.typing import BoolArray, FloatArray

LEAST_LEFT = 2  # temperatures that an activation is fitted to
MIDDLE = (0.1, 0.9)


def activation_std_K(
    decision: Decision, start: StartTables, model: CellModel, capacity_Ah: float, grid_C: FloatArray
) -> float | None:
    """By how much the activation may be off beyond the logs' temperatures, the larger end [K].

    Parameters
    ----------
    decision : Decision       the refinement of all logs
    model : CellModel         what was made of it
    grid_C : (temperatures,) float      with tables of their own, ascending

    Returns
    -------
    float or None             None where too few temperatures were loaded to leave one out
    """
    if grid_C.size > 1:
        return _of_tables(model, grid_C)
    warm = np.array(
        [float(np.median(log.temperature_C(decision.result.reference_C)))
         for log in decision.result.logs]
    )  # fmt: skip
    loaded = np.array([item.compare is None for item in decision.logs])
    found = []
    for end, inwards in ((warm[loaded].min(), 1.0), (warm[loaded].max(), -1.0)):
        held = loaded & (np.abs(warm - end) < SAME_TEMPERATURE_K)
        rest = np.sort(inwards * warm[loaded & ~held])
        if rest.size == 0 or _temperatures(rest) < LEAST_LEFT:
            return None
        # From where a filter begins to widen: within the tolerance a model is taken to hold.
        bound_C = inwards * (rest[0] - TOLERANCE_K)
        away = abs(float(inverse_K(end, bound_C)))
        found.append(math.log1p(_share_left_out(decision, start, held, capacity_Ah)) / away)
    return max(found)


def _temperatures(ascending_C: FloatArray) -> int:
    return 1 + int(np.count_nonzero(np.diff(ascending_C) >= SAME_TEMPERATURE_K))


def _share_left_out(
    decision: Decision, start: StartTables, held: BoolArray, capacity_Ah: float
) -> float:
    """What the voltage errs by more because its logs were left out, over the polarisation."""
    inside, settings = decision.result, decision.settings
    out = np.flatnonzero(held)
    result = refine(
        [decision.logs[k] for k in np.flatnonzero(~held)],
        start,
        settings=replace(settings, iterations=QUICK_ITERATIONS),
        capacity_Ah=capacity_Ah,
        reference_C=inside.reference_C,
        theta=inside.theta,
        most_rows=QUICK_ROWS,
        with_errors=False,
    )
    model = refined_model(result, start, capacity_Ah, skewed=False, hot=True)
    for effect in decision.effects:
        model = model.with_effect(effect)
    logs = [decision.logs[k] for k in out]
    judged = residuals_of(result, start, logs, settings, capacity_Ah, QUICK_ROWS)
    more, drop = 0.0, 0.0
    for k, (log, r) in zip(out, judged, strict=True):
        rows = _above_low_soc(log)
        soc, warm = log.soc[log.evaluate], log.temperature_C(result.reference_C)
        fallen = polarisation_V(model, soc, warm, log.measured_V - r)[rows]
        usual = inside.residual_V[k][_above_low_soc(inside.logs[k])]
        more += max(_mean_square(r[rows]) - _mean_square(usual), 0.0)
        drop += _mean_square(fallen)
    return math.sqrt(more / drop) if drop > 0.0 else 0.0


def _above_low_soc(log: PreparedLog) -> BoolArray:
    """Compared rows above the SOC where a hair of charge is many millivolts; all, if none is."""
    above = log.soc[log.evaluate] > MIDDLE[0]
    return np.asarray(above if above.any() else ~above)


def _mean_square(values_V: FloatArray) -> float:
    return float(np.mean(values_V * values_V))


def _of_tables(model: CellModel, grid_C: FloatArray) -> float:
    """The larger of the activations of the whole resistance between the last two at either end."""
    at = [int(np.argmin(np.abs(model.temperature_C - t))) for t in grid_C]
    rows = (model.soc > MIDDLE[0]) & (model.soc < MIDDLE[1])
    third = np.broadcast_to(model.effect(SlowDiffusion).r3_ohm, model.r0_ohm.shape)
    whole = np.log((model.r0_ohm + model.r1_ohm + model.r2_ohm + third)[at][:, rows])
    slopes = np.diff(whole, axis=0) / np.diff(inverse_K(grid_C, grid_C[0]))[:, None]
    return max(math.sqrt(_mean_square(slope)) for slope in (slopes[0], slopes[-1]))
