"""How long samples wait for their state, in bounded memory however long a stream runs."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

BINS_PER_DOUBLING = 16
SHORTEST_S = 1e-7


class LatencyMeter:
    """Counts of latencies in bins 4 % wide.

    Parameters
    ----------
    deadline_s : float or None      a sample that takes longer is late [s]; None: one that takes
                                    longer than the interval that it ends
    """

    def __init__(self, deadline_s: float | None = None) -> None:
        self.deadline_s = deadline_s
        self.count = self.missed = 0
        self.longest_s = 0.0
        self._bins: Counter[int] = Counter()

    def add(self, latency_s: float, interval_s: float) -> None:
        """One sample, and the interval that it ends [s]."""
        latency_s = max(latency_s, SHORTEST_S)
        deadline_s = interval_s if self.deadline_s is None else self.deadline_s
        self.count += 1
        self.missed += latency_s > deadline_s > 0.0
        self.longest_s = max(self.longest_s, latency_s)
        self._bins[int(BINS_PER_DOUBLING * math.log2(latency_s / SHORTEST_S))] += 1

    def quantile_s(self, share: float) -> float:
        """Latency below which this share of the samples stayed [s], to the bin's width."""
        left = share * self.count
        for place in sorted(self._bins):
            left -= self._bins[place]
            if left <= 0:
                edge = SHORTEST_S * math.exp2((place + 1) / BINS_PER_DOUBLING)
                return min(edge, self.longest_s)
        return math.nan

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON values, in milliseconds."""
        return {
            "p50_ms": 1e3 * self.quantile_s(0.5),
            "p99_ms": 1e3 * self.quantile_s(0.99),
            "max_ms": 1e3 * self.longest_s,
            "deadline_ms": None if self.deadline_s is None else 1e3 * self.deadline_s,
            "missed_deadlines": self.missed,
        }
