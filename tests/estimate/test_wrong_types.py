"""What is handed to an estimator with a wrong type is refused with a sentence, not by a kernel."""

from __future__ import annotations

import shutil
from functools import cache

import numpy as np
import pytest

from cellwise import InputError, LockstepEkf, Noise, load_dataset, replay, simulate
from cellwise.estimate.estimators import ESTIMATORS, make_estimator
from cellwise.estimate.fixed.fixed_step import FixedStep
from example_cells import curved_cell

STEPPED = ("coulomb", "ekf", "ukf", "adaptive", "rest-ocv")
COUNTED = ("fixed-step", *(["firmware"] if shutil.which("cc") else []))
SAMPLE = {"current_A": 1.0, "voltage_V": 3.7, "temperature_C": 25.0}
WRONG_READINGS = [None, "1.2", [1.0, 2.0], np.zeros(3), {"A": 1.0}, 1j]


@cache
def counted(name):
    """One for all tests: it keeps nothing, and the C twin is compiled for it."""
    from cellwise.export.firmware import Firmware

    return (FixedStep if name == "fixed-step" else Firmware)(curved_cell(), dt_s=1.0)


def estimator(name):
    if name in COUNTED:
        return counted(name)
    if name == "lockstep-ekf":
        return LockstepEkf(curved_cell(), 3, 1.0)
    return make_estimator(name, curved_cell())


def step(one, state, **sample):
    how = {"dt_s": 1.0} if one.name in STEPPED else {}
    if one.name in COUNTED:
        how = {"sequence": 1}
    return one.step(state, **SAMPLE | how | sample)


def sentence(error):
    """Found, expected, what to do."""
    assert all(len(part) > 3 for part in (error.found, error.expected, error.action))
    assert error.action.endswith(".")
    return str(error)


@pytest.mark.parametrize("name", [*STEPPED, *COUNTED, "lockstep-ekf"])
@pytest.mark.parametrize("wrong", [None, 0.5, "state", {}, np.zeros(4)], ids=repr)
def test_a_state_that_is_none_is_refused(name, wrong):
    with pytest.raises(InputError, match="found state = ") as caught:
        step(estimator(name), wrong)
    assert "init(soc0)" in sentence(caught.value)


@pytest.mark.parametrize("name", [*STEPPED, *COUNTED])
@pytest.mark.parametrize("reading", ["current_A", "voltage_V", "temperature_C"])
@pytest.mark.parametrize("wrong", WRONG_READINGS, ids=repr)
def test_a_reading_that_is_no_number_is_refused(name, reading, wrong):
    if reading == "temperature_C" and wrong is None:
        return  # nobody measured it
    one = estimator(name)
    with pytest.raises(InputError, match=f"found {reading} = ") as caught:
        step(one, one.init(0.5), **{reading: wrong})
    assert "nan where the reading is missing" in sentence(caught.value)


@pytest.mark.parametrize("name", STEPPED)
@pytest.mark.parametrize("wrong", [None, "1", np.zeros(2), -1.0, np.nan, np.inf], ids=repr)
def test_an_interval_that_is_none_is_refused(name, wrong):
    one = estimator(name)
    with pytest.raises(InputError, match=r"found dt_s = .*seconds, at least 0") as caught:
        step(one, one.init(0.5), dt_s=wrong)
    sentence(caught.value)


@pytest.mark.parametrize("name", COUNTED)
@pytest.mark.parametrize("wrong", [None, "1", 1.5])
def test_a_sequence_that_is_no_number_is_refused(name, wrong):
    one = estimator(name)
    with pytest.raises(InputError, match="a whole number"):
        step(one, one.init(0.5), sequence=wrong)


def test_another_estimator_s_state_is_refused():
    ekf, adaptive = estimator("ekf"), estimator("adaptive")
    with pytest.raises(InputError, match=r"an AdaptiveState.*expected an EkfState"):
        step(ekf, adaptive.init(0.5))
    wide, narrow = (FixedStep(curved_cell(), dt_s=1.0, wide=w) for w in (True, False))
    with pytest.raises(InputError, match="one record of"):
        step(narrow, wide.init(0.5))


@pytest.mark.parametrize(
    "wrong", [None, "1.2", ["a", "b", "c"], [1.0, None, 2.0], [[1.0], [2.0, 3.0]]]
)
def test_lockstep_refuses_what_is_no_row_of_numbers(wrong):
    one = estimator("lockstep-ekf")
    with pytest.raises(InputError, match="found current_A = ") as caught:
        step(one, one.init(0.5), current_A=wrong)
    sentence(caught.value)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_model_a_log_and_a_start_of_another_type_are_refused(name):
    with pytest.raises(InputError, match=r"model = None; expected a CellModel.*read_model"):
        make_estimator(name, None)
    with pytest.raises(InputError, match=r"noise = 0.1; expected a Noise"):
        make_estimator(name, curved_cell(), 0.1)
    if name == "firmware" and name not in COUNTED:
        pytest.skip("no C compiler")
    one = make_estimator(name, curved_cell(), Noise())
    with pytest.raises(InputError, match=r"log = 'a.csv'; expected a CellLog.*read_log"):
        one.run("a.csv", 0.5)
    log = load_dataset("nmc_drive_b").part(0, 20)
    for wrong in (None, "0.5", [0.5, 0.6]):
        with pytest.raises(InputError, match="soc0 = "):
            one.run(log, wrong)
        with pytest.raises(InputError, match="soc0_std = "):
            one.run(log, 0.5, wrong)


@pytest.mark.parametrize("function", [simulate, replay])
def test_functions_refuse_what_is_no_model_or_log(function):
    log = load_dataset("nmc_drive_b").part(0, 20)
    with pytest.raises(InputError, match=r"model = 'model.json'; expected a CellModel"):
        function("model.json", log)
    with pytest.raises(InputError, match=r"log = 'log.csv'; expected a CellLog"):
        function(curved_cell(), "log.csv")
