"""Station: the capacity that SOC refers to, by capacity tests, a whole pulse test or as rated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.notice import RANGE_V, SHOWN, Notice
from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import capacity_choices, choose_capacity
from cellwise.identify.capacity.capacity_test import CapacityTest, measure_capacities
from cellwise.identify.capacity.half_cycles import join_logs
from cellwise.identify.checked_logs import CheckedLogs
from cellwise.identify.hppc.phases import Phase, find_phases
from cellwise.identify.identification import IdentifySettings, TestLogs
from cellwise.logs.cell_log import CellLog


class CapacityLimits(NamedTuple):
    """How far capacities and charges of one cell may be apart, as ratios.

    ``near_nominal``: age, rating and rate leave less; beyond ``far`` no two of one cell are: an
    aged cell keeps a third, a wrong unit is a thousand.
    """

    near_nominal: float = 1.25
    far: float = 2.5


class CapacitySpread(NamedTuple):
    """Standard deviation of ln(capacity) where a fit may still move it.

    Of a cell in use whose rating is known; measured at a rate whose share of the whole the prior's
    resistances have to say; the nominal one where it was chosen by name.
    """

    rated: float = 0.1
    measured: float = 0.02
    chosen: float = 0.01


LIMITS, SPREAD = CapacityLimits(), CapacitySpread()


class MeasuredCapacity(NamedTuple):
    """The capacity taken, by which choice, of which choices and tests."""

    capacity_Ah: float
    choice: str
    choices_Ah: dict[str, float]
    tests: tuple[CapacityTest, ...]
    ln_std: float
    contradictions: tuple[Notice, ...]
    notices: tuple[str, ...]


def measure_capacity(checked: CheckedLogs, settings: IdentifySettings) -> MeasuredCapacity:
    """The capacity that SOC refers to.

    Raises
    ------
    InputError        no capacity; a capacity, or a charge that a log moves, which no cell of that
                      capacity can have
    """
    tests, nominal = checked.tests, settings.nominal_Ah
    notices: list[str] = []
    measured = _tests(checked, settings, notices)
    total = whole_hppc_Ah([log for log, _ in tests.hppc], nominal, notices)
    usable = measured if any(t.complete for t in measured) else ()
    if measured and not usable:
        notices.append("no capacity test reached the lower limit: none is used")
    if not usable and total is None and nominal is None:
        raise InputError(
            "nothing that says how large the cell is",
            "a capacity test, an HPPC log over the whole range, or a nominal capacity",
            "Add `capacity=LOG`, `hppc=LOG` or `nominal_Ah=X`.",
        )
    usable, parts = _without_parts(usable, nominal)
    notices.extend(f"capacity test {t.left_out}" for t in usable if not t.complete)
    choices = capacity_choices(usable, nominal, total, temperature_C=checked.default_C)
    choice, capacity = choose_capacity(choices, settings.capacity_choice)
    ln_std = SPREAD.measured if choice != "nominal" else SPREAD.rated
    if settings.capacity_choice == "nominal":
        ln_std = SPREAD.chosen
    found = (
        *parts,
        *_against_nominal(capacity, choice, nominal),
        *_against_logs(capacity, choice, tests),
    )
    if choice == "nominal" and total is None:
        found += tuple(_empty_before(tests, capacity))
    return MeasuredCapacity(capacity, choice, choices, measured, ln_std, found, tuple(notices))


def _without_parts(
    tests: tuple[CapacityTest, ...], nominal_Ah: float | None
) -> tuple[tuple[CapacityTest, ...], list[Notice]]:
    """The tests without those that look whole and are too small for the nominal capacity."""
    small = [t for t in tests if t.complete and t.total_Ah * LIMITS.far < (nominal_Ah or 0.0)]
    if not small or nominal_Ah is None:
        return tests, []
    found = [
        Notice(
            RANGE_V * math.log(nominal_Ah / t.total_Ah),
            f"capacity test '{t.name}' moved {t.total_Ah:.4g} Ah, of {nominal_Ah:g} Ah nominal: "
            "the end of a discharge, or a current in another scale? It is not used as a capacity",
        )
        for t in small
    ]
    left = tuple(t for t in tests if t not in small)
    return (left if any(t.complete for t in left) else ()), found


def _tests(
    checked: CheckedLogs, settings: IdentifySettings, notices: list[str]
) -> tuple[CapacityTest, ...]:
    tests = checked.tests
    # Low-rate logs may be parts of one test: discharge, its last per cent, charge.
    sources: list[CellLog | tuple[CellLog, ...]] = [
        *checked.low_rate,
        *tests.capacity,
    ]
    if not sources:
        return ()
    try:
        return measure_capacities(sources, nominal_Ah=settings.nominal_Ah)
    except InputError as error:
        if settings.nominal_Ah is None and not tests.hppc:
            raise
        notices.append(f"no capacity test found: {error}")
        return ()


def _against_nominal(capacity_Ah: float, choice: str, nominal_Ah: float | None) -> list[Notice]:
    if nominal_Ah is None:
        return []
    ratio = capacity_Ah / nominal_Ah
    if not 1.0 / LIMITS.far < ratio < LIMITS.far:
        raise InputError(
            f"a capacity of {capacity_Ah:.4g} Ah ({choice}) for a cell of {nominal_Ah:g} Ah "
            "nominal",
            f"a capacity within a factor of {LIMITS.far:g} of the nominal one",
            "Check the unit of the current (mA for A?) and `nominal_Ah=...`, or leave that out.",
        )
    if 1.0 / LIMITS.near_nominal < ratio < LIMITS.near_nominal:
        return []
    text = (
        f"the capacity of {capacity_Ah:.4g} Ah ({choice}) is {ratio:.2f} times the nominal "
        f"{nominal_Ah:.4g} Ah: another cell, an aged one, or another unit?"
    )
    return [Notice(RANGE_V * abs(math.log(ratio)), text)]


def _against_logs(capacity_Ah: float, choice: str, tests: TestLogs) -> list[Notice]:
    """Logs that move more than the cell holds."""
    found = []
    for log in tests.logs():
        share = float(np.ptp(log.counted_charge_Ah())) / capacity_Ah
        if share > LIMITS.far:
            raise InputError(
                f"'{log.name}' that moves {share * capacity_Ah:.4g} Ah for a cell of "
                f"{capacity_Ah:.4g} Ah ({choice})",
                "logs of one cell, with current in ampere",
                "Check the unit of the current (mA for A?), `parallel=N`, and the capacity.",
            )
        if share > SHOWN.charge:
            text = (
                f"'{log.name}' moves {share * capacity_Ah:.4g} Ah through a cell of "
                f"{capacity_Ah:.4g} Ah ({choice}): a log of another cell, or in another scale?"
            )
            found.append(Notice(RANGE_V * (share - 1.0), text))
    return found


def _empty_before(tests: TestLogs, nominal_Ah: float) -> list[Notice]:
    """A pulse test that is no capacity by its charge, and yet ends empty."""
    most = max((log for log, _ in tests.hppc), key=hppc_total_Ah, default=None)
    if most is None or not hppc_reaches_empty(most):
        return []
    total = hppc_total_Ah(most)
    text = (
        f"'{most.name}' is empty after {total:.4g} Ah, of {nominal_Ah:.4g} Ah nominal: did it "
        "begin full, and is the nominal capacity that of this cell?"
    )
    return [Notice(RANGE_V * math.log(nominal_Ah / total), text)]


class _PulseTest(NamedTuple):
    """When the charge of a pulse test is the capacity."""

    climbs: float = 2.0  # a log that brings back so many times what it takes climbs
    # At the lower limit the voltage falls this much faster than in the middle, in every chemistry.
    steep_end: float = 4.0
    ends_empty: float = 0.7  # of nominal: a test that moved less went through a part of the range
    nearly: float = 0.97  # of nominal: a test that does not end empty and yet is the whole cell


PULSE_TEST = _PulseTest()


def whole_hppc_Ah(
    logs: Sequence[CellLog], nominal_Ah: float | None, notices: list[str]
) -> float | None:
    """Charge of the pulse test that moved most [Ah]; None where it was not the whole cell.

    Parameters
    ----------
    logs : sequence of CellLog     pulse tests
    nominal_Ah : float or None     without it the charge counts anyway, with a notice
    notices : list of str          what was found is added
    """
    most = max(logs, key=hppc_total_Ah, default=None)
    if most is None:
        return None
    total = hppc_total_Ah(most)
    whole = hppc_reaches_empty(most)
    if nominal_Ah is None:
        if not whole:
            notices.append(
                f"'{most.name}' is not seen to go from full to empty: its {total:.3f} Ah are taken "
                "for the capacity, for want of a nominal one"
            )
        return total
    if total >= (PULSE_TEST.ends_empty if whole else PULSE_TEST.nearly) * nominal_Ah:
        return total
    notices.append(
        f"the HPPC test moved {total:.3f} Ah, {100 * total / nominal_Ah:.0f} % of nominal: "
        "it did not go from full to empty and is no capacity"
    )
    return None


def hppc_total_Ah(log: CellLog | Sequence[CellLog]) -> float:
    """Net charge from the fullest to the emptiest moment after it, all pulses included [Ah].

    The ``hppc-total`` choice: it is a capacity as far as the log begins, or is charged, full and
    ends empty. Of a log that climbs, the charge from its emptiest to its fullest moment.
    """
    charge = join_logs(log).charge_Ah
    down = float(np.max(charge - np.minimum.accumulate(charge)))
    up = float(np.max(np.maximum.accumulate(charge) - charge))
    return up if up > PULSE_TEST.climbs * down else down


def hppc_reaches_empty(log: CellLog) -> bool:
    """Whether a pulse test ends as a cell does at its lower limit: bending down.

    The slope at the end of the last discharge against that at the end of the usual ones.
    """
    steps = [p for p in find_phases(log) if p.kind == "cc" and p.current_A > 0.0]
    most = max((p.charge_Ah for p in steps), default=0.0)
    ends = [_end_slope(log, p) for p in steps if p.charge_Ah >= 0.1 * most]
    ends = [slope for slope in ends if np.isfinite(slope)]
    return len(ends) > 1 and ends[-1] >= PULSE_TEST.steep_end * float(np.median(ends))


def _end_slope(log: CellLog, step: Phase) -> float:
    """Fall of the voltage over the last third of a constant current's charge [V per Ah]."""
    rows = slice(max(step.start - 1, 0), step.stop)
    t, v = log.time_s[rows], log.voltage_V[rows]
    known = np.isfinite(v)
    late = t[-1] - 0.3 * (t[-1] - t[0])
    if np.count_nonzero(known) < 2 or not t[-1] > t[0]:
        return float("nan")
    at, end = np.interp(np.array([late, t[-1]]), t[known], v[known])
    return float((at - end) / (0.3 * step.charge_Ah))
