"""Testers' own binary files, written from their layouts, are read as the truth."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.logs import read_log
from log_files import pulse_channels
from tester_files import (
    digatron_columns,
    write_mat5,
    write_mat73,
    write_mpr,
    write_nda,
    write_ndax,
)

pytest.importorskip("galvani")
pytest.importorskip("fastnda")
pytest.importorskip("h5py")

TRUTH = pulse_channels()
WRITERS = {
    "nda": (write_nda, "neware-nda"),
    "ndax": (write_ndax, "neware-nda"),
    "mpr": (write_mpr, "biologic-mpr"),
    "mat 5": (write_mat5, "digatron-mat"),
    "mat 7.3": (write_mat73, "digatron-mat"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_binary_file_is_read_as_the_truth(name, tmp_path):
    write, wanted = WRITERS[name]
    log = read_log(write(tmp_path / "log.dat", TRUTH))  # the name tells nothing
    assert log.format == wanted
    np.testing.assert_allclose(log.time_s, TRUTH["time_s"], atol=1e-3)
    np.testing.assert_allclose(log.current_A, TRUTH["current_A"], atol=1e-4)
    np.testing.assert_allclose(log.voltage_V, TRUTH["voltage_V"], atol=1e-4)  # 0.1 mV, float32
    charge = log.charge_Ah - log.charge_Ah[0]
    np.testing.assert_allclose(charge, TRUTH["ampere_hours"], atol=2e-6)
    assert not any("LOOKS WRONG" in n or "does not know" in n for n in log.notices), log.notices


def test_a_galvanostatic_biologic_file_has_its_current_from_the_charge(tmp_path):
    log = read_log(write_mpr(tmp_path / "log.mpr", TRUTH, current=False))
    np.testing.assert_allclose(log.current_A, TRUTH["current_A"], atol=1e-6)
    assert any("taken from the counter" in notice for notice in log.notices)


def test_columns_of_a_matlab_file_can_be_stated(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "other.mat"
    c = digatron_columns(TRUTH)
    savemat(path, {"run": {"Zeit": c["Time"], "Strom": c["Current"], "Spannung": c["Voltage"]}})
    told = {"time_s": "Zeit", "current_A": "Strom", "voltage_V": "Spannung"}
    np.testing.assert_allclose(read_log(path, channels=told).current_A, TRUTH["current_A"])
