"""What is compiled into a fixed step: effects and care, as a model needs them.

Inside the step upper-case names stand for them (`arithmetic`), known when a loop is compiled
(``rows``) and when C is printed, so that what is not asked for costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from cellwise.cell.description import BRANCHES, CELL
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
    is_neutral,
)
from cellwise.cell.model import CellModel, branch_table
from cellwise.errors import InputError
from cellwise.estimate.filters.bank_kernels import COMPONENTS

if TYPE_CHECKING:
    from cellwise.estimate.power.state_of_power import PowerSettings

MOST_CELLS = 1000
# Residual and derivatives of a sketch: a small one, and one of every cause.
SMALL_SKETCH, WHOLE_SKETCH = 7, 10
ARRHENIUS_POINTS = 161  # of each table over temperature
# An option, and the effect that needs it.
OPTION_OF = {
    "hysteresis": Hysteresis,
    "leak": SelfDischarge,
    "skew": TimeSkew,
    "rate": RateDependence,
    "asymmetry": ChargeAsymmetry,
    "transfer": ChargeTransfer,
    "surface": SurfaceSoc,
}


@dataclass(frozen=True)
class CellSettings:
    """Differences of cells from the mean cell, one standard deviation each.

    ``soc``, ``capacity``, ``resistance`` (relative) at the start, their change ``*_month`` in
    thirty days, ``sensor_V`` that two cells' sensors differ by for good, ``lag_s`` that a cell is
    polled later than the others, ``memory_s`` for how long an error of a cell's voltage lasts.

    What is known of a pack that was never seen: three times what new cells of one batch differ by
    (capacity 1 %, resistance 3 %: Rumpf et al., J. Energy Storage 14 (2017) 224), since a weak cell
    is what is looked for, and SOC as it is without balancing. Cell monitors: 1 to 2 mV, polled
    within tenths of a second.
    """

    soc: float = 0.03
    capacity: float = 0.03
    resistance: float = 0.10
    soc_month: float = 0.002
    capacity_month: float = 0.001
    resistance_month: float = 0.002
    sensor_V: float = 0.0015
    lag_s: float = 0.10
    memory_s: float = 3600.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, (int, float)) and np.isfinite(value) and value > 0.0):
                raise InputError(
                    f"{field.name} = {value!r} for the cells of a pack",
                    "a number above zero",
                    "Leave it out for what is usual.",
                )


@dataclass(frozen=True)
class Options:
    """What is compiled in: effects as 0 or 1, sizes of tables.

    ``arrhenius`` is the number of points of the factor's table over temperature, ``depth`` that of
    the table of how far the particles' surface is below the mean, 0 without them;
    ``wide`` the care taken while SOC is badly known and of sensors which freeze or fall silent;
    without it the code is smaller. ``validity`` 1 watches SOC and current for what the
    model's data covered, 2 the temperature, too; ``power`` gives the state of power,
    ``remaining`` time and energy to empty; ``health`` takes a capacity and a resistance that a
    history gives, ``cells`` follows the cells of a pack beside the mean cell; ``bank`` has
    components for a start that nobody knows, ``offset`` the hypothesis of a current that is off,
    ``soh`` the capacity that rests show,
    ``sketch`` the residual and its derivatives in a sketch, ``sketch_sums`` their pairs.
    """

    points: int
    temperatures: int = 1
    slow: int = 0
    hysteresis: int = 0
    arrhenius: int = 0
    efficiency: int = 0
    leak: int = 0
    skew: int = 0
    rate: int = 0
    asymmetry: int = 0
    transfer: int = 0
    surface: int = 0
    depth: int = 0
    heating: int = 0
    wide: int = 1
    validity: int = 0
    power: int = 0
    remaining: int = 0
    health: int = 0
    cells: int = 0
    bank: int = 0
    offset: int = 0
    soh: int = 0
    sketch: int = 0
    sketch_sums: int = 0

    @property
    def needs_temperature(self) -> bool:
        """Whether a step reads the temperature."""
        found = self.temperatures > 1 or self.arrhenius > 0 or self.depth > 0
        return found or self.validity > 1

    @property
    def states(self) -> int:
        """States of the filter: those that are always there, and what is compiled in."""
        return sum(not s.option or bool(getattr(self, s.option)) for s in CELL)

    def defines(self) -> dict[str, int]:
        """The values as the C preprocessor sees them."""
        return {f"CELLWISE_{f.name.upper()}": int(getattr(self, f.name)) for f in fields(self)}


@dataclass(frozen=True)
class Asked:
    """What a fixed step is made with, beside its model, its noise and its time step.

    Parameters
    ----------
    points : int or None      SOC points of the tables; None: as few as the model's stated error
                              allows, see :func:`~cellwise.estimate.fixed.tables.soc_grid`
    wide : bool               take care of slopes while SOC is badly known, watch for sensors that
                              freeze or fall silent; without it the code is smaller, and slower to
                              recover from a start that is far off
    power : PowerSettings or None   what the state of power is asked for: one horizon, currents held
    remaining_V : float or None     cutoff down to which time and energy are asked for
    health : bool                   take capacity and resistance from a history
    cells : CellSettings or None    follow the cells of a pack beside the mean cell
    components : int          filters side by side while the SOC is not known; 1: one alone
    offset : bool             ask rests and voltages whether the current is off all the time, as the
                              float64 filters do
    soh : bool                estimate the capacity that is left between two rests far apart
    sketch : int              bytes that sums of the residual for a diagnosis may take; 0: none
    """

    points: int | None = None
    wide: bool = True
    power: PowerSettings | None = None
    remaining_V: float | None = None
    health: bool = False
    cells: CellSettings | None = None
    components: int = COMPONENTS
    offset: bool = False
    soh: bool = False
    sketch: int = 0


def options_of(model: CellModel, asked: Asked) -> Options:
    """What a model and a wish need; an effect at its neutral value needs nothing.

    Raises
    ------
    InputError        the hypothesis of an offset in a lean step
    """
    if asked.offset and not asked.wide:
        raise InputError(
            "an offset of the current in a lean step, which states no chance of it",
            "one of the two",
            "Leave `lean` or `offset` out.",
        )
    needed = {option: int(not is_neutral(model.effect(e))) for option, e in OPTION_OF.items()}
    kept = WHOLE_SKETCH if asked.sketch else 0
    arrhenius = ARRHENIUS_POINTS if model.effect(TemperatureDependence).activation_K != 0.0 else 0
    activated = needed["surface"] and model.effect(SurfaceSoc).activation_K != 0.0
    depth = ARRHENIUS_POINTS if activated else 0
    warm = model.temperature_C.size > 1 or arrhenius > 0 or depth > 0
    return Options(
        points=model.points,
        temperatures=model.temperature_C.size,
        **{s.option: int(np.any(branch_table(model, "r", s))) for s in BRANCHES if s.option},
        **needed,
        arrhenius=arrhenius,
        efficiency=int(model.charge_efficiency != 1.0),
        depth=depth,
        heating=int(warm and not is_neutral(model.effect(SelfHeating))),
        wide=int(asked.wide),
        validity=_watched(model),
        power=int(asked.power is not None),
        remaining=int(asked.remaining_V is not None),
        health=int(asked.health),
        cells=int(asked.cells is not None),
        bank=int(asked.wide and asked.components > 1),
        offset=int(asked.offset),
        soh=int(asked.soh),
        sketch=kept,
        sketch_sums=kept * (kept + 1) // 2,
    )


def _watched(model: CellModel) -> int:
    """What of a model's validity a step looks at."""
    valid = model.validity
    return 2 if valid.temperature_C is not None else int(valid.known)


def flags_of(options: Options) -> dict[str, int]:
    """The values of the upper-case names for one set of options."""
    flags = {f.name.upper(): int(getattr(options, f.name)) for f in fields(options)}
    del flags["POINTS"]
    return {
        **flags,
        "AT_ONCE": 0,
        "TEMPERATURES": int(options.temperatures > 1),
        "ARRHENIUS": int(options.arrhenius > 0),
        "DEPTH": int(options.depth > 0),
        "SKETCH": int(options.sketch > 0),
        "SKETCH_LARGE": int(options.sketch == WHOLE_SKETCH),
        "WARM": int(options.needs_temperature),
        "VALIDITY": int(options.validity > 0),
        "THERMAL": int(options.validity > 1),
        "SCALED": int(
            options.arrhenius > 0
            or bool(options.rate or options.asymmetry or options.health or options.cells)
        ),
    }
