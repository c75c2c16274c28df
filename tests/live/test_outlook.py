"""Remaining time and energy now, against the forecast of a replay of the same samples."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cli import main
from cellwise.errors import InputError
from cellwise.estimate.replay import replay
from cellwise.forecast.outlook import Outlook
from cellwise.forecast.remaining import cutoff_of, forecast
from cellwise.live import LiveFilter
from cellwise.live.run import LatencyMeter
from example_cells import curved_cell
from streams import driven, samples
from virtual_tester import logged

MODEL = curved_cell()


def under(*loads_A, rows=300, **more):
    """Log, filter, outlook and last sample of a cell at 80 % after so many rows of each load."""
    log = driven(MODEL, rows=rows * len(loads_A))
    log = replace(log, current_A=np.repeat(np.array(loads_A), rows))
    log = logged(MODEL, log, 0.8)
    live = LiveFilter(MODEL, soc0=0.8, soc0_std=0.05)
    outlook = Outlook(MODEL, cutoff_of(MODEL, 3.0), **more)
    for sample in samples(log):
        outlook.take(live.take(sample))
    return log, live, outlook, sample


def test_a_steady_load_leaves_what_a_replay_predicts():
    log, live, outlook, _ = under(2.0, rows=900)
    left = outlook.forecast(live.state, 25.0)
    told = forecast(MODEL, replay(MODEL, log, "ekf", soc0=0.8, soc0_std=0.05), cutoff_V=3.0).last
    assert left.load_A == pytest.approx(2.0)
    assert left.remaining_s == pytest.approx(told.remaining_s, rel=0.01)
    assert left.remaining_Wh == pytest.approx(told.remaining_Wh, rel=0.01)
    assert left.remaining_s_band == pytest.approx(told.remaining_s_band, rel=0.02)
    # Nearly the charge that is left over the load; the power is held, so the current grows.
    assert left.remaining_s < 3600 * 3.0 * 0.7 / 2.0


@pytest.mark.parametrize("amps", [0.0, -2.0])
def test_at_rest_and_while_charging_nothing_runs_out(amps):
    _, live, outlook, _ = under(amps, rows=100)
    assert outlook.forecast(live.state, 25.0) is None


@pytest.mark.parametrize(
    ("after_s", "amps", "rel"), [(1.0, 1e9, 1e-6), (20.0, 8.0, 0.05)], ids=["impossible", "pause"]
)
def test_a_reading_that_no_cell_carries_and_a_pause_keep_the_mean_load(after_s, amps, rel):
    _, live, outlook, last = under(2.0)
    before = outlook.forecast(live.state, 25.0)
    update = live.take(last._replace(time_s=last.time_s + after_s, current_A=amps))
    assert update.gap == (after_s > 10.0)
    outlook.take(update)
    after = outlook.forecast(live.state, 25.0)
    assert after.load_A == pytest.approx(2.0, rel=rel)
    assert after.remaining_s == pytest.approx(before.remaining_s, rel=max(rel, 0.01))


def test_without_a_deadline_the_interval_is_it():
    meter = LatencyMeter()
    meter.add(0.02, 0.01)
    meter.add(0.005, 0.01)
    meter.add(0.02, 0.0)  # the first sample ends no interval
    assert meter.missed == 1


def test_a_given_load_and_the_median_are_known_at_rest():
    """A vehicle that stands asks how long it could go."""
    _, live, outlook, _ = under(2.0, 0.0, rows=350, given_W=9.0)
    row = outlook.columns(live.state, 25.0)
    assert row["remaining_s"] is None
    # What is left over the time that it lasts is the load.
    left_s = row["given_load_remaining_s"]
    assert 3600.0 * row["given_load_remaining_Wh"] / left_s == pytest.approx(9.0, rel=0.01)
    median = outlook.at_median(live.state, 25.0)
    assert median.load_A == pytest.approx(2.0)
    low, high = row["median_load_remaining_s_band"]
    assert low < row["median_load_remaining_s"] == median.remaining_s < high
    with pytest.raises(InputError, match="load of -1 W"):
        Outlook(MODEL, 3.0, given_W=-1.0)


def test_a_charger_in_a_stream_says_when_the_cell_is_full(tmp_path, capsys):
    lines = (
        {"time_s": k, "current_A": -5.0, "voltage_V": 3.80 + 2e-5 * k, "temperature_C": 25}
        for k in range(400)
    )
    source = tmp_path / "charge.jsonl"
    source.write_text("".join(json.dumps(line) + "\n" for line in lines))
    command = ["live", "--model", "lipo-pouch", "--source", f"json:{source}", "--every", "10"]
    assert main([*command, "--display", "--charge-end-a", "0.5"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert rows[0]["full_s"] is None  # thirty seconds show that it lasts
    last = rows[-1]
    assert last["full_s_band"][0] < last["full_s"] < last["full_s_band"][1]
    assert last["full_s"] < rows[10]["full_s"]
    assert last["remaining_s"] is None
    shown = [row["displayed_percent"] for row in rows]
    assert shown == sorted(shown)
    assert main([*command, "--display", "3"]) == 2
