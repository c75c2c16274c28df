"""From a field log to a patch, and the same lives of the C without and with it: the commands."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from cellwise.cell.model_file import write_model
from cellwise.cell.simulate import simulate
from cellwise.cli import main
from cellwise.logs import CellLog, write_log
from example_cells import curved_cell
from random_loads import random_load

pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None, reason="no C compiler"
)
OFFSET_A = 0.15
DT = "2"


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """Model, export that takes patches, and a log of a sensor that shows 50 mA/Ah too much."""
    place = tmp_path_factory.mktemp("field")
    cell = curved_cell()
    write_model(cell, place / "cell.json")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cellwise.export.cross.cores_here", list)
        for name, more in (("firmware", ["--health"]), ("plain", [])):
            export = ["export", "--model", str(place / "cell.json"), "--dt", DT, *more]
            assert main([*export, "-o", str(place / name)]) == 0
    rng = np.random.default_rng(8)
    load = random_load(
        rng, 3.0, 0.9, rows=6000, rate_hz=0.5, charge=True, temperature_C=(24.0, 26.0)
    )
    voltage_V = simulate(cell, load, 0.9).voltage_V + rng.normal(0.0, 1e-3, len(load))
    for name, off_A in (("odd", OFFSET_A), ("good", 0.0)):
        log = CellLog(load.time_s, load.current_A + off_A, voltage_V, load.temperature_C)
        write_log(log, place / f"{name}.csv")
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


@pytest.fixture(scope="module")
def diagnosed(field):
    """What `diagnose --patch` writes of the odd log."""
    arguments = ["diagnose", "--model", field / "cell.json", field / "odd.csv", "--soc0", "0.9"]
    more = ["--patch", field / "a.patch", "--export", field / "firmware", "--generation", "3"]
    assert main([*map(str, arguments), *map(str, more)]) == 0
    return field / "a.patch"


def test_certificate_before_and_after_the_patch(field, diagnosed, tmp_path, capsys):
    """The log's own cell: with the patch a tenth of the error is left; virtual cells beside it."""
    assert len(diagnosed.read_bytes()) <= 128
    fleet = ["--cells", "1", "--hours", "2", "--log", f"{field / 'odd.csv'}@soc0=0.9"]
    certify = ["certify", field / "firmware", *fleet]
    code, data, err = run(capsys, *certify, "--patch", diagnosed, "-o", tmp_path / "c")
    assert code == 0, err
    assert set(data["patched"]) == set(data["sources"]) == {"model", "measured"}
    _, plain, _ = run(capsys, *certify)
    assert "patched" not in plain
    assert plain["sources"] == data["sources"]
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
    asked = ["diagnose", "--model", field / "cell.json", field / "odd.csv", "--patch", short]
    code, _, err = run(capsys, *asked)
    assert code == 2
    assert "--export" in err


def test_where_nothing_is_wrong_there_is_no_patch(field, capsys, tmp_path):
    asked = ["diagnose", "--model", field / "cell.json", field / "good.csv", "--soc0", "0.9"]
    more = ["--patch", tmp_path / "a.patch", "--export", field / "firmware"]
    code, data, _ = run(capsys, *asked, *more)
    assert code == 0
    assert data["patch"] is None
    assert not (tmp_path / "a.patch").exists()
