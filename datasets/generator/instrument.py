"""From true values to what an instrument writes: noise, resolution, time stamps, counter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .physics import FloatArray
from .tester import TrueLog


@dataclass(frozen=True)
class Instrument:
    """Errors of the measuring channel.

    Attributes
    ----------
    range_A : float              current range; its noise scales with it [A]
    current_noise : float        standard deviation as a share of the range
    voltage_noise_V : float      standard deviation [V]
    temperature_noise_C : float  standard deviation [degC]
    voltage_step_V, current_step_A, temperature_step_C, counter_step_Ah, time_step_s : float
        resolution of each column
    """

    range_A: float
    current_noise: float = 2e-4
    voltage_noise_V: float = 0.5e-3
    temperature_noise_C: float = 0.05
    voltage_step_V: float = 1e-4
    current_step_A: float = 1e-3
    temperature_step_C: float = 0.1
    counter_step_Ah: float = 1e-4
    time_step_s: float = 1e-3


class Recording(NamedTuple):
    """The columns of a tidy log, shape (n,) each; `temperature_C` is None without a sensor."""

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray | None
    ampere_hours: FloatArray
    step: NDArray[np.int32]


def _resolve(values: FloatArray, step: float) -> FloatArray:
    """Round to a resolution, as decimal numbers that print with no trailing noise."""
    decimals = max(0, round(-np.log10(step)))
    # Adding zero turns a negative zero into a plain one.
    return np.round(values, decimals) + 0.0


def measure(
    log: TrueLog, instrument: Instrument, thermocouple: bool, rng: np.random.Generator
) -> Recording:
    """Write down a true log as the instrument sees it.

    The counter is integrated inside the tester from the true current: it has resolution but
    neither noise nor drift. With the relay open the tester writes a current of exactly zero.

    Parameters
    ----------
    log : TrueLog
    instrument : Instrument
    thermocouple : bool            whether a temperature column is written
    rng : numpy.random.Generator   source of the noise
    """
    rows = log.time_s.size
    current_sd = instrument.current_noise * instrument.range_A
    current = log.current_A + current_sd * rng.standard_normal(rows)
    current[np.abs(log.current_A) < 1e-9] = 0.0
    voltage = log.voltage_V + instrument.voltage_noise_V * rng.standard_normal(rows)
    temperature = None
    if thermocouple:
        noisy = log.temperature_C + instrument.temperature_noise_C * rng.standard_normal(rows)
        temperature = _resolve(noisy, instrument.temperature_step_C)
    return Recording(
        _resolve(log.time_s, instrument.time_step_s),
        _resolve(current, instrument.current_step_A),
        _resolve(voltage, instrument.voltage_step_V),
        temperature,
        _resolve(log.charge_Ah, instrument.counter_step_Ah),
        log.step.astype(np.int32),
    )
