"""A123 26650 (LFP): identified on drives at 35 and 45 degC, judged on the one at 25 degC."""

from __future__ import annotations

from pathlib import Path

from benchmarks.accuracy.judging import POINTS_OFF, from_the_middle, judge_soc, voltage_rmse_mV
from benchmarks.figures import Figure, Progress
from benchmarks.measured_data import measured_log
from cellwise import IdentifySettings, TestLogs, identify_cell
from cellwise.logs import CellLog

CELL = "plett_a123"
NOMINAL_AH = 2.3
REFERENCE_AH = 2.0725
FROM_FULL = 1.0
AFTER_S = 1800.0
HELD_OUT = "dyn_p25_s1"
DRIVES = ("dyn_p35_s1", "dyn_p45_s1")


def a123_figures(data: Path, say: Progress) -> list[Figure]:
    """SOC from the right start, from 30 points off, and from the middle of the plateau."""

    def log(name: str) -> CellLog:
        return measured_log(data, f"{CELL}/{name}")

    say("A123: identified on low rate and two drives")
    found = identify_cell(
        TestLogs(
            ocv=tuple(log(f"ocv_p25_s{k}") for k in (1, 2, 3, 4)),
            drive=tuple((log(name), None) for name in DRIVES),
        ),
        IdentifySettings(nominal_Ah=NOMINAL_AH, name="A123 26650", chemistry="LFP"),
    )
    model, drive = found.model, log(HELD_OUT)
    group = f"A123 25 degC, {HELD_OUT}, identified on ocv_p25_s1..s4 and {', '.join(DRIVES)}"
    right, wrong = (
        judge_soc(
            model,
            drive,
            start=start,
            true_start=FROM_FULL,
            reference_Ah=REFERENCE_AH,
            after_s=AFTER_S,
        )
        for start in (FROM_FULL, FROM_FULL - POINTS_OFF)
    )
    figures = [
        Figure(
            group,
            "EKF from the right start: SOC RMSE",
            100 * right.rmse,
            "%",
            target=2.0,
            note=f"2-sigma band covers {100 * right.coverage:.0f} % of rows",
        ),
        Figure(
            group,
            "EKF from 70 % at full: SOC RMSE after 30 min",
            100 * wrong.late_rmse,
            "%",
            target=3.0,
            note=f"2-sigma band covers {100 * wrong.coverage:.0f} % of rows",
        ),
        Figure(
            group, "voltage RMSE above 10 % SOC", voltage_rmse_mV(model, drive, FROM_FULL), "mV"
        ),
    ]
    part, true_soc = from_the_middle(drive, FROM_FULL, REFERENCE_AH)
    for off in (-POINTS_OFF, POINTS_OFF):
        found = judge_soc(
            model,
            part,
            start=true_soc + off,
            true_start=true_soc,
            reference_Ah=REFERENCE_AH,
            after_s=AFTER_S,
        )
        figures.append(
            Figure(
                group,
                f"EKF from {100 * found.start:.0f} % at {100 * true_soc:.0f} %: SOC RMSE after "
                "30 min",
                100 * found.late_rmse,
                "%",
                note="on the plateau of LFP the voltage hardly depends on SOC; "
                f"2-sigma band covers {100 * found.coverage:.0f} % of rows",
            )
        )
    return figures
