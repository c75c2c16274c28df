"""A CellModel at a fixed time step as float32 tables: computed in float64, rounded once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

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
    sketch_constants,
    step_constants,
)
from cellwise.estimate.fixed.layout import constant_type, row_names, sketch_type
from cellwise.estimate.fixed.options import (
    SMALL_SKETCH,
    WHOLE_SKETCH,
    Asked,
    Options,
    options_of,
)
from cellwise.estimate.noise import Noise
from cellwise.typing import FloatArray
from cellwise.wording import arg

Float32Array = NDArray[np.float32]

# Rows of tables where a temperature effect has no other form on a target.
ROWS_C = np.arange(-30.0, 65.0, 5.0)
SOC_GRIDS = (51, 101, 201)  # points to choose from where none are asked for
# A miss of a quarter of the stated voltage error, were it one everywhere, would add 3 % to it.
MOST_MISSED = 0.25
LEAST_ERROR_V = 1e-6  # of float32 near 4 V, whatever is stated


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

    @classmethod
    def from_bytes(cls, dt_s: float, options: Options, memory: bytes) -> FixedStepTables:
        """The tables of a struct ``cellwise_model``."""
        kind = constant_type(options)
        constants = np.frombuffer(memory, dtype=kind, count=1).copy()
        rows = np.frombuffer(memory, dtype=np.float32, offset=kind.itemsize).copy()
        shape = options.temperatures, options.points, len(row_names(options))
        return cls(dt_s, options, constants, rows.reshape(shape))


class SocGrid(NamedTuple):
    """How many SOC points tables have, and what interpolation between them misses at most.

    ``missed`` is a fraction of the model's stated voltage error; ``by_default`` that nobody asked
    for this number.
    """

    points: int
    missed: float
    model_points: int
    by_default: bool

    @property
    def text(self) -> str:
        """The number, and why, as a statement without its stop."""
        if not self.by_default:
            why = "as asked for"
        elif self.points == self.model_points:
            return f"{self.points} SOC points, the model's own: fewer would cost accuracy"
        else:
            why = f"the fewest of those with at most {100.0 * MOST_MISSED:g} %"
        return (
            f"{self.points} SOC points of the model's {self.model_points}: between them OCV and R0 "
            f"at 1C miss at most {100.0 * self.missed:.2g} % of the stated voltage error, {why}"
        )

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {**self._asdict(), "most_missed": MOST_MISSED, "text": self.text}


def soc_grid(model: CellModel, points: int | None = None) -> SocGrid:
    """The points that are asked for, else the fewest with which the model loses no accuracy.

    The smallest of ``SOC_GRIDS`` where linear interpolation misses OCV and R0 at 1C together by at
    most ``MOST_MISSED`` of the model's own stated voltage error, at every SOC and temperature; the
    model's own number where none does.

    Raises
    ------
    InputError        fewer than 3 points
    """
    own = model.points
    if points is not None:
        return SocGrid(points, missed_by(model, points), own, False)
    coarser = (SocGrid(n, missed_by(model, n), own, True) for n in SOC_GRIDS if n < own)
    fine = SocGrid(own, 0.0, own, True)
    return next((grid for grid in coarser if grid.missed <= MOST_MISSED), fine)


def missed_by(model: CellModel, points: int) -> float:
    """What interpolation between so many SOC points misses, over the stated voltage error.

    The largest over SOC and temperature, of OCV and R0 at 1C. Both curves are straight between
    points, and equal at the new ones, so they are furthest apart at one of the model's own.

    Raises
    ------
    InputError        fewer than 3 points
    """
    if points == model.points:
        return 0.0
    coarse = resampled(model, points)

    def off(name: str) -> FloatArray:
        fine, rough = getattr(model, name), getattr(coarse, name)
        back = [np.interp(model.soc, coarse.soc, row) for row in rough]
        return np.asarray(np.abs(np.array(back) - fine))

    missed_V = off("ocv_V") + off("r0_ohm") * model.capacity_Ah
    return float(np.max(missed_V / np.maximum(model.slow_error_tables_V(), LEAST_ERROR_V)))


def resampled(model: CellModel, points: int) -> CellModel:
    """The model on another number of SOC points, linear between its own.

    Raises
    ------
    InputError        fewer than 3 points
    """
    if points < 3:
        raise InputError(
            f"{points} SOC points", "at least 3", "Give e.g. " + arg("points", 101) + "."
        )
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
        raise InputError(
            f"a time step of {dt_s} s", "seconds above zero", "Give e.g. " + arg("dt_s", 0.1) + "."
        )
    wish = Asked(**asked)
    noise = Noise.of_model(model) if noise is None else noise
    points = soc_grid(model, wish.points).points
    if points != model.points:
        model = resampled(model, points)
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
    if wish.sketch:
        options = with_room(options, wish.sketch)
        more |= sketch_constants(model, dt_s, noise)
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
            "Give " + arg("points", 101) + ", or fewer temperatures.",
        )
    slowest = _slowest_s(model, options)
    if dt_s / slowest < TARGET.smallest_gain:
        raise InputError(
            f"a time constant of {slowest:g} s at a time step of {dt_s:g} s",
            f"at most {1 / TARGET.smallest_gain:g} steps: float32 cannot hold slower ones",
            f"Give a time step of at least {TARGET.smallest_gain * slowest:.2g} s.",
        )


def with_room(options: Options, most: int) -> Options:
    """The options with the sketch that so many bytes hold.

    Raises
    ------
    InputError        fewer bytes than the smallest one takes
    """
    for kept in (WHOLE_SKETCH, SMALL_SKETCH):
        found = replace(options, sketch=kept, sketch_sums=kept * (kept + 1) // 2)
        needed = sketch_type(found).itemsize
        if needed <= most:
            return found
    wanted = f"{needed} or more for this model"
    raise InputError(f"{most} bytes for a sketch", wanted, "Give " + arg("sketch", 256) + ".")


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
