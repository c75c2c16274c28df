"""Cold and warm: Panasonic identified at each temperature by itself, and at all of them.

Of HPPC and drives cycle 1 and 2 of a temperature; judged on US06, HWFET, UDDS, LA92, NN of that
temperature, 30 points wrong from full.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.accuracy.judging import POINTS_OFF
from benchmarks.figures import Figure, Progress
from benchmarks.measured_data import measured_log
from cellwise import IdentifySettings, TestLogs, identify_cell
from cellwise.cell.model import CellModel
from cellwise.estimate.replay import Replay, replay
from cellwise.logs import CellLog

PANASONIC = "panasonic_18650pf"
PANASONIC_AH = 2.997  # C/20 between the campaigns; the cell ages over them
TARGETS = {25.0: 0.4, 10.0: 0.6, 0.0: 1.0, -10.0: 1.3, -20.0: 1.8}
TAGS = {25.0: "p25", 10.0: "p10", 0.0: "p00", -10.0: "n10", -20.0: "n20"}
CYCLES = ("us06", "hwfet", "hwfta", "udds", "la92", "nn")
LOST_BY_ONE_MODEL = 0.3


def cold_figures(data: Path, say: Progress) -> list[Figure]:
    """One model of each temperature, one of all."""
    figures: list[Figure] = []
    tests = {t: panasonic_tests(data, tag, t) for t, tag in TAGS.items()}
    held_out = {t: _held_out(data, tag) for t, tag in TAGS.items()}
    settled: dict[float, float] = {}
    settings = IdentifySettings(nominal_Ah=2.9, name="Panasonic 18650PF")
    for temperature, target in TARGETS.items():
        say(f"Panasonic {temperature:.0f} degC")
        model = identify_cell(tests[temperature], settings).model
        group = f"Panasonic {temperature:.0f} degC, identified there; 70 % stated at full"
        found = _cycles(group, model, held_out[temperature], target)
        settled[temperature] = float(np.mean([f.value for f in found if f.value is not None]))
        figures += [*found, Figure(group, "EKF settled SOC RMSE, mean", settled[temperature], "%",
                                   target=target)]  # fmt: skip
        ukf = [_judge(model, log, "ukf") for log in held_out[temperature]]
        figures.append(
            Figure(
                group,
                "UKF settled SOC RMSE, mean",
                _mean_settled(ukf),
                "%",
                note=_settled_note(ukf),
            )
        )
    say("Panasonic: one model")
    together = TestLogs(
        hppc=tuple(log for t in tests.values() for log in t.hppc),
        ocv=tests[25.0].ocv,
        capacity=tests[25.0].capacity,
        drive=tuple(log for t in tests.values() for log in t.drive),
    )
    model = identify_cell(together, settings).model
    for temperature in TARGETS:
        runs = [_judge(model, log, "ekf") for log in held_out[temperature]]
        figures.append(
            Figure(
                "Panasonic, one model of all temperatures",
                f"EKF settled SOC RMSE, mean at {temperature:.0f} degC",
                _mean_settled(runs),
                "%",
                target=settled[temperature] + LOST_BY_ONE_MODEL,
                note=_settled_note(runs),
            )
        )
    return figures


def panasonic_tests(data: Path, tag: str, temperature_C: float) -> TestLogs:
    """What the cell of one temperature is identified from."""

    def log(name: str) -> CellLog:
        return measured_log(data, f"{PANASONIC}/{name}")

    cycles = (2, 3) if tag == "p25" else (1, 2)  # there is no cycle 1 at 25 degC
    return TestLogs(
        hppc=((log(f"hppc_{tag}"), temperature_C),),
        ocv=(log("ocv_c20_p25"),),
        capacity=(log("cap_1c_p25_start_1"), log("cap_1c_p25_start_2")),
        # They began full (README of the cell), in the midst of their load: unstated, the first
        # minute does not separate full from half in the cold, and they are left out.
        drive=tuple(
            (replace(log(f"drive_{tag}_cycle_{k}"), soc0=1.0), temperature_C) for k in cycles
        ),
    )


def _held_out(data: Path, tag: str) -> list[CellLog]:
    found = []
    for name in CYCLES:
        if (data / PANASONIC / f"drive_{tag}_{name}.csv.gz").exists():
            found.append(measured_log(data, f"{PANASONIC}/drive_{tag}_{name}"))
    return found


def _cycles(group: str, model: CellModel, logs: list[CellLog], target: float) -> list[Figure]:
    figures = []
    for log in logs:
        run = _judge(model, log, "ekf")
        figures.append(
            Figure(
                group,
                f"EKF settled SOC RMSE, {log.name}",
                _mean_settled([run]),
                "%",
                target=2.0 * target,
                note=_settled_note([run]),
            )
        )
    return figures


def _judge(model: CellModel, log: CellLog, estimator: str) -> Replay:
    return replay(
        model,
        log,
        estimator,
        soc0=1.0 - POINTS_OFF,
        reference_soc0=1.0,
        reference_capacity_Ah=PANASONIC_AH,
    )


def _mean_settled(runs: list[Replay]) -> float:
    return 100 * float(np.mean([r.settled.rmse for r in runs if r.settled is not None]))


def _settled_note(runs: list[Replay]) -> str:
    late = [r.convergence_s for r in runs]
    within = "never" if None in late else f"{max(t for t in late if t is not None):.0f} s"
    covered = np.mean([r.coverage_2sigma for r in runs if r.coverage_2sigma is not None])
    nis = np.mean([r.nis_mean for r in runs if r.nis_mean is not None])
    return f"within 2 % after {within}; 2-sigma band covers {100 * covered:.0f} %; NIS {nis:.2f}"
