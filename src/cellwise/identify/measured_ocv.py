"""Third station: open-circuit voltage over SOC, of low-rate tests, rests, or what there is."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.checked_logs import CheckedLogs, nearest_test
from cellwise.identify.hppc.pulses import find_pulses
from cellwise.identify.identification import REFERENCE_C, CellTests, log_temperature_C
from cellwise.identify.ocv.curve import (
    POINTS,
    OcvCurve,
    combine_ocv,
    curve_from_points,
    sample_notice,
)
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.notices import Code, Notice
from cellwise.wording import arg


class MeasuredOcv(NamedTuple):
    """The curve, and what was found on the way."""

    curve: OcvCurve
    contradictions: tuple[Notice, ...]
    notices: tuple[Notice, ...]


def measure_ocv(checked: CheckedLogs, capacity_Ah: float) -> MeasuredOcv:
    """OCV from the low-rate test nearest in temperature, rests of an HPPC log, or both.

    Without either, from the slowest capacity test; without that, the voltages of a drive.

    Raises
    ------
    InputError        no OCV
    """
    tests = checked.tests
    notices: list[Notice] = []
    unlike: Notice | None = None
    curve = rests = _of_rests(tests, capacity_Ah, notices)
    slow = nearest_test(checked.low_rate, checked.default_C)
    if slow:
        curve = ocv_from_low_rate(slow, capacity_Ah=capacity_Ah)
        notices[:0] = curve.notes
        if rests is not None and rests.points_soc.size >= POINTS.fewest:
            unlike = sample_notice(rests, curve, capacity_Ah)
            curve = combine_ocv(rests, curve)
    elif rests is not None:
        notices.extend(rests.notes)
    elif tests.capacity:
        curve = ocv_from_low_rate(tests.capacity, capacity_Ah=capacity_Ah)
        text = "OCV taken from the slowest capacity test: it carries its polarisation"
        notices.append(Notice(Code.OCV_SOURCE, text))
    elif tests.drive:
        curve = _of_drives(tests, capacity_Ah, notices)
    if curve is None:
        why = notices[-1].head
        raise InputError(
            f"{pulse_counts(tests)}, and no open-circuit voltage ({why})",
            "a low-rate test, or an HPPC log with healthy pulses and rests at several SOC",
            "Add " + arg("ocv", letter="LOG") + " (a C/20 discharge), or give such an HPPC log.",
        )
    return MeasuredOcv(curve, () if unlike is None else (unlike,), tuple(notices))


def pulse_counts(tests: CellTests) -> str:
    """The pulses of each log by quality, as text."""
    values = []
    for log, _ in tests.hppc:
        counts = Counter(p.quality for p in find_pulses(log))
        listed = ", ".join(f"{n} {quality}" for quality, n in counts.items())
        values.append(f"{listed + ' pulse(s)' if listed else 'no pulse at all'} in '{log.name}'")
    return "; ".join(values)


def _of_rests(tests: CellTests, capacity_Ah: float, notices: list[Notice]) -> OcvCurve | None:
    """Of the log nearest to the reference temperature: a cold one relaxes too slowly."""
    if not tests.hppc:
        return None
    log, _ = min(tests.hppc, key=lambda item: abs(log_temperature_C(*item) - REFERENCE_C))
    try:
        return ocv_from_rests(log, capacity_Ah)
    except InputError as error:
        text = f"no OCV from the rests of '{log.name}': found " + error.found
        said = (text, "; expected " + error.expected + ". " + error.action)
        notices.append(Notice(Code.NO_OCV_OF_RESTS, said))
        return None


def _of_drives(tests: CellTests, capacity_Ah: float, notices: list[Notice]) -> OcvCurve:
    """A first OCV out of the longest drive: the upper quartile of the voltage at each SOC."""
    log = max((log for log, _ in tests.drive), key=lambda x: float(np.ptp(x.counted_charge_Ah())))
    soc = (1.0 if log.soc0 is None else log.soc0) - log.counted_charge_Ah() / capacity_Ah
    edges = np.linspace(max(float(np.nanmin(soc)), 0.0), 1.0, 31)
    points, level = [], []
    for low, high in pairwise(edges):
        inside = (soc >= low) & (soc < high) & np.isfinite(log.voltage_V)
        if np.count_nonzero(inside) >= 3:
            points.append(float(np.mean(soc[inside])))
            level.append(float(np.percentile(log.voltage_V[inside], 75)))
    if len(points) < POINTS.fewest:
        raise InputError(
            "no OCV test, no rest and too little charge moved",
            "a low-rate discharge or an HPPC log with rests",
            "Add " + arg("ocv", letter="LOG") + " or " + arg("hppc", letter="LOG") + ".",
        )
    begun = "begun full" if log.soc0 is None else f"begun at SOC {log.soc0:g}"
    text = f"no OCV test: first OCV from the voltages of drive '{log.name}', {begun}"
    notices.append(Notice(Code.OCV_SOURCE, text))
    source = f"drive {log.name}"
    return curve_from_points(
        np.array(points), np.array(level), capacity_Ah=capacity_Ah, source=source
    )
