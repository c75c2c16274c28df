"""Times as they are written: clocks, dates with or without a clock, days, stamps since 1970."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.arrow import to_numpy, truths
from cellwise.logs.files.words import MONTHS, plain
from cellwise.typing import BoolArray, FloatArray

if TYPE_CHECKING:
    import pyarrow

TimeKind = Literal["clock", "date", "day", "epoch", ""]

# 12.5 | 01:02 | 01:02:03.4 | 1:02:03 PM | 1d 02:03:04.5 | 1-02:03:04, a point or a comma
_CLOCK = (
    r"^\s*(?:(?P<d>\d+)(?:\s*d\s*|-|\s+))?"
    r"(?:(?P<h>\d+):(?P<m>\d+)(?::(?P<s>\d+(?:[.,:]\d*)?))?\s*(?P<half>[AaPp]\.?[Mm]\.?)?|"
    r"(?P<n>[-+]?\d+(?:[.,]\d*)?(?:[eE][-+]?\d+)?))\s*$"
)
_AT = r"(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2}(?:[.,:]\d*)?))?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_ZONE = r"\s*(?:Z|[A-Z]{3,4})?\s*(?P<zone>[-+]\d{1,2}(?::?\d{2})?)?(?:\s*[\[(].*[\])])?"
_NUMBERS = r"(?P<a>\d{1,4})(?P<sep>[-./年])(?P<b>\d{1,2})[-./月](?P<c>\d{1,4})日?"
_DAY_FIRST = (
    r"(?:[\p{L}.]+,?\s+)?(?P<a>\d{1,2})(?P<sep>)(?:\.?[-/\s]|\.)\s*"
    r"(?P<b>\p{L}+)\.?[-/,.\s]\s*(?P<c>\d{2,4})"
)
_MONTH_FIRST = (
    r"(?:\p{L}+,?\s+)?(?P<b>\p{L}+)\.?(?P<sep>)[-\s]+"
    r"(?P<a>\d{1,2})(?:st|nd|rd|th)?[-,\s]\s*(?P<c>\d{4})"
)
_DAYS = (_NUMBERS, _DAY_FIRST, _MONTH_FIRST)
# Fri May 31 09:00:00 GMT+02:00 2024 | 20240531T090000 | 09:00:00 31.05.2024
_PATTERNS = (
    *(rf"^\s*{day}[T_,\s-]+{_AT}{_ZONE}\s*$" for day in _DAYS),
    rf"^\s*\p{{L}}+,?\s+(?P<b>\p{{L}}+)(?P<sep>)\s+(?P<a>\d{{1,2}})\s+{_AT}{_ZONE}\s+(?P<c>\d{{4}})\s*$",
    r"^\s*(?P<a>\d{4})(?P<sep>)(?P<b>\d{2})(?P<c>\d{2})[T _-]?(?P<h>\d{2}):?(?P<m>\d{2}):?"
    rf"(?P<s>\d{{2}}(?:[.,]\d*)?)(?P<half>){_ZONE}\s*$",
    rf"^\s*{_AT}{_ZONE}[,\s]+{_NUMBERS}\s*$",
)
_EMPTY = "(?P<h>)(?P<m>)(?P<s>)(?P<half>)(?P<zone>)"
_DAY_PATTERNS = tuple(rf"^\s*{day}{_EMPTY}\s*$" for day in _DAYS)
DAY_S = 86_400.0
_SECONDS = {"d": DAY_S, "h": 3600.0, "m": 60.0, "s": 1.0, "n": 1.0}
# Seconds since 1970 in this century, and the same in smaller units.
_EPOCH = (9e8, 5e9)
_EPOCH_UNITS = (1.0, 1e-3, 1e-6, 1e-9)
LAST_MONTH = 12


def time_kind(texts: Sequence[str]) -> TimeKind:
    """How times are written in some cells; empty where they are numbers, or none."""
    import pyarrow as pa

    found = [text.strip() for text in texts if any(c.isdigit() for c in text)]
    if not found:
        return ""
    array = pa.array(found)
    if _pattern(array, _PATTERNS):
        return "date"
    if _pattern(array, _DAY_PATTERNS):
        return "day"
    if all(":" in text for text in found):
        return "clock" if _pattern(array, (_CLOCK,)) else ""
    try:
        numbers = [float(text.replace(",", ".")) for text in found]
    except ValueError:
        return ""
    return "epoch" if epoch_unit(np.array(numbers)) else ""


def _pattern(texts: pyarrow.Array, patterns: Sequence[str]) -> str:
    """The first pattern that the first cells are written in."""
    import pyarrow.compute as pc

    first = texts.drop_null().slice(0, 50)
    few = (p for p in patterns if len(first) and pc.all(pc.match_substring_regex(first, p)).as_py())
    return next(few, "")


def epoch_unit(values: FloatArray) -> float:
    """Seconds per count where numbers are stamps since 1970; 0 where they are not."""
    known = values[np.isfinite(values)]
    low, high = _EPOCH
    if known.size:
        for unit in _EPOCH_UNITS:
            if low < known[0] * unit < high and low < known[-1] * unit < high:
                return unit
    return 0.0


def seconds_of(
    found: pyarrow.ChunkedArray, name: str, where: str, *, alone: bool = True
) -> tuple[FloatArray, str]:
    """Seconds of texts: of clocks, or since 1970 of dates; a plain number is one of seconds.

    A clock ``alone``, without a day, goes on where it begins again at midnight; what was done with
    it is the second value.

    Raises
    ------
    InputError        a cell that holds no time
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = found.cast(pa.string()).combine_chunks()
    dates = _pattern(texts, (*_PATTERNS, *_DAY_PATTERNS))
    parts = pc.extract_regex(texts, pattern=dates or _CLOCK)

    def numbers(part: str) -> FloatArray:
        text = pc.replace_substring_regex(pc.struct_field(parts, part), "[,:]", ".")
        return to_numpy(pc.cast(pc.if_else(pc.equal(text, ""), "0", text), pa.float64()))

    def texts_of(part: str) -> pyarrow.Array:
        return pc.struct_field(parts, part)

    noted = ""
    if dates:
        total = _date_seconds(numbers, texts_of)
    else:
        total = np.sum([seconds * numbers(part) for part, seconds in _SECONDS.items()], axis=0)
        total = total + 3600.0 * _half_days(numbers, texts_of)
        is_clock = pc.any(pc.match_substring(texts, ":")).as_py()
        if alone and is_clock and not np.nan_to_num(numbers("d")).any():
            total, nights = past_midnight(total)
            noted = f"the clock passes midnight {nights} time(s) and was taken on" if nights else ""
    if texts.null_count < np.count_nonzero(np.isnan(total)):
        bad = texts.filter(pc.and_(pc.is_valid(texts), pc.is_null(parts)))
        if text := next((text for text in bad.to_pylist() if text.strip()), ""):
            raise InputError(
                f"'{text[:40]}' in column '{name}' of {where}",
                "a time as 12.5, 02:03:04.5, 1d 02:03:04 or 2024-05-31 02:03:04",
                "Correct the cell, or export the time in seconds.",
            )
    return total, noted


def past_midnight(clock_s: FloatArray) -> tuple[FloatArray, int]:
    """Seconds of a clock that goes on over midnight, and how often it passed it."""
    known = clock_s[np.isfinite(clock_s)]
    if known.size < 2 or known.min() < 0.0 or known.max() >= DAY_S:
        return clock_s, 0
    filled = np.where(np.isfinite(clock_s), clock_s, known[0])
    nights = np.cumsum(np.diff(filled, prepend=filled[0]) < -DAY_S / 2.0)
    return clock_s + DAY_S * nights, int(nights[-1])


def _half_days(
    numbers: Callable[[str], FloatArray], texts_of: Callable[[str], pyarrow.Array]
) -> FloatArray:
    """Hours to add for AM and PM."""
    import pyarrow.compute as pc

    half = pc.replace_substring(pc.utf8_lower(texts_of("half")), ".", "")

    def says(text: str) -> BoolArray:
        return truths(pc.equal(half, text))

    hour, pm, am = numbers("h"), says("pm"), says("am")
    added: FloatArray = np.where(pm & (hour < 12), 12.0, 0.0) - np.where(
        am & (hour == 12), 12.0, 0.0
    )
    return added


def _date_seconds(
    numbers: Callable[[str], FloatArray], texts_of: Callable[[str], pyarrow.Array]
) -> FloatArray:
    """Seconds since 1970 of dates by their parts, in universal time where they say their offset.

    Dates with slashes are month first, unless a number is no month or the log would be longer.
    """
    import pyarrow.compute as pc

    first, second, third = numbers("a"), _months(texts_of("b")), numbers("c")
    known = np.isfinite(first)
    year_first = first > 31
    slashes = known & truths(pc.equal(texts_of("sep"), "/")) & ~year_first
    day, month = np.where(year_first, third, first), second
    if slashes.any() and not _is_day_first(first[slashes], second[slashes]):
        day, month = np.where(slashes, second, day), np.where(slashes, first, month)
    year = np.where(year_first, first, third)
    year = np.where(year < 100, year + 2000, year)
    months = (np.where(known, year, 1970) - 1970) * 12 + np.where(month >= 1, month, 1) - 1
    days = months.astype(np.int64).astype("datetime64[M]").astype("datetime64[D]")
    total = DAY_S * (days.astype(np.int64) + day - 1) + 3600.0 * numbers("h")
    total += 3600.0 * _half_days(numbers, texts_of) + 60.0 * numbers("m") + numbers("s")
    total -= _offsets(texts_of("zone"))
    possible = (month >= 1) & (month <= LAST_MONTH) & (day >= 1) & (day <= 31)
    return np.where(possible, total, np.nan)


def _months(texts: pyarrow.Array) -> FloatArray:
    """Months of their numbers or names; 0 for another word."""

    def month(text: str | None) -> float:
        if text is None or text.isdigit():
            return float(text or "nan")
        word = plain(text)
        return float(MONTHS.get(word) or MONTHS.get(word[:3], 0))

    return _each(texts, month)


def _offsets(texts: pyarrow.Array) -> FloatArray:
    """Seconds that a stamp's zone is ahead of universal time: +01:00, -0530, +2."""

    def seconds(text: str | None) -> float:
        digits = (text or "")[1:].replace(":", "")
        if not digits:
            return 0.0
        hours, minutes = (digits, "0") if len(digits) < 3 else (digits[:-2], digits[-2:])
        size = 3600.0 * int(hours) + 60.0 * int(minutes)
        return -size if text and text[0] == "-" else size

    return _each(texts, seconds)


def _each(texts: pyarrow.Array, value: Callable[[str | None], float]) -> FloatArray:
    """A value for each text, looked up once for each different one."""
    import pyarrow as pa
    import pyarrow.compute as pc

    coded = pc.dictionary_encode(texts)
    values = np.array([value(text) for text in coded.dictionary.to_pylist()] + [value(None)])
    places = to_numpy(pc.cast(pc.fill_null(coded.indices, -1), pa.float64()))
    return values[places.astype(np.intp)]


def _is_day_first(first: FloatArray, second: FloatArray) -> bool:
    """Of dates such as 05/06/2024: by a number that is no month, else by the shorter time."""
    if np.any(first > LAST_MONTH) or np.any(second > LAST_MONTH):
        return bool(np.any(first > LAST_MONTH))
    return bool(np.ptp(31 * second + first) < np.ptp(31 * first + second))
