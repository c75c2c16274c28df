"""Samples in, updates out, until the stream ends or somebody stops it."""

from __future__ import annotations

import gc
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.estimate.status import Status
from cellwise.live.live_filter import LiveFilter, Update
from cellwise.live.samples import Source, Stray
from cellwise.wording import arg

MOST_REASONS = 50  # why something was no sample; more are counted together
LATENCIES = 50_000  # the last ones that are kept


class LatencyMeter:
    """How long samples wait for their state: the longest wait, and shares of the last ones.

    Parameters
    ----------
    deadline_s : float or None      a sample that takes longer is late [s]; None: one that takes
                                    longer than the interval that it ends
    """

    def __init__(self, deadline_s: float | None = None) -> None:
        self.deadline_s = deadline_s
        self.count = self.missed = 0
        self.longest_s = 0.0
        self._last: deque[float] = deque(maxlen=LATENCIES)

    def add(self, latency_s: float, interval_s: float) -> None:
        """One sample, and the interval that it ends [s]."""
        latency_s = max(latency_s, 0.0)  # clocks are set back
        deadline_s = interval_s if self.deadline_s is None else self.deadline_s
        self.count += 1
        self.missed += latency_s > deadline_s > 0.0
        self.longest_s = max(self.longest_s, latency_s)
        self._last.append(latency_s)

    def quantile_s(self, share: float) -> float:
        """Latency below which this share of the last samples stayed [s]; NaN before the first."""
        return float(np.quantile(self._last, share)) if self._last else float("nan")

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON values, in milliseconds."""
        return {
            "p50_ms": 1e3 * self.quantile_s(0.5),
            "p99_ms": 1e3 * self.quantile_s(0.99),
            "max_ms": 1e3 * self.longest_s,
            "deadline_ms": None if self.deadline_s is None else 1e3 * self.deadline_s,
            "missed_deadlines": self.missed,
        }


@dataclass
class Counts:
    """What came so far. ``late`` samples were older than the one before or had a broken stamp.

    ``outside`` samples lay beyond the SOC, temperature and current of the model's data, ``invalid``
    ones had no voltage that could be used.
    """

    samples: int = 0
    late: int = 0
    unused: int = 0
    gaps: int = 0
    outside: int = 0
    invalid: int = 0
    stray: Counter[str] = field(default_factory=Counter)
    latency: LatencyMeter = field(default_factory=LatencyMeter)
    last: Update | None = None

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "samples": self.samples,
            "late": self.late,
            "before_start": self.unused,
            "gaps": self.gaps,
            "outside": self.outside,
            "stray": dict(self.stray),
            "latency": self.latency.to_dict() if self.samples else None,
        }


def run_live(
    source: Source,
    live: LiveFilter,
    take: Callable[[Update], None],
    *,
    counts: Counts | None = None,
    look: Callable[[Counts], None] | None = None,
    state: Path | str | None = None,
    save_every_s: float = 10.0,
    most_samples: int | None = None,
    idle_s: float | None = None,
) -> Counts:
    """Feed a stream to a filter.

    Parameters
    ----------
    source : Source
    live : LiveFilter
    take : callable             gets every update
    counts : Counts or None     to count into; None: new ones
    look : callable or None     called with the counts, also while nothing comes
    state : path or None        where the state is put away, every ``save_every_s`` and at the end,
                                whatever ends the stream
    most_samples : int or None  stop after so many
    idle_s : float or None      stop when nothing has come for so long

    Returns
    -------
    Counts

    Raises
    ------
    InputError                  the source gives up
    """
    counts = Counts() if counts is None else counts
    # What was loaded (compilers, above all) stays: searching it for garbage takes tens of ms.
    gc.collect()
    gc.freeze()
    saved_s = heard_s = time.monotonic()
    try:
        for item in source:
            now_s = time.monotonic()
            if item is None:
                if idle_s is not None and now_s - heard_s > idle_s:
                    break
            elif isinstance(item, Stray):
                heard_s = now_s
                known = item.reason in counts.stray or len(counts.stray) < MOST_REASONS
                counts.stray[item.reason if known else "other"] += 1
            else:
                heard_s = now_s
                update = live.take(item)
                if update is None:
                    counts.late += live.state is not None
                    counts.unused += live.state is None
                else:
                    take(update)
                    counts.samples += 1
                    counts.gaps += update.gap
                    counts.outside += bool(update.info.status & Status.OUTSIDE)
                    counts.invalid += bool(update.info.status & Status.VOLTAGE_INVALID)
                    counts.last = update
                    counts.latency.add(time.time() - item.arrived_s, update.dt_s)
                    if counts.samples == most_samples:
                        break
            if look is not None:
                look(counts)
            if state is not None and now_s - saved_s >= save_every_s:
                live.save(state, time.time())
                saved_s = now_s
    except KeyboardInterrupt:
        pass  # the usual end of a stream
    finally:
        if state is not None:
            live.save(state, time.time())
        source.close()
        gc.unfreeze()
    return counts


def check_any(source: Source, counts: Counts) -> None:
    """Refuse a stream that held nothing.

    Raises
    ------
    InputError          not one sample; none with a voltage that a cell can have
    """
    if counts.samples and counts.invalid == counts.samples and counts.last is not None:
        raise InputError(
            f"{counts.samples} samples in {source.name} and no voltage of a cell among them (the "
            f"last is {counts.last.sample.voltage_V:.4g} V)",
            "the voltage of one cell, or a pack's with its cells in series",
            "State " + arg("series", letter="N") + ", or check the channel and its unit.",
        )
    if counts.samples:
        return
    strays = ", ".join(f"{reason}: {n}" for reason, n in counts.stray.most_common(3))
    if counts.unused:
        strays = f"{counts.unused} without a possible current and voltage; {strays}".rstrip("; ")
    raise InputError(
        f"no sample in {source.name} ({strays or 'nothing came'})",
        "samples with current and voltage",
        "Check the source, its channels, their units and the cells in series.",
    )
