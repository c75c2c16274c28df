"""Plans of loads: the simulation as reference, what is not known, tables, past logs."""

from __future__ import annotations

import json

import numpy as np
import pytest
from known_flights import discharge, known_replay

from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.forecast.plan import Plan, forecast_plan, is_plan, plan_of_log, read_plan
from cellwise.logs import CellLog, write_log
from example_cells import curved_cell, lfp_cell, linear_cell
from firmware_cases import cutoff_asked


@pytest.fixture(scope="module")
def flight():
    """A model, half an hour of a changing load, and what it does after that."""
    model = curved_cell()
    rng = np.random.default_rng(3)
    load = np.repeat(rng.uniform(0.2, 2.0, 120), 30)
    log, truth = discharge(model, load, 0.9)
    return model, log, truth.soc


def table(tmp_path, text):
    (tmp_path / "plan.csv").write_text(text)
    return tmp_path / "plan.csv"


@pytest.mark.parametrize("as_power", [True, False])
def test_a_plan_ends_where_the_simulation_does(flight, as_power):
    model, log, soc = flight
    now = 1800
    future = log.part(now, len(log))
    plan = plan_of_log(future)
    if not as_power:
        dt_s = future.interval_s[1:]
        plan = Plan("current", dt_s, np.array(future.current_A[1:]), False)
    found = forecast_plan(model, known_replay(log, soc), [plan], row=now, cutoff_V=2.8)
    assert found.seconds == pytest.approx(log.time_s[-1] - log.time_s[now])
    assert found.end_soc == pytest.approx(soc[-1], abs=5e-4)
    assert found.least_V == pytest.approx(future.voltage_V[1:].min(), abs=2e-3)
    energy = np.sum(future.current_A[1:] * future.voltage_V[1:] * future.interval_s[1:]) / 3600.0
    assert found.energy_Wh == pytest.approx(energy, rel=1e-3)
    # Only the capacity is not known of this replay: two per cent of what is drawn.
    low, high = found.end_soc_band
    assert (high - low) / 4 == pytest.approx(0.02 * (soc[now] - soc[-1]), rel=0.06)


def test_the_chance_follows_what_is_known_of_the_soc(flight):
    model, log, soc = flight
    plan = plan_of_log(log.part(1800, len(log)))
    chances = []
    for std in (0.001, 0.1):
        for away in (-0.05, 0.0, 0.05):
            found = forecast_plan(model, known_replay(log, soc, std), [plan], row=1800,
                                  above=float(soc[-1]) + away, cutoff_V=2.8)  # fmt: skip
            chances.append(found.chance)
    assert chances[0] > 0.99
    assert chances[1] == pytest.approx(0.5, abs=0.05)
    assert chances[2] < 0.01
    assert chances[3] == pytest.approx(0.69, abs=0.05)  # half a deviation
    assert chances[5] == pytest.approx(0.31, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("make", [linear_cell, curved_cell, lfp_cell])
@pytest.mark.parametrize("hold", ["current", "power"])
def test_the_firmware_s_plan_ends_where_this_one_does(make, hold):
    """Phases of minutes in parts of 30 s against steps of 10 s and less."""
    model = make()
    cutoff_V = cutoff_asked(model)
    fixed = FixedStep(model, dt_s=1.0, remaining_V=cutoff_V)
    load = 3.0 if hold == "power" else 1.0
    phases = [(20.0, 4 * load), (600.0, load), (90.0, 0.0), (45.0, -load), (900.0, 0.7 * load)]
    state = fixed.init(0.8, 0.02)
    rest, truth = discharge(model, np.zeros(2), 0.8)
    replayed = known_replay(rest, truth.soc, 0.02)
    parts = [(seconds / n, watts) for seconds, watts in phases for n in [100] for _ in range(n)]
    dt_s, loads = np.array(parts).T
    plan = Plan("phases", dt_s, loads, hold == "power")
    whole = forecast_plan(model, replayed, [plan], cutoff_V=cutoff_V)
    for above in (whole.end_soc - 0.03, whole.end_soc, whole.end_soc + 0.03):
        exact = forecast_plan(model, replayed, [plan], cutoff_V=cutoff_V, above=above)
        found = fixed.plan(state, phases, hold, above)[0]
        assert found["soc"] == pytest.approx(exact.end_soc, abs=2e-3)
        assert found["energy_J"] / 3600.0 == pytest.approx(exact.energy_Wh, rel=5e-3)
        assert found["least_V"] == pytest.approx(exact.least_V, abs=4e-3)
        width = exact.end_soc_band[1] - exact.end_soc_band[0]
        assert found["soc_high"] - found["soc_low"] == pytest.approx(width, rel=0.05)
        assert found["chance"] == pytest.approx(exact.chance, abs=0.03)


def test_a_load_that_no_cell_gives_reaches_the_cutoff(flight):
    model, log, soc = flight
    plan = Plan("too much", np.full(60, 10.0), np.full(60, 200.0), True)
    found = forecast_plan(model, known_replay(log, soc, 0.01), [plan], cutoff_V=3.0)
    assert found.chance_cutoff == 1.0
    assert found.chance == 0.0
    assert np.isfinite(found.end_soc)


def test_several_plans_are_as_probable_as_each_other(flight):
    model, log, soc = flight
    plans = [Plan(str(a), np.full(100, 10.0), np.full(100, a), False) for a in (0.1, 0.4)]
    ends = [forecast_plan(model, known_replay(log, soc), [p]).end_soc for p in plans]
    found = forecast_plan(model, known_replay(log, soc), plans, above=float(np.mean(ends)))
    assert found.chance == pytest.approx(0.5, abs=0.01)
    assert found.end_soc_band[0] == pytest.approx(ends[1], abs=0.01)
    assert found.end_soc_band[1] == pytest.approx(ends[0], abs=0.01)


def test_the_next_log_is_where_few_past_ones_leave_it():
    """Some drives of a population, then one more: it lands in the band 95 times of 100."""
    rng = np.random.default_rng(5)
    model = curved_cell()
    log, truth = discharge(model, np.full(600, 1.0), 0.95)
    replayed = known_replay(log, truth.soc)
    inside = []
    for _ in range(120):
        powers = np.exp(rng.normal(1.2, 0.3, int(rng.integers(4, 10))))
        plans = [
            Plan("", np.full(180, 10.0), np.full(180, p), is_power=True, is_past=True)
            for p in powers
        ]
        found = forecast_plan(model, replayed, plans[:-1], cutoff_V=2.0)
        true = forecast_plan(model, replayed, plans[-1:], cutoff_V=2.0).end_soc
        inside.append(found.end_soc_band[0] <= true <= found.end_soc_band[1])
    assert 0.90 <= np.mean(inside) <= 0.99


def test_a_table_of_a_pack_s_phases(tmp_path):
    plan = read_plan(table(tmp_path, "time_s,power_W\n30,400\n90,100\n"), series=4, parallel=2)
    assert plan.dt_s.sum() == 90.0
    assert plan.dt_s.max() <= 10.0
    assert np.sum(plan.dt_s * plan.load) * 8 == pytest.approx(30 * 400 + 60 * 100)
    amps = read_plan(table(tmp_path, "time_s,current_A\n60,10\n"), series=4, parallel=2)
    assert amps.load[0] == 5.0
    assert not amps.is_power


@pytest.mark.parametrize(
    "text",
    ["", "time_s\n1\n", "time_s,power_W,current_A\n1,2,3\n", "time_s,power_W\n10,5\n5,5\n",
     "time_s,power_W\n10,\n", "time_s,power_W\n10,nan\n", "time_s,power_W\n0,5\n"],
)  # fmt: skip
def test_a_table_that_is_no_plan_is_refused(tmp_path, text):
    with pytest.raises(InputError, match="plan"):
        read_plan(table(tmp_path, text))


def test_the_energy_of_a_past_log_is_kept_whatever_its_rows():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.exponential(0.3, 3000))
    log = CellLog(time, rng.normal(1.0, 2.0, 3000), rng.uniform(3.5, 3.9, 3000))
    plan = plan_of_log(log)
    energy = np.sum(log.current_A[1:] * log.voltage_V[1:] * log.interval_s[1:])
    assert plan.dt_s.sum() == pytest.approx(log.duration_s)
    assert np.sum(plan.dt_s * plan.load) == pytest.approx(energy)
    assert plan.dt_s.size < 1200


def test_the_command_takes_a_table_and_past_logs(flight, tmp_path, capsys):
    _, log, _ = flight
    write_log(log.part(0, 1200), tmp_path / "now.csv")
    write_log(log.part(1200, 2400), tmp_path / "past.csv")
    plan = table(tmp_path, "time_s,power_W\n600,4\n1200,2\n")
    assert is_plan(plan)
    assert not is_plan(tmp_path / "past.csv")
    command = ["replay", "--model", "nmc-18650", str(tmp_path / "now.csv"), "--plan", str(plan),
               str(tmp_path / "past.csv"), "--land-above", "0.3"]  # fmt: skip
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["forecast_plan"]
    assert found["plans"] == 2
    low, high = found["end_soc_band"]
    assert low < found["end_soc"] < min(high, found["soc"])
    assert 0.0 <= found["chance"] <= 1.0
    assert main(command) == 0
    assert "with a chance of" in capsys.readouterr().out
    assert main([*command[:4], "--land-above", "0.3"]) == 2
    assert main([*command[:4], "--plan", "nowhere.csv"]) == 2


def test_a_displayed_percentage_in_rows_and_at_the_end(flight, tmp_path, capsys):
    _, log, _ = flight
    write_log(log.part(0, 1200), tmp_path / "now.csv")
    out = tmp_path / "rows.csv"
    command = ["replay", "--model", "nmc-18650", str(tmp_path / "now.csv"), "--display", "-o",
               str(out), "--json"]  # fmt: skip
    assert main(command) == 0
    found = json.loads(capsys.readouterr().out)
    rows = np.genfromtxt(out, delimiter=",", names=True)
    shown = rows["displayed_percent"]
    assert shown[-1] == pytest.approx(found["displayed_percent"])
    assert np.all(np.diff(shown) <= 0.0)
    assert shown[-1] == pytest.approx(100 * found["soc_final"], abs=6.0)
