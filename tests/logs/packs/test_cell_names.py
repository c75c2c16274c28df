"""Cells' columns under the names that loggers write, or under any that the user states."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs import read_log
from cellwise.logs.packs.cells import known_column
from cellwise.logs.reading import read_pack
from cellwise.logs.writing import write_columns
from cellwise.notices import texts

ROWS = 200
TIME = np.arange(ROWS) * 10.0
CURRENT = np.where((np.arange(ROWS) // 20) % 2 == 0, 20.0, 0.0)
VOLTS = (3.9 - 0.2 * np.arange(ROWS) / ROWS - 0.004 * CURRENT)[:, None] + [0.0, 0.01, 0.02]
FORMS = (
    "Cell {} (V)", "cell_voltage_{}", "Cell{}", "cellVoltage{}", "voltageCell{}", "cell {} mv",
    "Cell Voltage {} (mV)", "Cell{} Voltage", "VCell{}", "U_Zelle_{} [V]", "BMS Cell {} V",
    "Celda {} (V)", "C{} (V)", "sensor.bms_cell_voltage_{}", "cell-{}-voltage",
)  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_they_are_read_with_their_unit(tmp_path, form):
    factor = 1000.0 if "mv" in form.casefold() else 1.0
    cells = {form.format(k + 1): factor * VOLTS[:, k] for k in range(3)}
    path = write_columns({"time_s": TIME, "current_A": CURRENT, **cells}, tmp_path / "pack.csv")
    pack = read_pack(path)
    assert pack.names == ("cell_01", "cell_02", "cell_03")
    np.testing.assert_allclose(pack.cell_V, VOLTS)
    np.testing.assert_allclose(read_log(path).voltage_V, VOLTS.mean(axis=1))


@pytest.mark.parametrize(
    "name", ["Cell 1 SOC", "cell_1_temperature", "Cell Max", "cells", "Cell 1 T"]
)
def test_other_things_of_a_cell_are_no_voltages(name):
    assert known_column(name) is None


def test_names_without_a_unit_may_be_millivolts_and_may_count_from_zero(tmp_path):
    cells = {f"cells[{k}]": 1000.0 * VOLTS[:, k] for k in range(3)}
    path = write_columns({"time_s": TIME, "current_A": CURRENT, **cells}, tmp_path / "pack.csv")
    pack = read_pack(path)
    assert pack.names == ("cell_01", "cell_02", "cell_03")
    np.testing.assert_allclose(pack.cell_V, VOLTS)
    assert any("millivolts" in notice for notice in texts(pack.notices))


def test_any_name_can_be_stated(tmp_path):
    cells = {f"B{k + 1}": 1000.0 * VOLTS[:, k] for k in range(3)}
    path = write_columns({"t": TIME, "current_A": CURRENT, **cells}, tmp_path / "pack.csv")
    with pytest.raises(InputError, match="`channels="):
        read_pack(path)
    told = {"time_s": "t", **{f"cell_{k + 1:02d}_mV": f"B{k + 1}" for k in range(3)}}
    np.testing.assert_allclose(read_pack(path, channels=told).cell_V, VOLTS)
    with pytest.raises(InputError, match="no column 'X'"):
        read_pack(path, channels=told | {"cell_02_mV": "X"})
