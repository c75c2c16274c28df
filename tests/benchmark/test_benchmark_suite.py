"""Suites in TOML: what ships can be read, what is wrong gives one clear message."""

from __future__ import annotations

import tomllib

import pytest

from cellwise.benchmark.faults import Fault
from cellwise.benchmark.suite import BASELINES, read_suite, shipped_suites, suite_from_table
from cellwise.benchmark.suite_logs import check_files
from cellwise.errors import InputError

GOOD = """
estimators = ["ekf"]
start_errors = [0.0, -0.3]
faults = ["standard"]
[[fault]]
name = "mine"
current_offset_A = 0.2
voltage_lag_samples = 2
[[cell]]
name = "c"
drive = ["embedded:nmc_drive_a"]
[[log]]
cell = "c"
log = "embedded:nmc_drive_b"
"""


def parsed(text, tmp_path):
    return suite_from_table(tomllib.loads(text), "mine", tmp_path)


def test_a_suite_reads_as_it_is_written(tmp_path):
    suite = parsed(GOOD, tmp_path)
    assert suite.estimators == ("ekf", *BASELINES)
    assert suite.faults[-1] == Fault("mine", current_offset_A=0.2, voltage_lag_samples=2)
    assert suite.name == "mine"
    assert suite.logs[0].shown == "nmc_drive_b"
    check_files(suite, None)


@pytest.mark.parametrize("name", ["embedded", "leo", "flight", "panasonic", "a123"])
def test_shipped_suites_are_sound(name):
    suite = read_suite(name)
    assert name in shipped_suites()
    assert set(BASELINES) <= set(suite.estimators)
    assert len(suite.faults) >= 16
    assert {0.0, -0.1, -0.3} <= set(suite.start_errors)


@pytest.mark.parametrize("name", ["embedded", "leo", "flight"])
def test_suites_of_embedded_data_need_nothing_else(name):
    check_files(read_suite(name), None)


@pytest.mark.parametrize("name", ["panasonic", "a123"])
def test_suites_of_measured_cells_find_their_files(name, real_data):
    check_files(read_suite(name), real_data)


def test_measured_cells_without_a_folder_are_refused_with_the_way_out():
    with pytest.raises(InputError, match="CELLWISE_DATA"):
        check_files(read_suite("panasonic"), None)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('estimators = ["ekf"]', 'estimators = ["kalman"]', "estimator 'kalman'"),
        ('estimators = ["ekf"]', 'estimator = ["ekf"]', "key 'estimator' in the suite"),
        ('estimators = ["ekf"]', 'estimators = "ekf"', "a list"),
        ("[0.0, -0.3]", "[0.0, -30.0]", "start_errors = -30"),
        ("[0.0, -0.3]", '["wrong"]', "a number"),
        ('["standard"]', '["typhoon"]', "fault 'typhoon'"),
        ("current_offset_A = 0.2", "current_offset = 0.2", "key 'current_offset'"),
        ("current_offset_A = 0.2", 'current_offset_A = "0.2"', "a number"),
        ("voltage_lag_samples = 2", "voltage_lag_samples = 2.5", "a whole number"),
        ('name = "mine"', 'name = "noise"', "two of fault 'noise'"),
        ('cell = "c"', 'cell = "d"', "cell 'd' of log"),
        ('drive = ["embedded:nmc_drive_a"]', "", "neither a model nor a test"),
        ('drive = ["embedded:nmc_drive_a"]', 'drive = ["embedded:x@hot"]', "LOG@TEMPERATURE"),
        ('log = "embedded:nmc_drive_b"', 'log = "drive.csv"', "without soc0"),
        ('log = "embedded:nmc_drive_b"', "", "without 'log'"),
        ('name = "c"', "", "without 'name'"),
        ("[[cell]]", "[cell]", "tables"),
    ],
)
def test_what_is_wrong_is_said(old, new, said, tmp_path):
    assert old in GOOD
    with pytest.raises(InputError, match=said.replace("[", r"\[")):
        parsed(GOOD.replace(old, new, 1), tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("nmc_drive_b", "nmc_drive_a", "on which cell 'c' was identified"),
        ("embedded:nmc_drive_b", "embedded:nmc_drive_z", "data set 'nmc_drive_z'"),
    ],
)
def test_logs_have_to_be_there_and_held_out(old, new, said, tmp_path):
    suite = parsed(GOOD.replace(old, new, 1), tmp_path)
    with pytest.raises(InputError, match=said):
        check_files(suite, None)


def test_no_file_and_no_toml_are_refused(tmp_path):
    with pytest.raises(InputError, match="embedded, flight"):
        read_suite(tmp_path / "none.toml")
    bad = tmp_path / "bad.toml"
    bad.write_text("estimators = [", encoding="utf-8")
    with pytest.raises(InputError, match="no TOML"):
        read_suite(bad)


def test_what_is_known_of_a_log_stands_behind_an_at(tmp_path):
    stated = GOOD.replace(
        'log = "embedded:nmc_drive_b"', 'log = "drive.csv@25,soc0=0.9"\nreference_Ah = 5.0'
    )
    assert parsed(stated, tmp_path).logs[0].shown == "drive"
    with pytest.raises(InputError, match="one initial SOC"):
        parsed(stated + "soc0 = 0.8\n", tmp_path)
