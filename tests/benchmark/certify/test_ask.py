"""`cellwise certify --ask`: the limit as text, the front, options on virtual cells."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cellwise.benchmark.certify.ask import DesignResult, find_designs, front, parse_ask
from cellwise.benchmark.certify.designs import (
    CAUSES,
    STEPS,
    Ask,
    Design,
    DesignOption,
    all_options,
)
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.sensor import CLASSES, seen_by
from cellwise.export.firmware import Firmware

needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None, reason="no C compiler"
)
MODEL = "nmc-18650"
REPOSITORY = Path(__file__).parents[3]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("5 % worst at -10 degC, 3 years", Ask(0.05, "worst", -10.0, 3.0)),
        ("  2.5% p95  at 25 °C, 1 year ", Ask(0.025, "p95", 25.0, 1.0)),
    ],
)
def test_a_limit_is_read_as_people_write_it(text, found):
    assert parse_ask(text) == found


@pytest.mark.parametrize("text", ["", "5 % worst", "5 % best at 0 degC, 1 year", "5. . % worst"])
def test_any_other_text_is_refused_with_an_example(text):
    with pytest.raises(InputError, match="5 % worst at -10 degC, 3 years"):
        parse_ask(text)


def test_a_step_costs_about_what_was_counted_last():
    """Instructions of `benchmarks/results/firmware.json`, which a release counts again."""
    counted = json.loads((REPOSITORY / "benchmarks/results/firmware.json").read_text())
    costs = counted["costs"]["cortex-m4f"]
    assert set(STEPS) == set(costs)
    for name, cost in costs.items():
        assert STEPS[name][1:] == pytest.approx(
            (cost["text_bytes"], cost["instructions_mean"]), rel=0.02
        )


def result(error, **costs):
    return DesignResult(DesignOption("car", "lean", 11, "none", False), error, 4, costs)


def test_no_result_of_a_front_is_at_least_as_good_as_another_in_everything():
    rng = np.random.default_rng(1)
    results = [result(e, bytes=b, hours=h) for e, b, h in rng.integers(0, 6, (60, 3))]
    best = front(results, is_kept=False)

    def is_better(a, b):
        x, y = (np.array([r.error, *r.costs.values()]) for r in (a, b))
        return np.all(x <= y) and np.any(x < y)

    assert not any(is_better(a, b) for a in results for b in best)
    for one in results:
        assert any(is_better(b, one) or np.array_equal(b[1:], one[1:]) for b in best) or one in best


@needs_compiler
def test_an_option_is_the_exported_c_on_its_tables():
    """Code that is compiled once for many tables says what each table's own code says."""
    design = Design(stock_model(MODEL), parse_ask("5 % worst at 20 degC, 0 years"), 10.0, 4.0, 1)
    options = [DesignOption(sensor, "lean", 21, "none", False) for sensor in ("car", "hall")]
    bank = design.step(DesignOption("car", "bank", 11, "none", False))
    life = design.life(options[0], 0)
    samples = samples_of(design.model, life.seen, 10.0)
    assert np.array_equal(
        bank.soc_of(samples.records, 0.5)[samples.row_sample], bank.run(life.seen, 0.5, 0.15).soc
    )
    for option in options:
        own = seen_by(design.model, CLASSES[option.sensor])
        alone = Firmware(own.model, own.noise, dt_s=10.0, wide=False, points=21)
        wanted = alone.run(life.seen, 0.5, 0.15).soc
        step = design.step(option)
        np.testing.assert_array_equal(step.run(life.seen, 0.5, 0.15).soc, wanted)
        found = step.soc_of(samples.records, 0.5)[samples.row_sample]
        np.testing.assert_array_equal(found, wanted)


@needs_compiler
def test_a_limit_that_all_keep_needs_the_cheapest_alone():
    design = Design(stock_model(MODEL), parse_ask("100 % worst at 20 degC, 1 year"), 60.0, 6.0, 1)
    cheapest = DesignOption("hall", "lean", 11, "none", False)
    dearer = [cheapest, DesignOption("shunt", "lean", 21, "ocv", True)]
    found = find_designs(design, 2, dearer)
    assert [one.option for one in found] == [cheapest]
    assert found[0].cells == 2


@needs_compiler
@pytest.mark.parametrize("limit", [3, 12])
def test_the_front_is_that_of_a_search_that_tries_everything_on_every_cell(limit):
    """Kept and not kept: a largest error grows with the cells, so what is left out is beaten."""
    ask = parse_ask(f"{limit} % worst at 0 degC, 2 years")
    design = Design(stock_model(MODEL), ask, 60.0, 8.0, 1)
    options = [one for one in all_options() if one.step in ("lean", "offset") and one.points == 11]
    found = find_designs(design, 9, options)
    everything = []
    for option in options:
        errors = []
        design.try_on([errors], [option], 9)
        worst = max(one["worst"] for one in errors)
        everything.append(DesignResult(option, worst, len(errors), design.costs(option)))
    kept = [one for one in everything if one.error <= ask.limit]
    assert bool(kept) == (limit == 12)
    wanted = {one.option: one for one in front(kept or everything, bool(kept))}
    assert {one.option: one for one in found} == wanted


@needs_compiler
def test_what_carries_the_error_is_found_by_leaving_it_out():
    """New cells have no age to lose; what is made perfect is the truth, and all else the same."""
    design = Design(stock_model(MODEL), parse_ask("1 % worst at 20 degC, 0 years"), 60.0, 6.0, 1)
    option = DesignOption("hall", "lean", 11, "none", False)
    errors = []
    design.try_on([errors], [option], 3)
    left = design.without_each(option, 3)
    assert left["age"] == max(one["worst"] for one in errors)
    assert set(left) == set(CAUSES)
    for number in range(3):
        seen = design.life(option, number, "sensor").seen
        life = design.life(option, number)
        assert np.array_equal(life.log.current_A, seen.current_A)
        assert not np.array_equal(life.log.current_A, life.seen.current_A)
        known = design.life(option, number, "start")
        assert known.about["started_at"] == pytest.approx(min(max(known.soc[0], 0.0), 1.0))
        usual = design.life(option, number, "temperature").log.temperature_C
        assert np.all(usual == design.model.usual_temperature_C)


@needs_compiler
def test_the_command_prints_the_front_and_writes_its_page(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("cellwise.benchmark.certify.designs.POINTS", (11,))
    monkeypatch.setattr("cellwise.benchmark.certify.designs.CLASSES", {"car": CLASSES["car"]})
    asked = ["--ask", "0.01 % rmse at 20 degC, 3 years", "--model", MODEL, "--dt", "60"]
    more = ["--cells", "1", "--hours", "3", "-o", str(tmp_path / "d"), "--json"]
    assert main(["certify", *asked, *more]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["reached"] is False
    assert data["front"]
    assert {"bytes", "instructions", "hours", "error"} <= set(data["front"][0])
    assert json.loads((tmp_path / "d" / "design.json").read_text()) == data
    left = [cause["error_without"] for cause in data["causes_of_best"]]
    assert left == sorted(left)
    page = (tmp_path / "d" / "index.html").read_text()
    assert "not reached" in page
    assert "What it takes" in page


def test_a_limit_without_a_model_is_refused(capsys):
    assert main(["certify", "--ask", "5 % worst at 0 degC, 1 year"]) == 2
    assert "--model" in capsys.readouterr().err
