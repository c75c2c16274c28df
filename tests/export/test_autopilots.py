"""PX4's module on a stub of documented names, ArduPilot's bridge and script: SOC, a restart.

Neither tree is here: what is tested is our side of their APIs.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from cellwise.cell.protocol import ConstantCurrent, DriveProfile, run_protocol
from cellwise.export.c_tables import STRICT_FLAGS, put
from cellwise.export.firmware import Firmware
from cellwise.export.package import Export
from example_cells import curved_cell

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
STUB = Path(__file__).parent / "px4_stub"
DT_S = 5.0
WARNINGS = ["-O2", "-Wall", "-Wextra", "-Werror", "-Wno-unused-result"]


def built(command):
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.fixture(scope="module", params=["px4", "ardupilot"])
def program(request, tmp_path_factory):
    """What reads samples and writes states of charge."""
    place = tmp_path_factory.mktemp(request.param)
    export = Export(curved_cell(), DT_S, layout=request.param)
    unmeasured = {"targets": [], "accuracy": [], "sockets": {}, "notices": []}
    put(export.files(export.description | unmeasured), place)
    folders = [f"-I{place}/include", f"-I{place}/src"]
    objects = []
    for source in [*place.glob("src/*.c"), *place.glob("*.c")]:
        objects.append(place / f"{source.stem}.o")
        flags = ["gcc", *STRICT_FLAGS, *WARNINGS, "-c", *folders, source, "-o", objects[-1]]
        built(flags)
    if request.param == "px4":
        objects += [f"-I{STUB}", *place.glob("*.cpp"), STUB / "main.cpp"]
        objects += ["-std=c++17", *WARNINGS, "-Wno-unused-parameter", *folders]
    built(["g++", *objects, "-lm", "-o", place / "app"])
    return place / "app"


@pytest.fixture(scope="module")
def log():
    """A load, then a charge."""
    rng = np.random.default_rng(2)
    model = curved_cell()
    load = model.capacity_Ah * rng.uniform(0.2, 0.8, 120)
    steps = [
        DriveProfile(time_s=DT_S * np.arange(1.0, 121.0), current_A=load),
        ConstantCurrent(current_A=-0.4 * model.capacity_Ah, duration_s=600.0),
    ]
    return run_protocol(model, steps, 0.8, DT_S, 25.0).part(1, 240)


def soc_of(program, log, folder, begin_ms=1000.0):
    """SOC at each row; the first line begins its interval."""
    time_ms = begin_ms + 1000.0 * DT_S * np.arange(len(log) + 1)
    rows = np.column_stack([log.current_A, log.voltage_V, log.temperature_C])
    rows = np.column_stack([time_ms, np.concatenate([rows[:1], rows])])
    text = "".join("{:.0f} {:.6f} {:.6f} {:.3f}\n".format(*row) for row in rows)
    done = subprocess.run(
        [str(program)], input=text, cwd=folder, capture_output=True, text=True, check=True
    )
    said = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    assert np.all(said[:, 3] == 1)  # valid; a source outside PX4
    return said[:, 0]


def test_each_row_is_what_replay_says(program, log, tmp_path):
    export = Export(curved_cell(), DT_S)
    trace = Firmware(export.seen.model, export.seen.noise, dt_s=DT_S).run(log, 0.5, 0.3)
    said = soc_of(program, log, tmp_path, 4294900000.0)  # milliseconds wrap on the way
    np.testing.assert_allclose(said, np.clip(trace.soc, 0.0, 1.0), atol=1e-4)


def test_a_restart_goes_on_from_what_was_written_last(program, log, tmp_path):
    before = soc_of(program, log.part(0, 121), tmp_path)[-1]
    assert list(tmp_path.glob("cellwise_?"))
    assert soc_of(program, log.part(121, 125), tmp_path)[0] == pytest.approx(before, abs=0.01)
    for kept in tmp_path.glob("cellwise_?"):
        kept.write_bytes(kept.read_bytes()[:-4] + b"torn")
    fresh = soc_of(program, log.part(121, 125), tmp_path / "..")[0]
    assert soc_of(program, log.part(121, 125), tmp_path)[0] == pytest.approx(fresh)


def test_the_script_hands_on_what_the_bridge_says():
    """The names are those of ArduPilot's scripting page."""
    lupa = pytest.importorskip("lupa", reason="no Lua: pip install lupa")
    lua = lupa.LuaRuntime()
    script = (Path(__file__).parents[2] / "firmware_ref/layouts/ardupilot/scripts").glob("*.lua")
    lua.execute(FAKE_AUTOPILOT)
    lua.globals().answer = "0.412000 0.010000 0 1 -2.500 15.200\n"
    lua.execute(next(script).read_text())
    said = lua.globals().said
    assert (said.healthy, said.percent, said.current) == (True, 41, -2.5)
    assert said.voltage == pytest.approx(15.2)
    assert lua.globals().sent == "7 2.00000 15.10000 25.00000\n"
    lua.globals().answer = "0.412000 0.300000 4096 0 -2.500 15.200\ngarbled\n"
    lua.execute("update()")
    assert lua.globals().said.healthy is False
    assert lua.globals().said.percent is None


FAKE_AUTOPILOT = """
sent, said, answer = "", nil, ""
local function whole(n) return {toint = function() return n end} end
function millis() return whole(7) end
serial = {find_serial = function() return {
  begin = function() end,
  write = function(_, byte) sent = sent .. string.char(byte) end,
  available = function() return whole(#answer) end,
  read = function() local b = answer:byte(1); answer = answer:sub(2); return b end,
} end}
function BattMonitorScript_State()
  local s = {}
  return {s = s,
    healthy = function(_, v) s.healthy = v end, voltage = function(_, v) s.voltage = v end,
    current_amps = function(_, v) s.current = v end,
    capacity_remaining_pct = function(_, v) s.percent = v end}
end
battery = {voltage = function() return 15.1 end, current_amps = function() return 2 end,
  get_temperature = function() return 25 end,
  handle_scripting = function(_, _, state) said = state.s end}
"""
