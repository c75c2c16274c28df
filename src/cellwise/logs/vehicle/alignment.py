"""Channels that are sampled apart, brought to one clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.gaps import find_gaps
from cellwise.typing import BoolArray, FloatArray

FASTER = 1.5  # samples of current per sample of voltage, from which on the current is averaged


class Series(NamedTuple):
    """A channel with stamps of its own [s]."""

    time_s: FloatArray
    values: FloatArray


def aligned(series: Mapping[str, Series], where: str) -> tuple[dict[str, FloatArray], list[str]]:
    """Rows at the stamps of the voltage, with what the other channels were then.

    A current that is sampled faster than the voltage becomes its mean over the interval that ends
    at the row, so that no charge is lost; a slower one, or one sampled at other moments, is
    interpolated. Where the current pauses for long it is missing (NaN), never bridged. Temperature
    and counter are interpolated.

    Parameters
    ----------
    series : mapping        field of `CellLog` to samples, with ``current_A`` and ``voltage_V``
    where : str             for messages

    Raises
    ------
    InputError              current and voltage have no time in common
    """
    clean = {field: _in_order(samples) for field, samples in series.items()}
    voltage, current = clean["voltage_V"], clean["current_A"]
    channels: dict[str, FloatArray] = {}
    if all(np.array_equal(voltage.time_s, s.time_s) for s in clean.values()):
        return {"time_s": voltage.time_s, **{f: s.values for f, s in clean.items()}}, []
    if voltage.time_s.size == 0 or current.time_s.size == 0:
        raise InputError(f"no samples in {where}", "voltage and current", "Check the recording.")
    inside = (voltage.time_s >= current.time_s[0]) & (voltage.time_s <= current.time_s[-1])
    if np.count_nonzero(inside) < 2:
        raise InputError(
            f"current from {current.time_s[0]:.3f} to {current.time_s[-1]:.3f} s and voltage from "
            f"{voltage.time_s[0]:.3f} to {voltage.time_s[-1]:.3f} s in {where}",
            "channels that were recorded at the same time",
            "Choose channels of one recording with `channels={...}`.",
        )
    time = voltage.time_s[inside]
    channels = {"time_s": time, "voltage_V": voltage.values[inside]}
    per_row = current.time_s.size / voltage.time_s.size
    at_rows = _mean_between(current, time) if per_row > FASTER else _between(current, time)
    channels["current_A"] = np.where(_paused(current, time), np.nan, at_rows)
    for field, samples in clean.items():
        if field not in channels and samples.time_s.size:
            channels[field] = _between(samples, time)
    notices = []
    if not np.array_equal(voltage.time_s, current.time_s):
        how = "averaged" if per_row > FASTER else "interpolated"
        notices.append(
            f"voltage and current are sampled apart: the current was {how} to the voltage's rows"
        )
    lost = voltage.time_s.size - time.size
    if lost:
        notices.append(f"{lost} row(s) before the first or after the last current left out")
    return channels, notices


def _in_order(samples: Series) -> Series:
    """Samples with a value, in the order of their stamps, the last of several at one stamp."""
    known = np.isfinite(samples.time_s) & np.isfinite(samples.values)
    time, values = samples.time_s[known], samples.values[known]
    if time.size > 1 and np.any(np.diff(time) <= 0):
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
        last = np.append(np.diff(time) > 0, True)
        time, values = time[last], values[last]
    return Series(time, values)


def _between(samples: Series, time: FloatArray) -> FloatArray:
    return np.interp(time, samples.time_s, samples.values)


def _mean_between(samples: Series, time: FloatArray) -> FloatArray:
    """Mean over the interval that ends at each row, by the trapezoids of the samples."""
    step = np.diff(samples.time_s)
    area = np.concatenate(
        ([0.0], np.cumsum(0.5 * (samples.values[1:] + samples.values[:-1]) * step))
    )
    # The integral within a trapezoid is a parabola; at the rows it is taken exactly.
    k = np.clip(np.searchsorted(samples.time_s, time, side="right") - 1, 0, step.size - 1)
    into = time - samples.time_s[k]
    slope = (samples.values[k + 1] - samples.values[k]) / step[k]
    at = area[k] + into * (samples.values[k] + 0.5 * slope * into)
    interval = np.diff(time)
    mean = np.empty_like(time)
    mean[0] = np.interp(time[0], samples.time_s, samples.values)
    mean[1:] = np.diff(at) / interval
    return mean


def _paused(samples: Series, time: FloatArray) -> BoolArray:
    """Rows inside a pause of the channel, shape (n,) bool."""
    gaps = find_gaps(samples.time_s)
    after = np.searchsorted(samples.time_s, time, side="left")
    after = np.minimum(after, samples.time_s.size - 1)
    exact = samples.time_s[after] == time
    paused: BoolArray = gaps[after] & ~exact
    return paused
