"""What people pass by mistake to the public face ends in one clear error, never in Python's own."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cellwise as cw
from cellwise.errors import InputError
from example_cells import curved_cell

MODEL = curved_cell()
LOG = cw.load_dataset("nmc_drive_b").part(0, 60)
T_S, I_A, V_V = LOG.time_s, LOG.current_A, LOG.voltage_V
OCV = np.linspace(3.0, 4.2, 11)


def identified(**settings):
    return cw.identify_cell(cw.CellTests(hppc=LOG), cw.IdentifySettings(**settings))


CALLS = {
    "model": {
        "simulate": lambda: cw.simulate(None, LOG),
        "replay": lambda: cw.replay("m.json", LOG),
        "diagnose": lambda: cw.diagnose(None, LOG),
        "tune_noise": lambda: cw.tune_noise(None, [LOG]),
        "forecast": lambda: cw.forecast(None, None),
        "Ekf": lambda: cw.Ekf(LOG),
        "LiveFilter": lambda: cw.LiveFilter(LOG),
        "Noise.of_model": lambda: cw.Noise.of_model(None),
        "export": lambda: cw.export_firmware(LOG, "firmware", 1.0),
        "write_model": lambda: cw.write_model("m.json", MODEL),
        "inverted": lambda: cw.replay_and_forecast(LOG, MODEL),
        "a filter of nothing": lambda: cw.Ekf().run(LOG),
        "a counter of nothing": lambda: cw.Coulomb(),
        "no name": lambda: cw.named_model(None),
        "a path": lambda: cw.Ekf(Path("m.json")),
        "a dict": lambda: cw.simulate({"capacity_Ah": 3.0}, LOG),
        "ageing_history, inverted": lambda: cw.ageing_history([LOG], MODEL),
    },
    "sample": {
        "a voltage": lambda: cw.LiveFilter(MODEL).take(3.7),
        "none": lambda: cw.LiveFilter(MODEL).take(None),
    },
    "current_A, of a sample": {
        "text": lambda: cw.LiveFilter(MODEL).take(cw.Sample(0.0, "1 A", 3.7)),
    },
    "temperature_C": {
        "text": lambda: MODEL.ocv_at("warm"),
        "kelvin": lambda: MODEL.at_temperature(298.15),
        "none": lambda: MODEL.at_temperature(None),
    },
    "capacity_Ah": {
        "text": lambda: cw.named_model("nmc-18650", "3 Ah"),
        "of a model": lambda: cw.CellModel("3 Ah", OCV, 0.03),
    },
    "load": {
        "text": lambda: cw.forecast_at(MODEL, cw.replay(MODEL, LOG, "coulomb", 0.8), "5 W"),
    },
    "asked": {"a name": lambda: cw.replay_and_forecast(MODEL, LOG, "adaptive")},
    "sensor": {"text": lambda: cw.replay(MODEL, LOG, sensor="car")},
    "power": {"text": lambda: cw.replay(MODEL, LOG, "ekf", 0.8, power="yes")},
    "logs": {
        "a name in a list": lambda: cw.ageing_history(MODEL, ["a.csv"]),
        "none": lambda: cw.ageing_history(MODEL, None),
        "of a pack": lambda: cw.estimate_pack(MODEL, LOG),
        "of a pack, in a list": lambda: cw.estimate_pack(MODEL, [LOG]),
    },
    "found": {
        "history page": lambda: cw.history_page(None, "x.html"),
        "pack page": lambda: cw.pack_page(LOG, "x.html"),
    },
    "identification": {"page": lambda: cw.identify_page(MODEL, "x.html")},
    "diagnosis": {"page": lambda: cw.diagnose_page(MODEL, "x.html")},
    "log": {
        "Stated": lambda: cw.Stated.parse(None),
        "replay_and_forecast": lambda: cw.replay_and_forecast(MODEL, None),
        "simulate": lambda: cw.simulate(MODEL, "a.csv"),
        "a list": lambda: cw.simulate(MODEL, [LOG]),
        "tune_noise": lambda: cw.tune_noise(MODEL, ["a.csv"]),
        "resample": lambda: cw.resample(None, 1.0),
        "Ekf": lambda: cw.Ekf(MODEL).run(None),
        "Coulomb": lambda: cw.Coulomb(MODEL).run(None),
        "Adaptive, a dict": lambda: cw.Adaptive(MODEL).run({}),
        "inspect_log": lambda: cw.inspect_log(MODEL),
        "write_log": lambda: cw.write_log(MODEL, "a.csv"),
        "write_log, inverted": lambda: cw.write_log("a.csv", LOG),
    },
    "replay": {
        "forecast": lambda: cw.forecast(MODEL, LOG),
        "forecast_at": lambda: cw.forecast_at(MODEL, None, 5.0),
        "page": lambda: cw.replay_page(MODEL, "x.html"),
    },
    "estimator": {
        "its start": lambda: cw.replay(MODEL, LOG, 0.9),
        "its class": lambda: cw.replay(MODEL, LOG, cw.Ekf),
        "none": lambda: cw.replay(MODEL, LOG, None),
        "another": lambda: cw.replay(MODEL, LOG, "particle"),
        "of a stream": lambda: cw.LiveFilter(MODEL, "adaptive"),
    },
    "soc0": {
        "simulate": lambda: cw.simulate(MODEL, LOG, "full"),
        "replay": lambda: cw.replay(MODEL, LOG, "coulomb", "full"),
        "diagnose": lambda: cw.diagnose(MODEL, LOG, soc0="auto"),
        "tune_noise": lambda: cw.tune_noise(MODEL, LOG, "full"),
        "LiveFilter": lambda: cw.LiveFilter(MODEL, soc0="full"),
        "CellLog": lambda: cw.CellLog(T_S, I_A, V_V, soc0="full"),
    },
    "an initial SOC of 80": {
        "replay": lambda: cw.replay(MODEL, LOG, soc0=80),
        "reference": lambda: cw.replay(MODEL, LOG, reference_soc0=80, reference_capacity_Ah=3.0),
    },
    "reference_capacity_Ah": {
        "replay": lambda: cw.replay(MODEL, LOG, soc0=0.9, reference_capacity_Ah="3 Ah"),
    },
    "h0": {"simulate": lambda: cw.simulate(MODEL, LOG, 0.9, "full")},
    "cutoff_V": {
        "forecast": lambda: cw.forecast(MODEL, cw.replay(MODEL, LOG, "coulomb"), cutoff_V="3 V"),
    },
    "hold": {"forecast": lambda: cw.forecast(MODEL, cw.replay(MODEL, LOG, "coulomb"), hold=3)},
    "voltage_V": {
        "none": lambda: cw.CellLog(T_S, I_A, None),
        "text": lambda: cw.CellLog(T_S, I_A, "voltage"),
        "words": lambda: cw.CellLog(T_S, I_A, ["high"] * len(T_S)),
    },
    "current_A": {"none": lambda: cw.CellLog(T_S, None, V_V)},
    "time_s": {"none": lambda: cw.CellLog(None, I_A, V_V)},
    "CellLog(": {
        "a dict": lambda: cw.CellLog({"time_s": T_S}),
        "a file": lambda: cw.CellLog("a.csv"),
    },
    "table": {
        "none": lambda: cw.CellLog.from_table(None),
        "a file": lambda: cw.CellLog.from_table("a.csv"),
        "rows": lambda: cw.CellLog.from_table([[0.0, 1.0, 3.7]]),
    },
    "rows": {"part": lambda: LOG.part(0.0, 20.0)},
    "path": {
        "read_model": lambda: cw.read_model(None),
        "read_log": lambda: cw.read_log(None),
        "read_log, a dict": lambda: cw.read_log({"time_s": T_S}),
        "read_pack": lambda: cw.read_pack(LOG),
        "write_model": lambda: cw.write_model(MODEL, None),
        "write_log": lambda: cw.write_log(LOG, 3),
    },
    "folder": {"export": lambda: cw.export_firmware(MODEL, None, 1.0)},
    "dt_s": {
        "export": lambda: cw.export_firmware(MODEL, "firmware", None),
        "resample": lambda: cw.resample(LOG, "1 s"),
    },
    "tests": {
        "a log": lambda: cw.identify_cell(LOG),
        "a list": lambda: cw.identify_cell([LOG]),
        "none": lambda: cw.identify_cell(None),
    },
    "settings": {"identify": lambda: cw.identify_cell(cw.CellTests(hppc=LOG), 5.0)},
    "nominal_Ah": {"text": lambda: identified(nominal_Ah="5 Ah")},
    "method": {"another": lambda: identified(method="least squares")},
    "branches": {"seven": lambda: identified(branches=7)},
    "prior": {"a name": lambda: identified(prior="nmc-18650")},
    "noise": {
        "replay": lambda: cw.replay(MODEL, LOG, noise=3),
        "Noise": lambda: cw.Noise(voltage_V="5 mV"),
    },
    "voltage_min_V": {
        "limits": lambda: cw.OperatingLimits(voltage_min_V="3 V"),
        "model": lambda: replace(MODEL, voltage_min_V="3 V"),
    },
    "a validity of soc": {"pair": lambda: cw.Validity(soc=(0.0, 0.5, 1.0))},
    "effect": {
        "number": lambda: cw.CellModel(3.0, OCV, 0.03, effects=3),
        "text": lambda: cw.CellModel(3.0, OCV, 0.03, effects=("hysteresis",)),
        "with_effect": lambda: MODEL.with_effect(None),
    },
    "error": {"number": lambda: cw.CellModel(3.0, OCV, 0.03, error=0.01)},
    "factor": {"text": lambda: MODEL.with_resistances("twice")},
    "provenance": {"text": lambda: cw.CellModel(3.0, OCV, 0.03, provenance="mine")},
}


@pytest.mark.parametrize(
    ("named", "case"), [(named, case) for named, cases in CALLS.items() for case in cases]
)
def test_a_wrong_argument_is_named_with_what_to_write(named, case):
    with pytest.raises(InputError) as caught:
        CALLS[named][case]()
    error = caught.value
    assert named.partition(",")[0] in error.found
    assert len(error.expected) > 3
    assert error.action.endswith(".")


def test_a_start_where_the_estimator_stands_says_where_it_goes():
    with pytest.raises(InputError, match=r"replay\(model, log, 'ekf', soc0=0.9\)"):
        cw.replay(MODEL, LOG, 0.9)
    with pytest.raises(InputError, match=r"make the filter: Ukf\(model\)"):
        cw.replay(MODEL, LOG, cw.Ukf)


@pytest.mark.parametrize("name", ["EKF", "Ekf", "ekf"])
def test_names_of_estimators_are_taken_in_any_case(name):
    assert cw.replay(MODEL, LOG, name, 0.9).estimator == "ekf"
    assert cw.LiveFilter(MODEL, name).filter.name == "ekf"


def test_a_start_is_given_by_position_or_by_name_and_none_is_not_known():
    by_position = cw.simulate(MODEL, LOG, 0.8), cw.replay(MODEL, LOG, "coulomb", 0.8)
    by_name = cw.simulate(MODEL, LOG, soc0=0.8), cw.replay(MODEL, LOG, "coulomb", soc0=0.8)
    for one, other in zip(by_position, by_name, strict=True):
        np.testing.assert_array_equal(one.soc, other.soc)
    np.testing.assert_array_equal(cw.simulate(MODEL, LOG, None).soc, cw.simulate(MODEL, LOG).soc)
    known = replace(LOG, soc0=0.6)
    assert cw.replay(MODEL, known, "coulomb", None).start.soc == 0.6
    assert cw.LiveFilter(MODEL, "ekf", 0.8).start.soc == 0.8
    assert cw.LiveFilter(MODEL, soc0=None).start is None


class Counter:
    """The least that an estimator of one's own is."""

    def start(self, soc0, soc0_std):
        self.soc = soc0

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        self.soc -= current_A * dt_s / (3600.0 * MODEL.capacity_Ah)
        return self.soc


def test_an_estimator_of_ones_own_that_counts_is_the_coulomb_counter():
    mine = cw.replay(MODEL, LOG, Counter(), 0.8)
    np.testing.assert_allclose(mine.soc, cw.replay(MODEL, LOG, "coulomb", 0.8).soc, atol=1e-12)
    assert mine.estimator == "Counter"


def test_an_estimator_that_answers_with_something_else_is_refused():
    class Silent(Counter):
        def step(self, *sample):
            return None

    with pytest.raises(InputError, match=r"what Silent.step gives = None; expected the SOC"):
        cw.replay(MODEL, LOG, Silent(), 0.8)


@pytest.mark.parametrize(
    ("model", "entry"),
    [
        (replace(MODEL, capacity_Ah=1000.0 * 3.0), "capacity_Ah"),
        (replace(MODEL, r0_ohm=1000.0 * MODEL.r0_ohm), "r0_ohm"),
        (replace(MODEL, ocv_V=1000.0 * MODEL.ocv_V), "ocv_V"),
        (replace(MODEL, temperature_C=MODEL.temperature_C + 273.15), "temperature_C"),
        (replace(MODEL, voltage_min_V=3000.0, voltage_max_V=4200.0), "voltage_min_V"),
    ],
)
def test_a_model_in_another_unit_is_refused_with_the_line_that_mends_it(model, entry):
    """Every function takes a model through one check; what it proposes is run as it stands."""
    for refuses in (lambda: cw.Ekf(model), lambda: cw.simulate(model, LOG, 0.9)):
        with pytest.raises(InputError) as caught:
            refuses()
        line = caught.value.action.partition(" Write ")[2].rstrip(".")
        assert line.startswith(f"dataclasses.replace(model, {entry}=")
    mended = eval(line, {"dataclasses": dataclasses, "model": model})
    if entry == "voltage_min_V":  # the other limit is in millivolts still
        mended = replace(mended, voltage_max_V=mended.voltage_max_V / 1000)
    assert cw.Ekf(mended).name == "ekf"


@pytest.mark.parametrize(
    "log",
    [
        replace(LOG, voltage_V=1000.0 * LOG.voltage_V),
        replace(LOG, temperature_C=np.full(len(LOG), 298.15)),
        replace(LOG, charge_Ah=np.linspace(0.0, 2900.0, len(LOG))),
    ],
    ids=["millivolts", "kelvin", "milliampere hours"],
)
def test_a_log_in_another_unit_is_refused_with_the_line_that_mends_it(log):
    for refuses in (
        lambda: cw.simulate(MODEL, log, 0.9),
        lambda: cw.Ekf(MODEL).run(log, 0.9),
        lambda: cw.replay(MODEL, log, "coulomb"),
        lambda: cw.diagnose(MODEL, log),
    ):
        with pytest.raises(InputError) as caught:
            refuses()
    line = caught.value.action.partition(" Write ")[2].rstrip(".")
    mended = eval(line, {"dataclasses": dataclasses, "log": log})
    assert np.isfinite(cw.simulate(MODEL, mended, 0.9).metrics.rmse_V)


def test_milliamperes_are_refused_with_the_line_that_mends_them():
    drive = cw.load_dataset("nmc_drive_b")
    log = replace(drive, current_A=1000.0 * drive.current_A)
    for refuses in (
        lambda: cw.simulate(MODEL, log),
        lambda: cw.replay(MODEL, log),
        lambda: cw.diagnose(MODEL, log),
    ):
        with pytest.raises(InputError) as caught:
            refuses()
    line = caught.value.action.partition(" Write ")[2].rstrip(".")
    mended = eval(line, {"dataclasses": dataclasses, "log": log})
    np.testing.assert_allclose(mended.current_A, drive.current_A)


@pytest.mark.parametrize("estimator", [cw.Ekf, cw.Ukf, cw.Adaptive, cw.Coulomb])
def test_a_filter_begins_where_it_is_told_or_where_the_log_states(estimator):
    told = estimator(MODEL).run(LOG, 0.8)
    stated = estimator(MODEL).run(replace(LOG, soc0=0.8))
    np.testing.assert_array_equal(stated.soc, told.soc)
    with pytest.raises(InputError, match=r"replay\(model, log\) finds it"):
        estimator(MODEL).run(LOG)
