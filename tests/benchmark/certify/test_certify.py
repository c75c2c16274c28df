"""`cellwise certify`: the exported C over virtual cells, through the command."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.benchmark.certify import Limits, certify, lives, read_export
from cellwise.benchmark.certify import run as certify_run
from cellwise.benchmark.certify.export_restarts import run_restarted
from cellwise.benchmark.certify.gauge import RESTART, SAVE, TORN, UPDATED
from cellwise.benchmark.certify.gauge_lives import life_events
from cellwise.benchmark.certify.restarts import restart_loss
from cellwise.benchmark.certify.virtual_cells import START_STD, CellSpread, aged, draw_cell
from cellwise.cell.model_error import ModelError
from cellwise.cell.posterior import POINTS, Posterior
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.options import Asked
from cellwise.estimate.fixed.stepper import start_state
from cellwise.estimate.replay import replay
from cellwise.estimate.sensor import CAR, Sensor
from cellwise.export.package import Export, write_package

pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None, reason="no C compiler"
)
SHORT = ["--cells", "4", "--hours", "12"]
PERFECT = Sensor(
    current_offset_C=0.0,
    current_gain=0.0,
    current_noise_C=0.0,
    voltage_offset_V=0.0,
    voltage_noise_V=0.0,
    temperature_K=0.0,
)
SAME = CellSpread(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def run(capsys, *arguments):
    """Exit code and JSON of the command."""
    try:
        code = main(["certify", *map(str, arguments), "--json"])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    return code, json.loads(out) if out else None, err


def test_certificate_of_an_export(folder, tmp_path, capsys):
    code, data, _ = run(capsys, folder, *SHORT, "-o", tmp_path / "c")
    assert code == 0
    assert data["cells"] == 4
    assert data["hours"] == 12
    assert data["verdict"]["within"] is None
    assert 0.0 < data["soc_error"]["rmse"] <= data["soc_error"]["worst"] <= 2.0
    assert 0.0 <= data["coverage_2sigma"] <= 1.0
    assert sum(g["cells"] for g in data["by"]["fault"].values()) == 4
    assert json.loads((tmp_path / "c" / "certificate.json").read_text()) == data
    assert "virtual cells" in (tmp_path / "c" / "index.html").read_text()


def test_layout_and_prefix_change_nothing(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("cellwise.export.cross.cores_here", list)
    other = tmp_path / "other"
    names = ["--prefix", "pouch", "--layout", "zephyr"]
    assert main(["export", "--model", "nmc-18650", "--dt", "5", "-o", str(other), *names]) == 0
    capsys.readouterr()
    assert (
        run(capsys, other, "--cells", "1", "--hours", "3")[1]
        == (run(capsys, folder, "--cells", "1", "--hours", "3")[1])
    )


@pytest.mark.parametrize("fault", [0, 1])
def test_what_is_certified_is_what_replay_steps(folder, fault):
    """The SOC of a life is that of `replay --estimator firmware`, to the bit: by a bank."""
    exported = read_export(folder)
    fleet = lives.Fleet(2, 0, (), 6.0, 1, CAR.of_cell(exported.model.capacity_Ah))
    life = fleet.life(exported.model, lives.MODEL, fault, exported.dt_s)
    start = life.about["started_at"]
    run = replay(exported.model, life.seen, "firmware", start, soc0_std=START_STD)
    said = certify_run.lived(exported, life, fleet.seed)
    np.testing.assert_array_equal(said.soc, run.trace.soc)
    np.testing.assert_array_equal(said.std, run.trace.soc_std)
    samples = samples_of(exported.model, life.seen, exported.dt_s)
    alone = exported.stepper.rows(start_state(exported.stepper, start, START_STD), samples.records)[
        samples.row_sample
    ]
    assert np.abs(alone["soc"] - said.soc).max() > 0.001  # one filter without a bank says other


def test_a_bank_has_as_many_components_as_its_readme_says(tmp_path):
    """One number: in README, glue of a layout, and what is certified; a lean one has no bank."""
    model = stock_model("nmc-18650")
    for layout, asked in ((None, {}), ("px4", {"components": 5}), (None, {"wide": False})):
        export = Export(model, 5.0, asked=Asked(**asked), layout=layout)
        place = tmp_path / f"{layout}{len(asked)}{export.components}"
        unmeasured = {"targets": [], "accuracy": [], "sockets": {}, "notices": []}
        write_package(export, place, export.description | unmeasured)
        memory = read_export(place).started(0.5, 0.15)
        assert memory.states.size == (1 if memory.bank is None else 1 + export.components)
        assert (memory.bank is None) == (not export.asked.wide)
        assert f"N = {export.components}" in (place / "README.md").read_text()
        glue = [path.read_text() for path in place.rglob("cellwise_glue.h")]
        assert len(glue) == (layout is not None)
        assert all(f"GLUE_COMPONENTS ({export.components}u)" in text for text in glue)


def test_a_limit_that_is_not_kept_is_exit_1(folder, capsys):
    code, data, _ = run(capsys, folder, *SHORT, "--most-rmse", "0.00001")
    assert code == 1
    assert data["verdict"]["within"] is False
    assert "rmse" in data["verdict"]["beyond"][0]
    code, data, _ = run(capsys, folder, *SHORT, "--most-rmse", "1")
    assert code == 0
    assert data["verdict"]["within"] is True


def test_a_run_goes_on_where_it_stopped(folder, tmp_path, capsys, monkeypatch):
    _, whole, _ = run(capsys, folder, *SHORT)
    place = tmp_path / "c"
    run(capsys, folder, "--cells", "2", "--hours", "12", "-o", place)
    rows = place / "cells.jsonl"
    rows.write_text(rows.read_text() + '{"cell": 2, "ag')  # cut off in a line
    done = []
    real = certify_run.run_life
    monkeypatch.setattr(
        certify_run,
        "run_life",
        lambda e, life, *more: done.append(life.about["cell"]) or real(e, life, *more),
    )
    _, rest, _ = run(capsys, folder, *SHORT, "-o", place)
    assert sorted(done) == [2, 3]
    assert rest == whole


def test_results_of_other_settings_are_not_taken_over(folder, tmp_path, capsys):
    asked = ("--cells", "1", "--hours")
    _, three, _ = run(capsys, folder, *asked, "3", "-o", tmp_path)
    _, four, _ = run(capsys, folder, *asked, "4", "-o", tmp_path)
    _, again, _ = run(capsys, folder, *asked, "3", "-o", tmp_path)
    assert four["hours"] == 4.0
    assert four["soc_error"] != three["soc_error"]
    assert again == three
    assert len((tmp_path / "cells.jsonl").read_text().splitlines()) == 2  # none was made twice


def test_a_perfect_cell_and_sensor_leave_little(folder, monkeypatch):
    """The fleet adds no error of its own: the model's own cell is followed closely."""
    exported = read_export(folder)
    with monkeypatch.context() as patch:
        patch.setattr(lives, "draw_cell", _own_cell)
        error = certify(exported, 2, 30.0, sensor=PERFECT).to_dict()["soc_error"]
    assert error["rmse"] < 0.01


def _own_cell(model, index, seed, hours, dt_s, sensor, _):
    spread = SAME
    certain = replace(model, error=ModelError.of_white_and_slow(0.0, 0.0))
    cell = draw_cell(certain, 2 * index, seed, hours, dt_s, sensor, spread)
    assert cell.truth.capacity_Ah == pytest.approx(model.capacity_Ah)
    return cell


def test_a_worse_sensor_is_seen(folder):
    exported = read_export(folder)
    good = certify(exported, 6, 20.0, sensor=PERFECT).to_dict()
    bad = certify(exported, 6, 20.0, sensor=Sensor(voltage_offset_V=0.2)).to_dict()
    assert bad["soc_error"]["rmse"] > good["soc_error"]["rmse"]


def test_the_last_digit_and_the_range_are_in_what_the_filter_sees(folder):
    exported = read_export(folder)
    sensor = replace(PERFECT, current_resolution_A=0.1, current_range_A=2.0)
    sensor = replace(sensor, voltage_resolution_V=0.01)
    seen = lives.Fleet(1, 0, (), 12.0, 1, sensor).life(exported.model, lives.MODEL, 0, 5.0).seen
    for values, step in ((seen.current_A, 0.1), (seen.voltage_V, 0.01)):
        assert np.abs(values / step - np.round(values / step)).max() < 1e-6
    assert np.abs(seen.current_A).max() == pytest.approx(2.0)


def restarted(exported):
    """Event, error and true SOC of lives with losses of power, a car's sensors."""
    fleet = lives.Fleet(16, 0, (), 48.0, 1, CAR.of_cell(exported.model.capacity_Ah))
    found = []
    for number in range(fleet.cells):
        life = fleet.life(exported.model, lives.MODEL, number, exported.dt_s)
        samples = samples_of(exported.model, life.seen, exported.dt_s)
        event, on, soc = life_events(life, samples, exported.dt_s, fleet.seed)
        start = (life.about["started_at"], START_STD)
        said, written = run_restarted(
            exported, samples.records[on], event[on], start, life.truth.capacity_Ah
        )
        found.append((event[on], written, said["soc"] - soc[on], soc[on]))
    return found


def test_a_restart_costs_an_export_at_most_a_point_beyond_what_flowed(folder):
    """Power lost in the middle of a write and for hours; tables updated."""
    for lived in restarted(read_export(folder)):
        assert {TORN, RESTART, UPDATED} <= set(lived[0])
        assert restart_loss(*lived) <= 0.01


@pytest.mark.parametrize("name", ["nmc-18650", "nca-18650", "lfp-26650", "lmo-pouch", "lipo-pouch"])
def test_a_restart_costs_a_cells_own_model_as_little(of_capacity_std, name):
    """Tables of a new cell, sure of 5 mV, on cells up to the end of their life."""
    for lived in restarted(read_export(of_capacity_std(0.004, name))):
        assert restart_loss(*lived) <= 0.01


def torn_at_100(exported, rate):
    """A load of a rate without a voltage, the power lost in a write."""
    records = np.zeros(200, dtype=INPUT)
    records["voltage_V"], records["temperature_C"] = np.nan, 25.0
    records["current_A"] = rate * exported.model.capacity_Ah
    records["sequence"] = np.arange(200)
    event = np.zeros(200, np.uint32)
    event[100] = TORN
    return records, event


def test_a_filter_that_keeps_nothing_begins_as_it_is_told(folder):
    """A write that was cut is refused: with no other the start is the one that is stated."""
    exported = read_export(folder)
    records, event = torn_at_100(exported, 0.06)  # 0.8 points: it asks for no write of its own
    said = run_restarted(exported, records, event, (0.7, 0.1), 1.0)[0]["soc"]
    assert said[100] == pytest.approx(said[0], abs=1e-6)
    event[50] = SAVE
    said = run_restarted(exported, records, event, (0.7, 0.1), 1.0)[0]["soc"]
    assert said[49] < said[0] - 0.003
    assert said[100] == pytest.approx(said[49], abs=2e-4)  # it goes on there: a step is 0.0001


def test_a_filter_keeps_its_state_where_the_soc_has_moved_by_a_point(folder):
    exported = read_export(folder)
    records, event = torn_at_100(exported, 1.0)
    event[10] = SAVE
    said, written = run_restarted(exported, records, event, (0.7, 0.1), 1.0)
    rows = np.flatnonzero(written[:100])
    assert np.all(np.diff(said["soc"][rows - 1]) < -0.01 + 1e-6)
    last = rows[-1] - 1
    assert said["soc"][100] == pytest.approx(said["soc"][last], abs=0.002)
    assert said["soc"][99] > said["soc"][last] - 0.02


def test_age_takes_capacity_and_adds_resistance(folder):
    model = read_export(folder).model
    cells = [aged(model, 1.0, np.random.default_rng(k), CellSpread()) for k in range(40)]
    assert np.mean([c.capacity_Ah for c in cells]) / model.capacity_Ah == pytest.approx(
        0.8, abs=0.03
    )
    assert np.mean([np.mean(c.r0_ohm / model.r0_ohm) for c in cells]) == pytest.approx(2.0, rel=0.1)
    for c in cells:  # the charge is counted between the same two voltages
        assert c.ocv_V[:, [0, -1]] == pytest.approx(model.ocv_V[:, [0, -1]], abs=1e-9)


def test_a_capacity_that_is_known_worse_widens_the_certificate(of_capacity_std, monkeypatch):
    """New cells without faults, the same for both but for what the fit left open of their capacity.

    On aged and faulty cells age and fault are all there is to see: a filter that knows its capacity
    to be open follows the voltage more closely, and is no worse there.
    """
    new = replace(CellSpread(), faded=0.0, resistance_grown=0.0, slipped_soc=0.0)
    monkeypatch.setattr(
        lives, "draw_cell", lambda cell, k, *asked: draw_cell(cell, 2 * k, *asked[:-1], new)
    )
    sure, unsure = (
        certify(read_export(of_capacity_std(std)), 24, 30.0, sensor=PERFECT, physics=0).to_dict()
        for std in (0.004, 0.05)
    )
    assert unsure["soc_error"]["rmse"] > 1.1 * sure["soc_error"]["rmse"]
    assert unsure["soc_error"]["p95"] > 1.1 * sure["soc_error"]["p95"]


def test_drawn_cells_have_the_posteriors_spread(folder):
    """Capacity, OCV in the middle and resistance scatter as the posterior says; the ends stay."""
    model = replace(read_export(folder).model, error=ModelError.of_white_and_slow(0.0, 0.0))
    one, none = np.ones(POINTS), np.zeros(POINTS)
    factor = np.array([[0.5, 0.0, 0.0], [0.4, 0.8, 0.0], [0.0, -0.3, 0.6]])
    fitted = Posterior(
        ("capacity_Ah", "ocv_mode_1", "resistance_mode_1"),
        factor,
        np.array([0.08, 0.0, 0.0]),
        np.array([none, 0.010 * one, none]),
        np.array([none, none, 0.2 * one]),
    )
    drawn = replace(model, posterior=fitted)
    cells = [aged(drawn, 0.0, np.random.default_rng(k), SAME) for k in range(2000)]
    middle = model.points // 2
    capacity = np.log([c.capacity_Ah / model.capacity_Ah for c in cells])
    ocv_V = np.array([c.ocv_V[0, middle] - model.ocv_V[0, middle] for c in cells])
    ln_r = np.log([c.r0_ohm[0, middle] / model.r0_ohm[0, middle] for c in cells])
    wanted = np.array([0.08, 0.010, 0.2])[:, None] * factor
    found = np.cov([capacity, ocv_V, ln_r])
    size = np.sqrt(np.diag(wanted @ wanted.T))
    np.testing.assert_allclose(
        found / np.outer(size, size), wanted @ wanted.T / np.outer(size, size), atol=0.1
    )
    for c in cells[:20]:
        assert c.ocv_V[:, [0, -1]] == pytest.approx(model.ocv_V[:, [0, -1]], abs=1e-9)


@pytest.mark.parametrize(
    ("name", "old", "new", "found"),
    [
        ("cell_table.c", "0x1", "0x1.8p+0f + 0x1", "bits that are not those"),
        ("cellwise_step.h", "float ", "flaot ", "does not compile"),
        ("cellwise_export.json", "{", "[", "missing or damaged"),
        ("cellwise_export.json", '"components": 11', '"components": 0', "missing or damaged"),
        ("cellwise_export.json", '"components"', '"others"', "missing or damaged"),
        ("cell.json", '"name": "', '"name": "other ', "sha256"),
    ],
)
def test_a_folder_that_was_changed_is_refused(folder, tmp_path, capsys, name, old, new, found):
    place = tmp_path / "changed"
    shutil.copytree(folder, place)
    text = (place / name).read_text()
    last = text.rindex(old) if name == "cell_table.c" else text.index(old)
    (place / name).write_text(text[:last] + new + text[last + len(old) :])
    code, data, err = run(capsys, place, *SHORT)
    assert (code, data) == (2, None)
    assert found in err


def test_a_limit_above_one_and_no_cell_are_refused():
    with pytest.raises(InputError, match="fraction"):
        Limits(rmse=3.0)
    with pytest.raises(InputError, match="one cell at least"):
        certify(None, 0)
