"""No filter may be worse than not filtering: known starts, and starts that are wrong under load.

Coulomb counting with the log's own current is the referee of the first, the tester's counter over
a laboratory's capacity that of both.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.estimate.estimators import make_estimator
from cellwise.identify import IdentifySettings, TestLogs, identify_cell
from cellwise.logs import read_log

REFERENCE_AH = 2.9973  # C/20 at 25 degC
LFP_AH = 2.0725
PAN_DRIVES = ("us06", "hwfta", "hwftb", "nn", "cycle_3", "cycle_4")
LFP_WARM = {"p25": 25.0, "p35": 35.0, "p45": 45.0}
KNOWN_STD = 0.005
MORE = 0.003  # of SOC RMSE, a filter may lose against counting

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def nca(real_data):
    folder = real_data / "panasonic_18650pf"
    tests = TestLogs(
        hppc=((read_log(folder / "hppc_p25.csv.gz"), None),),
        ocv=(read_log(folder / "ocv_c20_p25.csv.gz"),),
    )
    model = identify_cell(tests, IdentifySettings(nominal_Ah=2.9)).model
    return model, [read_log(folder / f"drive_p25_{name}.csv.gz") for name in PAN_DRIVES]


@pytest.fixture(scope="module")
def lfp(real_data):
    folder = real_data / "plett_a123"

    def log(name, warm):
        found = read_log(folder / f"{name}.csv.gz")
        return replace(found, temperature_C=np.full(len(found), warm), soc0=1.0)

    branches = [
        replace(log(f"ocv_p25_{part}", 25.0), soc0=None, name=part) for part in ("s1", "s3")
    ]
    drives = {tag: log(f"dyn_{tag}_s1", warm) for tag, warm in LFP_WARM.items()}
    tests = TestLogs(ocv=tuple(branches), drive=((drives["p25"], 25.0), (drives["p35"], 35.0)))
    return identify_cell(tests, IdentifySettings(nominal_Ah=2.07)).model, [*drives.values()]


def rmse(error):
    return float(np.sqrt(np.mean(np.square(error))))


def losses(model, logs, name, capacity_Ah):
    """SOC RMSE of a filter less that of counting, from a start that is known, log by log."""
    found = []
    for log in logs:
        truth = 1.0 - (log.charge_Ah - log.charge_Ah[0]) / capacity_Ah
        ours, counted = (
            make_estimator(n, model).run(log, 1.0, KNOWN_STD) for n in (name, "coulomb")
        )
        found.append(rmse(ours.soc - truth) - rmse(counted.soc - truth))
    return found


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_nca_from_a_known_start(nca, name):
    assert max(losses(*nca, name, REFERENCE_AH)) < MORE


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_lfp_from_a_known_start(lfp, name):
    assert max(losses(*lfp, name, LFP_AH)) < MORE


def cut(log, at_soc):
    """The log from where it has discharged to a SOC, at its next row above 1 A; the truth there."""
    soc = 1.0 - (log.charge_Ah - log.charge_Ah[0]) / REFERENCE_AH
    begin = int(np.argmax(soc < at_soc))
    begin += int(np.argmax(log.current_A[begin:] > 1.0))
    return log.part(begin, len(log)), soc[begin:]


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_nca_cut_in_the_middle_and_30_points_wrong(nca, name):
    """Nothing says that the cell was full; the model is of laboratory tests alone."""
    model, logs = nca
    errors, inside = [], []
    for log in logs:
        for at_soc, wrong in ((0.65, -0.3), (0.5, 0.3)):
            part, truth = cut(log, at_soc)
            trace = make_estimator(name, model).run(part, float(truth[0]) + wrong, 0.15)
            error = trace.soc - truth
            errors.append(rmse(error[len(error) // 4 :]))
            inside.append(float(np.mean(np.abs(error) < 2.0 * trace.soc_std)))
    assert np.mean(errors) < 0.02  # what counts as converged
    assert np.mean(inside) > 0.93
