"""What may be wrong, how it is done, and which answers are right: written down before any run.

``exact`` is the name that says what was done; ``acceptable`` are the names that describe it
without saying something false; ``there`` are all that may stand beside it. ``inseparable`` are
groups of causes that such logs cannot tell apart in principle: only there ``undetermined`` is an
answer, and only where the exact one is among those that compete.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class Condition:
    """Of a cell, healthy by default; what is not in a unit is a share of the healthy cell's."""

    lithium: float = 1.0
    negative: float = 1.0
    positive: float = 1.0
    contact_ohm: float = 0.0
    diffusion_negative: float = 1.0
    diffusion_positive: float = 1.0
    conductivity: float = 1.0
    exchange_negative: float = 1.0
    exchange_positive: float = 1.0
    cooling: float = 1.0
    ambient_C: float = 25.0
    hysteresis_V: float = 0.0
    leak_A: float = 0.0


@dataclass(frozen=True)
class Instrument:
    """Of the logger: errors and faults. Durations are shares of the log.

    ``soc0_shift`` is what the told SOC is above the true one; ``chamber`` whether the logged
    temperature is the chamber's and not the cell's.
    """

    offset_A: float = 0.0
    gain: float = 1.0
    offset_V: float = 0.0
    skew_s: float = 0.0
    soc0_shift: float = 0.0
    chamber: bool = False
    stuck_V: float = 0.0
    stuck_A: float = 0.0
    saturated: float = 0.0
    spikes: float = 0.0
    lost: float = 0.0


@dataclass(frozen=True)
class World:
    """A cell and its logger."""

    cell: Condition = field(default_factory=Condition)
    instrument: Instrument = field(default_factory=Instrument)

    def of_cell(self, **values: float) -> World:
        """The same with another condition of the cell."""
        return replace(self, cell=replace(self.cell, **values))

    def of_instrument(self, **values: float) -> World:
        """The same with another instrument."""
        return replace(self, instrument=replace(self.instrument, **values))


Put = Callable[[World, float, float], World]


@dataclass(frozen=True)
class Change:
    """One thing that may be changed.

    ``put(world, x, capacity_Ah)`` does it; the error grows about in proportion to x, which is at
    most ``most``. ``signed``: either direction is physical. ``needs``: of the cell.
    """

    name: str
    put: Put
    most: float
    exact: str
    acceptable: frozenset[str]
    there: frozenset[str]
    signed: bool = False
    needs: str = ""
    sized: bool = True


def _names(words: str) -> frozenset[str]:
    return frozenset(words.split())


def _change(
    name: str,
    put: Put,
    most: float,
    exact: str,
    acceptable: str = "",
    there: str = "",
    **more: bool | str,
) -> Change:
    right = _names(acceptable) | {exact}
    return Change(name, put, most, exact, right, right | _names(there), **more)  # type: ignore[arg-type]


_AGED = "capacity ocv_shift"
CHANGES: dict[str, Change] = {
    c.name: c
    for c in (
        # A smaller inventory is both a smaller capacity and another OCV; so is lost material.
        _change(
            "lithium_loss",
            lambda w, x, q: w.of_cell(lithium=1.0 - 0.01 * x),
            25.0,
            "lithium_inventory",
            _AGED,
        ),
        # Less material also means more current per surface: slower kinetics and diffusion.
        _change(
            "negative_loss",
            lambda w, x, q: w.of_cell(negative=1.0 - 0.01 * x),
            35.0,
            "active_material_negative",
            _AGED,
            "charge_transfer resistance_scale slow_diffusion",
        ),
        _change(
            "positive_loss",
            lambda w, x, q: w.of_cell(positive=1.0 - 0.01 * x),
            35.0,
            "active_material_positive",
            _AGED,
            "charge_transfer resistance_scale slow_diffusion",
        ),
        _change(
            "contact_resistance",
            lambda w, x, q: w.of_cell(contact_ohm=1e-3 * x / q),
            200.0,
            "ohmic_resistance",
            "resistance_scale",
        ),
        # A film on the negative electrode: a resistance, and the lithium that is in it.
        _change(
            "film_growth",
            lambda w, x, q: w.of_cell(contact_ohm=1e-3 * x / q, lithium=1.0 - 5e-4 * x),
            120.0,
            "ohmic_resistance",
            "resistance_scale",
            "lithium_inventory capacity ocv_shift",
        ),
        _change(
            "slow_negative",
            lambda w, x, q: w.of_cell(diffusion_negative=1.0 / (1.0 + 0.05 * x)),
            80.0,
            "slow_diffusion",
            "",
            "resistance_scale",
        ),
        _change(
            "slow_positive",
            lambda w, x, q: w.of_cell(diffusion_positive=1.0 / (1.0 + 0.05 * x)),
            80.0,
            "slow_diffusion",
            "",
            "resistance_scale",
        ),
        _change(
            "electrolyte",
            lambda w, x, q: w.of_cell(conductivity=1.0 / (1.0 + 0.05 * x)),
            200.0,
            "ohmic_resistance",
            "resistance_scale",
        ),
        # Without a double layer the charge transfer is as fast as the ohmic drop.
        _change(
            "exchange_negative",
            lambda w, x, q: w.of_cell(exchange_negative=1.0 / (1.0 + 0.1 * x)),
            200.0,
            "charge_transfer",
            "resistance_scale ohmic_resistance",
            "rate_dependence",
        ),
        _change(
            "exchange_positive",
            lambda w, x, q: w.of_cell(exchange_positive=1.0 / (1.0 + 0.1 * x)),
            200.0,
            "charge_transfer",
            "resistance_scale ohmic_resistance",
            "rate_dependence",
        ),
        _change(
            "cold",
            lambda w, x, q: w.of_cell(ambient_C=25.0 - x),
            30.0,
            "temperature_dependence",
            "",
            "entropy",
            needs="arrhenius",
        ),
        _change(
            "bad_cooling",
            lambda w, x, q: replace(
                w.of_cell(cooling=1.0 / (1.0 + 0.2 * x)),
                instrument=replace(w.instrument, chamber=True),
            ),
            60.0,
            "self_heating",
            "",
            "temperature_dependence entropy",
            needs="thermal",
        ),
        _change(
            "ocp_hysteresis",
            lambda w, x, q: w.of_cell(hysteresis_V=1e-3 * x),
            60.0,
            "hysteresis",
        ),
        _change(
            "shunt",
            lambda w, x, q: w.of_cell(leak_A=1e-3 * x * q),
            200.0,
            "self_discharge",
        ),
        _change(
            "current_offset",
            lambda w, x, q: w.of_instrument(offset_A=1e-3 * x * q),
            200.0,
            "current_offset",
            signed=True,
        ),
        _change(
            "current_gain",
            lambda w, x, q: w.of_instrument(gain=1.0 + 0.01 * x),
            20.0,
            "current_gain",
            signed=True,
        ),
        _change(
            "voltage_offset",
            lambda w, x, q: w.of_instrument(offset_V=1e-3 * x),
            50.0,
            "voltage_offset",
            signed=True,
        ),
        _change(
            "time_skew",
            lambda w, x, q: w.of_instrument(skew_s=0.1 * x),
            60.0,
            "time_skew",
        ),
        _change(
            "initial_soc",
            lambda w, x, q: w.of_instrument(soc0_shift=0.01 * x),
            25.0,
            "initial_soc",
            needs="told",
        ),
        *(
            _change(
                name,
                lambda w, x, q, name=name: w.of_instrument(**{name: x}),
                most,
                "sensor_fault",
                sized=False,
            )
            for name, most in (
                ("stuck_V", 0.08),
                ("stuck_A", 0.08),
                ("saturated", 0.6),
                ("spikes", 0.01),
                ("lost", 0.1),
            )
        ),
    )
}
FAULTS = tuple(c.name for c in CHANGES.values() if not c.sized)

# Groups that cannot be told apart in principle by a drive's current and voltage.
INSEPARABLE: tuple[frozenset[str], ...] = (
    # Which electrode lost what shows only where the window is seen from end to end.
    _names(
        "lithium_inventory active_material_negative active_material_positive capacity ocv_shift"
    ),
    # A gain on the current is a capacity and all resistances by one factor.
    _names("current_gain capacity"),
    _names("current_gain resistance_scale"),
    # A change of all resistances by a temperature that hardly moves.
    _names("temperature_dependence resistance_scale self_heating"),
    _names("charge_transfer rate_dependence resistance_scale ohmic_resistance"),
    # On a straight OCV a start, an offset of the voltage and of the charge look alike.
    _names("initial_soc voltage_offset"),
    _names("current_offset self_discharge"),
)

# A pair is drawn from two of these.
FAMILIES = (
    ("lithium_loss", "negative_loss", "positive_loss", "shunt", "current_offset", "current_gain"),
    ("contact_resistance", "slow_negative", "slow_positive", "exchange_positive", "cold"),
    ("voltage_offset", "ocp_hysteresis"),
    ("time_skew",),
)
