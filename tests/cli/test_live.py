"""cellwise live as a program: pipes, restarts, signals, a bus, refusals."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
import uuid

import pytest
from rich.console import Console

from cellwise.cell.model_file import read_model
from cellwise.cli import main
from cellwise.logs import read_log, write_log
from streams import json_lines

SEEN_S = 30.0


@pytest.fixture(scope="module")
def stream_file(drive, tmp_path_factory):
    place = tmp_path_factory.mktemp("stream") / "stream.jsonl"
    json_lines(read_log(drive).part(0, 1500), place)
    return place


@pytest.fixture(scope="module")
def lines(stream_file):
    return stream_file.read_text().splitlines(keepends=True)


def started(*arguments):
    return subprocess.Popen(
        [sys.executable, "-c", "import sys; from cellwise.cli import main; sys.exit(main())",
         "live", *arguments],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_a_pipe_gives_one_line_for_each_sample_and_passes_garbage_over(model, lines):
    told = [*lines[:100], "}{ nonsense\n", "\n", *lines[100:300]]
    run = started("--model", model, "--source", "stdin")
    out, err = run.communicate("".join(told), timeout=120)
    assert run.returncode == 0, err
    found = [json.loads(line) for line in out.splitlines()]
    assert len(found) == 300
    assert all(0.0 <= f["soc"] <= 1.0 and f["soc_std"] > 0 for f in found)
    assert found[0]["remaining_s"] is None or found[0]["remaining_s"] > 0
    assert found[-1]["time_s"] == json.loads(lines[299])["time_s"]


def test_a_line_comes_out_while_the_stream_goes_on(model, lines):
    """Nothing waits for a buffer to fill."""
    run = started("--model", model, "--source", "stdin")
    try:
        for line in lines[:3]:
            run.stdin.write(line)
            run.stdin.flush()
            assert json.loads(run.stdout.readline())["time_s"] == json.loads(line)["time_s"]
    finally:
        run.stdin.close()
        assert run.wait(SEEN_S) == 0
        run.stdout.close()
        run.stderr.close()


@pytest.mark.skipif(sys.platform == "win32", reason="a signal of POSIX")
@pytest.mark.parametrize("number", ["SIGTERM", pytest.param("SIGINT", marks=pytest.mark.slow)])
def test_a_program_that_is_asked_to_stop_keeps_its_state(model, lines, tmp_path, number):
    state = tmp_path / "state.json"
    run = started("--model", model, "--source", "stdin", "--state", str(state))
    for line in lines[:50]:
        run.stdin.write(line)
    run.stdin.flush()
    for _ in range(50):
        last = json.loads(run.stdout.readline())
    run.send_signal(getattr(signal, number))
    assert run.wait(SEEN_S) == 0
    run.stdin.close()
    run.stdout.close()
    run.stderr.close()
    assert json.loads(state.read_text())["state"]["cell"]["soc"] == last["soc"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a signal of POSIX")
def test_a_killed_program_goes_on_from_what_it_last_kept(model, lines, tmp_path, run_json):
    state, rest = tmp_path / "state.json", tmp_path / "rest.jsonl"
    options = ("--model", model, "--state", str(state))
    run = started(*options, "--source", "stdin", "--save-every", "0")
    for line in lines[:500]:
        run.stdin.write(line)
    run.stdin.flush()
    for _ in range(500):
        last = json.loads(run.stdout.readline())
    time.sleep(0.2)
    os.kill(run.pid, signal.SIGKILL)
    run.communicate()
    rest.write_text("".join(lines[500:]))
    found = run_json("live", *options, "--source", f"json:{rest}")
    assert found["soc0"]["how"] == "saved state"
    assert found["soc0"]["value"] == pytest.approx(last["soc"], abs=0.002)
    assert found["gaps"] == 1
    assert found["samples"] == 1000


def test_one_object_at_the_end_with_json(model, drive, stream_file, run_json, tmp_path):
    out = tmp_path / "out.jsonl"
    found = run_json(
        "live", "--model", model, "--source", f"json:{stream_file}", "-o", str(out), "--every", "60"
    )
    same = write_log(read_log(drive).part(0, 1500), tmp_path / "same.csv")
    whole = run_json("replay", "--model", model, same, "--soc0",
                     repr(found["soc0"]["value"]), "--soc0-std",
                     repr(found["soc0"]["std"]))  # fmt: skip
    assert found["samples"] == 1500
    assert found["soc"] == pytest.approx(whole["soc_final"], abs=1e-9)
    assert found["latency"]["missed_deadlines"] is not None
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert 10 < len(rows) < 60
    assert rows[1]["time_s"] - rows[0]["time_s"] == pytest.approx(60.0, abs=2.0)
    run_json("live", "--model", model, "--source", f"json:{stream_file}", "-o", str(out))
    assert len(out.read_text().splitlines()) == len(rows) + 1500  # added, never overwritten


def test_live_writes_the_soc_back_to_the_bus(model, lines, tmp_path, run_json):
    can = pytest.importorskip("can")
    cantools = pytest.importorskip("cantools")
    from streams import DBC

    dbc = tmp_path / "bms.dbc"
    dbc.write_text(DBC.replace("(0.1,0) [0|900]", "(0.0001,0) [0|6]"))
    database = cantools.database.load_file(str(dbc))
    channel = uuid.uuid4().hex
    back = []

    def vehicle():
        with can.Bus(interface="virtual", channel=channel) as bus:
            # Begins when somebody listens.
            while len(bus.channel) < 2:
                time.sleep(0.01)
            for line in lines[:100]:
                row = json.loads(line)
                for name, signals in (
                    ("BMS_Pack", {"PackCurrent": row["current_A"], "Alive": 0}),
                    ("BMS_Voltage", {"PackVoltage": row["voltage_V"]}),
                ):
                    message = database.get_message_by_name(name)
                    bus.send(
                        can.Message(
                            arbitration_id=message.frame_id,
                            is_extended_id=False,
                            data=message.encode(signals, strict=False),
                        )
                    )
                time.sleep(0.005)
            while (got := bus.recv(0.3)) is not None:
                back.append(database.decode_message(got.arbitration_id, got.data)["Soc"])

    thread = threading.Thread(target=vehicle)
    thread.start()
    found = run_json(
        "live", "--model", model, "--source", f"can:virtual:{channel}", "--dbc", str(dbc),
        "--send", "Cellwise.Soc", "--send-every", "0.05", "--samples", "100", "--idle", "10",
    )  # fmt: skip
    thread.join()
    assert found["samples"] == 100
    assert 5 <= len(back) <= 100
    assert back[-1] == pytest.approx(100 * found["soc"], abs=0.5)


def test_the_view_shows_what_a_person_asks_for(model, stream_file):
    from cellwise.cli.live import live_panel, panel
    from cellwise.forecast.outlook import Outlook
    from cellwise.live import LiveFilter, open_source, run_live
    from cellwise.live.followed import FollowedFilter

    cell = read_model(model)
    live, source = LiveFilter(cell), open_source(f"json:{stream_file}")
    outlook = Outlook(cell, 2.6)
    written = io.StringIO()
    console = Console(file=written, force_terminal=True, width=100)
    followed = FollowedFilter(live, outlook)
    with live_panel(source.name, followed, console) as look:
        counts = run_live(source, live, followed.take, look=look)
    console.print(panel(source.name, followed, counts, silent_s=5.0))
    text = written.getvalue()
    assert f"{100 * counts.last.info.soc:.2f} %" in text
    for word in ("current", "voltage", "remaining", "latency", "1,500 samples", "nothing for 5 s"):
        assert word in text


@pytest.mark.parametrize("content", ["", "\n\n", "garbage\n" * 20, '{"voltage_V": 3.7}\n' * 9])
def test_a_stream_without_one_sample_is_refused(model, refused, tmp_path, content):
    (tmp_path / "s").write_text(content)
    state = tmp_path / "state.json"
    told = refused("live", "--model", model, "--source", f"json:{tmp_path / 's'}",
                   "--state", str(state))  # fmt: skip
    assert "no sample" in told
    assert not state.exists()


def test_a_file_that_is_no_state_is_not_overwritten(model, refused, stream_file, tmp_path):
    precious = tmp_path / "precious.json"
    precious.write_text('{"thesis": "chapter 4"}')
    refused("live", "--model", model, "--source", f"json:{stream_file}", "--state", str(precious))
    assert "chapter 4" in precious.read_text()
    code = main(
        ["live", "--model", model, "--source", f"json:{stream_file}", "--state", str(precious),
         "--fresh", "--json"]
    )  # fmt: skip
    assert code == 0
