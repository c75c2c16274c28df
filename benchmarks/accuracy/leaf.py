"""Nissan Leaf cell: identified at 25 degC on pulses and 1C, judged on 2C and 3C discharges."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.figures import Figure, Progress
from benchmarks.measured_data import measured_log
from cellwise import CellTests, IdentifySettings, identify_cell
from cellwise.cell.metrics import error_metrics
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.fit.start import initial_soc
from cellwise.identify.hppc.phases import find_phases
from cellwise.logs import CellLog

CELL = "nissan_leaf"
NOMINAL_AH = 33.1
TARGET_MV = 30.0
WHOLE_DISCHARGE = 0.5  # of the capacity


def leaf_figures(data: Path, say: Progress) -> list[Figure]:
    """Every discharge round by itself, then the whole log with its recharges."""
    say("Leaf: identified on HPPC and 1C")
    found = identify_cell(
        CellTests(
            hppc=((measured_log(data, f"{CELL}/hppc_p25"), None),),
            capacity=(measured_log(data, f"{CELL}/cap_1c_p23"),),
        ),
        IdentifySettings(nominal_Ah=NOMINAL_AH, name="Leaf"),
    )
    figures = []
    for rate, target in (("2c", TARGET_MV), ("3c", None)):
        figures += _rounds(found.model, measured_log(data, f"{CELL}/cap_{rate}_p23"), rate, target)
    return figures


def _rounds(model: CellModel, log: CellLog, rate: str, target: float | None) -> list[Figure]:
    group = f"Leaf, {rate.upper()} discharges, identified on hppc_p25 and cap_1c_p23"
    start = initial_soc(model, log)
    simulated = simulate(model, log, start.soc)
    error, above = simulated.residual_V, simulated.soc > 0.1
    figures = []
    rounds = [
        p
        for p in find_phases(log)
        if p.kind == "cc" and p.charge_Ah > WHOLE_DISCHARGE * model.capacity_Ah
    ]
    for number, phase in enumerate(rounds, start=1):
        rows = np.zeros(len(log), dtype=np.bool_)
        rows[phase.start : phase.stop] = True
        rmse = error_metrics(error[rows & above]).rmse_V
        figures.append(
            Figure(
                group,
                f"voltage RMSE above 10 % SOC, round {number}",
                1e3 * rmse,
                "mV",
                target=target,
            )
        )
    whole = Figure(
        group,
        "voltage RMSE above 10 % SOC, whole log",
        1e3 * simulated.rmse_above_10pct_V,
        "mV",
        target=target,
        headline=target is not None,
        note=f"initial SOC {start.soc:.3f} by {start.how}; "
        f"over all SOC {1e3 * simulated.rmse_V:.1f} mV",
    )
    return [*figures, whole]
