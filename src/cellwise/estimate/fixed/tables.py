"""A CellModel at a fixed time step as float32 tables: computed in float64, rounded once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.description import BRANCHES
from cellwise.cell.effects import Effect, Hysteresis, SurfaceSoc, effect_table
from cellwise.cell.model import TABLES, CellModel, branch_table
from cellwise.cell.resolved import needs_rows, over_temperature
from cellwise.cell.unrolled import CALLED
from cellwise.errors import InputError
from cellwise.estimate.fixed.constants import (
    TARGET,
    cell_constants,
    power_constants,
    remaining_constants,
    step_constants,
)
from cellwise.estimate.fixed.layout import constant_type, row_names
from cellwise.estimate.fixed.options import Asked, Options, options_of
from cellwise.estimate.noise import Noise
from cellwise.typing import FloatArray

Float32Array = NDArray[np.float32]

# Rows of tables where a temperature effect has no other form on a target.
ROWS_C = np.arange(-30.0, 65.0, 5.0)


@dataclass(frozen=True, eq=False)
class FixedStepTables:
    """What a fixed step reads: options, one record of constants, table (temperatures, points, row).

    ``dt_s`` is the time step they hold for.
    """

    dt_s: float
    options: Options
    constants: NDArray[Any]
    table: Float32Array

    @property
    def flash_bytes(self) -> int:
        """Size of the model in read-only memory."""
        return int(self.constants.nbytes + self.table.nbytes)

    def to_bytes(self) -> bytes:
        """The bytes of the C struct ``cellwise_model``."""
        return self.constants.tobytes() + self.table.tobytes()


def resampled(model: CellModel, points: int) -> CellModel:
    """The model on another number of SOC points, linear between its own.

    Raises
    ------
    InputError        fewer than 3 points
    """
    if points < 3:
        raise InputError(f"{points} SOC points", "at least 3", "Give e.g. `points=101`.")
    soc = np.linspace(0.0, 1.0, points)

    def over(table: FloatArray) -> FloatArray:
        return np.array([np.interp(soc, model.soc, row) for row in table])

    def effect_over(effect: Effect) -> Effect:
        tables: dict[str, Any] = {
            key: over(value) for key, value in vars(effect).items() if np.ndim(value) == 2
        }
        return replace(effect, **tables)

    tables: dict[str, Any] = {name: over(getattr(model, name)) for name in TABLES}
    return replace(model, **tables, effects=tuple(effect_over(e) for e in model.effects))


def fixed_step_tables(
    model: CellModel, dt_s: float, noise: Noise | None = None, **asked: Any
) -> FixedStepTables:
    """Tables of a model at a time step.

    Parameters
    ----------
    noise : Noise or None     None: from the model's own validation error
    asked                     fields of :class:`~cellwise.estimate.fixed.options.Asked`

    Raises
    ------
    InputError        a time step that is not above zero; a model that float32 at this time step
                      cannot hold (see :func:`check_holds`); what ``Asked`` refuses
    """
    if not (np.isfinite(dt_s) and dt_s > 0):
        raise InputError(f"a time step of {dt_s} s", "seconds above zero", "Give e.g. `dt_s=0.1`.")
    wish = Asked(**asked)
    noise = Noise.of_model(model) if noise is None else noise
    if wish.points is not None and wish.points != model.points:
        model = resampled(model, wish.points)
    if needs_rows(model):
        model = over_temperature(model, ROWS_C)
    options = options_of(model, wish)
    check_holds(model, dt_s, options)
    columns = _columns(model, dt_s, noise)
    more: dict[str, Any] = {}
    if wish.power is not None:
        more = power_constants(model, wish.power, dt_s)
    if wish.remaining_V is not None:
        more |= remaining_constants(model, wish.remaining_V, dt_s)
    if wish.cells is not None:
        more |= cell_constants(wish.cells, model, dt_s)
    table = np.stack([columns[name] for name in row_names(options)], axis=-1)
    constants = np.zeros(1, dtype=constant_type(options))
    for name, value in (step_constants(model, dt_s, noise, options) | more).items():
        if name in (constants.dtype.names or ()):
            constants[name] = value
    for name in constants.dtype.names or ():
        _check_float32(name, constants[name])
    _check_float32("a table", table.astype(np.float32))
    return FixedStepTables(float(dt_s), options, constants, table.astype(np.float32))


def check_holds(model: CellModel, dt_s: float, options: Options) -> None:
    """Refuse what the target cannot hold.

    Raises
    ------
    InputError        a time constant beyond 1e6 steps, too many SOC points or temperatures
    """
    if not 3 <= options.points <= TARGET.points or options.temperatures > TARGET.temperatures:
        raise InputError(
            f"{options.points} SOC points at {options.temperatures} temperature(s)",
            f"3 to {TARGET.points} points, at most {TARGET.temperatures} temperatures",
            "Give `points=101`, or fewer temperatures.",
        )
    slowest = _slowest_s(model, options)
    if dt_s / slowest < TARGET.smallest_gain:
        raise InputError(
            f"a time constant of {slowest:g} s at a time step of {dt_s:g} s",
            f"at most {1 / TARGET.smallest_gain:g} steps: float32 cannot hold slower ones",
            f"Give a time step of at least {TARGET.smallest_gain * slowest:.2g} s.",
        )


def shortest_step_s(model: CellModel, options: Options) -> float:
    """The shortest time step at which float32 holds the model's time constants [s]."""
    return TARGET.smallest_gain * _slowest_s(model, options)


def _slowest_s(model: CellModel, options: Options) -> float:
    """The slowest time constant that is compiled in [s]."""
    slowest = max(
        float(np.max(branch_table(model, "tau", s)))
        for s in BRANCHES
        if not s.option or getattr(options, s.option)
    )
    return max(slowest, model.effect(SurfaceSoc).tau_s) if options.surface else slowest


def lag(tau_s: FloatArray, over_s: float) -> FloatArray:
    """1 / (1 - exp(-t / tau)): all but linear in tau, so it is interpolated as tau is."""
    return np.asarray(-1.0 / np.expm1(-over_s / tau_s))


def _columns(model: CellModel, dt_s: float, noise: Noise) -> dict[str, FloatArray]:
    shape = (model.temperature_C.size, model.points)
    return {
        "ocv_V": model.ocv_V,
        "error_V": noise.error_scale * model.slow_error_tables_V(),
        "r0_ohm": model.r0_ohm,
        **{CALLED["r"](s): branch_table(model, "r", s) for s in BRANCHES},
        **{f"lag{s.letter}": lag(branch_table(model, "tau", s), dt_s) for s in BRANCHES},
        "m_V": effect_table(model.effect(Hysteresis).m_V, shape),
    }


def _check_float32(name: str, value: NDArray[Any]) -> None:
    if not np.all(np.isfinite(value)):
        raise InputError(
            f"{name} that float32 cannot hold", "finite values", "Check the model's parameters."
        )
