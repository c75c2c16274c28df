"""How large faults of sensors and changes of cells are: priors that are no normal distribution.

A fit takes every cause as normally distributed about neutral, as wide as
:mod:`cellwise.diagnose.causes.catalogue` says. What is known of sizes is more than that: a cell
loses capacity and gains resistance, and a sensor keeps its class but for the few that were
configured wrongly. How much likelier or less likely that makes a size is added to the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from cellwise.diagnose.fit.least_squares import Prior

# Standard deviation below and above neutral. A cell is retired at 0.7 to 0.8 of its capacity;
# cells of one batch differ by 1 %, and none grows (Rumpf et al. 2017, 10.1016/j.est.2017.09.010).
# Until then its resistance grows by up to a half, at times to the double; what makes it fall is
# warmth (Schmalstieg et al. 2014, 10.1016/j.jpowsour.2014.02.012).
# Charge transfer is about a third of it and may have all of the growth.
AGE = {
    "ln_capacity": (0.12, 0.02),
    "ln_scale": (0.1, 0.4),
    "added_r0": (0.1, 0.4),
    "ln_r1": (0.3, 1.2),
}
# Beside a good log of the same cell: months apart, not a life.
SAME_AGE = {
    "ln_capacity": (0.03, 0.02),
    "ln_scale": (0.05, 0.1),
    "added_r0": (0.05, 0.1),
    "ln_r1": (0.15, 0.3),
}
# Of a class, and of those that are configured or wired wrongly, a few in a hundred. Current sensors
# of vehicles keep 1 to 3 % over temperature and life, shunts ten times better; cell monitors keep
# 1 to 9 mV by their data sheets.
CLASS = {"ln_gain": (0.02, 0.2), "offset_V": (0.005, 0.05)}
WRONG_SHARE = 0.03


def ln_size(
    z: Mapping[str, float], names: Iterable[str], prior: Prior, same_age: bool = False
) -> float:
    """Ln of how much likelier the sizes of causes are than the prior of the fit says.

    Parameters
    ----------
    z : the point; names : coordinates of causes; prior : what the fit took them for
    same_age : whether a good log of the same cell is known
    """
    total, age = 0.0, SAME_AGE if same_age else AGE
    for name in names:
        x, wide = z.get(name, 0.0), prior.std.get(name)
        if wide is None:
            continue
        if name in age:
            below, above = age[name]
            std = below if x < 0.0 else above
            total += math.log(2.0 * wide / (below + above)) + _ln_normal(x, std, wide)
        elif name in CLASS:
            usual, other = CLASS[name]
            within = math.log((1.0 - WRONG_SHARE) * wide / usual) + _ln_normal(x, usual, wide)
            wrong = math.log(WRONG_SHARE * wide / other) + _ln_normal(x, other, wide)
            total += max(within, wrong) + math.log1p(math.exp(-abs(within - wrong)))
    return total


def _ln_normal(x: float, std: float, wide: float) -> float:
    """Ln of one normal density over another, both without their factor before the exponential."""
    return -0.5 * x * x * (1.0 / std**2 - 1.0 / wide**2)
