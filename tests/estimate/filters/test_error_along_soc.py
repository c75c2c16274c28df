"""A model error that belongs to the SOC: driving on renews it, the same way again does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.estimate.filters.ekf import Ekf
from cellwise.estimate.filters.ukf import Ukf
from cellwise.estimate.lockstep.lockstep import LockstepEkf
from cellwise.estimate.noise import Noise
from cellwise.estimate.sensing_kernels import first_watch, new_ground
from cellwise.logs.cell_log import CellLog

SIZE_V, LENGTH = 0.02, 0.05
FLAT = np.full(11, 1.0)
MODEL = CellModel(
    capacity_Ah=3.0,
    ocv_V=np.linspace(3.2, 4.2, 11),
    r0_ohm=0.03 * FLAT,
    r1_ohm=0.01 * FLAT,
    tau1_s=2.0 * FLAT,
    r2_ohm=0.02 * FLAT,
    tau2_s=30.0 * FLAT,
    error=ModelError.of_white_and_slow(0.001, (SIZE_V,), 300.0, 0.0, correlation_soc=LENGTH),
)
# From 90 to 10 % at 1C with loads and rests, and twelve hours between 55 and 65 %.
DRIVE_A = np.tile(np.repeat([6.0, 0.0, 4.5, 0.0, 4.5], 2), 28)
ORBIT_A = np.tile(np.repeat([3.0, -3.0], 36), 60)


def wrong_along_soc(current_A, soc0, seed):
    """A log whose voltage is off by an Ornstein-Uhlenbeck process along the SOC; its SOC."""
    rng = np.random.default_rng(seed)
    time = 10.0 * np.arange(current_A.size)
    log = CellLog(time, current_A, np.full(time.size, 4.0), temperature_C=np.full(time.size, 25.0))
    done = simulate(MODEL, log, soc0)
    grid = np.linspace(0.0, 1.0, 1001)
    keep = np.exp(-1e-3 / LENGTH)
    error = np.empty(grid.size)
    error[0] = rng.standard_normal()
    for k in range(1, grid.size):
        error[k] = keep * error[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal()
    voltage = done.voltage_V + SIZE_V * np.interp(done.soc, grid, error)
    voltage = voltage + 0.001 * rng.standard_normal(time.size)
    return replace(log, voltage_V=voltage), done.soc


@pytest.mark.parametrize("kind", [Ekf, Ukf])
@pytest.mark.parametrize(("current_A", "soc0"), [(DRIVE_A, 0.9), (ORBIT_A, 0.65)])
def test_the_band_holds_the_truth_and_is_no_wider_than_twice_the_error(kind, current_A, soc0):
    inside, square, band = [], [], []
    for seed in range(30):
        log, truth = wrong_along_soc(current_A, soc0, seed)
        trace = kind(MODEL).run(log, soc0 + 0.1 * (-1.0) ** seed, 0.1)
        late = slice(len(log) // 4, None)
        error = (trace.soc - truth)[late]
        inside.append(np.mean(np.abs(error) < 2.0 * trace.soc_std[late]))
        square.append(np.mean(error**2))
        band.append(np.mean(trace.soc_std[late]))
    assert np.mean(inside) > 0.93
    assert np.mean(band) < 2.0 * np.sqrt(np.mean(square))


def test_driving_on_teaches_more_than_time_alone():
    alone = replace(MODEL, error=replace(MODEL.error, correlation_soc=None, correlation_s=3600.0))
    log, _ = wrong_along_soc(DRIVE_A, 0.9, 0)
    sure, unsure = (Ekf(m).run(log, 0.9, 0.1).soc_std[-1] for m in (MODEL, alone))
    assert sure < 0.75 * unsure


def test_new_ground_is_what_lies_beyond_where_the_cell_has_been():
    """Down by 30 points, up by 40, down again: 40 points in all, once each."""
    watch, seen = first_watch(0.0), 0.0
    for way, steps in ((0.01, 30), (-0.01, 40), (0.01, 40), (0.0, 400)):
        for _ in range(steps):
            shown, ground = new_ground(watch, way, 60.0)
            seen += shown
            watch = watch._replace(**ground._asdict())
    assert seen == pytest.approx(0.40, abs=1e-9)


def test_a_model_that_does_not_know_its_length_goes_by_time():
    unknown = replace(MODEL, error=replace(MODEL.error, correlation_soc=None))
    noise = Noise.of_model(unknown)
    assert noise.slow_soc == 0.0
    assert noise.scalars().memory_s == noise.slow_s == 300.0


def test_lockstep_knows_the_same():
    log, _ = wrong_along_soc(DRIVE_A, 0.9, 1)
    ekf, fleet = Ekf(MODEL), LockstepEkf(MODEL, 2, 10.0)
    one, many = ekf.init(0.88, 0.015), fleet.init(np.array([0.88, 0.6]), 0.015)
    for k in range(DRIVE_A.size):
        one, _ = ekf.step(one, log.current_A[k], log.voltage_V[k], 25.0, dt_s=10.0)
        both = np.full(2, log.current_A[k]), np.full(2, log.voltage_V[k])
        many, _ = fleet.step(many, *both, 25.0)
    mine, lane = one, fleet.cell_state(many, 0)
    assert lane.soc == pytest.approx(mine.soc, rel=1e-9)
    assert lane.soc_std == pytest.approx(mine.soc_std, rel=1e-9)
