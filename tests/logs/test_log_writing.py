"""Logs are written whole or not at all, and read back bit for bit."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from cellwise.cli import main
from cellwise.data import load_dataset
from cellwise.files import write_atomically
from cellwise.logs import CellLog, read_log, write_log
from cellwise.logs.writing import write_columns

FIELDS = ("time_s", "current_A", "voltage_V", "temperature_C", "charge_Ah", "step")


def rough_log(n: int = 3000, **more) -> CellLog:
    """Numbers of all sizes with all their digits, holes, repeated stamps."""
    rng = np.random.default_rng(9)
    current = rng.normal(0, 1, n) * 10.0 ** rng.integers(-9, 3, n)
    current[::50] = np.nan
    time = np.cumsum(rng.exponential(1.0, n))
    time[n // 2] = time[n // 2 - 1]
    return CellLog(
        time,
        current,
        3.7 + rng.normal(0, 0.1, n),
        temperature_C=np.where(rng.random(n) < 0.2, np.nan, 25 + rng.normal(0, 1, n)),
        charge_Ah=np.cumsum(np.nan_to_num(current) * np.diff(time, prepend=0.0)) / 3600.0,
        step=rng.integers(0, 9, n),
        **more,
    )


STANDARD = ["bdf", "bdf.gz", "bdf.csv", "bdf.csv.gz", "bdf.parquet"]


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "parquet", "CSV", "mat", *STANDARD])
def test_round_trip_to_the_last_bit(tmp_path, suffix):
    log = rough_log()
    path = write_log(log, tmp_path / f"out.{suffix}")
    again = read_log(path)
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(again, field), getattr(log, field), err_msg=field)
    assert os.listdir(tmp_path) == [path.name]


def test_matlab_finds_columns_in_a_structure_positive_on_charge(tmp_path):
    log = rough_log(50)
    found = scipy.io.loadmat(write_log(log, tmp_path / "out.mat"))["meas"][0, 0]
    assert found["Time"].shape == (50, 1)
    np.testing.assert_array_equal(found["Current"][:, 0], -log.current_A)
    np.testing.assert_array_equal(found["Ah"][:, 0], -log.charge_Ah)


@pytest.mark.parametrize("suffix", ["bdf.csv", "bdf.parquet"])
def test_the_library_of_the_battery_data_format_takes_it(tmp_path, suffix, recwarn):
    bdf = pytest.importorskip("bdf", reason="no batterydf: pip install batterydf")
    log = load_dataset("nmc_drive_a")
    write_log(log, tmp_path / "log.csv")
    place = tmp_path / f"log.{suffix}"
    assert main(["convert", str(tmp_path / "log.csv"), "-o", str(place)]) == 0
    table = bdf.read(place)
    bdf.validate(table, raise_on_error=True)
    np.testing.assert_array_equal(table["Current / A"], -log.current_A)
    np.testing.assert_array_equal(table["Voltage / V"], log.voltage_V)
    np.testing.assert_array_equal(table["Test Time / s"], log.time_s)


def test_only_the_channels_there_are(tmp_path):
    log = CellLog(np.arange(3.0), np.ones(3), np.full(3, 3.7))
    path = write_log(log, tmp_path / "out.csv")
    assert path.read_text() == "time_s,current_A,voltage_V\n0,1,3.7\n1,1,3.7\n2,1,3.7\n"


def test_the_same_log_makes_the_same_bytes(tmp_path):
    log = rough_log(500)
    for suffix in ("csv", "csv.gz", "parquet"):
        first = write_log(log, tmp_path / f"a.{suffix}").read_bytes()
        assert write_log(log, tmp_path / f"b.{suffix}").read_bytes() == first


def test_the_tidy_form_has_one_meaning_of_the_current(tmp_path):
    log = rough_log(current_meaning="interval_start")
    again = read_log(write_log(log, tmp_path / "out.parquet"))
    np.testing.assert_array_equal(again.interval_current_A, log.interval_current_A)


def test_a_failing_writer_leaves_what_was_there(tmp_path):
    target = tmp_path / "out.csv"
    target.write_text("before")

    def fails(path: Path) -> None:
        path.write_text("half a fi")
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        write_atomically(target, fails)
    assert target.read_text() == "before"
    assert os.listdir(tmp_path) == ["out.csv"]


def test_a_link_keeps_pointing_where_it_points(tmp_path):
    real = tmp_path / "real.csv"
    real.write_text("old")
    link = tmp_path / "link.csv"
    link.symlink_to(real)
    write_atomically(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"


def test_new_files_have_the_usual_permissions(tmp_path):
    plain = tmp_path / "plain"
    plain.write_text("")
    written = write_atomically(tmp_path / "written", "")
    assert written.stat().st_mode == plain.stat().st_mode


def test_a_device_is_written_to_directly():
    assert write_atomically("/dev/null", "text") == Path("/dev/null")
    assert not Path("/dev/null").is_file()


COLUMNS = {
    "time_s": np.array([0.0, 0.1, 1e6]),
    "soc": np.array([1.0, 1.0 / 3.0, np.nan]),
    "status": np.array([0, 4, 7], dtype=np.uint8),
}


@pytest.mark.parametrize("name", ["out.csv", "out.csv.gz", "out.parquet", "OUT.CSV"])
def test_columns_come_back_to_the_last_digit(tmp_path, name):
    path = write_columns(COLUMNS, tmp_path / name)
    assert path == tmp_path / name
    found = pd.read_parquet(path) if name.endswith("parquet") else pd.read_csv(path)
    assert list(found.columns) == list(COLUMNS)
    for key, values in COLUMNS.items():
        np.testing.assert_array_equal(found[key].to_numpy(dtype=float), values.astype(float))
