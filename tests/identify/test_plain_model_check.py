"""A fit that is worse than C/20 curve, R0 and two branches is not handed out, and that is said."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_file import read_model, write_model
from cellwise.cell.simulate import simulate
from cellwise.data import load_dataset
from cellwise.fit.rows import BaseOcv
from cellwise.identify import CellTests, IdentifySettings, identify_cell, pipeline
from cellwise.logs import CellLog, read_log
from cellwise.notices import Code
from example_cells import curved_cell
from synthetic import drive_current
from virtual_tester import logged

SETTINGS = IdentifySettings(nominal_Ah=3.0, chemistry="NMC", branches=2)
OFF_V = 0.15


def made_tests() -> CellTests:
    """C/20 and two drives of a cell that is what the plain model takes a cell for."""
    cell = curved_cell()
    same = np.ones_like(cell.tau1_s)
    cell = replace(cell, tau1_s=10.0 * same, tau2_s=300.0 * same)
    rng = np.random.default_rng(43)

    def log(name: str, time_s, current_A) -> CellLog:
        bare = CellLog(time_s, current_A, np.full(time_s.size, 3.7), name=name, soc0=1.0)
        return logged(cell, bare, 1.0, rng.normal(0.0, 1e-3, time_s.size))

    hours = np.arange(0.0, 20.0 * 3600.0, 20.0)
    drives = [drive_current(7500.0, 1.0, 4.5, rng) for _ in range(2)]
    return CellTests(
        ocv=log("c20", hours, np.full(hours.size, cell.capacity_Ah / 20.0)),
        drive=[log(f"drive {k}", np.arange(float(x.size)), x) for k, x in enumerate(drives)],
    )


@pytest.fixture(scope="module")
def made():
    return made_tests()


def spoilt(fit_with_effects, off_V):
    """Station of the fit whose OCV lies beside the one that was found."""

    def station(joint):
        fit = fit_with_effects(joint)
        base = BaseOcv(fit.result.base.voltage_V + off_V)
        return replace(fit, result=replace(fit.result, base=base))

    return station


def test_of_a_plain_cell_both_models_agree_and_the_fit_is_handed_out(made):
    found = identify_cell(made, SETTINGS)
    assert found.plain is not None
    assert found.plain.reason == ""
    assert found.contradictions == ()
    assert max(found.plain.fit_V, found.plain.plain_V) < 0.005, "1 mV of it is noise"
    shown = {(x.log, x.left_out) for x in found.plain.logs}
    assert {("c20", False), ("drive 0", False), ("drive 0", True)} <= shown
    for where in (found.to_dict()["plain_model"], found.model.provenance["plain_model"]):
        assert where["handed_out"] == "fit"
        assert where["fit_rmse_V"] > 0.0
        assert where["plain_rmse_V"] > 0.0


def test_a_fit_that_is_spoilt_is_refused_and_the_plain_model_handed_out(
    made, monkeypatch, tmp_path
):
    monkeypatch.setattr(pipeline, "fit_with_effects", spoilt(pipeline.fit_with_effects, OFF_V))
    found = identify_cell(made, SETTINGS)
    assert found.contradictions[0] == found.notices[0]
    assert found.notices[0].code is Code.PLAIN_MODEL
    first = found.notices[0].text
    fit_mV, plain_mV = (float(x) for x in re.findall(r"(\d+) mV", first))
    assert fit_mV > 50.0
    assert plain_mV < 5.0
    assert found.to_dict()["plain_model"]["handed_out"] == "plain"
    write_model(found.model, tmp_path / "plain.json")
    model = read_model(tmp_path / "plain.json")
    for log in (*made.ocv, *(log for log, _ in made.drive)):
        assert simulate(model, log, 1.0).rmse_above_10pct_V < 0.005
    assert np.all(model.posterior.std == pytest.approx(1.0)), "nothing is taken from the fit"
    assert float(model.slow_error_V(0.5)) < 0.05, "its error is of what it left out itself"


def test_a_loss_of_millivolts_that_is_sure_is_enough(made, monkeypatch):
    monkeypatch.setattr(pipeline, "fit_with_effects", spoilt(pipeline.fit_with_effects, 0.02))
    found = identify_cell(made, SETTINGS)
    assert found.plain.gain[1] < 0.0
    assert found.notices[0].code is Code.PLAIN_MODEL


def test_pulses_alone_are_not_judged():
    tests = CellTests(hppc=load_dataset("nmc_hppc"), ocv=load_dataset("nmc_ocv_c20"))
    found = identify_cell(tests, IdentifySettings(nominal_Ah=5.0, refine=False))
    assert found.plain is None
    assert found.to_dict()["plain_model"] is None


PANASONIC, LG, LEAF = "panasonic_18650pf/", "lg_18650hg2/", "nissan_leaf/"
TESTER = [f"{PANASONIC}cap_1c_p25_start_{k}" for k in (1, 2)]
MEASURED = {
    "panasonic": (2.9, {"hppc": [f"{PANASONIC}hppc_p25"], "ocv": [f"{PANASONIC}ocv_c20_p25"],
                        "capacity": TESTER}),
    "lg": (3.0, {"ocv": [f"{LG}ocv_c20_p25_549"], "capacity": [f"{LG}cap_1c_p25_551"]}),
    "a123": (2.0, {"ocv": ["plett_a123/ocv_p25_s1"], "drive": ["plett_a123/dyn_p25_s1"]}),
    "nmc of 1 Ah": (1.0, {"drive": ["pybatteryid_nmc/nmc_identification"]}),
    "leaf": (33.1, {"hppc": [f"{LEAF}hppc_p25"], "capacity": [f"{LEAF}cap_1c_p23"]}),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("cell", MEASURED)
def test_of_a_measured_cell_the_fit_is_handed_out(cell, real_data):
    rated_Ah, kit = MEASURED[cell]
    logs = {k: [read_log(real_data / f"{n}.csv.gz") for n in names] for k, names in kit.items()}
    found = identify_cell(CellTests(**logs), IdentifySettings(nominal_Ah=rated_Ah))
    assert found.plain.reason == ""
    assert found.plain.logs
