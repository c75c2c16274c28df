"""Flight and vehicle logs: batteries, unknown values, units, clocks of their own."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs import read_log
from cellwise.notices import texts
from log_files import pulse_channels
from vehicle_files import (
    DBC,
    can_messages,
    write_can,
    write_dataflash,
    write_dbc,
    write_mdf,
    write_mdf_frames,
    write_ulog,
)

pytest.importorskip("pyulog")
pytest.importorskip("pymavlink")
pytest.importorskip("asammdf")
pytest.importorskip("cantools")

CELL = pulse_channels(600)


def pack(cells=4, parallel=2, **changes):
    c = {name: values.copy() for name, values in CELL.items()}
    c["voltage_V"] *= cells
    c["current_A"] *= parallel
    c["ampere_hours"] *= parallel
    return {**c, **changes}


def assert_is_the_cell(log, current=1e-6, voltage=1e-5, charge=1e-6):
    np.testing.assert_allclose(log.time_s, CELL["time_s"], atol=1e-5)
    np.testing.assert_allclose(log.current_A, CELL["current_A"], atol=current)
    np.testing.assert_allclose(log.voltage_V, CELL["voltage_V"], atol=voltage)
    if log.charge_Ah is not None:
        np.testing.assert_allclose(log.charge_Ah, CELL["ampere_hours"], atol=charge)


def refused(*arguments, **options):
    with pytest.raises(InputError) as caught:
        read_log(*arguments, **options)
    return caught.value


# ULog


def test_a_ulog_says_how_many_cells_it_states(tmp_path):
    path = write_ulog(tmp_path / "flight", [pack()])
    assert any("4 cells in series: `series='auto'`" in n for n in texts(read_log(path).notices))
    assert any("3 were stated" in n for n in texts(read_log(path, series=3).notices))


def test_minus_one_is_unknown_not_one_ampere(tmp_path):
    current = pack()["current_A"]
    unknown = np.zeros(current.size, dtype=bool)
    unknown[50:60] = True
    c = pack(current_A=np.where(unknown, -1.0, current))
    c["ampere_hours"][:] = -1e-3  # written in mAh
    c["temperature_C"][:] = np.nan
    log = read_log(write_ulog(tmp_path / "flight", [c]))
    assert np.array_equal(np.isnan(log.current_A), unknown)
    assert log.charge_Ah is None
    assert log.temperature_C is None


def test_of_several_batteries_the_measured_one_or_the_one_asked_for(tmp_path):
    nothing = pack(current_A=np.full(600, -1.0))
    path = write_ulog(tmp_path / "flight", [nothing, pack(cells=6), pack(cells=12)])
    log = read_log(path, series=6, parallel=2)
    assert_is_the_cell(log)
    assert any("3 batteries" in n and "read number 1" in n for n in texts(log.notices))
    assert_is_the_cell(read_log(path, series=12, parallel=2, instance=2))
    error = refused(path, instance=7)
    assert "no battery 7" in error.found
    assert "0: 16.4 V, 1: 24.5 V, 2: 49.1 V" in error.found


def test_a_ulog_that_was_cut_off_is_refused_unless_told(tmp_path, capfd):
    path = write_ulog(tmp_path / "flight", [pack()])
    path.write_bytes(path.read_bytes()[:-7])
    error = refused(path)
    assert "cut off ULog" in error.found
    assert "`partial=True`" in error.action
    log = read_log(path, partial=True, series=4, parallel=2)
    assert len(log) == 599
    assert any("cut off" in n for n in texts(log.notices))
    assert capfd.readouterr() == ("", "")


# dataflash


@pytest.mark.parametrize("form", ["instances", "two messages"])
def test_a_dataflash_log_is_read_as_its_mean_cell(form, tmp_path):
    path = write_dataflash(tmp_path / "flight", [pack(), pack(cells=6)], form)
    log = read_log(path, series=4, parallel=2)
    assert log.format == "ardupilot-dataflash"
    assert_is_the_cell(log)
    assert_is_the_cell(read_log(path, series=6, parallel=2, instance=1))
    np.testing.assert_allclose(log.temperature_C, 25.0)
    assert "no battery 2" in refused(path, instance=2).found


def test_old_dataflash_logs_count_in_hundredths(tmp_path):
    path = write_dataflash(tmp_path / "flight", [pack()], "old")
    log = read_log(path, series=4, parallel=2)
    assert_is_the_cell(log, current=0.0026, voltage=0.0013)


# MDF


def mdf(path, current_every=1, voltage_every=1, more=()):
    c = pack()
    t = c["time_s"] + 3.0
    i, v = slice(None, None, current_every), slice(None, None, voltage_every)
    return write_mdf(
        path,
        [
            [("BMS_PackCurrent", "A", t[i], c["current_A"][i])],
            [("BMS_PackVoltage", "mV", t[v], 1000 * c["voltage_V"][v])],
            [("BatteryTemp", "°C", t[::60], c["temperature_C"][::60])],
            *more,
        ],
    )


def test_an_mdf_file_is_read_by_units_and_names(tmp_path):
    t = CELL["time_s"]
    more = [
        [("MotorCurrent", "A", t, t), ("AuxVoltage", "V", t, t), ("CellVoltageMin", "V", t, t)],
        [("VehicleSpeed", "km/h", t, t)],
    ]
    log = read_log(mdf(tmp_path / "drive", more=more), series=4, parallel=2)
    assert log.format == "asam-mdf"
    np.testing.assert_allclose(log.current_A, CELL["current_A"], atol=1e-9)
    np.testing.assert_allclose(log.voltage_V, CELL["voltage_V"], atol=1e-9)
    np.testing.assert_allclose(log.temperature_C, 25.0)


def test_an_mdf_file_with_two_packs_is_refused_with_its_candidates(tmp_path):
    t = CELL["time_s"]
    path = mdf(tmp_path / "drive", more=[[("Pack2Current", "A", t, t)]])
    error = refused(path)
    assert "BMS_PackCurrent" in error.found
    assert "Pack2Current" in error.found
    assert "`channels={'current_A': " in error.action
    log = read_log(path, channels={"current_A": "BMS_PackCurrent"}, parallel=2)
    np.testing.assert_allclose(log.current_A, CELL["current_A"], atol=1e-9)


def test_signals_of_one_name_are_chosen_by_their_group(tmp_path):
    t, c = CELL["time_s"], pack()
    groups = [
        [("Current", "A", t, -t), ("Voltage", "V", t, c["voltage_V"])],
        [("Current", "A", t, c["current_A"])],
    ]
    path = write_mdf(tmp_path / "drive", groups)
    error = refused(path, channels={"current_A": "Current"})
    assert "'0.Current', '1.Current'" in error.found
    log = read_log(path, channels={"current_A": "1.Current"}, parallel=2)
    np.testing.assert_allclose(log.current_A, CELL["current_A"], atol=1e-9)


def test_an_mdf_file_of_can_frames_is_read_through_its_database(tmp_path):
    path = write_mdf_frames(tmp_path / "drive", pack())
    assert "`dbc=" in refused(path).action
    log = read_log(path, dbc=write_dbc(tmp_path / "bms.dbc"), series=4, parallel=2)
    np.testing.assert_allclose(log.current_A, CELL["current_A"], atol=0.0051)
    np.testing.assert_allclose(log.voltage_V, CELL["voltage_V"], atol=0.0126)
    assert not any("apart" in n for n in texts(log.notices))  # both are in one frame
    other = write_dbc(tmp_path / "other.dbc", DBC.replace("256", "257").replace("512", "513"))
    assert "no frame of" in refused(path, dbc=other).found


@pytest.mark.parametrize(
    ("current", "voltage", "factor"),
    [
        (("Batt_I_A", ""), ("Batt_U_V", ""), 1),
        (("battery_current_mA", ""), ("battery_voltage", "V"), 1000),
        (("PackCurr", "-"), ("PackVolt", "-"), 1),
        (("I", "A"), ("U", "V"), 1),
        (("HVBattCurrent", "Ampere"), ("HV Battery Voltage", "[V]"), 1),
    ],
)
def test_signals_of_many_namings(current, voltage, factor, tmp_path):
    t, c = CELL["time_s"], pack()
    groups = [
        [(*current, t, factor * c["current_A"]), ("MaxChargeCurrent", "A", t, t)],
        [(*voltage, t, c["voltage_V"]), ("Odometer", "", t, t), ("DCDC Voltage", "V", t, t)],
    ]
    log = read_log(write_mdf(tmp_path / "drive", groups), series=4, parallel=2)
    np.testing.assert_allclose(log.current_A, CELL["current_A"], atol=1e-9)
    np.testing.assert_allclose(log.voltage_V, CELL["voltage_V"], atol=1e-9)


# CAN


@pytest.mark.parametrize("kind", ["blf", "asc", "log", "trc"])
def test_a_can_log_is_read_through_its_database(kind, tmp_path):
    dbc = write_dbc(tmp_path / "bms.dbc")
    path = write_can(tmp_path / "drive", pack(), kind)
    log = read_log(path, dbc=dbc, series=4, parallel=2)
    assert log.format == "can-log"
    np.testing.assert_allclose(log.time_s, CELL["time_s"], atol=1.1e-3)  # TRC: 0.1 ms, ASC: 1 us
    np.testing.assert_allclose(log.current_A, CELL["current_A"], atol=0.0051)
    np.testing.assert_allclose(log.voltage_V, CELL["voltage_V"], atol=0.0126)
    np.testing.assert_allclose(log.temperature_C, 25.0)


# Text logs of CAN frames, each with the times that its program writes.
def savvycan():
    begin_s = list(can_messages(CELL))[500].timestamp  # the program writes them so on request
    yield "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"
    for m in can_messages(CELL):
        cells = m.data.hex(",").upper()
        extended = str(m.is_extended_id).lower()
        at = round(1e6 * (m.timestamp - begin_s))
        yield f"{at},{m.arbitration_id:08X},{extended},Rx,0,{m.dlc},{cells},"


def candump(time_of=lambda t: f"({t:.6f})"):
    for m in can_messages(CELL):
        name = f"{m.arbitration_id:0{8 if m.is_extended_id else 3}X}"
        yield f" {time_of(m.timestamp)}  can0  {name}   [{m.dlc}]  {m.data.hex(' ').upper()}"


def old_trc():
    yield ";   Start time: 24.07.2017 12:09:03.143"
    yield ";---+--   ----+----  ----+---  +  -+ -- -- ..."
    messages = list(can_messages(CELL))
    for k, m in enumerate(messages):
        name = f"{m.arbitration_id:0{8 if m.is_extended_id else 4}X}"
        at = 1e3 * (m.timestamp - messages[0].timestamp)
        yield f"{k + 1:6d}) {at:10.1f}  Rx  {name}  {m.dlc}  {m.data.hex(' ').upper()}"


def asc_without_base():
    for m in can_messages(CELL):
        name = f"{m.arbitration_id:X}{'x' * m.is_extended_id}"
        yield f"   {m.timestamp:.6f} 1  {name}             Rx   d {m.dlc} {m.data.hex(' ')}"


@pytest.mark.parametrize("write", [savvycan, candump, old_trc, asc_without_base])
def test_a_text_log_of_can_frames(write, tmp_path):
    path, dbc = tmp_path / "log.txt", write_dbc(tmp_path / "bms.dbc")
    path.write_text("\n".join(write()) + "\n")
    log = read_log(path, dbc=dbc)
    assert log.format == "can-log"
    found = np.interp(CELL["time_s"], log.time_s, log.voltage_V)
    np.testing.assert_allclose(found[5:-5], CELL["voltage_V"][5:-5], atol=0.2)
    np.testing.assert_allclose(np.ptp(log.time_s), CELL["time_s"][-1], atol=2.0)


def test_candump_without_times_is_told_what_to_do(tmp_path):
    path, dbc = tmp_path / "log.txt", write_dbc(tmp_path / "bms.dbc")
    path.write_text("\n".join(candump(lambda t: "")) + "\n")
    assert "candump -L" in refused(path, dbc=dbc).action


def test_a_database_with_longer_frames_is_the_wrong_one(tmp_path):
    long = DBC.replace("BMS_Pack: 8", "BMS_Pack: 16")
    dbc = write_dbc(tmp_path / "other.dbc", long)
    error = refused(write_can(tmp_path / "drive", pack(), "log"), dbc=dbc)
    assert "frames of 8 byte(s)" in error.found


def test_values_outside_the_databases_range_are_missing(tmp_path):
    """A BMS that is not awake sends all ones: no current of -327 A, but none at all."""
    c = pack(current_A=np.where(np.arange(600) < 5, 327.0, pack()["current_A"]))
    dbc = write_dbc(tmp_path / "bms.dbc")
    log = read_log(write_can(tmp_path / "drive", c, "blf"), dbc=dbc, parallel=2)
    assert np.nanmax(log.current_A) < 5
    assert any("5 value(s) of 'BMS_Pack.PackCurrent' outside" in n for n in texts(log.notices))
