"""Files as the instruments wrote them, against their tidy conversions by other hands."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.logs import inspect_log, read_log

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
    packs = [n for n in native.notices if "LOOKS WRONG for one cell" in n]
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
    others = [n for n in native.notices if n not in packs]
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
