"""The virtual supply: limits to the instant, held voltages, trimmed pulses, defined endings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from cellwise.cell.equations import BEYOND
from cellwise.cell.protocol import (
    ConstantCurrent,
    ConstantVoltage,
    DriveProfile,
    Rest,
    run_protocol,
)
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.notices import texts
from example_cells import EFFECTS, curved_cell, lfp_cell, linear_cell

RICH = curved_cell(effects=EFFECTS[:3], charge_efficiency=0.99)
MIXED = (
    ConstantCurrent(current_A=3.0, voltage_min_V=3.0),
    ConstantVoltage(voltage_V=3.0, until_current_A=0.1),
    Rest(900.0, period_s=10.0),
    ConstantVoltage(voltage_V=4.15, until_current_A=0.15, current_limit_A=1.5),
    ConstantCurrent(current_A=6.0, duration_s=30.0, period_s=0.1),
    DriveProfile(
        time_s=np.arange(0.0, 3000.0, 2.0),
        current_A=np.random.default_rng(1).normal(2.0, 6.0, 1500),
        voltage_min_V=3.1,
        voltage_max_V=4.1,
    ),
    ConstantCurrent(current_A=1.0, charge_Ah=0.05),
    Rest(60.0),
)


@pytest.mark.parametrize("model", [RICH, lfp_cell(), linear_cell()], ids=["rich", "flat", "linear"])
def test_simulating_the_log_again_gives_its_voltages_back(model):
    log = run_protocol(model, MIXED, 0.9)
    np.testing.assert_allclose(simulate(model, log, 0.9).voltage_V, log.voltage_V, atol=1e-11)
    flowed = log.current_A * log.interval_s / 3600
    np.testing.assert_allclose(log.charge_Ah, np.cumsum(flowed), atol=1e-10)
    assert np.unique(log.step).tolist() == list(range(1, 9))
    assert np.all(np.diff(log.time_s) > 0)


class TestConstantCurrent:
    @given(current=st.floats(0.3, 12.0), soc0=st.floats(0.3, 1.0), dt=st.sampled_from([0.1, 1, 60]))
    def test_discharge_ends_exactly_at_the_lower_limit(self, current, soc0, dt):
        log = run_protocol(
            RICH, [ConstantCurrent(current_A=current, voltage_min_V=2.9)], soc0, float(dt)
        )
        assert log.voltage_V[-1] == pytest.approx(2.9, abs=1e-11)
        assert np.all(log.voltage_V[:-1] > 2.9)
        assert log.notices == ()

    def test_instant_of_the_limit_is_the_equations_root(self):
        # Constant branches, linear OCV, from rest: the voltage is a formula of time.
        model, current = linear_cell(), 3.0

        def voltage(t):
            branches = 0.012 * (1 - np.exp(-t / 7.0)) + 0.020 * (1 - np.exp(-t / 90.0))
            ocv = 3.2 + 0.9 * (0.8 - current * t / (3600 * 3.0))
            return ocv - current * (0.030 + branches)

        exact = brentq(lambda t: voltage(t) - 3.5, 1.0, 3600.0, xtol=1e-10)
        for dt in (0.7, 10.0, 300.0):
            log = run_protocol(
                model, [ConstantCurrent(current_A=current, voltage_min_V=3.5)], 0.8, dt
            )
            assert log.time_s[-1] == pytest.approx(exact, abs=1e-7)

    def test_ends_by_time_charge_or_soc_whichever_comes_first(self):
        def end(**limits):
            return run_protocol(RICH, [ConstantCurrent(current_A=-2.0, **limits)], 0.3)

        assert end(duration_s=33.4).time_s[-1] == pytest.approx(33.4, abs=1e-9)
        log = end(charge_Ah=0.1)
        assert log.charge_Ah[-1] == pytest.approx(-0.1, abs=1e-12)
        log = end(soc=0.37)
        assert simulate(RICH, log, 0.3).soc[-1] == pytest.approx(0.37, abs=1e-12)
        assert log.charge_Ah[-1] == pytest.approx(-0.07 * 3.0 / 0.99, abs=1e-12)
        first = end(duration_s=33.4, charge_Ah=0.1, soc=0.9, voltage_max_V=4.3)
        assert first.time_s[-1] == pytest.approx(33.4, abs=1e-9)

    def test_the_models_own_limits_hold_where_the_step_names_none(self):
        model = replace(RICH, voltage_min_V=3.2, voltage_max_V=4.0)
        step = ConstantCurrent(current_A=1.0)
        assert run_protocol(model, [step], 0.5).voltage_V[-1] == pytest.approx(3.2)
        step = ConstantCurrent(current_A=-1.0, duration_s=1e5)
        assert run_protocol(model, [step], 0.5).voltage_V[-1] == pytest.approx(4.0)
        lower = ConstantCurrent(current_A=1.0, voltage_min_V=3.0)
        assert run_protocol(model, [lower], 0.5).voltage_V[-1] == pytest.approx(3.0)

    @pytest.mark.parametrize("period", [0.1, 0.3, 1 / 3, 0.7])
    def test_no_sliver_of_rounding_is_a_row(self, period):
        for count in range(1, 60):
            step = ConstantCurrent(current_A=1.0, duration_s=count * period, period_s=period)
            log = run_protocol(RICH, [step], 0.5)
            assert len(log) == count + 1
            # The same duration by other arithmetic: at most one rounding longer or shorter.
            charge = ConstantCurrent(
                current_A=1.3, charge_Ah=1.3 * (count * period) / 3600, period_s=period
            )
            assert len(run_protocol(RICH, [charge], 0.5)) == count + 1


class TestConstantVoltage:
    @given(
        target=st.floats(3.1, 4.15),
        soc0=st.floats(0.1, 0.95),
        until=st.floats(0.02, 0.3),
        dt=st.sampled_from([0.1, 1.0, 30.0]),
    )
    def test_every_row_is_at_the_voltage_and_the_last_at_the_current(self, target, soc0, until, dt):
        rest = float(np.interp(soc0, RICH.soc, RICH.ocv_V[0]))
        if abs(rest - target) < 0.05:  # may be there already: hysteresis is 20 mV
            return
        step = ConstantVoltage(voltage_V=target, until_current_A=until)
        log = run_protocol(RICH, [step], soc0, dt)
        np.testing.assert_allclose(log.voltage_V[1:], target, atol=1e-10)
        assert abs(log.current_A[-1]) == pytest.approx(until, rel=1e-12)
        assert np.all(np.abs(log.current_A[1:-1]) > until)
        assert np.sign(log.current_A[-1]) == np.sign(rest - target)

    def test_in_a_cell_with_r0_alone_the_current_decays_exponentially(self):
        tiny = np.full(11, 1e-12)
        model = linear_cell(r1_ohm=tiny, r2_ohm=tiny)
        step = ConstantVoltage(voltage_V=3.9, duration_s=900.0)
        log = run_protocol(model, [step], 0.5, dt_s=0.01)
        # R0 I = 3.2 + 0.9 soc - 3.9 and d soc/dt = -I/Q: I decays with Q R0 / 0.9.
        tau = 3600 * 3.0 * 0.030 / 0.9
        start = (3.2 + 0.9 * 0.5 - 3.9) / 0.030
        exact = start * np.exp(-(log.time_s[1:] - 0.005) / tau)
        np.testing.assert_allclose(log.current_A[1:], exact, rtol=1e-4)

    def test_current_limit_makes_it_cc_then_cv(self):
        step = ConstantVoltage(voltage_V=4.1, until_current_A=0.1, current_limit_A=1.5)
        log = run_protocol(RICH, [step], 0.2)
        apart = run_protocol(
            RICH,
            [
                ConstantCurrent(current_A=-1.5, voltage_max_V=4.1),
                ConstantVoltage(voltage_V=4.1, until_current_A=0.1, current_limit_A=1.5),
            ],
            0.2,
        )
        assert np.min(log.current_A) == -1.5
        assert log.charge_Ah[-1] == pytest.approx(apart.charge_Ah[-1], rel=1e-6)
        assert log.time_s[-1] == pytest.approx(apart.time_s[-1], rel=1e-6)
        assert np.max(log.voltage_V) <= 4.1 + 1e-10


class TestDriveProfile:
    time = np.arange(1.0, 2001.0)
    current = np.random.default_rng(2).normal(3.0, 8.0, 2000)

    def test_limits_trim_the_pulses_and_nothing_else(self):
        profile = DriveProfile(
            time_s=self.time, current_A=self.current, voltage_min_V=3.3, voltage_max_V=4.0
        )
        log = run_protocol(RICH, [profile], 0.7)
        asked, got = self.current, log.current_A[1:]
        trimmed = got != asked
        assert 50 < np.count_nonzero(trimmed) < 1900
        down, up = trimmed & (asked > 0), trimmed & (asked < 0)
        held = np.abs(got) > 0
        np.testing.assert_allclose(log.voltage_V[1:][down & held], 3.3, atol=1e-10)
        np.testing.assert_allclose(log.voltage_V[1:][up & held], 4.0, atol=1e-10)
        assert np.all(np.abs(got) <= np.abs(asked))
        assert np.all(got * asked >= 0)
        assert np.all(log.voltage_V[1:][got > 0] >= 3.3 - 1e-10)
        assert np.all(log.voltage_V[1:][got < 0] <= 4.0 + 1e-10)

    def test_an_empty_cell_ends_it_with_a_notice(self):
        profile = DriveProfile(time_s=60 * self.time, current_A=np.full(2000, 3.0))
        log = run_protocol(linear_cell(), [profile, Rest(5.0)], 0.5)
        assert "step 1" in log.notices[0].text
        soc = simulate(linear_cell(), log, 0.5).soc[-1]
        assert soc == pytest.approx(-BEYOND, abs=0.02)
        assert soc <= -BEYOND


class TestEndings:
    @pytest.mark.parametrize(
        "step",
        [
            ConstantCurrent(current_A=1.0, voltage_min_V=-5.0),
            ConstantCurrent(current_A=-1.0, voltage_max_V=50.0),
            ConstantCurrent(current_A=1.0, voltage_max_V=4.2),  # the wrong direction's limit
            ConstantCurrent(current_A=1.0, charge_Ah=1e6),
            ConstantVoltage(voltage_V=50.0, until_current_A=0.1),
            ConstantVoltage(voltage_V=50.0, until_current_A=0.1, current_limit_A=2.0),
        ],
        ids=lambda s: repr(s)[:60],
    )
    def test_a_limit_that_is_never_reached_ends_off_the_tables_and_is_told(self, step):
        log = run_protocol(linear_cell(), [step, Rest(1.0)], 0.5, dt_s=10.0)
        assert len(log.notices) == 1
        assert "step 1" in log.notices[0].text
        assert "no limit reached" in log.notices[0].text
        soc = simulate(linear_cell(), log, 0.5).soc
        assert abs(soc[-1] - 0.5) >= 0.5 + BEYOND - 1e-9
        assert log.step[-1] == 2  # the protocol goes on

    @pytest.mark.parametrize(
        "step",
        [
            ConstantCurrent(current_A=5.0, voltage_min_V=3.9),
            ConstantCurrent(current_A=1.0, soc=0.7),
            ConstantCurrent(current_A=-1.0, soc=0.3),
            ConstantVoltage(voltage_V=3.65, until_current_A=0.5),  # 3.65 V is the OCV at 0.5
        ],
    )
    def test_a_step_at_its_limit_from_the_start_has_no_row(self, step):
        log = run_protocol(linear_cell(), [step, Rest(3.0)], 0.5)
        assert len(log) == 4
        assert np.all(log.step[1:] == 2)
        assert texts(log.notices) == ["step 1: at its limit from the start, so it has no row"]
        with pytest.raises(InputError, match="none lasts"):
            run_protocol(linear_cell(), [step], 0.5)

    def test_nothing_to_run_is_refused(self):
        with pytest.raises(InputError, match="0 step"):
            run_protocol(linear_cell(), [], 0.5)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"soc0": 1.5}, "from 0 to 1"),
            ({"dt_s": 0.0}, "dt_s"),
            ({"dt_s": np.nan}, "dt_s"),
            ({"temperature_C": np.inf}, "temperature"),
        ],
    )
    def test_arguments_are_checked(self, arguments, message):
        with pytest.raises(InputError, match=message):
            run_protocol(linear_cell(), [Rest(5.0)], **{"soc0": 0.5, **arguments})


def test_temperature_reaches_the_cell_and_the_log():
    cold = run_protocol(RICH, MIXED, 0.9, temperature_C=-10.0)
    assert np.all(cold.temperature_C == -10.0)
    warm = run_protocol(RICH, MIXED, 0.9)
    first = [log.charge_Ah[log.step == 1][-1] for log in (cold, warm)]
    assert first[0] < first[1]  # more resistance: the limit comes earlier
    assert simulate(RICH, cold, 0.9).metrics.max_error_V < 1e-10


@pytest.mark.parametrize(
    "make",
    [
        lambda: Rest(np.nan),
        lambda: ConstantCurrent(current_A=0.0),
        lambda: ConstantCurrent(current_A=1.0, charge_Ah=-0.1),
        lambda: ConstantCurrent(current_A=1.0, voltage_min_V=np.inf),
        lambda: ConstantVoltage(voltage_V=4.2),
        lambda: ConstantVoltage(voltage_V=4.2, until_current_A=2.0, current_limit_A=1.0),
        lambda: DriveProfile(time_s=[], current_A=[]),
        lambda: DriveProfile(time_s=[1.0, 1.0], current_A=[1.0, 2.0]),
        lambda: DriveProfile(time_s=[1.0, 2.0], current_A=[1.0, np.nan]),
    ],
)
def test_refused_when_written_not_when_run(make):
    with pytest.raises(InputError):
        make()
