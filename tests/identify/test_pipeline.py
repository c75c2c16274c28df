"""Laboratory tests in, model out: on embedded data, whose physics shares no code with cellwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise import IdentifySettings, InputError, TestLogs, identify_cell, load_dataset, simulate
from cellwise.data import list_datasets
from cellwise.estimate.replay import replay
from cellwise.logs import CellLog

TestLogs.__test__ = False

TRUTH = {e["name"]: e for e in list_datasets()}
# A physics model is no equivalent circuit: one to two per cent of the 1.7 V window is what a good
# fit leaves on a drive it has not seen; the mean of two cells' papers is 23 mV on their own data.
HELD_OUT_V = 0.030


@pytest.fixture(scope="module")
def laboratory():
    tests = TestLogs(
        hppc=((load_dataset("nmc_hppc"), None),),
        ocv=(load_dataset("nmc_ocv_c20"),),
        capacity=tuple(load_dataset(f"nmc_cap_{r}") for r in ("c20", "c5", "c3")),
    )
    return identify_cell(tests, IdentifySettings(nominal_Ah=5.0))


def held_out_rmse(model, name):
    return simulate(model, load_dataset(name), TRUTH[name]["initial_soc"]).rmse_above_10pct_V


def test_a_drive_nobody_fitted(laboratory):
    assert held_out_rmse(laboratory.model, "nmc_drive_b") < HELD_OUT_V


def test_ekf_from_30_points_off_on_it(laboratory):
    truth = TRUTH["nmc_drive_b"]
    found = replay(
        laboratory.model,
        load_dataset("nmc_drive_b"),
        soc0=truth["initial_soc"] - 0.3,
        reference_soc0=truth["initial_soc"],
        reference_capacity_Ah=truth["true_capacity_Ah"],
    )
    assert found.settled.rmse < 0.012
    assert found.coverage_2sigma > 0.9


def test_capacities_keep_their_order(laboratory):
    c = laboratory.capacities
    assert c["rate:C/20"] > c["rate:C/5"] > c["rate:C/3"]
    rates = [c["rate:C/20"], c["rate:C/5"], c["rate:C/3"]]
    assert c["cc-average"] == pytest.approx(np.mean(rates), rel=1e-3)
    assert laboratory.model.capacity_Ah == c["rate:C/20"]
    assert c["rate:C/20"] == pytest.approx(TRUTH["nmc_hppc"]["true_capacity_Ah"], rel=0.01)


def test_the_model_says_where_its_numbers_came_from(laboratory):
    said = laboratory.model.provenance
    assert said["capacity"]["choice"] == "rate:C/20"
    assert any("hppc" in name for name in said["logs"]["hppc"])
    assert said["pulses"]["method"] == "varpro"
    assert all(v > 0 for v in said["refinement"][0]["standard_error"].values())


def test_refinement_beats_the_pulses_alone_on_a_drive(laboratory):
    tests = TestLogs(hppc=((load_dataset("nmc_hppc"), None),), ocv=(load_dataset("nmc_ocv_c20"),))
    plain = identify_cell(tests, IdentifySettings(nominal_Ah=5.0, refine=False)).model
    assert held_out_rmse(laboratory.model, "nmc_drive_b") < held_out_rmse(plain, "nmc_drive_b")


@pytest.mark.parametrize("method", ["varpro", "segments", "pso"])
@pytest.mark.parametrize("tables", ["spline", "cubic"])
def test_every_method_gives_a_model(method, tables):
    log = load_dataset("nmc_hppc_c3")
    tests = TestLogs(hppc=((log, None),), ocv=(load_dataset("nmc_ocv_c20"),))
    settings = IdentifySettings(nominal_Ah=5.0, method=method, tables=tables, refine=False)
    model = identify_cell(tests, settings).model
    assert np.all(model.tau1_s < model.tau2_s)
    # Ohm's law, at 1.7 A: whatever the method, the voltage is off by less than the whole drop.
    assert simulate(model, log, 1.0).rmse_above_10pct_V < 0.1


def test_flat_lfp_with_pulse_pairs():
    tests = TestLogs(hppc=((load_dataset("lfp_hppc"), None),), ocv=(load_dataset("lfp_ocv_c20"),))
    found = identify_cell(tests, IdentifySettings(nominal_Ah=2.3))
    assert found.pulse_counts["trimmed"] == 8  # by the generator's own account
    log = load_dataset("lfp_cdc")
    error = simulate(found.model, log, TRUTH["lfp_cdc"]["initial_soc"])
    assert error.rmse_above_10pct_V < HELD_OUT_V


@pytest.mark.slow
def test_a_temperature_axis_beats_one_temperature(laboratory):
    tests = TestLogs(
        hppc=((load_dataset("nmc_hppc"), 25.0), (load_dataset("nmc_hppc_p00"), 0.0)),
        ocv=(load_dataset("nmc_ocv_c20"),),
    )
    model = identify_cell(tests, IdentifySettings(nominal_Ah=5.0)).model
    assert model.temperature_C.tolist() == [0.0, 25.0]
    assert np.median(model.r0_ohm[0]) > np.median(model.r0_ohm[1])
    warm = replace(laboratory.model, effects=())
    assert held_out_rmse(model, "nmc_drive_p00") < 0.5 * held_out_rmse(warm, "nmc_drive_p00")


def short(log: CellLog, first_s: float, last_s: float) -> CellLog:
    rows = (log.time_s >= first_s) & (log.time_s <= last_s)
    return log.rows(np.flatnonzero(rows))


class TestRefused:
    def run(self, tests, **settings):
        return identify_cell(tests, IdentifySettings(nominal_Ah=5.0, **settings))

    def test_nothing(self):
        with pytest.raises(InputError, match="neither an HPPC nor a drive"):
            self.run(TestLogs())

    def test_swapped_sign(self):
        log = load_dataset("nmc_hppc")
        wrong = CellLog(log.time_s, -log.current_A, log.voltage_V, name="wrong")
        with pytest.raises(InputError, match="--sign"):
            self.run(TestLogs(hppc=((wrong, None),)))

    def test_no_pulse(self):
        log = load_dataset("nmc_cap_c3")
        with pytest.raises(InputError):
            self.run(TestLogs(hppc=((log, None),), ocv=(load_dataset("nmc_ocv_c20"),)))

    def test_unknown_capacity_choice_lists_those_there_are(self):
        with pytest.raises(InputError, match="nominal"):
            self.run(TestLogs(hppc=((load_dataset("nmc_hppc"), None),)), capacity_choice="rate:9C")

    def test_drive_alone_without_capacity(self):
        with pytest.raises(InputError):
            identify_cell(TestLogs(drive=((load_dataset("nmc_drive_b"), None),)))

    def test_a_capacity_test_that_never_reaches_the_limit(self):
        log = load_dataset("nmc_cap_c3")
        cut = short(log, 0.0, 5400.0)
        tests = TestLogs(
            hppc=((load_dataset("nmc_hppc"), None),),
            ocv=(load_dataset("nmc_ocv_c20"),),
            capacity=(cut,),
        )
        found = self.run(tests, refine=False)
        assert "rate:C/3" not in found.capacities
        assert found.capacity_choice == "rate:C/20"


def test_one_pulse_is_enough_for_a_model_that_says_so():
    log = load_dataset("nmc_hppc")
    step = np.flatnonzero(np.abs(np.diff(log.current_A)) > 1.0)
    one = short(log, 0.0, float(log.time_s[step[1]]) + 30.0)
    tests = TestLogs(hppc=((one, None),), ocv=(load_dataset("nmc_ocv_c20"),))
    found = identify_cell(tests, IdentifySettings(nominal_Ah=5.0, refine=False))
    assert sum(found.pulse_counts.values()) >= 1
    assert np.all(found.model.r0_ohm == pytest.approx(float(found.model.r0_ohm[0, 0])))


def test_missing_voltages_in_the_middle_change_little(laboratory):
    log = load_dataset("nmc_hppc")
    voltage = log.voltage_V.copy()
    voltage[np.random.default_rng(4).integers(0, voltage.size, voltage.size // 100)] = np.nan
    tests = TestLogs(
        hppc=((replace(log, voltage_V=voltage), None),), ocv=(load_dataset("nmc_ocv_c20"),)
    )
    model = identify_cell(tests, IdentifySettings(nominal_Ah=5.0)).model
    assert held_out_rmse(model, "nmc_drive_b") < 1.1 * held_out_rmse(
        laboratory.model, "nmc_drive_b"
    )
