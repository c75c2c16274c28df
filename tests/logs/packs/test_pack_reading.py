"""A pack's log is read whole, and what is wrong with its cells is said before any model."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs.packs.pack_log import PackLog
from cellwise.logs.reading import read_pack
from cellwise.logs.writing import write_columns
from cellwise.notices import texts

ROWS = 400


def measured(cells=4, rows=ROWS, seed=0):
    """Time, current, cells' voltages of a pack under a load that comes and goes."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) * 2.0
    current = np.where((np.arange(rows) // 40) % 2 == 0, 20.0, 0.0)
    mean = 3.9 - 0.2 * np.arange(rows) / rows - 0.004 * current
    volts = mean[:, None] + rng.normal(0.0, 0.001, (rows, cells))
    return time, current, volts


def table_of(time, current, volts, unit="V", **extra):
    factor = 1000.0 if unit == "mV" else 1.0
    cells = {f"cell_{k + 1:02d}_{unit}": factor * v for k, v in enumerate(volts.T)}
    return {"time_s": time, "current_A": current, **cells, **extra}


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
@pytest.mark.parametrize("unit", ["V", "mV"])
def test_the_tidy_form_of_a_pack_is_read(tmp_path, suffix, unit):
    time, current, volts = measured()
    path = write_columns(table_of(time, current, volts, unit), tmp_path / f"pack{suffix}")
    pack = read_pack(path)
    assert pack.names == ("cell_01", "cell_02", "cell_03", "cell_04")
    np.testing.assert_allclose(pack.cell_V, volts, rtol=1e-12)
    np.testing.assert_allclose(pack.mean.voltage_V, volts.mean(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(pack.mean.current_A, current)
    assert pack.flags == ()
    assert not any("cell_" in notice for notice in texts(pack.notices))


def test_names_of_leafspy_are_known_and_its_negative_voltages_are_balancing(tmp_path):
    time, current, volts = measured(3)
    table = {"time_s": time, "current_A": current}
    table |= {f"CP{k + 1}": 1000.0 * v for k, v in enumerate(volts.T)}
    table["CP2"] = np.where(np.arange(ROWS) < 30, -table["CP2"], table["CP2"])
    pack = read_pack(write_columns(table, tmp_path / "leaf.csv"))
    np.testing.assert_allclose(pack.cell_V, volts, rtol=1e-12)
    assert pack.balancing is not None
    assert np.flatnonzero(pack.balancing[:, 1]).tolist() == list(range(30))
    assert not pack.balancing[:, [0, 2]].any()
    assert [flag.kind for flag in pack.flags] == ["balancing"]


def test_the_mean_of_temperature_sensors_and_the_voltage_of_the_pack(tmp_path):
    time, current, volts = measured()
    table = table_of(
        time, current, volts, temperature_1_C=np.full(ROWS, 20.0),
        temperature_2_C=np.full(ROWS, 24.0), voltage_V=volts.sum(axis=1),
    )  # fmt: skip
    pack = read_pack(write_columns(table, tmp_path / "pack.csv"))
    np.testing.assert_allclose(pack.mean.temperature_C, 22.0)
    np.testing.assert_allclose(pack.pack_V, volts.sum(axis=1))
    assert pack.flags == ()


def test_what_is_stated_behind_the_path_holds(tmp_path):
    path = write_columns(table_of(*measured()), tmp_path / "pack.csv")
    pack = read_pack(f"{path}@temperature_C=5,soc0=0.9")
    assert pack.mean.soc0 == 0.9
    np.testing.assert_array_equal(pack.mean.temperature_C, np.full(ROWS, 5.0))


def test_a_pack_without_one_column_says_which(tmp_path):
    time, current, volts = measured(5)
    table = table_of(time, current, volts, voltage_V=volts.sum(axis=1))
    del table["cell_03_V"]
    pack = read_pack(write_columns(table, tmp_path / "pack.csv"))
    assert pack.names == ("cell_01", "cell_02", "cell_04", "cell_05")
    assert {flag.kind for flag in pack.flags} == {"missing", "count"}
    assert any("cell_03" in notice for notice in texts(pack.notices))
    assert any("5.0 cells in series, and 4" in notice for notice in texts(pack.notices))


@pytest.mark.parametrize("since", [0, 250])
@pytest.mark.parametrize("reading", [0.0, np.nan, 65.535])
def test_a_dead_sensor_is_named_and_what_it_read_before_is_used(reading, since):
    time, current, volts = measured(6)
    broken = volts.copy()
    broken[since:, 2] = reading
    pack = PackLog.from_arrays(time, current, broken)
    assert [(flag.cell, flag.kind) for flag in pack.flags] == [("cell_03", "dead")]
    assert ("from row 251 on" in pack.flags[0].text) == (since > 0)
    np.testing.assert_array_equal(pack.cell_V[:since, 2], volts[:since, 2])
    assert np.all(np.isnan(pack.cell_V[since:, 2]))
    others = np.delete(volts, 2, axis=1)[since:]
    atol = 1e-12 if since == 0 else 1e-3  # its usual difference from the others is added
    np.testing.assert_allclose(pack.mean.voltage_V[since:], others.mean(axis=1), atol=atol)


def test_cells_that_miss_the_last_rows_together_are_not_dead():
    time, current, volts = measured(6)
    volts[250:, [0, 1, 2, 3, 5]] = np.nan
    pack = PackLog.from_arrays(time, current, volts)
    assert {flag.kind for flag in pack.flags} == {"missing"}


def test_a_cell_whose_wires_are_reversed_is_not_taken_as_balanced_in_silence():
    time, current, volts = measured(6)
    volts[:, 3] *= -1.0
    pack = PackLog.from_arrays(time, current, volts)
    said = [flag.text for flag in pack.flags if flag.cell == "cell_04"]
    assert len(said) == 1
    assert "reversed" in said[0]
    assert "not estimated" in said[0]


def test_a_frozen_sensor_is_named_and_a_quiet_rest_is_not():
    time, current, volts = measured(6)
    frozen = volts.copy()
    frozen[:, 4] = frozen[0, 4]
    pack = PackLog.from_arrays(time, current, frozen)
    assert [(flag.cell, flag.kind) for flag in pack.flags] == [("cell_05", "frozen")]
    resting = np.full_like(volts, 3.7)
    assert PackLog.from_arrays(time, 0.0 * current, resting).flags == ()


def test_a_cell_that_misses_rows_does_not_move_the_mean_by_its_level():
    time, current, volts = measured(4)
    apart = volts + np.array([0.0, 0.0, 0.0, 0.030])
    gone = apart.copy()
    gone[100:150, 3] = np.nan
    pack = PackLog.from_arrays(time, current, gone)
    np.testing.assert_allclose(pack.mean.voltage_V, apart.mean(axis=1), atol=0.003)
    assert [flag.kind for flag in pack.flags] == ["missing"]


def test_single_readings_far_off_do_not_move_the_mean():
    time, current, volts = measured(8)
    spiky = volts.copy()
    spiky[200, 5] += 0.2
    pack = PackLog.from_arrays(time, current, spiky)
    np.testing.assert_allclose(pack.mean.voltage_V, volts.mean(axis=1), atol=0.001)


@pytest.mark.parametrize(
    ("volts", "says"),
    [(np.full((ROWS, 4), 3700.0), "cell_01_mV"), (np.full((ROWS - 1, 4), 3.7), "cells"),
     (np.full(ROWS, 3.7), r"\(400, cells\)")],
    ids=["millivolts", "fewer rows", "one column"],
)  # fmt: skip
def test_what_is_no_voltage_of_each_cell_is_refused(volts, says):
    time, current, _ = measured()
    with pytest.raises(InputError, match=says):
        PackLog.from_arrays(time, current, volts)


def test_a_log_of_one_cell_is_refused(tmp_path):
    time, current, volts = measured()
    path = write_columns(
        {"time_s": time, "current_A": current, "voltage_V": volts[:, 0]}, tmp_path / "one.csv"
    )
    with pytest.raises(InputError, match="cell_01_V"):
        read_pack(path)
