"""`cellwise certify --gauge`: anybody's gauge, its limits, its causes, its restarts."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellwise.benchmark.certify import Gauge, causes
from cellwise.benchmark.certify.gauge import RESTART, SAMPLE, SAVE, TORN, UPDATED, config_of
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.errors import InputError

pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None, reason="no C compiler"
)
GAUGES = Path(__file__).parent / "gauges"
MODEL = "nmc-18650"
# What is wrong with a gauge, and the cause that has to be named first.
PLANTED = {
    "table": "#define TABLE_V(soc) (0.16f * ((soc) - 0.5f) * ((soc) - 0.5f) - 0.02f)",
    "capacity": "#define CAPACITY 0.9f",
    "current_sensor": "#define OFFSET_A 0.05f",
    "start": "#define START -0.2f",
    "resistance": "#define RESISTANCE 0.3f",
}


def gauge_of(folder, name, line="", dt_s=20.0):
    """A gauge with something wrong."""
    source = folder / f"{name}.c"
    source.write_text(f'{line}\n#include "{GAUGES / name}.c"\n')
    return Gauge(source, None, stock_model(MODEL), dt_s)


@pytest.fixture
def own(tmp_path):
    """A gauge whose step is a text, with the folder left out."""

    def write(step, more=""):
        source = tmp_path / "own.c"
        source.write_text(
            f'#include "gauge.h"\n#include <math.h>\n#include <stdlib.h>\n#include <unistd.h>\n'
            "static int n; static float told, capacity;\n"
            "void gauge_init(const gauge_config *c)\n"
            "{ told = c->soc0; capacity = c->capacity_Ah; }\n"
            "float gauge_step(float i, float v, float t, float dt, float *std)\n"
            f"{{ n++; *std = NAN; {step} return told; }}\n{more}"
        )
        return Gauge(source, None, stock_model(MODEL), 1.0)

    return write


def samples(rows, **events):
    found = np.zeros(rows, dtype=SAMPLE)
    found["voltage_V"], found["dt_s"] = 3.7, 1.0
    for row, kind in events.items():
        found["event"][int(row[1:])] = kind
    return found


@pytest.mark.parametrize(
    ("step", "problem"),
    [
        ("if (n > 300) return NAN;", "said no number at sample 300"),
        ("if (n > 300) abort();", "crashed at sample 300 of 500 (SIGABRT)"),
        ("if (n > 300) exit(0);", "ended at sample 300"),
        pytest.param(
            "if (n > 300) for (;;);", "took too long at sample 300", marks=pytest.mark.slow
        ),
        (
            "if (n > 300) { char *p = malloc(1u << 30); *(volatile char *)p = 1; }",
            "crashed at sample 300 of 500 (SIGSEGV)",
        ),
    ],
)
def test_what_a_gauge_does_wrong_is_a_result(own, step, problem):
    gauge = own(step)
    said = gauge.run(config_of(gauge.model, 0.25), samples(500))
    assert said.problem.startswith(problem)
    assert np.all(said.soc[:300] == 0.25)
    assert np.all(np.isnan(said.soc[300:]))


def test_a_restart_is_a_new_process_that_is_told_the_last_whole_write(own):
    """A counter of samples begins anew; what was said at the write before comes back."""
    gauge = own("told -= 0.001f; *std = (float)n;")
    told = config_of(gauge.model, 0.9)
    said = gauge.run(told, samples(400, r100=SAVE, r150=TORN, r200=SAVE, r300=RESTART))
    assert said.std[149] == 150
    assert said.std[150] == 1
    assert said.soc[150] == pytest.approx(said.soc[99] - 0.001)
    assert said.soc[300] == pytest.approx(said.soc[199] - 0.001)
    assert not said.problem


def test_a_record_that_was_cut_is_for_the_gauge_to_refuse(own):
    """Half of a record comes first; refused, the whole one before it."""
    gauge = own(
        "told -= 0.001f;",
        "unsigned gauge_save(void *to, unsigned size)"
        "{ float *x = to; x[0] = 42.0f; x[1] = told; (void)size; return 8u; }\n"
        "int gauge_restore(const void *from, unsigned size)"
        "{ const float *x = from; (void)size; if (x[1] <= 0.0f || x[0] != 42.0f) return 0;"
        " told = x[1]; return 1; }\n",
    )
    said = gauge.run(config_of(gauge.model, 0.9), samples(200, r100=SAVE, r150=TORN))
    assert said.soc[150] == pytest.approx(said.soc[99] - 0.001)


def test_updated_tables_are_told_after_the_restart(own):
    """The capacity is the new one, the SOC what was said last."""
    gauge = own("told -= 0.1f * i / capacity; *std = capacity;")
    told = config_of(gauge.model, 0.9)
    driven = samples(20, r10=UPDATED)
    driven["current_A"][:10] = told.capacity_Ah / 10.0
    said = gauge.run(told, driven, told._replace(capacity_Ah=2.0))
    assert said.soc[9:11] == pytest.approx((0.8, 0.8))
    assert said.std[9:11] == pytest.approx((told.capacity_Ah, 2.0))


def test_a_gauge_that_does_not_compile_is_refused(tmp_path):
    source = tmp_path / "bad.c"
    source.write_text("int gauge_init(")
    with pytest.raises(InputError, match="does not compile"):
        _ = Gauge(source, None, stock_model(MODEL), 1.0).program
    with pytest.raises(InputError, match="no gauge"):
        _ = Gauge(tmp_path / "none.c", None, stock_model(MODEL), 1.0).program


def found_causes(tmp_path, name, cause, dt_s):
    found, error, left = causes.own_causes(
        gauge_of(tmp_path, name, PLANTED[cause], dt_s), sensor=None, seed=1
    )
    assert left <= error
    return found, error


def split_of(folder, name, line, seed, cell="lmo-pouch"):
    """Causes and errors of a gauge on a cell that took no part in what was planted."""
    gauge = replace(gauge_of(folder, name, line), model=stock_model(cell))
    return causes.own_causes(gauge, sensor=None, seed=seed)


def test_a_planted_capacity_is_found_with_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(causes, "LIVES", 2)
    monkeypatch.setattr(causes, "HOURS", 12.0)
    found, error, left = causes.own_causes(
        gauge_of(tmp_path, "counter", PLANTED["capacity"], 60.0), sensor=None, seed=1
    )
    assert found[0].name == "capacity"
    assert found[0].correction == pytest.approx(0.9, abs=0.01)  # right at nine tenths of the load
    assert left < 0.3 * error


def test_age_is_what_makes_a_counter_wrong(tmp_path, monkeypatch):
    """On fresh cells, with a true start and perfect sensors, counting is right."""
    monkeypatch.setattr(causes, "LIVES", 2)
    monkeypatch.setattr(causes, "HOURS", 12.0)
    found, error, _ = causes.own_causes(gauge_of(tmp_path, "counter", "", 60.0), None, seed=1)
    assert found[0].name == "age"
    assert found[0].points > error
    assert {cause.name for cause in found} >= {"tuning", "restart"}


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """Causes of two gauges with each fault."""
    pairs = [(name, cause) for name in ("ekf1", "autopilot") for cause in PLANTED]
    return {pair: found_causes(tmp_path_factory.mktemp("planted"), *pair, 20.0) for pair in pairs}


@pytest.fixture(scope="module")
def split_on_another_cell(tmp_path_factory):
    """Points of each cause, and the error, of a gauge with a line, on another cell."""

    def split(line):
        found, error, _ = split_of(tmp_path_factory.mktemp("gauge"), "ekf1", line, 1)
        return {one.name: one.points for one in found}, error

    healthy = split("")
    return lambda line: (healthy, split(line))


@pytest.mark.slow
@pytest.mark.parametrize("cause", PLANTED)
def test_a_fault_raises_its_cause_by_what_it_adds_to_the_error(split_on_another_cell, cause):
    """To a fifth, or 0.1 points."""
    (healthy, before), (planted, after) = split_on_another_cell(PLANTED[cause])
    assert planted[cause] - healthy[cause] == pytest.approx(after - before, rel=0.2, abs=0.001)


@pytest.mark.slow
def test_nine_of_ten_planted_causes_are_named_first_to_correct(planted):
    """Beside it stands what remains: age, restarts, tuning cost these gauges without a fault."""
    named = [causes.to_correct(*found) == cause for (_, cause), found in planted.items()]
    assert sum(named) >= 9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf1", "autopilot"])
def test_a_correction_brings_on_other_lives_what_is_said(tmp_path, name):
    """Without a fault: told R0 alone they need more for the branches; then none is to correct."""
    (found, error, _), (_, other, _) = (split_of(tmp_path, name, "", seed) for seed in (1, 2))
    first = next(one for one in found if one.unit)
    assert causes.to_correct(found, error) == first.name == "resistance"
    line = f"#define RESISTANCE {1.0 + first.correction:.3f}f"
    found, after, _ = split_of(tmp_path, name, line, 2)
    assert other - after > 0.8 * first.points
    assert causes.to_correct(found, after) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("cell", ["nca-18650", "lmo-pouch"])
def test_of_a_counter_with_right_numbers_none_is_to_correct(tmp_path, cell, seed):
    """Also where any lower voltage would keep it from a reset that comes early in the cold."""
    found, error, _ = split_of(tmp_path, "counter", "", seed, cell)
    assert causes.to_correct(found, error) is None


def test_the_command_splits_the_error_and_shows_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(causes, "LIVES", 1)
    monkeypatch.setattr(causes, "HOURS", 6.0)
    place = tmp_path / "c"
    source = str(GAUGES / "ekf1.c")
    asked = ["--gauge", source, "--model", MODEL, "--dt", "60", "--cells", "2", "--hours", "24"]
    assert main(["certify", *asked, "--physics", "0", "-o", str(place), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    points = [cause["points"] for cause in data["causes"]]
    assert points == sorted(points, reverse=True)
    assert {c["name"] for c in data["fleet_causes"]} >= {"age", "restart", "start", "capacity"}
    assert data["failures"] == []
    assert data["settings"]["gauge"] == "ekf1"
    page = (place / "index.html").read_text()
    first = "What would bring most to correct" if data["to_correct"] else "No number of its own"
    assert first in page
    assert "What no number of the gauge corrects" in page
    assert "the gauge ekf1" in page


def test_a_gauge_that_crashes_keeps_no_limit(own, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(causes, "LIVES", 1)
    monkeypatch.setattr(causes, "HOURS", 3.0)
    source = str(own("if (n > 10) abort();").source)
    asked = ["--gauge", source, "--model", MODEL, "--dt", "60", "--cells", "1", "--hours", "6"]
    with pytest.raises(SystemExit) as stop:
        main(["certify", *asked, "--physics", "0", "--most-worst", "1", "--json"])
    assert stop.value.code == 1
    data = json.loads(capsys.readouterr().out)
    assert "crashed" in data["failures"][0]["problem"]
    assert data["soc_error"]["worst"] == 1.0
    assert data["coverage_2sigma"] is None


def test_the_header_is_written_and_compiles_alone(tmp_path, capsys):
    header = tmp_path / "cellwise_gauge.h"
    assert main(["certify", "--gauge-header", str(header)]) == 0
    assert "gauge_step" in header.read_text()


@pytest.mark.parametrize(
    ("asked", "found"),
    [
        ((), "neither an export nor a gauge"),
        (("x", "--gauge", "y.c"), "an export and a gauge"),
        (("--gauge", "y.c"), "without --model"),
        (("--gauge", "y.c", "--model", MODEL, "--dt", "0"), "time step"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(capsys, asked, found):
    assert main(["certify", *asked]) == 2
    assert found in capsys.readouterr().err


def test_the_gauge_on_the_page_compiles_and_counts(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "certificate.md").read_text()
    source = tmp_path / "counter.c"
    source.write_text("#include" + page.partition("```text\n#include")[2].partition("```")[0])
    gauge = Gauge(source, None, stock_model(MODEL), 1.0)
    told = config_of(gauge.model, 0.5)
    one_hour = samples(3600)
    one_hour["current_A"] = 0.1 * told.capacity_Ah
    assert gauge.run(told, one_hour).soc[-1] == pytest.approx(0.4, abs=1e-3)
