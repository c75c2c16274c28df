"""A fleet against one replay after another; errors, resuming, deaths of workers."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import time
from dataclasses import dataclass, replace

import pytest

from cellwise.errors import InputError
from cellwise.estimate.replay import replay
from cellwise.fleet import DiagnoseTask, ReplayTask, engine, run_fleet
from cellwise.logs import read_log, write_log
from fleet_logs import drive, rows_in


@pytest.mark.parametrize("scheduler", ["local", pytest.param("processes", marks=pytest.mark.slow)])
def test_every_log_has_the_row_that_its_replay_gives(model, folder, tmp_path, scheduler):
    out = tmp_path / "out"
    told = run_fleet(ReplayTask(model), folder, out, scheduler=scheduler, workers=2, batch=2)
    rows = rows_in(out)
    assert (told.logs, told.done, told.failed, told.resumed) == (8, 8, 2, 0)
    assert set(rows) == {p.relative_to(folder).as_posix() for p in folder.rglob("*.*")}
    for name, row in rows.items():
        if row["error"] is not None:
            continue
        whole = replay(model, read_log(folder / name)).to_dict()
        assert row["soc_final"] == pytest.approx(whole["soc_final"], abs=1e-12)
        assert row["voltage_rmse_V"] == pytest.approx(whole["voltage_rmse_V"], rel=1e-9)
        assert row["soc0_how"] == whole["soc0"]["how"]
    assert "empty" in rows["empty.parquet"]["error"]
    assert rows["notes.md"]["soc_final"] is None
    assert rows["truck_2/day_3.parquet"]["cell"] == "truck_2"
    assert rows["turned.parquet"]["cell"] == "turned"


def test_a_log_that_surprises_the_filter_has_its_sign_checked(model, folder, tmp_path):
    run_fleet(ReplayTask(model), folder, tmp_path / "out", workers=1)
    rows = rows_in(tmp_path / "out")
    assert rows["turned.parquet"]["sign"] == "contradicted"
    assert rows["truck_1/day_0.parquet"]["sign"] == "not checked"


def test_the_adaptive_estimator_tells_its_parameters(model, folder, tmp_path):
    task = ReplayTask(model, estimator="adaptive")
    run_fleet(task, folder, tmp_path / "out", pattern="day_4*", workers=1)
    (row,) = rows_in(tmp_path / "out").values()
    told = replay(model, read_log(folder / row["log"]), "adaptive").to_dict()["parameters"]
    assert row["offset_A"] == pytest.approx(told["offset_A"]["value"])
    assert row["capacity_std_Ah"] == pytest.approx(told["capacity_Ah"]["std"])
    assert row["soh_resistance"] == pytest.approx(told["soh_resistance"])


class StopError(Exception):
    pass


def test_an_interrupted_run_goes_on_where_it_stopped(model, folder, tmp_path):
    out = tmp_path / "out"

    def stop(done, failed, total):
        if done >= 3:
            raise StopError

    with pytest.raises(StopError):
        run_fleet(ReplayTask(model), folder, out, workers=1, batch=1, progress=stop)
    before = rows_in(out)
    assert 3 <= len(before) < 8
    told = run_fleet(ReplayTask(model), folder, out, workers=1)
    assert told.resumed == len(before)
    assert told.done == 8 - len(before)
    after = rows_in(out)
    assert len(after) == 8
    assert all(after[name] == row for name, row in before.items())
    assert run_fleet(ReplayTask(model), folder, out, workers=1).done == 0


def test_what_has_changed_is_done_again_and_what_failed_on_request(model, folder, tmp_path):
    out = tmp_path / "out"
    run_fleet(ReplayTask(model), folder, out, workers=1)
    shutil.copy(folder / "truck_1" / "day_0.parquet", folder / "empty.parquet")
    changed = folder / "truck_1" / "day_1.parquet"
    os.utime(changed, (time.time() + 10, time.time() + 10))
    told = run_fleet(ReplayTask(model), folder, out, workers=1)
    assert told.done == 2
    assert rows_in(out)["empty.parquet"]["error"] is None
    told = run_fleet(ReplayTask(model), folder, out, workers=1, retry_failed=True)
    assert (told.done, told.failed) == (1, 1)  # notes.md is still none
    assert len(rows_in(out)) == 8


def test_other_settings_and_other_folders_are_refused_and_stay(model, folder, tmp_path):
    out = tmp_path / "out"
    run_fleet(ReplayTask(model), folder, out, pattern="day_0*", workers=1)
    before = rows_in(out)
    with pytest.raises(InputError, match="estimator"):
        run_fleet(ReplayTask(model, estimator="ukf"), folder, out, pattern="day_0*", workers=1)
    assert rows_in(out) == before
    told = run_fleet(
        ReplayTask(model, estimator="ukf"), folder, out, pattern="day_0*", workers=1, fresh=True
    )
    assert told.done == 1
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.txt").write_text("chapter 4")
    for fresh in (False, True):
        with pytest.raises(InputError, match="something else"):
            run_fleet(ReplayTask(model), folder, precious, fresh=fresh)
    assert os.listdir(precious) == ["thesis.txt"]


def test_results_inside_the_folder_of_logs_are_not_taken_for_logs(model, folder):
    out = folder / "results"
    run_fleet(ReplayTask(model), folder, out, workers=1)
    assert run_fleet(ReplayTask(model), folder, out, workers=1).logs == 8


@pytest.mark.slow
def test_an_address_is_a_cluster(model, folder, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        run_fleet(ReplayTask(model), folder, tmp_path / "out", scheduler=cluster.scheduler_address)
    assert len(rows_in(tmp_path / "out")) == 8


@dataclass(frozen=True)
class Deadly(ReplayTask):
    """Kills its worker on one log: once, or each time."""

    marker: str = ""
    always: bool = False

    def settings(self):
        return {"kind": "deadly"}

    def row(self, work, folder, name):
        if name.endswith("day_2.parquet") and (self.always or not os.path.exists(self.marker)):
            with open(self.marker, "w"):
                pass
            os.kill(os.getpid(), signal.SIGKILL)
        return super().row(work, folder, name)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a signal of POSIX")
@pytest.mark.parametrize("always", [False, True])
def test_a_killed_worker_loses_nothing(model, folder, tmp_path, always):
    import cloudpickle

    cloudpickle.register_pickle_by_value(sys.modules[Deadly.__module__])
    task = Deadly(model, marker=str(tmp_path / "once"), always=always)
    told = run_fleet(task, folder, tmp_path / "out", scheduler="processes", workers=2, batch=3)
    rows = rows_in(tmp_path / "out")
    assert len(rows) == 8
    assert (tmp_path / "once").exists()
    deadly = rows["truck_2/day_2.parquet"]
    if always:
        assert "the worker died on it" in deadly["error"]
        assert told.failed == 3
    else:
        assert deadly["error"] is None
        assert told.failed == 2


class _Never:
    """A future that nobody works on."""

    def done(self):
        return False

    def add_done_callback(self, call):
        pass


def test_workers_that_never_come_back_end_the_run(model, folder, monkeypatch):
    from cellwise.errors import MachineError

    patience = engine.PATIENCE._replace(without_s=0.5, ask_s=0.1)
    monkeypatch.setattr(engine, "PATIENCE", patience)
    gone = engine.Cluster(lambda *_: _Never(), lambda: 0)
    with pytest.raises(MachineError, match="no worker for"):
        list(engine.rows_of(gone, ReplayTask(model), folder, ["a.parquet"], 1))


def test_only_some_batches_are_in_hand(model, folder, monkeypatch):
    """However many logs there are: what waits stays a name."""
    monkeypatch.setattr(engine, "PATIENCE", engine.PATIENCE._replace(in_hand=3))
    flying, most = set(), [0]
    with engine.connected("local", 2) as threads:

        def counted(*work):
            flying.add(future := threads.submit(*work))
            most[0] = max(most[0], sum(not one.done() for one in flying))
            return future

        names = ["truck_1/day_0.parquet"] * 40
        limited = threads._replace(submit=counted)
        rows = list(engine.rows_of(limited, ReplayTask(model), folder, names, 1))
    assert sum(map(len, rows)) == 40
    assert most[0] <= 3


def test_a_failure_of_the_machine_is_none_of_the_log(model, folder, tmp_path, monkeypatch):
    """A disk that is full for a while: the logs are tried again, and only they."""
    from cellwise.fleet import tasks

    out, read = tmp_path / "out", tasks.read_prepared

    def failing(path, *arguments, **more):
        if path.name in ("day_1.parquet", "day_2.parquet"):
            raise OSError(28, "No space left on device")
        return read(path, *arguments, **more)

    monkeypatch.setattr(tasks, "read_prepared", failing)
    told = run_fleet(ReplayTask(model), folder, out, workers=1)
    assert (told.done, told.failed, told.machine) == (8, 4, 2)
    rows = rows_in(out)
    assert rows["truck_1/day_1.parquet"]["failed_by"] == "machine"
    assert "No space left" in rows["truck_1/day_1.parquet"]["error"]
    assert rows["notes.md"]["failed_by"] == "log"
    monkeypatch.setattr(tasks, "read_prepared", read)
    told = run_fleet(ReplayTask(model), folder, out, workers=1)
    assert (told.done, told.resumed, told.failed, told.machine) == (2, 6, 2, 0)
    assert run_fleet(ReplayTask(model), folder, out, workers=1).failed == 2  # still said


def test_a_cache_that_cannot_be_written_is_no_failure(model, folder, tmp_path):
    (tmp_path / "cache").write_text("a file where the folder would be")
    task = ReplayTask(model, cache=str(tmp_path / "cache"))
    told = run_fleet(task, folder, tmp_path / "out", workers=1)
    assert (told.failed, told.machine) == (2, 0)
    row = rows_in(tmp_path / "out")["truck_1/day_1.parquet"]
    assert "not kept in the cache" in row["notices"]


def test_hostile_files_are_rows_that_say_which_limit(model, folder, tmp_path, monkeypatch):
    pytest.importorskip("python_calamine")
    from tester_files import far_cell_workbook

    far_cell_workbook(folder / "far.xlsx")
    monkeypatch.setenv("CELLWISE_READ_ROWS", "950")
    (folder / "long.csv").write_text("time_s,current_A,voltage_V\n" + "1,1,3.7\n" * 2000)
    told = run_fleet(ReplayTask(model), folder, tmp_path / "out", workers=2, batch=1)
    rows = rows_in(tmp_path / "out")
    assert "limit of memory" in rows["far.xlsx"]["error"]
    assert "rows or more" in rows["long.csv"]["error"]
    assert rows["far.xlsx"]["failed_by"] == "log"
    assert told.logs == 10


@pytest.mark.slow
def test_a_diagnosis_of_every_log(model, tmp_path):
    place = tmp_path / "logs"
    place.mkdir()
    good = drive(1, 0.9, rows=3000)
    write_log(good, place / "good.parquet")
    wrong = replace(good, current_A=good.current_A + 0.3, charge_Ah=None)
    write_log(wrong, place / "offset.parquet")
    (place / "none.csv").write_text("x\n")
    task = DiagnoseTask(model, soc0=0.9, causes=("current_offset", "resistance_scale"))
    run_fleet(task, place, tmp_path / "out", workers=1)
    rows = rows_in(tmp_path / "out")
    assert rows["offset.parquet"]["verdict"] == "current_offset"
    assert "offset_A" in rows["offset.parquet"]["parameters"]
    assert rows["good.parquet"]["verdict"] in ("none", "undetermined")
    assert rows["none.csv"]["error"]
