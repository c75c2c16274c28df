"""What a command prints is what its function gives a notebook."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise import InputError, load_dataset, read_log, read_model, write_log, write_model
from cellwise.cell.stock import named_model
from cellwise.cli import main
from cellwise.cli.common.printing import clean
from cellwise.export import cross
from cellwise.notices import Code, coded
from cellwise.workflows.exporting import (
    check_export,
    export_firmware,
    firmware_of,
    without_effects,
)
from cellwise.workflows.following import FollowRequest, follow_stream
from cellwise.workflows.found_files import look_at
from cellwise.workflows.replaying import (
    ForecastRequest,
    ReplayRequest,
    replay_and_forecast,
    replay_each,
)
from cellwise.workflows.served import each_that_serves
from cellwise.workflows.simulating import simulate_from_start
from cellwise.workflows.starts import start_of

CLOCKED = {"seconds", "ns_per_step", "notices"}  # of this run alone; in a command's words


@pytest.fixture(scope="module")
def log():
    return replace(load_dataset("nmc_drive_b").part(0, 1500), name="drive", notices=())


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    place = tmp_path_factory.mktemp("model") / "cell.json"
    write_model(named_model("nmc-18650", 5.0), place)
    return place


@pytest.fixture(scope="module")
def model(file):
    return read_model(file)


@pytest.fixture
def printed(log, file, tmp_path, capsys):
    """The object that a command prints of the log."""
    place = write_log(log, tmp_path / "drive.parquet")

    def run(command, *more, of_log=True):
        given = ["--model", str(file), *([str(place)] if of_log else [])]
        assert main([command, *given, *map(str, more), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return run


def same(ours, printed):
    left, right = (
        {k: v for k, v in one.items() if k not in CLOCKED} for one in (clean(ours), printed)
    )
    assert left == json.loads(json.dumps(left))
    assert left.keys() == right.keys()
    for key, value in left.items():
        assert value == right[key], key


def test_a_replay_with_all_that_is_ahead_is_what_the_command_prints(printed, model, log):
    ahead = ForecastRequest(cutoff_V=3.0, load=10.0, display=0.1, anyway=True)
    found = replay_and_forecast(model, log, ReplayRequest("ekf", soc0=0.9, soc0_std=0.02), ahead)
    assert found.flight is not None
    assert found.at_load is not None
    same(
        found.to_dict(),
        printed("replay", "--soc0", 0.9, "--soc0-std", 0.02, "--cutoff-v", 3, "--load", 10,
                "--display", 0.1, "--anyway"),
    )  # fmt: skip


def test_a_simulation_from_its_start_is_what_the_command_prints(printed, model, log):
    same(simulate_from_start(model, log).to_dict(), printed("simulate"))


def test_an_export_is_what_the_command_prints(printed, model, tmp_path, monkeypatch):
    monkeypatch.setattr(cross, "cores_here", dict)  # counted elsewhere, for minutes
    found = export_firmware(firmware_of(model, 1.0), tmp_path / "ours")
    theirs = printed("export", "--dt", 1, "-o", tmp_path / "theirs", of_log=False)
    same(found.report, theirs)
    written = sorted(p.relative_to(tmp_path / "ours") for p in (tmp_path / "ours").rglob("*.c"))
    assert written
    for path in written:
        ours, others = (tmp_path / where / path for where in ("ours", "theirs"))
        assert ours.read_bytes() == others.read_bytes()


def test_nothing_is_foreseen_of_a_log_that_is_far_off_unless_asked(log):
    other = named_model("lfp-26650", 5.0)
    found = replay_and_forecast(other, log)
    assert found.far is not None
    assert found.flight is None
    assert found.power is None
    assert found.critical[-1].code is found.far.code
    assert [n.code for n in found.notices] == [n.code for n in found.replay.notices]
    withheld = coded(found.notices, found.far.code)[0]
    assert withheld != found.far
    assert withheld.text.startswith(found.far.text)
    anyway = replay_and_forecast(other, log, ahead=ForecastRequest(anyway=True))
    assert anyway.flight is not None
    assert anyway.far is None


def test_behind_a_pause_what_is_stated_of_the_start_does_not_hold(model, log):
    time_s = log.time_s + np.where(np.arange(len(log)) < 750, 0.0, 4000.0)
    paused = replace(log, time_s=time_s, charge_Ah=None)
    steps = []
    runs = replay_each(
        model,
        [paused],
        ReplayRequest(soc0=0.7),
        ForecastRequest(),
        lambda what, done, total: steps.append((done, total)),
    ).made
    assert steps == [(0, 2), (1, 2)]
    assert runs[0].replay.start.how == "given"
    assert runs[1].replay.start.how != "given"


@pytest.mark.parametrize(
    ("stated", "asked", "start"), [(None, 0.5, 0.5), (0.5, 0.5, None), (0.5, None, None)]
)
def test_what_is_stated_of_a_log_holds(stated, asked, start):
    assert start_of(stated, asked) == start


def test_two_starts_are_refused_by_the_argument_that_gives_one(model, log):
    with pytest.raises(InputError, match=r"`soc0=0\.5`") as refusal:
        replay_and_forecast(model, replace(log, soc0=0.9), ReplayRequest(soc0=0.5))
    assert "Leave out `soc0=...`" in refusal.value.action


def test_one_of_several_that_is_refused_is_left_out():
    def halved(number):
        if number % 2:
            raise InputError(f"{number}", "an even number", "Give one.")
        return number // 2

    found = each_that_serves([2, 3, 4], halved)
    assert found.made == [1, 2]
    assert [error.found for error in found.refused] == ["3"]
    with pytest.raises(InputError, match="found 1"):
        each_that_serves([1, 3], halved)


def test_an_export_is_refused_before_any_work(model, tmp_path):
    with pytest.raises(InputError, match="`fmu="):
        check_export(None, {"fmu": str(tmp_path / "cell.zip")})
    with pytest.raises(InputError, match="`without=magic`"):
        without_effects(model, ["magic"])


def test_a_folder_is_read_with_the_sign_that_the_voltages_show(log, tmp_path):
    import pyarrow as pa
    from pyarrow import parquet

    columns = {"time_s": log.time_s, "current_A": -log.current_A, "voltage_V": log.voltage_V}
    parquet.write_table(pa.table(columns), tmp_path / "swapped.parquet")
    files, sign = look_at(tmp_path)
    assert [one.kind for one in files] == ["drive"]
    assert sign == "charge-positive"
    contradicted = coded(read_log(tmp_path / "swapped.parquet").notices, Code.SIGN_CONTRADICTED)
    assert [one.value for one in contradicted] == ["charge-positive"]


def test_a_stream_followed_in_a_notebook_ends_as_the_command_does(model, log, tmp_path, printed):
    source = f"csv:{write_log(log.part(0, 300), tmp_path / 'samples.csv')}"
    told = []
    stream = follow_stream(model, source, FollowRequest(soc0=0.9), ForecastRequest(load=5.0))
    mine = {k: v for k, v in stream.run([told.append]).items() if k != "latency"}
    stream.source.close()
    assert len(told) == stream.counts.samples == 300
    asked = ("--source", source, "--soc0", "0.9", "--load", "5")
    theirs = printed("live", *asked, of_log=False)
    del theirs["latency"]
    same(mine, theirs)
