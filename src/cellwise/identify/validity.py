"""What the logs behind a model covered: SOC visited, temperature, current."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.validity import UNKNOWN, Validity, covered
from cellwise.identify.identification import OwnLog, TestLogs
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray


class _Trimmed(NamedTuple):
    """At each end: a pulse of a few rows in hours of rest counts, a sensor's single spike not."""

    rows: int = 2
    share: float = 2e-5


TRIMMED = _Trimmed()


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
    trim = max(TRIMMED.rows, round(TRIMMED.share * np.count_nonzero(part)))
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
    stated = {_mark(log): warm for log, warm in (*tests.hppc, *tests.drive) if warm is not None}
    parts = [
        log_validity(
            o.simulation.log,
            o.simulation.soc,
            stated.get(_mark(o.simulation.log), temperature_C),
            o.compared,
        )
        for o in used
    ]
    fitted = {_mark(o.simulation.log) for o in used}
    slow = [p for p, o in zip(parts, used, strict=True) if o.role == "ocv"]
    loads = [p for p, o in zip(parts, used, strict=True) if o.role != "ocv"]
    slow += [
        log_validity(log, None, temperature_C) for log in tests.ocv if _mark(log) not in fitted
    ]
    # A low-rate test shows no resistance: where loads were measured, their temperatures count.
    if joined(loads).temperature_C is not None:
        slow = [replace(p, temperature_C=None) for p in slow]
    parts = [*loads, *slow]
    if measured_soc.size:
        parts.append(Validity(soc=covered(np.clip(measured_soc, 0.0, 1.0))))
    return joined(parts)


def joined(parts: Iterable[Validity]) -> Validity:
    """What all of them covered together."""
    return reduce(Validity.joined, parts, UNKNOWN)


def _mark(log: CellLog) -> tuple[str, str, int]:
    return log.name, str(log.source), len(log)
