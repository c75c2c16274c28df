"""What a log's current reads at rest: a sensor's offset shows there, self-discharge does not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.logs.cell_log import CellLog

# A rest is this long at least, its current this small a share of the capacity (per hour), and its
# readings scatter less than this share.
REST_S = 60.0
SMALL_C = 0.06
QUIET_C = 0.02
# How well a reading at rest determines the offset; a load that never switches off may look like a
# rest, so a reading other than zero never outweighs the voltage by more than MOST nats.
STD_C = 0.001
MOST = 12.0
ZERO_STDS = 3.0


@dataclass(frozen=True)
class RestReading:
    """Mean reading at rest [A] and its standard deviation; None if the log never rests."""

    mean_A: float | None
    std_A: float

    @property
    def zero(self) -> bool:
        """Whether the sensor reads nothing where nothing flows: then it has no offset."""
        return self.mean_A is not None and abs(self.mean_A) < ZERO_STDS * self.std_A

    def ln_likelihood(self, z: Mapping[str, float]) -> float:
        """Ln likelihood of a sensor offset; at least -MOST where the reading may be a load."""
        if self.mean_A is None:
            return 0.0
        away = (z.get("offset_A", 0.0) - self.mean_A) / self.std_A
        square = 0.5 * away * away
        return -(square if self.zero else min(square, MOST))


NO_READING = RestReading(None, 1.0)


def rest_reading(logs: Sequence[CellLog], capacity_Ah: float) -> RestReading:
    """Mean reading over all rests of the logs that agree with each other, or that read nothing."""
    means = []
    for log in logs:
        current = log.current_A
        small = np.isfinite(current) & (np.abs(current) < SMALL_C * capacity_Ah)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], small.astype(np.int8), [0]))))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if log.time_s[stop - 1] - log.time_s[start] >= REST_S:
                part = current[start:stop]
                if float(np.std(part)) < QUIET_C * capacity_Ah:
                    means.append(float(np.median(part)))
    std = STD_C * capacity_Ah
    nothing = [m for m in means if abs(m) < ZERO_STDS * std]
    if nothing:
        # Small loads read what they are; a sensor with an offset reads nothing nowhere.
        return RestReading(float(np.median(nothing)), std)
    if not means or float(np.std(means)) > 4.0 * std:
        return RestReading(None, std)
    return RestReading(float(np.median(means)), std)
