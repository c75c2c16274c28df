"""Where a model is valid: SOC, temperature, current of its data; the voltage of one cell."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from cellwise.arguments import numbers
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.units import LARGEST_V
from cellwise.typing import FloatArray
from cellwise.wording import arg

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel


Range: TypeAlias = tuple[float, float]


# A hair outside is inside: within these a model is as good as at the edge of its data.
TOLERANCE_SOC = 0.02
TOLERANCE_K = 3.0
TOLERANCE_CURRENT = 0.1  # of the largest current in the data


class Bounds(NamedTuple):
    """Where a model is taken to hold, tolerance included; infinite where that is not known."""

    soc_low: float
    soc_high: float
    cold_C: float
    warm_C: float
    charge_A: float
    discharge_A: float


# Of the polarisation, for twice the data's current: asinh(2y) / asinh(y) from y = 1 to 4 takes 18
# to 32 % off it.
SHARE_AT_TWICE = 0.25


@dataclass(frozen=True)
class Validity:
    """The lowest and highest value that a model's data covered; None: not known.

    Parameters
    ----------
    soc : (low, high) or None             SOC, 0..1
    temperature_C : (low, high) or None   measured at the surface, or stated [degC]
    current_A : (low, high) or None       positive on discharge [A]

    Raises
    ------
    InputError        bounds that are not finite, or in the wrong order
    """

    soc: Range | None = None
    temperature_C: Range | None = None
    current_A: Range | None = None

    def __post_init__(self) -> None:
        for name in NAMES:
            given = getattr(self, name)
            if given is None:
                continue
            pair = numbers(name, given)
            if pair.shape != (2,):
                raise InputError(
                    f"a wrong entry: {pair.size} number(s) for a validity of {name}",
                    "two finite numbers, the lower one first",
                    "Correct them, or leave the quantity out where it is not known.",
                )
            low, high = pair.tolist()
            if not (np.isfinite(low) and np.isfinite(high) and low <= high):
                raise InputError(
                    f"a validity of {name} from {low:g} to {high:g}",
                    "two finite numbers, the lower one first",
                    "Correct them, or leave the quantity out where it is not known.",
                )
            object.__setattr__(self, name, (low, high))

    @property
    def known(self) -> bool:
        """Whether anything is known of the data."""
        return any(getattr(self, name) is not None for name in NAMES)

    def joined(self, other: Validity) -> Validity:
        """What the data of both covered."""
        return Validity(*(_both(getattr(self, name), getattr(other, name)) for name in NAMES))

    def extended(self, other: Validity) -> Validity:
        """Widened by further data; what is not known stays so.

        A model whose own data nobody knows does not become one of the further data alone.
        """
        both = self.joined(other)
        return Validity(
            *(None if getattr(self, name) is None else getattr(both, name) for name in NAMES)
        )

    @property
    def largest_A(self) -> float:
        """Largest current of the data, either way [A]; infinite where that is not known."""
        return np.inf if self.current_A is None else max(map(abs, self.current_A))

    def bounds(self) -> Bounds:
        """Where the model is taken to hold, tolerance included."""
        none = (-np.inf, np.inf)
        soc, temperature_C, current = (getattr(self, name) or none for name in NAMES)
        more_A = 0.0 if self.current_A is None else TOLERANCE_CURRENT * self.largest_A
        return Bounds(
            soc[0] - TOLERANCE_SOC,
            soc[1] + TOLERANCE_SOC,
            temperature_C[0] - TOLERANCE_K,
            temperature_C[1] + TOLERANCE_K,
            current[0] - more_A,
            current[1] + more_A,
        )

    def to_dict(self) -> dict[str, list[float] | None]:
        """As JSON values: pairs, null where not known."""
        return {
            name: None if getattr(self, name) is None else list(getattr(self, name))
            for name in NAMES
        }


NAMES = tuple(f.name for f in fields(Validity))
UNKNOWN = Validity()


def covered(rows: FloatArray, trim: int = 0) -> Range | None:
    """Lowest and highest of the finite rows but for ``trim`` at each end; None without any."""
    known = np.sort(rows[np.isfinite(rows)])
    if known.size == 0:
        return None
    out = min(trim, (known.size - 1) // 2)
    return float(known[out]), float(known[known.size - 1 - out])


def beyond_soc(validity: Validity, soc: FloatArray | float) -> FloatArray:
    """How far a SOC lies beyond where the model is taken to hold; 0 inside."""
    bounds = validity.bounds()
    x = np.asarray(soc, dtype=np.float64)
    return np.maximum(np.maximum(bounds.soc_low - x, x - bounds.soc_high), 0.0)


def _both(a: Range | None, b: Range | None) -> Range | None:
    if a is None or b is None:
        return a or b
    return min(a[0], b[0]), max(a[1], b[1])


# Between which voltages the median of a single cell lies, whatever load and temperature.
ABOVE_FULL_V = 1.0  # the model's full OCV, at most
SHARE_OF_EMPTY = 0.65  # of the OCV at EMPTY_SOC, at least
EMPTY_SOC = 0.05
OVERCHARGED_V = 0.15  # above full that a cell in a pack may be
FULL_V = 4.2  # of most chemistries
FULL_LFP_V = 3.65  # of LFP
MILLIVOLT_FROM = 1000.0  # a number like this is no voltage of a pack


def check_cells_in_series(model: CellModel, log: CellLog) -> None:
    """Refuse a log whose voltage is no single cell's of the model's kind.

    Raises
    ------
    InputError        names the voltages and the number of cells in series that would fit
    """
    full = float(np.max(model.ocv_V))
    empty = float(np.min([np.interp(EMPTY_SOC, model.soc, row) for row in model.ocv_V]))
    typical = log.typical_voltage_V
    expected = f"the voltage of one cell, {np.min(model.ocv_V):.2f} to {full:.2f} V by the model"
    if typical < SHARE_OF_EMPTY * empty:
        raise InputError(
            f"a voltage of typically {typical:.3g} V in log '{log.name}'",
            expected,
            "Fewer cells in series? Correct "
            + arg("series", letter="...")
            + "; or it is another kind of cell.",
        )
    if typical > full + ABOVE_FULL_V:
        raise _several_cells(log, expected, full)


def check_one_cell(log: CellLog) -> None:
    """Refuse a log whose voltage is above that of any cell.

    Raises
    ------
    InputError        names the voltage and the number of cells in series that would fit
    """
    if log.typical_voltage_V > LARGEST_V:
        expected = f"the voltage of one cell, at most {LARGEST_V:g} V"
        raise _several_cells(log, expected, FULL_V)


def cells_in_series(log: CellLog, full_V: float) -> int:
    """The fewest cells of which none is above full at the log's highest voltage."""
    return math.ceil(float(np.nanmax(log.voltage_V)) / (full_V + OVERCHARGED_V))


def _several_cells(log: CellLog, expected: str, full_V: float) -> InputError:
    cells = cells_in_series(log, full_V)
    others = cells_in_series(log, FULL_LFP_V)
    also = f" (LFP: {others})" if full_V == FULL_V and others != cells else ""
    hint: str = f"{cells} cells in series{also}? Give " + arg("series", cells) + "."
    if log.typical_voltage_V > MILLIVOLT_FROM:
        hint = "Millivolts? Name the column voltage_mV."
    found = f"a voltage of typically {log.typical_voltage_V:.4g} V in log '{log.name}'"
    return InputError(found, expected, hint)
