"""Cases drawn from a seed: a published cell, drives, an instrument; nothing or something wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.physics_laboratory.cell_physics import Array, capacity_Ah, respond
from benchmarks.physics_laboratory.changes import CHANGES, FAMILIES, Change, Instrument, World
from benchmarks.physics_laboratory.published_cells import CELLS, PublishedCell, cells_for
from benchmarks.physics_laboratory.stored import Case
from benchmarks.physics_laboratory.virtual_laboratory import (
    CURRENT_NOISE,
    CURRENT_STEP,
    TEMPERATURE_NOISE_C,
    TEMPERATURE_STEP_C,
    VOLTAGE_NOISE_V,
    VOLTAGE_STEP_V,
    shown,
)
from cellwise.logs.cell_log import CellLog
from random_loads import random_load

ROWS = 5400
HOLD_ROWS = 9  # a drive's demand changes every so many seconds
SIZES_V = (0.008, 0.040)
TRAIN = 2
HEALTHY = World()


@dataclass(frozen=True)
class Drive:
    """What is logged of a current without error, and the true SOC at its start."""

    time_s: Array
    current_A: Array
    soc0: float


def draw_case(
    seed: int, kind: str, purpose: str = "development", only: tuple[str, ...] = ()
) -> Case:
    """A case of a kind (``none``, ``single``, ``pairs``, ``faults``); ``only`` of these changes."""
    rng = np.random.default_rng([seed, *kind.encode()])
    cells = cells_for(purpose)
    cell = cells[int(rng.integers(len(cells)))]
    told = cell.flat or rng.random() < 0.4
    changes = _changes(kind, rng, cell, only)
    if any(c.needs == "told" for c in changes):
        told = True
    drives = [_drive(cell, rng) for _ in range(TRAIN + 2)]
    world, sizes = HEALTHY, []
    for change in changes:
        sign = -1.0 if change.signed and rng.random() < 0.5 else 1.0
        target = rng.uniform(*SIZES_V) if change.sized else 0.0
        size, x = _sized(cell, change, sign, drives[0], target, rng)
        world = change.put(world, x, capacity_Ah(cell))
        sizes.append(size)
    logs = [_log(cell, world, d, rng, f"drive {k + 1}") for k, d in enumerate(drives[: TRAIN + 1])]
    baseline = [_log(cell, HEALTHY, drives[-1], rng, "good drive")] if rng.random() < 0.5 else []
    return Case(
        seed=seed,
        kind=kind,
        cell=cell.name,
        changes=tuple(c.name for c in changes),
        sizes_V=tuple(sizes),
        told=tuple(d.soc0 for d in drives[: TRAIN + 1]) if told else None,
        told_baseline=drives[-1].soc0 if told else None,
        logs=tuple(logs[:TRAIN]),
        holdout=tuple(logs[TRAIN:]),
        baseline=tuple(baseline),
    )


def laboratory_drives(cell: PublishedCell, rng: np.random.Generator, many: int) -> list[CellLog]:
    """Drives of the healthy cell for its identification, their start known."""
    drives = [_drive(cell, rng) for _ in range(many)]
    return [healthy_log(cell, d, rng, f"drive {k + 1}") for k, d in enumerate(drives)]


def healthy_log(cell: PublishedCell, drive: Drive, rng: np.random.Generator, name: str) -> CellLog:
    """What is logged of a healthy cell, its start known."""
    return replace(_log(cell, HEALTHY, drive, rng, name), soc0=drive.soc0)


def _changes(
    kind: str, rng: np.random.Generator, cell: PublishedCell, only: tuple[str, ...]
) -> tuple[Change, ...]:
    """Which of the changes that the cell can have."""

    def possible(change: Change) -> bool:
        return not change.needs or bool(getattr(cell, change.needs, True))

    if kind == "none":
        return ()
    if kind == "pairs":
        first, second = rng.choice(len(FAMILIES), 2, replace=False)
        drawn = []
        for family in (FAMILIES[first], FAMILIES[second]):
            names = [n for n in family if possible(CHANGES[n])]
            drawn.append(CHANGES[str(rng.choice(names))])
        return tuple(drawn)
    names = [
        c.name
        for c in CHANGES.values()
        if c.sized == (kind == "single") and possible(c) and (not only or c.name in only)
    ]
    if not names:
        raise SystemExit(f"{cell.name} cannot have {', '.join(only)}: draw another seed")
    return (CHANGES[names[int(rng.integers(len(names)))]],)


def _drive(cell: PublishedCell, rng: np.random.Generator) -> Drive:
    """A random drive, at most as hard as the cell bears."""
    soc0 = float(rng.uniform(0.85, 0.95))
    q = capacity_Ah(cell)
    load = random_load(
        rng, q, soc0, rows=ROWS, rate_hz=1.0, charge=bool(rng.random() < 0.5), temperature_C=(0, 1)
    )
    most = cell.largest_C * q
    current = most * np.tanh(load.current_A / most)
    held = np.repeat(current[1::HOLD_ROWS], HOLD_ROWS)[: current.size - 1]
    return Drive(load.time_s, np.concatenate(([0.0], held)), soc0)


def _sized(
    cell: PublishedCell,
    change: Change,
    sign: float,
    drive: Drive,
    target_V: float,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Of a change of about the wanted size: its size [V], and how much it is."""
    q = capacity_Ah(cell)
    if not change.sized:
        x = change.most * float(rng.uniform(0.5, 1.0))
        return 0.0, x
    good = _seen(cell, HEALTHY, drive)[0]

    def size(x: float) -> float:
        bad = _seen(cell, change.put(HEALTHY, x, q), drive)[0]
        rows = min(bad.size, good.size)
        return float(np.sqrt(np.mean((bad[:rows] - good[:rows]) ** 2)))

    x = sign * change.most / 8.0
    found = size(x)
    for _ in range(3):
        if abs(found / target_V - 1.0) < 0.1:
            break
        x = float(np.clip(x * target_V / max(found, 1e-6), -change.most, change.most))
        found = size(x)
    if found < 0.5 * SIZES_V[0]:
        raise ValueError(f"{change.name} of {cell.name} is at most {1e3 * found:.1f} mV")
    return found, x


def _seen(cell: PublishedCell, world: World, drive: Drive) -> tuple[Array, Array]:
    """Voltage and temperature that the instrument would log without noise or fault.

    A told SOC that is wrong is a start that is wrong for whoever believes it.
    """
    i = world.instrument
    # At rest the cell is cut off: nothing flows, whatever the sensor reads.
    true_A = np.where(drive.current_A == 0.0, 0.0, (drive.current_A - i.offset_A) / i.gain)
    found = respond(cell, world.cell, drive.time_s, true_A, drive.soc0 - i.soc0_shift)
    rows = found.voltage_V.size
    time = drive.time_s[:rows]
    voltage = np.interp(time - i.skew_s, time, found.voltage_V) + i.offset_V
    surface = np.full(rows, world.cell.ambient_C) if i.chamber else found.cell_C
    return voltage, surface


def _log(
    cell: PublishedCell, world: World, drive: Drive, rng: np.random.Generator, name: str
) -> CellLog:
    """The log of a drive."""
    voltage, surface = _seen(cell, world, drive)
    rows = voltage.size
    noise, q = rng.standard_normal((3, rows)), capacity_Ah(cell)
    read_A = np.where(drive.current_A == 0.0, world.instrument.offset_A, drive.current_A)[:rows]
    current = shown(read_A + CURRENT_NOISE * q * noise[0], CURRENT_STEP * q)
    voltage = shown(voltage + VOLTAGE_NOISE_V * noise[1], VOLTAGE_STEP_V)
    current, voltage = faulty(world.instrument, current, voltage, rng)
    temperature = shown(surface + TEMPERATURE_NOISE_C * noise[2], TEMPERATURE_STEP_C)
    return CellLog(
        drive.time_s[:rows], current, voltage, temperature if cell.arrhenius else None, name=name
    )


def faulty(
    i: Instrument, current_A: Array, voltage_V: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Channels with what a broken sensor makes of them."""
    n = current_A.size
    current, voltage = current_A.copy(), voltage_V.copy()
    for share, channel in ((i.stuck_V, voltage), (i.stuck_A, current)):
        if share:
            begin = int(rng.uniform(0.1, 0.85 - share) * n)
            channel[begin : begin + int(share * n)] = channel[begin]
    if i.saturated:
        top = i.saturated * float(np.max(current))
        current = np.minimum(current, top)
    if i.spikes:
        at = rng.choice(n, max(int(i.spikes * n), 3), replace=False)
        voltage[at] += rng.choice([-1.0, 1.0], at.size) * rng.uniform(0.2, 2.0, at.size)
    if i.lost:
        begin = int(rng.uniform(0.1, 0.85 - i.lost) * n)
        voltage[begin : begin + int(i.lost * n)] = np.nan
    return current, voltage


__all__ = ["CELLS", "draw_case"]
