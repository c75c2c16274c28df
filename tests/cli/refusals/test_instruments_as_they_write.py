"""Files as instruments write them, through the command: read, or the option that reads them."""

from __future__ import annotations

import numpy as np
import pytest

from log_files import pulse_channels
from tester_files import halves, step_counters, steps_of, table
from vehicle_files import can_messages, write_dbc, write_mdf_frames

TRUTH = pulse_channels()
T, I, V = (TRUTH[name] for name in ("time_s", "current_A", "voltage_V"))  # noqa: E741
Q = TRUTH["ampere_hours"]


def novonix() -> str:
    columns = {"Run Time (h)": T / 3600.0, "Current (mA)": -1e3 * I, "Potential (V)": V}
    head = "[Summary]\nNovonix HPC data file\n[End Summary]\n[Data]\n"
    return head + table({**columns, "Capacity (mAh)": -1e3 * step_counters(Q, steps_of(I))})


def pec() -> str:
    charged, discharged = halves(Q)
    return "TestRegime Name,Formation\n" + table(
        {"Total Time (Seconds)": T, "Voltage (mV)": 1e3 * V, "Current (mA)": -1e3 * I,
         "Step": steps_of(I), "Charge Capacity (mAh)": 1e3 * charged,
         "Discharge Capacity (mAh)": 1e3 * discharged}
    )  # fmt: skip


@pytest.mark.parametrize("export", [novonix, pec])
def test_milliamperes_of_a_tester(export, tmp_path, run_json):
    place = tmp_path / "export.csv"
    place.write_text(export())
    found = run_json("inspect", str(place))
    assert found["current_A"]["min"] == pytest.approx(I.min(), abs=1e-6)
    assert found["current_A"]["max"] == pytest.approx(I.max(), abs=1e-6)
    assert found["voltage_V"]["max"] == pytest.approx(V.max(), abs=1e-6)
    assert found["sign"] == "verified"


def savvycan(channels: dict[str, np.ndarray]) -> str:
    lines = ["Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"]
    for message in can_messages(channels, start_s=-100.0):  # the tool's stamps may be negative
        data = ",".join(f"{byte:02X}" for byte in message.data)
        extended = str(message.is_extended_id).lower()
        lines.append(
            f"{round(1e6 * message.timestamp)},{message.arbitration_id:08X},{extended},Rx,0,"
            f"{len(message.data)},{data},"
        )
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("kind", ["csv", "mf4"])
def test_raw_frames_ask_for_their_database_and_are_read_with_it(kind, tmp_path, refused, run_json):
    pytest.importorskip("cantools")
    pytest.importorskip("asammdf")
    channels = {name: np.asarray(TRUTH[name]) for name in TRUTH}
    channels["voltage_V"] = 96.0 * channels["voltage_V"]
    place = tmp_path / f"car.{kind}"
    if kind == "csv":
        place.write_text(savvycan(channels))
    else:
        write_mdf_frames(place, channels)
    said = refused("inspect", str(place))
    assert "--dbc" in said
    assert "omit" not in said.lower()
    dbc = write_dbc(tmp_path / "bms.dbc")
    found = run_json("inspect", str(place), "--dbc", str(dbc), "--series", "96")
    assert found["current_A"]["max"] == pytest.approx(I.max(), abs=0.01)
    assert found["voltage_V"]["max"] == pytest.approx(V.max(), abs=0.01)
