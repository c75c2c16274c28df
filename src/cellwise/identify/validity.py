"""What the logs behind a model covered: SOC visited, temperature, current."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce

import numpy as np

from cellwise.cell.plausibility.validity import UNKNOWN, Validity, covered
from cellwise.cell.simulate import Simulation
from cellwise.identify.identification import TestLogs
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

# At each end: a pulse of a few rows in hours of rest counts, a sensor's single spike does not.
TRIMMED_ROWS = 2
TRIMMED_SHARE = 2e-5


def log_validity(log: CellLog, soc: FloatArray | None, stated_C: float | None = None) -> Validity:
    """What one log covered.

    Parameters
    ----------
    soc : (n,) float or None      of every row; None: not known
    stated_C : float or None      temperature where none was measured; None: not known [degC]
    """
    trim = max(TRIMMED_ROWS, round(TRIMMED_SHARE * len(log)))
    warm = None if log.temperature_C is None else covered(log.temperature_C, trim)
    if warm is None and stated_C is not None:
        warm = float(stated_C), float(stated_C)
    seen = None if soc is None else covered(np.clip(soc, 0.0, 1.0), trim)
    return Validity(seen, warm, covered(log.interval_current_A, trim))


def identified_validity(
    tests: TestLogs,
    simulations: Sequence[Simulation],
    ocv: OcvCurve,
    temperature_C: float | None = None,
) -> Validity:
    """What the logs that took part in an identification covered together.

    Parameters
    ----------
    tests : TestLogs                        with the temperatures that were stated
    simulations : sequence of Simulation    of the logs that the model was fitted on
    ocv : OcvCurve                          its points count, its extrapolation does not
    temperature_C : float or None           of tests that measured none, as stated [degC]
    """
    stated = {_mark(log): warm for log, warm in (*tests.hppc, *tests.drive) if warm is not None}
    parts = [
        log_validity(s.log, s.soc, stated.get(_mark(s.log), temperature_C)) for s in simulations
    ]
    fitted = {_mark(s.log) for s in simulations}
    parts += [
        log_validity(log, None, temperature_C) for log in tests.ocv if _mark(log) not in fitted
    ]
    parts.append(Validity(soc=covered(np.clip(ocv.points_soc, 0.0, 1.0))))
    return joined(parts)


def joined(parts: Iterable[Validity]) -> Validity:
    """What all of them covered together."""
    return reduce(Validity.joined, parts, UNKNOWN)


def _mark(log: CellLog) -> tuple[str, str, int]:
    return log.name, str(log.source), len(log)
