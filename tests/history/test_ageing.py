"""Ageing that was put into simulated cells comes back from whatever windows are given."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_file import read_model
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.cli.health import print_life
from cellwise.errors import InputError
from cellwise.history.ageing import ageing_history
from cellwise.history.log_health import changed_model, log_health
from cellwise.history.trend import FADE, Deviations, change_of, trend_of
from cellwise.logs import CellLog, write_log
from cellwise.notices import texts
from cellwise.report.history_page import capacity_picture

FRESH = stock_model("nca-18650")
SHARES = (1.0, 0.97, 0.94, 0.90)


def discharge(share, *, rate=0.5, scale=1.0, window=(1.0, 0.0), seed=0, name="", temperature=25.0):
    """A discharge of an aged cell at one current, of which some SOC window is logged."""
    cell = changed_model(FRESH, np.log(share), np.log(scale))
    seconds = np.arange(0.0, 3700.0 / rate, 5.0)
    current = np.full(seconds.size, rate * FRESH.capacity_Ah)
    current[0] = 0.0
    log = CellLog(seconds, current, np.full(seconds.size, 3.7), np.full(seconds.size, temperature))
    found = simulate(cell, log, 1.0)
    noise = np.random.default_rng(seed).normal(0.0, 0.001, seconds.size)
    stop = max(int(np.argmax(found.voltage_V < 2.9)), 1)
    inside = (found.soc <= window[0]) & (found.soc >= window[1]) & (np.arange(seconds.size) < stop)
    full = replace(log, voltage_V=found.voltage_V + noise, name=name or f"share{share:g}")
    return full.rows(np.flatnonzero(inside))


def drive(share, scale=1.0, seed=0):
    """Two hours of changing load."""
    rng = np.random.default_rng(seed)
    cell = changed_model(FRESH, np.log(share), np.log(scale))
    current = np.repeat(rng.uniform(-0.3, 1.3, 240), 30) * FRESH.capacity_Ah * 0.6
    time = np.arange(current.size, dtype=np.float64)
    log = CellLog(time, current, np.full(time.size, 3.7), np.full(time.size, 25.0))
    found = simulate(cell, log, 0.95)
    return replace(log, voltage_V=found.voltage_V + rng.normal(0.0, 0.001, time.size))


def of_own(std):
    """Deviations of logs that have nothing in common."""
    return Deviations(std, np.zeros_like(std), np.zeros_like(std))


def test_complete_discharges_are_counted():
    life = ageing_history(FRESH, [discharge(s, seed=k) for k, s in enumerate(SHARES)])
    assert all(one.counted for one in life.logs)
    np.testing.assert_allclose([one.share for one in life.logs], SHARES, atol=0.004)
    np.testing.assert_allclose(life.trend.share, SHARES, atol=0.006)
    percent = f"{100 * life.trend.share[-1]:.1f} +- "
    assert repr(life).startswith(f"AgeingHistory({len(SHARES)} logs: {percent}")
    assert len(repr(life)) < 200


def test_a_picture_of_a_life_shows_every_bar_whole_and_its_legend_beside_them():
    life = ageing_history(FRESH, [discharge(s, seed=k) for k, s in enumerate(SHARES)])
    figure = capacity_picture(life).figure
    (axes,) = figure.axes
    assert axes.get_legend() is None
    (legend,) = figure.legends
    figure.canvas.draw()
    assert not legend.get_window_extent().overlaps(axes.get_window_extent())
    low, high = axes.get_ylim()
    for one in life.logs:
        assert low < 100.0 * (one.share - 2.0 * one.share_std)
        assert 100.0 * (one.share + 2.0 * one.share_std) < high


def test_windows_are_compared_with_the_first_complete_discharge():
    logs = [discharge(1.0)]
    logs += [discharge(s, window=(0.8, 0.2), seed=k) for k, s in enumerate(SHARES[1:])]
    life = ageing_history(FRESH, logs)
    assert [one.counted for one in life.logs] == [True, False, False, False]
    off = np.array([one.share for one in life.logs]) - SHARES
    std = np.array([one.share_std for one in life.logs])
    assert np.all(np.abs(off) < 0.015)
    assert np.all(np.abs(off) < 2.0 * std + 0.002)


def test_more_resistance_is_no_less_capacity():
    life = ageing_history(FRESH, [discharge(1.0), discharge(1.0, scale=1.3, window=(0.8, 0.2))])
    aged = life.logs[1]
    assert abs(aged.share - 1.0) < min(2.0 * aged.share_std, 0.02)
    assert life.logs[1].resistance_scale == pytest.approx(1.3, abs=0.1)


def test_another_rate_is_no_age():
    """The first discharge at another rate says nothing of ageing, however much less it gives."""
    life = ageing_history(
        FRESH, [discharge(1.0), discharge(1.0, rate=1.0), discharge(0.95, rate=1.0)]
    )
    assert life.logs[1].share == pytest.approx(1.0, abs=0.002)
    assert life.logs[1].capacity_Ah < 0.99 * life.logs[0].capacity_Ah
    assert life.logs[2].share == pytest.approx(0.95, abs=0.006)


@pytest.mark.parametrize(("share", "scale"), [(1.0, 1.0), (0.9, 1.0), (0.9, 1.4)])
def test_a_drive_shows_both_within_its_band(share, scale):
    fit = log_health(FRESH, drive(share, scale))
    capacity = share * FRESH.capacity_Ah
    assert abs(fit.capacity_Ah - capacity) < 3.0 * fit.capacity_std_Ah
    assert abs(fit.capacity_Ah - capacity) < 0.03 * capacity
    # What it does not cover may have aged by itself, by as much as a life brings.
    unseen = 0.3 * (1.0 - fit.covered)
    assert unseen < fit.capacity_std_Ah / fit.capacity_Ah < unseen + 0.03
    assert abs(fit.resistance_scale - scale) < 3.0 * fit.resistance_std + 0.01


@pytest.mark.slow
def test_cells_beside_their_model_lie_within_the_band():
    """Another OCV in the middle, each resistance by itself: no fit of three numbers covers that."""
    rng = np.random.default_rng(3)
    off, stated = [], []
    for k in range(12):
        share, scale = rng.uniform(0.78, 1.0), np.exp(rng.uniform(-0.1, 0.6))
        aged = changed_model(FRESH, np.log(share), np.log(scale))
        waves = np.sin(np.pi * np.outer([1.0, 2.0, 3.0], aged.soc))
        ocv = np.maximum.accumulate(aged.ocv_V + rng.normal(0.0, 0.004, 3) @ waves, axis=1)
        r0, r1, r2 = np.exp(rng.normal(0.0, 0.1, 3))
        cell = replace(
            aged, ocv_V=ocv, r0_ohm=r0 * aged.r0_ohm, r1_ohm=r1 * aged.r1_ohm,
            r2_ohm=r2 * aged.r2_ohm,
        )  # fmt: skip
        log = drive(1.0, seed=k)
        seen = simulate(cell, log, 0.95).voltage_V + rng.normal(0.0, 0.001, len(log))
        fit = log_health(FRESH, replace(log, voltage_V=seen).part(0, len(log) - 600 * (k % 6)))
        off.append(np.log(fit.capacity_Ah / cell.capacity_Ah))
        # What a window cannot see at all is in the deviation; the log's own part is beside it.
        unseen = 0.3 * (1.0 - fit.covered)
        stated.append([fit.capacity_std_Ah / fit.capacity_Ah, unseen])
    off, (whole, unseen) = np.array(off), np.array(stated).T
    assert np.all(np.abs(off) < 2.0 * whole)
    assert np.sqrt(np.mean(whole**2 - unseen**2)) > 0.5 * np.sqrt(np.mean(off**2))
    assert np.sqrt(np.mean(off**2)) < 0.05


def test_the_band_of_a_trend_covers_what_made_it():
    """Straight fades, by each test a little off by itself: 95 % within two sigma."""
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(100):
        way = np.arange(20.0)
        fade = rng.uniform(0.05, 0.3)
        truth = 1.0 - fade * way / 19.0 + rng.normal(0.0, rng.choice([0.0, 0.005, 0.01]), 20)
        std = np.full(20, 0.005)
        found = trend_of(way, truth + rng.normal(0.0, std), of_own(std))
        inside.append(np.abs(found.share - truth) < 2.0 * found.std)
    assert 0.90 <= np.mean(inside) <= 0.995


def test_windows_wrong_together_leave_a_wider_band_than_counted_charges():
    way, share = np.arange(10.0), 1.0 - 0.01 * np.arange(10.0)
    std = 0.002 + 0.3 * (1.0 - share)  # what a window cannot see grows with the fade
    counted = trend_of(way, share, of_own(std)).std[-1]
    windows = trend_of(way, share, Deviations(0.22 * std, 0.97 * std, 0.0 * std)).std[-1]
    assert windows > 1.3 * counted


def drawn(rng, std, alike, fade=0.0, before=0.15):
    """Ten days of windows that err together by ``alike`` and each by ``std``; what they say."""
    way = np.arange(10.0)
    truth = 1.0 - before - fade * way / 9.0
    near = np.exp(-np.abs(way[:, None] - way[None, :]) / (9.0 * FADE.alike_over))
    together = np.linalg.cholesky(near + 1e-9 * np.eye(10)) @ rng.normal(0.0, alike, 10)
    share = truth + together + rng.normal(0.0, std, 10)
    deviations = Deviations(np.full(10, std), np.full(10, alike), np.zeros(10))
    return change_of(way, share, deviations, 0.05), trend_of(way, share, deviations, 0.05)


def test_a_change_is_claimed_of_an_aged_car_that_did_not_change_in_one_case_of_twenty():
    """The trend begins at the new cell, so ten days of an aged car are a steep fade to it."""
    rng = np.random.default_rng(11)
    found = [drawn(rng, 0.02, 0.06) for _ in range(200)]
    assert np.mean([change.shown for change, _ in found]) < 0.08
    by_trend = [abs(t.share[0] - t.share[-1]) > 2.0 * t.std[-1] for _, t in found]
    assert np.mean(by_trend) > 0.2
    off = np.array([change.level - 0.85 for change, _ in found])
    assert np.mean(np.abs(off) < 2.0 * np.array([c.level_std for c, _ in found])) > 0.9


def test_a_change_that_the_logs_show_is_claimed():
    rng = np.random.default_rng(12)
    found = [drawn(rng, 0.005, 0.0, fade=0.1)[0] for _ in range(50)]
    assert np.mean([change.shown for change in found]) > 0.95
    assert np.mean([change.share for change in found]) == pytest.approx(-0.1, abs=0.003)


def test_what_to_use_is_of_all_logs_where_they_show_no_change(capsys):
    life = ageing_history(FRESH, [drive(0.9, seed=k) for k in range(3)])
    assert not life.change.shown
    assert life.share == (life.change.level, life.change.level_std)
    assert life.to_dict()["trend"]["use"]["capacity_Ah"] == life.capacity_Ah
    assert abs(life.capacity_Ah - 0.9 * FRESH.capacity_Ah) < 2.0 * life.capacity_std_Ah
    print_life(life)
    assert "no change of the capacity shown" in capsys.readouterr().out
    aged = ageing_history(FRESH, [discharge(share, seed=k) for k, share in enumerate(SHARES)])
    assert aged.change.shown
    assert aged.share == (aged.trend.share[-1], aged.trend.std[-1])


@pytest.mark.parametrize(("bends", "expected"), [(False, None), (True, 12)])
def test_a_knee_is_found_where_there_is_one(bends, expected):
    way = np.arange(24.0)
    share = 1.0 - 0.004 * way - (0.02 * np.maximum(way - 12.0, 0.0) if bends else 0.0)
    share += np.random.default_rng(2).normal(0.0, 0.001, way.size)
    knee = trend_of(way, share, of_own(np.full(24, 0.002))).knee
    assert (knee is None) if expected is None else abs(knee - expected) <= 2


def test_one_log_is_a_life_too():
    life = ageing_history(FRESH, [drive(0.95)])
    assert life.trend.share.shape == (1,)
    assert "complete discharge" in life.next_reference


def test_no_log_and_logs_that_say_nothing_are_refused():
    with pytest.raises(InputError, match="no log"):
        ageing_history(FRESH, [])
    short = discharge(1.0).part(0, 5)
    with pytest.raises(InputError, match="none of which"):
        ageing_history(FRESH, [short])


def test_days_that_run_backwards_are_refused():
    logs = [discharge(1.0, name="d_2024-05-02"), discharge(0.99, name="d_2024-05-01")]
    with pytest.raises(InputError, match="Sort them"):
        ageing_history(FRESH, logs)


def test_the_command_prints_the_contract_and_saves_the_aged_model(tmp_path, capsys):
    names = []
    for k, share in enumerate(SHARES):
        log = discharge(share, seed=k, name=f"test_2024-0{k + 1}-15")
        names.append(str(write_log(log, tmp_path / f"{log.name}.csv")))
    aged = tmp_path / "aged.json"
    out = tmp_path / "life.csv"
    arguments = ["history", "--model", "nca-18650", *names, "--save-model", str(aged)]
    assert main([*arguments, "-o", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    keys = {"log", "start", "capacity_Ah", "capacity_std_Ah", "resistance_scale", "notices"}
    keys |= {"resistance_std", "soc_start", "soc_end", "throughput_Ah"}
    assert all(keys <= set(one) for one in found["logs"])
    assert [one["start"] for one in found["logs"]] == [f"2024-0{k}-15" for k in range(1, 5)]
    assert found["logs"][0]["soc_start"] == pytest.approx(1.0, abs=0.02)
    assert found["logs"][0]["soc_end"] < 0.1
    assert found["trend"]["over"] == "days"
    # Why the capacity to use is not the one that was counted.
    assert any("at its load" in n and "whole SOC range" in n for n in found["notices"])
    assert read_model(aged).capacity_Ah == pytest.approx(0.9 * FRESH.capacity_Ah, rel=0.01)
    assert len(out.read_text().splitlines()) == 5
    assert main(["history", "--model", "nca-18650", names[1], names[0]]) == 2
    assert "Sort them" in capsys.readouterr().err


def test_a_lipo_s_fade_at_4c_is_within_three_tenths_of_a_point(real_data):
    """5.147 to 5.026 Ah over 48 cycles: within 0.3 points, better than no change and than a line
    through the first three cycles."""
    from cellwise.logs import read_log

    cycles = np.array([1.0, 2.0, 3.0, 25.0, 48.0])
    logs = [read_log(real_data / "lipo_5450" / f"c4_cycle{int(k):02d}.csv.gz") for k in cycles]
    life = ageing_history(stock_model("lipo-pouch"), logs)
    fade = 100.0 * (1.0 - life.trend.share[-1])
    measured = 100.0 * (1.0 - 5.026 / 5.147)
    off = abs(fade - measured)
    assert off < 0.3
    first = [one.capacity_Ah for one in life.logs[:3]]
    line = np.polyval(np.polyfit(cycles[:3], first, 1), 48.0)
    assert off < abs(100.0 * (1.0 - line / first[0]) - measured)
    assert off < measured


def test_how_well_the_first_log_is_known_stays_in_the_band():
    """Charges that are counted against an uncertain first one: the level is uncertain, not the
    fade."""
    share = 0.92 - 0.002 * np.arange(10.0)
    std = Deviations(np.full(10, 0.002), np.zeros(10), np.full(10, 0.03))
    trend = trend_of(np.arange(10.0), share, std, start_std=0.05)
    assert np.all(trend.std > 0.02)
    assert trend.share[0] - trend.share[-1] == pytest.approx(0.018, abs=0.004)


def test_the_capacity_to_use_is_no_surer_than_the_new_cells():
    life = ageing_history(FRESH, [discharge(s, seed=k) for k, s in enumerate(SHARES)])
    assert life.logs[0].counted
    use = life.to_dict()["trend"]["use"]
    least = SHARES[-1] * FRESH.capacity_std_Ah
    assert use["capacity_std_Ah"] > 0.99 * least
    assert life.aged_model.capacity_std_Ah == use["capacity_std_Ah"]


def test_a_trend_stays_among_its_points():
    """Windows that see little are wrong by as much as they do not see, alike in what all miss."""
    way = np.arange(8.0)
    share = np.array([0.97, 0.73, 1.0, 0.97, 0.93, 0.94, 0.98, 0.96])
    std = np.array([0.39, 0.09, 0.4, 0.4, 0.38, 0.37, 0.36, 0.38])
    own, alike = np.sqrt(0.05) * std, np.sqrt(0.95) * std
    found = trend_of(way, share, Deviations(own, alike, np.zeros(8)), 0.1)
    assert np.all(found.share > 0.7)


def test_complete_discharges_in_one_file_are_each_a_log():
    parts = [discharge(s, seed=k) for k, s in enumerate(SHARES)]
    ends = np.cumsum([0.0, *(p.duration_s + 3600.0 for p in parts)])
    together = CellLog(
        np.concatenate([p.time_s - p.time_s[0] + t for p, t in zip(parts, ends, strict=False)]),
        np.concatenate([p.current_A for p in parts]),
        np.concatenate([p.voltage_V for p in parts]),
        np.full(sum(map(len, parts)), 25.0),
        name="cycles",
    )
    life = ageing_history(FRESH, [together])
    assert [one.log.name for one in life.logs] == [f"cycles, cycle {k}" for k in (1, 2, 3, 4)]
    np.testing.assert_allclose([one.share for one in life.logs], SHARES, atol=0.005)
    assert any("4 complete half cycles" in n for n in texts(life.logs[0].log.notices))
