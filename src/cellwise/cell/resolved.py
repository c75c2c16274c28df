"""A model whose temperature effects have become rows of its temperature axis."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cellwise.cell.effects import IN_TABLES, Effect, beside_common_activation, is_neutral
from cellwise.cell.equations import look_up
from cellwise.cell.model import TABLES, CellModel
from cellwise.cell.point_kernels import COLUMN_SOURCES
from cellwise.typing import FloatArray


def needs_rows(model: CellModel) -> bool:
    """Whether an effect of temperature has no other form on a target than rows of tables.

    The factor that all resistances have in common has one of its own.
    """
    return any(isinstance(e, IN_TABLES) for e in beside_common_activation(model.effects))


def over_temperature(model: CellModel, temperature_C: FloatArray) -> CellModel:
    """The model with one row of tables for each temperature, and no effect of temperature left.

    Between the rows everything is linear: an Arrhenius factor bends, so rows of 5 K are within
    about 1 % of it at 5,000 K and -20 degC.

    Parameters
    ----------
    temperature_C : (temperatures,) float      ascending [degC]
    """
    tables = model.parameters()
    rows = [[look_up(tables, soc, float(warm)) for soc in model.soc] for warm in temperature_C]

    def over(field: str) -> FloatArray:
        return np.array([[getattr(point, field) for point in row] for row in rows])

    def resolved(effect: Effect) -> Effect:
        sources = {s: c for c, s in COLUMN_SOURCES.items() if s.startswith(f"{effect.name}.")}
        tables: dict[str, Any] = {s.partition(".")[2]: over(c) for s, c in sources.items()}
        return replace(effect, **tables)

    rows_of: dict[str, Any] = {name: over(name) for name in TABLES}
    return replace(
        model,
        **rows_of,
        temperature_C=np.asarray(temperature_C, dtype=np.float64),
        effects=tuple(
            resolved(e) for e in model.effects if not isinstance(e, IN_TABLES) and not is_neutral(e)
        ),
    )
