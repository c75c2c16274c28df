"""Effects: how the plain 2-RC model is extended, one small record each.

Every record has a neutral value at which the model is exactly the plain one. Kernels never ask
which effects there are: :meth:`CellModel.effect` gives the neutral value for an absent one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np

from cellwise.errors import InputError
from cellwise.typing import FloatArray

# Resistances and time constants with an activation energy of their own.
BRANCH_ACTIVATIONS = ("r0", "r1", "tau1", "r2", "tau2", "r3", "tau3")


def between(low: float, high: float, *, off: bool = False) -> dict[str, Any]:
    """What is known of a parameter: its bounds, and whether its default switches the effect off."""
    return {"bounds": (low, high), "off": off}


LARGEST_K = 15000.0  # 125 kJ/mol over the gas constant: more than any process in a cell


def activation(*, off: bool = False) -> Any:
    """A field of an activation energy over the gas constant [K], 0 unless said."""
    return field(default=0.0, metadata=between(-2000.0, LARGEST_K, off=off))


def added_activation() -> Any:
    """A field of what one resistance or time constant has beside the common one [K]."""
    return field(default=0.0, metadata=between(-LARGEST_K, LARGEST_K, off=True))


def reference() -> Any:
    """A field of the temperature at which a parameter holds: 25 degC unless said [degC]."""
    return field(default=25.0, metadata=between(-50.0, 90.0))


@dataclass(frozen=True, eq=False)
class Effect:
    """What all effects have: a name, the bounds of each parameter, values that switch it off."""

    name: ClassVar[str] = ""
    bounds: ClassVar[dict[str, tuple[float, float]]] = {}
    neutral: ClassVar[dict[str, float]] = {}

    def __init_subclass__(cls) -> None:
        """Take name, bounds and neutral values from the class and its parameters."""
        own: dict[str, Any] = {n: x for n, x in vars(cls).items() if isinstance(x, Field)}
        cls.name = re.sub(r"(?<!^)([A-Z])", r"_\1", cls.__name__).lower()
        cls.bounds = {name: one.metadata["bounds"] for name, one in own.items()}
        cls.neutral = {n: float(one.default) for n, one in own.items() if one.metadata["off"]}


@dataclass(frozen=True, eq=False)
class SlowDiffusion(Effect):
    """A third RC branch for what 10 s pulses cannot see. Neutral: ``r3_ohm`` = 0.

    ``r3_ohm`` [ohm] and ``tau3_s`` [s] are numbers, or tables of shape (temperatures, soc points).
    """

    r3_ohm: FloatArray | float = field(default=0.0, metadata=between(0.0, 1e6, off=True))
    tau3_s: FloatArray | float = field(default=1000.0, metadata=between(1.0, 1e6))


@dataclass(frozen=True, eq=False)
class Hysteresis(Effect):
    """One-state hysteresis M h (Plett), h from -1 (discharged into) to +1 (charged into).

    ``m_V`` [V] is half the gap between the charge and the discharge branch, a number or a table;
    ``gamma`` [1] says how fast a branch is reached, in e-folds per full charge. Neutral: m_V = 0.
    """

    m_V: FloatArray | float = field(default=0.0, metadata=between(-0.5, 0.5, off=True))
    gamma: float = field(default=0.0, metadata=between(0.0, 1e5))


@dataclass(frozen=True, eq=False)
class TemperatureDependence(Effect):
    """Arrhenius factors exp(E (1/T - 1/T_ref)). Neutral: every E = 0 K.

    ``activation_K`` [K] is the activation energy over the gas constant that every resistance has in
    common, ``r0_K``, ``r1_K``, ``r2_K``, ``r3_K`` what one resistance has beside it, ``tau1_K``,
    ``tau2_K``, ``tau3_K`` those of the time constants; ``reference_C`` [degC] is where the tables
    hold.
    """

    activation_K: float = activation(off=True)
    reference_C: float = reference()
    r0_K: float = added_activation()
    r1_K: float = added_activation()
    tau1_K: float = added_activation()
    r2_K: float = added_activation()
    tau2_K: float = added_activation()
    r3_K: float = added_activation()
    tau3_K: float = added_activation()


@dataclass(frozen=True, eq=False)
class TimeSkew(Effect):
    """The sampling delay: the logged voltage lags the logged current by ``skew_s``. Neutral: 0 s.

    It belongs to the logger, not to the cell; it is kept with the model because a filter that
    runs on the same logger needs it.
    """

    skew_s: float = field(default=0.0, metadata=between(0.0, 60.0, off=True))


@dataclass(frozen=True, eq=False)
class RateDependence(Effect):
    """Resistances R0, R1, R2 times 1 / (1 + k |I| / capacity). Neutral: ``rate_h`` = 0.

    ``rate_h`` [h] is k: 0.1 means that at 1C the resistances have fallen by a factor of 1.1.
    Negative: they rise with the current.
    """

    rate_h: float = field(default=0.0, metadata=between(-0.05, 10.0, off=True))


@dataclass(frozen=True, eq=False)
class ChargeTransfer(Effect):
    """The fast branch follows the asinh law of a charge transfer. Neutral: ``asinh_per_V`` = 0.

    ``asinh_per_V`` [1/V] is k in V1 -> asinh(k R1 I) / k: R1 is the resistance at small currents,
    1 / (2 k R1) the exchange current, which follows R1 over SOC and temperature. One
    electron and a symmetric reaction (Butler-Volmer): F / (2 R T), 19.5 per volt at 25 degC.
    """

    asinh_per_V: float = field(default=0.0, metadata=between(0.0, 200.0, off=True))


@dataclass(frozen=True, eq=False)
class SurfaceSoc(Effect):
    """Under load the surface of the particles is emptier than their mean. Neutral: ``depth_h`` = 0.

    Resistances and time constants are looked up at SOC - depth exp(E (1/T - 1/T_ref)) I / Q, with
    the current I through a lag of first order; the OCV stays at the mean SOC. ``depth_h`` [h]:
    0.06 means that the surface is 6 % of SOC below the mean after long at 1C; ``tau_s`` [s] is the
    lag's time constant, ``activation_K`` [K] the activation energy of the depth over the gas
    constant, ``reference_C`` [degC] where ``depth_h`` holds. A lumped model of solid diffusion.
    """

    depth_h: float = field(default=0.0, metadata=between(0.0, 1.0, off=True))
    tau_s: float = field(default=300.0, metadata=between(1.0, 1e5))
    activation_K: float = activation()
    reference_C: float = reference()


@dataclass(frozen=True, eq=False)
class ChargeAsymmetry(Effect):
    """Every resistance times ``charge_scale`` while the cell is charged. Neutral: 1."""

    charge_scale: float = field(default=1.0, metadata=between(0.1, 10.0, off=True))


@dataclass(frozen=True, eq=False)
class SelfHeating(Effect):
    """The cell is warmer than the temperature of the log by what its losses heat it.

    ``rth_K_per_W`` [K/W] is the steady rise per watt lost, ``thermal_s`` [s] the time constant.
    Neutral: ``rth_K_per_W`` = 0. Without a temperature axis or an Arrhenius factor nothing follows
    from the rise.
    """

    rth_K_per_W: float = field(default=0.0, metadata=between(0.0, 200.0, off=True))
    thermal_s: float = field(default=600.0, metadata=between(1.0, 1e5))


@dataclass(frozen=True, eq=False)
class SelfDischarge(Effect):
    """A current ``leak_A`` [A] inside the cell that no sensor sees. Neutral: 0."""

    leak_A: float = field(default=0.0, metadata=between(0.0, 1e3, off=True))


@dataclass(frozen=True, eq=False)
class Entropy(Effect):
    """The OCV moves with temperature: + dOCV/dT (T - T_ref). Neutral: dOCV/dT = 0.

    ``docv_dT_V_per_K`` [V/K] is the entropy of the reaction over the Faraday constant, a number or
    a table over SOC; ``reference_C`` [degC] is where the OCV table holds.
    """

    docv_dT_V_per_K: FloatArray | float = field(
        default=0.0, metadata=between(-0.005, 0.005, off=True)
    )
    reference_C: float = reference()


EFFECTS: dict[str, type[Effect]] = {kind.name: kind for kind in Effect.__subclasses__()}

# What they say at a SOC and a temperature is the same under every load and after every past: a
# target, which has no term for them, gets it as rows of its tables.
IN_TABLES = (TemperatureDependence, Entropy)


def is_neutral(effect: Effect) -> bool:
    """Whether the model with an effect is the model without it."""
    return all(np.all(getattr(effect, name) == value) for name, value in effect.neutral.items())


def beside_common_activation(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Effects that are not neutral without the factor that all resistances have in common."""
    rest = (
        replace(e, activation_K=0.0) if isinstance(e, TemperatureDependence) else e for e in effects
    )
    return tuple(e for e in rest if not is_neutral(e))


def check_effect(effect: Effect, shape: tuple[int, int]) -> None:
    """Refuse an effect whose parameters are not finite, out of bounds or of the wrong shape."""
    for one in fields(effect):
        value = np.asarray(getattr(effect, one.name), dtype=np.float64)
        low, high = effect.bounds[one.name]
        if value.ndim and value.shape != shape:
            raise InputError(
                f"effect {effect.name} with {one.name} of shape {value.shape}",
                f"a number or a table of shape {shape} (temperatures, soc points)",
                "Interpolate it onto the model's grid.",
            )
        if not np.all(np.isfinite(value)) or value.min() < low or value.max() > high:
            raise InputError(
                f"effect {effect.name} with {one.name} from {value.min():g} to {value.max():g}",
                f"finite values in [{low:g}, {high:g}]",
                "Check the fit that gave it.",
            )


def effect_table(value: FloatArray | float, shape: tuple[int, int]) -> FloatArray:
    """A parameter of an effect as a table of the given shape."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), shape)
