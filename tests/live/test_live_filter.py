"""A filter that is fed sample by sample: the same as a replay, and as itself before a restart."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.replay import replay
from cellwise.estimate.saved_state import read_state
from cellwise.live import LiveFilter, Sample
from cellwise.live.live_filter import AGREEING, Interval, Timeline
from cellwise.logs.gaps import find_gaps
from example_cells import curved_cell, lfp_cell
from streams import driven, samples


@pytest.mark.parametrize("estimator", ["ekf", "ukf"])
def test_a_stream_gives_what_a_replay_gives(estimator):
    model = curved_cell()
    log = driven(model)
    live = LiveFilter(model, estimator, soc0=0.6, soc0_std=0.2)
    found = [live.take(sample) for sample in samples(log)]
    whole = replay(model, log, estimator, soc0=0.6, soc0_std=0.2).trace
    np.testing.assert_allclose([u.info.soc for u in found], whole.soc, rtol=1e-12)
    np.testing.assert_allclose([u.info.soc_std for u in found], whole.soc_std, rtol=1e-9)
    assert [u.info.status for u in found] == whole.status.tolist()


@pytest.mark.parametrize("model", [curved_cell(), lfp_cell()], ids=["nmc", "lfp"])
@pytest.mark.parametrize("soc0", [0.08, 0.35, 0.6, 0.93])
def test_a_start_that_was_not_given_is_consistent(model, soc0):
    """The first sample, at rest or under load: the truth lies within what it says."""
    for rest in (0, 100):
        log = driven(model, soc0, seed=3, rest=rest)
        live = LiveFilter(model)
        update = live.take(next(samples(log)))
        assert abs(update.info.soc - soc0) < 3.0 * update.info.soc_std
        assert live.start.how


def test_nothing_begins_without_a_possible_current_and_voltage():
    live = LiveFilter(curved_cell())
    for current, voltage in ((math.nan, 3.7), (1.0, math.nan), (1.0, 65.535), (1e9, 3.7)):
        assert live.take(Sample(0.0, current, voltage)) is None
        assert live.state is None
    assert live.take(Sample(1.0, 1.0, 3.7)) is not None


def test_a_restart_goes_on_as_if_there_had_been_a_gap(tmp_path):
    model = curved_cell()
    log = driven(model, rows=400)
    place = tmp_path / "state.json"
    stopped = LiveFilter(model, soc0=0.7)
    every = list(samples(log))
    for sample in every[:200]:
        stopped.take(sample)
    stopped.save(place, now_s=1000.0)
    again = LiveFilter(model)
    assert again.resume(place, now_s=1600.0)
    assert again.state == stopped.state
    expected, told = stopped.filter.step(
        stopped.state, every[200].current_A, every[200].voltage_V, 25.0, dt_s=600.0, gap=True
    )
    update = again.take(every[200])
    assert (update.dt_s, update.gap) == (600.0, True)
    assert again.state == expected
    assert update.info == told
    assert update.info.soc_std > stopped.state.soc_std


def test_a_saved_state_is_one_that_the_estimator_reads_too(tmp_path):
    live = LiveFilter(curved_cell(), soc0=0.5)
    live.take(Sample(0.0, 1.0, 3.7))
    live.save(tmp_path / "state.json", now_s=0.0)
    assert read_state(tmp_path / "state.json") == live.state


def test_no_state_yet_and_a_file_that_a_loss_of_power_left_empty_start_again(tmp_path):
    live = LiveFilter(curved_cell())
    assert not live.resume(tmp_path / "none.json", 0.0)
    (tmp_path / "empty.json").touch()
    assert not live.resume(tmp_path / "empty.json", 0.0)


def test_the_state_of_another_model_is_refused(tmp_path):
    live = LiveFilter(curved_cell(), soc0=0.5)
    live.take(Sample(0.0, 1.0, 3.7))
    live.save(tmp_path / "state.json", now_s=0.0)
    with pytest.raises(InputError, match="another model"):
        LiveFilter(curved_cell(capacity_Ah=3.1)).resume(tmp_path / "state.json", 1.0)
    renamed = LiveFilter(curved_cell(name="the same cell"))
    assert renamed.resume(tmp_path / "state.json", 1.0)
    assert json.loads((tmp_path / "state.json").read_text())["live"]["saved_s"] == 0.0


def test_garbage_between_the_samples_leaves_the_soc_where_it_was():
    model = curved_cell()
    log = driven(model, rows=600)
    rng = np.random.default_rng(5)
    live = LiveFilter(model, soc0=0.8, soc0_std=0.02)
    for sample in samples(log):
        if rng.random() < 0.1:
            live.take(Sample(sample.time_s, *rng.choice([np.nan, 1e12, -1e12], 2)))
        live.take(sample)
    true = simulate(model, log, 0.8).soc[-1]
    assert live.state.soc == pytest.approx(true, abs=0.01)


def test_the_unknown_start_on_a_measured_drive_is_within_its_band(real_data):
    """Beginning anywhere in a drive, without a word about the SOC."""
    from cellwise.identify import CellTests, IdentifySettings, identify_cell
    from cellwise.logs import read_log

    folder = real_data / "panasonic_18650pf"
    tests = CellTests(
        hppc=((read_log(folder / "hppc_p25.csv.gz"), 25.0),),
        ocv=(read_log(folder / "ocv_c20_p25.csv.gz"),),
        capacity=(read_log(folder / "cap_1c_p25_start_1.csv.gz"),),
    )
    model = identify_cell(tests, IdentifySettings(nominal_Ah=2.9, refine=False)).model
    log = read_log(folder / "drive_p25_us06.csv.gz")
    reference = 1.0 - log.counted_charge_Ah() / 2.9
    for begin in range(2000, len(log) - 20_000, 5000):
        live = LiveFilter(model)
        part = log.part(begin, begin + 6000)
        found = [live.take(sample) for sample in samples(part)]
        assert abs(found[0].info.soc - reference[begin]) < 3.0 * found[0].info.soc_std
        assert found[-1].info.soc == pytest.approx(reference[begin + 5999], abs=0.04)


# Stamps: intervals, gaps as in a log, late samples, clocks that are set.
def fed(times, arrived=None):
    line = Timeline()
    arrived = times if arrived is None else arrived
    return [line.advance(float(t), float(a)) for t, a in zip(times, arrived, strict=True)]


def test_intervals_are_the_differences_of_the_stamps():
    times = np.cumsum(np.random.default_rng(1).uniform(0.01, 2.0, 200))
    found = fed(times)
    assert found[0] == Interval(0.0, gap=False)
    np.testing.assert_allclose([i.dt_s for i in found[1:]], np.diff(times))


@pytest.mark.parametrize("seed", range(5))
def test_gaps_are_those_of_the_finished_log(seed):
    rng = np.random.default_rng(seed)
    steps = rng.choice([0.1, 1.0]) * rng.uniform(0.8, 1.2, 400)
    pauses = 8 + 40 * np.arange(9) + rng.integers(0, 20, 9)
    steps[pauses] = rng.uniform(20.0, 3000.0, 9)
    times = np.concatenate(([0.0], np.cumsum(steps)))
    found = np.array([i.gap for i in fed(times)])
    np.testing.assert_array_equal(found, find_gaps(times))
    assert found.sum() == 9


def test_a_late_sample_is_left_out_and_the_next_one_counts_from_the_last_good():
    found = fed([0.0, 1.0, 2.0, 1.5, 3.0])
    assert found[3] is None
    assert found[4] == Interval(1.0, gap=False)


@pytest.mark.parametrize("broken", [1e15, -1e15, np.nan, np.inf])
def test_a_broken_stamp_is_left_out(broken):
    found = fed([0.0, 1.0, broken, 2.0, 3.0])
    assert found[2] is None
    assert found[3:] == [Interval(1.0, gap=False)] * 2


@pytest.mark.parametrize("jump", [-5000.0, 1e6])
def test_a_clock_that_was_set_is_a_gap_as_long_as_our_own_clock_says(jump):
    times = np.arange(0.0, 40.0)
    arrived = 100.0 + times
    times[20:] += jump
    found = fed(times, arrived)
    assert found[20 : 20 + AGREEING - 1] == [None] * (AGREEING - 1)
    assert found[20 + AGREEING - 1] == Interval(float(AGREEING), gap=True)
    assert all(i == Interval(1.0, gap=False) for i in found[20 + AGREEING :])


def test_after_a_restart_the_first_sample_ends_the_gap():
    line = Timeline()
    line.resume(500.0)
    assert line.advance(3.0) == Interval(500.0, gap=True)
    assert line.advance(4.0) == Interval(1.0, gap=False)
