"""The causes that cellwise knows: meaning, parameters, signature, what they are confused with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from cellwise.diagnose.causes.coordinates import (
    OCV_NAMES,
    UNSEEN_OCV_NAMES,
    UNSEEN_R_NAMES,
    Coordinates,
)

Kind = Literal["measurement", "start", "cell"]
Values = dict[str, float]


@dataclass(frozen=True)
class Parameter:
    """One number of a cause.

    ``coordinate`` is how the fit moves it (:mod:`cellwise.diagnose.causes.coordinates`),
    ``wide`` the prior standard deviation of a fault in that coordinate, in units of
    ``per``: 1, the capacity in Ah ("capacity"), or the interval of the log ("interval").
    """

    name: str
    unit: str
    neutral: float
    bounds: tuple[float, float]
    coordinate: str
    wide: float
    per: Literal["one", "capacity"] = "one"

    @property
    def key(self) -> str:
        """Name of its coordinate in a point: of the first log where every log has its own."""
        return "soc0:0" if self.coordinate == "soc0" else self.coordinate

    def value(self, x: float, coordinates: Coordinates, soc0: float) -> float:
        """What people see at ``x`` in its coordinate; ``soc0``: the first log's stated start."""
        start = self.coordinate == "soc0"
        return soc0 + x if start else coordinates.value_of(self.coordinate, x)


@dataclass(frozen=True)
class Cause:
    """A reason for a simulation to be wrong.

    ``kind`` says what is corrected: the log ("measurement"), where it starts ("start") or the model
    ("cell"). ``shape`` is a coordinate that means nothing while the effect is neutral, with the
    values from which the search starts; ``beginnings`` are other points to start from, where a
    fit that starts at neutral may stop half way. ``forms`` are other shapes that it may have, as
    causes of the same name: of those that a model can have the likeliest counts.
    """

    name: str
    kind: Kind
    meaning: str
    term: str
    signature: str
    parameters: tuple[Parameter, ...]
    confused_with: tuple[str, ...]
    shape: tuple[str, tuple[float, ...]] | None = None
    beginnings: tuple[dict[str, float], ...] = ()
    forms: tuple[Cause, ...] = ()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates that are estimated for it."""
        return tuple(p.coordinate for p in self.parameters)

    def values(self, coordinates: Coordinates, z: Mapping[str, float], soc0: float) -> Values:
        """Its parameters at a point as people see them."""
        return {p.name: p.value(z.get(p.key, 0.0), coordinates, soc0) for p in self.parameters}

    @property
    def log(self) -> int | None:
        """Number of the one log that it is of; None: of all."""
        _, of_log, number = self.parameters[0].coordinate.partition(":")
        return int(number) if of_log else None


# Slower diffusion in an electrode has no memory of its own: what the model has of it in its two
# slow branches grows and takes longer, as r^2 / D does.
_SLOWER_DIFFUSION = Cause(
    "slow_diffusion",
    "cell",
    "Diffusion has become slower: both slow branches have grown, and their time constants.",
    "R2, R3 -> r R2, r R3; tau2, tau3 -> t tau2, t tau3; r3_ohm and tau3_s are those after it",
    "Error that follows the mean current of the last minutes to hours and decays in rests.",
    (
        Parameter("r3_ohm", "ohm", 0.0, (0.0, 100.0), "ln_slow_r", 0.7),
        Parameter("tau3_s", "s", 600.0, (5.0, 1e5), "ln_slow_tau", 0.7),
    ),
    ("hysteresis", "resistance_scale", "current_offset"),
)

CAUSES: dict[str, Cause] = {
    c.name: c
    for c in (
        Cause(
            "current_offset",
            "measurement",
            "The current sensor adds a constant to the true current.",
            "I = (I_log - offset_A) / gain",
            "SOC drifts with time, also at rest; a small constant drop across the resistances.",
            (Parameter("offset_A", "A", 0.0, (-1e4, 1e4), "offset_A", 0.1, "capacity"),),
            ("self_discharge", "capacity", "current_gain"),
        ),
        Cause(
            "current_gain",
            "measurement",
            "The current sensor multiplies the true current by a factor.",
            "I = (I_log - offset_A) / gain",
            "Drops and SOC drift are wrong by the same share.",
            (Parameter("gain", "1", 1.0, (0.5, 2.0), "ln_gain", 0.05),),
            ("capacity", "resistance_scale"),
        ),
        Cause(
            "voltage_offset",
            "measurement",
            "The voltage sensor adds a constant.",
            "v_log = v + offset_V",
            "The same error at any current, SOC and time.",
            (Parameter("offset_V", "V", 0.0, (-1.0, 1.0), "offset_V", 0.03),),
            ("ocv_shift", "initial_soc"),
        ),
        Cause(
            "time_skew",
            "measurement",
            "The voltage is logged later than the current (positive) or earlier.",
            "I(t) -> I(t - skew_s)",
            "Spikes at every edge of the current that change sign with it, nothing between.",
            (Parameter("skew_s", "s", 0.0, (-60.0, 60.0), "skew_s", 3.0),),
            ("resistance_scale",),
            # Edges that are seconds apart do not pull at each other.
            beginnings=tuple(
                {"skew_s": x} for x in (0.0, 0.4, -0.4, 1.2, -1.2, 2.2, -2.2, 3.5, 5.0)
            ),
        ),
        Cause(
            "initial_soc",
            "start",
            "The log does not start at the stated SOC.",
            "soc(0) = soc0",
            "The OCV of another SOC from the first row on: a persistent shift.",
            (Parameter("soc0", "1", 0.0, (0.0, 1.0), "soc0", 0.1),),
            ("voltage_offset", "ocv_shift", "capacity"),
        ),
        Cause(
            "capacity",
            "cell",
            "The cell holds more or less charge than the model.",
            "soc' = -I / (3600 capacity_Ah)",
            "SOC error grows with the charge that has passed, ohmic drops stay right.",
            (Parameter("capacity_Ah", "Ah", 0.0, (0.0, 1e5), "ln_capacity", 0.2),),
            ("current_gain", "current_offset", "ocv_shift"),
        ),
        Cause(
            "resistance_scale",
            "cell",
            "Every resistance is larger or smaller by one factor (age, temperature).",
            "R -> scale R",
            "Error in proportion to the drop, at every SOC.",
            (Parameter("scale", "1", 1.0, (0.1, 10.0), "ln_scale", 0.5),),
            ("current_gain", "temperature_dependence", "rate_dependence", "time_skew"),
        ),
        Cause(
            "ohmic_resistance",
            "cell",
            "The ohmic resistance alone has changed: a contact, a film, the electrolyte.",
            "R0 -> R0 + added_ohm",
            "Steps at every edge of the current in proportion to it, and nothing that relaxes.",
            (Parameter("added_ohm", "ohm", 0.0, (-100.0, 100.0), "added_r0", 0.5),),
            ("resistance_scale", "rate_dependence", "time_skew"),
        ),
        Cause(
            "charge_transfer",
            "cell",
            "The exchange current has changed: the reaction at the surface runs more slowly.",
            "V1 -> asinh(asinh_per_V R1 I) / asinh_per_V, R1 -> R1 / exchange_scale",
            "A drop that follows the current within seconds and grows less than in proportion.",
            (
                Parameter("exchange_scale", "1", 1.0, (0.05, 20.0), "ln_r1", 0.5),
                Parameter("asinh_per_V", "1/V", 0.0, (0.0, 60.0), "asinh_per_V", 5.0),
            ),
            ("resistance_scale", "ohmic_resistance", "rate_dependence"),
        ),
        Cause(
            "lithium_inventory",
            "cell",
            "Lithium that can be cycled was lost.",
            "OCV and capacity of two electrodes with less lithium between them",
            "Less capacity, and an OCV whose steps from the two electrodes have moved apart.",
            (Parameter("lithium_loss", "1", 0.0, (0.0, 0.6), "lithium_loss", 0.1),),
            ("active_material_negative", "active_material_positive", "capacity", "ocv_shift"),
        ),
        Cause(
            "active_material_negative",
            "cell",
            "Material of the negative electrode was lost.",
            "OCV and capacity of two electrodes, the negative one smaller",
            "The steps of the negative electrode in the OCV come nearer to each other.",
            (Parameter("negative_loss", "1", 0.0, (0.0, 0.6), "negative_loss", 0.1),),
            ("lithium_inventory", "active_material_positive", "capacity", "ocv_shift"),
        ),
        Cause(
            "active_material_positive",
            "cell",
            "Material of the positive electrode was lost.",
            "OCV and capacity of two electrodes, the positive one smaller",
            "The OCV falls with the steeper fall of the positive electrode, from full on.",
            (Parameter("positive_loss", "1", 0.0, (0.0, 0.6), "positive_loss", 0.1),),
            ("lithium_inventory", "active_material_negative", "capacity", "ocv_shift"),
        ),
        Cause(
            "entropy",
            "cell",
            "The OCV moves with temperature.",
            "OCV -> OCV + docv_dT (T - 25 degC)",
            "An error that follows the temperature, with current and without.",
            (Parameter("docv_dT_V_per_K", "V/K", 0.0, (-2e-3, 2e-3), "docv_dT", 2e-4),),
            ("voltage_offset", "ocv_shift", "temperature_dependence"),
        ),
        Cause(
            "ocv_shift",
            "cell",
            "The OCV curve has another shape (age, another batch).",
            "OCV(soc) -> OCV(soc) + shift(soc), linear between knots",
            "Error that depends on SOC and not on current or time.",
            tuple(
                Parameter(f"shift_{round(1000 * k / 8):04d}_V", "V", 0.0, (-0.5, 0.5), name, 0.03)
                for k, name in enumerate(OCV_NAMES)
            ),
            ("voltage_offset", "capacity", "initial_soc", "hysteresis"),
        ),
        Cause(
            "slow_diffusion",
            "cell",
            "A slow polarisation that the two branches do not have.",
            "- V3, V3' = (r3_ohm I - V3) / tau3_s",
            "Error that follows the mean current of the last minutes to hours and decays in rests.",
            (
                Parameter("r3_ohm", "ohm", 0.0, (0.0, 100.0), "r3", 1.0),
                Parameter("tau3_s", "s", 600.0, (5.0, 1e5), "ln_tau3", 1.5),
            ),
            ("hysteresis", "resistance_scale", "current_offset"),
            ("ln_tau3", (30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0)),
            forms=(_SLOWER_DIFFUSION,),
        ),
        Cause(
            "hysteresis",
            "cell",
            "The OCV depends on whether the cell was charged or discharged into its SOC.",
            "+ m_V h, h' = -gamma |I| / (3600 Q) (h + sgn I)",
            "Error that turns with the direction of charge and does not decay in rests.",
            (
                Parameter("m_V", "V", 0.0, (0.0, 0.3), "m_V", 0.02),
                Parameter("gamma", "1", 30.0, (0.5, 5000.0), "ln_gamma", 1.5),
            ),
            ("slow_diffusion", "charge_asymmetry", "ocv_shift"),
            ("ln_gamma", (5.0, 20.0, 80.0, 300.0)),
        ),
        Cause(
            "temperature_dependence",
            "cell",
            "Resistances change with temperature more, or less, than the model says.",
            "R -> R exp(activation_K (1/T - 1/T_ref))",
            "Error in proportion to the drop, and following the temperature.",
            (
                Parameter("activation_K", "K", 0.0, (-2000.0, 15000.0), "activation_K", 3000.0),
                Parameter("r0_K", "K", 0.0, (-8000.0, 8000.0), "r0_K", 1000.0),
                Parameter("tau_K", "K", 0.0, (-8000.0, 8000.0), "tau_K", 1000.0),
            ),
            ("resistance_scale", "self_heating"),
        ),
        Cause(
            "rate_dependence",
            "cell",
            "Resistances fall (or rise) with the size of the current.",
            "R -> R / (1 + rate_h |I| / Q), for R0, R1, R2",
            "The drop is too large at large currents and too small at small ones, or the reverse.",
            (Parameter("rate_h", "h", 0.0, (-0.05, 10.0), "rate_h", 0.2),),
            ("resistance_scale", "charge_asymmetry"),
        ),
        Cause(
            "charge_asymmetry",
            "cell",
            "Resistances on charge differ from those on discharge.",
            "R -> charge_scale R where I < 0",
            "Error in proportion to the drop on charge alone.",
            (Parameter("charge_scale", "1", 1.0, (0.1, 10.0), "ln_charge_scale", 0.5),),
            ("hysteresis", "resistance_scale", "rate_dependence"),
        ),
        Cause(
            "self_heating",
            "cell",
            "The cell is warmer inside than the temperature that was logged.",
            "T = T_log + heat, heat' = (rth_K_per_W P - heat) / thermal_s",
            "The drop shrinks after minutes of load and comes back after a rest.",
            (
                Parameter("rth_K_per_W", "K/W", 0.0, (0.0, 200.0), "rth_K_per_W", 10.0),
                Parameter("thermal_s", "s", 600.0, (10.0, 3e4), "ln_thermal_s", 1.0),
            ),
            ("temperature_dependence", "resistance_scale", "rate_dependence"),
            ("ln_thermal_s", (100.0, 300.0, 1000.0, 3000.0)),
        ),
        Cause(
            "self_discharge",
            "cell",
            "Charge is lost inside the cell.",
            "soc' = -(I + leak_A) / (3600 Q)",
            "SOC falls with time, also at rest; no drop goes with it.",
            (Parameter("leak_A", "A", 0.0, (0.0, 1e3), "leak_A", 0.05, "capacity"),),
            ("current_offset", "capacity"),
        ),
    )
}


def _over_soc(
    name: str, unit: str, coordinates: tuple[str, ...], most: float, wide: float
) -> tuple[Parameter, ...]:
    """The same parameter at even knots over SOC, in thousandths in its name."""
    last, called = len(coordinates) - 1, unit.replace("/", "_per_")
    return tuple(
        Parameter(f"{name}_{1000 * k // last:04d}_{called}", unit, 0.0, (-most, most), c, wide)
        for k, c in enumerate(coordinates)
    )


# At a temperature that the model was not measured at its law is an extrapolation, for every
# process by another activation: charge transfer has 27 to 60 kJ/mol (3200 to 7200 K;
# 10.1039/D3RA03630H and what it compares with), electrolytes less, and what each has of a
# resistance differs with the SOC. Entropies of usual electrodes move the OCV by 0.1 to 0.5 mV/K
# (Viswanathan et al. 2010, 10.1016/j.jpowsour.2009.11.103).
UNSEEN_TEMPERATURE = replace(
    CAUSES["temperature_dependence"],
    meaning="Resistances and OCV at a temperature that the model was not measured at.",
    parameters=(
        *CAUSES["temperature_dependence"].parameters,
        *_over_soc("activation", "K", UNSEEN_R_NAMES, 10000.0, 2000.0),
        *_over_soc("docv_dT", "V/K", UNSEEN_OCV_NAMES, 2e-3, 3e-4),
    ),
)

# Found before any fit, in the logs alone (:mod:`cellwise.diagnose.sensor_faults`).
SENSOR_FAULT = Cause(
    "sensor_fault",
    "measurement",
    "A sensor stood still, was at its end, jumped or was lost; those rows were left out.",
    "rows without a value",
    "A channel that does what the other one contradicts.",
    (
        Parameter("rows", "1", 0.0, (0.0, 1e12), "", 0.0),
        Parameter("start_s", "s", 0.0, (0.0, 1e12), "", 0.0),
        Parameter("duration_s", "s", 0.0, (0.0, 1e12), "", 0.0),
    ),
    (),
)


def known_cause(name: str) -> Cause:
    """A cause by its name, whether it is fitted or found in the logs alone."""
    return SENSOR_FAULT if name == SENSOR_FAULT.name else CAUSES[name]


# On cells of simulated physics it took the place of a contact resistance, a slow diffusion and a
# resistance, and was the first cause of none of five cells whose exchange current had changed.
ON_REQUEST = frozenset({"charge_transfer"})


def forms_of(cause: Cause, coordinates: Coordinates, logs: Sequence[int] = ()) -> tuple[Cause, ...]:
    """A cause in every form that it can have in a model; of one of several ``logs`` alone, too."""
    others = [f for f in cause.forms if all(coordinates.possible(n) for n in f.coordinates)]
    if cause.name == "voltage_offset":
        others += [_in_one_log(cause, k) for k in logs]
    return (cause, *others)


def _in_one_log(cause: Cause, log: int) -> Cause:
    """What a sensor does in one log alone: every log may have its own sensor, as its own start."""
    return replace(
        cause,
        meaning=f"{cause.meaning[:-1]} in log {log + 1} alone.",
        parameters=tuple(replace(p, coordinate=f"{p.coordinate}:{log}") for p in cause.parameters),
    )


def kept_coordinates(causes: Iterable[Cause]) -> set[str]:
    """Coordinates that the causes move, and the activation that self-heating needs."""
    kept = set()
    for c in causes:
        kept |= set(c.coordinates)
        if c.name == "self_heating":
            kept.add("activation_K")
    return kept
