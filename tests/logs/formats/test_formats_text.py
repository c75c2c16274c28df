"""Exports of testers as text: units, signs, states and counters come out as the truth."""

from __future__ import annotations

import ast
import gzip
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cellwise.errors import InputError
from cellwise.logs import read_log
from log_files import pulse_channels
from tester_files import clock, halves, step_counters, step_times, steps_of, table

TRUTH = pulse_channels()
T, I, V = (TRUTH[name] for name in ("time_s", "current_A", "voltage_V"))  # noqa: E741
Q, TEMP = TRUTH["ampere_hours"], TRUTH["temperature_C"]
CHARGED, DISCHARGED = halves(Q)
STEPS = steps_of(I)
STEP_TIME, MOVED = step_times(T, STEPS), step_counters(Q, STEPS)
WORD = np.where(I > 0, "D", np.where(I < 0, "C", "R"))
NOTHING = np.zeros(T.size)


def arbin_old():
    return table(
        {
            "Data_Point": np.arange(T.size),
            "Test_Time(s)": T,
            "Date_Time": ["09/13/2013 09:01:39"] * T.size,
            "Step_Index": STEPS,
            "Cycle_Index": NOTHING,
            "Current(A)": -I,
            "Voltage(V)": V,
            "Charge_Capacity(Ah)": CHARGED,
            "Discharge_Capacity(Ah)": DISCHARGED,
            "Internal_Resistance(Ohm)": NOTHING,
            "Aux_Temperature_1(C)": TEMP,
        }
    )


def arbin_new():
    return "\ufeff" + table(
        {
            "Date Time": ["09/13/2023 09:01:39.123"] * T.size,
            "Test Time (s)": T,
            "Step Time (s)": STEP_TIME,
            "Cycle Index": NOTHING,
            "Step Index": STEPS,
            "Current (A)": -I,
            "Voltage (V)": V,
            "Charge Capacity (Ah)": CHARGED,
            "Discharge Capacity (Ah)": DISCHARGED,
            "Aux_Temperature_1 (C)": TEMP,
        },
        end="\r\n",
    )


def arbin_database():
    """The names of the database, without units."""
    return table(
        {
            "Test_ID": NOTHING,
            "Data_Point": np.arange(T.size),
            "Test_Time": T,
            "Step_Index": STEPS,
            "Current": -I,
            "Voltage": V,
            "Charge_Capacity": CHARGED,
            "Discharge_Capacity": DISCHARGED,
        }
    )


def bdf_labels():
    return table(
        {
            "Test Time / s": T,
            "Voltage / V": V,
            "Current / A": -I,
            "Net Capacity / Ah": -Q,
            "Cycle Count / 1": NOTHING,
            "Step Count / 1": STEPS,
            "Ambient Temperature / degC": TEMP,
        }
    )


def bdf_machine_names():
    return table(
        {
            "test_time_second": T,
            "voltage_volt": V,
            "current_ampere": -I,
            "charging_capacity_ah": CHARGED,
            "discharging_capacity_ah": DISCHARGED,
            "temperature_t1_celsius": TEMP,
        }
    )


def maccor_old():
    return "Today's Date\t04/06/2016\nFilename:\tC:\\data\\cell.074\tProcedure:\tx\n" + table(
        {
            "Rec#": np.arange(T.size),
            "Cyc#": NOTHING,
            "Step": STEPS,
            "Test (Sec)": T,
            "Step (Sec)": STEP_TIME,
            "Amp-hr": MOVED,
            "Watt-hr": NOTHING,
            "Amps": np.abs(I),
            "Volts": V,
            "State": WORD,
            "ES": NOTHING,
            "DPt Time": ["04/06/2016 10:00:00"] * T.size,
            "Temp 1": TEMP,
        },
        sep="\t",
    )


def maccor_new():
    return table(
        {
            "Rec": np.arange(T.size),
            "Cycle P": NOTHING,
            "Cycle C": NOTHING,
            "Step": STEPS,
            "TestTime": [clock(t, day=True) for t in T],
            "StepTime": [clock(t, day=True) for t in STEP_TIME],
            "Cap. [mAh]": 1000 * MOVED,
            "Ener. [Wh]": NOTHING,
            "Current [mA]": 1000 * np.abs(I),
            "Voltage [V]": V,
            "Md": WORD,
            "ES": NOTHING,
        },
        sep="\t",
    )


def neware_new():
    word = np.where(I > 0, "CC DChg", np.where(I < 0, "CC Chg", "Rest"))
    return table(
        {
            "DataPoint": np.arange(T.size),
            "Cycle Index": NOTHING,
            "Step Index": STEPS,
            "Step Type": word,
            "Time": [clock(t) for t in STEP_TIME],
            "Total Time": [clock(t) for t in T],
            "Current(A)": -I,
            "Voltage(V)": V,
            "Capacity(Ah)": MOVED,
            "Chg. Cap.(Ah)": np.where(I < 0, MOVED, 0),
            "DChg. Cap.(Ah)": np.where(I > 0, MOVED, 0),
            "Date": ["2024-05-01 12:00:00"] * T.size,
            "T1(℃)": TEMP,
        }
    )


def neware_old():
    """Unsigned, in mA, with the time of the step only."""
    word = np.where(I > 0, "D_CC", np.where(I < 0, "C_CC", "R"))
    return table(
        {
            "Record number": np.arange(T.size),
            "State": word,
            "Steps": STEPS,
            "Current(mA)": 1000 * np.abs(I),
            "Voltage(V)": V,
            "CapaCity(mAh)": 1000 * MOVED,
            "Relative Time(h:min:s.ms)": [clock(t) for t in STEP_TIME],
        }
    )


def biologic(decimal="."):
    text = table(
        {
            "mode": NOTHING,
            "ox/red": NOTHING,
            "Ns": STEPS,
            "time/s": T,
            "Ewe/V": V,
            "<I>/mA": -1000 * I,
            "(Q-Qo)/mA.h": -1000 * Q,
            "Temperature/°C": TEMP,
        },
        sep="\t",
        end="\r\n",
    )
    head = "EC-Lab ASCII FILE\r\nNb header lines : 4\r\n\r\n"
    return (head + text.replace(".", decimal)).replace("mA,h", "mA.h")


def digatron():
    """Preamble, names, units, rows; the time of the program as a clock."""
    text = table(
        {
            "Time Stamp": ["10/21/2018 1:05:31 PM"] * T.size,
            "Step": STEPS,
            "Status": np.where(I > 0, "DCH", "PAU"),
            "Prog Time": [clock(t) for t in T],
            "Step Time": [clock(t) for t in STEP_TIME],
            "Cycle": NOTHING,
            "Cycle Level": NOTHING,
            "Procedure": ["551"] * T.size,
            "Voltage": V,
            "Current": -I,
            "Temperature": TEMP,
            "Capacity": -Q,
            "WhAccu": NOTHING,
            "Cnt": NOTHING,
        }
    )
    head, rows = text.split("\n", 1)
    units = ",,,,,,,,[V],[A],[C],[Ah],[Wh],[Cnt]\n"
    return "File:,cell_1,\nTest date:,10/21/2018\n\n" + head + "\n" + units + rows


def bitrode():
    word = np.where(I > 0, "DCHG", np.where(I < 0, "CHRG", "REST"))
    restarting = np.where(I > 0, -MOVED, MOVED)
    rows = table(
        {
            "Exclude": ["No"] * T.size,
            "Time(s)": T,
            "Cycle": NOTHING,
            "Loop": NOTHING,
            "Loop ": NOTHING,
            "Step": STEPS,
            "StepTime(s)": STEP_TIME,
            "Current(A)": -I,
            "Voltage(V)": V,
            "Capacity(Ah)": restarting,
            "Mode": word,
            "Data": [" "] * T.size,
        }
    )
    return rows.replace("\n", ",\n")  # every line ends with a comma


WRITERS = {
    "arbin-csv, old": (arbin_old, "arbin-csv"),
    "arbin-csv, new": (arbin_new, "arbin-csv"),
    "arbin-csv, database": (arbin_database, "arbin-csv"),
    "bdf-csv, labels": (bdf_labels, "bdf-csv"),
    "bdf-csv, machine names": (bdf_machine_names, "bdf-csv"),
    "maccor-text, old": (maccor_old, "maccor-text"),
    "maccor-text, new": (maccor_new, "maccor-text"),
    "neware-csv, new": (neware_new, "neware-csv"),
    "neware-csv, old": (neware_old, "neware-csv"),
    "biologic-mpt": (biologic, "biologic-mpt"),
    "biologic-mpt, comma": (lambda: biologic(","), "biologic-mpt"),
    "digatron-csv": (digatron, "digatron-csv"),
    "bitrode-csv": (bitrode, "bitrode-csv"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_an_export_is_read_as_the_truth(name, tmp_path):
    write, wanted = WRITERS[name]
    path = tmp_path / "export.dat"  # the name tells nothing
    encoding = "latin-1" if wanted == "biologic-mpt" else "utf-8"
    path.write_bytes(write().encode(encoding))
    log = read_log(path)
    assert log.format == wanted
    np.testing.assert_allclose(log.time_s, T, atol=1e-6)
    np.testing.assert_allclose(log.current_A, I, atol=1e-9)
    np.testing.assert_allclose(log.voltage_V, V, atol=1e-9)
    np.testing.assert_allclose(log.charge_Ah - log.charge_Ah[0], Q, atol=1e-9)
    if log.temperature_C is not None:
        np.testing.assert_allclose(log.temperature_C, TEMP)
    else:
        assert "temp" not in path.read_text(encoding=encoding).casefold()
    assert not any("LOOKS WRONG" in n or "does not know" in n for n in log.notices), log.notices


@pytest.mark.parametrize("name", WRITERS)
def test_an_export_is_read_from_gzip(name, tmp_path):
    path = tmp_path / "export.csv"
    path.write_bytes(gzip.compress(WRITERS[name][0]().encode()))
    assert read_log(path).format == WRITERS[name][1]


@pytest.mark.parametrize("sign", ["auto", "charge-positive"])
def test_a_maccor_file_that_has_signs_keeps_them(sign, tmp_path):
    text = maccor_old()
    head, rows = text.split("Rec#")[0], "Rec#" + text.split("Rec#")[1]
    lines = rows.splitlines()
    place = lines[0].split("\t").index("Amps")
    signed = [lines[0]]
    for line, current in zip(lines[1:], I, strict=True):
        cells = line.split("\t")
        cells[place] = repr(float(current))
        signed.append("\t".join(cells))
    path = tmp_path / "signed.txt"
    path.write_text(head + "\n".join(signed) + "\n")
    log = read_log(path, sign=sign)
    np.testing.assert_allclose(log.current_A, I if sign == "auto" else -I)


def test_an_unsigned_current_in_an_unknown_state_is_refused(tmp_path):
    path = tmp_path / "maccor.txt"
    path.write_text(maccor_old().replace("\tD\t", "\tZ\t"))
    with pytest.raises(InputError, match="without sign"):
        read_log(path)


def test_a_bdf_parquet_is_detected_by_its_columns(tmp_path):
    path = tmp_path / "log.parquet"
    columns = {"Test Time / s": T, "Voltage / V": V, "Current / A": -I, "Net Capacity / Ah": -Q}
    pq.write_table(pa.table(columns), path)
    log = read_log(path)
    assert log.format == "bdf-parquet"
    np.testing.assert_array_equal(log.current_A, I)
    np.testing.assert_array_equal(log.charge_Ah, Q)


def test_a_counter_that_restarts_with_every_cycle_is_joined(tmp_path):
    """Arbin's two capacities go to zero where a cycle begins; the net charge goes on."""
    half = T.size // 2
    charged, discharged = CHARGED.copy(), DISCHARGED.copy()
    charged[half:] -= charged[half - 1]
    discharged[half:] -= discharged[half - 1]
    path = tmp_path / "log.csv"
    path.write_text(
        table(
            {
                "Test_Time(s)": T,
                "Cycle_Index": (np.arange(T.size) >= half).astype(float),
                "Current(A)": -I,
                "Voltage(V)": V,
                "Charge_Capacity(Ah)": charged,
                "Discharge_Capacity(Ah)": discharged,
            }
        )
    )
    np.testing.assert_allclose(read_log(path).charge_Ah, Q, atol=1e-12)


def test_a_column_that_is_missing_is_named_with_the_nearest(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(arbin_old().replace("Current(A)", "Curent(A)"))
    with pytest.raises(InputError) as caught:
        read_log(path)
    assert "missing: Current(A)" in caught.value.found
    assert "'Data_Point'" in caught.value.found
    assert "'Curent(A)'" in caught.value.action
    assert "`channels={'current_A': 'Curent(A)'" in caught.value.action
    log = read_log(path, channels={"current_A": "Curent(A)"})
    np.testing.assert_array_equal(log.current_A, I)


def test_a_column_that_the_format_does_not_know_is_reported_with_the_nearest(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(arbin_old().replace("Aux_Temperature_1(C)", "Aux_Temperatur_1(C)"))
    notices = " ".join(read_log(path).notices)
    assert "'Aux_Temperatur_1(C)' (nearest: 'Aux_Temperature_1(C)')" in notices


def test_any_table_is_read_with_the_columns_told(tmp_path):
    path = tmp_path / "rig.csv"
    head = "rig 7\noperator: x\n"
    path.write_text(
        head + table({"t / ms": 1000 * T, "Strom": 1000 * I, "Klemme": V, "Raum": TEMP}, sep=";")
    )
    told = {"time_ms": "t / ms", "current_mA": "Strom", "voltage_V": "Klemme"}
    log = read_log(path, channels=told)
    np.testing.assert_allclose(log.time_s, T)
    np.testing.assert_allclose(log.current_A, I)
    np.testing.assert_allclose(log.voltage_V, V)


@pytest.mark.parametrize(
    ("names", "factors"),
    [
        (("Testzeit [s]", "Strom [mA]", "Spannung [V]"), (1, 1e3, 1)),
        (("t_sec", "Pack Current (mA)", "Cell Volts"), (1, 1e3, 1)),
        (("Zeit/ms", "I/A", "U/mV"), (1e3, 1, 1e3)),
        (("Time (h)", "Strom", "Ewe/V"), (1 / 3600, 1, 1)),
    ],
)
def test_the_advice_for_odd_headers_reads_them_in_their_units(names, factors, tmp_path):
    path = tmp_path / "odd.csv"
    values = (f * x for f, x in zip(factors, (T, I, V), strict=True))
    path.write_text(table(dict(zip(names, values, strict=True)), sep=";"))
    with pytest.raises(InputError) as caught:
        read_log(path)
    told = ast.literal_eval(re.search(r"`channels=({.*})`", caught.value.action)[1])
    log = read_log(path, channels=told)
    np.testing.assert_allclose(log.time_s, T, atol=1e-6)
    np.testing.assert_allclose(log.current_A, I, atol=1e-9)
    np.testing.assert_allclose(log.voltage_V, V, atol=1e-9)


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ({"current_A": "Strm"}, "Nearest: 'Strom'"),
        ({"curent_A": "Strom"}, "Did you mean current_A"),
    ],
)
def test_a_column_told_that_is_not_there(told, says, tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text(table({"time_s": T, "Strom": I, "voltage_V": V}))
    with pytest.raises(InputError) as caught:
        read_log(path, channels=told)
    assert says in caught.value.action


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("0d 00:00:01.50", 1.5),
        ("1d 02:03:04", 93784.0),
        ("  3d 00:00:00.25", 259200.25),
        ("100:00:00", 360000.0),
        ("12:34", 45240.0),
        ("7.25", 7.25),
        ("1-00:00:01", 86401.0),
    ],
)
def test_clocks(text, seconds, tmp_path):
    rows = f"1\t{text}\t1\t3.9\tD\n2\t{clock(seconds + 5, day=True)}\t1\t3.8\tD\n"
    path = tmp_path / "m.txt"
    path.write_text("Rec\tTestTime\tCurrent [A]\tVoltage [V]\tMd\n" + rows)
    assert read_log(path).time_s[0] == pytest.approx(seconds)


def test_a_cell_that_is_no_clock_is_refused(tmp_path):
    path = tmp_path / "m.txt"
    path.write_text(
        "Rec\tTestTime\tCurrent [A]\tVoltage [V]\tMd\n1\tsoon\t1\t3.9\tD\n2\t9\t1\t3\tD\n"
    )
    with pytest.raises(InputError, match="'soon' in column 'TestTime'"):
        read_log(path)
