"""Verdicts on pulses: a circuit is never distorted, what is none is, a limit is a limit."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify import IdentifySettings, TestLogs
from cellwise.identify.checked_logs import check_logs
from cellwise.identify.fitted_pulses import fit_all_pulses
from cellwise.identify.hppc.pulses import find_pulses
from cellwise.identify.ocv.curve import curve_from_points
from synthetic import HppcPlan, driven_log, hppc_log, lfp_cell, nmc_cell


def linear_cell(slope_V=0.7, bend_V=0.0):
    """Constant resistances; OCV a line, or a line with a cliff of depth bend_V below 30 %."""
    return replace(
        nmc_cell(),
        ocv_V=lambda s: 3.4 + slope_V * s - bend_V * np.exp(-30.0 * (s - 0.3)),
        r0_ohm=lambda s: 0.03 + 0.0 * s,
        r1_ohm=lambda s: 0.02 + 0.0 * s,
        tau1_s=lambda s: 4.0 + 0.0 * s,
        r2_ohm=lambda s: 0.03 + 0.0 * s,
        tau2_s=lambda s: 60.0 + 0.0 * s,
        lower_V=0.0,
        upper_V=9.0,
    )


def fitted(cell, **plan):
    """The pulses as the station of their fits judges them."""
    log = hppc_log(cell, HppcPlan(noise_V=1e-3, **plan)).log
    settings = IdentifySettings(nominal_Ah=cell.capacity_Ah)
    checked = check_logs(TestLogs(hppc=((log, None),)), settings)
    grid = np.linspace(0.0, 1.0, 201)
    ocv = curve_from_points(grid, cell.ocv_V(grid), capacity_Ah=cell.capacity_Ah)
    (group,) = fit_all_pulses(checked, ocv, cell.capacity_Ah, settings).groups
    return group.pulse_sets[0]


@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_a_circuit_of_two_branches_is_never_distorted(seconds):
    found = fitted(linear_cell(), levels=(0.9, 0.5, 0.2), rates_c=(0.5, 3.0), pulse_s=seconds)
    assert {p.quality for p in found.pulses} == {"healthy"}


def test_what_no_circuit_answers_is_distorted_and_not_fitted():
    """Between two rows of one pulse the cell jumps by a fifth of its answer."""
    log = hppc_log(linear_cell(), HppcPlan(levels=(0.9, 0.7, 0.5), rates_c=(1.0,))).log
    start = next(p for p in find_pulses(log) if p.role == "pulse").start
    voltage = log.voltage_V.copy()
    voltage[start + 20 : start + 60] -= 0.02
    grid = np.linspace(0.0, 1.0, 201)
    cell = linear_cell()
    ocv = curve_from_points(grid, cell.ocv_V(grid), capacity_Ah=3.0)
    settings = IdentifySettings(nominal_Ah=3.0)
    checked = check_logs(TestLogs(hppc=((replace(log, voltage_V=voltage), None),)), settings)
    (found,) = fit_all_pulses(checked, ocv, 3.0, settings).groups[0].pulse_sets
    assert [p.start for p in found.pulses if p.quality == "distorted"] == [start]
    assert start not in [p.start for p in found.fitted]
    assert len(found.fits) == len(found.fitted)


def pulses_of(cell, **plan):
    made = hppc_log(cell, HppcPlan(**plan))
    return made, find_pulses(made.log)


@pytest.mark.parametrize("limit", ["cv", "stop"])
@pytest.mark.parametrize("cell", [nmc_cell(), lfp_cell(3.0)], ids=["nmc", "lfp"])
def test_a_pulse_that_a_limit_cut_is_trimmed_and_no_other(limit, cell):
    made, pulses = pulses_of(
        cell, levels=(0.95, 0.5, 0.1, 0.05), rates_c=(1.0, 3.0, 6.0), pulse_s=30.0, limit=limit,
        noise_V=1e-3, noise_A=0.003,
    )  # fmt: skip
    # A pulse that its first row ended is a glitch for all that a log shows.
    cut = [p for p in made.pulses if p.limited and p.role == "pulse" and p.stop - p.start > 1]
    short = {p.start: p for p in cut}
    # A limit that is reached within the last tenth of a pulse leaves it as good as whole.
    held = {
        start: np.mean(np.abs(made.current_A[p.start : p.stop] - p.current_A) > 0.02 * 3.0)
        for start, p in short.items()
    }
    trimmed = {p.start for p in pulses if p.quality == "trimmed"}
    if limit == "cv":
        assert trimmed >= {start for start, share in held.items() if share > 0.1}
    else:
        lasted = {s: made.log.time_s[p.stop - 1] - made.log.time_s[s - 1] for s, p in short.items()}
        assert trimmed >= {start for start, seconds in lasted.items() if seconds < 27.0}
    assert trimmed <= set(short) | {p.start for p in pulses if p.role == "move"}
    assert short


def test_the_reason_of_a_trimmed_pulse_has_the_limit_the_time_and_the_current():
    _, pulses = pulses_of(nmc_cell(), levels=(0.9,), rates_c=(6.0,), pulse_s=30.0, order="charge")
    cut = next(p for p in pulses if p.kind == "charge")
    assert cut.quality == "trimmed"
    assert "4.200 V was reached" in cut.reason
    assert "of 30 s" in cut.reason
    assert cut.cc_stop < cut.stop


def test_a_blip_among_pulses_is_spurious_and_says_so():
    current = np.zeros(20_000)
    for at in (1000, 5000, 9000, 13_000):
        current[at : at + 300] = 3.0
    current[17_000:17_020] = 3.0
    pulses = find_pulses(driven_log(nmc_cell(), current, 10.0, noise_V=1e-3))
    assert [p.quality for p in pulses] == ["healthy"] * 4 + ["spurious"]
    assert "2 s long where its siblings last 30 s" in pulses[-1].reason


def test_a_current_that_the_voltage_does_not_answer_is_spurious():
    current = np.zeros(6000)
    current[1000:1300] = current[4000:4300] = 3.0
    log = driven_log(nmc_cell(), current, 10.0)
    voltage = log.voltage_V.copy()
    voltage[3990:] = voltage[3989]
    pulses = find_pulses(replace(log, voltage_V=voltage))
    assert [p.quality for p in pulses] == ["healthy", "spurious"]
    assert "does not answer" in pulses[1].reason


def test_swapped_sign_leaves_no_healthy_pulse():
    log = hppc_log(nmc_cell(), HppcPlan(limit="none")).log
    pulses = find_pulses(replace(log, current_A=-log.current_A))
    assert pulses
    assert {p.quality for p in pulses} == {"spurious"}


def test_gaps_and_missing_voltages_in_a_pulse_are_named():
    made = hppc_log(nmc_cell(), HppcPlan(limit="none"))
    first, second = [p for p in made.pulses if p.role == "pulse"][:2]
    voltage = made.log.voltage_V.copy()
    voltage[first.start + 5 : first.start + 25] = np.nan
    row = second.start + 50
    time = made.log.time_s + np.where(np.arange(len(made.log)) >= row, 500.0, 0.0)
    current = made.log.current_A
    charge = np.cumsum(current * np.diff(time, prepend=time[0])) / 3600.0
    log = replace(made.log, voltage_V=voltage, time_s=time, charge_Ah=charge)
    reasons = {p.start: p.reason for p in find_pulses(log) if p.quality == "spurious"}
    assert "missing" in reasons[first.start]
    assert "gap" in reasons[second.start]


def test_a_missing_voltage_or_two_do_not_spoil_a_pulse():
    made = hppc_log(nmc_cell(), HppcPlan(limit="none", order="discharge-only"))
    voltage = made.log.voltage_V.copy()
    for pulse in made.pulses:
        voltage[[pulse.start - 1, pulse.start + 7, pulse.stop - 1]] = np.nan
    verdicts = [p.quality for p in find_pulses(made.log)]
    assert [p.quality for p in find_pulses(replace(made.log, voltage_V=voltage))] == verdicts


def test_a_duration_of_its_own_for_each_rate_is_no_defect():
    """30 s at 1C, 10 s at 3C, 4 s at 6C, down to low SOC and no limit anywhere near."""
    pieces = [np.zeros(3000)]
    for _ in range(6):
        for rate, rows in ((1.0, 300), (3.0, 100), (6.0, 40)):
            pieces += [np.full(rows, rate * 3.0), np.zeros(4000)]
        pieces += [np.full(4000, 3.0), np.zeros(9000)]
    log = driven_log(linear_cell(), np.concatenate(pieces), 10.0, soc=0.95, noise_V=1e-3)
    pulses = [p for p in find_pulses(log) if p.role == "pulse"]
    assert len(pulses) == 18
    assert {p.quality for p in pulses} == {"healthy"}
