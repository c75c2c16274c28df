"""Cells that differ from the exported model as cells do, their missions and their sensors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cellwise.benchmark.faults import Fault
from cellwise.cell.effects import Hysteresis, SlowDiffusion, TemperatureDependence
from cellwise.cell.model import CellModel
from cellwise.cell.posterior import POINTS, CellDraw
from cellwise.cell.protocol import ConstantCurrent, ConstantVoltage, DriveProfile, Rest, Step
from cellwise.estimate.sensor import Sensor
from cellwise.typing import FloatArray


@dataclass(frozen=True)
class CellSpread:
    """How cells of one kind differ (standard deviations), and what age 1 has made of them.

    A cell is at its end of life at 80 % of its capacity or twice its resistance, as vehicle makers
    define it. Both ends of its OCV stay where they are, since they are what its capacity is counted
    between; lost lithium moves the electrodes against each other, and the OCV in the middle.
    """

    capacity: float = 0.01
    resistance: float = 0.05  # of all resistances together
    branch: float = 0.10  # of each resistance beside
    hysteresis_V: float = 0.003
    activation_K: float = 300.0
    faded: float = 0.20
    resistance_grown: float = 1.0
    slipped_soc: float = 0.03
    model_error: float = 1.0  # of what the model states of its own error
    age: float | None = None  # None: drawn, as is the temperature
    temperature_C: float | None = None


# What goes wrong beside, in every second cell; shares of 1C so that they fit a cell of any size.
FAULTS = (
    Fault("current +3 % of 1C", current_offset_C=0.03),
    Fault("current -3 % of 1C", current_offset_C=-0.03),
    Fault("current gain +3 %", current_gain=1.03),
    Fault("voltage +30 mV", voltage_offset_V=0.030),
    Fault("voltage -30 mV", voltage_offset_V=-0.030),
    Fault("voltage one sample late", voltage_lag_samples=1),
    Fault("5 % of the samples lost", dropout_share=0.05),
)
NO_FAULT = Fault("none beside the sensor's class")
START_STD = 0.15  # of the SOC that the filter is started with


@dataclass(frozen=True, eq=False)
class VirtualCell:
    """One cell: its truth, where it lives, what its sensors do, how the filter is started."""

    truth: CellModel
    age: float
    temperature_C: float
    soc0: float
    given_soc0: float
    fault: Fault
    steps: tuple[Step, ...]


def draw_cell(
    model: CellModel,
    index: int,
    seed: int,
    hours: float,
    dt_s: float,
    sensor: Sensor,
    spread: CellSpread | None = None,
) -> VirtualCell:
    """The cell of an index: the same for the same seed, whatever is drawn beside it."""
    rng = np.random.default_rng([seed, index])
    spread = spread or CellSpread()
    drawn = float(rng.uniform())
    age = drawn if spread.age is None else spread.age
    truth = aged(model, age, rng, spread)
    low, high = model.validity.temperature_C or (model.temperature_C[0], model.temperature_C[-1])
    drawn_C = float(rng.uniform(low, high))
    temperature_C = drawn_C if spread.temperature_C is None else spread.temperature_C
    soc0 = float(rng.uniform(0.2, 1.0))
    started = float(np.clip(soc0 + START_STD * rng.standard_normal(), 0.0, 1.0))
    fault = NO_FAULT if index % 2 == 0 else FAULTS[index // 2 % len(FAULTS)]
    both = with_sensor(fault, sensor, truth.capacity_Ah, rng)
    steps = tuple(mission(truth, soc0, hours, dt_s, rng))
    return VirtualCell(truth, age, temperature_C, soc0, started, both, steps)


def with_sensor(
    fault: Fault, sensor: Sensor, capacity_Ah: float, rng: np.random.Generator
) -> Fault:
    """A fault and what one sensor of its class is off by beside, on a cell of this size."""
    off = rng.standard_normal(4)
    wide_A = fault.current_range_A if sensor.current_range_A is None else sensor.current_range_A
    return replace(
        fault,
        current_offset_A=sensor.offset_A(capacity_Ah) * off[0],
        current_gain=fault.current_gain * (1.0 + sensor.current_gain * off[1]),
        voltage_offset_V=fault.voltage_offset_V + sensor.voltage_offset_V * off[2],
        temperature_K=sensor.temperature_K * off[3],
        current_noise_C=sensor.noise_A(capacity_Ah) / capacity_Ah,
        voltage_noise_V=sensor.voltage_noise_V,
        current_resolution_A=sensor.current_resolution_A,
        voltage_resolution_V=sensor.voltage_resolution_V,
        current_range_A=wide_A,
    )


def aged(model: CellModel, age: float, rng: np.random.Generator, spread: CellSpread) -> CellModel:
    """A sample of the cell after a part of its life, off by what the model says of its error too.

    What the model's fit left open is drawn from its posterior: capacity, OCV, resistances.

    Parameters
    ----------
    age : float       0 new, 1 at the end of life
    """
    n = rng.standard_normal
    fade = spread.faded * age * float(rng.uniform(0.5, 1.5))
    grown = (1.0 + spread.resistance_grown * age * float(rng.uniform(0.5, 1.5))) * math.exp(
        spread.resistance * n()
    )
    slip = spread.slipped_soc * age * n()
    left = model.soc + 4.0 * slip * model.soc * (1.0 - model.soc)
    fitted = _fitted_cell(model, rng)
    off_V = fitted.ocv_V + spread.model_error * _lasting_error_V(model, rng)
    ocv = np.array([np.interp(left, model.soc, row) for row in model.ocv_V]) + off_V
    grown_at = grown * np.exp(fitted.ln_r)
    r0, r1, r2, r3 = (grown_at * math.exp(spread.branch * n()) for _ in range(4))
    slow = model.effect(SlowDiffusion)
    law = model.effect(TemperatureDependence)
    hysteresis = model.effect(Hysteresis)
    m_V = np.asarray(hysteresis.m_V) + abs(spread.hysteresis_V * n())
    truth = replace(
        model,
        capacity_Ah=model.capacity_Ah
        * (1.0 - fade)
        * math.exp(fitted.ln_capacity + spread.capacity * n()),
        ocv_V=np.maximum.accumulate(ocv, axis=1),
        r0_ohm=model.r0_ohm * r0,
        r1_ohm=model.r1_ohm * r1,
        r2_ohm=model.r2_ohm * r2,
    )
    truth = truth.with_effect(
        replace(law, activation_K=law.activation_K + spread.activation_K * n())
    ).with_effect(replace(hysteresis, m_V=m_V, gamma=hysteresis.gamma or USUAL_GAMMA))
    if np.any(np.asarray(slow.r3_ohm) > 0.0):
        truth = truth.with_effect(replace(slow, r3_ohm=np.asarray(slow.r3_ohm) * r3))
    return truth


USUAL_GAMMA = 20.0  # e-folds per full charge: a branch is reached within a tenth of the charge
USUAL_LENGTH_SOC = 0.1  # over which the model's error is another one, where it does not say
LARGEST_RATE = 1.0  # of a mission's mean current, in C
REGENERATION = 0.15  # of the time of a drive


def _fitted_cell(model: CellModel, rng: np.random.Generator) -> CellDraw:
    """One of the cells that the model may have been of, over the model's SOC."""
    if model.posterior is None:
        return CellDraw(0.0, np.zeros(model.points), np.zeros(model.points))
    one = model.posterior.draw(rng)
    grid = np.linspace(0.0, 1.0, POINTS)
    ocv_V = _inside(model.soc, USUAL_LENGTH_SOC) * np.interp(model.soc, grid, one.ocv_V)
    return CellDraw(one.ln_capacity, ocv_V, np.interp(model.soc, grid, one.ln_r))


def _inside(soc: FloatArray, length: float) -> FloatArray:
    """From 0 at the ends of the charge, which are defined by their voltages, to 1 within."""
    return np.asarray(np.minimum(np.minimum(soc, 1.0 - soc) / length, 1.0))


def _lasting_error_V(model: CellModel, rng: np.random.Generator) -> FloatArray:
    """An error that lasts, drawn from the model's own statement of it, shape (1, points).

    Without what its posterior leaves of the OCV, which the statement holds and `_fitted_cell` has.
    """
    length = model.error.correlation_soc or USUAL_LENGTH_SOC
    gap = (model.soc[:, None] - model.soc[None, :]) / length
    smooth = np.linalg.cholesky(np.exp(-0.5 * gap**2) + 1e-6 * np.eye(model.points))
    lasting_V = model.error.at(model.soc) * math.sqrt(model.error.lasting_share)
    if model.posterior is not None:
        fitted_V = np.interp(model.soc, np.linspace(0.0, 1.0, POINTS), model.posterior.ocv_std_V)
        lasting_V = np.sqrt(np.maximum(lasting_V**2 - fitted_V**2, 0.0))
    size_V = _inside(model.soc, length) * lasting_V
    return np.asarray(size_V * (smooth @ rng.standard_normal(model.points)))[None, :]


def mission(
    truth: CellModel, soc0: float, hours: float, dt_s: float, rng: np.random.Generator
) -> Iterator[Step]:
    """Days of a cell: it drives, stands, is charged to some level or to full, stands."""
    capacity = truth.capacity_Ah
    charge_A, discharge_A = truth.validity.current_A or (-capacity, 2.0 * capacity)
    low_V = float(truth.ocv_V[:, 0].min()) if truth.voltage_min_V is None else truth.voltage_min_V
    high_V = float(truth.ocv_V[:, -1].max()) if truth.voltage_max_V is None else truth.voltage_max_V
    largest = min(LARGEST_RATE, 0.5 * discharge_A / capacity)
    fastest = max(min(0.7, 0.8 * -charge_A / capacity), 0.2)
    soc, gone_s = soc0, 0.0
    while gone_s < 3600.0 * hours:
        rest_s = 3600.0 * float(rng.uniform(0.2, 6.0))
        yield Rest(rest_s)
        gone_s += rest_s
        target = max(soc - float(rng.uniform(0.1, 0.8)), 0.08)
        mean = largest * float(rng.uniform(0.3, 1.0))
        drive = np.clip(_drive(capacity, soc - target, mean, dt_s, rng), charge_A, discharge_A)
        if drive.size > 1:
            time_s = np.asarray(dt_s * np.arange(1, drive.size + 1), dtype=np.float64)
            limits = {"voltage_min_V": low_V, "voltage_max_V": high_V}
            yield DriveProfile(time_s=time_s, current_A=drive, **limits)
            gone_s += dt_s * drive.size
            soc = target
        if soc > 0.5 and rng.uniform() < 0.5:
            continue  # goes on without a charge
        rest_s = 3600.0 * float(rng.uniform(0.1, 8.0))
        yield Rest(rest_s)
        rate = float(rng.uniform(0.2, fastest))
        full = rng.uniform() < 0.4
        level = 1.0 if full else float(rng.uniform(max(soc, 0.6), 0.95))
        charge_Ah = max(level - soc, 0.01) * capacity
        yield ConstantCurrent(
            current_A=-rate * capacity,
            voltage_max_V=high_V,
            charge_Ah=None if full else charge_Ah,
        )
        if full:
            yield ConstantVoltage(voltage_V=high_V, until_current_A=0.05 * capacity)
        gone_s += rest_s + 3600.0 * (level - soc) / rate
        soc = level


def _drive(
    capacity_Ah: float, share: float, rate: float, dt_s: float, rng: np.random.Generator
) -> FloatArray:
    """Currents of a drive that takes a share of the charge at a mean rate, a row each dt [A]."""
    rows = max(int(3600.0 * share / rate / dt_s), 2)
    rows_each = np.maximum(rng.exponential(8.0 / dt_s, rows), 1.0).astype(np.int64)
    loads = rate * rng.gamma(1.5, 1.0 / 1.5, rows)
    loads[rng.uniform(size=rows) < REGENERATION] *= -0.5
    current = np.repeat(loads, rows_each)[:rows]
    return np.asarray(capacity_Ah * current * rate / max(float(current.mean()), 0.2 * rate))
