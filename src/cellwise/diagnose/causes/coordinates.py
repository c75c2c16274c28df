"""The coordinates in which a model and a log may be off, and how the kernels see each of them.

Every coordinate is zero where the model and the log are as stated. Positive quantities move on a
logarithm, so that a step of 0.1 is ten per cent of whatever the value is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import RateDependence
from cellwise.cell.equations import ZERO_CELSIUS_K, CellTables
from cellwise.cell.model import USUAL_C, CellModel
from cellwise.cell.point_kernels import (
    ENTROPY,
    OCV,
    R0,
    R1,
    R2,
    R3,
    TAU1,
    TAU2,
    TAU3,
    CellScalars,
    M,
)
from cellwise.diagnose.causes.electrodes import Electrodes, electrodes_of
from cellwise.typing import FloatArray

OCV_KNOTS = 9  # places over SOC at which the OCV may be off by different amounts
R_KNOTS = 5  # places at which resistances may


# Where the shape of an effect starts when the model has none of it.
START_TAU3_S = 600.0
START_GAMMA = 30.0  # [1]
START_HEATING_S = 600.0

CAPACITY_RANGE = (0.3, 2.0)  # of the model's: another cell of its kind
# Factor by which diffusion becomes slower, never faster: else it would take back from the slow
# branches what one factor on all resistances has given them too much.
MOST_SLOWED = 20.0

# Steps of numerical derivatives, far above rounding.
STEP_V_PER_K = 1e-7
STEP_K = 1.0
STEP = 1e-5  # in the coordinate's unit


OCV_NAMES = tuple(f"ocv_{k}" for k in range(OCV_KNOTS))
R_NAMES = tuple(f"ln_r_{k}" for k in range(R_KNOTS))
LOSS_NAMES = ("lithium_loss", "negative_loss", "positive_loss")
# At a temperature that the model was not measured at, beside what its own law says: activation of
# all resistances and slope of the OCV, at knots over SOC.
UNSEEN_R_NAMES = tuple(f"unseen_r_{k}_K" for k in range(R_KNOTS))
UNSEEN_OCV_NAMES = tuple(f"unseen_ocv_{k}_V_per_K" for k in range(R_KNOTS))
UNSEEN_NAMES = (*UNSEEN_R_NAMES, *UNSEEN_OCV_NAMES)
BRANCH_NAMES = ("r0_K", "tau_K")
# Where each enters: the current, the table or the scalars of the cell.
CURRENT_NAMES = ("offset_A", "ln_gain", "skew_s")
MEASURED_NAMES = (*CURRENT_NAMES, "offset_V")


class KernelInputs(NamedTuple):
    """A point in these coordinates as the kernels take it."""

    table: FloatArray
    grid: FloatArray
    scalars: CellScalars
    added_V: float
    offset_A: float
    gain: float
    skew_s: float

    @property
    def tables(self) -> CellTables:
        """The cell as the equations see it."""
        return CellTables(self.table, self.grid, self.scalars)


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates about one model.

    ``r3`` is the resistance of the slow branch over the median R0 where the model has no such
    branch, and the logarithm of a factor where it has one; ``ln_slow_r`` and ``ln_slow_tau`` are
    factors of both slow branches of such a model; ``ln_tau3``, ``ln_gamma`` and
    ``ln_thermal_s`` are about the model's values or those of :class:`Shapes`.

    ``unseen_C`` is a temperature that the model was not measured at: its tables are held there a
    second time, so that they can change there alone.
    """

    model: CellModel
    shapes: Mapping[str, float] = field(default_factory=dict)
    unseen_C: float | None = None

    def __post_init__(self) -> None:
        table, grid, scalars = self.model.parameters()
        row = -1
        if self.unseen_C is not None:
            row = 0 if self.unseen_C < grid[0] else grid.size
            table = np.insert(table, row, table[min(row, grid.size - 1)], axis=0)
            grid = np.insert(grid, row, self.unseen_C)
        vars(self).update(
            table=table,
            grid_C=grid,
            row=row,
            _scalars=scalars,
            has_slow=bool(np.any(table[..., R3])),
            has_hysteresis=bool(np.any(table[..., M])),
            r_typical_ohm=float(np.median(table[..., R0])),
            hats=_hats(table.shape[1], OCV_KNOTS),
            r_hats=_hats(table.shape[1], R_KNOTS),
        )

    table: FloatArray = field(init=False)
    grid_C: FloatArray = field(init=False)
    row: int = field(init=False)
    _scalars: CellScalars = field(init=False)
    has_slow: bool = field(init=False)
    has_hysteresis: bool = field(init=False)
    r_typical_ohm: float = field(init=False)
    hats: FloatArray = field(init=False)
    r_hats: FloatArray = field(init=False)

    @property
    def unseen_from_C(self) -> float:
        """The temperature of the model that is nearest to the unseen one."""
        return float(self.grid_C[1 if self.row == 0 else self.row - 1])

    @property
    def unseen_per_K(self) -> float:
        """1/T at the unseen temperature over that of the nearest one of the model [1/K]."""
        unseen_K = self.grid_C[self.row] + ZERO_CELSIUS_K
        return float(1.0 / unseen_K - 1.0 / (self.unseen_from_C + ZERO_CELSIUS_K))

    @property
    def tau3_s(self) -> float:
        """Time constant of the slow branch where ``ln_tau3`` is zero [s]."""
        own_s = float(np.median(self.table[..., TAU3]))
        return own_s if self.has_slow else self.shapes.get("ln_tau3", START_TAU3_S)

    @property
    def gamma(self) -> float:
        """Hysteresis rate where ``ln_gamma`` is zero."""
        own = self._scalars.hysteresis_rate
        return own if self.has_hysteresis else self.shapes.get("ln_gamma", START_GAMMA)

    @property
    def thermal_s(self) -> float:
        """Thermal time constant where ``ln_thermal_s`` is zero [s]."""
        own_s, heats = self._scalars.heating_s, self._scalars.heating_K_per_W != 0.0
        return own_s if heats else self.shapes.get("ln_thermal_s", START_HEATING_S)

    @cached_property
    def electrodes(self) -> Electrodes | None:
        """The half cells that the OCV is made of; None where no published ones come near it."""
        return electrodes_of(self.model.soc, self.model.at_temperature(USUAL_C).ocv_V[0])

    def possible(self, name: str) -> bool:
        """Whether a coordinate means something for this model and these logs."""
        if name in UNSEEN_NAMES:
            return self.unseen_C is not None
        if name in _SLOWED:  # where nobody has measured, slower diffusion is what the cold does
            return self.has_slow and self.unseen_C is None
        return name not in LOSS_NAMES or self.electrodes is not None

    @cached_property
    def _own(self) -> dict[str, float]:
        """What people see where a coordinate is zero, of those where that is neither 0 nor 1."""
        s, capacity_Ah = self._scalars, self.model.capacity_Ah
        slow_ohm = float(np.median(self.table[..., R3]))
        return {
            "ln_capacity": capacity_Ah,
            "ln_charge_scale": s.charge_scale,
            "r3": slow_ohm,
            "ln_slow_r": slow_ohm,
            "ln_tau3": self.tau3_s,
            "ln_slow_tau": self.tau3_s,
            "ln_gamma": self.gamma,
            "ln_thermal_s": self.thermal_s,
            "asinh_per_V": s.asinh_per_V,
            "activation_K": s.activation_K,
            "rate_h": s.rate_per_A * capacity_Ah,
            "leak_A": s.leak_A,
            "rth_K_per_W": s.heating_K_per_W,
        }

    def _is_factor(self, name: str) -> bool:
        """Whether a coordinate is the logarithm of a factor."""
        return name.startswith("ln_") or (name == "r3" and self.has_slow)

    def value_of(self, name: str, x: float) -> float:
        """What people see where a coordinate is ``x``: resistances in ohm."""
        if name == "ln_r1":  # the exchange current, one over the resistance at small currents
            return math.exp(-x)
        if self._is_factor(name):
            return self._own.get(name, 1.0) * math.exp(x)
        return self._own.get(name, 0.0) + x * self._unit(name)

    def bounds_of(self, name: str, bounds: tuple[float, float]) -> tuple[float, float]:
        """Bounds of what people see as bounds of the coordinate.

        What the model has of an effect may go, but not turn round.
        """
        low, high = bounds
        if name == "ln_capacity":
            return math.log(CAPACITY_RANGE[0]), math.log(CAPACITY_RANGE[1])
        if name in _SLOWED:
            return 0.0, math.log(MOST_SLOWED)
        if name == "ln_r1":
            return -math.log(high), -math.log(low)
        if name == "ln_tau3":
            low = max(low, self.shortest_tau3_s)
        if self._is_factor(name):
            own = self._own.get(name, 1.0)
            return (math.log(low / own) if low > 0.0 else -math.inf), math.log(high / own)
        own = float(np.min(self.table[..., M])) if name == "m_V" else self._own.get(name, 0.0)
        return (low - own) / self._unit(name), high / self._unit(name)

    def _unit(self, name: str) -> float:
        """What people see of a coordinate of one."""
        return self.r_typical_ohm if name in ("added_r0", "r3") else 1.0

    @property
    def shortest_tau3_s(self) -> float:
        """Slow is what the second branch does not reach [s]."""
        return 2.0 * float(np.median(self.model.tau2_s))

    def _aged(self, z: Mapping[str, float]) -> tuple[FloatArray, float]:
        """Change of the OCV [V] and factor on the capacity by what the electrodes have lost."""
        losses = [z.get(n, 0.0) for n in LOSS_NAMES]
        if self.electrodes is None or not any(losses):
            return np.zeros(self.model.soc.size), 1.0
        return self.electrodes.aged(self.model.soc, *losses)

    def added_V(self, name: str, soc: FloatArray) -> FloatArray:
        """What a unit of a coordinate of the OCV, or of a voltage offset, adds at a SOC [V]."""
        if name not in OCV_NAMES:
            return np.ones(soc.size)
        return np.asarray(np.interp(soc, self.model.soc, self.hats[OCV_NAMES.index(name)]))

    def capacity_Ah(self, z: Mapping[str, float]) -> float:
        """What the cell holds at a point, after what its electrodes have lost [Ah]."""
        own = self.model.capacity_Ah * math.exp(z.get("ln_capacity", 0.0))
        return own * self._aged(z)[1]

    @cached_property
    def factors(self) -> dict[str, tuple[int, ...]]:
        """Coordinates that are logarithms of factors on columns of the table."""
        slow = (R3,) if self.has_slow else ()
        every = (R0, R1, R2, *slow)
        return {"ln_scale": every, **dict.fromkeys(R_NAMES, every), **_SINGLE, **_SLOWED} | (
            {"r3": slow} if slow else {}
        )

    def inputs(self, z: Mapping[str, float]) -> KernelInputs:
        """The kernels' inputs at a point; coordinates that are not named are zero."""

        def at(name: str) -> float:
            return z.get(name, 0.0)

        base = self._scalars
        t = self.table.copy()
        aged_V, share = self._aged(z)
        t[..., OCV] += np.array([at(n) for n in OCV_NAMES]) @ self.hats + aged_V
        t[..., R0] += at("added_r0") * self.r_typical_ohm
        if not self.has_slow:
            t[..., R3] = at("r3") * self.r_typical_ohm
            t[..., TAU3] = self.tau3_s
        for name, columns in self.factors.items():
            if name in z:
                over_soc = self.r_hats[R_NAMES.index(name)] if name in R_NAMES else 1.0
                t[..., list(columns)] *= np.exp(z[name] * over_soc)[..., None]
        t[..., M] += at("m_V")
        t[..., ENTROPY] += at("docv_dT")
        if self.unseen_C is not None:
            more_K = np.array([at(n) for n in UNSEEN_R_NAMES]) @ self.r_hats
            t[self.row, :, list(RESISTANCES)] *= np.exp(more_K * self.unseen_per_K)
            slope = np.array([at(n) for n in UNSEEN_OCV_NAMES]) @ self.r_hats
            t[self.row, :, OCV] += slope * (self.unseen_C - self.unseen_from_C)
        branches = any(n in z for n in BRANCH_NAMES)
        charge_As = base.charge_As * math.exp(at("ln_capacity")) * share
        rate_per_A = base.rate_per_A + at("rate_h") / self.model.capacity_Ah
        # However wide a tolerance: below this a load of twenty times 1C would have no resistance
        # that is finite.
        least_rate_per_A = 3600.0 * RateDependence.bounds["rate_h"][0] / charge_As
        scalars = base._replace(
            charge_As=charge_As,
            branch_activation=1.0 if branches else base.branch_activation,
            r0_activation_K=base.r0_activation_K + at("r0_K"),
            tau1_activation_K=base.tau1_activation_K + at("tau_K"),
            tau2_activation_K=base.tau2_activation_K + at("tau_K"),
            tau3_activation_K=base.tau3_activation_K + at("tau_K"),
            entropy_K=base.entropy_K or ZERO_CELSIUS_K + USUAL_C,
            hysteresis_rate=self.gamma * math.exp(at("ln_gamma")),
            activation_K=base.activation_K + at("activation_K"),
            rate_per_A=max(rate_per_A, least_rate_per_A),
            charge_scale=base.charge_scale * math.exp(at("ln_charge_scale")),
            asinh_per_V=base.asinh_per_V + at("asinh_per_V"),
            leak_A=base.leak_A + at("leak_A"),
            heating_K_per_W=base.heating_K_per_W + at("rth_K_per_W"),
            heating_s=self.thermal_s * math.exp(at("ln_thermal_s")),
            skew_s=0.0,  # the current is shifted before it reaches the kernel
        )
        return KernelInputs(
            t,
            self.grid_C,
            scalars,
            at("offset_V"),
            at("offset_A"),
            math.exp(at("ln_gain")),
            base.skew_s + at("skew_s"),
        )


def step_of(name: str) -> float:
    """Step of a numerical derivative by a coordinate: a small share of what it may move by."""
    if name == "docv_dT" or name.endswith("V_per_K"):
        return STEP_V_PER_K
    return STEP_K if name.endswith("_K") else STEP


def _hats(points: int, knots: int) -> FloatArray:
    """Hat functions over SOC, shape (knots, points): they add up to one."""
    soc = np.linspace(0.0, 1.0, points)
    places = np.linspace(0.0, 1.0, knots)
    return np.array([np.interp(soc, places, row) for row in np.eye(knots)])


RESISTANCES = (R0, R1, R2, R3)
_SINGLE = {
    "ln_r0": (R0,),
    "ln_r1": (R1,),
    "ln_r2": (R2,),
    "ln_tau1": (TAU1,),
    "ln_tau2": (TAU2,),
    "ln_tau3": (TAU3,),
}
_SLOWED = {"ln_slow_r": (R2, R3), "ln_slow_tau": (TAU2, TAU3)}
