"""Memory layout of the fixed-step estimator: the C structs as NumPy record types.

One buffer can be stepped by numba and by C. Fields and their order are those of
``firmware_ref/cellwise_ekf.h``; a test compares offsets and sizes with the compiler's.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from cellwise.cell.effects import (
    ChargeAsymmetry,
    Hysteresis,
    RateDependence,
    SelfDischarge,
    SelfHeating,
    SlowDiffusion,
    TemperatureDependence,
    TimeSkew,
)
from cellwise.cell.model import CellModel

Fields = list[tuple[str, Any]]

INPUT = np.dtype(
    [("current_A", "f4"), ("voltage_V", "f4"), ("temperature_C", "f4"), ("sequence", "u4")]
)
OUTPUT = np.dtype(
    [
        ("soc", "f4"),
        ("soc_variance", "f4"),
        ("voltage_V", "f4"),
        ("innovation_V", "f4"),
        ("innovation_variance_V2", "f4"),
        ("status", "u4"),
    ]
)


@dataclass(frozen=True)
class Options:
    """What is compiled in: effects as 0 or 1, sizes of tables.

    ``arrhenius`` is the number of points of the factor's table over temperature, 0 without it;
    ``wide`` the care taken while SOC is badly known, ``watch`` that of sensors which freeze or fall
    silent; without them the code is smaller.
    """

    points: int
    temperatures: int = 1
    slow: int = 0
    hysteresis: int = 0
    offset: int = 0
    arrhenius: int = 0
    efficiency: int = 0
    leak: int = 0
    skew: int = 0
    rate: int = 0
    asymmetry: int = 0
    heating: int = 0
    wide: int = 1
    watch: int = 1

    @property
    def needs_temperature(self) -> bool:
        """Whether a step reads the temperature."""
        return self.temperatures > 1 or self.arrhenius > 0

    @property
    def states(self) -> int:
        """States of the filter: SOC, two branches, and what is compiled in."""
        return 3 + self.slow + self.hysteresis + self.offset

    def defines(self) -> dict[str, int]:
        """The values as the C preprocessor sees them."""
        return {f"CELLWISE_{f.name.upper()}": int(getattr(self, f.name)) for f in fields(self)}


def options_of(
    model: CellModel,
    *,
    offset: bool = False,
    wide: bool = True,
    watch: bool = True,
    arrhenius_points: int = 0,
) -> Options:
    """What a model needs; an effect at its neutral value needs nothing.

    Parameters
    ----------
    offset : bool             carry the current sensor's offset as a state
    wide : bool               take care of slopes while SOC is badly known
    watch : bool              watch for sensors that freeze or fall silent
    arrhenius_points : int    points of the Arrhenius table where the model has that effect
    """
    arrhenius = arrhenius_points if model.effect(TemperatureDependence).activation_K != 0.0 else 0
    warm = model.temperature_C.size > 1 or arrhenius > 0
    return Options(
        points=model.points,
        temperatures=model.temperature_C.size,
        slow=int(np.any(np.asarray(model.effect(SlowDiffusion).r3_ohm) != 0.0)),
        hysteresis=int(np.any(np.asarray(model.effect(Hysteresis).m_V) != 0.0)),
        offset=int(offset),
        arrhenius=arrhenius,
        efficiency=int(model.charge_efficiency != 1.0),
        leak=int(model.effect(SelfDischarge).leak_A != 0.0),
        skew=int(model.effect(TimeSkew).skew_s != 0.0),
        rate=int(model.effect(RateDependence).rate_h != 0.0),
        asymmetry=int(model.effect(ChargeAsymmetry).charge_scale != 1.0),
        heating=int(warm and model.effect(SelfHeating).rth_K_per_W != 0.0),
        wide=int(wide),
        watch=int(watch),
    )


def row_fields(options: Options) -> Fields:
    """Names of a table row, in order."""
    names = ["ocv_V", "error_V" if options.wide else "noise_V2"]
    names += ["r0_ohm", "r1_ohm", "lag1", "r2_ohm", "lag2"]
    names += ["r3_ohm", "lag3"] if options.slow else []
    names += ["m_V"] if options.hysteresis else []
    return [(name, "f4") for name in names]


def constant_fields(options: Options) -> Fields:
    """Names of the constants, in order."""
    o = options
    found: Fields = [
        (name, "f4")
        for name in (
            "soc_per_A",
            "soc_walk",
            "current_variance_A2",
            "lost_A2",
            "share_variance",
            "gate_square",
            "shared_start",
            "shared",
            "lately",
            "mismatch_cap",
            "gap_variance",
            "current_limit_A",
            "voltage_low_V",
            "voltage_high_V",
            "branch_variance_V2",
            "rest_A",
            "start_rest_A",
            "start_load_A",
        )
    ]
    found += [("recovery_after", "u4"), ("under_load", "u4"), ("gap_steps", "u4")]
    if o.watch:
        found += [("hold_steps", "u4"), ("lost_soc", "f4"), ("frozen_V", "f4")]
    else:
        found += [("lost_walk", "f4")]
    optional = (
        (o.wide, ["flat_slope_V", "fixed_V2", "ocv_soc2", "recovery_A"]),
        (o.efficiency, ["charge_efficiency"]),
        (o.leak, ["leak_soc"]),
        (o.skew, ["skew_share"]),
        (o.rate, ["rate_per_A"]),
        (o.asymmetry, ["charge_scale"]),
        (o.hysteresis, ["hysteresis_per_A"]),
        (o.offset, ["offset_variance_A2", "offset_walk_A2"]),
        (o.heating, ["heat_K_per_W", "heat_gain"]),
        (o.needs_temperature, ["temperature_C"]),
    )
    for present, names in optional:
        found += [(name, "f4") for name in names if present]
    if o.temperatures > 1:
        found += [("grid_C", "f4", (o.temperatures,)), ("per_K", "f4", (o.temperatures - 1,))]  # type: ignore[list-item]
    if o.arrhenius:
        found += [("arrhenius_low_C", "f4"), ("arrhenius_per_K", "f4")]
        found += [("arrhenius", "f4", (o.arrhenius,))]  # type: ignore[list-item]
    return found


def state_fields(options: Options) -> Fields:
    """Names of the state, in order: x, the upper triangle of P row by row, what was seen last."""
    kept = [
        suffix
        for suffix, present in (
            ("s", True),
            ("1", True),
            ("2", True),
            ("3", options.slow),
            ("h", options.hysteresis),
            ("o", options.offset),
        )
        if present
    ]
    names = ["soc", "soc_carry", "v1_V", "v2_V"]
    names += ["v3_V", "v3_carry_V"] if options.slow else []
    names += ["h"] if options.hysteresis else []
    names += ["offset_A"] if options.offset else []
    for i, first in enumerate(kept):
        names += [(first if first == "s" else f"p{first}") + second for second in kept[i:]]
    if options.wide:
        names.insert(names.index("ss") + 1, "ss_carry")
    names += ["current_A", "mismatch"]
    names += ["heat_K"] if options.heating else []
    names += ["temperature_C"] if options.needs_temperature else []
    names += ["voltage_V", "frozen_A"] if options.watch else []
    found: Fields = [(name, "f4") for name in names]
    counts = ["repeats", "no_current", "no_voltage"] if options.watch else []
    found += [(name, "u4") for name in counts]
    return [*found, ("sequence", "u4"), ("rejections", "u4"), ("evidence", "u4")]


def state_type(options: Options) -> np.dtype[Any]:
    """Record type of the state."""
    return np.dtype(state_fields(options), align=True)


def constant_type(options: Options) -> np.dtype[Any]:
    """Record type of the constants."""
    return np.dtype(constant_fields(options), align=True)


def row_type(options: Options) -> np.dtype[Any]:
    """Record type of a table row: float32 only, so that a table is also an array."""
    return np.dtype(row_fields(options), align=True)
