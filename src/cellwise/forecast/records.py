"""What goes on from a moment, what is not known of it, and what comes out: records for kernels."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.plausibility.validity_kernels import ValidityScalars
from cellwise.forecast.warming_kernels import Thermal
from cellwise.typing import BoolArray, FloatArray

# Of a model that does not say how far along the SOC its error stays: those of measured cells that
# do say 0.07 to 0.37.
USUAL_MEMORY_SOC = 0.2
# Twice as far as a charge at constant voltage lasts from what a model says, as a factor: nobody
# identifies a model there, and slow diffusion makes it longer (1 to 3 times on four cells).
TAIL_FACTOR = 3.0
# Why a forecast ended.
BY_CHARGE, BY_VOLTAGE, NEVER, BY_CURRENT = 0, 1, 2, 3
STEPS = 400  # from full to empty


class Remaining(NamedTuple):
    """Time, energy out, voltage and SOC at the end of a forecast, and why it ended.

    ``tail_s`` is the part of the time in which a charger holds its voltage; 0 for a load.
    """

    time_s: float
    energy_J: float
    voltage_V: float
    soc: float
    reason: int
    tail_s: float


class Uncertain(NamedTuple):
    """How far a model's voltage may come to lie off what it is off by now.

    ``share`` of the polarisation and the point's own slow error, both another one once the SOC has
    moved on by ``memory_soc``; outside ``valid`` an OCV that nobody measured. The cell's capacity
    is the model's to ``capacity_std``, as a share.
    """

    share: float
    memory_soc: float
    valid: ValidityScalars
    capacity_std: float


class Outcome(NamedTuple):
    """A forecast, and its ends at two deviations: of time, energy and end voltage."""

    usual: Remaining
    time_s: tuple[float, float]
    energy_J: tuple[float, float]
    voltage_V: tuple[float, float]


class FilteredRows(NamedTuple):
    """A log and what a filter said of it, shape (n,) each; a measured voltage may be NaN."""

    interval_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray
    measured_C: FloatArray
    voltage_V: FloatArray
    soc: FloatArray
    soc_std: FloatArray


class Load(NamedTuple):
    """What goes on: the load of every row, whether its power is held, and until when.

    ``power_W`` is what is held where that was given, with a current near it; NaN: what the current
    makes of the model's terminal voltage. ``wanted`` are the rows to forecast at, ``window_s`` over
    what time the model's error is averaged, ``cutoff_V`` the voltage at which the load gives up or
    that a charger holds; ``taper_A`` the current at which a charger ends.
    ``warms_unseen`` whether the losses warm the cell in a forecast where nobody measures its
    temperature.
    """

    current_A: FloatArray
    power_W: FloatArray
    wanted: BoolArray
    hold_power: bool
    window_s: float
    cutoff_V: float
    warms_unseen: bool
    taper_A: float = 0.0


class Going(NamedTuple):
    """What goes on, from one moment.

    Parameters
    ----------
    load_A : float          current now; below zero: a charger's
    hold_power : bool       keep load times voltage, not the current (a rotor, a drive)
    start_V : float         terminal voltage now, measured; NaN: the model's, plus its error
    offset_V : float        measured minus modelled voltage that stays whatever the load does
    of_polarisation : float  and what of it is a share of the polarisation, as a share
    cutoff_V : float        terminal voltage at which the load gives up, or that a charger holds
    temperature_C : float   now
    lump : Thermal          how it will change
    taper_A : float         current at which a charger ends, above zero
    """

    load_A: float
    hold_power: bool
    start_V: float
    offset_V: float
    of_polarisation: float
    cutoff_V: float
    temperature_C: float
    lump: Thermal
    taper_A: float = 0.0


class Away(NamedTuple):
    """By how many deviations a forecast goes away from the usual one in SOC, voltage, warmth."""

    soc: float
    voltage: float
    warmth: float


USUAL = Away(0.0, 0.0, 0.0)
