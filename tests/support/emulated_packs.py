"""Packs of simulated cells, each a little different, with one fault put into one of them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.logs.cell_log import CellLog
from cellwise.logs.packs.pack_log import PackLog


@dataclass(frozen=True)
class Fault:
    """What is wrong with one cell; zeros are no fault."""

    cell: int = 0
    capacity: float = 0.0  # share
    resistance: float = 0.0  # share
    soc: float = 0.0
    leak_A: float = 0.0
    offset_V: float = 0.0
    delay_s: float = 0.0


def drive_current(rows, capacity_Ah, seed):
    """A load that comes and goes by the minute, with rests, about C/4 on average."""
    rng = np.random.default_rng(seed)
    minutes = rows // 30 + 1
    level = rng.choice([0.0, 0.1, 0.4, 0.8, -0.2], minutes, p=[0.25, 0.25, 0.25, 0.15, 0.1])
    wiggle = np.repeat(rng.normal(0.0, 0.2, rows // 5 + 1), 5)[:rows]
    current = np.repeat(level, 30)[:rows]
    return capacity_Ah * np.where(current == 0.0, 0.0, current + wiggle)


def emulated_pack(
    cells, fault=None, *, hours=3.0, seed=0, soc0=0.9, noise_V=0.001, name="pack", balanced=0.0
):
    """Model of the mean cell and a pack's log at 1 Hz.

    Cells differ by 0.4 % in capacity, 1.5 % in resistance, 0.3 % in SOC, their sensors by 0.5 mV;
    who is who depends on the number of the cell alone, what happens to them on the seed.
    ``balanced`` is how much their SOC moves from one seed to the next (standard deviation).
    """
    model = stock_model("nca-18650")
    rows = int(hours * 3600)
    own = np.random.default_rng(12345)
    spread = own.normal(size=(cells, 4)) * [0.004, 0.015, 0.003, 0.0005]
    rng = np.random.default_rng(seed + 1)
    moved = np.random.default_rng(seed + 1000).normal(0.0, 1.0, cells) * balanced
    current = drive_current(rows, model.capacity_Ah, seed) * min(3.0 / hours, 1.0)
    time = np.arange(rows, dtype=np.float64)
    warm = np.full(rows, model.temperature_C[-1])
    volts = np.empty((rows, cells))
    for k in range(cells):
        hurt = fault if fault is not None and fault.cell == k else Fault()
        one = 1.0 + spread[k, 1] + hurt.resistance
        cell = replace(
            model,
            capacity_Ah=model.capacity_Ah * (1.0 + spread[k, 0] + hurt.capacity),
            r0_ohm=one * model.r0_ohm, r1_ohm=one * model.r1_ohm, r2_ohm=one * model.r2_ohm,
        )  # fmt: skip
        log = CellLog(time, current + hurt.leak_A, np.full(rows, 3.7), temperature_C=warm)
        start = soc0 + spread[k, 2] + moved[k] + hurt.soc
        volts[:, k] = simulate(cell, log, start).voltage_V + spread[k, 3] + hurt.offset_V
        if hurt.delay_s:
            volts[:, k] = np.interp(time - hurt.delay_s, time, volts[:, k])
    volts += rng.normal(0.0, noise_V, volts.shape)
    volts = np.round(volts, 3)
    return model, PackLog.from_arrays(time, current, volts, temperature_C=warm, name=name)


def with_cells(pack, volts):
    """A pack's log with other cell voltages, shape (n, cells): mean and checks again."""
    mean = {one.name: getattr(pack.mean, one.name) for one in fields(pack.mean)}
    same = {name: getattr(pack, name) for name in ("names", "pack_V", "balancing")}
    return PackLog.from_arrays(cell_V=volts, **same, **mean)
