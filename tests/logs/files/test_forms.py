"""Forms in which people have their logs, by small files: the charge that flowed is the file's.

Where a refusal proposes options they are pasted, as people do.
"""

from __future__ import annotations

import json
import re
import shlex
from datetime import datetime, timedelta

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from cellwise.cli import main

STEP_S = 2.0
ROWS = 1500
START = datetime(2024, 5, 31, 9)
PROPOSED = re.compile(r"Name the columns with ((?:--channel \w+=(?:'[^']*'|\S+) ?)+), if")


def discharge():
    """Rests and a load of 3 A with a charge between them: time, current, voltage of one cell."""
    t = STEP_S * np.arange(ROWS)
    current = np.where((t > 200) & (t < 900), 3.0, 0.0)
    current = np.where((t > 1200) & (t < 1800), -1.5, current)
    current = np.where((t > 2100) & (t < 2700), 2.0 + np.sin(t / 40), current)
    soc = 0.95 - np.cumsum(current) * STEP_S / 3600 / 2.8
    slow = np.zeros(ROWS)
    for k in range(1, ROWS):
        slow[k] = slow[k - 1] + (0.02 * current[k] - slow[k - 1]) * STEP_S / 60.0
    return t, current, 3.4 + 0.75 * soc - 0.03 * current - slow


TIME, CURRENT, VOLTAGE = discharge()
NET_AH = float(np.sum(CURRENT) * STEP_S / 3600)
HOURS = TIME[-1] / 3600


def clock(t, start=9 * 3600):
    s = int(start + t)
    return f"{s // 3600 % 24:02d}:{s // 60 % 60:02d}:{s % 60:02d}"


def table(header, row, above="", between="", below=""):
    rows = "\n".join(row(t, i, v) for t, i, v in zip(TIME, CURRENT, VOLTAGE, strict=True))
    return f"{above}{header}\n{between}{rows}\n{below}"


def state(i, words):
    return words[int(np.sign(round(i, 6)))]


ENGLISH = {0: "Rest", 1: "Discharge", -1: "Charge"}
CHINESE = {0: "静置", 1: "恒流放电", -1: "恒流充电"}
SUMMER = "2024-03-31T{}+0{}:00"


def over_spring(t):
    """Stamps of central Europe on the night in which an hour is left out."""
    s = 3600 + 35 * 60 + t
    return SUMMER.format(clock(s, 0), 1) if s < 7200 else SUMMER.format(clock(s + 3600, 0), 2)


def over_autumn(t):
    """And of that in which one comes twice."""
    s = 2 * 3600 + 35 * 60 + t
    offset = 2 if s < 3 * 3600 else 1
    return f"2024-10-27T{clock(s - (3600 if offset == 1 else 0), 0)}+0{offset}:00"


def long_rows(t, i, v):
    stamp = f"2024-05-31T{clock(t)}.000Z"
    found = {"bms_voltage": 16 * v, "bms_current": -i, "soc": 50.0}
    return "\n".join(f"sensor.{name},{x:.3f},{stamp}" for name, x in found.items())


def gamry(t, i, v):
    return f"\t{int(t)}\t{t:.2f}\t{v:.5E}\t{-i:.5E}\t0\t0\t0\t0\t...........\t25.0"


# Name: text, arguments of `inspect`.
FORMS = {
    "Betaflight": (
        table(
            "loopIteration, time (us), axisP[0], vbatLatest (V), amperageLatest (A), rssi",
            lambda t, i, v: f"8, {5e7 + 1e6 * t:.0f},  -1, {4 * v:.4f}, {i:.3f}, 785",
        ),
        "--series 4",
    ),
    "Betaflight, raw": (
        table(
            "loopIteration, time, axisP[0], vbatLatest, amperageLatest",
            lambda t, i, v: f"8, {1e6 * t:.0f}, -1, {400 * v:.0f}, {100 * i:.0f}",
        ),
        "--series 4",
    ),
    "INAV, of which a part was cut out": (
        table(
            "time (us),vbat,amperage", lambda t, i, v: f"{1e6 * t:.0f},{400 * v:.0f},{100 * i:.0f}"
        ),
        "--series 4",
    ),
    "EdgeTX": (
        table(
            "Date,Time,1RSS(dB),RQly(%),RxBt(V),Curr(A),Capa(mAh),Bat%(%),GPS,TxBat(V)",
            lambda t, i, v: f"2024-05-31,{clock(t)}.000,-50,100,{4 * v:.3f},{i:.2f},0,90,48 11,7.9",
        ),
        "--series 4",
    ),
    "AirData": (
        table(
            "time(millisecond),datetime(utc),latitude,height_above_takeoff(meters),voltage(v),"
            "max_altitude(meters),battery_percent,voltageCell1,current(A),battery_temperature(f)",
            lambda t, i, v: (
                f"{1000 * t:.0f},2024-05-31 {clock(t)},48,10,{4 * v:.3f},99,90,{v:.3f},{i:.2f},77"
            ),
        ),
        "--series 4",
    ),
    "DJI text": (
        table(
            "CUSTOM.date [local],CUSTOM.updateTime [local],OSD.height [m],BATTERY.chargeLevel,"
            "BATTERY.voltage [V],BATTERY.current [A],BATTERY.temperature [C]",
            lambda t, i, v: f"5/31/2024,{clock(t)[1:]}.50 AM,10,90,{4 * v:.3f},{-i:.2f},30",
            above="sep=,\n",
        ),
        "--series 4",
    ),
    "VESC Tool": (
        table(
            "ms_today;input_voltage;temp_mos_max;temp_motor;current_motor;current_in;erpm;duty_cycle",
            lambda t, i, v: f"{3e7 + 1000 * t:.0f};{10 * v:.3f};30;30;{3 * i:.2f};{i:.3f};0;0.1",
        ),
        "--series 10",
    ),
    "Float Control": (
        table(
            "Time(s),State,Duty%,Voltage,I-Battery,I-Motor,Requested Amps,Setpoint,T-Mosfet",
            lambda t, i, v: f"{t:.1f},RIDING,30%,{20 * v:.2f},{i:.2f},{9 * i:.1f},-8.0,0,32",
        ),
        "--series 20",
    ),
    "Victron VRM": (
        table(
            "timestamp,Battery Monitor [279],Battery Monitor [279],Solar charger [258],Gateway [0]",
            lambda t, i, v: f"2024-05-31 {clock(t)},{16 * v:.2f},{-100 * i:.1f},99.1,on",
            between="Europe/Berlin (+02:00),Voltage,Current,Voltage,Relay\n,V,A,V,\n",
        ),
        "--series 16 --parallel 100",
    ),
    "Home Assistant": (
        "entity_id,state,last_changed\nsensor.bms_voltage,unavailable,2024-05-31T08:59:00.000Z\n"
        + table("", long_rows)[1:],
        "--series 16",
    ),
    "JBD": (
        table(
            "Date,Time,Total Voltage(V),Current(A),SOC(%),Cell Max(V),Cell Min(V),Temp1(°C)",
            lambda t, i, v: f"2024/05/31,{clock(t)},{16 * v:.2f},{-i:.2f},50,{v:.3f},{v:.3f},25",
        ),
        "--series 16",
    ),
    "Daly": (
        table(
            "Timestamp,PackVoltage,PackCurrent,SOC,MaxCellVoltage,MinCellVoltage,ChargeMOS",
            lambda t, i, v: f"2024-05-31 {clock(t)},{16 * v:.2f},{i:.2f},50,{v:.3f},{v:.3f},1",
        ),
        "--series 16",
    ),
    "ZKE EBC": (
        table(
            "Time(S),Cur(A),Vol(V)",
            lambda t, i, v: f"{t:.0f},{abs(i):.3f},{v:.4f}",
            above="---EB Tester Software---\nDevice:EBC-A20\nMode:D-CC  3.00A  2.80V\n"
            "Begin Volt:4.180V\n-----www-----\n",
        ),
        "",
    ),
    "Landt": (
        table(
            "循环序号,工步序号,状态,测试时间/Sec,电压/V,电流/mA",
            lambda t, i, v: f"1,1,{state(i, CHINESE)},{t:.1f},{v:.4f},{1000 * abs(i):.1f}",
        ),
        "",
    ),
    "Gamry": (
        table(
            "\tPt\tT\tVf\tIm\tVu\tSig\tAch\tIERange\tOver\tTemp",
            gamry,
            above="EXPLAIN\nTAG\tPWR\nTITLE\tLABEL\tDischarge\tIdentifier\nCURVE\tTABLE\t1500\n",
            between="\t#\ts\tV vs. Ref.\tA\tV\tV\tV\t#\tbits\tdeg C\n",
        ),
        "",
    ),
    "NASA": (
        table(
            "Voltage_measured,Current_measured,Temperature_measured,Current_load,Voltage_load,Time",
            lambda t, i, v: f"{v:.5f},{-i:.5f},25,{abs(i):.2f},0.0,{t:.1f}",
        ),
        "",
    ),
    "Battery Archive": (
        table(
            "Date_Time,Test_Time (s),Cycle_Index,Current (A),Voltage (V),Cell_Temperature (C)",
            lambda t, i, v: f"2024-05-31 {clock(t)},{t:.1f},1,{-i:.4f},{v:.4f},25",
        ),
        "",
    ),
    "Torque": (
        table(
            "GPS Time, Device Time, Longitude,HV Battery Current(A),HV Battery Voltage(V)",
            lambda t, i, v: (
                f"Fri May 31 {clock(t)} GMT+02:00 2024,31-May-2024 {clock(t)},,{i:.2f},{96 * v:.1f}"
            ),
            between="Fri May 31 08:59:58 GMT+02:00 2024,31-May-2024 08:59:59.000,11,-,-\n"
            "GPS Time, Device Time, Longitude,HV Battery Current(A),HV Battery Voltage(V)\n",
        ),
        "--series 96",
    ),
    "states": (
        table(
            "Time(s),Status,Voltage(V),Current(A)",
            lambda t, i, v: f"{t},{state(i, ENGLISH)},{v:.4f},{abs(i):.4f}",
        ),
        "",
    ),
    "two currents": (
        table(
            "Time (s),Voltage (V),Charge current (A),Discharge current (A)",
            lambda t, i, v: f"{t},{v:.4f},{max(-i, 0):.4f},{max(i, 0):.4f}",
        ),
        "",
    ),
    "days and clocks, decimal commas": (
        table(
            "Datum;Zeit;Spannung;Strom",
            lambda t, i, v: f"31.05.2024;{clock(t)};{v:.4f};{i:.3f}".replace(".", ",").replace(
                "31,05,", "31.05."
            ),
        ),
        "",
    ),
    "past midnight": (
        table("Time,Voltage (V),Current (A)", lambda t, i, v: f"{clock(t, 84600)},{v:.4f},{i:.3f}"),
        "",
    ),
    "spring": (
        table("Time,Voltage (V),Current (A)", lambda t, i, v: f"{over_spring(t)},{v:.4f},{i:.3f}"),
        "",
    ),
    "autumn": (
        table("Time,Voltage (V),Current (A)", lambda t, i, v: f"{over_autumn(t)},{v:.4f},{i:.3f}"),
        "",
    ),
    "month first, afternoon": (
        table(
            "Date,Volts,Amps",
            lambda t, i, v: f'"May 31, 2024 1{clock(t, 3600)[1:]} PM",{v:.4f},{i:.3f}',
        ),
        "",
    ),
    "milliseconds since 1970": (
        table(
            "timestamp,Voltage (V),Current (A)",
            lambda t, i, v: f"{1717142400000 + 1000 * t:.0f},{v:.4f},{i:.3f}",
        ),
        "",
    ),
    "micro": (
        table(
            "Timestamp(ms),Current(uA),Voltage(uV)",
            lambda t, i, v: f"{1000 * t:.0f},{1e6 * i:.0f},{1e6 * v:.0f}",
        ),
        "",
    ),
    "DIN symbols": (table("Time [s],U [V],I [A]", lambda t, i, v: f"{t},{v:.4f},{i:.3f}"), ""),
    "a line of units": (
        table(
            "Time,Voltage,Current,Power",
            lambda t, i, v: f"{t},{v:.4f},{1000 * i:.1f},0",
            between="s,V,mA,W\n",
        ),
        "",
    ),
    "a block of metadata": (
        table(
            "Elapsed time (s);Cell voltage (V);Cell current (A)",
            lambda t, i, v: f"{t};{v:.4f};{i:.3f}",
            above="Instrument;PSU 3005\nSerial;12345\nStarted;2024-05-31 09:00\n\n",
        ),
        "",
    ),
    "some names of a tester's": (
        table(
            "Rec,Mode,Loop,Current,Elapsed (s),Cell voltage (V)",
            lambda t, i, v: f"1,{state(i, ENGLISH)},1,{i:.3f},{t},{v:.4f}",
        ),
        "",
    ),
    "compounds": (
        table(
            "Zeit [s];Zellspannung [mV];Ladestrom [A];Entladestrom [A]",
            lambda t, i, v: f"{t};{1000 * v:.1f};{max(-i, 0):.3f};{max(i, 0):.3f}",
        ),
        "",
    ),
    "MAVLink": (
        table(
            "timestamp,SYS_STATUS.voltage_battery,SYS_STATUS.current_battery",
            lambda t, i, v: f"{1717142400 + t:.3f},{4000 * v:.0f},{100 * i:.0f}",
        ),
        "--series 4",
    ),
    "InfluxDB": (
        "_time,_value,_field,entity_id\n"
        + table(
            "",
            lambda t, i, v: (
                f"2024-05-31T{clock(t)}Z,{v:.4f},value,bms_voltage\n"
                f"2024-05-31T{clock(t)}Z,{i:.3f},value,bms_current"
            ),
        )[1:],
        "",
    ),
    "Car Scanner": (
        '"SECONDS";"PID";"VALUE";"UNITS"\n'
        + table(
            "",
            lambda t, i, v: (
                f'"{3600 + t}";"[BMS] Battery voltage";"{96 * v:.2f}";"V"\n'
                f'"{3600 + t}";"[BMS] Battery current";"{i:.3f}";"A"'
            ),
        )[1:],
        "--series 96",
    ),
    "between blanks": (
        table(
            "  Time(s)   Voltage(V)   Current(A)",
            lambda t, i, v: f"{t:9.1f} {v:12.4f} {i:12.4f}",
        ),
        "",
    ),
    "keys and values of the same width": (
        table(
            "Time (s),Voltage (V),Current (A)",
            lambda t, i, v: f"{t},{v:.3f},{i:.3f}",
            above="Start Time,2024-05-31 09:00:00,\nCapacity,2.8,Ah\n\n",
            below="\nSummary\nCapacity (Ah),0.66\n",
        ),
        "",
    ),
    "Russian": (
        table("Время, с;Напряжение, В;Ток, А", lambda t, i, v: f"{t};{v:.4f};{i:.3f}"),
        "",
    ),
}
ENCODED = {
    "gb18030": "测试时间(s),电压(V),电流(A)",
    "cp932": "経過時間[s],電圧[V],電流[A]",
    "cp949": "시간(s),전압(V),전류(A)",
    "big5": "測試時間(s),電壓(V),電流(A)",
    "cp1251": "Время (с),Напряжение (В),Ток (А)",
    "utf-16": "Time (s),Voltage (V),Current (A)",
}


def inspected(path, capsys, args=""):
    """What `inspect` says of a file, the options that a refusal proposes pasted; these."""
    code = main(["inspect", str(path), *shlex.split(args), "--json"])
    said = capsys.readouterr()
    if code == 0:
        return json.loads(said.out), ""
    options = PROPOSED.search(said.err)
    assert options is not None, said.err
    assert main(["inspect", str(path), *shlex.split(options[1]), *shlex.split(args), "--json"]) == 0
    return json.loads(capsys.readouterr().out), options[1]


@pytest.mark.parametrize("form", FORMS)
def test_the_charge_is_the_files(form, tmp_path, capsys):
    text, args = FORMS[form]
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    found, _ = inspected(path, capsys, args)
    assert found["charge_Ah"] == pytest.approx(NET_AH, rel=0.02)
    assert found["duration_s"] == pytest.approx(3600 * HOURS, rel=0.001)
    assert found["sign"] == "verified"
    assert 3.0 < found["voltage_V"]["min"] < found["voltage_V"]["max"] < 4.3


@pytest.mark.parametrize("encoding", ENCODED)
def test_names_of_another_character_set(encoding, tmp_path, capsys):
    path = tmp_path / "log.csv"
    text = table(ENCODED[encoding], lambda t, i, v: f"{t},{v:.4f},{i:.3f}")
    path.write_bytes(text.encode(encoding))
    found, options = inspected(path, capsys)
    assert not options
    assert found["charge_Ah"] == pytest.approx(NET_AH, rel=0.02)


def test_a_comma_between_name_and_unit_parts_no_cells(tmp_path, capsys):
    path = tmp_path / "log.csv"
    rows = table(
        "Zeit, s;Spannung, V;Strom, A",
        lambda t, i, v: f"{t};{v:.4f};{i:.3f}".replace(".", ","),
    )
    path.write_text(rows)
    found, options = inspected(path, capsys)
    assert not options
    assert found["charge_Ah"] == pytest.approx(NET_AH, rel=0.02)


SHEETS = {
    "plain": (("Time (s)", "Voltage (V)", "Current (A)"), lambda t: t),
    "dates": (("Datum", "Spannung [V]", "Strom [A]"), lambda t: START + timedelta(seconds=t)),
    "Neware": (("DataPoint", "Step Type", "Total Time", "Voltage(V)", "Current(A)"), clock),
}


@pytest.mark.parametrize("kind", SHEETS)
def test_the_sheet_with_the_measurement_is_read(kind, tmp_path, capsys):
    names, stamp = SHEETS[kind]
    book = openpyxl.Workbook()
    book.active.append(["Made by", "X"])
    sheet = book.create_sheet("record")
    for row in ((), names) if kind == "plain" else (names,):
        sheet.append(row)
    for k, (t, i, v) in enumerate(zip(TIME, CURRENT, VOLTAGE, strict=True)):
        more = [k + 1, state(i, ENGLISH)] if kind == "Neware" else []
        sheet.append([*more, stamp(float(t)), float(v), float(i if kind != "Neware" else -i)])
    book.save(tmp_path / "log.xlsx")
    found, options = inspected(tmp_path / "log.xlsx", capsys)
    assert not options
    assert found["charge_Ah"] == pytest.approx(NET_AH, rel=0.02)
    assert found["duration_s"] == pytest.approx(3600 * HOURS, rel=0.001)


def test_a_dataflash_log_as_text(tmp_path, capsys):
    pytest.importorskip("pymavlink")
    path = tmp_path / "flight.log"
    head = "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
    head += "FMT, 160, 45, BAT, QBffff, TimeUS,Inst,Volt,VoltR,Curr,CurrTot"
    path.write_text(
        table(
            head, lambda t, i, v: f"BAT, {1e6 * t:.0f}, 0, {4 * v:.3f}, {4 * v:.3f}, {i:.3f}, 0.0"
        )
    )
    found, _ = inspected(path, capsys, "--series 4")
    assert found["charge_Ah"] == pytest.approx(NET_AH, rel=0.02)


def test_names_in_a_matlab_file_are_proposed(tmp_path, capsys):
    path = tmp_path / "log.mat"
    savemat(path, {"zeit": TIME, "spannung": VOLTAGE, "strom": CURRENT})
    found, options = inspected(path, capsys)
    assert "current_A=strom" in options
    assert found["charge_Ah"] == pytest.approx(NET_AH, rel=0.02)


def test_a_day_without_rows_is_a_gap(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text(
        table(
            "Date,Time,Voltage (V),Current (A)",
            lambda t, i, v: f"2024-0{'5-31' if t < 1000 else '6-01'},{clock(t)},{v:.4f},{i:.3f}",
        )
    )
    found, _ = inspected(path, capsys)
    assert found["duration_s"] == pytest.approx(3600 * HOURS + 86400)
    assert len(found["gaps"]) == 1


def test_a_current_without_a_sign_is_said_first(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text(table("time_s,current_A,voltage_V", lambda t, i, v: f"{t},{abs(i)},{v:.4f}"))
    found, _ = inspected(path, capsys)
    assert "has no sign" in found["notices"][0]
    assert found["charge_Ah"] == pytest.approx(NET_AH, rel=0.02)


def test_a_current_whose_sign_nothing_gives_is_refused_by_identify(tmp_path, capsys):
    path = tmp_path / "log.csv"
    # Of the last load the voltage says nothing.
    header = "time_s,current_A,voltage_V"
    path.write_text(table(header, lambda t, i, v: f"{t},{abs(i)},{v if t < 2000 else 3.8:.4f}"))
    found, _ = inspected(path, capsys)
    assert "LOOKS WRONG: it has no sign" in found["notices"][0]
    model = tmp_path / "model.json"
    assert main(["identify", "--capacity", str(path), "--nominal-ah", "2.8", "-o", str(model)]) == 2
    assert "no sign" in capsys.readouterr().err
    assert not model.exists()


def test_hours_taken_for_seconds_are_said_loudly(tmp_path, capsys):
    path = tmp_path / "log.csv"
    hours = np.linspace(0, 5, 300)
    rows = "\n".join(f"{h:.4f},0.5,{4.1 - 0.22 * h:.4f}" for h in hours)
    path.write_text(f"time_s,current_A,voltage_V\n{rows}\n")
    found, _ = inspected(path, capsys)
    assert any("time LOOKS WRONG" in notice for notice in found["notices"])
