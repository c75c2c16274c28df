"""What the logs behind a model covered: SOC visited, temperature, current."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from cellwise.cell.plausibility.validity import UNKNOWN, Validity, covered
from cellwise.identify.identification import OwnLog, TestLogs
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

# Left out at each end: a pulse of a few rows in hours of rest counts, a sensor's spike does not.
TRIMMED_ROWS, TRIMMED_SHARE = 2, 2e-5


def log_validity(
    log: CellLog,
    soc: FloatArray | None,
    stated_C: float | None = None,
    rows: BoolArray | None = None,
) -> Validity:
    """What one log covered.

    Parameters
    ----------
    soc : (n,) float or None      of every row; None: not known
    stated_C : float or None      temperature where none was measured; None: not known [degC]
    rows : (n,) bool or None      those that took part; None: all
    """
    part = np.ones(len(log), dtype=np.bool_) if rows is None else rows
    trim = max(TRIMMED_ROWS, round(TRIMMED_SHARE * np.count_nonzero(part)))
    warm = None if log.temperature_C is None else covered(log.temperature_C[part], trim)
    if warm is None and stated_C is not None:
        warm = float(stated_C), float(stated_C)
    seen = None if soc is None else covered(np.clip(soc[part], 0.0, 1.0), trim)
    return Validity(seen, warm, covered(log.interval_current_A[part], trim))


def identified_validity(
    tests: TestLogs,
    used: Sequence[OwnLog],
    measured_soc: FloatArray,
    temperature_C: float | None = None,
) -> Validity:
    """What the logs that took part in an identification covered together.

    Parameters
    ----------
    tests : TestLogs                        with the temperatures that were stated
    used : sequence of OwnLog               the logs that the model was fitted on
    measured_soc : (m,) float               where the OCV was measured
    temperature_C : float or None           of tests that measured none, as stated [degC]
    """
    stated = {id(log): warm for log, warm in (*tests.hppc, *tests.drive) if warm is not None}
    loads: list[Validity] = []
    slow: list[Validity] = []
    fitted = set()
    for own in used:
        s = own.simulation
        fitted.add(id(s.log))
        warm = stated.get(id(s.log), temperature_C)
        part = log_validity(s.log, s.soc, warm, own.compared)
        (slow if own.role == "ocv" else loads).append(part)
    slow += [log_validity(x, None, temperature_C) for x in tests.ocv if id(x) not in fitted]
    # A low-rate test shows no resistance: where loads were measured, their temperatures count.
    if joined(loads).temperature_C is not None:
        slow = [replace(p, temperature_C=None) for p in slow]
    if measured_soc.size:
        slow.append(Validity(soc=covered(np.clip(measured_soc, 0.0, 1.0))))
    return joined([*loads, *slow])


def joined(parts: Iterable[Validity]) -> Validity:
    """What all of them covered together."""
    return reduce(Validity.joined, parts, UNKNOWN)
