"""How nature's effects may differ from the causes' shapes: a little everywhere along the SOC.

A film on an electrode is not quite an ohmic resistance, a loss of material not quite a shift of the
OCV. What the right cause leaves of its effect is of no use as evidence for a second cause, unless
that explains more than wrong shapes would.
"""

from __future__ import annotations

import numpy as np

from cellwise.diagnose.fit.rows import Evidence
from cellwise.typing import FloatArray

# Standard deviations that are tried, as shares of an effect, and how likely each is. Exact shapes
# first, so that a small effect is not lost for it; on simulated physics, where the right causes
# leave 0.05 to 0.5 of their effects, the logs overrule that by tens of nats.
SHAPE_SHARES = {0.001: 0.9, 0.05: 0.025, 0.1: 0.025, 0.2: 0.025, 0.4: 0.025}
# Over the SOC a wrong shape changes within a tenth of the range.
LEVELS = 10


def wrong_shapes(evidence: Evidence, effects_V: FloatArray, soc: FloatArray) -> FloatArray:
    """Columns that wrong shapes may be made of, for sizes that are shares of the effects.

    Around every level of SOC each effect may be larger or smaller, and what all causes explain
    together may be off by a share of its root mean square in the log.

    Parameters
    ----------
    effects_V : (rows, causes) by how much each cause moves the voltage [V]
    soc : (rows,)

    Returns
    -------
    (rows, LEVELS * (causes + 1)) [V]; without a cause (rows, 0)
    """
    if effects_V.shape[1] == 0:
        return np.zeros((evidence.rows, 0))
    together = np.zeros(evidence.rows)
    for _, rows in evidence.each():
        together[rows] = np.sqrt(np.mean(effects_V[rows].sum(axis=1) ** 2))
    sizes = np.column_stack((effects_V, together))
    place = np.clip(np.nan_to_num(soc), 0.0, 1.0) * (LEVELS - 1)
    near = np.clip(1.0 - np.abs(place[:, None] - np.arange(LEVELS)), 0.0, 1.0)
    return np.asarray(near[:, :, None] * sizes[:, None, :]).reshape(evidence.rows, -1)
