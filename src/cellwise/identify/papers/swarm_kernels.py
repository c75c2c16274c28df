"""Compiled cost of a particle: one pass over the samples of a pulse."""

from __future__ import annotations

import math

from cellwise.cell.compiled import cached
from cellwise.identify.pulse_fit.varpro_kernels import SAME_INTERVAL, Window
from cellwise.typing import FloatArray


@cached()
def swarm_costs(
    window: Window,
    positions: FloatArray,
    costs: FloatArray,
) -> None:
    """Weighted sum of squared residuals of every particle [V^2].

    Parameters
    ----------
    window : Window                   its trend is not used
    positions : (m, 7) float          R0, R1, tau1, R2, tau2, OCV minus reference, OCV slope
    costs : (m,) float                result; infinite where tau1 >= tau2
    """
    dt, current, known, dq, weight, _, centre = window
    for p in range(positions.shape[0]):
        r0, r1, tau1 = positions[p, 0], positions[p, 1], positions[p, 2]
        r2, tau2, ocv, slope = (
            positions[p, 3], positions[p, 4], positions[p, 5], positions[p, 6],
        )  # fmt: skip
        if tau1 >= tau2:
            costs[p] = math.inf
            continue
        v1 = v2 = total = 0.0
        a1 = a2 = 0.0
        last_dt = -1.0
        for k in range(dt.size):
            if abs(dt[k] - last_dt) > SAME_INTERVAL * dt[k]:
                last_dt = dt[k]
                a1 = math.exp(-dt[k] / tau1)
                a2 = math.exp(-dt[k] / tau2)
            v1 = r1 * current[k] + a1 * (v1 - r1 * current[k])
            v2 = r2 * current[k] + a2 * (v2 - r2 * current[k])
            error = known[k] - (ocv + slope * (centre - dq[k]) - r0 * current[k] - v1 - v2)
            total += weight[k] * error * error
        costs[p] = total
