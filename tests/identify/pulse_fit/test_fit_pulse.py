"""Pulse identification as a whole: one interface, whole tests with a known truth, real cells."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.identify.pulse_fit.circuit import PulseFit
from cellwise.identify.pulse_fit.fit_pulse import fit_pulse
from cellwise.identify.pulse_fit.pulse_data import cut_pulse, pulse_data
from cellwise.logs import CellLog, read_log
from closed_form import Circuit, closed_pulse, stamps
from rich_cell import rich_nmc
from synthetic import HppcPlan, SyntheticCell, hppc_log, nmc_cell

FULL_TEST = HppcPlan(
    levels=(0.95, 0.8, 0.7, 0.5, 0.3), rates_c=(0.5, 1.0, 2.0, 3.0), order="by-level",
    pulse_s=60.0, rest_s=1200.0, pulse_hz=135.0, fast_s=60.0, noise_V=2e-4, limit="none",
)  # fmt: skip
RICH = rich_nmc(3.0)


def truth(cell: SyntheticCell, soc: float) -> np.ndarray:
    s = np.array([soc])
    tables = (cell.r0_ohm, cell.r1_ohm, cell.tau1_s, cell.r2_ohm, cell.tau2_s)
    return np.array([float(table(s)[0]) for table in tables])


QUICK = {
    "10 Hz, free clock": {"pulse_hz": 10.0, "aligned": False, "jitter": 0.3},
    "135 Hz, free clock": {"aligned": False, "rates_c": (1.0, 2.0, 3.0, 3.0)},
    "10 s pulses": {"pulse_hz": 10.0, "pulse_s": 10.0, "rest_s": 600.0},
    "60 s rows at rest": {"pulse_hz": 10.0, "rest_hz": 1 / 60, "fast_s": 60.0},
    "charge first": {"pulse_hz": 10.0, "order": "charge", "levels": (0.9, 0.7, 0.6, 0.5, 0.3)},
}


@pytest.mark.parametrize("plan", QUICK)
def test_other_testers_and_plans(plan):
    """Five percent where the parameters stand still over a pulse; the joint fit takes the rest."""
    cell = nmc_cell()
    made = hppc_log(cell, replace(FULL_TEST, **QUICK[plan]), rng=np.random.default_rng(2))
    pulses = [p for p in find_pulses(made.log) if p.role == "pulse"]
    fits = [fit_pulse(cut_pulse(made.log, p, made.soc, cell.ocv_V)) for p in pulses]
    assert len(fits) == 40
    error = np.abs([np.array(f.value[:5]) / truth(cell, f.soc) - 1.0 for f in fits])
    for level in range(5):
        assert np.all(np.median(error[8 * level : 8 * level + 8], axis=0) < 0.05)


# --- windows -------------------------------------------------------------------------------------


def a_log(nan=()):
    """Rest of 100 s, a pulse of 60 s at 20 A, its relaxation; and the pulse."""
    data = closed_pulse(Circuit(slope=0.0), stamps(before_s=100.0, pulse_hz=10.0))
    voltage = data.voltage_V.copy()
    voltage[list(nan)] = np.nan
    log = CellLog(data.time_s - data.time_s[0], data.current_A, voltage)
    (pulse,) = find_pulses(log)
    return log, pulse


def cut(log, pulse):
    return cut_pulse(log, pulse, 0.5 - log.counted_charge_Ah() / 40.0)


def test_window_shows_a_minute_of_rest_and_all_of_the_relaxation():
    log, pulse = a_log()
    data = cut(log, pulse)
    assert data.time_s[data.start - 1] - data.time_s[data.first] == pytest.approx(60.0, abs=1.0)
    assert data.time_s[data.start - 1] - data.time_s[0] == pytest.approx(100.0)
    assert data.time_s[-1] == log.time_s[-1]
    assert data.mean_soc == pytest.approx(0.5 - 0.5 * 20.0 * 60.0 / 3600.0 / 40.0)
    assert data.pulse_current_A == pytest.approx(20.0)
    assert data.pulse_duration_s == pytest.approx(60.0)
    late = log.time_s + np.where(np.arange(len(log)) >= pulse.stop + 400, 5000.0, 0.0)
    assert cut(replace(log, time_s=late), pulse).time_s.size == data.stop + 400, "ends at a gap"


def test_rows_that_hold_a_switch_are_left_out():
    log, pulse = a_log()
    current = log.current_A.copy()
    current[pulse.start], current[pulse.stop] = 6.0, 12.0  # switched inside these rows' intervals
    (found,) = find_pulses(replace(log, current_A=current))
    data = cut(replace(log, current_A=current), found)
    rows = np.flatnonzero(data.settling_rows)
    np.testing.assert_array_equal(rows, [pulse.start, pulse.stop])


def test_switch_late_in_a_slow_row_is_left_out():
    """A row of 1 s whose last 10 ms carry the pulse: no current to speak of, all of its drop."""
    log, pulse = a_log()
    current, voltage = log.current_A.copy(), log.voltage_V.copy()
    current[pulse.start - 1] = 0.01 * 20.0
    voltage[pulse.start - 1] -= 2e-3 * 20.0
    data = cut(replace(log, current_A=current, voltage_V=voltage), pulse)
    np.testing.assert_array_equal(np.flatnonzero(data.settling_rows), [data.start - 1])
    np.testing.assert_allclose(fit_pulse(data).value[:5], Circuit().values[:5], rtol=5e-3)


def test_rows_without_a_voltage_are_dropped_and_their_charge_is_kept():
    whole, pulse = a_log()
    start, stop = pulse.start, pulse.stop
    missing = [start + 3, start + 4, start + 100, stop + 7, *range(stop + 40, stop + 60)]
    log, _ = a_log(nan=missing)
    a, b = (fit_pulse(cut(x, pulse)) for x in (whole, log))
    assert b.rows == a.rows - len(missing)
    np.testing.assert_allclose(b.value, a.value, rtol=1e-5)


def test_voltage_that_arrives_late_is_left_out():
    """A tester that filters its voltage with 0.1 s, as one of the measured cells' did."""
    clean = closed_pulse(Circuit(), stamps(pulse_hz=10.0, fast_s=60.0))
    voltage = clean.voltage_V.copy()
    for edge, sign in ((clean.start, 1.0), (clean.stop, -1.0)):
        voltage[edge : edge + 6] += sign * 0.04 * 0.33 ** np.arange(1, 7)
    data = replace(clean, voltage_V=voltage)
    assert 4 <= np.count_nonzero(data.settling_rows) <= 10
    np.testing.assert_allclose(fit_pulse(data).value[:5], Circuit().values[:5], rtol=0.03)
    assert not clean.settling_rows.any()


# --- one interface -------------------------------------------------------------------------------


def test_a_wrong_method_and_a_window_of_too_few_rows_are_refused():
    with pytest.raises(InputError, match="'varpro', 'segments' or 'pso'"):
        fit_pulse(closed_pulse(Circuit(), stamps(pulse_hz=5.0)), "magic")
    t = np.arange(9.0)
    short = pulse_data(t, np.where(t >= 4, 2.0, 0.0), np.full(9, 3.6), np.full(9, 0.5), 4, 7)
    with pytest.raises(InputError, match="at least"):
        fit_pulse(short)


def test_a_flat_voltage_or_a_wrong_sign_gives_no_nonsense():
    good = closed_pulse(Circuit(slope=0.0), stamps(pulse_hz=5.0))
    flat = fit_pulse(replace(good, voltage_V=np.full(good.time_s.size, 3.6)))
    assert flat.r0_ohm == pytest.approx(0.0, abs=1e-9)
    assert all(np.isfinite(flat.value))
    fit = fit_pulse(replace(good, current_A=-good.current_A))
    assert "r0_ohm" in fit.at_bound
    assert not fit.identified.r0_ohm


# --- real cells ----------------------------------------------------------------------------------

REAL = {
    "panasonic": (
        "panasonic_18650pf/hppc_p25.csv.gz",
        2.997,
        "panasonic_18650pf/ocv_c20_p25.csv.gz",
    ),
    "leaf": ("nissan_leaf/hppc_p25.csv.gz", 30.3, None),
}


@pytest.mark.parametrize("name", REAL)
def test_pulse_fits_are_no_worse_than_the_swarm_on_measured_pulses(real_data, name):
    """Never worse than the swarm; each R0 near the line through its neighbours'.

    Within 6 %, and 10 % where the OCV bends within the window (Panasonic at 61 %): a pulse alone
    gives some of the bend to its branches.
    """
    path, capacity, slow = REAL[name]
    log = read_log(real_data / path)
    charge = log.counted_charge_Ah()
    soc = 1.0 - (charge - charge.min()) / capacity
    ocv = ocv_from_low_rate(read_log(real_data / slow)) if slow else ocv_from_rests(log, capacity)
    chosen = [p for p in pulses_to_fit(find_pulses(log)) if p.role == "pulse"]
    data = [cut_pulse(log, p, soc, ocv.function.evaluate) for p in chosen]
    fits = [fit_pulse(d) for d in data]
    assert len(fits) >= 18
    for one, fit in list(zip(data, fits, strict=True))[::4]:
        assert fit.rmse_V <= fit_pulse(one, "pso").rmse_V
    assert np.median([f.rmse_V for f in fits]) < 1e-3
    by_current: dict[float, list[PulseFit]] = {}
    for fit in fits:
        if 0.2 < fit.soc < 0.98:
            by_current.setdefault(round(fit.current_A), []).append(fit)
    checked = near = 0
    for group in by_current.values():
        group.sort(key=lambda f: f.soc)
        for a, b, c in zip(group, group[1:], group[2:], strict=False):
            part = (b.soc - a.soc) / (c.soc - a.soc)
            assert b.r0_ohm == pytest.approx((1.0 - part) * a.r0_ohm + part * c.r0_ohm, rel=0.1)
            near += abs(b.r0_ohm / ((1.0 - part) * a.r0_ohm + part * c.r0_ohm) - 1.0) < 0.06
            checked += 1
    assert checked > 8
    assert near >= 0.9 * checked
