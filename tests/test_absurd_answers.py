"""Answers that no engineer would give: each kind was given once, and is not given again."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import cellwise as cw
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.simulate import simulate
from cellwise.cli.replay_output import print_forecasts, print_runs, state_of_health
from cellwise.diagnose.limits import next_test
from cellwise.errors import InputError
from cellwise.estimate.status import Status
from cellwise.estimate.trace import long_innovation, soc_step
from cellwise.identify.identification import Start
from cellwise.identify.own_logs import simulate_back, updates_for_worse
from cellwise.live.run import Counts, check_any
from cellwise.notices import Code
from cellwise.report.page.markup import escape
from cellwise.report.page.numerals import significant
from cellwise.report.replay.page import flight_content, flight_finding, replay_page
from cellwise.report.replay.replay_section import reached, replay_finding
from cellwise.workflows.replaying import ReplayRequest
from example_cells import curved_cell, random_log
from virtual_tester import logged

MODEL = curved_cell()
MINUTES = 90


def followed(innovation_V=0.0, step=0.0, how="rest"):
    """A replay of ninety minutes, one row a second, whose filter was off by so much."""
    n = 60 * MINUTES
    log = cw.CellLog(np.arange(float(n)), np.full(n, 0.5), np.full(n, 3.7))
    found = simulate(MODEL, log, 0.8)
    soc = found.soc + np.where(np.arange(n) >= n // 2, step, 0.0)
    zeros, off = np.zeros(n), np.broadcast_to(innovation_V, n).astype(float)
    log = cw.CellLog(log.time_s, log.current_A, found.voltage_V + off)
    trace = cw.Trace(log.time_s, soc, zeros + 0.01, found.voltage_V, off, zeros + 1e-4, zeros,
                     zeros.astype(np.int32))  # fmt: skip
    return cw.Replay(log, "ekf", InitialSoc(0.8, 0.01, how), trace, 1.0, None, model=MODEL)


def between(first, last, value):
    """An innovation [V] from one minute to another."""
    minute = np.arange(60 * MINUTES) / 60.0
    return np.where((minute >= first) & (minute < last), value, 0.0)


def test_innovations_of_95_mv_for_43_minutes_are_remarked_on():
    run = followed(between(20, 63, -0.095))
    (said,) = (n for n in run.notices if n.code is Code.LONG_INNOVATION)
    assert re.search(r"9[45] mV below what is predicted for 43 min, from 20 min on", said.text)
    assert said.rows.start == pytest.approx(20 * 60, abs=60)
    assert said.rows.stop == pytest.approx(63 * 60, abs=60)
    assert "stated start" not in said.text


@pytest.mark.parametrize(
    "innovation_V",
    [0.0, between(20, 28, -0.095), between(20, 63, -0.010)],
    ids=["none", "short", "small"],
)
def test_short_and_small_ones_are_not(innovation_V):
    assert long_innovation(MODEL, followed().log, followed(innovation_V).trace) is None


def test_noise_of_the_size_that_the_model_states_is_not_remarked_on():
    """Ten minutes beyond three deviations do not happen to a model that is right."""
    rng = np.random.default_rng(0)
    n, memory = 60 * MINUTES, np.exp(-1.0 / 300.0)
    slow = np.zeros(n)
    for k in range(1, n):
        slow[k] = memory * slow[k - 1] + 0.010 * np.sqrt(1.0 - memory**2) * rng.normal()
    assert long_innovation(MODEL, followed().log, followed(slow).trace) is None


@pytest.mark.parametrize(("how", "said"), [("stated", True), ("given", True), ("rest", False)])
def test_a_stated_start_is_questioned_where_the_voltage_contradicts_it_from_the_first_row(
    how, said
):
    notices = followed(-0.075, how=how).notices
    (notice,) = (n for n in notices if n.code is Code.LONG_INNOVATION)
    assert ("the stated start (0.800) may be wrong" in notice.text) == said


def test_a_step_of_the_soc_in_one_sample_is_marked():
    run = followed(step=-0.06)
    (said,) = (n for n in run.notices if n.code is Code.SOC_STEP)
    assert said.rows == range(30 * MINUTES, 30 * MINUTES + 1)
    before, after = 100.0 * run.soc[30 * MINUTES - 1], 100.0 * run.soc[30 * MINUTES]
    assert f"from {before:.1f} to {after:.1f} % in one sample after 45 min" in said.text


def test_what_flowed_is_no_step_and_neither_is_the_first_minute():
    log = random_log(np.random.default_rng(3), rows=200)
    large = cw.CellLog(60.0 * np.arange(200.0), 3.0 * np.sign(log.current_A), log.voltage_V)
    found = simulate(MODEL, large, 0.5)
    assert np.abs(np.diff(found.soc)).max() > 0.01
    counted = SimpleNamespace(soc=found.soc)
    assert soc_step(MODEL, large, counted) is None
    settled = SimpleNamespace(soc=found.soc + np.where(np.arange(200) == 0, 0.2, 0.0))
    assert soc_step(MODEL, large, settled) is None
    moved = SimpleNamespace(soc=found.soc + np.where(np.arange(200) < 50, 0.03, 0.0))
    assert soc_step(MODEL, large, moved) == 50


@pytest.mark.parametrize(
    ("shown", "said"), [(True, "90.0 +- 2.0 % of the stated capacity"), (False, "not determined")]
)
def test_a_state_of_health_is_no_echo_of_the_capacity_that_was_typed_in(shown, said):
    capacity = {"value": 2.7, "std": 0.03, "shown": shown}
    text = state_of_health({"capacity_Ah": capacity, "soh_capacity": 0.9, "soh_resistance": 1.1})
    assert text.startswith(said)
    assert ("%" in text) == shown


@pytest.mark.parametrize(("invalid", "refused"), [(10, True), (9, False)])
def test_a_stream_of_a_pack_read_as_one_cell_is_refused(invalid, refused):
    counts = Counts(
        samples=10, invalid=invalid, last=SimpleNamespace(sample=cw.Sample(9.0, 1.0, 22.2))
    )
    source = SimpleNamespace(name="flight.jsonl")
    if not refused:
        check_any(source, counts)
        return
    with pytest.raises(InputError, match=r"the last is 22.2 V.*State `series=N`"):
        check_any(source, counts)


def test_the_stream_counts_what_no_cell_gives():
    live = cw.LiveFilter(MODEL, soc0=0.5)
    updates = [live.take(cw.Sample(float(k), 1.0, v)) for k, v in enumerate((22.2, 3.7))]
    assert [bool(u.info.status & Status.VOLTAGE_INVALID) for u in updates] == [True, False]


def test_a_test_is_asked_for_at_the_temperature_at_which_the_log_began():
    warming = SimpleNamespace(temperature_C=np.linspace(0.0, 30.0, 100))  # by its own heat
    open_ = SimpleNamespace(open_between=(), accepted=(), first=())
    assert "HPPC at 0 degC" in next_test(open_, MODEL, SimpleNamespace(logs=(warming,)))


@pytest.mark.parametrize(("updated", "worse"), [(1.4, True), (1.0, False)])
def test_an_update_that_follows_its_own_flight_worse_than_before_is_said(updated, worse):
    flight = replace(random_log(np.random.default_rng(5), rows=600), name="flight")
    truth = simulate(MODEL, flight, 0.9)
    flight = replace(flight, voltage_V=truth.voltage_V, soc0=0.9)
    model, before = MODEL.with_resistances(updated), MODEL.with_resistances(1.2)
    fitted = SimpleNamespace(starts=(Start(flight, 0.9),))
    (own,) = simulate_back(model, cw.CellTests(drive=flight), fitted, before)
    assert own.to_dict()["prior_rmse_V"] == pytest.approx(
        simulate(before, flight, 0.9).rmse_V, rel=1e-9
    )
    said = updates_for_worse([own])
    assert [n.code for n in said] == [Code.UPDATE_WORSE] * worse
    if worse:
        assert f"{1e3 * own.prior_rmse_V:.1f} mV" in said[0].text


def test_without_a_model_to_update_nothing_is_compared():
    flight = replace(random_log(np.random.default_rng(5), rows=600), soc0=0.9)
    fitted = SimpleNamespace(starts=(Start(flight, 0.9),))
    (own,) = simulate_back(MODEL, cw.CellTests(drive=flight), fitted)
    assert own.prior_rmse_V is None
    assert not updates_for_worse([own])


def test_a_wrong_start_is_no_large_nis_and_a_wrong_model_is_said_once_on_the_page(tmp_path):
    log = random_log(np.random.default_rng(7), rows=1200)
    log = logged(MODEL, log, 0.8)
    right, wrong = (cw.replay(MODEL, log, "ekf", soc0) for soc0 in (0.8, 0.5))
    assert max(wrong.nis) < max(4.0, 2.0 * max(right.nis))
    assert not [n for n in wrong.notices if n.code is Code.MODEL_OFF]
    minutes = 0.1 * np.sin(log.time_s / 100.0)
    off = cw.replay(MODEL, replace(log, voltage_V=log.voltage_V + minutes), "ekf", 0.8)
    assert max(off.nis) > 4.0
    (said,) = (n for n in off.notices if n.code is Code.MODEL_OFF)
    assert f"(NIS {max(off.nis):.1f})" in said.text
    page = replay_page([off], tmp_path / "page.html").read_text()
    shown = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL).lower()
    assert shown.count(escape(said.text).lower()) == 1


def test_settled_is_not_claimed_while_the_stated_deviation_is_larger():
    """A start that happens to be right is within two points from the first row on, by luck."""
    run = followed(np.zeros(60 * MINUTES))
    minutes = run.log.time_s / 60.0
    unsure = replace(
        run,
        start=InitialSoc(0.5, 0.15, "given"),
        trace=replace(run.trace, soc_std=np.where(minutes < 20.0, 0.15, 0.01)),
        reference_soc=run.trace.soc,
    )
    assert unsure.convergence_s == 0.0
    assert unsure.settled_s == pytest.approx(20 * 60.0, abs=60.0)
    never = replace(unsure, trace=replace(run.trace, soc_std=np.full(len(minutes), 0.15)))
    assert never.settled_s is None
    assert reached(never) == "never by its own band"
    assert "its own deviation stays above" in replay_finding(never)


def test_the_band_beside_an_error_is_of_the_same_rows():
    """Near empty the OCV is steep and what a model states many times what it states elsewhere."""
    log = random_log(np.random.default_rng(3), rows=1200)
    found = cw.simulate(MODEL, log, 0.2)
    above = found.soc > 0.1
    stated = found.stated_V
    assert found.band_V == pytest.approx(np.sqrt(np.mean(stated**2)))
    assert found.band_above_10pct_V == pytest.approx(np.sqrt(np.mean(stated[above] ** 2)))
    assert found.to_dict()["band_above_10pct_V"] == found.band_above_10pct_V


@pytest.mark.parametrize("rest_s", [0, 57])
def test_a_rest_at_the_end_of_a_log_is_no_present_load(rest_s, capsys):
    """Its last minute holds seconds of load: their mean is no load that goes on for hours."""
    time_s = np.arange(1800.0)
    current_A = np.where(time_s < time_s.size - rest_s, MODEL.capacity_Ah, 0.0)
    log = cw.CellLog(time_s, current_A, np.full(time_s.size, 3.7))
    log = logged(MODEL, log, 0.9)
    run = cw.replay_and_forecast(MODEL, log, ReplayRequest("ekf", soc0=0.9))
    assert run.flight.stands == (rest_s > 0)
    print_forecasts(run)
    said = capsys.readouterr().out
    assert ("load of the last minute" in said) == (rest_s == 0)
    assert ("ends at a rest" in said) == (rest_s > 0)
    assert "usual load" in said


def test_pilots_read_the_energy_of_their_pack(tmp_path, capsys):
    flight = random_log(np.random.default_rng(9), rows=600)
    flight = replace(flight, voltage_V=4.0 * simulate(MODEL, flight, 0.8).voltage_V)
    place = cw.write_log(replace(flight, current_A=2.0 * flight.current_A), tmp_path / "flight.csv")
    log = cw.read_log(place, series=4, parallel=2)
    assert (log.series, log.parallel) == (4, 2)
    run = cw.replay_and_forecast(MODEL, log)
    of_cell = run.flight.last.remaining_Wh
    assert run.cells == run.to_dict()["forecast"]["cells"] == 8
    assert run.to_dict()["forecast"]["remaining_pack_Wh"] == pytest.approx(8.0 * of_cell)
    print_runs([run], sure=True)
    shown = (run.flight.typical or run.flight).last
    row = next(r for r in capsys.readouterr().out.splitlines() if "of the pack of" in r)
    assert f"{significant(8.0 * shown.remaining_Wh)} Wh (" in row
    assert "Wh (" in flight_finding(run.flight)
    assert "in the pack" in flight_finding(run.flight)
    assert "of the pack of 8" in flight_content(run.flight, several=False)
    assert "of the pack" not in flight_content(replace(run.flight, cells=1), several=False)
