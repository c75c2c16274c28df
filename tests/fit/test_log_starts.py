"""Where a log begins, by its voltages and what its role says of it."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.fit.log_starts import find_beginning, thinned
from cellwise.fit.population import cell_classes
from cellwise.fit.rows import ROWS, FitLog
from measured_models import missed
from synthetic import drive_current, driven_log, lfp_cell, nmc_cell

CELLS = {"layered": nmc_cell(3.0), "lfp": lfp_cell(3.0)}
CLASSES = {c.name: c for c in cell_classes()}


def discharge(cell, rest_s, rate=0.5, used=0.97, soc=1.0):
    load = np.full(int(3600.0 * used * soc / rate), rate * cell.capacity_Ah)
    current = np.concatenate((np.zeros(rest_s), load, np.zeros(600)))
    return driven_log(cell, current, 1.0, soc=soc, noise_V=5e-4)


def beginning(name, log, full=0.8, ln_std=0.02):
    cell = CELLS[name]
    item = FitLog(log, 1.0, past_V=0.03)
    return find_beginning(item, CLASSES[name], cell.capacity_Ah, ln_std, 25.0, full)


FULL = {f"{name} {rest_s}": (name, rest_s) for name in CELLS for rest_s in (0, 600)}


@pytest.mark.parametrize("case", missed(FULL, **{"layered 0": "89 %, deviation 0.027"}))
def test_a_capacity_test_that_begins_under_load_is_found_full(case):
    name, rest_s = FULL[case]
    log = discharge(CELLS[name], rest_s)
    if not rest_s:
        log = log.part(1, len(log))
        assert log.current_A[0] > 0.0
    found = beginning(name, log, full=0.97)
    assert found.full > 0.9
    assert found.soc == 1.0
    assert found.std < 0.02


@pytest.mark.parametrize("soc", [0.85, 0.6, 0.4])
def test_a_drive_from_the_middle_is_found_there(soc):
    current = drive_current(1500, 1.0, 6.0, np.random.default_rng(3))
    log = driven_log(CELLS["layered"], current, 1.0, soc=soc, noise_V=5e-4)
    found = beginning("layered", log)
    # A drive of 25 minutes shows little: what it leaves open is said.
    assert found.soc == pytest.approx(soc, abs=2.0 * found.std)
    assert found.full < 0.9
    assert found.std < 0.2


def test_the_less_likely_full_is_beforehand_the_less_it_is_after():
    log = driven_log(
        CELLS["lfp"], drive_current(600, 1.0, 4.0, np.random.default_rng(5)), 1.0, soc=0.9
    )
    shares = [beginning("lfp", log, full).full for full in (0.9, 0.5, 0.1)]
    assert shares == sorted(shares, reverse=True)


def test_thinning_keeps_charge_and_time():
    log = discharge(CELLS["layered"], 600)
    short = thinned(log)
    assert len(short) < 0.2 * len(log)
    assert len(short) <= ROWS.most + 1
    assert short.counted_charge_Ah()[-1] == pytest.approx(log.counted_charge_Ah()[-1], rel=1e-9)
    assert short.time_s[-1] == log.time_s[-1]
    moved = float(short.known_current_A() @ short.interval_s) / 3600.0
    assert moved == pytest.approx(log.counted_charge_Ah()[-1], rel=1e-3)


def test_rows_that_are_not_compared_bring_no_voltage():
    log = discharge(CELLS["layered"], 600)
    short = thinned(log, np.arange(len(log)) < 3000)
    assert np.all(np.isnan(short.voltage_V[short.time_s > 3010.0]))
    assert np.all(np.isfinite(short.voltage_V[short.time_s < 2990.0]))
