"""`identify --voltage-only`: remaining time by voltages, its band, and its forms for firmware."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.export.voltage_table import voltage_forms
from cellwise.identify.ocv.voltage_only import (
    VoltageLog,
    discharges_of,
    identify_voltage_table,
    read_voltage,
    read_voltage_table,
    write_voltage_table,
)

# Discharges of one cell in one kind of use: constant loads, drives, a life, rates together.
MEASURED = {
    "30Q at 1C over its life": "samsung_30q_ageing/d1_cellA_cycle???.csv.gz",
    "LiPo at 1C": "lipo_5450/c1_*.csv.gz",
    "LiPo at 1C to 4C": "lipo_5450/c?_*.csv.gz",
    "18650PF, drives at 25 degC": "panasonic_18650pf/drive_p25_*.csv.gz",
    "18650PF, drives at 10 degC": "panasonic_18650pf/drive_p10_[chlnu]*.csv.gz",
    "18650PF, drives at 0 degC": "panasonic_18650pf/drive_p00_*.csv.gz",
    "A123, drives at 5 to 45 degC": "plett_a123/dyn_p*_s1.csv.gz",
}


def discharge(hours, name="d", shape=lambda r: 3.0 + 1.2 * r, rows=600):
    """Voltages of a discharge, by what remains."""
    time = np.linspace(0.0, 3600.0 * hours, rows)
    return VoltageLog(name, time, shape(1.0 - time / time[-1]))


def test_a_straight_line_is_its_own_table():
    """However long a discharge took: the fraction is of its own time."""
    logs = [discharge(hours) for hours in (2.0, 10.0, 400.0)]
    table = identify_voltage_table(logs, average_s=1.0, full_V=4.19, empty_V=3.01)
    assert np.allclose(table.voltage_V, np.interp(table.remaining, [0, 1], [3.01, 4.19]), atol=4e-3)
    volts = np.linspace(3.1, 4.1, 50)
    assert np.allclose(table.remaining_at(volts), (volts - 3.01) / 1.18, atol=4e-3)
    assert (table.high - table.low).max() < 0.01
    assert np.allclose(table.hours, np.array([2.0, 10.0, 400.0]) * 1.18 / 1.2, rtol=0.01)


def test_the_band_holds_a_discharge_that_is_not_in_it():
    """Of cells and loads that differ: no less of them than it says, whatever their number."""
    rng = np.random.default_rng(5)
    held = []
    for _ in range(40):
        bends = rng.normal(1.0, 0.15, 6)
        logs = [discharge(5.0, shape=lambda r, b=b: 3.0 + 1.2 * r**b) for b in bends]
        table = identify_voltage_table(logs[1:], full_V=4.15, empty_V=3.05)
        new = discharges_of(logs[:1], table.full_V, table.empty_V, 60.0)[0].each[0]
        low, high = table.band_at(table.remaining_at(new.voltage_V))
        held.append(np.mean((low <= new.remaining) & (new.remaining <= high)))
    assert np.mean(held) >= 0.95


@pytest.mark.parametrize("cell", MEASURED)
def test_nine_tenths_of_measured_discharges_left_out_are_in_the_band(real_data, cell):
    """Each discharge in turn, its current never looked at, by the table of the others."""
    logs = [read_voltage(path) for path in sorted(real_data.glob(MEASURED[cell]))]
    logs = logs[:: 1 + len(logs) // 12]
    held, error = [], []
    for k, one in enumerate(logs):
        table = identify_voltage_table([*logs[:k], *logs[k + 1 :]])
        full = min(table.full_V, discharges_of([one], None, None, 60.0)[0].full_V)
        empty = max(table.empty_V, discharges_of([one], None, None, 60.0)[0].empty_V)
        for new in discharges_of([one], full, empty, 60.0)[0].each:
            said = table.remaining_at(new.voltage_V)
            low, high = table.band_at(said)
            held.append(np.mean((low <= new.remaining) & (new.remaining <= high)))
            error.append(np.sqrt(np.mean((said - new.remaining) ** 2)))
    assert len(held) >= len(logs) >= 4
    assert np.mean(held) >= 0.9
    # Better than what needs no voltage: that half of the time is left, uniform over 0 to 1.
    assert np.mean(error) < 0.5 * np.sqrt(1.0 / 12.0)


def test_what_is_no_discharge_is_left_out():
    """A charge before, a rest without rows, a charge behind, and a second discharge."""
    down, up = np.linspace(4.2, 3.0, 500), np.linspace(3.0, 4.2, 100)
    volts = np.concatenate([up, down, up, down, up])
    time = 60.0 * np.arange(volts.size)
    time[100:] += 7200.0  # a rest at full that nobody logged
    both = VoltageLog("both", time, volts)
    plain = VoltageLog("one", 60.0 * np.arange(500), down)
    table = identify_voltage_table([both, plain])
    assert np.allclose(table.hours, 500.0 / 60.0, atol=0.1)
    assert table.names == ("both", "both (2)", "one")
    assert (table.high - table.low).max() < 0.01


def test_a_hole_within_a_discharge_is_said():
    log = discharge(10.0, "holed")
    rows = np.r_[0:200, 300:600]
    holed = VoltageLog("holed", log.time_s[rows], log.voltage_V[rows])
    (notice,) = identify_voltage_table([holed, discharge(10.0)]).notices
    assert "'holed': 17 % of a discharge has no row" in notice.text


def test_a_log_that_shortens_all_is_said():
    short = discharge(5.0, "short", lambda r: 3.4 + 0.8 * r)
    (notice,) = identify_voltage_table([discharge(5.0), discharge(6.0), short]).notices
    assert notice.log == "short"
    assert "ends at 3.4" in notice.text


@pytest.mark.parametrize(
    ("logs", "options", "said"),
    [
        ([], {}, "no log"),
        ([discharge(5.0)], {}, "two or more"),
        ([discharge(5.0)] * 2, {"points": 2}, "3 to 101 points"),
        ([discharge(5.0)] * 2, {"average_s": 0.0}, "average over 0 s"),
        ([discharge(5.0)] * 2, {"average_s": np.nan}, "average over nan s"),
        ([discharge(5.0)] * 2, {"full_V": 4.5}, "which goes from"),
        ([discharge(5.0)] * 2, {"empty_V": 2.5}, "which goes from"),
        ([discharge(5.0)] * 2, {"full_V": 3.2, "empty_V": 3.9}, "full above empty"),
        ([discharge(0.1)] * 2, {"points": 51}, "fewer points"),
    ],
)
def test_refused(logs, options, said):
    with pytest.raises(InputError, match=said):
        identify_voltage_table(logs, **options)


def table_of_three():
    bends = ((3.0, 0.8), (5.0, 1.0), (9.0, 1.1))
    bent = [discharge(h, shape=lambda r, b=b: 3.0 + 1.2 * r**b) for h, b in bends]
    return identify_voltage_table(bent, points=21)


def test_written_and_read_again(tmp_path):
    table = table_of_three()
    write_voltage_table(table, tmp_path / "t.json")
    again = read_voltage_table(tmp_path / "t.json")
    assert json.dumps(again.to_dict()) == json.dumps(table.to_dict())
    for text in ("", "{}", '{"kind": "voltage table"}', "[1]"):
        (tmp_path / "no.json").write_text(text)
        with pytest.raises(InputError, match="no table of remaining time"):
            read_voltage_table(tmp_path / "no.json")


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_says_what_the_table_says(tmp_path):
    table = table_of_three()
    (tmp_path / "battery_table.h").write_text(voltage_forms(table)["battery_table.h"])
    (tmp_path / "main.c").write_text(
        '#include "battery_table.h"\n#include <stdio.h>\nint main(void) {\n'
        "    for (uint16_t v = 2800u; v < 4400u; v++) {\n        uint16_t a, b, r = "
        'battery_remaining(v, &a, &b);\n        printf("%u %u %u\\n", r, a, b);\n    }\n}\n'
    )
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-fsanitize=undefined"]
    subprocess.run(["cc", *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    said = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    thousandths = np.array([line.split() for line in said.splitlines()], float)
    remaining = table.remaining_at(np.arange(2800, 4400) / 1000.0)
    low, high = table.band_at(remaining)
    # A millivolt of rounding in the table, and the last thousandth is cut.
    slope = 1000.0 * np.max(np.diff(table.remaining) / np.diff(table.voltage_V)) / 1000.0
    assert np.abs(thousandths[:, 0] - 1000.0 * remaining).max() <= 1.0 + slope
    steepest = slope * np.max(np.abs(np.diff([table.low, table.high])) / np.diff(table.remaining))
    assert np.abs(thousandths[:, 1:].T - 1000.0 * np.array([low, high])).max() <= 1.5 + steepest


def test_forms_of_firmware():
    """Eleven voltages: rising in microvolts, falling in millivolts, pairs of volts and per cent."""
    files = voltage_forms(table_of_three())
    micro = [int(v) for v in re.search(r"table-0 = <(.*)>", files["zephyr.overlay"])[1].split()]
    milli = re.search(r"OCV_ARRAY (.*)", files["meshtastic_variant.h"])[1].split(", ")
    pairs = re.findall(r"- ([\d.]+) -> (\d+)", files["esphome.yaml"])
    assert len(micro) == 11
    assert min(np.diff(micro)) >= 1000
    assert [1000 * int(v) for v in reversed(milli)] == micro
    assert [round(1e6 * float(v)) for v, _ in pairs] == micro
    assert [int(p) for _, p in pairs] == list(range(0, 101, 10))


def test_flat_voltages_stay_apart_in_the_forms():
    """A plateau: connected by straight lines, two equal voltages would divide by zero."""
    flat = [discharge(5.0, shape=lambda r: np.where(r > 0.5, 3.3, 3.0 + 0.6 * r))] * 3
    flat = [
        VoltageLog("flat", f.time_s, f.voltage_V + np.where(f.time_s < 60, 0.2, 0)) for f in flat
    ]
    files = voltage_forms(identify_voltage_table(flat, average_s=1.0))
    pairs = re.findall(r"- ([\d.]+) -> (\d+)", files["esphome.yaml"])
    assert min(np.diff([float(v) for v, _ in pairs])) > 0.0009


def written(log, path, current=False):
    amperes = ",current_A" if current else ""
    lines = [f"time_s,voltage_V{amperes}"]
    rows = zip(log.time_s, log.voltage_V, strict=True)
    lines += [f"{t:.3f},{v:.4f}" + (",1.5" if current else "") for t, v in rows]
    path.write_text("\n".join(lines) + "\n")


def test_through_the_commands(tmp_path, capsys):
    """A log with a current, and the same without one, give the same table."""
    for k, hours in enumerate((4.0, 5.0, 7.0)):
        written(discharge(hours), tmp_path / f"with{k}.csv", current=True)
        written(discharge(hours), tmp_path / f"only{k}.csv")
    said = []
    for name in ("with", "only"):
        logs = [str(tmp_path / f"{name}{k}.csv") for k in range(3)]
        place = str(tmp_path / f"{name}.json")
        assert (
            main(["identify", "--voltage-only", *logs, "--points", "6", "-o", place, "--json"]) == 0
        )
        said.append(json.loads(capsys.readouterr().out))
    assert said[0]["voltage_V"] == said[1]["voltage_V"]
    unknown = [line.split(":")[0] for line in said[0]["unknown"]]
    assert unknown[:3] == ["capacity", "resistance", "the load"]
    model, folder = str(tmp_path / "only.json"), tmp_path / "out"
    assert main(["export", "--model", model, "--what", "table", "-o", str(folder), "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert sorted(files) == sorted(p.name for p in folder.iterdir())
    assert len((folder / "battery_table.csv").read_text().splitlines()) == 7


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("identify --voltage-only a.csv --hppc a.csv -o m.json", "Leave --hppc out"),
        ("identify --voltage-only a.csv --nominal-ah 2 -o m.json", "Leave --nominal-ah out"),
        ("identify --voltage-only a.csv -o m.json", "two or more"),
        ("export --model nmc-18650 --what table", "without -o"),
        ("export --model nmc-18650 --what table --dt 1 -o out", "--dt"),
        ("export --model nmc-18650 --what table -o out", "no table of remaining time"),
    ],
)
def test_refused_by_the_commands(tmp_path, capsys, monkeypatch, options, said):
    monkeypatch.chdir(tmp_path)
    written(discharge(5.0), tmp_path / "a.csv")
    assert main(options.split()) == 2
    assert said in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]
