"""An effect hidden in measured logs: what the instrument would have read had the cell had it.

A fault of the instrument is put on the channels. A property of the cell is put in as the voltage
difference between two emulated cells, with and without it, under the measured current: the log
keeps everything that the emulator does not know.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from cellwise import CellModel, IdentifySettings, TestLogs, identify_cell, read_log, simulate
from cellwise.cell.effects import Hysteresis, SlowDiffusion, TemperatureDependence
from cellwise.logs import CellLog
from cellwise.logs.cell_log import resample
from emulator import Cell, Sensor, Table, emulate, flat
from emulator_drives import Load
from emulator_effects import EFFECTS, World, amplitude, draw_effect, size_of
from hidden_cases import HiddenEffect, Sealed, Truth

FROM_FULL = 1.0
# Share of the nominal charge at which drives are cut.
ABOVE_EMPTY = 0.15

# What the measured loads can show at all: Panasonic drives at one temperature, A123 drives from
# full to the middle of the plateau, where charge leaves hardly a trace.
POSSIBLE = {
    "panasonic": (
        "current_offset",
        "current_gain",
        "voltage_offset",
        "time_skew",
        "initial_soc",
        "capacity",
        "resistance_scale",
        "ocv_shift",
        "slow_diffusion",
        "hysteresis",
        "rate_dependence",
        "charge_asymmetry",
        "self_discharge",
    ),
    "a123": ("current_offset", "voltage_offset", "time_skew", "ocv_shift", "slow_diffusion"),
}


@dataclass(frozen=True, eq=False)
class MeasuredCell:
    """A cell of the laboratory: its model, and drives from full that the model has not seen."""

    name: str
    model: CellModel
    drives: tuple[CellLog, ...]
    good: tuple[CellLog, ...]


def emulated_cell(model: CellModel, temperature_C: float = 25.0) -> Cell:
    """The emulator's cell with a model's tables at one temperature."""
    at = model.at_temperature(temperature_C)
    slow, hysteresis = at.effect(SlowDiffusion), at.effect(Hysteresis)
    activation = at.effect(TemperatureDependence)

    def table(values: object) -> Table:
        found = np.asarray(values, dtype=float)
        return Table(found.reshape(-1)) if found.size > 1 else flat(float(found.reshape(-1)[0]))

    return Cell(
        capacity_Ah=at.capacity_Ah,
        ocv_V=table(at.ocv_V),
        r0_ohm=table(at.r0_ohm),
        r1_ohm=table(at.r1_ohm),
        tau1_s=table(at.tau1_s),
        r2_ohm=table(at.r2_ohm),
        tau2_s=table(at.tau2_s),
        r3_ohm=table(slow.r3_ohm),
        tau3_s=table(slow.tau3_s),
        m_V=table(hysteresis.m_V),
        gamma=hysteresis.gamma if np.any(hysteresis.m_V) else 0.0,
        activation_K=activation.activation_K,
        reference_C=activation.reference_C,
        charge_efficiency=at.charge_efficiency,
    )


def load_of(log: CellLog) -> Load:
    """What flowed in a measured log, and at which temperature."""
    temperature = np.full(len(log), 25.0) if log.temperature_C is None else log.temperature_C
    rows = np.arange(len(log))
    known = np.isfinite(temperature)
    filled = np.interp(rows, rows[known], temperature[known])
    return Load(log.time_s, log.known_current_A(), filled)


def hide_in(log: CellLog, plain: World, changed: World, soc0: float, name: str) -> CellLog:
    """The log as it would have been; the tester's own counter, which would tell, is left out."""
    load = load_of(log)
    with_it, without = (
        emulate(
            world.cell, load.time_s, load.current_A, load.temperature_C, soc0 + world.soc0_shift
        ).voltage_V
        for world in (changed, plain)
    )
    sensor: Sensor = changed.sensor
    voltage = log.voltage_V + with_it - without + sensor.offset_V
    if sensor.skew_s:
        voltage = np.interp(log.time_s - sensor.skew_s, log.time_s, voltage)
    return replace(
        log,
        current_A=sensor.gain * load.current_A + sensor.offset_A,
        current_meaning="interval_end",
        voltage_V=voltage,
        charge_Ah=None,
        step=None,
        name=name,
        source="",
        notices=(),
    )


def hidden_real_case(
    cell: MeasuredCell,
    seed: int,
    effects: tuple[str, ...] = (),
    size_V: float = 0.020,
    drives: int = 1,
) -> Sealed:
    """Drives to learn from and as many to judge by with the effects in all, and a good one."""
    rng = np.random.default_rng([seed, len(effects), 17])
    order = rng.permutation(len(cell.drives))
    chosen = [cell.drives[k] for k in order]
    train, holdout = chosen[:drives], chosen[drives : 2 * drives]
    good = cell.good or (chosen[2 * drives],)
    soc0 = FROM_FULL
    plain = World(emulated_cell(cell.model))
    loads = [(load_of(log), soc0) for log in train]
    world, hidden = plain, []
    for name in effects:
        draw = draw_effect(rng)
        if name == "initial_soc":
            draw = replace(draw, sign=-1.0)  # nothing is fuller than full
        put, x = EFFECTS[name][0], amplitude(name, draw, plain, loads, size_V)
        alone, values = put(plain, draw, x)
        world = put(world, draw, x)[0]
        if name == "initial_soc":
            values = {"soc0": soc0 + values["soc0"]}
        size = size_of(plain, alone, loads)
        hidden.append(HiddenEffect(name, values, size))

    def answer() -> Truth:
        left = [simulate(cell.model, log, soc0).metrics.rmse_V for log in holdout]
        possible = float(np.sqrt(np.mean(np.square(left))))
        return Truth(tuple(hidden), world, plain, (soc0,), possible, cell.name)

    return Sealed(
        label=f"{cell.name} {seed}",
        model=cell.model,
        logs=[hide_in(log, plain, world, soc0, f"log {k + 1}") for k, log in enumerate(train)],
        holdout=[
            hide_in(log, plain, world, soc0, f"log {drives + k + 1}")
            for k, log in enumerate(holdout)
        ],
        baseline=[
            hide_in(log, plain, plain, soc0, f"good log {k + 1}") for k, log in enumerate(good)
        ],
        soc0=soc0,
        answer=answer,
    )


@lru_cache(maxsize=4)
def measured_cell(folder: Path, which: Literal["panasonic", "a123"]) -> MeasuredCell:
    """Identified from laboratory tests and a drive that no case uses to judge by."""
    return _panasonic(folder) if which == "panasonic" else _a123(folder)


def _panasonic(folder: Path) -> MeasuredCell:
    def log(name: str) -> CellLog:
        return read_log(folder / "panasonic_18650pf" / f"{name}.csv.gz")

    tests = TestLogs(
        hppc=((log("hppc_p25"), None),),
        ocv=(log("ocv_c20_p25"),),
        capacity=(log("cap_1c_p25_start_1"), log("cap_1c_p25_start_2")),
        drive=((log("drive_p25_cycle_2"), None),),
    )
    model = identify_cell(tests, IdentifySettings(nominal_Ah=2.9)).model
    names = ("cycle_3", "cycle_4", "us06", "hwfta", "hwftb", "nn")
    # At 1 Hz the mean current no longer fits the voltage at its end: 5 Hz keeps the pulses.
    drives = tuple(_above_empty(resample(log(f"drive_p25_{name}"), 0.2), 2.9) for name in names)
    return MeasuredCell("panasonic", model, drives, ())


def _above_empty(log: CellLog, nominal_Ah: float) -> CellLog:
    """The log until ABOVE_EMPTY of the charge is left: below, a few rows would rule the rest."""
    spent = log.counted_charge_Ah() - log.counted_charge_Ah()[0]
    low = np.flatnonzero(spent > (1.0 - ABOVE_EMPTY) * nominal_Ah)
    return log.part(0, int(low[0])) if low.size else log


def _a123(folder: Path) -> MeasuredCell:
    """One drive learns the model and is the good one; a case sees the first four hours."""

    def log(name: str) -> CellLog:
        return read_log(folder / "plett_a123" / f"{name}.csv.gz")

    tests = TestLogs(
        ocv=tuple(log(f"ocv_p25_s{k}") for k in (1, 2, 3, 4)),
        drive=((log("dyn_p35_s1"), None),),
    )
    model = identify_cell(tests, IdentifySettings(nominal_Ah=2.3, chemistry="LFP")).model
    logs = {name: log(f"dyn_{name}_s1").part(0, 15000) for name in ("p25", "p35", "p45")}
    return MeasuredCell("a123", model, (logs["p25"], logs["p45"]), (logs["p35"],))
