"""Files as instruments store them: by their layouts, by tidy conversions by other hands."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.logs import FORMATS, inspect_log, read_log, reading
from cellwise.logs.files.columns import OWN, Channel, Unit
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.reading import read_pack
from cellwise.notices import texts
from log_files import pulse_channels, write_csv
from tester_files import (
    digatron_columns,
    write_mat5,
    write_mat73,
    write_mpr,
    write_nda,
    write_ndax,
)

for library in ("galvani", "fastnda", "h5py"):
    pytest.importorskip(library)

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
    assert not any("LOOKS WRONG" in n or "does not know" in n for n in texts(log.notices)), (
        log.notices
    )


def test_a_galvanostatic_biologic_file_has_its_current_from_the_charge(tmp_path):
    log = read_log(write_mpr(tmp_path / "log.mpr", TRUTH, current=False))
    np.testing.assert_allclose(log.current_A, TRUTH["current_A"], atol=1e-6)
    assert any("taken from the counter" in notice for notice in texts(log.notices))


def test_columns_of_a_matlab_file_can_be_stated(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "other.mat"
    c = digatron_columns(TRUTH)
    savemat(path, {"run": {"Zeit": c["Time"], "Strom": c["Current"], "Spannung": c["Voltage"]}})
    told = {"time_s": "Zeit", "current_A": "Strom", "voltage_V": "Spannung"}
    np.testing.assert_allclose(read_log(path, channels=told).current_A, TRUTH["current_A"])


# Native file to its tidy twin; both were converted independently of this package.
TWINS = {
    "arbin_a123_ocv_p25_s1.csv": ("plett_a123/ocv_p25_s1.csv.gz", "arbin-csv"),
    "bitrode_leaf_3c.csv": ("nissan_leaf/cap_3c_p23.csv.gz", "bitrode-csv"),
    "digatron_panasonic_c20_25degC.mat": ("panasonic_18650pf/ocv_c20_p25.csv.gz", "digatron-mat"),
    "ardupilot_dronekit-la_log171.bin": (
        "drone_logs/copter_4s_log171.csv.gz",
        "ardupilot-dataflash",
    ),
}
# The twins' own last digits; the Bitrode counter has steps of 0.01 Ah.
TOLERANCE = {"time_s": 0.006, "current_A": 6e-5, "voltage_V": 6e-5, "charge_Ah": 0.0055}


@pytest.mark.parametrize("name", TWINS)
def test_a_native_file_is_its_tidy_twin(name, real_data, tmp_path):
    pytest.importorskip("pymavlink")
    twin, wanted = TWINS[name]
    disguised = tmp_path / "log.xyz"  # told by content, not by name
    disguised.write_bytes((real_data / "native" / name).read_bytes())
    native, tidy = read_log(disguised), read_log(real_data / twin)
    packs = [n for n in texts(native.notices) if "LOOKS WRONG for one cell" in n]
    assert len(packs) == (wanted == "ardupilot-dataflash")  # a pack of four, read as one
    assert native.format == wanted
    start = native.time_s - native.time_s[0]
    if len(native) != len(tidy):  # the twin has no repeated stamps
        rows = np.searchsorted(start, tidy.time_s - 0.006)
        assert len(native) - len(tidy) <= 3
    else:
        rows = np.arange(len(native))
    np.testing.assert_allclose(start[rows], tidy.time_s, atol=TOLERANCE["time_s"])
    for field in ("current_A", "voltage_V", "charge_Ah"):
        found, expected = getattr(native, field)[rows], getattr(tidy, field)
        if field == "charge_Ah":
            found = found - found[0]
        share = np.mean(np.abs(found - expected) <= TOLERANCE[field])
        assert share > 0.999, (field, share)
    assert inspect_log(native).sign == "verified"
    others = [n for n in texts(native.notices) if n not in packs]
    assert not any("LOOKS WRONG" in n or "does not know" in n for n in others)


def test_the_ulog_of_pyulog_has_two_batteries(real_data):
    pytest.importorskip("pyulog")
    path = real_data / "native" / "px4_pyulog_sample_log_small.ulg"
    first, second = read_log(path, series="auto"), read_log(path, series="auto", instance=1)
    assert len(first) == len(second) == 21
    # Both are lithium-ion packs of which the log states 6 and 12 cells.
    assert 3.8 < first.voltage_V.mean() < 4.0
    assert 4.1 < second.voltage_V.mean() < 4.2
    assert first.temperature_C is None
    assert read_pack(path).cells == 6  # the first one's, by a process of its own


# A format is one record: how its content tells it, its columns, its sign.
CYCLER = Format(
    name="cycler",
    matches=lambda source: source.head.startswith(b"Zeit/ms"),
    channels=(
        Channel("time_s", {"Zeit/ms": Unit(1e-3)}, required=True),
        Channel("current_A", {"I/mA": Unit(1e-3)}, required=True),
        Channel("voltage_V", {"U/V": OWN}, required=True),
        Channel("charge_Ah", {"Q/Ah": OWN}),
    ),
    read=read_csv,
    sign="charge-positive",
)


def test_a_new_format_is_read_with_its_units_and_its_sign_unless_overridden(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "FORMATS", (CYCLER, *FORMATS))
    path = write_csv(
        tmp_path / "export.csv",
        {"Zeit/ms": 1000 * TRUTH["time_s"], "U/V": TRUTH["voltage_V"],
         "I/mA": -1000 * TRUTH["current_A"], "Q/Ah": -TRUTH["ampere_hours"]},
    )  # fmt: skip
    log = read_log(path)
    assert log.format == "cycler"
    np.testing.assert_allclose(log.time_s, TRUTH["time_s"], rtol=1e-15)
    np.testing.assert_allclose(log.current_A, TRUTH["current_A"], rtol=1e-15)
    np.testing.assert_array_equal(log.charge_Ah, TRUTH["ampere_hours"])
    assert not any("LOOKS WRONG" in notice for notice in texts(log.notices))
    other = read_log(path, sign="discharge-positive")
    np.testing.assert_array_equal(other.current_A, -log.current_A)
    assert any("`sign='charge-positive'`" in notice for notice in texts(other.notices))
