"""Segments: equations (6) to (9) to the letter, where the answer is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.papers.segments import fit_segments
from closed_form import Circuit, closed_pulse, stamps

ONE_BRANCH = Circuit(r1=1.0e-3, tau1=5.0, r2=0.0, slope=0.0)


@pytest.mark.parametrize("current", [-20.0, 20.0])
def test_single_branch_step_gives_the_closed_form(current):
    # Rows from 0.1 s to 60 s: t1 = 0.1, t3 = 60, t2 the row nearest a tenth of the way.
    data = closed_pulse(ONE_BRANCH, stamps(pulse_hz=10.0), current)
    fit = fit_segments(data)
    t1, t3 = 0.1, 60.0
    t2 = round((t1 + 0.1 * (t3 - t1)) * 10.0) / 10.0

    def left(t):
        return np.exp(-t / 5.0)

    assert fit.r0_ohm == pytest.approx(2.0e-3 + 1.0e-3 * (1.0 - left(t1)), rel=1e-9)
    assert fit.r1_ohm == pytest.approx(1.0e-3 * (left(t1) - left(t2)), rel=1e-9)
    assert fit.r2_ohm == pytest.approx(1.0e-3 * (left(t1) - left(t3)), rel=1e-9)
    assert fit.tau1_s == pytest.approx((t2 - t1) / 5.0, rel=1e-9)
    assert fit.tau2_s == pytest.approx((t3 - t1) / 5.0, rel=1e-9)
    assert fit.c1_F == pytest.approx(fit.tau1_s / fit.r1_ohm, rel=1e-12)
    assert fit.c2_F == pytest.approx(fit.tau2_s / fit.r2_ohm, rel=1e-12)
    assert fit.ocv_V == pytest.approx(3.6)


def test_errors_of_the_resistances_follow_from_the_noise():
    rng = np.random.default_rng(0)
    t = stamps(pulse_hz=10.0)
    fits = [
        fit_segments(closed_pulse(ONE_BRANCH, t, noise=1e-3 * rng.standard_normal(t.size)))
        for _ in range(300)
    ]
    for name in ("r0_ohm", "r1_ohm", "r2_ohm"):
        scatter = np.std([getattr(f, name) for f in fits])
        assert getattr(fits[0].error, name) == pytest.approx(scatter, rel=0.25)
    assert np.isnan(fits[0].error.tau1_s)
    assert not fits[0].identified.tau1_s
    assert fits[0].identified.r0_ohm


def test_rows_where_the_voltage_still_arrives_are_skipped():
    t = stamps(pulse_hz=10.0)
    data = closed_pulse(ONE_BRANCH, t)
    voltage = data.voltage_V.copy()
    k = data.start
    voltage[k : k + 3] += 0.04 * np.array([0.6, 0.25, 0.1])  # R0 I = 40 mV arrives in three rows
    fit = fit_segments(replace(data, voltage_V=voltage))
    expected = 2.0e-3 + 1.0e-3 * (1.0 - np.exp(-0.4 / 5.0))
    assert fit.r0_ohm == pytest.approx(expected, rel=1e-9)


def test_a_pulse_without_rest_before_or_of_two_rows_is_refused():
    data = closed_pulse(ONE_BRANCH, stamps(pulse_hz=10.0))
    a, b = data.start, data.stop

    def part(rows, start, stop):
        columns = ("time_s", "current_A", "voltage_V", "soc", "ocv_V")
        return replace(data, start=start, stop=stop, **{n: getattr(data, n)[rows] for n in columns})

    with pytest.raises(InputError, match="0 rows before"):
        fit_segments(part(slice(a, None), 0, b - a))
    keep = np.r_[0 : a + 1, b - 1 : data.time_s.size]
    with pytest.raises(InputError, match="settled rows"):
        fit_segments(part(keep, a, a + 2))
