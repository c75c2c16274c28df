"""Exports as text, from their public descriptions: units, signs, states, counters as the truth."""

from __future__ import annotations

import ast
import datetime
import gzip
import re
from typing import NamedTuple

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs import read_log
from cellwise.notices import texts
from log_files import pulse_channels
from tester_files import clock, halves, step_counters, step_times, steps_of, table, write_mpr

TRUTH = pulse_channels()
T, I, V = (TRUTH[name] for name in ("time_s", "current_A", "voltage_V"))  # noqa: E741
Q, TEMP = TRUTH["ampere_hours"], TRUTH["temperature_C"]
STEPS = steps_of(I)
STEP_TIME, MOVED = step_times(T, STEPS), step_counters(Q, STEPS)
START = datetime.datetime(2024, 5, 9, 23, 55)


def stamps(pattern):
    return [(START + datetime.timedelta(seconds=t)).strftime(pattern) for t in T]


def words(discharge, charge, rest):
    return np.where(I > 0, discharge, np.where(I < 0, charge, rest))


# What a layout's columns are made of.
CHANNELS = {
    "t": T, "dt": STEP_TIME, "i": I, "v": V, "q": Q, "moved": MOVED, "temp": TEMP, "step": STEPS,
    "charged": halves(Q)[0], "discharged": halves(Q)[1], "n": np.arange(T.size),
    "zero": np.zeros(T.size), "one": np.ones(T.size), "stamps": stamps, "words": words,
    "abs": np.abs, "where": np.where, "clocks": lambda x, day=False: [clock(s, day) for s in x],
}  # fmt: skip


def columns_of(said):
    """``Column = channels; ...``, every column of one text in all rows the same."""
    pairs = (part.split(" = ") for part in said.replace("\n", " ").split("; "))
    found = {name: eval(made, dict(CHANNELS)) for name, made in pairs}
    return {name: [x] * T.size if isinstance(x, str) else x for name, x in found.items()}


class Layout(NamedTuple):
    """A format's name, its columns, what separates them, what stands above them."""

    format: str
    columns: str
    sep: str = ","
    end: str = "\n"
    above: str = ""

    def text(self):
        return self.above + table(columns_of(self.columns), self.sep, self.end)


def commas(text):
    """The same text with decimal commas; its cells must not be separated by commas."""
    return text.replace(".", ",")


ARBIN = """Data_Point = n; Test_Time(s) = t; Date_Time = '09/13/2013 09:01:39'; Step_Index = step;
Cycle_Index = zero; Current(A) = -i; Voltage(V) = v; Charge_Capacity(Ah) = charged;
Discharge_Capacity(Ah) = discharged; Internal_Resistance(Ohm) = zero; Aux_Temperature_1(C) = temp"""
ARBIN_NEW = """Date Time = '09/13/2023 09:01:39.123'; Test Time (s) = t; Step Time (s) = dt;
Cycle Index = zero; Step Index = step; Current (A) = -i; Voltage (V) = v;
Charge Capacity (Ah) = charged; Discharge Capacity (Ah) = discharged;
Aux_Temperature_1 (C) = temp"""
DATABASE = """Test_ID = zero; Data_Point = n; Test_Time = t; Step_Index = step; Current = -i;
Voltage = v; Charge_Capacity = charged; Discharge_Capacity = discharged"""
MACCOR = """Rec# = n; Cyc# = zero; Step = step; Test (Sec) = t; Step (Sec) = dt; Amp-hr = moved;
Watt-hr = zero; Amps = AMPS; Volts = v; State = words('D', 'C', 'R'); ES = zero;
DPt Time = '04/06/2016 10:00:00'; Temp 1 = temp"""
MACCOR_NEW = """Rec = n; Cycle P = zero; Cycle C = zero; Step = step;
TestTime = clocks(t, day=True); StepTime = clocks(dt, day=True); Cap. [mAh] = 1e3 * moved;
Ener. [Wh] = zero; Current [mA] = 1e3 * abs(i); Voltage [V] = v; Md = words('D', 'C', 'R');
ES = zero"""
NEWARE = """DataPoint = n; Cycle Index = zero; Step Index = step;
Step Type = words('CC DChg', 'CC Chg', 'Rest'); Time = clocks(dt); Total Time = clocks(t);
Current(A) = -i; Voltage(V) = v; Capacity(Ah) = moved; Chg. Cap.(Ah) = where(i < 0, moved, 0);
DChg. Cap.(Ah) = where(i > 0, moved, 0); Date = '2024-05-01 12:00:00'; T1(℃) = temp"""
NEWARE_OLD = """Record number = n; State = words('D_CC', 'C_CC', 'R'); Steps = step;
Current(mA) = 1e3 * abs(i); Voltage(V) = v; CapaCity(mAh) = 1e3 * moved;
Relative Time(h:min:s.ms) = clocks(dt)"""
NEWARE_CUMULATIVE = """DataPoint = n; Step Index = step;
Step Type = words('CC DChg', 'CC Chg', 'Rest'); Time = clocks(dt); Cumulative Time = clocks(t);
Current(A) = -i; Voltage(V) = v; Chg. Cap.(Ah) = charged; DChg. Cap.(Ah) = discharged"""
BIOLOGIC = """mode = zero; ox/red = zero; Ns = step; time/s = t; Ewe/V = v; <I>/mA = -1e3 * i;
(Q-Qo)/mA.h = -1e3 * q; Temperature/°C = temp"""
TWO_ELECTRODES = """mode = one; time/s = t; Ewe/V = v + 0.1; Ece/V = 0.1 * one; <I>/mA = -1e3 * i;
(Q-Qo)/mA.h = -1e3 * q"""
BT_LAB = """Ns changes = zero; Ns = step; time/s = stamps('%m/%d/%Y %H:%M:%S.000'); Ecell/V = v;
I/mA = -1e3 * i; (Q-Qo)/mA.h = -1e3 * q; step time/s = dt"""
NOVONIX = """Date and Time = stamps('%Y-%m-%d %I:%M:%S %p'); Cycle Number = one; Step Type = zero;
Run Time (h) = t / 3600; Step Time (h) = dt / 3600; Current (A) = -i; Potential (V) = v;
Capacity (Ah) = moved; Temperature (°C) = temp; Circuit Temperature (°C) = temp + 1;
Step Number = step"""
NOVONIX_ABOVE = """[Summary]
Novonix HPC data file
Started: 2022-09-13 5:43:03 PM
[End Summary]
[Protocol]
[Charge]
   [StepLimits 0 60 0 50]
[End Protocol]
[Data]
"""
PEC = """Total Time (Seconds) = t; Step Time (Seconds) = dt; Voltage (mV) = 1e3 * v;
Current (mA) = -1e3 * i; Cycle = zero; Step = step; Charge Capacity (mAh) = 1e3 * charged;
Discharge Capacity (mAh) = 1e3 * discharged; Internal Resistance 1 (mOhm) = zero"""
PEC_ABOVE = "TestRegime Name,Formation\nStart Time,2025-01-01 00:00:00\n"
PEC_CLOCKS = """Test = one; Step = step; Instruction Name = words('D', 'C', 'R');
Total Time (Hours in hh:mm:ss.xxx) = clocks(t); Step Time (Seconds) = dt; Voltage (V) = v;
Current (A) = AMPS; Charge Capacity (mAh) = 1e3 * charged;
Discharge Capacity (mAh) = 1e3 * discharged; Temp (°C) = temp"""
LONG_ABOVE = "".join(f"Test {k}:,{k}\n" for k in range(45)) + "Names of variables:\n"
BASYTEC = """~Time[h] = t / 3600; DataSet = n; DateTime = stamps('%d.%m.%Y %H:%M:%S');
t-Step[h] = dt / 3600; Line = step; Command = words('Discharge', 'Charge', 'Pause'); U[V] = v;
I[A] = -i; Ah[Ah] = -q; T1[°C] = temp; State = zero"""
BASYTEC_ABOVE = "~Resultfile from Basytec Battery Test System\n~Name of Test: a\n~Battery: b\n~\n"
BDF = """Test Time / s = t; Voltage / V = v; Current / A = -i; Net Capacity / Ah = -q;
Cycle Count / 1 = zero; Step Count / 1 = step; Ambient Temperature / degC = temp"""
BDF_MACHINE = """test_time_second = t; voltage_volt = v; current_ampere = -i;
charging_capacity_ah = charged; discharging_capacity_ah = discharged;
temperature_t1_celsius = temp"""
BDF_HOURS = """Test Time / h = t / 3600; Current / A = -i; Voltage / V = v; Step Index / 1 = step;
Charge Capacity / Ah = charged; Discharge Capacity / Ah = discharged"""
DIGATRON = """Time Stamp = '10/21/2018 1:05:31 PM'; Step = step;
Status = words('DCH', 'CHA', 'PAU'); Prog Time = clocks(t); Step Time = clocks(dt); Cycle = zero;
Cycle Level = zero; Procedure = '551'; Voltage = v; Current = -i; Temperature = temp; Capacity = -q;
WhAccu = zero; Cnt = zero"""
BITRODE = """Exclude = 'No'; Time(s) = t; Cycle = zero; Loop = zero; Loop  = zero; Step = step;
StepTime(s) = dt; Current(A) = -i; Voltage(V) = v; Capacity(Ah) = where(i > 0, -moved, moved);
Mode = words('DCHG', 'CHRG', 'REST'); Data = ' '"""
TIDY = "time_s = t; current_A = i; voltage_V = v"


def maccor(amps="abs(i)", end="\r\n"):
    above = "Today's Date\t04/06/2016\nFilename:\tC:\\data\\cell.074\tProcedure:\tx\n"
    return Layout("maccor-text", MACCOR.replace("AMPS", amps), "\t", end, above)


def pec_clocks(amps):
    return Layout("pec-csv", PEC_CLOCKS.replace("AMPS", amps), above=LONG_ABOVE)


def digatron():
    """Preamble, names, units, rows."""
    names, rows = Layout("", DIGATRON).text().split("\n", 1)
    units = ",,,,,,,,[V],[A],[C],[Ah],[Wh],[Cnt]\n"
    return f"File:,cell_1,\nTest date:,10/21/2018\n\n{names}\n{units}{rows}"


WORD = words("CC DChg", "CC Chg", "Rest")


def neware_levels():
    lines = [
        '"Cycle ID","Cap_Chg(mAh)","Cap_DChg(mAh)"',
        '"","Step ID","Step Name","Step Time","Capacity(mAh)"',
        '"","","Record ID","Time(h:min:s.ms)","Voltage(V)","Current(mA)","Temperature(C)",'
        '"Capacity(mAh)","Realtime"',
        "1,10,20",
    ]
    step = 0
    for k in range(T.size):
        if STEPS[k] != step:
            step = STEPS[k]
            name = WORD[k]
            lines.append(f",{step},{name},00:00:00.000,0")
        time = clock(STEP_TIME[k])
        lines.append(
            f",,{k + 1},{time},{float(V[k])!r},{float(-1e3 * I[k])!r},25.0,"
            f"{float(1e3 * MOVED[k])!r},2024-05-09 10:00:00"
        )
    return "\n".join(lines) + "\n"


def neware_short_levels(degrees="℃"):
    """Index instead of ID; the first step of a cycle stands in the cycle's own row."""
    lines = [
        "Cycle Index,Chg. Cap.(Ah),DChg. Cap.(Ah)",
        f",Step Index,Step Number,Step Type,Step Time,Capacity(Ah),T1 End T({degrees})",
        f",,DataPoint,Time,Total Time,Current(A),Voltage(V),Capacity(Ah),Date,T1({degrees})",
    ]
    step = 0
    for k in range(T.size):
        if STEPS[k] != step:
            step = STEPS[k]
            name = WORD[k]
            lines.append(f"{'1,0.5,0.5,' if step == 1 else ','}{step},{step},{name},00:01:00,0,25")
        times = f"{clock(STEP_TIME[k])},{clock(T[k])}"
        lines.append(
            f",,{k + 1},{times},{float(-I[k])!r},{float(V[k])!r},{float(MOVED[k])!r},"
            "2026-03-06 12:37:25,25.0"
        )
    return "\n".join(lines) + "\n"


LAYOUTS = {
    "arbin": Layout("arbin-csv", ARBIN),
    "arbin, new": Layout("arbin-csv", ARBIN_NEW, end="\r\n", above="\ufeff"),
    "arbin, names of the database": Layout("arbin-csv", DATABASE),
    "bdf": Layout("bdf-csv", BDF),
    "bdf, machine names": Layout("bdf-csv", BDF_MACHINE),
    "bdf, hours": Layout("bdf-csv", BDF_HOURS),
    "maccor": maccor(),
    "maccor, new": Layout("maccor-text", MACCOR_NEW, "\t"),
    "maccor, signed as discharge": maccor("i"),
    "maccor, signed as charge": maccor("-i"),
    "neware": Layout("neware-csv", NEWARE),
    "neware, the step's time alone, unsigned": Layout("neware-csv", NEWARE_OLD),
    "neware, cumulative time": Layout("neware-csv", NEWARE_CUMULATIVE),
    "novonix": Layout("novonix-csv", NOVONIX, above=NOVONIX_ABOVE),
    "pec": Layout("pec-csv", PEC, above=PEC_ABOVE),
    "pec, clocks": pec_clocks("-i"),
    "pec, clocks, unsigned": pec_clocks("abs(i)"),
    "basytec": Layout("basytec-text", BASYTEC, "\t", above=BASYTEC_ABOVE),
    "basytec, blanks": Layout("basytec-text", BASYTEC, " ", above=BASYTEC_ABOVE),
    "biologic, Ewe and Ece": Layout("biologic-mpt", TWO_ELECTRODES, "\t",
                                    above="EC-Lab ASCII FILE\nNb header lines : 3\n"),
    "biologic, dates": Layout("biologic-mpt", BT_LAB, "\t", above="BT-Lab ASCII FILE\n"),
    "tidy, clocks": Layout("tidy-csv", TIDY.replace("= t", "= clocks(t)")),
    "tidy, dates": Layout("tidy-csv", TIDY.replace("= t", "= stamps('%Y-%m-%d %H:%M:%S')")),
}  # fmt: skip
MPT = Layout(
    "biologic-mpt", BIOLOGIC, "\t", "\r\n", "EC-Lab ASCII FILE\r\nNb header lines : 4\r\n\r\n"
)
# By name: the format, and a text that a record of columns cannot say.
TEXTS = {
    **{name: (one.format, one.text()) for name, one in LAYOUTS.items()},
    "maccor, millivolts": ("maccor-text", maccor()._replace(
        columns=MACCOR.replace("AMPS", "abs(i)").replace("Volts = v", "Volts = 1e3 * v")).text()),
    "maccor, decimal commas": ("maccor-text", commas(maccor().text())),
    "maccor, blank lines": ("maccor-text", maccor().text().replace("\r\n", "\r\n\r\n")),
    "maccor, lines of tabs": ("maccor-text", "\t\t\r\n" + maccor().text().replace(
        "\r\n", "\r\n\t\t\t\t\t\t\t\t\t\t\t\t\t\r\n", 1)),
    "novonix, milliamperes": ("novonix-csv", LAYOUTS["novonix"]._replace(
        columns=NOVONIX.replace("(A) = -i", "(mA) = -1e3 * i")).text()),
    "pec, unsigned": ("pec-csv", LAYOUTS["pec"].text().replace(",-", ",")),
    "basytec, decimal commas": ("basytec-text", commas(LAYOUTS["basytec"].text()).replace(
        "09,05,2024", "09.05.2024").replace("10,05,2024", "10.05.2024")),
    "biologic": ("biologic-mpt", MPT.text()),
    "biologic, decimal commas": (
        "biologic-mpt", MPT.text().replace(".", ",").replace("mA,h", "mA.h")),
    # Without preamble and mode columns; the header ends in a tab, the rows do not.
    "biologic, CA": ("biologic-mpt", Layout(
        "", "time/s = t; Ewe/V = v; I/mA = -1e3 * i", "\t").text().replace("\n", "\t\n", 1)),
    "digatron": ("digatron-csv", digatron()),
    "bitrode": ("bitrode-csv", Layout("", BITRODE).text().replace("\n", ",\n")),
    "neware, levels": ("neware-levels", neware_levels()),
    "neware, short levels": ("neware-levels", neware_short_levels()),
    "neware, levels with lost signs": ("neware-levels", neware_short_levels("?")),
}  # fmt: skip


# One packed file for each way of reading text.
PACKED = ("arbin", "basytec, blanks", "neware, levels")


@pytest.mark.parametrize(
    ("name", "packed"), [*((n, False) for n in TEXTS), *((n, True) for n in PACKED)]
)
def test_an_export_is_read_as_the_truth(name, packed, tmp_path):
    wanted, text = TEXTS[name]
    path = tmp_path / "export.dat"  # the name tells nothing
    content = text.encode("latin-1" if wanted in ("basytec-text", "biologic-mpt") else "utf-8")
    path.write_bytes(gzip.compress(content) if packed else content)
    log = read_log(path)
    assert log.format == wanted
    np.testing.assert_allclose(log.time_s, T, atol=2e-3)
    np.testing.assert_allclose(log.current_A, I, atol=1e-9)
    np.testing.assert_allclose(log.voltage_V, V, atol=1e-9)
    if log.charge_Ah is not None:
        np.testing.assert_allclose(log.charge_Ah - log.charge_Ah[0], Q, atol=1e-6)
    if log.temperature_C is not None:
        np.testing.assert_allclose(log.temperature_C, TEMP)
    assert not any("LOOKS WRONG" in n or "does not know" in n for n in texts(log.notices)), (
        log.notices
    )


def test_an_unsigned_current_in_an_unknown_state_is_refused(tmp_path):
    path = tmp_path / "maccor.txt"
    path.write_text(maccor().text().replace("\tD\t", "\tZ\t"))
    with pytest.raises(InputError, match="without sign"):
        read_log(path)


def test_a_state_that_contradicts_the_signs_is_refused(tmp_path):
    """Half the rows of either meaning: nobody can know."""
    path = tmp_path / "export.txt"
    path.write_text(maccor("where(n % 2, i, -i)").text())
    with pytest.raises(InputError, match="state"):
        read_log(path)


def test_a_sensors_zero_does_not_pass_for_a_sign(tmp_path):
    """A few negative milliamperes at rest leave a current unsigned."""
    path = tmp_path / "export.txt"
    path.write_text(maccor("where(i == 0, where(n % 2, 1e-3, -1e-3), abs(i))").text())
    np.testing.assert_array_equal(read_log(path).current_A[I != 0], I[I != 0])


def test_a_counter_that_restarts_with_every_cycle_is_joined(tmp_path):
    """Arbin's two capacities go to zero where a cycle begins; the net charge goes on."""
    half = T.size // 2
    columns = columns_of(ARBIN)
    for name in ("Charge_Capacity(Ah)", "Discharge_Capacity(Ah)"):
        columns[name] = columns[name] - np.where(
            np.arange(T.size) < half, 0.0, columns[name][half - 1]
        )
    path = tmp_path / "log.csv"
    path.write_text(table(columns))
    np.testing.assert_allclose(read_log(path).charge_Ah, Q, atol=1e-12)


def test_a_tick_of_the_other_counter_does_not_turn_a_charge(tmp_path):
    """A tester's counters both move by their last digit where a step begins (seen with Arbin)."""
    rows = np.arange(60.0)
    current = np.where(rows < 20, 0.0, 2.65)
    charged = np.cumsum(current) / 3600.0
    path = tmp_path / "export.csv"
    path.write_text(
        table(
            {"Data Point": rows, "Test Time (s)": rows, "Step Index": 1.0 + (rows >= 20),
             "Current (A)": current, "Voltage (V)": 3.53 + 0.03 * current + 0.001 * rows,
             "Charge Capacity (Ah)": np.where(rows == 20, charged[19], charged),
             "Discharge Capacity (Ah)": np.where(rows < 20, 0.0, 2e-5)}
        )
    )  # fmt: skip
    log = read_log(path)
    np.testing.assert_allclose(log.current_A, -current)


def test_a_counter_against_a_current_that_no_voltage_confirms_is_said_first(tmp_path):
    """Hours of a milliampere: the voltage's drops are too small to tell."""
    rows = np.arange(300.0)
    current = np.where(rows < 150, 0.006, -0.006)
    counted = np.cumsum(current) * 500.0 / 3600.0
    path = tmp_path / "export.csv"
    path.write_text(
        table(
            {"Test Time / s": 500.0 * rows, "Current / A": current,
             "Voltage / V": 3.3 - 0.3 * counted,
             "Net Capacity / Ah": -counted}
        )
    )  # fmt: skip
    assert "runs against" in read_log(path).notices[0].text


FOOTERS = {
    "one line": "End of data\n",
    "lines": "\nEnd of data\nWritten by the logger\n",
    "as wide as the rows": "End of data,,\n",
    "sums": "Total,1.5,3.7\n",
}


@pytest.mark.parametrize("footer", FOOTERS)
def test_lines_below_the_data_are_left_out_and_said(footer, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time_s,current_A,voltage_V\n" + "".join(f"{k},1.5,3.7\n" for k in range(50))
                    + FOOTERS[footer])  # fmt: skip
    log = read_log(path)
    assert len(log) == 50
    word = FOOTERS[footer].strip().split(",")[0].split("\n")[0]
    assert any(word in n and "left out" in n for n in texts(log.notices)), log.notices


def test_a_last_row_with_text_in_one_channel_is_refused(tmp_path):
    """It has a time: a row of the data, not what stands below them."""
    path = tmp_path / "log.csv"
    path.write_text("time_s,current_A,voltage_V\n0,1.5,3.7\n1,1.5,3.7\n2,1.5,over\n")
    with pytest.raises(InputError, match="'over'"):
        read_log(path)


def test_text_between_rows_is_refused_with_its_row_and_what_to_do(tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{k},1.5,3.7" for k in range(50)]
    rows[20] = "End of part one,,"
    path.write_text("time_s,current_A,voltage_V\n" + "\n".join(rows) + "\n")
    with pytest.raises(InputError, match=r"row 21 .*remove the row"):
        read_log(path)


def test_an_mpr_file_with_two_electrodes_gives_the_cell(tmp_path):
    pytest.importorskip("galvani")
    log = read_log(write_mpr(tmp_path / "log.mpr", TRUTH, counter_V=0.1))
    np.testing.assert_allclose(log.voltage_V, V, atol=1e-6)
    assert any("Ewe less Ece" in notice for notice in texts(log.notices))


GERMAN = {"Zeit": T, "Strom": -I, "Spannung": V}
TOLD = {"time_s": "Zeit", "current_A": "Strom", "voltage_V": "Spannung"}


@pytest.mark.parametrize(
    ("time", "decimal"),
    [
        (lambda: [clock(t) for t in T], "."),
        (lambda: [clock(t).replace(".", ",") for t in T], ","),
        (lambda: stamps("%d.%m.%Y %H:%M:%S"), ","),
        (lambda: stamps("%Y-%m-%d %H:%M:%S"), "."),
        (lambda: stamps("%Y-%m-%dT%H:%M:%SZ"), "."),
        (lambda: stamps("%m/%d/%Y %I:%M:%S %p"), "."),
        (lambda: stamps("%d/%m/%Y %H:%M:%S"), "."),
    ],
)
def test_german_headers_clocks_and_dates_with_the_columns_told(time, decimal, tmp_path):
    text = table(GERMAN | {"Zeit": ["x"] * T.size}, sep=";")
    text = commas(text) if decimal == "," else text
    lines = text.splitlines()
    rows = [
        line.replace("x;", f"{stamp};", 1) for line, stamp in zip(lines[1:], time(), strict=True)
    ]
    path = tmp_path / "messung.csv"
    path.write_text("\n".join([lines[0], *rows]) + "\n")
    log = read_log(path, sign="charge-positive", channels=TOLD)
    np.testing.assert_allclose(log.time_s, T, atol=2e-3)
    np.testing.assert_allclose(log.current_A, I, atol=1e-9)
    np.testing.assert_allclose(log.voltage_V, V, atol=1e-9)


def test_quoted_decimal_commas_between_commas(tmp_path):
    rows = (f'"{t}","{i}","{v}"'.replace(".", ",") for t, i, v in zip(T, I, V, strict=True))
    path = tmp_path / "log.csv"
    path.write_text("time_s,current_A,voltage_V\n" + "\n".join(rows) + "\n")
    np.testing.assert_allclose(read_log(path).voltage_V, V, atol=1e-9)


def test_the_decimal_sign_can_be_stated(tmp_path):
    """1.234 is a thousand and more to one, one and a bit to the other."""
    path = tmp_path / "log.csv"
    path.write_text("time_s;current_A;voltage_V\n" + "".join(f"{k};1,5;3,7\n" for k in range(9)))
    assert read_log(path, decimal=",").current_A[0] == 1.5
    with pytest.raises(InputError):
        read_log(path, decimal=".")
    with pytest.raises(InputError, match="decimal"):
        read_log(path, decimal="x")


def test_a_column_that_the_format_does_not_know_is_reported_with_the_nearest(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(LAYOUTS["arbin"].text().replace("Aux_Temperature_1(C)", "Aux_Temperatur_1(C)"))
    notices = " ".join(texts(read_log(path).notices))
    assert "'Aux_Temperatur_1(C)' (nearest: 'Aux_Temperature_1(C)')" in notices


@pytest.mark.parametrize(
    ("names", "factors"),
    [
        (("t_sec", "Pack Current (mA)", "Cell Volts"), (1, 1e3, 1)),
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
def test_clock_times_of_testers_become_seconds(text, seconds, tmp_path):
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


def test_an_obd_log_of_a_car_is_a_pack_of_its_cells(tmp_path):
    columns = columns_of("""Date/Time = stamps('%m/%d/%Y %H:%M:%S'); Gids = 200 * one;
    SOC = 865123 * one; AHr = 433000 * one; Pack Volts = 96 * v; Pack Amps = 20 * i;
    Avg CP mV = 1e3 * v; Pack T1 C = temp; Pack T3 C = 'none'; epoch time = 1.49e9 + t""")
    columns |= {f"CP{k}": np.round(1e3 * V) for k in range(1, 97)}
    path = tmp_path / "Log_U1.csv"
    path.write_text(table(columns))
    log = read_log(path, series="auto")
    assert log.format == "leafspy-csv"
    np.testing.assert_allclose(log.voltage_V, V, atol=1e-3)  # the cells' digits
    np.testing.assert_allclose(log.current_A, 20 * I, atol=1e-9)
    np.testing.assert_allclose(log.time_s, T)
    np.testing.assert_allclose(log.temperature_C, TEMP)
    for series in (1, 96):
        np.testing.assert_array_equal(read_log(path, series=series).voltage_V, log.voltage_V)
