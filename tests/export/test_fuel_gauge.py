"""The zephyr layout's fuel_gauge driver on a stub of documented names: properties, a restart.

Zephyr itself is not here: what is tested is our side of its API.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from cellwise.cell.protocol import ConstantCurrent, DriveProfile, run_protocol
from cellwise.export.c_tables import STRICT_FLAGS, put
from cellwise.export.firmware import Firmware
from cellwise.export.package import Export
from example_cells import curved_cell

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
STUB = Path(__file__).parent / "zephyr_stub"
DT_S = 5.0
NAMES = (
    "avg_current", "current", "cycle_count", "flags", "full_charge_capacity", "remaining_capacity",
    "runtime_to_empty", "runtime_to_full", "relative_state_of_charge", "temperature", "voltage",
)  # fmt: skip


@pytest.fixture(scope="module")
def export():
    return Export(curved_cell(), DT_S, layout="zephyr")


@pytest.fixture(scope="module", params=["application", "sensor"])
def program(request, export, tmp_path_factory):
    """The driver compiled with the stub, and a folder where settings are kept."""
    place = tmp_path_factory.mktemp("zephyr")
    unmeasured = {"targets": [], "accuracy": [], "sockets": {}, "notices": []}
    put(export.files(export.description | unmeasured), place)
    made = place / "app"
    folders = [f"-I{STUB}", f"-I{place}/include", f"-I{place}/drivers", f"-I{place}/src"]
    sources = [*place.glob("src/*.c"), *place.glob("drivers/*.c"), STUB / "main.c"]
    flags = ["-O2", *STRICT_FLAGS, "-Wall", "-Wextra", "-Werror", "-D_DEFAULT_SOURCE"]
    has = f"-DSTUB_HAS_SENSOR={int(request.param == 'sensor')}"
    flags.append("-DCONFIG_CELLWISE_FUEL_GAUGE_KEEP_MINUTES=10")
    done = subprocess.run(
        ["gcc", *flags, has, *folders, *map(str, sources), "-lm", "-o", str(made)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return made


def lived(program, rows, folder, how="go", period_ms=5000):
    """Properties after each row, by name."""
    text = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in rows)
    done = subprocess.run(
        [str(program), how, str(period_ms)],
        input=text,
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    assert not done.stderr
    found = np.array([line.split() for line in done.stdout.splitlines()], dtype=np.int64)
    return dict(zip(NAMES, found.T, strict=True))


@pytest.fixture(scope="module")
def log(export):
    """A load, then a charge, rounded as a sensor's value is."""
    rng = np.random.default_rng(2)
    capacity = export.model.capacity_Ah
    load = capacity * rng.uniform(0.2, 0.8, 120)
    steps = [
        DriveProfile(time_s=DT_S * np.arange(1.0, 121.0), current_A=load),
        ConstantCurrent(current_A=-0.4 * capacity, duration_s=300.0),
    ]
    return run_protocol(export.model, steps, 0.8, DT_S, 25.0).part(1, 180)


def test_every_property_is_what_replay_says(program, export, log, tmp_path):
    rows = np.column_stack([log.current_A, log.voltage_V, log.temperature_C])
    said = lived(program, rows, tmp_path)
    firmware = Firmware(export.seen.model, export.seen.noise, dt_s=DT_S)
    trace = firmware.run(log, 0.5, 0.3)
    capacity_uAh = 1e6 * export.model.capacity_Ah
    soc = np.clip(trace.soc, 0.0, 1.0)
    # What the device is handed has six decimals.
    assert np.abs(said["relative_state_of_charge"] - 100.0 * soc).max() <= 0.51
    np.testing.assert_allclose(
        said["remaining_capacity"], capacity_uAh * soc, atol=1e-4 * capacity_uAh
    )
    np.testing.assert_allclose(said["full_charge_capacity"], capacity_uAh, rtol=1e-5)
    np.testing.assert_allclose(said["current"], -1e6 * log.current_A, atol=3)
    np.testing.assert_allclose(said["voltage"], 1e6 * log.voltage_V, atol=3)
    np.testing.assert_allclose(said["temperature"], 10.0 * (log.temperature_C + 273.15), atol=0.6)
    assert np.array_equal(said["flags"], trace.status)
    assert not said["cycle_count"].any()  # refused as not supported
    falls = said["avg_current"] < 0
    assert falls[0]
    assert not falls[-1]
    minutes = -60.0 * said["remaining_capacity"] / said["avg_current"]
    assert np.abs(said["runtime_to_empty"] - minutes)[falls].max() <= 1.5
    assert np.all(said["runtime_to_empty"][~falls] == 65535)
    assert np.all(said["runtime_to_full"][falls] == 65535)
    missing_uAh = said["full_charge_capacity"] - said["remaining_capacity"]
    minutes = 60.0 * missing_uAh / np.where(falls, 1, said["avg_current"])
    assert np.abs(said["runtime_to_full"] - minutes)[~falls & (minutes < 6e4)].max() <= 1.5


def test_a_restart_goes_on_from_what_settings_kept(program, log, tmp_path):
    rows = np.column_stack([log.current_A, log.voltage_V, log.temperature_C])
    before = lived(program, rows[:100], tmp_path, "keep")["remaining_capacity"][-1]
    after = lived(program, rows[100:102], tmp_path)
    full = after["full_charge_capacity"][0]
    assert abs(after["remaining_capacity"][0] - before) < 0.01 * full
    (tmp_path / "1").write_bytes((tmp_path / "1").read_bytes()[:-4] + b"torn")
    torn = lived(program, rows[100:102], tmp_path)["remaining_capacity"][0]
    assert 0 <= torn <= full


@pytest.mark.parametrize("period_ms", [1300, 5500])
def test_charge_is_what_flowed_however_often_the_driver_is_called(
    program, export, tmp_path, period_ms
):
    """A work queue that is late by a tenth takes nothing; between two steps the mean counts."""
    rows = np.tile([1.0, 3.7, 25.0], (200, 1))
    rows[:, 0] += np.tile([0.5, -0.5], 100)
    rows[:, 1] = np.nan  # no voltage corrects it
    said = lived(program, rows, tmp_path, period_ms=period_ms)["remaining_capacity"]
    first = 10  # steps are there
    flowed_uAh = 1e6 * (200 - first) * period_ms / 3.6e6
    assert said[first - 1] - said[-1] == pytest.approx(flowed_uAh, abs=1e6 * 1.5 * DT_S / 3600.0)


def test_a_reading_that_is_missing_has_no_value_and_leaves_the_mean(program, log, tmp_path):
    rows = np.column_stack([log.current_A, log.voltage_V, log.temperature_C])[:40]
    whole = lived(program, rows, tmp_path)
    rows[20] = np.nan
    said = lived(program, rows, tmp_path)
    for name in ("current", "voltage", "temperature"):
        assert said[name][20] == -9  # refused
        assert said[name][21] == whole[name][21]
    assert said["avg_current"][20] == whole["avg_current"][19]
    assert 0 < said["runtime_to_empty"][39] < 65535


def test_settings_that_are_loaded_after_the_first_step_count_once(program, log, tmp_path):
    rows = np.column_stack([log.current_A, log.voltage_V, log.temperature_C])
    before = lived(program, rows[:100], tmp_path, "keep")["remaining_capacity"][-1]
    shutil.copytree(tmp_path, tmp_path / "same")  # each writes by itself where the SOC has moved
    after = lived(program, rows[100:120], tmp_path, "late")
    in_time = lived(program, rows[101:120], tmp_path / "same")
    full = after["full_charge_capacity"][0]
    assert abs(after["remaining_capacity"][1] - before) < 0.01 * full
    assert (
        np.abs(after["remaining_capacity"][1:] - in_time["remaining_capacity"]).max() < 0.002 * full
    )


def test_a_node_with_a_sensor_keeps_its_state_every_ten_minutes(program, log, tmp_path, request):
    rows = np.column_stack([log.current_A, log.voltage_V, log.temperature_C])
    lived(program, rows[:130], tmp_path)
    is_sensor = request.node.callspec.params["program"] == "sensor"
    assert (tmp_path / "1").exists() == is_sensor
