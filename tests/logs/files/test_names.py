"""Columns of no format's names are taken where word and unit leave one choice, else refused."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.logs import read_log
from cellwise.notices import texts
from log_files import pulse_channels

PULSES = pulse_channels()
FACTORS = {"s": 1.0, "ms": 1e3, "h": 1 / 3600.0, "A": 1.0, "mA": 1e3, "V": 1.0, "mV": 1e3}
NAMED = {
    "English": ("Time [s]", "s", "Current (mA)", "mA", "Voltage / V", "V"),
    "German": ("Zeit (ms)", "ms", "Strom [A]", "A", "Spannung (mV)", "mV"),
    "French": ("Temps (h)", "h", "Courant (A)", "A", "Tension (V)", "V"),
    "units as names": ("Seconds", "s", "Amps", "A", "Volts", "V"),
}


def written(folder, time, time_unit, current, current_unit, voltage, voltage_unit, sign=1.0):
    """A log of pulses under these names."""
    columns = (
        (time, PULSES["time_s"] * FACTORS[time_unit]),
        (current, sign * PULSES["current_A"] * FACTORS[current_unit]),
        (voltage, PULSES["voltage_V"] * FACTORS[voltage_unit]),
        ("Temperatur (°C)", PULSES["temperature_C"]),
    )
    rows = zip(*(values.tolist() for _, values in columns), strict=True)
    lines = [";".join(name for name, _ in columns), *(";".join(map(repr, row)) for row in rows)]
    path = folder / "rig.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["discharge positive", "charge positive"])
@pytest.mark.parametrize("names", NAMED.values(), ids=NAMED)
def test_word_and_unit_are_enough_and_the_voltage_gives_the_sign(tmp_path, capsys, names, sign):
    path = written(tmp_path, *names, sign=sign)
    assert main(["inspect", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert any("sign of the current" in n and "by the voltage" in n for n in found["notices"])
    assert sum("by its name" in n for n in found["notices"]) == 4
    log = read_log(path)
    np.testing.assert_allclose(log.time_s, PULSES["time_s"], rtol=1e-9)
    np.testing.assert_allclose(log.current_A, PULSES["current_A"], rtol=1e-9)
    np.testing.assert_allclose(log.voltage_V, PULSES["voltage_V"], rtol=1e-9)
    np.testing.assert_array_equal(log.temperature_C, PULSES["temperature_C"])


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_time_of_dates_needs_no_unit(tmp_path, suffix):
    frame = pd.DataFrame(
        {
            "Timestamp": pd.to_datetime("2024-05-01 10:00")
            + pd.to_timedelta(PULSES["time_s"], "s"),
            "Current (A)": PULSES["current_A"],
            "Voltage (V)": PULSES["voltage_V"],
        }
    )
    path = tmp_path / f"rig.{suffix}"
    frame.to_csv(path, index=False) if suffix == "csv" else frame.to_parquet(path)
    np.testing.assert_allclose(read_log(path).time_s, PULSES["time_s"], atol=1e-6)


def test_a_stated_sign_goes_before_what_the_voltage_says(tmp_path):
    path = written(tmp_path, *NAMED["German"])
    log = read_log(path, sign="charge-positive")
    np.testing.assert_allclose(log.current_A, -PULSES["current_A"], rtol=1e-9)


def test_a_sign_that_nobody_says_is_said(tmp_path):
    path = tmp_path / "rest.csv"
    rows = "\n".join(f"{k};0.0;3.7" for k in range(100))
    path.write_text(f"Zeit [s];Strom [A];Spannung [V]\n{rows}\n")
    assert any("nor does the voltage" in n for n in texts(read_log(path).notices))


@pytest.mark.parametrize(
    "header",
    [
        "Time;Current;Voltage",  # no unit
        "Time;Current [A];Voltage [V]",  # of the time, and no dates
        "Time [s];Current [V];Voltage [V]",  # that of another quantity
        "Time [s];Current [A];Strom [A];Voltage [V]",  # two to choose from
        "Time [s];Fan current [A];Voltage [V]",  # of something else, perhaps
        "Step time [s];Current [A];Voltage [V]",
    ],
)
def test_anything_less_is_refused_with_what_to_do(tmp_path, header):
    path = tmp_path / "rig.csv"
    cells = ";".join("1.0" for _ in header.split(";"))
    path.write_text(f"{header}\n{cells}\n{cells}\n")
    with pytest.raises(InputError, match="channels="):
        read_log(path)
