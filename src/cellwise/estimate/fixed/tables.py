"""A CellModel at a fixed time step as float32 tables: computed in float64, rounded once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.description import BRANCHES
from cellwise.cell.effects import (
    ChargeAsymmetry,
    ChargeTransfer,
    Effect,
    Hysteresis,
    RateDependence,
    SelfDischarge,
    SelfHeating,
    SurfaceSoc,
    TemperatureDependence,
    TimeSkew,
    effect_table,
)
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.cell.model import TABLES, CellModel, branch_table
from cellwise.cell.plausibility.validity_kernels import validity_scalars
from cellwise.cell.resolved import needs_rows, over_temperature
from cellwise.cell.unrolled import CALLED
from cellwise.errors import InputError
from cellwise.estimate.cells.settings import cell_constants
from cellwise.estimate.evidence_kernels import CONTRADICTED_S, COUNT_ROUNDING
from cellwise.estimate.fixed.layout import constant_type, row_names
from cellwise.estimate.fixed.options import Asked, Options, options_of
from cellwise.estimate.noise import Noise
from cellwise.estimate.power.fixed_tables import (
    CURRENT_LIMIT_C,
    lag,
    power_constants,
    remaining_constants,
)
from cellwise.estimate.recovery_kernels import (
    RECOVERY_RATE,
    START_BRANCH_V,
    START_LOAD_RATE,
    START_REST_RATE,
)
from cellwise.estimate.sensing_kernels import LOST_RATE, REST_RATE
from cellwise.estimate.slopes_kernels import FLAT_SHARE
from cellwise.typing import FloatArray

Float32Array = NDArray[np.float32]

BRIDGED_S = 5.0  # missing samples up to here are bridged by the currents on both sides
MISSING_S = 60.0  # in a lean build: for how long a current that nobody measures keeps its sign


class TargetLimits(NamedTuple):
    """What a target can hold in float32."""

    smallest_gain: float = 1e-6  # below it float32 rounds a branch's variance away
    voltage_most_V: float = 1000.0
    voltage_least_V: float = 1e-3  # above zero: the C compares bits
    points: int = 4001  # of a table over SOC
    temperatures: int = 32
    steps: int = 1_000_000_000  # that a counter reaches
    endless: float = 1e6  # beyond any SOC, temperature and current that a step lets pass


TARGET = TargetLimits()

ARRHENIUS_LOW_C, ARRHENIUS_HIGH_C = -60.0, 100.0
ARRHENIUS_POINTS = 161
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
    options = options_of(model, wish, ARRHENIUS_POINTS)
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
    for name, value in (_constants(model, dt_s, noise, options) | more).items():
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


def _constants(model: CellModel, dt_s: float, noise: Noise, options: Options) -> dict[str, Any]:
    per_A = dt_s / (3600.0 * model.capacity_Ah)
    slow_s = noise.slow_s
    shared = max(2.0 * slow_s / dt_s, 1.0)
    half_s = max(noise.slow_half_s, dt_s)
    early_s = half_s * min(noise.slow_first_s / max(slow_s, dt_s), 1.0)
    adapts = noise.mismatch_cap > 0 and slow_s > 0
    heating = model.effect(SelfHeating)
    surface = model.effect(SurfaceSoc)
    lost_A = LOST_RATE * model.capacity_Ah
    return {
        "soc_per_A": per_A,
        "soc_walk": noise.soc_per_sqrt_h**2 / 3600.0 * dt_s + (per_A * noise.current_A) ** 2,
        "current_variance_A2": noise.current_A**2,
        "lost_A2": lost_A**2,
        "lost_soc": per_A * lost_A,
        "lost_walk": (per_A * lost_A) ** 2 * max(1.0, 2.0 * MISSING_S / dt_s),
        "hold_steps": steps_within(noise.hold_s, dt_s),
        "frozen_V": noise.frozen_V,
        "flat_slope_V": FLAT_SHARE * float(model.ocv_V[0, -1] - model.ocv_V[0, 0]),
        "share_variance": noise.branch_share**2,
        "charge_variance": (noise.charge_factor * noise.branch_share) ** 2,
        "gate_square": noise.gate**2,
        "shared": shared,
        "shared_early": max(shared * early_s, half_s) / dt_s,
        "shared_half": half_s / dt_s,
        "lately": min(dt_s / slow_s, 1.0) if adapts else 0.0,
        "mismatch_cap": noise.mismatch_cap,
        "gap_variance": noise.gap_soc**2,
        "current_limit_A": min(noise.current_limit_A, CURRENT_LIMIT_C * model.capacity_Ah),
        "voltage_low_V": max(noise.voltage_low_V, TARGET.voltage_least_V),
        "voltage_high_V": min(noise.voltage_high_V, TARGET.voltage_most_V),
        "branch_variance_V2": START_BRANCH_V**2,
        "rest_A": REST_RATE * model.capacity_Ah,
        "start_rest_A": START_REST_RATE * model.capacity_Ah,
        "start_load_A": START_LOAD_RATE * model.capacity_Ah,
        "fixed_V2": noise.voltage_V**2,
        "ocv_soc2": noise.ocv_soc**2,
        "recovery_A": RECOVERY_RATE * model.capacity_Ah,
        "recovery_after": steps_rejected(noise, dt_s),
        "gap_steps": int(np.ceil(BRIDGED_S / dt_s)),
        "charge_efficiency": model.charge_efficiency,
        "leak_soc": per_A * model.effect(SelfDischarge).leak_A,
        "skew_share": min(model.effect(TimeSkew).skew_s / dt_s, 1.0),
        "rate_per_A": model.effect(RateDependence).rate_h / model.capacity_Ah,
        "charge_scale": model.effect(ChargeAsymmetry).charge_scale,
        "asinh_per_V": model.effect(ChargeTransfer).asinh_per_V,
        "surface_per_A": surface.depth_h / model.capacity_Ah,
        "surface_gain": -np.expm1(-dt_s / surface.tau_s),
        "surface_rate": dt_s / surface.tau_s,
        "hysteresis_per_A": model.effect(Hysteresis).gamma * per_A,
        "drift_soc": noise.offset_share * dt_s / 3600.0,
        "contradicted_share": min(dt_s / CONTRADICTED_S, 1.0),
        "heat_K_per_W": heating.rth_K_per_W,
        "heat_gain": -np.expm1(-dt_s / heating.thermal_s),
        "heat_rate": dt_s / heating.thermal_s,
        "temperature_C": model.usual_temperature_C,
        **_temperature_tables(model, options),
        **_validity(model, noise),
    }


def _validity(model: CellModel, noise: Noise) -> dict[str, Any]:
    """Where the model is valid; what is not known is as good as endless."""
    valid = validity_scalars(model)
    bounds = np.clip(valid[:6], -TARGET.endless, TARGET.endless)
    names = ("soc_low", "soc_high", "cold_C", "warm_C", "charge_A", "discharge_A")
    scale = noise.error_scale
    return {
        **{f"valid_{name}": bound for name, bound in zip(names, bounds, strict=True)},
        "share_per_A": scale * valid.share_per_A,
        "share_per_K": scale * valid.share_per_K,
        "voltage_per_K": scale * valid.voltage_per_K,
    }


def steps_within(seconds: float, dt_s: float) -> int:
    """Whole time steps within a time; one that falls on its end belongs to it."""
    return int(min(np.floor(seconds / dt_s * (1.0 + 1e-9)), TARGET.steps))


def steps_rejected(noise: Noise, dt_s: float) -> int:
    """Rejected steps in a row that recover: each counts for its time, at most for one, as there."""
    steps = np.ceil((noise.recovery_after - COUNT_ROUNDING) / min(dt_s, 1.0))
    return int(min(max(steps, 1), TARGET.steps))


def _temperature_tables(model: CellModel, options: Options) -> dict[str, Any]:
    effect, surface = model.effect(TemperatureDependence), model.effect(SurfaceSoc)
    per_A = surface.depth_h / model.capacity_Ah
    found: dict[str, Any] = {
        "arrhenius_low_C": ARRHENIUS_LOW_C,
        "arrhenius_per_K": _points_per_K(options.arrhenius),
        "arrhenius": _factors(effect, options.arrhenius),
        "depth_low_C": ARRHENIUS_LOW_C,
        "depth_per_K": _points_per_K(options.depth),
        "depth": per_A * _factors(surface, options.depth),
    }
    if options.temperatures > 1:
        found["grid_C"] = model.temperature_C
        found["per_K"] = 1.0 / np.diff(model.temperature_C)
    return found


def _points_per_K(points: int) -> float:
    return (max(points, 2) - 1) / (ARRHENIUS_HIGH_C - ARRHENIUS_LOW_C)


def _factors(effect: TemperatureDependence | SurfaceSoc, points: int) -> FloatArray:
    """Arrhenius factors of an effect from ARRHENIUS_LOW_C to ARRHENIUS_HIGH_C."""
    kelvin = np.linspace(ARRHENIUS_LOW_C, ARRHENIUS_HIGH_C, max(points, 2)) + ZERO_CELSIUS_K
    reference_K = effect.reference_C + ZERO_CELSIUS_K
    with np.errstate(over="ignore"):
        return np.asarray(np.exp(effect.activation_K * (1.0 / kelvin - 1.0 / reference_K)))


def _check_float32(name: str, value: NDArray[Any]) -> None:
    if not np.all(np.isfinite(value)):
        raise InputError(
            f"{name} that float32 cannot hold", "finite values", "Check the model's parameters."
        )
