"""SOC of the fixed step against the float64 EKF on every Panasonic drive, at 0.1 s and 1 s."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.accuracy.panasonic import CELL, TAGS, panasonic_tests
from benchmarks.figures import Figure, Progress
from benchmarks.measured_data import measured_log
from cellwise import CellTests, IdentifySettings, identify_cell
from cellwise.cell.model import CellModel
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.fit.start import initial_soc
from cellwise.logs import CellLog
from cellwise.logs.cell_log import resample

STEPS_S = (0.1, 1.0)
TARGET_POINTS = 0.05
TAG = slice(6, 9)  # of drive_p25_...: a temperature, the one that a drive which warms up begins at


def agreement_figures(data: Path, say: Progress) -> list[Figure]:
    """Every drive with the model of its temperature and with that of all, started as found.

    The filter is the numba one; C gives the same bits.
    """
    settings = IdentifySettings(nominal_Ah=2.9, name="Panasonic 18650PF")
    tests = {tag: panasonic_tests(data, tag) for tag in TAGS.values()}
    models = {}
    for tag in tests:
        say(f"fixed step: model of {tag}")
        models[tag] = identify_cell(tests[tag], settings).model
    say("fixed step: one model of all temperatures")
    together = CellTests(
        hppc=tuple(log for t in tests.values() for log in t.hppc),
        ocv=tests["p25"].ocv,
        capacity=tests["p25"].capacity,
        drive=tuple(log for t in tests.values() for log in t.drive),
    )
    models["all"] = identify_cell(together, settings).model
    figures = []
    for path in sorted((data / CELL).glob("drive_*.csv.gz")):
        name = path.name.removesuffix(".csv.gz")
        say(name)
        log = measured_log(data, f"{CELL}/{name}")
        for dt_s in STEPS_S:
            figures.append(_figure(name, resample(log, dt_s), dt_s, models))
    return figures


def _figure(name: str, log: CellLog, dt_s: float, models: dict[str, CellModel]) -> Figure:
    own, one = (apart(models[key], log, dt_s) for key in (name[TAG], "all"))
    return Figure(
        f"Fixed step of {dt_s:g} s: SOC apart from the float64 EKF's, RMSE",
        name,
        max(own, one),
        "points",
        target=TARGET_POINTS,
        note=f"model of {name[TAG]} {own:.4f}, of all {one:.4f}; {len(log):,} samples",
    )


def apart(model: CellModel, log: CellLog, dt_s: float) -> float:
    """RMSE between both filters' SOC [points], on a log at an even time step."""
    start = initial_soc(model, log)
    ours = FixedStep(model, dt_s=dt_s).run(log, start.soc, start.std).soc
    theirs = Ekf(model).run(log, start.soc, start.std).soc
    return 100 * float(np.sqrt(np.mean((ours - theirs) ** 2)))
