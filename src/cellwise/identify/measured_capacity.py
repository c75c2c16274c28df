"""Second station: every capacity that the logs offer, the one taken, and what contradicts it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.notice import RANGE_V, Notice
from cellwise.cell.plausibility.simulated import MUCH_CHARGE
from cellwise.errors import InputError
from cellwise.identify.by_temperature import low_rate_tests
from cellwise.identify.capacity.capacity_choice import capacity_choices, choose_capacity
from cellwise.identify.capacity.capacity_test import CapacityTest, measure_capacities
from cellwise.identify.capacity.hppc_capacity import (
    hppc_reaches_empty,
    hppc_total_Ah,
    whole_hppc_Ah,
)
from cellwise.identify.checked_logs import CheckedLogs
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
    notices.extend(f"capacity test {t.left_out}" for t in usable if not t.complete)
    choices = capacity_choices(usable, nominal, total, temperature_C=checked.default_C)
    choice, capacity = choose_capacity(choices, settings.capacity_choice)
    ln_std = SPREAD.measured if choice != "nominal" else SPREAD.rated
    if settings.capacity_choice == "nominal":
        ln_std = SPREAD.chosen
    found = (*_against_nominal(capacity, choice, nominal), *_against_logs(capacity, choice, tests))
    if choice == "nominal" and total is None:
        found += tuple(_empty_before(tests, capacity))
    return MeasuredCapacity(capacity, choice, choices, measured, ln_std, found, tuple(notices))


def _tests(
    checked: CheckedLogs, settings: IdentifySettings, notices: list[str]
) -> tuple[CapacityTest, ...]:
    tests = checked.tests
    # Low-rate logs may be parts of one test: discharge, its last per cent, charge.
    sources: list[CellLog | tuple[CellLog, ...]] = [
        *low_rate_tests(tests.ocv, checked.default_C),
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
        if share > MUCH_CHARGE:
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
