"""The LFP paper's tables, piece by piece, where the answer is known without the pipeline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.identify.hppc.pulse_quality import Pulse
from cellwise.identify.pulse_fit.circuit import PulseFit, PulseParameters
from cellwise.logs.cell_log import CellLog
from cellwise.studies.papers import cycle_error, polynomials, split_tests


def flat_cell():
    return CellModel(2.0, np.array([3.0, 3.4]), *(np.full(2, x) for x in (0.02, 0.01, 5, 0.01, 60)))


def two_hours(offset_V):
    """Rest, with a voltage that is off by a known amount of volts per row."""
    time = np.arange(0.0, 7200.0, 60.0)
    blank = CellLog(time, np.full(time.size, 0.1), np.full(time.size, 3.3))
    exact = simulate(flat_cell(), blank, 1.0).voltage_V
    return replace(blank, voltage_V=exact + offset_V(time))


def test_error_shares_are_of_the_measured_voltage():
    log = two_hours(lambda t: np.full(t.size, 0.01))
    error = cycle_error(flat_cell(), log)
    assert error["rms_V"] == pytest.approx(0.01)
    assert error["mean_abs"] == pytest.approx(np.mean(0.01 / log.voltage_V))
    assert error["peak"] == pytest.approx(0.01 / log.voltage_V.min())
    assert error["mean_abs_window"] == pytest.approx(error["mean_abs"], rel=1e-2)


def test_window_leaves_the_ends_out():
    log = two_hours(lambda t: np.where((t < 1200.0) | (t > 6000.0), 0.05, 0.001))
    error = cycle_error(flat_cell(), log, window_s=(1200.0, 6000.0))
    assert error["peak"] > 0.014
    assert error["peak_window"] == pytest.approx(0.001 / log.voltage_V.min(), rel=0.1)
    assert error["mean_abs_window"] < error["mean_abs"]


def test_window_beyond_the_log_has_no_figure():
    error = cycle_error(flat_cell(), two_hours(np.zeros_like), window_s=(1e5, 2e5))
    assert np.isnan(error["mean_abs_window"])
    assert np.isfinite(error["mean_abs"])


def pulse(start, stop, role, quality="healthy"):
    return Pulse(start, stop, stop, start - 2, stop + 2, 1.0, 10.0, 0.0, role, quality, "")


def test_every_test_ends_with_its_move():
    n = 100
    log = CellLog(
        np.arange(n) * 10.0,
        np.ones(n),
        np.full(n, 3.3),
        charge_Ah=np.arange(n) * 0.01,
    )
    pulses = [
        pulse(5, 8, "pulse"),
        pulse(12, 15, "pulse", "trimmed"),
        pulse(20, 31, "move"),
        pulse(40, 43, "pulse", "distorted"),
        pulse(50, 61, "move"),
        pulse(70, 73, "pulse"),
    ]
    tests = split_tests(log, pulses, 1.0 - log.charge_Ah)
    assert [t["number"] for t in tests] == [1, 2, 3]
    assert [(t["healthy"], t["trimmed"], t["distorted"]) for t in tests] == [
        (1, 1, 0),
        (0, 0, 1),
        (1, 0, 0),
    ]
    # Counter: 0.01 Ah a row, moves end at rows 30 and 60, the log at row 99.
    assert [t["charge_Ah"] for t in tests] == pytest.approx([0.30, 0.30, 0.39])
    assert tests[1]["soc_start"] == pytest.approx(0.7)
    assert sum(t["charge_Ah"] for t in tests) == pytest.approx(log.charge_Ah[-1])


def fit(soc, r1=0.001, r2=0.002, c1=5000.0, c2=20000.0):
    value = PulseParameters(0.003 + 0.001 * soc, r1, c1 * r1, r2, c2 * r2, 3.3)
    error = PulseParameters(*(0.001 * abs(x) for x in value))
    return PulseFit("pso", soc, 1.0, 60.0, value, error, 1e-3, 100)


def test_polynomials_give_back_what_made_the_pulses():
    soc = np.linspace(0.05, 0.95, 10)
    fits = [fit(s, c1=5000.0 + 1000.0 * s**2, c2=2e4 - 3e3 * s**3) for s in soc]
    rows = polynomials(fits)
    assert list(rows) == ["R0", "R1", "R2", "C1", "C2"]
    assert rows["R0"] == pytest.approx((0.003, 0.001, 0.0, 0.0), abs=1e-9)
    assert rows["C1"] == pytest.approx((5000.0, 0.0, 1000.0, 0.0), abs=1e-3)
    assert rows["C2"] == pytest.approx((2e4, 0.0, 0.0, -3e3), abs=1e-3)


def test_a_branch_of_no_resistance_has_no_capacitance():
    fits = [fit(s) for s in np.linspace(0.05, 0.95, 10)]
    ghost = fit(0.5, r1=1e-9)
    ghost = replace(ghost, value=ghost.value._replace(tau1_s=5.0))
    assert ghost.c1_F > 1e9
    rows = polynomials([*fits, ghost])
    assert rows["C1"][0] == pytest.approx(5000.0)
