"""Verdicts on pulses: a linear circuit is never distorted, a bent OCV is, a limit is a limit."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify.hppc.pulses import find_pulses
from cellwise.logs import CellLog, read_log
from synthetic import HppcPlan, driven_log, hppc_log, lfp_cell, nmc_cell


def linear_cell(slope_V=0.7, bend_V=0.0, tau_s=(4.0, 60.0)):
    """Constant resistances; OCV a line, or a line with a cliff of depth bend_V below 30 %."""
    return replace(
        nmc_cell(),
        ocv_V=lambda s: 3.4 + slope_V * s - bend_V * np.exp(-30.0 * (s - 0.3)),
        r0_ohm=lambda s: 0.03 + 0.0 * s,
        r1_ohm=lambda s: 0.02 + 0.0 * s,
        tau1_s=lambda s: tau_s[0] + 0.0 * s,
        r2_ohm=lambda s: 0.03 + 0.0 * s,
        tau2_s=lambda s: tau_s[1] + 0.0 * s,
        lower_V=0.0,
        upper_V=9.0,
    )


def pulses_of(cell, **plan):
    made = hppc_log(cell, HppcPlan(**plan))
    return made, find_pulses(made.log)


@pytest.mark.parametrize("hz", [135.0, 10.0, 1.0])
@pytest.mark.parametrize(
    ("seconds", "tau_s"), [(10.0, (0.7, 20.0)), (60.0, (4.0, 60.0)), (30.0, (11.0, 400.0))]
)
@pytest.mark.parametrize("noise", [0.0, 1e-3, 5e-3])
def test_a_linear_circuit_is_never_distorted(hz, seconds, tau_s, noise):
    """Whatever the time constants: the grid holds none of them, and yet explains them all."""
    _, pulses = pulses_of(
        linear_cell(tau_s=tau_s), levels=(0.9, 0.5, 0.2), rates_c=(0.5, 3.0), pulse_s=seconds,
        pulse_hz=hz, rest_s=900.0, noise_V=noise,
    )  # fmt: skip
    assert len(pulses) == 15
    assert {p.quality for p in pulses} == {"healthy"}


def test_a_pulse_is_distorted_where_the_ocv_bends():
    verdicts = []
    for bend in (0.0, 0.02, 0.1, 0.3):
        _, pulses = pulses_of(
            linear_cell(bend_V=bend), levels=(0.3,), rates_c=(2.0,), order="discharge-only",
            pulse_s=60.0, rest_s=900.0, noise_V=5e-4,
        )  # fmt: skip
        verdicts.append(pulses[-1].quality)
    assert verdicts[0] == "healthy"
    assert verdicts[-1] == "distorted"


def test_a_relaxation_that_is_not_the_pulse_again_is_named():
    """Half of the slow voltage stays: hysteresis. The pulse alone is that of a circuit."""
    t = np.arange(0.0, 2000.0, 0.1)
    current = np.where((t > 600.0) & (t <= 630.0), 3.0, 0.0)
    since, after = np.clip(t - 600.0, 0.0, 30.0), np.maximum(t - 630.0, 0.0)
    slow = 0.06 * -np.expm1(-since / 8.0)
    slow = np.where(after > 0.0, slow * (0.5 + 0.5 * np.exp(-after / 8.0)), slow)
    (pulse,) = find_pulses(CellLog(t, current, 3.7 - 0.01 * current - slow))
    assert pulse.quality == "distorted"
    assert "no passive circuit" in pulse.reason


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
    cut = next(p for p in pulses if p.current_A < 0.0)
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


def test_panasonic_pulses_are_distorted_at_the_ends_of_the_range_only(real_data):
    log = read_log(real_data / "panasonic_18650pf" / "hppc_p25.csv.gz")
    pulses = [p for p in find_pulses(log) if p.role == "pulse"]
    soc = {p.start: 1.0 - log.charge_Ah[p.start - 1] / 2.997 for p in pulses}
    distorted = [soc[p.start] for p in pulses if p.quality == "distorted"]
    assert distorted
    assert all(s < 0.2 or s > 0.95 for s in distorted)
    assert sum(p.quality == "healthy" for p in pulses) > 50


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
