"""Station: the capacity that SOC refers to, by capacity tests, a whole pulse test or as rated."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.notice import MOST_CHARGE, RANGE_V
from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import capacity_choices, choose_capacity
from cellwise.identify.capacity.capacity_test import CapacityTest, measure_capacities
from cellwise.identify.checked_logs import CheckedLogs
from cellwise.identify.hppc.phases import find_phases
from cellwise.identify.identification import CellTests, IdentifySettings
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice
from cellwise.wording import arg


class CapacityLimits(NamedTuple):
    """How far capacities and charges of one cell may be apart, as ratios.

    ``near_nominal``: age, rating and rate leave less; beyond ``far`` no two of one cell are: an
    aged cell keeps a third, a wrong unit is a thousand.
    """

    near_nominal: float = 1.25
    far: float = 2.5


class CapacitySpread(NamedTuple):
    """Standard deviation of ln(capacity) beforehand, where a fit may still move it.

    Of a cell in use whose rating is known; of a pulse test that is taken for whole, or of another
    sample; measured by a capacity test, or nominal where that was chosen by name.
    """

    rated: float = 0.1
    pulses: float = 0.02
    measured: float = 0.001


class _PulseTest(NamedTuple):
    """When the charge of a pulse test is the capacity."""

    climbs: float = 2.0  # a log that brings back so many times what it takes climbs
    # At the lower limit the voltage falls this much faster than in the middle, in every chemistry.
    steep_end: float = 4.0
    step: float = 0.1  # of the largest step: a smaller one is a pulse
    late: float = 0.3  # of a step's time, at its end, is where its voltage is seen to fall
    ends_empty: float = 0.7  # of nominal: a test that moved less went through a part of the range
    nearly: float = 0.97  # of nominal: a test that does not end empty and yet is the whole cell


LIMITS, SPREAD, PULSE_TEST = CapacityLimits(), CapacitySpread(), _PulseTest()


class MeasuredCapacity(NamedTuple):
    """The capacity taken, by which choice, of which choices and tests."""

    capacity_Ah: float
    choice: str
    choices_Ah: dict[str, float]
    tests: tuple[CapacityTest, ...]
    ln_std: float
    contradictions: tuple[Notice, ...]
    notices: tuple[Notice, ...]


def measure_capacity(checked: CheckedLogs, settings: IdentifySettings) -> MeasuredCapacity:
    """The capacity that SOC refers to.

    Raises
    ------
    InputError        no capacity; a capacity, or a charge that a log moves, which no cell of that
                      capacity can have
    """
    tests, nominal = checked.tests, settings.nominal_Ah
    notices: list[Notice] = []
    measured: tuple[CapacityTest, ...] = ()
    # Low-rate logs may be parts of one test: discharge, its last per cent, charge.
    sources: list[CellLog | tuple[CellLog, ...]] = [*checked.low_rate, *tests.capacity]
    try:
        measured = measure_capacities(sources, nominal_Ah=nominal) if sources else ()
    except InputError as error:
        if nominal is None and not tests.hppc:
            raise
        notices.append(Notice(Code.NO_CAPACITY_TEST, "no capacity test found: " + error.text))
    total, empty_early = _of_pulse_tests(tests, nominal, notices)
    usable, parts = _without_parts(measured, nominal)
    if not any(t.complete for t in usable):
        usable = ()
        if measured:
            text = "no capacity test reached the lower limit: none is used"
            notices.append(Notice(Code.NO_CAPACITY_TEST, text))
    left_out = (f"capacity test {t.left_out}" for t in usable if not t.complete)
    notices.extend(Notice(Code.CAPACITY_TEST_UNUSED, text) for text in left_out)
    choices = capacity_choices(usable, nominal, total, temperature_C=checked.default_C)
    choice, capacity = choose_capacity(choices, settings.capacity_choice)
    of_choice = {"nominal": SPREAD.rated, "hppc-total": SPREAD.pulses}
    ln_std = of_choice.get(choice, SPREAD.measured)
    if settings.capacity_choice == "nominal":
        ln_std = SPREAD.measured
    found = [
        *parts,
        *_against_nominal(capacity, choice, nominal),
        *_against_logs(capacity, choice, tests),
        *(empty_early if choice == "nominal" else []),
    ]
    return MeasuredCapacity(
        capacity, choice, choices, measured, ln_std, tuple(found), tuple(notices)
    )


def _without_parts(
    tests: tuple[CapacityTest, ...], nominal_Ah: float | None
) -> tuple[tuple[CapacityTest, ...], list[Notice]]:
    """The tests without those that look whole and are too small for the nominal capacity."""
    nominal = nominal_Ah or 0.0
    small = [t for t in tests if t.complete and t.total_Ah * LIMITS.far < nominal]
    found = [
        Notice(
            Code.PART_OF_DISCHARGE,
            f"capacity test '{t.name}' moved {t.total_Ah:.4g} Ah, of {nominal:g} Ah nominal: "
            "the end of a discharge, or a current in another scale? It is not used as a capacity",
            size_V=RANGE_V * math.log(nominal / t.total_Ah),
        )
        for t in small
    ]
    return tuple(t for t in tests if t not in small), found


def _against_nominal(capacity_Ah: float, choice: str, nominal_Ah: float | None) -> list[Notice]:
    if nominal_Ah is None:
        return []
    ratio = capacity_Ah / nominal_Ah
    away = abs(math.log(ratio))
    if away >= math.log(LIMITS.far):
        raise InputError(
            f"a capacity of {capacity_Ah:.4g} Ah ({choice}) for a cell of {nominal_Ah:g} Ah "
            "nominal",
            f"a capacity within a factor of {LIMITS.far:g} of the nominal one",
            "Check the unit of the current (mA for A?) and "
            + arg("nominal_Ah", letter="...")
            + ", or leave that out.",
        )
    if away < math.log(LIMITS.near_nominal):
        return []
    text = (
        f"the capacity of {capacity_Ah:.4g} Ah ({choice}) is {ratio:.2f} times the nominal "
        f"{nominal_Ah:.4g} Ah: another cell, an aged one, or another unit?"
    )
    return [Notice(Code.NOT_NOMINAL, text, size_V=RANGE_V * away)]


def _against_logs(capacity_Ah: float, choice: str, tests: CellTests) -> list[Notice]:
    """Logs that move more than the cell holds."""
    found = []
    for log in tests.logs():
        moved_Ah = float(np.ptp(log.counted_charge_Ah()))
        of_cell = f"moves {moved_Ah:.4g} Ah"
        if moved_Ah > LIMITS.far * capacity_Ah:
            raise InputError(
                f"'{log.name}' that {of_cell} for a cell of {capacity_Ah:.4g} Ah ({choice})",
                "logs of one cell, with current in ampere",
                "Check the unit of the current (mA for A?), "
                + arg("parallel", letter="N")
                + ", and the capacity.",
            )
        if moved_Ah > MOST_CHARGE * capacity_Ah:
            text = (
                f" {of_cell} through a cell of {capacity_Ah:.4g} Ah ({choice}): a log of another "
                "cell, or in another scale?"
            )
            size_V = RANGE_V * (moved_Ah / capacity_Ah - 1.0)
            found.append(Notice(Code.MORE_THAN_HELD, text, log=log.name, size_V=size_V))
    return found


def _of_pulse_tests(
    tests: CellTests, nominal_Ah: float | None, notices: list[Notice]
) -> tuple[float | None, list[Notice]]:
    """Charge of the pulse test that moved most [Ah], None where it was not the whole cell.

    Without a nominal capacity it counts anyway, with a notice; a test that ends empty and yet is no
    capacity contradicts the nominal one.
    """
    most = max((log for log, _ in tests.hppc), key=hppc_total_Ah, default=None)
    if most is None:
        return None, []
    total, whole = hppc_total_Ah(most), hppc_reaches_empty(most)
    if nominal_Ah is None:
        if not whole:
            text = (
                f" is not seen to go from full to empty: its {total:.3f} Ah are taken for the "
                "capacity, for want of a nominal one"
            )
            notices.append(Notice(Code.PULSE_TEST_TAKEN, text, log=most.name))
        return total, []
    if total >= (PULSE_TEST.ends_empty if whole else PULSE_TEST.nearly) * nominal_Ah:
        return total, []
    text = (
        f"the HPPC test moved {total:.3f} Ah, {100 * total / nominal_Ah:.0f} % of nominal: "
        "it did not go from full to empty and is no capacity"
    )
    notices.append(Notice(Code.PULSE_TEST_NO_CAPACITY, text))
    if not whole:
        return None, []
    text = (
        f" is empty after {total:.4g} Ah, of {nominal_Ah:.4g} Ah nominal: did it begin full, and "
        "is the nominal capacity that of this cell?"
    )
    size_V = RANGE_V * math.log(nominal_Ah / total)
    return None, [Notice(Code.EMPTY_EARLY, text, log=most.name, size_V=size_V)]


def hppc_total_Ah(log: CellLog) -> float:
    """Net charge from the fullest to the emptiest moment after it, all pulses included [Ah].

    The ``hppc-total`` choice: it is a capacity as far as the log begins, or is charged, full and
    ends empty. Of a log that climbs, the charge from its emptiest to its fullest moment.
    """
    charge = log.counted_charge_Ah()
    down = float(np.max(charge - np.minimum.accumulate(charge)))
    up = float(np.max(np.maximum.accumulate(charge) - charge))
    return up if up > PULSE_TEST.climbs * down else down


def hppc_reaches_empty(log: CellLog) -> bool:
    """Whether a pulse test ends as a cell does at its lower limit: bending down.

    The fall per ampere-hour at the end of the last discharge against that of the usual ones.
    """
    steps = [p for p in find_phases(log) if p.kind == "cc" and p.current_A > 0.0]
    most = max((p.charge_Ah for p in steps), default=0.0)
    falls = []
    for step in (p for p in steps if p.charge_Ah >= PULSE_TEST.step * most):
        known = np.arange(max(step.start - 1, 0), step.stop)
        known = known[np.isfinite(log.voltage_V[known])]
        if known.size > 1:
            t, v = log.time_s[known], log.voltage_V[known]
            late_V = np.interp(t[-1] - PULSE_TEST.late * step.duration_s, t, v)
            falls.append(float(late_V - v[-1]) / step.charge_Ah)
    return len(falls) > 1 and falls[-1] >= PULSE_TEST.steep_end * float(np.median(falls))
