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
    UPDATED,
    Gauge,
    GaugeConfig,
    config_of,
)
from cellwise.benchmark.certify.lives import MODEL, SETTLED_S, CertifiedLife, Fleet
from cellwise.benchmark.certify.restarts import REST_C, power_events, restart_loss
from cellwise.estimate.fixed.fixed_step import Samples, samples_of
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

FEW_CELLS, EVERY = 50, 11  # odd: every second life has a fault


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
    event, on, truth = life_events(life, rows, gauge.dt_s, seed, restarts)
    handed = np.isfinite(records["current_A"]) & np.isfinite(records["voltage_V"]) & on
    number = records["sequence"].astype(np.int64)
    samples = _handed(records[handed], number[handed], event, handed, gauge.dt_s)
    config = config or config_of(gauge.model, life.about["started_at"])
    found = gauge.run(config, samples, config_of(life.truth, config.soc0))
    last = np.maximum(np.cumsum(handed) - 1, 0)[row_sample]  # a lost sample: the answer before it
    written = np.isin(samples["event"], (SAVE, UPDATED))
    lost = restart_loss(samples["event"], written, found.soc - truth[handed], truth[handed])
    return Lived(found.soc[last], found.std[last], on[row_sample], lost, found.problem)


def life_events(
    life: CertifiedLife, rows: Samples, dt_s: float, seed: int, restarts: bool = True
) -> tuple[NDArray[Any], BoolArray, FloatArray]:
    """`power_events` at the samples of a life, and its true SOC there, each of shape (n,)."""
    number = rows.records["sequence"].astype(np.int64)
    at = np.searchsorted(rows.row_sample, np.arange(number.size), side="right") - 1
    row = np.maximum(at, 0)  # the last one up to each sample
    loaded = np.abs(life.log.current_A[row]) > REST_C * life.truth.capacity_Ah
    rng = np.random.default_rng([seed, life.about["cell"], 5])
    event, on = power_events(dt_s * (number - number[0]), loaded, rng, restarts)
    return event, on, life.soc[row]


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
