"""A cell's model packed for the kernels, as the description says where each number comes from."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from cellwise.cell.description import COLUMNS, SCALARS
from cellwise.cell.effects import (
    BRANCH_ACTIVATIONS,
    EFFECTS,
    Entropy,
    Hysteresis,
    TemperatureDependence,
    effect_table,
)
from cellwise.cell.equations import ZERO_CELSIUS_K, CellTables
from cellwise.cell.point_kernels import CellScalars
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel

# Numbers that are not taken over as they are: in other units, or 0 where nothing follows from them.
CONVERTED: dict[str, Callable[[CellModel, float], float]] = {
    "charge_As": lambda model, value: 3600.0 * value,
    "reference_K": lambda model, value: value + ZERO_CELSIUS_K,
    "hysteresis_rate": lambda model, value: value if np.any(model.effect(Hysteresis).m_V) else 0.0,
    "rate_per_A": lambda model, value: value / model.capacity_Ah,
    "surface_per_A": lambda model, value: value / model.capacity_Ah,
    "surface_reference_K": lambda model, value: value + ZERO_CELSIUS_K,
    "branch_activation": lambda model, value: float(_has_branch_activation(model)),
    "entropy_K": lambda model, value: (
        value + ZERO_CELSIUS_K if np.any(model.effect(Entropy).docv_dT_V_per_K) else 0.0
    ),
}


def packed(model: CellModel) -> CellTables:
    """The packed table (temperatures, soc points, COLUMNS), its temperatures, the scalars."""
    shape = model.ocv_V.shape
    columns = [effect_table(_source(model, column.source), shape) for column in COLUMNS]
    table = np.ascontiguousarray(np.stack(columns, axis=-1))
    scalars = {}
    for scalar in SCALARS:
        value = float(_source(model, scalar.source))
        convert = CONVERTED.get(scalar.name)
        scalars[scalar.name] = float(convert(model, value)) if convert else value
    return CellTables(table, np.ascontiguousarray(model.temperature_C), CellScalars(**scalars))


def _source(model: CellModel, name: str) -> FloatArray | float:
    if name == "error":
        return model.slow_error_tables_V()
    holder, _, parameter = name.rpartition(".")
    value: FloatArray | float = getattr(
        model.effect(EFFECTS[holder]) if holder else model, parameter
    )
    return value


def _has_branch_activation(model: CellModel) -> bool:
    effect = model.effect(TemperatureDependence)
    return any(getattr(effect, f"{name}_K") != 0.0 for name in BRANCH_ACTIVATIONS)
