"""Filters on cells made by PyBaMM: cut in the middle, under load, 30 points wrong.

python -m benchmarks.physics_laboratory.filter_runs FOLDER [--seed 1 --cells all]
    [--estimators ekf,ukf,adaptive]

The truth is what PyBaMM counted. A model of laboratory tests alone and one with two drives; three
random drives and four uses of another kind that no fit has seen. What is made stays in FOLDER, and
is read from there without PyBaMM.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.physics_laboratory.published_cells import PublishedCell, cells_for
from cellwise import IdentifySettings, TestLogs, identify_cell, read_model, write_log, write_model
from cellwise.cell.model import CellModel
from cellwise.estimate.estimators import make_estimator
from cellwise.logs import CellLog, read_log
from cellwise.typing import FloatArray

FITTED, FRESH = 2, 3
# Where of a log's way along the SOC it is cut, and how far off the filter begins.
STARTS = ((0.33, -0.3), (0.5, 0.3))
LOADED_C = 0.2
LEAST_ROWS = 900  # a drive that the cell's limits end early says little after its first quarter
MODELS = ("laboratory", "drives")


@dataclass(frozen=True)
class Run:
    """One filter from one start, in points of SOC; ``inside`` a share of the rows."""

    cell: str
    model: str
    estimator: str
    use: str
    rmse: float
    inside: float
    sigma: float


def main(arguments: list[str] | None = None) -> int:
    """Make what is not there, run the filters, print a table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.physics_laboratory.filter_runs",
        description=__doc__.splitlines()[0],
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cells", default="all", help="development, validation or all")
    parser.add_argument("--estimators", default="ekf,ukf,adaptive")
    chosen = parser.parse_args(arguments)
    cells = cells_for(chosen.cells)
    if not cells:
        parser.error(f"--cells {chosen.cells}: development, validation or all")
    runs: list[Run] = []
    for cell in cells:
        place = chosen.folder / f"{cell.name}_{chosen.seed}"
        if not (place / "made").exists():
            print(f"making {place.name}", file=sys.stderr, flush=True)
            make(cell, place, chosen.seed)
        for estimator in chosen.estimators.split(","):
            runs += runs_of(cell.name, place, estimator)
    print(report(runs))
    return 0


def make(cell: PublishedCell, place: Path, seed: int) -> None:
    """Logs of one cell, and the two models of it."""
    from benchmarks.physics_laboratory.cases import laboratory_drives
    from benchmarks.physics_laboratory.cell_physics import capacity_Ah
    from benchmarks.physics_laboratory.virtual_laboratory import hppc_log, low_rate_log

    place.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, *cell.name.encode()])
    hppc, low = hppc_log(cell, rng), low_rate_log(cell, rng)
    fitted = laboratory_drives(cell, rng, FITTED)
    logs = laboratory_drives(cell, rng, FRESH) + list(other_uses(cell, rng))
    q = capacity_Ah(cell)
    settings = IdentifySettings(nominal_Ah=q, temperature_C=25.0, name=cell.name)
    for name, drives in zip(MODELS, ([], fitted), strict=True):
        tests = TestLogs(hppc=((hppc, 25.0),), ocv=(low,), drive=tuple((d, 25.0) for d in drives))
        write_model(identify_cell(tests, settings).model, place / f"{name}.json")
    for log in logs:
        write_log(with_counter(log), place / f"{log.name.replace(' ', '_')}.parquet")
    begins = [log.soc0 for log in logs]
    np.savez(place / "truth.npz", names=[g.name for g in logs], soc0=begins, capacity_Ah=q)
    (place / "made").touch()


def other_uses(cell: PublishedCell, rng: np.random.Generator) -> Iterator[CellLog]:
    """A steady discharge, a steady charge, a flight and a city's stop and go."""
    from benchmarks.physics_laboratory.cases import Drive, healthy_log
    from benchmarks.physics_laboratory.cell_physics import capacity_Ah

    q = capacity_Ah(cell)
    most = cell.largest_C * q
    flown = np.arange(0.0, 3600.0 * 0.62 / (0.6 * cell.largest_C))
    hover = 1.0 + 0.25 * np.sign(np.sin(2.0 * np.pi * flown / 47.0))
    gusts = 0.1 * rng.standard_normal(flown.size)
    held = np.repeat(rng.uniform(-0.35, 0.9, 361) * (rng.random(361) < 0.6), 20)[:7200]
    mean_A = 0.65 * q / 2.0  # from 88 to 23 % in two hours
    city = held * mean_A / max(float(held.mean()), 0.05)
    uses = {
        "discharge": (np.full(5000, 0.5 * q), 0.90),
        "charge": (np.full(7000, -q / 3.0), 0.15),
        "flight": (np.clip(0.6 * most * (hover + gusts), 0.0, most), 0.92),
        "city": (np.clip(city, -0.5 * most, most), 0.88),
    }
    for name, (current, soc0) in uses.items():
        current[0] = 0.0
        drive = Drive(np.arange(float(current.size)), current, soc0)
        yield healthy_log(cell, drive, rng, name)


def with_counter(log: CellLog) -> CellLog:
    """The log with what flowed, to the noise of the current [Ah]."""
    moved = np.concatenate(([0.0], np.cumsum(log.current_A[1:] * np.diff(log.time_s))))
    return replace(log, charge_Ah=moved / 3600.0)


def runs_of(cell: str, place: Path, estimator: str) -> list[Run]:
    """One estimator over all logs of a cell, from both starts, with both models."""
    truth = np.load(place / "truth.npz")
    models = {name: read_model(place / f"{name}.json") for name in MODELS}
    found = []
    for name, soc0 in zip(truth["names"], truth["soc0"], strict=True):
        log = read_log(place / f"{str(name).replace(' ', '_')}.parquet")
        if len(log) < LEAST_ROWS or log.charge_Ah is None:
            continue
        soc = float(soc0) - log.charge_Ah / float(truth["capacity_Ah"])
        for kind, model in models.items():
            for way, wrong in STARTS:
                figures = from_the_middle(model, log, soc, estimator, way, wrong)
                found.append(Run(cell, kind, estimator, str(name), *figures))
    return found


def from_the_middle(
    model: CellModel, log: CellLog, soc: FloatArray, estimator: str, way: float, wrong: float
) -> tuple[float, float, float]:
    """RMSE after the first quarter, share inside two sigma, mean sigma after the first quarter."""
    begin = int(np.argmax(np.abs(soc - soc[0]) >= way * abs(soc[-1] - soc[0])))
    begin += int(np.argmax(np.abs(log.current_A[begin:]) > LOADED_C * model.capacity_Ah))
    part, truth = log.part(begin, len(log)), soc[begin:]
    trace = make_estimator(estimator, model).run(
        part, float(np.clip(truth[0] + wrong, 0.0, 1.0)), 0.15
    )
    error = trace.soc - truth
    late = slice(error.size // 4, None)
    inside = float(np.mean(np.abs(error) < 2.0 * trace.soc_std))
    rmse = float(np.sqrt(np.mean(error[late] ** 2)))
    return 100.0 * rmse, inside, 100.0 * float(np.mean(trace.soc_std[late]))


def report(runs: list[Run]) -> str:
    """Means by cell, model and estimator; then over the cells; then what is held worst."""
    lines = [
        f"{'cell':14}{'model':12}{'filter':10}{'RMSE':>7}{'worst':>7}{'inside':>8}{'sigma':>7}"
    ]
    groups: dict[tuple[str, str, str], list[Run]] = {}
    for run in runs:
        groups.setdefault((run.cell, run.model, run.estimator), []).append(run)
        groups.setdefault(("all", run.model, run.estimator), []).append(run)
    for (cell, model, estimator), some in sorted(groups.items(), key=lambda g: g[0][0] == "all"):
        rmse, inside, sigma = np.mean([(r.rmse, r.inside, r.sigma) for r in some], axis=0)
        worst = max(r.rmse for r in some)
        figures = f"{rmse:7.2f}{worst:7.2f}{100 * inside:7.1f}%{sigma:7.2f}"
        lines.append(f"{cell:14}{model:12}{estimator:10}{figures}")
    lines.append("inside in less than half of the rows:")
    for r in sorted(runs, key=lambda r: r.inside):
        if r.inside < 0.5:
            lines.append(
                f"  {r.cell} {r.model} {r.estimator} {r.use}: {100 * r.inside:.0f} %, "
                f"RMSE {r.rmse:.1f}, sigma {r.sigma:.1f} points"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
