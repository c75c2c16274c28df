"""The band given the voltage that was measured: of the error seen now, and of another SOC."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_flights import CUTOFF_V, discharge, known_replay, until

from cellwise.cell.model_error import ModelError
from cellwise.forecast.remaining import forecast
from example_cells import curved_cell, linear_cell

ERROR_V, MEMORY_SOC = 0.05, 0.1
LOAD_A = 3.0


def drawn_error_V(soc, rng):
    """A stationary error along the SOC, as a model states it: deviation and memory [V]."""
    kept = np.exp(-np.abs(np.diff(soc)) / MEMORY_SOC)
    error = np.empty(soc.size)
    error[0] = rng.normal()
    for k, (rho, new) in enumerate(zip(kept, rng.normal(size=kept.size), strict=True)):
        error[k + 1] = rho * error[k] + np.sqrt(1.0 - rho * rho) * new
    return ERROR_V * error


@pytest.mark.slow
def test_the_band_holds_as_often_whatever_error_is_seen_now():
    """Of cells whose errors are drawn as stated: of those off by little now, and by much."""
    model = curved_cell(
        error=replace(
            ModelError.of_white_and_slow(slow_V=(ERROR_V,), resistance_share=0.0),
            correlation_soc=MEMORY_SOC,
        )
    )
    whole, truth = discharge(model, np.full(380, LOAD_A), 0.95, dt=10.0)
    rng = np.random.default_rng(3)
    now = 150
    seen, inside, width = [], [], []
    for _ in range(400):
        error_V = drawn_error_V(truth.soc, rng)
        log = replace(whole, voltage_V=whole.voltage_V + error_V)
        end_s, _ = until(log, truth.soc, CUTOFF_V)
        known = known_replay(log.part(0, now + 1), truth.soc[: now + 1])
        left = forecast(model, known, cutoff_V=CUTOFF_V, hold="current").last
        low, high = left.remaining_s_band
        seen.append(abs(np.mean(error_V[now - 5 : now + 1])))
        inside.append(low <= end_s - left.time_s <= high)
        width.append(high - low)
    seen, inside, width = np.array(seen), np.array(inside), np.array(width)
    little, much = seen < 0.5 * ERROR_V, seen > 1.5 * ERROR_V
    assert np.mean(inside[little]) == pytest.approx(0.95, abs=0.04)
    assert np.mean(inside[much]) == pytest.approx(0.95, abs=0.07)
    assert np.median(width[much]) > 1.2 * np.median(width[little])


def test_on_a_straight_ocv_the_time_to_a_voltage_needs_no_soc():
    """The voltage falls by as much per hour from any SOC."""
    model = linear_cell(error=ModelError.of_white_and_slow(slow_V=(ERROR_V,), resistance_share=0.0))
    log, truth = discharge(model, np.full(1200, LOAD_A), 0.9)
    sure, unsure = (
        forecast(model, known_replay(log, truth.soc, std), cutoff_V=3.3, hold="current").last
        for std in (0.0, 0.02)
    )
    assert sure.by == "voltage"
    assert unsure.remaining_s_band == pytest.approx(sure.remaining_s_band, rel=1e-3)


def test_a_soc_that_the_voltage_contradicts_widens_the_band_all_the_same():
    """No filter has made anything of the voltage yet: an error of that size is none of a model."""
    model = linear_cell(error=ModelError.of_white_and_slow(slow_V=(0.002,), resistance_share=0.0))
    log, truth = discharge(model, np.full(1200, LOAD_A), 0.9)
    left = forecast(model, known_replay(log, truth.soc, 0.1), cutoff_V=3.3, hold="current").last
    seconds_per_soc = 3600 * model.capacity_Ah / LOAD_A
    explained_soc = 2 * 0.002 / 0.9
    half = 0.5 * np.diff(left.remaining_s_band)[0]
    assert half == pytest.approx((0.2 - explained_soc) * seconds_per_soc, rel=0.03)
