"""A sensor's file: how it is read, what each of its numbers moves, and that bands then hold."""

from __future__ import annotations

import math
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model, stock_names
from cellwise.errors import InputError
from cellwise.estimate.adaptive import Adaptive
from cellwise.estimate.filters.kalman import Ekf, Ukf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.noise import Noise
from cellwise.estimate.replay import replay
from cellwise.estimate.sensor import CAR, CLASSES, Sensor, assumed, read_sensor, seen_by
from cellwise.export.firmware import Firmware
from example_cells import curved_cell
from virtual_tester import planned

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "sensor.toml"
COMPILED = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
# Firmware has the bits of the FixedStep: see below.
FILTERS = (Ekf, Ukf, Adaptive, pytest.param(Firmware, marks=COMPILED))
KNOWN = (0.95, 0.005)  # a start that is stated


def written(tmp_path, text):
    path = tmp_path / "sensor.toml"
    path.write_text(text, encoding="utf-8")
    return path


# The file


def test_the_example_states_every_key_as_a_car_has_it():
    assert read_sensor(EXAMPLE) == CAR
    text = EXAMPLE.read_text(encoding="utf-8")
    assert [one.name for one in fields(Sensor) if one.name not in text] == []


def test_what_a_file_leaves_out_is_its_class(tmp_path):
    assert read_sensor(written(tmp_path, "")) == CAR
    assert read_sensor(written(tmp_path, "voltage_offset_V = 0.03")) == Sensor(
        voltage_offset_V=0.03
    )
    hall = read_sensor(written(tmp_path, 'class = "hall"\ncurrent_gain = 0.02'))
    assert hall == replace(CLASSES["hall"], current_gain=0.02)


def test_a_share_of_1C_takes_the_place_of_a_class_in_ampere(tmp_path):
    found = read_sensor(written(tmp_path, 'class = "hall"\ncurrent_offset_C = 0.01'))
    assert found.offset_A(20.0) == pytest.approx(0.2)
    assert CLASSES["hall"].offset_A(20.0) == CLASSES["hall"].offset_A(2.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("voltage_offset_V = -0.03", "without a sign"),
        ("voltage_offset_V = 30", "30 mV are voltage_offset_V = 0.03"),
        ("voltage_offset_mV = 30", "Did you mean 'voltage_offset_V'?"),
        ("current_gain = 1.01", "1 % is current_gain = 0.01"),
        ("current_gain = true", "a number"),
        ("current_gain = nan", "a number from 0 to 0.5"),
        ("current_offset_A = 0.1\ncurrent_offset_C = 0.01", "one of the two"),
        ('class = "satellite"', "one of car, shunt, hall"),
        ("class = [1]", "one of car, shunt, hall"),
        ("volt = 1", "some of current_offset_A"),
        ("not toml", "a TOML file with lines such as voltage_offset_V = 0.005"),
    ],
)
def test_a_wrong_file_says_what_to_write(tmp_path, text, said):
    with pytest.raises(InputError) as refused:
        read_sensor(written(tmp_path, text))
    assert said in str(refused.value)


def test_a_missing_sensor_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="no sensor's specification"):
        read_sensor(tmp_path / "missing.toml")


# What a number moves


@pytest.mark.parametrize("name", stock_names())
def test_a_car_sensor_is_what_filters_assume_without_a_file(name):
    model = stock_model(name)
    seen = seen_by(model, CAR)
    assert seen.model is model
    assert seen.noise == Noise.of_model(model) == seen_by(model).noise


def warm_cell(error=None):
    """A cell whose resistances follow the temperature."""
    cell = curved_cell() if error is None else curved_cell(error=error)
    return cell.with_effect(TemperatureDependence(activation_K=3600.0))


def changed_by(**stated):
    """Names of the noise that a number changes, and whether the model's own error grows."""
    model = warm_cell()
    seen, base = seen_by(model, Sensor(**stated)), Noise.of_model(model)
    names = {k for k, v in vars(seen.noise).items() if v != getattr(base, k)}
    wider = np.all(seen.model.slow_error_tables_V() > model.slow_error_tables_V())
    return names - {"slow_s", "slow_first_s", "slow_half_s", "lasting_share"}, bool(wider)


@pytest.mark.parametrize(
    ("stated", "names", "wider"),
    [
        ({"current_offset_C": 0.03}, {"soc_per_sqrt_h", "offset_share"}, False),
        ({"current_offset_A": 0.3}, {"soc_per_sqrt_h", "offset_share"}, False),
        ({"current_gain": 0.02}, {"capacity_share"}, False),
        ({"current_noise_A": 0.5}, {"current_A"}, False),
        ({"current_range_A": 20.0}, {"current_limit_A"}, False),
        (
            {"current_resolution_A": 0.5},
            {"current_A", "soc_per_sqrt_h", "offset_share"},
            False,
        ),
        ({"voltage_offset_V": 0.03}, set(), True),
        ({"voltage_noise_V": 0.02}, {"voltage_V"}, False),
        ({"voltage_resolution_V": 0.05}, {"voltage_V", "frozen_V"}, True),
        ({"temperature_K": 5.0}, {"branch_share"}, False),
    ],
)
def test_a_number_moves_its_own_direction_alone(stated, names, wider):
    assert changed_by(**stated) == (names, wider)


def test_a_voltage_offset_comes_back_at_the_same_soc_for_good():
    """Of the slow variance that part lasts which the sensor adds, and what lasted before."""
    error = ModelError.of_white_and_slow(0.001, 0.004, persistent_share=0.0)
    model = curved_cell(error=error)
    offset_V = math.sqrt(CAR.voltage_offset_V**2 + 0.003**2)
    seen = seen_by(model, Sensor(voltage_offset_V=offset_V))
    assert Noise.of_model(model).lasting_share == 0.0
    assert seen.model.error.at(0.5) == pytest.approx(0.005)
    assert seen.model.error.persistent_share == pytest.approx(9.0 / 25.0)


def test_a_model_that_no_temperature_moves_ignores_its_sensor():
    model = curved_cell()
    assert seen_by(model, Sensor(temperature_K=10.0)).model is model


@pytest.mark.parametrize("kind", FILTERS)
def test_a_reading_at_the_end_of_the_range_is_none(kind):
    model, rows = curved_cell(), 200
    sensor = Sensor(current_range_A=6.0)
    current = np.full(rows, 6.0)
    log = planned(current)
    assert np.all(kind(*seen_by(model, sensor)).run(log, 0.8).status[20:] != 0)
    assert not np.any(kind(*seen_by(model, CAR)).run(log, 0.8).status[20:] & 1)


# What is held out: a fault of the stated size


def drive(model, hours=1.5, seed=3):
    """A drive from 95 %, the model's own voltage, a true count of the SOC."""
    rng = np.random.default_rng(seed)
    rows = int(3600 * hours)
    current = np.repeat(rng.gamma(1.0, 0.5, rows // 20 + 1), 20)[:rows] * model.capacity_Ah
    log = planned(current, temperature_C=25.0)
    found = simulate(model, log, KNOWN[0])
    stop = int(np.searchsorted(-found.soc, -0.1))
    return replace(log, voltage_V=found.voltage_V).part(0, stop), found.soc[:stop]


SURE = ModelError.of_white_and_slow(0.001, 0.002, resistance_share=0.005)
FAULTS = {
    "voltage": (Sensor(voltage_offset_V=0.03), {"voltage_V": -0.03}),
    "current": (Sensor(current_offset_C=0.03), {"current_C": 0.03}),
    "gain": (Sensor(current_gain=0.03), {"gain": 1.03}),
    "temperature": (Sensor(temperature_K=8.0), {"warm_K": -8.0}),
}


def seen_with(log, model, *, voltage_V=0.0, current_C=0.0, gain=1.0, warm_K=0.0):
    return replace(
        log,
        voltage_V=log.voltage_V + voltage_V,
        current_A=gain * log.current_A + current_C * model.capacity_Ah,
        temperature_C=log.temperature_C + warm_K,
    )


def followed(kind, model, sensor, log):
    return kind(*seen_by(model, sensor)).run(log, *KNOWN)


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_stated_size_is_inside_the_band(kind, fault):
    sensor, what = FAULTS[fault]
    model = warm_cell(SURE)
    log, soc = drive(model)
    trace = followed(kind, model, sensor, seen_with(log, model, **what))
    assert np.mean(np.abs(trace.soc - soc) <= 2.0 * trace.soc_std) >= 0.9
    # Of a log without a fault, too: what may be wrong is not known to be right.
    stated, bare = followed(kind, model, sensor, log), followed(kind, model, None, log)
    assert stated.soc_std[-1] > 1.1 * bare.soc_std[-1]


@pytest.mark.parametrize("fault", ["voltage", "temperature"])
def test_without_its_file_the_fault_is_beyond_the_band(fault):
    model = warm_cell(SURE)
    log, soc = drive(model)
    trace = followed(Ekf, model, None, seen_with(log, model, **FAULTS[fault][1]))
    assert np.mean(np.abs(trace.soc - soc) <= 2.0 * trace.soc_std) < 0.9


# One step in Python and in C


@COMPILED
@pytest.mark.slow
def test_the_c_has_the_bits_of_python_with_a_sensor():
    model = warm_cell()
    log, _ = drive(model, hours=0.5)
    noisy = replace(log, voltage_V=log.voltage_V - 0.03)
    sensor = replace(CLASSES["hall"], voltage_offset_V=0.03, temperature_K=4.0)
    ours, theirs = (followed(kind, model, sensor, noisy) for kind in (FixedStep, Firmware))
    for name in ("soc", "soc_std", "voltage_V", "innovation_variance_V2", "status"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), name)


def test_replay_takes_it_and_says_it():
    model = curved_cell()
    log, _ = drive(model, hours=0.3)
    sensor = Sensor(voltage_offset_V=0.03)
    found = replay(model, log, soc0=0.95, soc0_std=0.005, sensor=sensor)
    expected = Ekf(*seen_by(model, sensor)).run(log, *KNOWN)
    np.testing.assert_array_equal(found.trace.soc_std, expected.soc_std)
    assert found.to_dict()["sensor"] == assumed(sensor, model.capacity_Ah)
    assert not found.to_dict()["sensor"]["by_default"]
    assert replay(model, log, soc0=0.95).to_dict()["sensor"]["by_default"]
    with pytest.raises(InputError, match="made already"):
        replay(model, log, Ekf(model), sensor=sensor)
