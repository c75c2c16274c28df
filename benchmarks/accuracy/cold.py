"""Panasonic 18650PF, one model of five temperatures, from a start that is 30 points wrong.

Drives that took no part in the fit, cut under load in the middle of the SOC: nothing tells a filter
that the cell was full. Beside the EKF stand the fixed step, whose C is equal bit for bit, and an
EKF as filterpy's users write it, with the same model and noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.ablation.panel import (
    COLD_AH,
    PANASONIC,
    PANASONIC_AH,
    WARM_C,
    Case,
    from_middle,
    named,
    of_all_temperatures,
)
from benchmarks.ablation.run import Result, result_of
from benchmarks.accuracy.judging import voltage_rmse_mV
from benchmarks.figures import Figure, Progress
from benchmarks.parts import each_case
from cellwise.cell.model import CellModel
from cellwise.estimate.estimators import make_estimator

WARM_DRIVES, DRIVES = ("nn", "hwfta"), ("nn", "la92")  # at 25 degC; colder
COLD = ("n10", "n20")  # the cell had aged by an unknown part when it was driven there
VOLTAGE_MV = {25.0: 10.0, 10.0: 12.0, 0.0: 18.0, -10.0: 22.0, -20.0: 35.0}
SOC_PERCENT = {25.0: 0.5, 10.0: 1.0, 0.0: 1.8, -10.0: 3.5, -20.0: 5.0}
OURS, PLAIN = {"ekf": "EKF", "fixed-step": "fixed step and its C"}, "filterpy-ekf"


def cases_at(data: Path, model: CellModel, tag: str) -> Iterator[Case]:
    """Two drives of one temperature that are not in the fit, from two places each."""
    capacities = COLD_AH if tag in COLD else (PANASONIC_AH,)
    for name in WARM_DRIVES if tag == "p25" else DRIVES:
        log = named(data, PANASONIC, f"drive_{tag}_{name}")
        yield from from_middle(f"Panasonic {tag}", model, log, capacities)


def judged(case: Case, name: str) -> Result:
    """One estimator over one case."""
    return result_of(
        case, name, make_estimator(name, case.model).run(case.log, case.soc0, case.std)
    )


def cold_figures(data: Path, say: Progress) -> list[Figure]:
    """Voltage of drives left out, and the SOC from the middle, by temperature."""
    say("Panasonic, five temperatures: one model")
    model = of_all_temperatures(data)
    cases = (
        (f"Panasonic {warm:.0f} degC, one model of five temperatures, drives left out", tag)
        for tag, warm in WARM_C.items()
    )
    return each_case(((g, partial(_at_temperature, data, model, g, tag)) for g, tag in cases), say)


def _at_temperature(data: Path, model: CellModel, group: str, tag: str) -> list[Figure]:
    """One temperature, by every estimator."""
    warm = WARM_C[tag]
    voltage = voltage_rmse_mV(model, named(data, PANASONIC, f"drive_{tag}_nn"), 1.0)
    figures = [
        Figure(group, "voltage RMSE above 10 % SOC, NN", voltage, "mV",
               target=VOLTAGE_MV[warm], headline=True)
    ]  # fmt: skip
    cases = list(cases_at(data, model, tag))
    for name, called in OURS.items():
        runs = [judged(case, name) for case in cases]
        figures += _ours(group, called, runs, SOC_PERCENT[warm])
    plain = [judged(case, PLAIN) for case in cases]
    return [*figures, _rmse(group, "plain EKF (filterpy)", plain, None)]


def _ours(group: str, called: str, runs: list[Result], most: float) -> list[Figure]:
    inside = float(np.mean([run.inside for run in runs]))
    return [
        _rmse(group, called, runs, most),
        Figure(group, f"{called}: rows inside two deviations", inside, "%", target=93.0,
               at_least=True),
    ]  # fmt: skip


def _rmse(group: str, called: str, runs: list[Result], most: float | None) -> Figure:
    mean = {
        name: float(np.mean([getattr(run, name) for run in runs]))
        for name in ("rmse", "sigma", "inside")
    }
    return Figure(
        group,
        f"{called}, under load in the middle, 30 points wrong: SOC RMSE",
        mean["rmse"],
        "%",
        target=most,
        note=f"{mean['inside']:.0f} % of the rows inside two deviations, "
        f"{mean['sigma']:.1f} % stated",
        headline=True,
    )
