"""Cells drawn at random for the emulator, and the imperfect model that is known of each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellwise import CellModel, IdentifySettings, ModelError, TestLogs, identify_cell
from cellwise.cell.effects import Effect, SlowDiffusion, TemperatureDependence
from cellwise.logs.cell_log import CellLog
from emulator import Array, Cell, Sensor, Table, emulate, flat, measure

Chemistry = Literal["nmc", "lfp"]
FINE = 2001
MODEL_POINTS = 51


@dataclass(frozen=True)
class Misfit:
    """Standard deviation of what identification gets wrong: smooth over SOC, and on average."""

    resistance: float = 0.02
    resistance_mean: float = 0.005
    time_constant: float = 0.05
    ocv_V: float = 1.0e-3
    ocv_mean_V: float = 0.3e-3
    capacity: float = 0.001


def wave(rng: np.random.Generator, soc: Array, waves: int = 4) -> Array:
    """A smooth random function of SOC without mean, of unit standard deviation."""
    value = np.zeros(soc.size)
    for k in range(1, waves + 1):
        value += rng.normal() / k * np.cos(np.pi * k * soc + rng.uniform(0.0, 2.0 * np.pi))
    value -= value.mean()
    return value / value.std()


def random_cell(
    rng: np.random.Generator,
    chemistry: Chemistry | None = None,
    *,
    third: bool = False,
    activation_K: float = 0.0,
) -> Cell:
    """1 to 60 Ah, NMC-like or LFP-like; resistances are so many volt at 1C."""
    chemistry = chemistry or ("nmc" if rng.random() < 0.7 else "lfp")
    capacity = float(np.exp(rng.uniform(np.log(1.0), np.log(60.0))))
    soc = np.linspace(0.0, 1.0, FINE)

    def resistance(low: float, high: float) -> Table:
        rise = rng.uniform(0.2, 1.0) * np.exp(-rng.uniform(6.0, 12.0) * soc)
        shape = (1.0 + rise) * np.exp(0.08 * wave(rng, soc))
        return Table(rng.uniform(low, high) / capacity * shape)

    def seconds(low: float, high: float) -> Table:
        middle = np.exp(rng.uniform(np.log(low), np.log(high)))
        return Table(middle * np.exp(0.12 * wave(rng, soc, 3)))

    return Cell(
        capacity_Ah=capacity,
        ocv_V=Table(_nmc_ocv(rng, soc) if chemistry == "nmc" else _lfp_ocv(rng, soc)),
        r0_ohm=resistance(0.04, 0.10),
        r1_ohm=resistance(0.015, 0.045),
        tau1_s=seconds(2.0, 8.0),
        r2_ohm=resistance(0.02, 0.05),
        tau2_s=seconds(35.0, 130.0),
        r3_ohm=resistance(0.02, 0.05) if third else flat(0.0),
        tau3_s=seconds(600.0, 2000.0) if third else flat(1000.0),
        activation_K=activation_K,
    )


def _nmc_ocv(rng: np.random.Generator, soc: Array) -> Array:
    ocv = rng.uniform(3.35, 3.50) + rng.uniform(0.50, 0.66) * soc
    ocv += rng.uniform(0.02, 0.12) * soc ** rng.uniform(3.0, 7.0)
    ocv -= rng.uniform(0.3, 0.6) * np.exp(-rng.uniform(15.0, 22.0) * soc)
    for _ in range(2):
        ocv += rng.uniform(0.0, 0.02) * np.tanh(
            rng.uniform(6.0, 12.0) * (soc - rng.uniform(0.25, 0.85))
        )
    return rising(ocv + 0.006 * wave(rng, soc, 3))


def _lfp_ocv(rng: np.random.Generator, soc: Array) -> Array:
    ocv = rng.uniform(3.21, 3.27) + rng.uniform(0.02, 0.05) * soc
    ocv += rng.uniform(0.012, 0.028) * np.tanh(
        rng.uniform(8.0, 14.0) * (soc - rng.uniform(0.55, 0.72))
    )
    ocv += rng.uniform(0.008, 0.020) * np.tanh(
        rng.uniform(8.0, 14.0) * (soc - rng.uniform(0.22, 0.35))
    )
    ocv -= rng.uniform(0.3, 0.5) * np.exp(-rng.uniform(17.0, 24.0) * soc)
    ocv += rng.uniform(0.05, 0.10) * np.exp(-rng.uniform(25.0, 35.0) * (1.0 - soc))
    return rising(ocv)


def rising(ocv: Array) -> Array:
    """The curve with a slope of at least 5 mV per full charge."""
    step = np.maximum(np.diff(ocv), 0.005 / (ocv.size - 1))
    return ocv[0] + np.concatenate(([0.0], np.cumsum(step)))


def known_model(
    cell: Cell, rng: np.random.Generator, misfit: Misfit | None = None, noise_V: float = 1e-3
) -> CellModel:
    """What a good identification would know: the true tables on 51 points, a little wrong."""
    off = misfit or Misfit()
    soc = np.linspace(0.0, 1.0, MODEL_POINTS)

    def near(table: Table, shape: float, mean: float) -> Array:
        error = rng.normal() * mean + shape * rng.uniform(0.5, 1.2) * wave(rng, soc)
        return table(soc) * np.exp(error)

    def ohm(table: Table) -> Array:
        return near(table, off.resistance, off.resistance_mean)

    def second(table: Table) -> Array:
        return near(table, off.time_constant, off.time_constant / 2.0)

    ocv = cell.ocv_V(soc) + off.ocv_mean_V * rng.normal() + off.ocv_V * wave(rng, soc)
    effects: list[Effect] = []
    if np.any(cell.r3_ohm.values > 0.0):
        effects.append(SlowDiffusion(ohm(cell.r3_ohm)[None, :], second(cell.tau3_s)[None, :]))
    if cell.activation_K:
        activation = cell.activation_K * (1.0 + 0.02 * rng.normal())
        effects.append(TemperatureDependence(activation, cell.reference_C))
    return CellModel(
        capacity_Ah=cell.capacity_Ah * (1.0 + off.capacity * rng.normal()),
        ocv_V=np.maximum.accumulate(ocv),
        r0_ohm=ohm(cell.r0_ohm),
        r1_ohm=ohm(cell.r1_ohm),
        tau1_s=second(cell.tau1_s),
        r2_ohm=ohm(cell.r2_ohm),
        tau2_s=second(cell.tau2_s),
        temperature_C=np.array([cell.reference_C]),
        effects=tuple(effects),
        error=ModelError.of_white_and_slow(white_V=noise_V, slow_V=(0.003,), resistance_share=0.03),
        name="emulated cell",
    )


def identified_model(cell: Cell, rng: np.random.Generator) -> CellModel:
    """What identification finds on the emulator's own HPPC test and C/20 cycle.

    Both are at one temperature, so what it assumes of others is replaced by what is known.
    """
    hppc, low_rate = laboratory(cell, rng)
    tests = TestLogs(hppc=((hppc, cell.reference_C),), ocv=(low_rate,))
    settings = IdentifySettings(
        nominal_Ah=cell.capacity_Ah,
        branches=3 if np.any(cell.r3_ohm.values > 0.0) else 2,
        temperature_C=cell.reference_C,
        name="emulated cell",
    )
    found = identify_cell(tests, settings).model
    others = tuple(e for e in found.effects if not isinstance(e, TemperatureDependence))
    known = (TemperatureDependence(cell.activation_K, cell.reference_C),)
    return replace(found, effects=others + (known if cell.activation_K else ()))


def laboratory(cell: Cell, rng: np.random.Generator) -> tuple[CellLog, CellLog]:
    """An HPPC test from full to empty (10 Hz around pulses) and a C/20 discharge and charge."""
    q = cell.capacity_Ah
    sensor = Sensor(noise_V=0.3e-3, noise_A=2e-4 * q, noise_C=0.05, step_V=1e-4)
    steps = [(0.0, 60.0, 1.0)]
    for level in np.arange(1.0, 0.05, -0.1):
        steps += [(1.0 * q, 10.0, 0.1), (0.0, 60.0, 0.2), (0.0, 240.0, 2.0)]
        if level < 0.95:
            steps += [(-0.75 * q, 10.0, 0.1), (0.0, 60.0, 0.2), (0.0, 240.0, 2.0)]
        kept = -10.0 / 3600.0 + (0.75 * 10.0 / 3600.0 if level < 0.95 else 0.0)
        steps += [(q / 3.0, (0.1 + kept) * 3.0 * 3600.0, 5.0), (0.0, 1800.0, 5.0)]
    hppc = _played(cell, steps, 1.0, sensor, rng, "hppc")
    slow = [
        (0.0, 60.0, 10.0),
        (q / 20.0, 72000.0, 60.0),
        (0.0, 3600.0, 60.0),
        (-q / 20.0, 72000.0, 60.0),
    ]
    return hppc, _played(cell, slow, 1.0, sensor, rng, "c20")


def _played(
    cell: Cell,
    steps: list[tuple[float, float, float]],
    soc0: float,
    sensor: Sensor,
    rng: np.random.Generator,
    name: str,
) -> CellLog:
    """Steps of (current, seconds, row interval) as a log with the tester's counter."""
    time, current = [0.0], [0.0]
    for ampere, seconds, interval in steps:
        rows = max(round(seconds / interval), 1)
        time += list(time[-1] + seconds * np.arange(1, rows + 1) / rows)
        current += [ampere] * rows
    t, amps = np.array(time), np.array(current)
    run = emulate(cell, t, amps, cell.reference_C, soc0)
    counter = np.concatenate(([0.0], np.cumsum(amps[1:] * np.diff(t)))) / 3600.0
    log = measure(run, sensor, rng, name)
    return CellLog(
        log.time_s, log.current_A, log.voltage_V, log.temperature_C, charge_Ah=counter, name=name
    )
