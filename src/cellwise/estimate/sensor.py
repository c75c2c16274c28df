"""What the sensors of a target are off by, and what a filter makes of it.

A sensor's errors last: no further sample averages them out, and a filter cannot distinguish them
from the model's. They are considered (Schmidt 1966), not estimated: each widens the error of the
model or of the count that moves the SOC alike (`docs/theory.md`, directions that are considered).
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.records import check_ranges, need, record, within

HOW = (
    "Each number is one standard deviation in the unit that its name ends in, without a sign: "
    "30 mV are voltage_offset_V = 0.03, 1 % is current_gain = 0.01."
)
OF_SIZE = ("current_offset", "current_noise")  # stated in ampere, or of 1C


@dataclass(frozen=True)
class Sensor:
    """Standard deviations of what sensors are off by, the same for as long as they are in use.

    The defaults are a car's, whatever the cell's size.

    Parameters
    ----------
    current_offset_A, current_offset_C : float    what is added to every current: in ampere, else
                                                  as a share of 1C
    current_gain : float                          by what share every current is too large
    current_noise_A, current_noise_C : float      of every sample
    current_resolution_A, voltage_resolution_V : float    of the last digit
    current_range_A : float                       the sensor reads no more than that
    voltage_offset_V, voltage_noise_V : float
    temperature_K : float                         what is added to every temperature

    Raises
    ------
    InputError        a value that is negative, not finite or of another unit
    """

    current_offset_A: float | None = within(0.0, 1e4, None)
    current_offset_C: float = within(0.0, 1.0, 0.002)  # a vehicle's, after its calibration
    current_gain: float = within(0.0, 0.5, 0.005)
    current_noise_A: float | None = within(0.0, 1e4, None)
    current_noise_C: float = within(0.0, 1.0, 0.002)
    current_resolution_A: float = within(0.0, 1e4, 0.0)
    current_range_A: float | None = within(1e-6, 1e6, None)
    voltage_offset_V: float = within(0.0, 1.0, 0.003)
    voltage_noise_V: float = within(0.0, 1.0, 0.001)
    voltage_resolution_V: float = within(0.0, 1.0, 0.0)
    temperature_K: float = within(0.0, 50.0, 1.0)

    def __post_init__(self) -> None:
        check_ranges(self, "a sensor", HOW)

    def offset_A(self, capacity_Ah: float) -> float:
        """What it adds to the current of a cell of this size [A]."""
        stated = self.current_offset_A
        return self.current_offset_C * capacity_Ah if stated is None else stated

    def noise_A(self, capacity_Ah: float) -> float:
        """Of every sample of the current of a cell of this size [A]."""
        stated = self.current_noise_A
        return self.current_noise_C * capacity_Ah if stated is None else stated

    def of_cell(self, capacity_Ah: float) -> Sensor:
        """The same stated in ampere, for a cell of this size."""
        return replace(
            self,
            current_offset_A=self.offset_A(capacity_Ah),
            current_noise_A=self.noise_A(capacity_Ah),
        )

    def to_dict(self, capacity_Ah: float) -> dict[str, float | None]:
        """As JSON values, for a cell of this size: keys as in the file, in ampere."""
        found = asdict(self.of_cell(capacity_Ah))
        return {key: value for key, value in found.items() if not key.endswith("_C")}


CAR = Sensor()
# By the word that a file calls them by. A data sheet's "typical" is one deviation, its limit three.
CLASSES = {
    "car": CAR,
    # TI INA226 (SBOS547B) on 2 mohm: offset 2.5 uV and gain 0.02 % typical, digits of 2.5 uV and
    # 1.25 mV, range 81.92 mV, voltage off by 1.25 mV typical.
    "shunt": Sensor(
        current_offset_A=0.00125,
        current_gain=0.0002,
        current_resolution_A=0.00125,
        current_range_A=40.96,
        voltage_offset_V=0.00125,
        voltage_resolution_V=0.00125,
    ),
    # Allegro ACS712 x20A, 100 mV/A: offset 40 mV limit, total error 1.5 % typical, noise 11 mV peak
    # to peak (six deviations).
    "hall": Sensor(
        current_offset_A=0.133, current_gain=0.015, current_noise_A=0.018, current_range_A=20.0
    ),
}


def read_sensor(path: str | Path) -> Sensor:
    """A sensor from a TOML file: keys of :class:`Sensor`, and ``class`` for those not stated.

    Raises
    ------
    InputError        no such file, no TOML, no such class, a key that is none, one thing stated
                      twice, a value that is refused
    """
    try:
        found = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"'{path}', which is no sensor's specification ({error})",
            "a TOML file with lines such as voltage_offset_V = 0.005",
            f"Write it with any of {', '.join(one.name for one in fields(Sensor))}.",
        ) from error
    return sensor_of(found, f"'{path}'")


def sensor_of(table: dict[str, Any], where: str) -> Sensor:
    """A sensor from a table as a file holds it; raises as `read_sensor`."""
    stated = {key: value for key, value in table.items() if key != "class"}
    kind = table.get("class", "car")
    known = isinstance(kind, str) and kind in CLASSES
    need(known, f"class = {kind!r} in {where}", f"one of {', '.join(CLASSES)}", "Or leave it out.")
    own = record(Sensor, stated, where)
    values = {key: getattr(own, key) for key in stated}
    for name in OF_SIZE:
        ampere, share = f"{name}_A", f"{name}_C"
        twice = ampere in stated and share in stated
        need(not twice, f"{ampere} and {share} in {where}", "one of the two", "Leave one out.")
        if share in stated:
            values[ampere] = None
    return replace(CLASSES[kind], **values)


def assumed(sensor: Sensor | None, capacity_Ah: float) -> dict[str, Any]:
    """As JSON values what is assumed of the sensors, and whether nobody stated it."""
    return {"by_default": sensor is None, **(sensor or CAR).to_dict(capacity_Ah)}


def assumed_text(sensor: dict[str, Any]) -> str:
    """The same for people: what is not zero, in one line."""
    found = {key: value for key, value in sensor.items() if key != "by_default" and value}
    text = ", ".join(f"{key} {value:.3g}" for key, value in found.items())
    whose = "a car's, as nobody stated them (--sensor)" if sensor["by_default"] else "as stated"
    return f"sensors: {whose}: {text}"


class Seen(NamedTuple):
    """A model and the noise of a filter on it, both with what the sensors add."""

    model: CellModel
    noise: Noise


def seen_by(model: CellModel, sensor: Sensor | None = None) -> Seen:
    """A model as it is seen through its sensors; None: a car's, which `Noise` assumes.

    What is within a car's sensor is in the defaults of :class:`Noise` and in the model's own error,
    which was found with sensors too: only what goes beyond is added, in squares.

    - voltage, its offset: an error of the model that comes back at the same SOC for good;
    - temperature: resistances that are off for good, by what they change over it;
    - gain: a capacity that is off by as much;
    - offset: a count that drifts by as much in an hour, and the offset that a filter looks for;
    - the last digit: noise, and an offset too, since what stands still is rounded one way.
    """
    if sensor is None:
        return Seen(model, Noise.of_model(model))
    size_Ah = model.capacity_Ah
    current_A, voltage_V = last_digit(sensor.current_resolution_A, sensor.voltage_resolution_V)
    offset_V = beyond(CAR.voltage_offset_V, sensor.voltage_offset_V, voltage_V)
    share = resistance_per_K(model) * beyond(CAR.temperature_K, sensor.temperature_K)
    if offset_V > 0.0 or share > 0.0:
        model = replace(model, error=model.error.with_slow(np.full(2, offset_V), share))
    drift = beyond(CAR.offset_A(size_Ah), sensor.offset_A(size_Ah), current_A) / size_Ah
    base = Noise.of_model(model)
    more = {
        "current_A": beyond(CAR.noise_A(size_Ah), sensor.noise_A(size_Ah), current_A),
        "voltage_V": beyond(CAR.voltage_noise_V, sensor.voltage_noise_V, voltage_V),
        "soc_per_sqrt_h": drift,
        "offset_share": drift,
        "capacity_share": beyond(CAR.current_gain, sensor.current_gain),
    }
    wider: dict[str, Any] = {k: math.hypot(getattr(base, k), std) for k, std in more.items()}
    noise = replace(
        base,
        **wider,
        current_limit_A=min(base.current_limit_A, saturated_A(sensor)),
        frozen_V=max(base.frozen_V, sensor.voltage_resolution_V),
    )
    return Seen(model, noise)


def last_digit(*resolutions: float) -> tuple[float, ...]:
    """Deviation of what rounding adds: to every sample, and for good while nothing changes."""
    return tuple(one / math.sqrt(12.0) for one in resolutions)


def beyond(usual: float, *stds: float) -> float:
    """What deviations have together more than the usual one, in squares."""
    return math.sqrt(max(math.fsum((*(std * std for std in stds), -usual * usual)), 0.0))


def saturated_A(sensor: Sensor) -> float:
    """The largest current that is a reading, and not the end of the sensor's range [A]."""
    if sensor.current_range_A is None:
        return math.inf
    below = float(np.nextafter(np.float32(sensor.current_range_A), np.float32(0.0)))
    return min(below, sensor.current_range_A - sensor.current_resolution_A)


def resistance_per_K(model: CellModel) -> float:
    """By what share the resistances change with the temperature, where that is most [1/K].

    By the tables, and by Arrhenius' law at the coldest that the model knows.
    """
    whole = np.maximum((model.r0_ohm + model.r1_ohm + model.r2_ohm).mean(axis=1), 1e-12)
    steps = np.abs(np.diff(np.log(whole))) / np.diff(model.temperature_C)
    valid_C = model.validity.temperature_C
    coldest_C = model.usual_temperature_C if valid_C is None else valid_C[0]
    law = model.effect(TemperatureDependence)
    return float(np.max(steps, initial=0.0)) + law.activation_K / (coldest_C + ZERO_CELSIUS_K) ** 2
