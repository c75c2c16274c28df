"""From a field log to a patch, and the same lives of the C without and with it: the commands."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.cli import main
from cellwise.logs import CellLog, write_log
from diagnosis_cases import odd_sensor
from example_cells import curved_cell

pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None, reason="no C compiler"
)
OFFSET_A = 0.12
# Few causes: the commands are under test, not the judge.
QUICK = ("--cause", "current_offset", "--cause", "resistance_scale")


def long_drive():
    """Three hours of the same cell and sensor, beside them the tester's counter."""
    rng = np.random.default_rng(5)
    time_s = np.arange(5400) * 2.0
    true_A = np.repeat(rng.uniform(-1.0, 2.0, 270), 20)
    log = CellLog(time_s, true_A, np.full(time_s.size, 3.7))
    voltage_V = simulate(curved_cell(), log, 0.9).voltage_V + rng.normal(0.0, 1e-3, time_s.size)
    charge_Ah = np.cumsum(true_A * log.interval_s) / 3600.0
    return CellLog(time_s, true_A + OFFSET_A, voltage_V, charge_Ah=charge_Ah)


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """Drives whose current sensor adds a constant; exports of their model, one takes patches."""
    place = odd_sensor(tmp_path_factory.mktemp("field"), OFFSET_A)
    write_log(long_drive(), place / "long.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cellwise.export.cross.cores_here", list)
        for name, more in (("firmware", ["--health"]), ("plain", [])):
            export = ["export", "--model", str(place / "cell.json"), "--dt", "2", *more]
            assert main([*export, "-o", str(place / name)]) == 0
    return place


def run(capsys, *arguments):
    """Exit code, JSON and errors of a command."""
    capsys.readouterr()
    try:
        code = main([*map(str, arguments), "--json"])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    return code, json.loads(out) if out else None, err


def asked_of(field):
    logs = (field / "drive.csv", "--holdout", field / "held.csv")
    return ["diagnose", "--model", field / "cell.json", *logs, "--soc0", "0.9", *QUICK]


@pytest.fixture(scope="module")
def diagnosed(field):
    """What `diagnose --patch` writes of it."""
    more = ["--patch", field / "a.patch", "--export", field / "firmware", "--generation", "3"]
    assert main([*map(str, (*asked_of(field), *more))]) == 0
    return field / "a.patch"


def test_certificate_before_and_after_the_patch(field, diagnosed, tmp_path, capsys):
    """Of the log's own cell, faults beside it, half of the squares go; virtual cells beside it."""
    assert len(diagnosed.read_bytes()) <= 128
    fleet = ["--cells", "1", "--hours", "2", "--log", f"{field / 'long.csv'}@soc0=0.9"]
    certify = ["certify", field / "firmware", *fleet]
    code, data, err = run(capsys, *certify, "--patch", diagnosed, "-o", tmp_path / "c")
    assert code == 0, err
    assert set(data["patched"]) == set(data["sources"]) == {"model", "measured"}
    _, plain, _ = run(capsys, *certify)
    assert "patched" not in plain
    assert plain["sources"] == data["sources"]
    before, after = (data[k]["measured"]["rmse"] for k in ("sources", "patched"))
    assert after**2 < 0.5 * before**2
    page = (tmp_path / "c" / "index.html").read_text()
    assert "as exported" in page
    assert "with the patch" in page


def test_limits_are_those_of_the_runs_with_the_patch(field, diagnosed, capsys):
    fleet = ["--cells", "2", "--hours", "3"]
    certify = ["certify", field / "firmware", *fleet, "--patch", diagnosed]
    _, data, _ = run(capsys, *certify)
    before, after = (data[k]["model"]["rmse"] for k in ("sources", "patched"))
    assert before < after  # cells whose sensor is right: the patch of another one harms
    code, data, _ = run(capsys, *certify, "--most-rmse", f"{0.5 * (before + after)}")
    assert code == 1
    assert not data["verdict"]["within"]


def test_what_takes_no_patch_and_what_is_none_is_refused(field, diagnosed, capsys, tmp_path):
    code, _, err = run(capsys, "certify", field / "plain", "--patch", diagnosed)
    assert code == 2
    assert "--health" in err
    short = tmp_path / "short.patch"
    short.write_bytes(diagnosed.read_bytes()[:-1])
    code, _, err = run(capsys, "certify", field / "firmware", "--patch", short)
    assert code == 2
    assert "damaged" in err
    code, _, err = run(capsys, *asked_of(field), "--patch", short)
    assert code == 2
    assert "--export" in err


def test_where_nothing_is_found_there_is_no_patch(field, capsys, tmp_path):
    asked = [*asked_of(field)[:-4], "--cause", "hysteresis"]  # which it does not have
    more = ["--patch", tmp_path / "a.patch", "--export", field / "firmware"]
    code, data, _ = run(capsys, *asked, *more)
    assert code == 0
    assert data["patch"] is None
    assert data["no_patch"]
    assert not (tmp_path / "a.patch").exists()
