"""Station: open-circuit voltage over SOC as a test measured it, for the report and the papers."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

from cellwise.errors import InputError
from cellwise.identify.checked_logs import CheckedLogs, nearest_test
from cellwise.identify.hppc.pulses import find_pulses
from cellwise.identify.identification import REFERENCE_C, CellTests, log_temperature_C
from cellwise.identify.ocv.curve import OcvCurve, sample_notice
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
    """OCV from the rests of an HPPC log, else from the low-rate test nearest in temperature.

    The branches of that test go with the rests, too.

    Raises
    ------
    InputError        neither
    """
    rests, failed = _of_rests(checked.tests, capacity_Ah)
    slow = nearest_test(checked.low_rate, checked.default_C)
    if not slow:
        if rests is not None:
            return MeasuredOcv(rests, (), rests.notes)
        raise InputError(
            "; ".join((pulse_counts(checked.tests), *(one.head for one in failed))),
            "a low-rate test, or an HPPC log with healthy pulses and rests at several SOC",
            "Add " + arg("ocv", letter="LOG") + " (a C/20 discharge), or give such an HPPC log.",
        )
    curve = ocv_from_low_rate(slow, capacity_Ah=capacity_Ah)
    if rests is None:
        return MeasuredOcv(curve, (), (*curve.notes, *failed))
    unlike = sample_notice(rests, curve, capacity_Ah)
    both = replace(
        rests,
        discharge_V=curve.discharge_V,
        charge_V=curve.charge_V,
        source=f"{rests.source}; {curve.source}",
        notes=(*curve.notes, *rests.notes),
    )
    return MeasuredOcv(both, () if unlike is None else (unlike,), both.notes)


def pulse_counts(tests: CellTests) -> str:
    """The pulses of each log by quality, as text."""
    values = []
    for log, _ in tests.hppc:
        counts = Counter(p.quality for p in find_pulses(log))
        listed = ", ".join(f"{n} {quality}" for quality, n in counts.items())
        values.append(f"{listed + ' pulse(s)' if listed else 'no pulse at all'} in '{log.name}'")
    return "; ".join(values) or "no HPPC log"


def _of_rests(tests: CellTests, capacity_Ah: float) -> tuple[OcvCurve | None, tuple[Notice, ...]]:
    """Of the log nearest to the reference temperature: a cold one relaxes too slowly."""
    if not tests.hppc:
        return None, ()
    log, _ = min(tests.hppc, key=lambda item: abs(log_temperature_C(*item) - REFERENCE_C))
    try:
        return ocv_from_rests(log, capacity_Ah), ()
    except InputError as error:
        text = f"no OCV from the rests of '{log.name}': found " + error.found
        said = (text, "; expected " + error.expected + ". " + error.action)
        return None, (Notice(Code.NO_OCV_OF_RESTS, said),)
