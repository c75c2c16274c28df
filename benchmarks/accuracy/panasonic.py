"""Panasonic 18650PF at 25 degC: identified with and without drives, judged on other drives."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.accuracy.judging import POINTS_OFF, from_the_middle, judge_soc, voltage_rmse_mV
from benchmarks.figures import Figure, Progress
from benchmarks.measured_data import measured_log
from benchmarks.parts import each_case
from cellwise import CellTests, IdentifySettings, identify_cell
from cellwise.cell.model import CellModel
from cellwise.logs import CellLog

CELL = "panasonic_18650pf"
TAGS = {25.0: "p25", 10.0: "p10", 0.0: "p00", -10.0: "n10", -20.0: "n20"}
NOMINAL_AH = 2.9
SETTINGS = IdentifySettings(nominal_Ah=NOMINAL_AH, name="Panasonic 18650PF")
REFERENCE_AH = 2.997
HELD_OUT = ("us06", "hwfta", "nn", "cycle_4")
FROM_FULL = 1.0
AFTER_S = 300.0


def panasonic_figures(data: Path, say: Progress) -> list[Figure]:
    """Both identifications, four held-out drives each."""
    driven, plain = (
        f"Panasonic 25 degC, laboratory tests {more}" for more in ("+ drives cycle 2, 3", "alone")
    )
    cases = ((driven, partial(_driven, data, driven)), (plain, partial(_plain, data, plain)))
    return each_case(cases, say)


def _driven(data: Path, group: str) -> list[Figure]:
    model = identify_cell(panasonic_tests(data), SETTINGS).model
    held_out = _held_out(data)
    voltage = _voltage(group, model, held_out, each=18.0, mean=12.0)
    return voltage + _soc(group, model, held_out, after=0.6)


def _plain(data: Path, group: str) -> list[Figure]:
    model = identify_cell(replace(panasonic_tests(data), drive=()), SETTINGS).model
    held_out = _held_out(data)
    voltage = _voltage(group, model, held_out, each=25.0, mean=None)
    return voltage + _soc(group, model, held_out, after=1.2)


def _held_out(data: Path) -> list[CellLog]:
    return [measured_log(data, f"{CELL}/drive_p25_{name}") for name in HELD_OUT]


def panasonic_tests(data: Path, tag: str = "p25") -> CellTests:
    """Laboratory tests and two drives of one temperature, which began full (its README)."""

    def log(name: str) -> CellLog:
        return measured_log(data, f"{CELL}/{name}")

    warm = None if tag == "p25" else {name: t for t, name in TAGS.items()}[tag]
    cycles = (2, 3) if tag == "p25" else (1, 2)  # there is no cycle 1 at 25 degC
    drives = (replace(log(f"drive_{tag}_cycle_{k}"), soc0=1.0) for k in cycles)
    return CellTests(
        hppc=((log(f"hppc_{tag}"), warm),),
        ocv=(log("ocv_c20_p25"),),
        capacity=(log("cap_1c_p25_start_1"), log("cap_1c_p25_start_2")),
        drive=tuple((one, warm) for one in drives),
    )


def _voltage(
    group: str, model: CellModel, logs: list[CellLog], *, each: float, mean: float | None
) -> list[Figure]:
    values = [voltage_rmse_mV(model, log, FROM_FULL) for log in logs]
    figures = [
        Figure(group, f"voltage RMSE above 10 % SOC, {log.name}", value, "mV", target=each)
        for log, value in zip(logs, values, strict=True)
    ]
    average = float(np.mean(values))
    return [
        *figures,
        Figure(
            group, "voltage RMSE above 10 % SOC, mean", average, "mV", target=mean, headline=True
        ),
    ]


def _soc(group: str, model: CellModel, logs: list[CellLog], *, after: float) -> list[Figure]:
    """From 30 points wrong: at full, where the target is set, and in the middle."""
    figures = []
    for log in logs:
        found = judge_soc(
            model,
            log,
            start=FROM_FULL - POINTS_OFF,
            true_start=FROM_FULL,
            reference_Ah=REFERENCE_AH,
            after_s=AFTER_S,
        )
        figures += [
            Figure(
                group,
                f"EKF from 70 % at full: time to within 2 %, {log.name}",
                found.convergence_s,
                "s",
                target=AFTER_S,
                note="" if found.convergence_s is not None else "never for ten minutes",
            ),
            Figure(
                group,
                f"EKF from 70 % at full: SOC RMSE after 300 s, {log.name}",
                100 * found.late_rmse,
                "%",
                target=after,
                note=f"2-sigma band covers {100 * found.coverage:.0f} % of rows",
            ),
        ]
        figures.append(_from_middle(group, model, log))
    return figures


def _from_middle(group: str, model: CellModel, log: CellLog) -> Figure:
    part, true_soc = from_the_middle(log, FROM_FULL, REFERENCE_AH)
    found = [
        judge_soc(
            model,
            part,
            start=true_soc + off,
            true_start=true_soc,
            reference_Ah=REFERENCE_AH,
            after_s=AFTER_S,
        )
        for off in (-POINTS_OFF, POINTS_OFF)
    ]
    worst = max(found, key=lambda t: t.late_rmse)
    times = ", ".join(
        "never" if t.convergence_s is None else f"{t.convergence_s:.0f} s" for t in found
    )
    return Figure(
        group,
        f"EKF 30 points off at 60 %: SOC RMSE after 300 s, {log.name}",
        100 * worst.late_rmse,
        "%",
        note=f"the worse of 30 % and 90 %; within 2 % after {times}",
    )
