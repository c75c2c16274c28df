"""Constants of the fixed step, and of the functions beside it, by the names of the layout."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cellwise.cell.effects import (
    ChargeAsymmetry,
    ChargeTransfer,
    Hysteresis,
    RateDependence,
    SelfDischarge,
    SelfHeating,
    SurfaceSoc,
    TemperatureDependence,
    TimeSkew,
)
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import WHITE_BELOW_S
from cellwise.cell.plausibility.validity_kernels import validity_scalars
from cellwise.errors import InputError
from cellwise.estimate.equations.constants import (
    COUNT_ROUNDING,
    IMPOSSIBLE_RATE,
    LOST_RATE,
    OFFSET_REST_S,
    RECOVERY_RATE,
)
from cellwise.estimate.evidence_kernels import constants_of
from cellwise.estimate.fixed.options import CellSettings, Options
from cellwise.estimate.noise import WANDERS, Noise
from cellwise.estimate.power.limits import LEAST_LOAD_C
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from cellwise.estimate.power.state_of_power import PowerSettings

BRIDGED_S = 5.0  # missing samples up to here are bridged by the currents on both sides
SOH_REST_RATE = 0.02  # below C/50 a drop is a millivolt or two
SOH_REST_S = 1800.0  # of a rest until its voltage is the OCV, to the model's stated error
SOH_LOAD_RATE = 0.2  # from C/5 on a drop is tens of millivolts
SOH_LOAD_S = 30.0  # after which the OCV has moved as much as a drop of C/5
MISSING_S = 60.0  # in a lean build: for how long a current that nobody measures keeps its sign
LEAST_CUTOFF_V = 0.1
MONTH_S = 30.0 * 86_400.0
# Rejected voltages until a cell's SOC is taken for unknown.
FEWEST_TURNS, RECOVERY_S = 10, 60.0
# An error of a cell's voltage lasts for much longer than a sample: a cell is looked at every so
# often, and the others in between.
EVERY_S, MOST_TURNS = 30.0, 32


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


class SketchSettings(NamedTuple):
    """How a residual is summed: decision 0015 has what was measured with these."""

    row_s: float = 15.0  # from row to row of the sums
    age_s: float = 1000.0 * 3600.0  # of use, after which a row counts for 1/e
    slow_from_s: float = 30.0  # stated errors of longer scales are slow
    memory_s: float = 500.0  # of the model's slow error
    slow_s: float = 1500.0  # of a slow branch that the model may lack
    path_per_capacity: float = 60.0  # e-folds of a hysteresis that it may lack, over all of the SOC
    fast_V: float = 0.002  # what is not slow in a row
    low_soc: float = 0.2  # below it models of tests at constant current are off by far more
    start_soc: float = 0.02  # deviation of SOC at which a simulation begins
    longest_s: float = 8.0 * 3600.0  # then it begins again: what drifts is not the cause alone


ARRHENIUS_LOW_C, ARRHENIUS_HIGH_C = -60.0, 100.0


def step_constants(model: CellModel, dt_s: float, noise: Noise, options: Options) -> dict[str, Any]:
    """Of the step itself."""
    of_filters = constants_of(
        3600.0 * model.capacity_Ah, model.effect(Hysteresis).gamma, noise.scalars(), dt_s, dt_s
    )
    per_A = of_filters.soc_per_A
    half = max(of_filters.shared_half, 1.0)
    wanders = WANDERS if options.offset and noise.offset_share > 0.0 else 1.0
    heating = model.effect(SelfHeating)
    surface = model.effect(SurfaceSoc)
    lost_A = LOST_RATE * model.capacity_Ah
    return {
        **of_filters._asdict(),
        "soc_walk": wanders**2 * noise.soc_per_sqrt_h**2 / 3600.0 * dt_s
        + (per_A * noise.current_A) ** 2,
        "capacity_walk": noise.capacity_share**2 * per_A,
        "lost_A2": lost_A**2,
        "lost_soc": per_A * lost_A,
        "lost_walk": (per_A * lost_A) ** 2 * max(1.0, 2.0 * MISSING_S / dt_s),
        "hold_steps": steps_within(noise.hold_s, dt_s),
        "frozen_V": noise.frozen_V,
        "shared_early": max(of_filters.shared_early * (half / of_filters.shared_half), half),
        "shared_half": half,
        "gap_variance": noise.gap_soc**2,
        "current_limit_A": min(noise.current_limit_A, IMPOSSIBLE_RATE * model.capacity_Ah),
        "voltage_low_V": max(noise.voltage_low_V, TARGET.voltage_least_V),
        "voltage_high_V": min(noise.voltage_high_V, TARGET.voltage_most_V),
        "lately": min(of_filters.lately, 1.0),
        "block_steps": np.ceil(of_filters.block_steps),
        "ocv_soc2": noise.ocv_soc**2,
        "recovery_A": RECOVERY_RATE * model.capacity_Ah,
        "look_steps": np.ceil(of_filters.look_steps),
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
        "offset_A": noise.offset_share * model.capacity_Ah,
        "rate_A": model.capacity_Ah,
        "rest_steps": np.ceil(OFFSET_REST_S / dt_s),
        "soh_rest_A": SOH_REST_RATE * model.capacity_Ah,
        "soh_steps": np.ceil(SOH_REST_S / dt_s),
        "soh_load_A": SOH_LOAD_RATE * model.capacity_Ah,
        "soh_load_steps": 1.0 + np.ceil(SOH_LOAD_S / dt_s),
        "soh_capacity": model.capacity_share,
        "soh_drift": noise.offset_share * dt_s / 3600.0,
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


def sketch_constants(model: CellModel, dt_s: float, noise: Noise) -> dict[str, Any]:
    """Of a sketch of the residual, by rows of about fifteen seconds."""
    usual = SketchSettings()
    steps = max(1, round(usual.row_s / dt_s))
    row_s = steps * dt_s
    of = model.error
    slow = np.array(of.scales_s) >= usual.slow_from_s
    stated = np.array([np.median(np.square(v)) for v in of.std_V])
    shares = np.square(of.share)
    whole = stated[np.array(of.scales_s) >= WHITE_BELOW_S].sum() or 1.0  # what the table holds
    return {
        "sketch_rows": steps,
        "sketch_steps": steps,
        "sketch_share": 1.0 / steps,
        "sketch_soc": row_s / (3600.0 * model.capacity_Ah),
        "sketch_most": max(1, round(usual.longest_s / row_s)),
        "sketch_per_s": 1.0 / dt_s,
        "sketch_fade": row_s / usual.age_s,
        "sketch_keep": np.exp(-row_s / usual.memory_s),
        "sketch_branch": np.exp(-row_s / usual.slow_s),
        "sketch_path": usual.path_per_capacity * row_s / (3600.0 * model.capacity_Ah),
        "sketch_V2": usual.fast_V**2,
        "sketch_fast": stated[~slow].sum() / whole,
        "sketch_slow": stated[slow].sum() / whole,
        "sketch_fast_share": shares[~slow].sum(),
        "sketch_slow_share": np.sqrt(shares[slow].sum()),
        "sketch_low": usual.low_soc,
        "sketch_soc2": usual.start_soc**2,
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


def power_constants(model: CellModel, power: PowerSettings, dt_s: float) -> dict[str, Any]:
    """Horizon and limits; a current that nothing limits is as good as endless.

    Raises
    ------
    InputError        several horizons, a power held
    """
    if len(power.horizons_s) != 1 or power.hold != "current":
        raise InputError(
            f"{len(power.horizons_s)} horizons with hold '{power.hold}' for a fixed step",
            "one horizon with hold 'current'",
            "Give one, 10 s, say, and hold='current'.",
        )
    (horizon_s,) = power.horizons_s
    limits = power.known.scalars()
    most_A = IMPOSSIBLE_RATE * model.capacity_Ah
    return {
        "power_steps": horizon_s / dt_s,
        "power_low_V": limits.low_V,
        "power_high_V": limits.high_V,
        "power_discharge_A": min(limits.discharge_A, most_A),
        "power_charge_A": min(limits.charge_A, most_A),
        "power_soc_low": limits.low_soc,
        "power_soc_high": limits.high_soc,
    }


def remaining_constants(model: CellModel, cutoff_V: float, dt_s: float) -> dict[str, Any]:
    """What the remaining time reads beside the step's constants.

    Raises
    ------
    InputError        a cutoff that is not below the model's full OCV
    """
    if not LEAST_CUTOFF_V <= cutoff_V < float(np.max(model.ocv_V)):
        raise InputError(
            f"a cutoff of {cutoff_V:g} V",
            f"{LEAST_CUTOFF_V:g} V to the model's full OCV, {float(np.max(model.ocv_V)):.2f} V",
            "Give the voltage of a cell, not of the pack.",
        )
    return {
        "remaining_low_V": cutoff_V,
        "remaining_least_A": LEAST_LOAD_C * model.capacity_Ah,
        "remaining_share": 2.0 * model.capacity_share,
        "step_s": dt_s,
    }


def turns_of(dt_s: float) -> int:
    """Samples in which every cell is looked at once."""
    return int(min(max(EVERY_S // dt_s, 1.0), MOST_TURNS))


def cell_constants(settings: CellSettings, model: CellModel, dt_s: float) -> dict[str, Any]:
    """What the fixed step reads of the settings, by the names of its layout."""

    def walk(month: float) -> float:
        return month**2 * dt_s / MONTH_S

    ocv = model.ocv_V[0]
    slope_V = float(np.interp(0.9, model.soc, ocv) - np.interp(0.1, model.soc, ocv)) / 0.8
    single_V2 = settings.sensor_V**2
    turns = turns_of(dt_s)
    return {
        "cell_soc2": settings.soc**2,
        "cell_capacity2": settings.capacity**2,
        "cell_resistance2": settings.resistance**2,
        "cell_soc_walk": walk(settings.soc_month),
        "cell_capacity_walk": walk(settings.capacity_month),
        "cell_resistance_walk": walk(settings.resistance_month),
        "cell_V2": single_V2,
        "cell_shared": max(2.0 * settings.memory_s / (turns * dt_s), 1.0),
        "cell_lag": min(settings.lag_s / dt_s, 1.0) ** 2,
        "cell_least_soc2": single_V2 / max(slope_V, 1e-3) ** 2,
        "cell_turns": turns,
        "cell_recovery": int(max(RECOVERY_S / (turns * dt_s), FEWEST_TURNS)),
    }
