"""First station: logs that no cell can have are refused, temperatures that disagree are said."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.cells_in_series import check_one_cell
from cellwise.cell.plausibility.notice import Notice
from cellwise.errors import InputError
from cellwise.identify.by_temperature import LowRateTest, low_rate_tests
from cellwise.identify.identification import REFERENCE_C, IdentifySettings, TestLogs
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.sign import verify_sign
from cellwise.logs.measured_log import cut_at_pauses
from cellwise.logs.stated import other_temperature

# The highest voltages of a log of an empty cell and one of a full differ by less (LTO: 1.87); those
# of one cell and two in series by 2.
OTHER_VOLTAGE = 1.9
VOLT_PER_KELVIN = 0.005  # about what a wrong temperature does at 1C: only the order of notices


class CheckedLogs(NamedTuple):
    """The tests, and what was found.

    ``low_rate`` has the logs of a low-rate test together; ``default_C`` is the temperature of a log
    that measured none.
    """

    tests: TestLogs
    low_rate: tuple[LowRateTest, ...]
    default_C: float
    contradictions: tuple[Notice, ...]


def check_logs(tests: TestLogs, settings: IdentifySettings) -> CheckedLogs:
    """Refuse what no later step could make sense of.

    Raises
    ------
    InputError        no usable log; a log whose current has the wrong sign; a pack beside or
                      instead of a cell; a nominal capacity that is none
    """
    _check_complete(tests, settings)
    logs = tests.logs()
    for log in logs:
        _check_sign(log)
        check_one_cell(log)
    _check_voltages(logs)
    default = REFERENCE_C if settings.temperature_C is None else settings.temperature_C
    contradictions = []
    for log, stated in (*tests.hppc, *tests.drive):
        found = None if stated is None else other_temperature(log, stated)
        if found is not None:
            contradictions.append(Notice(VOLT_PER_KELVIN * found[0], found[1]))
    # After a pause that nobody counted a drive is another drive.
    drives = tuple((part, warm) for log, warm in tests.drive for part in cut_at_pauses(log))
    low_rate = tuple(low_rate_tests(tests.ocv, default))
    return CheckedLogs(replace(tests, drive=drives), low_rate, default, tuple(contradictions))


def reading_notices(tests: TestLogs) -> list[str]:
    """What reading the logs has noted, each with the name of its log."""
    return [
        n if log.name and log.name in n else f"'{log.name}': {n}"
        for log in tests.logs()
        for n in log.notices
    ]


def _check_complete(tests: TestLogs, settings: IdentifySettings) -> None:
    if not tests.logs():
        raise InputError("no test", "at least one", "Give `hppc=LOG` or `drive=LOG`.")
    nominal = settings.nominal_Ah
    if nominal is not None and not (np.isfinite(nominal) and nominal > 0.0):
        raise InputError(
            f"a nominal capacity of {nominal:g} Ah", "a number above zero", "Give it in Ah."
        )


def _check_sign(log: CellLog) -> None:
    found = verify_sign(log)
    if found.verdict == "contradicted":
        raise InputError(
            f"log '{log.name}' whose voltage rises with its discharge current "
            f"({'; '.join(found.evidence[:2])})",
            "positive current on discharge",
            "Give `sign='charge-positive'`, or swap the sign in the file.",
        )


def _check_voltages(logs: tuple[CellLog, ...]) -> None:
    """Refuse a pack beside a cell."""
    highest = [float(np.nanmax(log.voltage_V)) for log in logs]
    for low, high in combinations(np.argsort(highest), 2):
        if highest[high] > OTHER_VOLTAGE * highest[low]:
            raise InputError(
                f"up to {highest[high]:.3g} V in '{logs[high].name}' beside "
                f"{highest[low]:.3g} V in '{logs[low].name}'",
                "logs of one cell",
                "Other cells in series? Read that log alone with its own `series=N`, and write it "
                "as a log of one cell (write_log, cellwise convert).",
            )
