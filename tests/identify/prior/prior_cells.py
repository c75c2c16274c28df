"""A cell that differs from a stock model in known ways, and drives of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.cell.simulate import simulate
from cellwise.cell.stock import named_model
from cellwise.logs.cell_log import CellLog

CAPACITY_AH = 5.0


def other_cell(name="nmc-18650", shift=0.03, factor=1.3):
    """A cell of the kind: OCV shifted along SOC, but not at its ends; resistances by a factor."""
    stock = named_model(name, CAPACITY_AH)
    bent = np.interp(stock.soc + shift * np.sin(np.pi * stock.soc), stock.soc, stock.ocv_V[0])
    return replace(
        stock,
        ocv_V=np.maximum.accumulate(np.tile(bent, (stock.temperature_C.size, 1)), axis=1),
        r0_ohm=factor * stock.r0_ohm,
        r1_ohm=factor * stock.r1_ohm,
        r2_ohm=factor * stock.r2_ohm,
    )


def drive_of(model, soc0, soc_end, seed=3, noise_V=5e-4) -> CellLog:
    """A drive with rests between its loads from one SOC to another, 1 Hz."""
    rng = np.random.default_rng(seed)
    load = np.repeat(rng.uniform(-0.5, 2.2, 400), rng.integers(5, 40, 400))
    current = CAPACITY_AH * load
    moved = np.cumsum(current) / 3600.0 / CAPACITY_AH
    last = int(np.argmax(moved >= soc0 - soc_end))
    assert last > 0, "the load moves too little"
    current = np.concatenate((np.zeros(60), current[:last]))
    log = CellLog(
        time_s=np.arange(current.size, dtype=float),
        current_A=current,
        voltage_V=np.full(current.size, 3.7),
        name=f"drive{seed}",
    )
    voltage = simulate(model, log, soc0).voltage_V
    return replace(log, voltage_V=voltage + rng.normal(0.0, noise_V, current.size))
