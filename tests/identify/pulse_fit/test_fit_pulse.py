"""Pulse identification as a whole: one interface, whole tests with a known truth, real cells."""

from functools import cache

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.fitted_pulses import cut_pulse, cut_pulses, pulse_from_arrays
from cellwise.identify.hppc.pulses import find_pulses
from cellwise.identify.pulse_fit.fit_pulse import fit_pulse, fit_pulses
from cellwise.identify.pulse_fit.pulse_data import PulseData, has_enough_rows
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit
from cellwise.logs import CellLog, read_log
from closed_form import Circuit, closed_pulse, stamps
from synthetic import HppcPlan, SyntheticCell, hppc_log, nmc_cell

LEVELS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.15, 0.05)
FULL_TEST = HppcPlan(
    levels=LEVELS, rates_c=(0.5, 1.0, 2.0, 3.0), order="by-level", pulse_s=60.0, rest_s=1200.0,
    pulse_hz=135.0, fast_s=60.0, noise_V=1e-3, limit="none",
)  # fmt: skip


def truth(cell: SyntheticCell, soc: float) -> np.ndarray:
    s = np.array([soc])
    tables = (cell.r0_ohm, cell.r1_ohm, cell.tau1_s, cell.r2_ohm, cell.tau2_s)
    return np.array([float(table(s)[0]) for table in tables])


def relative_errors(cell: SyntheticCell, fits: list[PulseFit]) -> np.ndarray:
    return np.array([np.array(f.value[:5]) / truth(cell, f.soc) - 1.0 for f in fits])


def cut_all(made) -> list[PulseData]:
    pulses = [p for p in find_pulses(made.log) if p.role == "pulse"]
    return cut_pulses(made.log, pulses, made.cell.capacity_Ah, made.soc, made.cell.ocv_V)


# --- synthetic truth -----------------------------------------------------------------------------


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
    changes = {"levels": (0.95, 0.8, 0.7, 0.5, 0.3), **QUICK[plan]}
    base = {**vars(FULL_TEST), "noise_V": 2e-4, **changes}
    cell = nmc_cell()
    fits = fit_pulses(cut_all(hppc_log(cell, HppcPlan(**base), rng=np.random.default_rng(2))))
    assert len(fits) == 40
    error = np.abs(relative_errors(cell, fits))
    for level in range(5):
        assert np.all(np.median(error[8 * level : 8 * level + 8], axis=0) < 0.05)


# --- windows -------------------------------------------------------------------------------------


def a_log(rest_before=100.0, gap=False, nan=()):
    t = stamps(before_s=rest_before, pulse_hz=10.0)
    data = closed_pulse(Circuit(), t)
    time_s, voltage = data.time_s.copy(), data.voltage_V.copy()
    voltage[list(nan)] = np.nan
    if gap:
        time_s[data.stop + 400 :] += 5000.0
    return CellLog(time_s - time_s[0], data.current_A, voltage), data.start, data.stop


def test_window_shows_a_minute_of_rest_and_all_of_the_relaxation():
    log, start, stop = a_log()
    data = cut_pulse(log, start, stop, 40.0, soc_start=0.5)
    assert data.time_s[data.start - 1] - data.time_s[data.first] == pytest.approx(60.0, abs=1.0)
    assert data.time_s[data.start - 1] - data.time_s[0] == pytest.approx(100.0)
    assert data.time_s[-1] == log.time_s[-1]
    assert data.soc == pytest.approx(0.5 - 0.5 * 20.0 * 60.0 / 3600.0 / 40.0)
    assert data.pulse_current_A == pytest.approx(20.0)
    assert data.pulse_duration_s == pytest.approx(60.0)


def test_window_takes_in_the_row_that_holds_the_switch():
    log, start, stop = a_log()
    current = log.current_A.copy()
    current[start], current[stop] = 6.0, 12.0  # switched inside these rows' intervals
    data = cut_pulse(CellLog(log.time_s, current, log.voltage_V), start, stop, 40.0)
    assert data.current_A[data.stop] == 12.0
    assert len(data) - data.stop > 100
    assert data.settling_rows[data.start]
    assert data.settling_rows[data.stop]
    assert np.count_nonzero(data.settling_rows) == 2


def test_switch_late_in_a_slow_row_is_left_out():
    """A row of 1 s whose last 10 ms carry the pulse: no current to speak of, all of its drop."""
    log, start, stop = a_log()
    current, voltage = log.current_A.copy(), log.voltage_V.copy()
    current[start - 1] = 0.01 * 20.0
    voltage[start - 1] -= 2e-3 * 20.0
    data = cut_pulse(CellLog(log.time_s, current, voltage), start, stop, 40.0)
    rows = np.flatnonzero(data.settling_rows)
    np.testing.assert_array_equal(rows, [data.start - 1])
    np.testing.assert_allclose(fit_pulse(data).value[:5], Circuit().values[:5], rtol=5e-3)


def test_rows_without_a_voltage_are_dropped_and_their_charge_is_kept():
    whole, start, stop = a_log()
    missing = [start + 3, start + 4, start + 100, stop + 7, *range(stop + 40, stop + 60)]
    log, _, _ = a_log(nan=missing)
    a, b = (fit_pulse(cut_pulse(x, start, stop, 40.0)) for x in (whole, log))
    assert b.rows == a.rows - len(missing)
    np.testing.assert_allclose(b.value, a.value, rtol=1e-5)


def test_voltage_that_arrives_late_is_left_out_and_said():
    """A tester that filters its voltage with 0.1 s, as one of the measured cells' did."""
    t = stamps(pulse_hz=10.0, fast_s=60.0)
    clean = closed_pulse(Circuit(), t)
    voltage = clean.voltage_V.copy()
    for edge, sign in ((clean.start, 1.0), (clean.stop, -1.0)):
        voltage[edge : edge + 6] += sign * 0.04 * 0.33 ** np.arange(1, 7)
    data = pulse_from_arrays(t, clean.current_A, voltage, clean.start, clean.stop, 40.0)
    fit = fit_pulse(data)
    assert 4 <= fit.left_out <= 10
    np.testing.assert_allclose(fit.value[:5], Circuit().values[:5], rtol=0.03)
    assert not clean.settling_rows.any()


# --- one interface -------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["varpro", "segments", "pso"])
def test_every_method_returns_the_same_kind_of_thing(method):
    data = closed_pulse(Circuit(), stamps(pulse_hz=5.0))
    fit = fit_pulse(data, method)
    assert fit.method == method
    assert fit.soc == pytest.approx(data.soc)
    assert fit.current_A == pytest.approx(20.0)
    assert all(np.isfinite(fit.value))
    assert fit.rmse_V >= 0.0
    assert fit.tau1_s < fit.tau2_s
    assert fit.c1_F == pytest.approx(fit.tau1_s / fit.r1_ohm)
    assert fit_pulses([data, data], method)[0].value == fit.value


def test_a_wrong_method_is_refused():
    with pytest.raises(InputError, match="'varpro', 'segments' or 'pso'"):
        fit_pulse(closed_pulse(Circuit(), stamps(pulse_hz=5.0)), "magic")


# --- input that says little ----------------------------------------------------------------------


def test_a_window_of_too_few_rows_is_refused():
    t = np.arange(9.0)
    with pytest.raises(InputError, match="at least"):
        pulse_from_arrays(t, np.where(t >= 4, 2.0, 0.0), np.full(9, 3.6), 4, 7, 3.0)


def test_a_flat_noisy_or_constant_voltage_gives_no_nonsense():
    t = stamps(pulse_hz=5.0)
    good = closed_pulse(Circuit(), t)
    flat = fit_pulse(PulseData(**{**vars(good), "voltage_V": np.full(t.size, 3.6)}))
    assert flat.r0_ohm == pytest.approx(0.0, abs=1e-9)
    assert all(np.isfinite(flat.value))
    wrong_sign = PulseData(**{**vars(good), "current_A": -good.current_A})
    fit = fit_pulse(wrong_sign)
    assert "r0_ohm" in fit.at_bound
    assert not fit.identified.r0_ohm


# --- real cells ----------------------------------------------------------------------------------

REAL = {
    "panasonic": ("panasonic_18650pf/hppc_p25.csv.gz", 2.997),
    "leaf": ("nissan_leaf/hppc_p25.csv.gz", 30.3),
}


@cache
def real_pulses(folder, name):
    path, capacity = REAL[name]
    log = read_log(folder / path)
    charge = log.counted_charge_Ah()
    soc = 1.0 - (charge - charge.min()) / capacity
    found = [p for p in find_pulses(log) if p.role == "pulse" and p.quality != "spurious"]
    data = cut_pulses(log, found, capacity, soc)
    assert all(has_enough_rows(d) for d in data)
    return data


@pytest.mark.parametrize("name", REAL)
def test_real_pulses_fit_and_never_worse_than_the_swarm(real_data, name):
    data = real_pulses(real_data, name)
    fits = fit_pulses(data)
    assert len(fits) >= 20
    for k, (one, fit) in enumerate(zip(data, fits, strict=True)):
        if k % 4 == 0:
            assert fit.rmse_V <= fit_pulse(one, "pso").rmse_V
        if fit.soc > 0.2:
            assert fit.rmse_V < 0.01 * np.ptp(one.voltage_V)
    assert np.median([f.rmse_V for f in fits]) < 1e-3


@pytest.mark.parametrize("name", REAL)
def test_real_r0_is_smooth_over_soc(real_data, name):
    """Pulses of one current: each R0 within 6 % of the line through its neighbours'."""
    fits = [f for f in fit_pulses(real_pulses(real_data, name)) if 0.15 < f.soc < 0.98]
    by_current: dict[float, list[PulseFit]] = {}
    for fit in fits:
        by_current.setdefault(round(fit.current_A), []).append(fit)
    checked = 0
    for group in by_current.values():
        group.sort(key=lambda f: f.soc)
        for a, b, c in zip(group, group[1:], group[2:], strict=False):
            part = (b.soc - a.soc) / (c.soc - a.soc)
            line = (1.0 - part) * a.r0_ohm + part * c.r0_ohm
            assert b.r0_ohm == pytest.approx(line, rel=0.06 if a.soc > 0.2 else 0.15)
            checked += 1
    assert checked > 10
