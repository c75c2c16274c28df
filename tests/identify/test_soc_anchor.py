"""Where a log begins: full, empty, in the middle, under load, on a plateau; and how sure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify.ocv.curve import curve_from_points
from cellwise.identify.soc_anchor import anchor_soc
from cellwise.logs.cell_log import CellLog
from synthetic import HppcPlan, drive_current, driven_log, hppc_log, lfp_cell, nmc_cell

NMC, LFP = nmc_cell(3.0), lfp_cell(2.3)
GRID = np.linspace(0.0, 1.0, 101)


def curve(cell, half_gap_V=0.0):
    branches = {}
    if half_gap_V:
        at = np.linspace(0.0, 1.0, 201)
        branches = {
            "discharge_V": cell.ocv_V(at) - half_gap_V,
            "charge_V": cell.ocv_V(at) + half_gap_V,
        }
    return curve_from_points(GRID, cell.ocv_V(GRID), capacity_Ah=cell.capacity_Ah, **branches)


NMC_OCV, LFP_OCV = curve(NMC), curve(LFP)


def drive_from(cell, soc, *, hours=0.4, rest_s=1200, load_first=False, noise_V=5e-4):
    """A rest (or none), a drive, half an hour of rest; 1 Hz, without a counter."""
    rng = np.random.default_rng(3)
    drive = drive_current(3600.0 * hours, 1.0, 0.8 * cell.capacity_Ah, rng)
    if load_first:
        current = np.concatenate((drive[drive != 0.0], np.full(120, 0.3)))
    else:
        current = np.concatenate((np.zeros(rest_s), drive, np.zeros(1800)))
    return driven_log(cell, current, 1.0, soc=soc, noise_V=noise_V, rng=rng)


def consistent(anchor, truth, floor=0.005):
    return abs(anchor.soc - truth) <= 2.0 * anchor.std + floor


def test_a_test_that_begins_full():
    made = hppc_log(NMC, HppcPlan(noise_V=5e-4))
    anchor = anchor_soc(made.log, NMC_OCV, NMC.capacity_Ah, 0.05)
    assert made.soc[0] == pytest.approx(1.0, abs=1e-6)
    assert anchor.soc == 1.0
    assert anchor.std <= 0.01
    assert "full" in anchor.how


def test_a_test_that_begins_empty_and_is_charged_full():
    plan = HppcPlan(initial_charge=True, levels=(0.8, 0.5, 0.2), noise_V=5e-4)
    made = hppc_log(NMC, plan)
    anchor = anchor_soc(made.log, NMC_OCV, NMC.capacity_Ah, 0.05)
    assert made.soc[0] == pytest.approx(0.02, abs=1e-3)
    assert anchor.soc == pytest.approx(made.soc[0], abs=0.01)


@pytest.mark.parametrize("soc", [0.1, 0.25, 0.5, 0.7, 0.9])
def test_a_rest_in_the_middle_of_a_steep_ocv(soc):
    anchor = anchor_soc(drive_from(NMC, soc, hours=0.1), NMC_OCV, NMC.capacity_Ah, 0.05)
    assert anchor.soc == pytest.approx(soc, abs=0.015)
    assert consistent(anchor, soc)
    assert anchor.std < 0.03


@pytest.mark.parametrize("soc", [0.4, 0.55, 0.7])
def test_a_log_without_any_rest_is_anchored_in_its_first_minute(soc):
    log = drive_from(NMC, soc, hours=0.3, load_first=True)
    assert log.current_A[0] != 0.0
    anchor = anchor_soc(log, NMC_OCV, NMC.capacity_Ah, 0.044)
    assert "load" in anchor.how
    assert consistent(anchor, soc)
    assert anchor.std > 0.005


def test_one_row_without_current_in_the_middle_of_a_load_is_no_rest():
    log = drive_from(NMC, 0.55, hours=0.3, load_first=True)
    current = log.current_A.copy()
    current[0] = 0.0  # a car at a light
    anchor = anchor_soc(replace(log, current_A=current), NMC_OCV, NMC.capacity_Ah, 0.044)
    assert "load" in anchor.how
    assert consistent(anchor, 0.55)


@pytest.mark.parametrize("soc", [0.2, 0.35, 0.5, 0.8])
def test_on_a_plateau_the_spread_is_consistent(soc):
    log = drive_from(LFP, soc, hours=0.05)
    anchor = anchor_soc(log, LFP_OCV, LFP.capacity_Ah, 0.05)
    assert consistent(anchor, soc)
    steep = anchor_soc(drive_from(NMC, soc, hours=0.05), NMC_OCV, NMC.capacity_Ah, 0.05)
    assert anchor.std > steep.std, "a plateau says less than a slope"


def test_a_gap_between_the_branches_widens_what_a_rest_may_read():
    # Rested after a discharge the cell reads half a gap low: 15 mV are 30 points of this plateau.
    log = drive_from(LFP, 0.5, hours=0.05)
    low = replace(log, voltage_V=log.voltage_V - 0.015)
    plain = anchor_soc(low, LFP_OCV, LFP.capacity_Ah, 0.05)
    aware = anchor_soc(low, curve(LFP, 0.015), LFP.capacity_Ah, 0.05)
    assert aware.std > plain.std
    assert consistent(aware, 0.5)


def test_a_plateau_that_ends_in_a_knee_is_known_by_the_knee():
    # The start says little, but the log runs down to 2 % and rests there: charge tells the rest.
    capacity = LFP.capacity_Ah
    steps = [0.0] * 1200 + [capacity] * int(3600 * 0.38) + [0.0] * 3600
    log = driven_log(LFP, np.array(steps), 1.0, soc=0.4, noise_V=5e-4)
    alone = anchor_soc(log.part(0, 1200), LFP_OCV, capacity, 0.05)
    anchor = anchor_soc(log, LFP_OCV, capacity, 0.05)
    assert anchor.std < 0.5 * alone.std
    assert consistent(anchor, 0.4)
    assert anchor.soc == pytest.approx(0.4, abs=0.04)


def test_a_capacity_that_is_off_does_not_pull_the_start_along():
    # It rests at 90 %, then at 80, 70 ... 30 %: with 15 % too much capacity every later rest says
    # something else of the start, and all of them are wrong together.
    hour = [0.0] * 3600
    steps = hour + ([0.5 * NMC.capacity_Ah] * 720 + hour) * 6
    log = driven_log(NMC, np.array(steps), 1.0, soc=0.9, noise_V=5e-4)
    anchor = anchor_soc(log, NMC_OCV, 1.15 * NMC.capacity_Ah, 0.05)
    assert anchor.soc == pytest.approx(0.9, abs=0.015)


@pytest.mark.parametrize("volts", [2.0, 4.6])
def test_a_voltage_beyond_the_curve_stays_on_the_axis(volts):
    log = CellLog(np.arange(3600.0), np.zeros(3600), np.full(3600, volts))
    anchor = anchor_soc(log, NMC_OCV, NMC.capacity_Ah, 0.05)
    assert anchor.soc == pytest.approx(0.0 if volts < 3.0 else 1.0, abs=0.02)
