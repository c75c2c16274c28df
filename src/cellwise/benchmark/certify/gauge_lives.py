"""A gauge through a certified life: samples that it sees, restarts, and what each cause costs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.benchmark.certify.gauge import (
    RESTART,
    SAMPLE,
    SAVE,
    TORN,
    UPDATED,
    Gauge,
    GaugeConfig,
    config_of,
)
from cellwise.benchmark.certify.lives import MODEL, SETTLED_S, CertifiedLife, Fleet
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

SAVE_S = 600.0  # between two writes of what is kept over a restart
FEW_CELLS, EVERY = 50, 11  # odd: every second life has a fault
GAP_S = 60.0  # of samples, beyond which the power was off
OFF_H, REST_C = (1.0, 4.0), 0.01  # how long the power is lost, and the load that a rest has at most
# When, as shares of a life: in the middle of a write; for hours; and tables are updated.
RESTARTS = ((TORN, 0.25, 0.40), (RESTART, 0.50, 0.65), (UPDATED, 0.70, 0.85))


class Lived(NamedTuple):
    """What was said at each row of a life's log, shape (n,), and of the life.

    ``on`` are rows with the power on; ``restart_loss`` the largest growth of the error over a
    restart beyond the charge that flowed meanwhile; ``problem`` why it said no more.
    """

    soc: FloatArray
    std: FloatArray
    on: BoolArray
    restart_loss: float
    problem: str


def live(
    gauge: Gauge,
    life: CertifiedLife,
    seed: int,
    config: GaugeConfig | None = None,
    restarts: bool = True,
) -> Lived:
    """Run a gauge through a life; a sample of which a part is missing is not handed to it.

    Its configuration is the model's with the life's start, unless ``config`` is another.
    """
    rows = samples_of(gauge.model, life.seen, gauge.dt_s)
    records, row_sample = rows.records, rows.row_sample
    number = records["sequence"].astype(np.int64)
    handed = np.isfinite(records["current_A"]) & np.isfinite(records["voltage_V"])
    load_A = _at_samples(life.log.current_A, row_sample, records.size)
    event, on = _events(life, gauge.dt_s * (number - number[0]), load_A, seed, restarts)
    handed &= on
    samples = _handed(records[handed], number[handed], event, handed, gauge.dt_s)
    config = config or config_of(gauge.model, life.about["started_at"])
    found = gauge.run(config, samples, config_of(life.truth, config.soc0))
    last = np.maximum(np.cumsum(handed) - 1, 0)[row_sample]  # a lost sample: the answer before it
    truth = _at_samples(life.soc, row_sample, records.size)[handed]
    lost = _restart_loss(samples["event"], found.soc - truth, truth)
    return Lived(found.soc[last], found.std[last], on[row_sample], lost, found.problem)


def _events(
    life: CertifiedLife, time_s: FloatArray, load_A: FloatArray, seed: int, restarts: bool
) -> tuple[NDArray[Any], BoolArray]:
    """The event before each sample, and whether the power is on at it.

    It is off for hours in a rest; a load or a charger switches it on.
    """
    event = np.zeros(time_s.size, dtype=np.uint32)
    on = np.ones(time_s.size, dtype=np.bool_)
    event[1:][np.diff(np.floor(time_s / SAVE_S)) > 0] = SAVE
    event[1:][np.diff(time_s) > GAP_S] = RESTART  # of the log: whoever logged was off
    rng = np.random.default_rng([seed, life.about["cell"], 5])
    loaded = np.abs(load_A) > REST_C * life.truth.capacity_Ah
    for kind, low, high in RESTARTS:
        first = int(np.searchsorted(time_s, float(rng.uniform(low, high)) * time_s[-1]))
        off_s = 3600.0 * float(rng.uniform(*OFF_H))
        back = first
        if kind == RESTART:
            first += int(np.argmin(loaded[first:]))
            ends = first + int(np.argmax(np.append(loaded[first:], True)))
            back = min(ends, int(np.searchsorted(time_s, time_s[first] + off_s)))
        if restarts or kind == UPDATED:
            on[first:back] = False
            event[min(back, event.size - 1)] = kind
    return event, on


def _handed(
    records: NDArray[Any], number: NDArray[Any], event: NDArray[Any], handed: BoolArray, dt_s: float
) -> NDArray[Any]:
    """Samples as a gauge is handed them; an event waits for the next one that is not lost."""
    found = np.zeros(records.size, dtype=SAMPLE)
    for name in ("current_A", "voltage_V", "temperature_C"):
        found[name] = records[name]
    found["dt_s"] = dt_s * np.diff(number, prepend=number[0] - 1)
    at = np.minimum(np.cumsum(handed) - handed, found.size - 1)
    np.maximum.at(found["event"], at, event)
    found["dt_s"][found["event"] >= RESTART] = dt_s  # what it was off for it does not see
    return found


def _at_samples(values: FloatArray, row_sample: NDArray[Any], samples: int) -> FloatArray:
    """Values of rows at each sample: of the last row up to it."""
    row = np.searchsorted(row_sample, np.arange(samples), side="right") - 1
    return np.asarray(values[np.maximum(row, 0)])


def _restart_loss(event: NDArray[Any], error: FloatArray, truth: FloatArray) -> float:
    """Largest growth of the error over a restart, beyond what flowed since the last write."""
    flowed = np.cumsum(np.abs(np.diff(truth, prepend=truth[0])))
    saved = np.maximum.accumulate(np.where(event > 0, np.arange(event.size), 0))
    at = np.flatnonzero(event[1:] >= RESTART) + 1
    since = flowed[at] - flowed[np.maximum(saved[at - 1] - 1, 0)]
    grown = np.abs(error[at]) - np.abs(error[at - 1]) - since
    return float(np.max(np.where(np.isfinite(grown), grown, 1.0), initial=0.0))


def is_split(fleet: Fleet, number: int) -> bool:
    """Whether a life is run again without each cause: of many some, with and without faults."""
    return fleet.cells <= FEW_CELLS or number % EVERY == 0


def without_each(gauge: Gauge, fleet: Fleet, life: CertifiedLife) -> dict[str, list[float]]:
    """Squares of the error and rows of a life with one cause of the fleet made perfect in turn."""
    about, seed = life.about, fleet.seed
    lost = np.isnan(life.seen.current_A)
    worlds = {
        "start": replace(life, about={**about, "started_at": float(np.clip(life.soc[0], 0, 1))}),
        "current_sensor": _seen(life, current_A=np.where(lost, np.nan, life.log.current_A)),
        "voltage_sensor": _seen(life, voltage_V=life.log.voltage_V),
        "temperature": _seen(life, temperature_C=life.log.temperature_C),
    }
    if about["source"] == MODEL:
        new = replace(fleet.spread, faded=0.0, resistance_grown=0.0, slipped_soc=0.0)
        worlds["age"] = replace(fleet, spread=new).life(
            gauge.model, MODEL, about["cell"], gauge.dt_s
        )
    model, truth = (config_of(cell, about["started_at"]) for cell in (gauge.model, life.truth))
    cells = {
        "table": model._replace(ocv_V=truth.ocv_V, soc=truth.soc),
        "capacity": model._replace(capacity_Ah=truth.capacity_Ah),
        "resistance": model._replace(r0_ohm=truth.r0_ohm),
    }
    found = {name: _squares(one, live(gauge, one, seed)) for name, one in worlds.items()}
    found |= {name: _squares(life, live(gauge, life, seed, cell)) for name, cell in cells.items()}
    return {**found, "restart": _squares(life, live(gauge, life, seed, restarts=False))}


def _seen(life: CertifiedLife, **channel: FloatArray | None) -> CertifiedLife:
    seen: CellLog = replace(life.seen, **channel)  # type: ignore[arg-type]
    return replace(life, seen=seen)


def _squares(life: CertifiedLife, said: Lived) -> list[float]:
    scored = scored_rows(life) & said.on
    error = np.where(np.isfinite(said.soc), said.soc - life.soc, 1.0)[scored]
    return [float(np.sum(error**2)), int(scored.sum())]


def scored_rows(life: CertifiedLife) -> BoolArray:
    """Rows after the first hour whose SOC is known."""
    time_s = life.log.time_s
    return np.asarray((time_s - time_s[0] >= SETTLED_S) & np.isfinite(life.soc))


def fleet_causes(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What each cause of the fleet costs, in points of SOC error (RMS), the largest first."""
    rows = [row for row in rows if "without" in row]
    names = dict.fromkeys(name for row in rows for name in row["without"])
    found = []
    for name in names:
        having = [row for row in rows if name in row["without"]]
        base = _rms((row["squares"], row["rows"]) for row in having)
        left = _rms(row["without"][name] for row in having)
        found.append({"name": name, "points": base - left})
    return sorted(found, key=lambda cause: -cause["points"])


def _rms(parts: Iterable[Sequence[float]]) -> float:
    squares, rows = np.sum(np.array([tuple(part) for part in parts], dtype=np.float64), axis=0)
    return math.sqrt(squares / max(rows, 1.0))
