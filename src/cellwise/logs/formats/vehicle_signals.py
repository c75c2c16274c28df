"""Signals of a vehicle's recording: which is the battery's, their values, one clock for all.

Names of signals differ by maker, so they are only taken when units and names leave one choice.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.choice import MissingColumnsError, tidy_of
from cellwise.logs.files.columns import (
    REQUIRED,
    TIDY_NAME,
    Unit,
    folded,
    listed,
    named_units,
    no_such_name,
    tidy_name,
)
from cellwise.logs.files.words import WORDS, words_of
from cellwise.logs.gaps import find_gaps
from cellwise.notices import Code, Notice
from cellwise.typing import BoolArray, FloatArray
from cellwise.wording import arg

SIGNAL_UNITS = {
    "current_A": named_units(("a", "amp", "amps", "ampere", "ma => mA")),
    "voltage_V": named_units(("v", "volt", "volts", "mv => mV")),
    "temperature_C": named_units(("°c", "degc", "deg c", "c", "celsius", "grad c", "℃", "k => K")),
    "charge_Ah": named_units(("ah", "mah => mAh", "as => As")),
}
_OF_PACK = ("battery", "batt", "bat", "pack", "hv", "bms", "traction", "string", "total")
_OTHERWISE = (
    *("max", "min", "limit", "lim", "target", "setpoint", "set", "request", "req", "cmd", "avail"),
    *("motor", "phase", "aux", "lv", "12v", "dcdc", "charger", "inverter", "allowed", "nominal"),
    *("offset", "error", "fault", "status", "ref", "reference", "ambient", "coolant", "inlet"),
)


class Signal(NamedTuple):
    """A signal of a recording: its full name, its unit as written, what the reader finds it by."""

    name: str
    unit: str
    key: tuple[object, ...]

    @property
    def short(self) -> str:
        """The name without its message or group."""
        return self.name.rpartition(".")[2]

    @property
    def folded_unit(self) -> str:
        """The unit as units are compared."""
        return self.unit.strip().strip("[]()").casefold()


class Chosen(NamedTuple):
    """A signal for a channel, and its conversion."""

    field: str
    signal: Signal
    unit: Unit


def choose_signals(
    signals: Sequence[Signal], stated: Mapping[str, str], where: str
) -> tuple[list[Chosen], list[Notice]]:
    """Find current, voltage and, where they are clear, temperature and counter.

    Parameters
    ----------
    signals : sequence of Signal
    stated : mapping          tidy name, which gives the unit, to the signal's name
    where : str             for messages

    Returns
    -------
    chosen : list of Chosen
    notices : list of Notice

    Raises
    ------
    InputError              no such signal, none of that unit, or several that it could be
    """
    chosen = [_stated(tidy, name, signals, where) for tidy, name in stated.items()]
    notices: list[Notice] = []
    fields = {c.field for c in chosen}
    for field, units in SIGNAL_UNITS.items():
        if field in fields:
            continue
        found = _best(field, signals)
        if len(found) == 1:
            signal = found[0]
            chosen.append(Chosen(field, signal, units[_unit(signal, field)]))
            unit = signal.unit or "no unit"
            text = f"signal '{signal.name}' ({unit}) was taken for {field}"
            notices.append(Notice(Code.SIGNAL_CHOSEN, text))
        elif field in REQUIRED:
            raise _unclear(field, found, signals, where)
    return chosen, notices


def _stated(tidy: str, name: str, signals: Sequence[Signal], where: str) -> Chosen:
    field, unit = tidy_name(tidy, SIGNAL_UNITS)
    found = [s for s in signals if s.name == name] or [
        s for s in signals if folded(name) in (folded(s.name), folded(s.short))
    ]
    if not found:
        raise no_such_name(name, [s.name for s in signals], where, "signal")
    if len(found) > 1:
        raise InputError(
            f"{len(found)} signals '{name}' in {where}: {listed([s.name for s in found])}",
            "one signal",
            "Name it with its message or group.",
        )
    return Chosen(field, found[0], unit)


def _best(field: str, signals: Sequence[Signal]) -> list[Signal]:
    """The signals of a channel's unit whose names speak most for it."""
    scores = [(_score(field, s.name), s) for s in signals if _unit(s, field) in SIGNAL_UNITS[field]]
    required = field in REQUIRED
    scores = [(score, s) for score, s in scores if score > (-2 if required else 1)]
    best = max((score for score, _ in scores), default=0)
    return [s for score, s in scores if score == best]


def _score(field: str, name: str) -> int:
    words = words_of(name)
    own = 1 if words.intersection(WORDS[field]) else 0
    pack = 2 if words.intersection(_OF_PACK) else 0
    other = -3 if words.intersection(_OTHERWISE) else 0
    return own + pack + other


def _unit(signal: Signal, field: str) -> str:
    """The unit, folded; of a signal without one, what its name says (``current_mA``, ``PackVolt``).

    Without a unit the name must have the quantity's own name.
    """
    unit = signal.folded_unit
    if unit and unit != "-":
        return unit
    words = words_of(signal.short)
    if not words.intersection(WORDS[field]):
        return ""
    last = signal.short.rpartition("_")[2].casefold()
    return last if last in SIGNAL_UNITS[field] else next(iter(SIGNAL_UNITS[field]))


# Of signals whose unit the database says: CellVoltage01, VCell_12, Cell3_Volt.
_CELL = re.compile(
    r"(?:v(?:olt(?:age)?)?_?)?cell_?(?:v(?:olt(?:age)?)?)?_?(\d+)(?:_?v(?:olt(?:age)?)?)?",
    re.IGNORECASE,
)


def cell_number(signal: str) -> int | None:
    """The cell whose voltage a signal is by its name, from 1 as the names count; else None."""
    match = _CELL.fullmatch(signal)
    return int(match[1]) if match else None


def cell_signals(signals: Sequence[Signal], cells: int) -> list[Signal]:
    """The signals of so many cells' voltages, in order.

    Raises
    ------
    InputError        another number of them
    """
    volts = [s for s in signals if s.folded_unit in SIGNAL_UNITS["voltage_V"]]
    numbers = [(n, s) for s in volts if (n := cell_number(s.short)) is not None]
    found = dict(numbers)
    if not len(numbers) == len(found) == cells:
        raise InputError(
            f"signals of {len(found)} cells' voltages in the database",
            f"{cells}, one for each cell, named like CellVoltage01 or VCell_1",
            "Correct the number of cells, or the names in the database.",
        )
    return [found[n] for n in sorted(found)]


def _unclear(
    field: str, found: Sequence[Signal], signals: Sequence[Signal], where: str
) -> InputError:
    tidy = TIDY_NAME[field]
    if found:
        names = [s.name for s in found]
        return MissingColumnsError(
            f"{len(found)} signals that could be {field} in {where}: {listed(names)}",
            "one",
            "Choose it: " + arg("channels", (tidy, "NAME")) + ".",
            proposals=[{tidy_of(field, f"({_unit(s, field)})"): s.name} for s in found],
        )
    names = [s.name + (f" [{s.unit}]" if s.unit else "") for s in signals]
    return InputError(
        f"no signal with a unit of {field} in {where}, which has {listed(names) or 'none at all'}",
        f"the battery's {field.partition('_')[0]}",
        "Choose it: " + arg("channels", (tidy, "NAME")) + ".",
    )


FASTER = 1.5  # samples of current per sample of voltage, from which on the current is averaged


class Series(NamedTuple):
    """A channel with stamps of its own [s]."""

    time_s: FloatArray
    values: FloatArray


def aligned(series: Mapping[str, Series], where: str) -> tuple[dict[str, FloatArray], list[Notice]]:
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
            "Choose channels of one recording with " + arg("channels", letter="{...}") + ".",
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
        text = f"voltage and current are sampled apart: the current was {how} to the voltage's rows"
        notices.append(Notice(Code.SAMPLED_APART, text))
    lost = voltage.time_s.size - time.size
    if lost:
        text = f"{lost} row(s) before the first or after the last current left out"
        notices.append(Notice(Code.ROWS_WITHOUT_CURRENT, text))
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
    """Mean over the interval that ends at each row: no charge is lost."""
    area = np.cumsum(0.5 * (samples.values[1:] + samples.values[:-1]) * np.diff(samples.time_s))
    at = np.interp(time, samples.time_s, np.concatenate(([0.0], area)))
    first = np.interp(time[:1], samples.time_s, samples.values)
    return np.concatenate((first, np.diff(at) / np.diff(time)))


def _paused(samples: Series, time: FloatArray) -> BoolArray:
    """Rows inside a pause of the channel, shape (n,) bool."""
    gaps = find_gaps(samples.time_s)
    after = np.searchsorted(samples.time_s, time, side="left")
    after = np.minimum(after, samples.time_s.size - 1)
    exact = samples.time_s[after] == time
    paused: BoolArray = gaps[after] & ~exact
    return paused
