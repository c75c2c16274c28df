"""The start that is found is at least as likely as every one that it could have taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.initial_soc.initial_soc import initial_soc, ln_likelihood_of_starts, past_voltage
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import scaled_model, stock_model
from cellwise.logs import read_log
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, lfp_cell
from virtual_tester import logged

ROUNDING = 1e-6
PRIOR = 0.5
# Stock models of the kind: another sample than the log's, as a user's first try has it.
CUTS = {
    "panasonic_18650pf/drive_p25_us06": ("nca-18650", 2.9),
    "panasonic_18650pf/drive_n10_us06": ("nca-18650", 2.9),
    "plett_a123/dyn_p25_s1": ("lfp-26650", 2.07),
    "plett_a123/dyn_n15_s1": ("lfp-26650", 2.07),
    "lg_18650hg2/drive_us06_n10_601": ("nmc-18650", 3.0),
    "samsung_30q_ageing/d1_cellA_cycle441": ("nca-18650", 3.0),
    "lipo_5450/c2_cycle25": ("lipo-pouch", 5.45),
}
AT = (0.0, 0.2, 0.4, 0.6, 0.8)


def check(model: CellModel, log: CellLog) -> None:
    """Compare what is found with what the beginning says, full, empty and the middle."""
    found = initial_soc(model, log, whole_log=True)
    beginning = initial_soc(model, log)
    if beginning.how.startswith("rest"):
        # What the rest says besides counts, too: the simulation alone is not what is judged.
        errors = [rmse(model, log, s) for s in (found.soc, beginning.soc, 1.0, 0.0)]
        assert errors[0] <= min(errors) + max(0.005, 0.5 * min(errors)), (found, errors)
        return
    starts = np.array([found.soc, beginning.soc, 1.0, 0.0, PRIOR])
    likely = ln_likelihood_of_starts(model, log, past_voltage(model, log), None, starts)
    assert likely[0] >= likely.max() - ROUNDING, (found, beginning, likely)


def rmse(model: CellModel, log: CellLog, soc0: float) -> float:
    return simulate(model, log, soc0).rmse_V


@pytest.mark.parametrize("model", [curved_cell(), lfp_cell()], ids=["curved", "flat"])
@pytest.mark.parametrize("soc0", [1.0, 0.8, 0.4])
@pytest.mark.parametrize("rest_s", [0, 5, 600])
def test_a_drive_of_the_model_s_own_cell_and_of_another(model, soc0, rest_s):
    rng = np.random.default_rng(int(10 * soc0) + rest_s)
    load = model.capacity_Ah * np.repeat(rng.uniform(-0.2, 1.0, 60), 20)
    current = np.r_[np.zeros(rest_s), load]
    log = CellLog(np.arange(float(current.size)), current, np.full(current.size, 3.7))
    other = replace(model, r0_ohm=1.3 * model.r0_ohm)
    for cell in (model, other):
        check(model, logged(cell, log, soc0))


@pytest.mark.slow
@pytest.mark.parametrize("name", CUTS)
def test_measured_logs_cut_anywhere(real_data, name):
    stock, capacity_Ah = CUTS[name]
    model = scaled_model(stock_model(stock), capacity_Ah)
    log = read_log(real_data / f"{name}.csv.gz")
    if log.temperature_C is None:
        warm = -15.0 if "_n15_" in name else 25.0
        log = replace(log, temperature_C=np.full(len(log), warm))
    for at in AT:
        part = log.part(int(at * len(log)), len(log))
        check(model, replace(part, charge_Ah=None, soc0=None))
