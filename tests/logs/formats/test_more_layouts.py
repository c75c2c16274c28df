"""Layouts of more instruments and of older exports, from their public descriptions."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs import read_log
from log_files import pulse_channels
from tester_files import clock, halves, step_counters, step_times, steps_of, table, write_mpr
from vehicle_files import can_messages, write_dbc

TRUTH = pulse_channels()
T, I, V = (TRUTH[name] for name in ("time_s", "current_A", "voltage_V"))  # noqa: E741
Q, TEMP = TRUTH["ampere_hours"], TRUTH["temperature_C"]
CHARGED, DISCHARGED = halves(Q)
STEPS = steps_of(I)
STEP_TIME, MOVED = step_times(T, STEPS), step_counters(Q, STEPS)
WORD = np.where(I > 0, "D", np.where(I < 0, "C", "R"))
START = datetime.datetime(2024, 5, 9, 23, 55)


def stamps(pattern):
    return [(START + datetime.timedelta(seconds=t)).strftime(pattern) for t in T]


def commas(text):
    """The same text with decimal commas; its cells must not be separated by commas."""
    return text.replace(".", ",")


def maccor(amps, factor=1.0, **more):
    columns = {
        "Rec#": np.arange(T.size),
        "Cyc#": np.ones(T.size),
        "Step": STEPS,
        "Test (Sec)": T,
        "Step (Sec)": STEP_TIME,
        "Amp-hr": MOVED,
        "Watt-hr": np.zeros(T.size),
        "Amps": amps,
        "Volts": factor * V,
        "State": WORD,
    }
    return table(columns | more, sep="\t", end="\r\n")


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
            name = {"D": "CC DChg", "C": "CC Chg", "R": "Rest"}[WORD[k]]
            lines.append(f",{step},{name},00:00:00.000,0")
        time = clock(STEP_TIME[k])
        lines.append(
            f",,{k + 1},{time},{float(V[k])!r},{float(-1e3 * I[k])!r},25.0,"
            f"{float(1e3 * MOVED[k])!r},2024-05-09 10:00:00"
        )
    return "\n".join(lines) + "\n"


def novonix(current="Current (A)", scale=1.0):
    preamble = "[Summary]\nNovonix HPC data file\nStarted: 2022-09-13 5:43:03 PM\n[End Summary]\n"
    preamble += "[Protocol]\n[Charge]\n   [StepLimits 0 60 0 50]\n[End Protocol]\n[Data]\n"
    return preamble + table(
        {
            "Date and Time": stamps("%Y-%m-%d %I:%M:%S %p"),
            "Cycle Number": np.ones(T.size),
            "Step Type": np.zeros(T.size),
            "Run Time (h)": T / 3600.0,
            "Step Time (h)": STEP_TIME / 3600.0,
            current: -scale * I,
            "Potential (V)": V,
            "Capacity (Ah)": MOVED,
            "Temperature (°C)": TEMP,
            "Circuit Temperature (°C)": TEMP + 1.0,
            "Step Number": STEPS,
        }
    )


def pec():
    preamble = "TestRegime Name,Formation\nStart Time,2025-01-01 00:00:00\n"
    return preamble + table(
        {
            "Total Time (Seconds)": T,
            "Step Time (Seconds)": STEP_TIME,
            "Voltage (mV)": 1e3 * V,
            "Current (mA)": -1e3 * I,
            "Cycle": np.zeros(T.size),
            "Step": STEPS,
            "Charge Capacity (mAh)": 1e3 * CHARGED,
            "Discharge Capacity (mAh)": 1e3 * DISCHARGED,
            "Internal Resistance 1 (mOhm)": np.zeros(T.size),
        }
    )


def pec_unsigned():
    return pec().replace(",-", ",")


def basytec(sep="\t"):
    preamble = "~Resultfile from Basytec Battery Test System\n~Name of Test: a\n~Battery: b\n~\n"
    return preamble + table(
        {
            "~Time[h]": T / 3600.0,
            "DataSet": np.arange(T.size),
            "DateTime": stamps("%d.%m.%Y %H:%M:%S"),
            "t-Step[h]": STEP_TIME / 3600.0,
            "Line": STEPS,
            "Command": ["Pause" if i == 0 else "Charge" if i < 0 else "Discharge" for i in I],
            "U[V]": V,
            "I[A]": -I,
            "Ah[Ah]": -Q,
            "T1[°C]": TEMP,
            "State": np.zeros(T.size),
        },
        sep=sep,
    )


def biologic_ca():
    """Without preamble and mode columns; the header ends in a tab, the rows do not."""
    lines = table({"time/s": T, "Ewe/V": V, "I/mA": -1e3 * I}, sep="\t").splitlines()
    return "\n".join([lines[0] + "\t", *lines[1:]]) + "\n"


def biologic_two_electrodes():
    preamble = "EC-Lab ASCII FILE\nNb header lines : 3\n"
    return preamble + table(
        {"mode": np.ones(T.size), "time/s": T, "Ewe/V": V + 0.1, "Ece/V": np.full(T.size, 0.1),
         "<I>/mA": -1e3 * I, "(Q-Qo)/mA.h": -1e3 * Q}, sep="\t"
    )  # fmt: skip


def biologic_dates():
    """BT-Lab, whose ``time/s`` may be told to hold dates."""
    preamble = "BT-Lab ASCII FILE\nNb header lines : 4\nBattery capacity : 4.500 A.h\n"
    return preamble + table(
        {"Ns changes": np.zeros(T.size), "Ns": STEPS, "time/s": stamps("%m/%d/%Y %H:%M:%S.000"),
         "Ecell/V": V, "I/mA": -1e3 * I, "(Q-Qo)/mA.h": -1e3 * Q, "step time/s": STEP_TIME},
        sep="\t",
    )  # fmt: skip


def pec_clocks(amps=-I):
    """Times as clocks, the table below a preamble of many lines."""
    preamble = "".join(f"Test {k}:,{k}\n" for k in range(45)) + "Names of variables:\n"
    return preamble + table(
        {
            "Test": np.ones(T.size),
            "Step": STEPS,
            "Instruction Name": list(WORD),
            "Total Time (Hours in hh:mm:ss.xxx)": [clock(t) for t in T],
            "Load On Time (Hours in hh:mm:ss.xxx)": [clock(0.0) for _ in T],
            "Step Time (Seconds)": STEP_TIME,
            "Voltage (V)": V,
            "Current (A)": amps,
            "Charge Capacity (mAh)": 1e3 * CHARGED,
            "Discharge Capacity (mAh)": 1e3 * DISCHARGED,
            "Temp (°C)": TEMP,
        }
    )


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
            name = {"D": "CC DChg", "C": "CC Chg", "R": "Rest"}[WORD[k]]
            lines.append(f"{'1,0.5,0.5,' if step == 1 else ','}{step},{step},{name},00:01:00,0,25")
        times = f"{clock(STEP_TIME[k])},{clock(T[k])}"
        lines.append(
            f",,{k + 1},{times},{float(-I[k])!r},{float(V[k])!r},{float(MOVED[k])!r},"
            "2026-03-06 12:37:25,25.0"
        )
    return "\n".join(lines) + "\n"


def neware_cumulative():
    """The time of the step restarts; that of the test has a name of its own."""
    return table(
        {"DataPoint": np.arange(T.size), "Step Index": STEPS,
         "Step Type": [{"D": "CC DChg", "C": "CC Chg", "R": "Rest"}[w] for w in WORD],
         "Time": [clock(t) for t in STEP_TIME], "Cumulative Time": [clock(t) for t in T],
         "Current(A)": -I, "Voltage(V)": V, "Chg. Cap.(Ah)": CHARGED, "DChg. Cap.(Ah)": DISCHARGED}
    )  # fmt: skip


def bdf(unit, seconds):
    return table(
        {f"Test Time / {unit}": T / seconds, "Current / A": -I, "Voltage / V": V,
         "Step Index / 1": STEPS, "Charge Capacity / Ah": CHARGED,
         "Discharge Capacity / Ah": DISCHARGED}
    )  # fmt: skip


WRITERS = {
    "maccor, signed as discharge": (lambda: maccor(I), "maccor-text"),
    "maccor, signed as charge": (lambda: maccor(-I), "maccor-text"),
    "maccor, millivolts": (lambda: maccor(np.abs(I), 1e3), "maccor-text"),
    "maccor, decimal commas": (lambda: commas(maccor(np.abs(I))), "maccor-text"),
    "maccor, blank lines": (
        lambda: "\r\n\r\n" + maccor(np.abs(I)).replace("\r\n", "\r\n\r\n"), "maccor-text"),
    "maccor, lines of tabs": (
        lambda: "\t\t\r\n" + maccor(np.abs(I)).replace("\r\n", "\r\n\t\t\t\t\t\t\t\t\t\r\n", 1),
        "maccor-text"),
    "neware, levels": (neware_levels, "neware-levels"),
    "novonix": (novonix, "novonix-csv"),
    "novonix, milliamperes": (lambda: novonix("Current (mA)", 1e3), "novonix-csv"),
    "pec": (pec, "pec-csv"),
    "pec, unsigned": (pec_unsigned, "pec-csv"),
    "basytec, tabs": (basytec, "basytec-text"),
    "basytec, blanks": (lambda: basytec(" "), "basytec-text"),
    "basytec, decimal commas": (
        lambda: commas(basytec()).replace("09,05,2024", "09.05.2024"), "basytec-text"),
    "biologic, CA": (biologic_ca, "biologic-mpt"),
    "biologic, Ewe and Ece": (biologic_two_electrodes, "biologic-mpt"),
    "biologic, dates": (biologic_dates, "biologic-mpt"),
    "pec, clocks": (pec_clocks, "pec-csv"),
    "pec, clocks, unsigned": (lambda: pec_clocks(np.abs(I)), "pec-csv"),
    "neware, short levels": (neware_short_levels, "neware-levels"),
    "neware, levels with lost signs": (lambda: neware_short_levels("?"), "neware-levels"),
    "neware, cumulative time": (neware_cumulative, "neware-csv"),
    "bdf, hours": (lambda: bdf("h", 3600.0), "bdf-csv"),
    "bdf, minutes": (lambda: bdf("min", 60.0), "bdf-csv"),
    "tidy, clocks": (
        lambda: table({"time_s": [clock(t) for t in T], "current_A": I, "voltage_V": V}),
        "tidy-csv"),
    "tidy, dates": (
        lambda: table({"time_s": stamps("%Y-%m-%d %H:%M:%S"), "current_A": I, "voltage_V": V}),
        "tidy-csv"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_an_export_is_read_as_the_truth(name, tmp_path):
    write, wanted = WRITERS[name]
    path = tmp_path / "export.dat"
    path.write_bytes(write().encode("latin-1" if "basytec" in name else "utf-8"))
    log = read_log(path)
    assert log.format == wanted
    np.testing.assert_allclose(log.time_s, T, atol=2e-3)
    np.testing.assert_allclose(log.current_A, I, atol=1e-9)
    np.testing.assert_allclose(log.voltage_V, V, atol=1e-9)
    if log.charge_Ah is not None:
        np.testing.assert_allclose(log.charge_Ah - log.charge_Ah[0], Q, atol=1e-6)
    assert not any("LOOKS WRONG" in n for n in log.notices), log.notices


def test_a_state_that_contradicts_the_signs_is_refused(tmp_path):
    """Half the rows of either meaning: nobody can know."""
    path = tmp_path / "export.txt"
    path.write_text(maccor(np.where(np.arange(T.size) % 2, I, -I)))
    with pytest.raises(InputError, match="state"):
        read_log(path)


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


def test_a_discharge_alone_without_sign_goes_by_its_counter(tmp_path):
    rows = np.arange(60.0)
    current = np.where(rows < 20, 0.0, 20.0)
    path = tmp_path / "export.csv"
    path.write_text(
        table(
            {"Total Time (Seconds)": rows, "Step": 1.0 + (rows >= 20), "Current (A)": current,
             "Voltage (V)": 3.68 - 0.002 * current - 1e-4 * rows,
             "Charge Capacity (Ah)": np.zeros(60),
             "Discharge Capacity (Ah)": np.cumsum(current) / 3600.0}
        )
    )  # fmt: skip
    np.testing.assert_allclose(read_log(path).current_A, current)


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
    assert "runs against" in read_log(path).notices[0]


def test_columns_in_rows_of_siblings_are_not_listed_one_by_one(tmp_path):
    more = {f"Aux #{k}": np.zeros(T.size) for k in range(1, 17)}
    more |= {f"VAR{k}": np.zeros(T.size) for k in range(1, 16)}
    odd = {f"Odd {name}": np.zeros(T.size) for name in "abcdefghijklmnopqrst"}
    path = tmp_path / "export.txt"
    path.write_text(maccor(np.abs(I), **more, **odd))
    (said,) = (n for n in read_log(path).notices if "does not know" in n)
    assert "VAR" not in said
    assert "Aux" not in said
    assert "and 8 more" in said


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
    assert any(word in n and "left out" in n for n in log.notices), log.notices


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
    assert any("Ewe less Ece" in notice for notice in log.notices)


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


# Text logs of CAN frames, each with the times that its program writes.
def frames():
    return [(m.timestamp, m.arbitration_id, bytes(m.data)) for m in can_messages(TRUTH)]


def savvycan(begin_s=0.0):
    yield "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"
    for time, ident, data in frames():
        extended = "true" if ident > 0x7FF else "false"
        cells = ",".join(f"{byte:02X}" for byte in data)
        yield f"{round(1e6 * (time - begin_s))},{ident:08X},{extended},Rx,0,{len(data)},{cells}"


def savvycan_before_zero():
    """Stamps relative to a moment in the recording, as the program writes them on request."""
    return savvycan(frames()[len(frames()) // 2][0])


def candump(time_of=lambda t: f"({t:.6f})"):
    for time, ident, data in frames():
        width = 8 if ident > 0x7FF else 3
        cells = " ".join(f"{byte:02X}" for byte in data)
        yield f" {time_of(time)}  can0  {ident:0{width}X}   [{len(data)}]  {cells}"


def busmaster():
    yield "***BUSMASTER Ver 2.4.0***"
    yield "***PROTOCOL CAN***"
    yield "***HEX***"
    for time, ident, data in frames():
        seconds = time % 86_400
        hms = f"{int(seconds // 3600)}:{int(seconds // 60 % 60)}:{int(seconds % 60)}"
        part = f"{round(seconds % 1 * 1e4):04d}"
        cells = " ".join(f"{byte:02X}" for byte in data)
        kind = "x" if ident > 0x7FF else "s"
        yield f"{hms}:{part} Rx 1 0x{ident:03X} {kind} {len(data)} {cells}"


def old_trc():
    yield ";   Start time: 24.07.2017 12:09:03.143"
    yield ";---+--   ----+----  ----+---  +  -+ -- -- ..."
    first = frames()[0][0]
    for k, (time, ident, data) in enumerate(frames()):
        cells = " ".join(f"{byte:02X}" for byte in data)
        width = 8 if ident > 0x7FF else 4
        ms = 1e3 * (time - first)
        yield f"{k + 1:6d}) {ms:10.1f}  Rx  {ident:0{width}X}  {len(data)}  {cells}"


def asc_without_base():
    for time, ident, data in frames():
        cells = " ".join(f"{byte:02X}" for byte in data)
        mark = "x" if ident > 0x7FF else ""
        yield f"   {time:.6f} 1  {ident:X}{mark}             Rx   d {len(data)} {cells}"


@pytest.mark.parametrize(
    "write", [savvycan, savvycan_before_zero, candump, busmaster, old_trc, asc_without_base]
)
def test_a_text_log_of_can_frames(write, tmp_path):
    pytest.importorskip("cantools")
    path, dbc = tmp_path / "log.txt", write_dbc(tmp_path / "bms.dbc")
    path.write_text("\n".join(write()) + "\n")
    log = read_log(path, dbc=dbc)
    assert log.format == "can-text"
    found = np.interp(T, log.time_s, log.voltage_V)
    np.testing.assert_allclose(found[5:-5], V[5:-5], atol=0.2)
    np.testing.assert_allclose(np.ptp(log.time_s), T[-1], atol=2.0)


def test_candump_without_times_is_told_what_to_do(tmp_path):
    path, dbc = tmp_path / "log.txt", write_dbc(tmp_path / "bms.dbc")
    path.write_text("\n".join(candump(lambda t: "")) + "\n")
    with pytest.raises(InputError, match=r"candump -L"):
        read_log(path, dbc=dbc)


def leafspy(sep=","):
    cells = {f"CP{k}": np.round(1e3 * V) for k in range(1, 97)}
    return table(
        {
            "Date/Time": stamps("%m/%d/%Y %H:%M:%S"),
            "Gids": np.full(T.size, 200.0),
            "SOC": np.full(T.size, 865123.0),
            "AHr": np.full(T.size, 433000.0),
            "Pack Volts": 96 * V,
            "Pack Amps": 20 * I,
            "Avg CP mV": 1e3 * V,
            "Pack T1 C": TEMP,
            "Pack T3 C": ["none"] * T.size,
            **cells,
            "epoch time": 1_490_000_000 + T,
        },
        sep=sep,
    )


def test_an_obd_log_of_a_car_is_a_pack_of_its_cells(tmp_path):
    path = tmp_path / "Log_U1.csv"
    path.write_text(leafspy())
    log = read_log(path, series="auto")
    assert log.format == "leafspy-csv"
    np.testing.assert_allclose(log.voltage_V, V, atol=1e-9)
    np.testing.assert_allclose(log.current_A, 20 * I, atol=1e-9)
    np.testing.assert_allclose(log.time_s, T)
    np.testing.assert_allclose(log.temperature_C, TEMP)
    np.testing.assert_allclose(read_log(path).voltage_V, V, atol=1e-3)  # the mean cell without it


def test_an_arbin_database_is_read_by_mdbtools(tmp_path, monkeypatch):
    """What the program prints is a table; without the program, its name is said."""
    path = tmp_path / "test.res"
    path.write_bytes(b"\x00\x01\x00\x00Standard Jet DB\x00" + bytes(4000))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    with pytest.raises(InputError, match="mdbtools"):
        read_log(path)
    (tmp_path / "bin").mkdir()
    text = tmp_path / "table.csv"
    text.write_text(
        table({"Test_ID": np.ones(T.size), "Data_Point": np.arange(T.size), "Test_Time": T,
               "Step_Index": STEPS, "Current": -I, "Voltage": V, "Charge_Capacity": CHARGED,
               "Discharge_Capacity": DISCHARGED})
    )  # fmt: skip
    tool = tmp_path / "bin" / "mdb-export"
    tool.write_text(f'#!/bin/sh\n[ "$2" = Channel_Normal_Table ] && exec /bin/cat {text}\nexit 1\n')
    tool.chmod(0o755)
    log = read_log(path)
    assert log.format == "arbin-res"
    np.testing.assert_allclose(log.current_A, I)
    np.testing.assert_allclose(log.charge_Ah - log.charge_Ah[0], Q, atol=1e-9)
