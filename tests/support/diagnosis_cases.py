"""A diagnosis with every record filled, for its page; drives that an odd sensor logged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.cell.model_file import write_model
from cellwise.cell.simulate import simulate
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.residual import residual_analysis
from cellwise.diagnose.result import Diagnosis, FoundCause, LogRun, TriedCause
from cellwise.logs import write_log
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

CELL = replace(curved_cell(), name="cell <b>&amp;</b>")
OFFSET_A = 0.098
VALUES = {
    "current_offset": {"offset_A": OFFSET_A},
    "current_gain": {"gain": 1.032},
    "voltage_offset": {"offset_V": -0.012},
    "time_skew": {"skew_s": 0.4},
    "initial_soc": {"soc0": 0.85},
    "capacity": {"capacity_Ah": 2.7},
    "resistance_scale": {"scale": 1.35},
    "ocv_shift": {"shift_0125_V": 0.003, "shift_0500_V": -0.012},
    "slow_diffusion": {"r3_ohm": 0.012, "tau3_s": 1000.0},
    "hysteresis": {"m_V": 0.018, "gamma": 30.0},
    "temperature_dependence": {"activation_K": 2500.0},
    "rate_dependence": {"rate_h": 0.25},
    "charge_transfer": {"exchange_scale": 0.55, "asinh_per_V": 19.0},
    "charge_asymmetry": {"charge_scale": 1.3},
    "self_heating": {"rth_K_per_W": 5.0, "thermal_s": 600.0},
    "self_discharge": {"leak_A": 0.02},
}


def measured(name, seed, offset=OFFSET_A):
    rng = np.random.default_rng(seed)
    true = np.repeat(rng.uniform(-1.0, 3.0, 60), 20)
    log = CellLog(np.arange(1200.0), true, np.full(1200, 3.7))
    voltage = simulate(CELL, log, 0.9).voltage_V + rng.normal(0.0, 1e-3, 1200)
    return CellLog(log.time_s, true + offset, voltage, name=name)


def found(name, **changes):
    cause = CAUSES[name]
    values = VALUES[name]
    record = FoundCause(
        name=name,
        kind=cause.kind,
        meaning=cause.meaning,
        parameters=values,
        ci95={k: (0.9 * v, 1.1 * v) for k, v in values.items()},
        train_rmse_before_V=0.020,
        train_rmse_after_V=0.008,
        holdout_rmse_before_V=0.024,
        holdout_rmse_after_V=0.009,
        gain=0.625,
        gain_ci95=(0.55, 0.68),
        evidence=("seen at <every> edge",),
        confusable_with=cause.confused_with,
    )
    return replace(record, **changes)


def runs_of(logs, held, corrected):
    """Before and after with the offset taken out, from the true start."""
    runs = []
    for log, used in (*((g, "fit") for g in logs), *((g, "holdout") for g in held)):
        before = simulate(CELL, log, 0.9)
        right = replace(log, current_A=log.current_A - OFFSET_A)
        fixed = simulate(CELL, right, 0.9) if corrected else None
        runs.append(LogRun(log, used, before, before, fixed))
    return tuple(runs)


def diagnosis(*names, **changes):
    logs, held = (measured("drive", 0),), (measured("held <&>", 1),)
    fixed = tuple(replace(g, current_A=g.current_A - OFFSET_A) for g in logs)
    tried = [TriedCause(n, 0.009 + 0.001 * k, VALUES[n], 80.0 - 20.0 * k)
             for k, n in enumerate(VALUES)]  # fmt: skip
    record = Diagnosis(
        verdict=names[0] if names else "none",
        causes=tuple(found(n) for n in names),
        candidates=tuple(tried),
        anatomy=residual_analysis(CELL, logs[0], 0.9),
        next_test="rest an hour at 50 %",
        reasons=("nothing more explains anything",),
        model=CELL,
        extended_model=CELL if names else None,
        logs=logs,
        holdout=held,
        corrected=fixed,
        soc0=({"value": 0.9, "std": 0.0015, "how": "given"},) * 2,
        runs=runs_of(logs, held, any(CAUSES[n].kind == "measurement" for n in names)),
    )
    return replace(record, **changes)


ODD_ROWS = 2500


def odd_sensor(folder, offset_A, *, counted=False):
    """A model and two drives in a folder: the current sensor adds a constant.

    ``counted``: beside it the tester's counter, which has no such error.
    """
    cell = curved_cell()
    write_model(cell, folder / "cell.json")
    for k, name in enumerate(("drive", "held")):
        rng = np.random.default_rng(k)
        true = np.repeat(rng.uniform(-1.0, 3.0, ODD_ROWS // 20), 20)
        log = CellLog(np.arange(ODD_ROWS) * 2.0, true, np.full(ODD_ROWS, 3.7))
        voltage = simulate(cell, log, 0.9).voltage_V + rng.normal(0.0, 1e-3, ODD_ROWS)
        charge = np.cumsum(true * log.interval_s) / 3600.0 if counted else None
        read = CellLog(log.time_s, true + offset_A, voltage, charge_Ah=charge)
        write_log(read, folder / f"{name}.csv")
    return folder
