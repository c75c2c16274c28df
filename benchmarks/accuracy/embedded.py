"""The embedded NMC cell, for whoever has no measured data: a physics model, no targets."""

from __future__ import annotations

from pathlib import Path

from benchmarks.accuracy.judging import POINTS_OFF, judge_soc, voltage_rmse_mV
from benchmarks.figures import Figure, Progress
from benchmarks.measured_data import REPOSITORY
from cellwise import IdentifySettings, TestLogs, identify_cell
from cellwise.logs import CellLog, read_log

NOMINAL_AH = 5.0
REFERENCE_AH = 5.1532  # true_capacity_Ah in the catalogue
TRUE_START = 0.99701  # initial_soc there
HELD_OUT = ("drive_b", "drive_c")


def embedded_figures(say: Progress) -> list[Figure]:
    """Identified with one drive, and without; judged on two others."""
    folder = REPOSITORY / "datasets" / "nmc"
    laboratory = {
        "hppc": ((_log(folder, "hppc"), None),),
        "ocv": (_log(folder, "ocv_c20"),),
        "capacity": tuple(_log(folder, f"cap_{rate}") for rate in ("c20", "c5", "c3")),
    }
    settings = IdentifySettings(nominal_Ah=NOMINAL_AH, name="embedded NMC")
    figures = []
    for group, drive in (
        (
            "Embedded NMC (physics model), laboratory tests + drive_a",
            ((_log(folder, "drive_a"), None),),
        ),
        ("Embedded NMC (physics model), laboratory tests alone", ()),
    ):
        say(group)
        model = identify_cell(TestLogs(**laboratory, drive=drive), settings).model
        for name in HELD_OUT:
            log = _log(folder, name)
            found = judge_soc(
                model,
                log,
                start=TRUE_START - POINTS_OFF,
                true_start=TRUE_START,
                reference_Ah=REFERENCE_AH,
                after_s=300.0,
            )
            figures += [
                Figure(
                    group,
                    f"voltage RMSE above 10 % SOC, {name}",
                    voltage_rmse_mV(model, log, TRUE_START),
                    "mV",
                ),
                Figure(
                    group,
                    f"EKF from 70 % at full: SOC RMSE after 300 s, {name}",
                    100 * found.late_rmse,
                    "%",
                    note=f"2-sigma band covers {100 * found.coverage:.0f} % of rows",
                ),
            ]
    return figures


def _log(folder: Path, name: str) -> CellLog:
    return read_log(folder / f"{name}.parquet")
