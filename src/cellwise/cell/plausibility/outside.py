"""A model used where its data never were: said once, first, with the numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cellwise.cell.effects import Entropy, TemperatureDependence
from cellwise.cell.plausibility.notice import Notice
from cellwise.cell.plausibility.validity import Validity
from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel

WARMED = (TemperatureDependence, Entropy)  # effects that follow the temperature
LEAST_ROWS = 3  # fewer are a sensor's spikes
LEAST_SHARE = 1e-3
ASSUMED_V = 0.01  # about what ten kelvin do at 1C: only the order of notices
OUTSIDE_V = 100.0  # above every voltage of a cell, below what makes all figures meaningless


def outside_notices(validity: Validity, log: MeasuredLog, soc: FloatArray) -> list[Notice]:
    """Which rows of a log lie outside what the model's data covered, and how far.

    A hair outside is inside (see :mod:`cellwise.cell.plausibility.validity`); what is not known,
    of the model or of the log, gives no notice.

    Parameters
    ----------
    soc : (n,) float      simulated, or estimated
    """
    found = list(_parts(validity, log, soc))
    if not found:
        return []
    text = (
        f"'{log.name or 'the log'}' leaves what the model's data covered: {'; '.join(found)}. "
        "There the error is not validated and grows with the distance"
    )
    # First: every other figure is to be read with it. But a wrong cell or unit, too, drives SOC
    # and current out of their ranges, and is then the cause: only a temperature stands by itself.
    by_itself = "degC" in text
    return [Notice(math.inf if by_itself else OUTSIDE_V, text)]


def assumed_temperature_notices(
    model: CellModel, log: MeasuredLog, assumed_C: float
) -> list[Notice]:
    """That nobody measured the temperature on which the model depends, and what is assumed."""
    measured = log.temperature_C
    if measured is not None and bool(np.any(np.isfinite(measured))):
        return []
    if model.temperature_C.size == 1 and not any(isinstance(e, WARMED) for e in model.effects):
        return []
    text = (
        f"no temperature was measured in '{log.name or 'the log'}': {assumed_C:.0f} degC is "
        "assumed (LOG@10 states another)"
    )
    return [Notice(ASSUMED_V, text)]


def outside_moment(
    validity: Validity, soc: float, temperature_C: float, current_A: float
) -> str | None:
    """Which quantity of one moment lies outside, and where the data end; None inside."""
    bounds = validity.bounds()
    found = [
        f"{name} {value:.{digits}f}{unit} (the model's data: {low:.{digits}f} to {high:.{digits}f})"
        for name, value, bound, ends, digits, unit in (
            ("SOC", soc, bounds[:2], validity.soc, 2, ""),
            ("temperature", temperature_C, bounds[2:4], validity.temperature_C, 1, " degC"),
            ("current", current_A, bounds[4:], validity.current_A, 2, " A"),
        )
        if ends is not None and (value < bound[0] or value > bound[1])
        for low, high in (ends,)
    ]
    return ", ".join(found) or None


def _parts(validity: Validity, log: MeasuredLog, soc: FloatArray) -> Iterator[str]:
    """The text for each side of a range that is left."""
    bounds = validity.bounds()
    if validity.temperature_C is not None and log.temperature_C is not None:
        cold, warm = validity.temperature_C
        at = log.temperature_C
        yield from _left(at, bounds.cold_C, "below {:.3g} degC", cold, lower=True)
        yield from _left(at, bounds.warm_C, "above {:.3g} degC", warm)
    if validity.soc is not None:
        low, high = validity.soc
        yield from _left(soc, bounds.soc_low, "below SOC {:.2f}", low, lower=True)
        yield from _left(soc, bounds.soc_high, "above SOC {:.2f}", high)
    if validity.current_A is not None:
        charge, discharge = validity.current_A
        at = log.current_A
        yield from _left(at, bounds.charge_A, "below {:.3g} A (charge)", charge, lower=True)
        yield from _left(at, bounds.discharge_A, "above {:.3g} A", discharge)


def _left(
    values: FloatArray, bound: float, side: str, end: float, *, lower: bool = False
) -> Iterator[str]:
    """The share of the rows beyond a bound, where the data end, and how far the rows go."""
    beyond = values < bound if lower else values > bound
    if np.count_nonzero(beyond) < LEAST_ROWS:  # the usual case, in one pass
        return
    known = values[np.isfinite(values)]
    rows = int(np.count_nonzero(known < bound if lower else known > bound))
    if rows < max(LEAST_ROWS, LEAST_SHARE * known.size):
        return
    furthest = float(known.min() if lower else known.max())
    share = 100.0 * rows / known.size
    yield (
        f"{share:.{0 if share >= 1.0 else 1}f} % of the rows are {side.format(end)}, where its "
        f"data end, to {furthest:.3g}"
    )
