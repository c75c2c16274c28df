"""What a start that was read from a voltage would have been read as, were a cause there.

A rest at the start of a log shows an OCV, and its SOC is where the model has that OCV. Where the
sensor is off by a voltage, the cell's OCV has changed or has a hysteresis, the same rest means
another SOC: what is known beforehand of a start holds for its reading, whatever its SOC then is.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellwise.cell.point_kernels import OCV, M
from cellwise.cell.simulate import start_hysteresis
from cellwise.diagnose.causes.coordinates import LOSS_NAMES, OCV_NAMES, Coordinates
from cellwise.diagnose.fit.rows import Evidence
from cellwise.typing import FloatArray

# Over so much SOC the slope of the OCV is taken, as a rest is read to about that.
ABOUT_SOC = 0.01
# On a flatter plateau a rest reads nothing, and the logs say so themselves [V].
LEAST_SLOPE_V = 0.02
READ_WITH = frozenset({"offset_V", "m_V", *OCV_NAMES, *LOSS_NAMES})


def start_readings(
    names: Collection[str], coordinates: Coordinates, evidence: Evidence
) -> dict[str, dict[str, float]]:
    """By how much a unit of each coordinate moves the SOC that each start stands for.

    Of the starts that were read from a voltage, and the coordinates in ``names`` that change what
    such a reading means: start to coordinate to change of SOC per unit.
    """
    asked = [n for n in names if n in READ_WITH]
    read = [
        (name, log)
        for name, log in zip(evidence.starts(), evidence.logs, strict=True)
        if log.start.how != "given"
    ]
    if not asked or not read:
        return {}
    soc = coordinates.model.soc
    inputs = coordinates.inputs({})
    moved: dict[str, FloatArray] = {}
    for n in asked:
        direction = None if n == "offset_V" else coordinates.table_direction(n, inputs)
        column = M if n == "m_V" else OCV
        moved[n] = np.ones(soc.size) if direction is None else direction[0, :, column]
    found: dict[str, dict[str, float]] = {}
    for name, log in read:
        at = (log.start.beginning or log.start).soc
        ends = np.clip([at - ABOUT_SOC, at + ABOUT_SOC], soc[0], soc[-1])
        ocv = coordinates.model.ocv_at(float(log.temperature_C[0]))
        low, high = np.interp(ends, soc, ocv)
        slope = max(float(high - low) / float(ends[1] - ends[0]), LEAST_SLOPE_V)
        found[name] = {n: -float(np.interp(at, soc, v)) / slope for n, v in moved.items()}
        if "m_V" in moved:  # as much of it as a log is taken to start with
            found[name]["m_V"] *= start_hysteresis(at)
    return found
