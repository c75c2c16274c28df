"""The adaptive estimator names what was hidden in the sensors and the cell, or says why not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.protocol import ConstantCurrent, DriveProfile, Rest, run_protocol
from cellwise.errors import InputError
from cellwise.estimate.adaptive import ESTIMABLE, Adaptive, AdaptiveSettings, WhyHeld, reason
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.noise import WANDERS, Noise
from cellwise.estimate.status import Status
from example_cells import curved_cell, lfp_cell

CAPACITY = 3.0
ERROR = ModelError.of_white_and_slow(
    white_V=0.001, slow_V=(0.003,), correlation_s=300.0, resistance_share=0.02
)
MODEL = curved_cell(error=ERROR)


def trusting(model):
    """The EKF that takes the current for right."""
    return Ekf(model, replace(Noise.of_model(model), offset_share=0.0))


def drive(cell=MODEL, hours=2.2, soc0=0.95, mean=1.1, rest_s=900.0):
    """Loads that change from minute to minute, then a rest; the cell's own voltage."""
    rng = np.random.default_rng(3)
    rows = int(3600 * hours)
    slow = np.repeat(rng.uniform(0.2, 2.0, rows // 300 + 1), 300)[:rows]
    fast = np.repeat(rng.normal(0.0, 2.0, rows // 5 + 1), 5)[:rows]
    profile = DriveProfile(time_s=np.arange(1.0, rows + 1.0), current_A=mean * slow + fast)
    return run_protocol(cell, [profile, Rest(rest_s)], soc0)


def truth(log, soc0=0.95, capacity=CAPACITY):
    return soc0 - (log.charge_Ah - log.charge_Ah[0]) / capacity


def error_rms(trace, soc):
    half = len(trace) // 2
    return float(np.sqrt(np.mean((trace.soc - soc)[half:] ** 2)))


LOG = drive()


class TestNaming:
    @pytest.mark.parametrize("offset", [0.1, -0.06])
    def test_an_offset_of_the_current_sensor(self, offset):
        log = replace(LOG, current_A=LOG.current_A + offset)
        trace = Adaptive(MODEL).run(log, 0.7)
        told = trace.parameters()
        assert told.offset_A.value == pytest.approx(offset, rel=0.1)
        assert abs(told.offset_A.value - offset) < 3 * told.offset_A.std
        assert told.offset_A.shown
        assert not told.capacity_Ah.shown
        assert told.soh_capacity == pytest.approx(1.0, abs=0.01)
        assert error_rms(trace, truth(log)) < 0.012
        assert error_rms(trace, truth(log)) < 0.5 * error_rms(
            trusting(MODEL).run(log, 0.7), truth(log)
        )

    def test_an_offset_without_any_rest(self):
        log = drive(hours=2.1, rest_s=1.0)
        biased = replace(log, current_A=log.current_A + 0.15)
        told = Adaptive(MODEL).run(biased, 0.95, 0.02).parameters()
        assert told.offset_A.value == pytest.approx(0.15, rel=0.35)

    @pytest.mark.parametrize("factor", [0.9, 1.1])
    def test_a_capacity_that_is_another_one(self, factor):
        trace = Adaptive(replace(MODEL, capacity_Ah=factor * CAPACITY)).run(LOG, 0.7)
        told = trace.parameters()
        assert told.capacity_Ah.value == pytest.approx(CAPACITY, rel=0.03)
        assert told.capacity_Ah.shown
        assert not told.offset_A.shown
        assert told.soh_capacity == pytest.approx(1.0 / factor, rel=0.03)
        assert error_rms(trace, truth(LOG)) < 0.015

    def test_a_gain_where_the_capacity_is_sure(self):
        log = replace(LOG, current_A=1.05 * LOG.current_A)
        settings = AdaptiveSettings(learn=("current_offset", "resistance", "current_gain"))
        told = Adaptive(MODEL, settings=settings).run(log, 0.7).parameters()
        assert told.gain.value == pytest.approx(1.05, abs=0.015)
        assert told.capacity_Ah.value == CAPACITY
        assert told.capacity_Ah.std == 0.0
        assert told.capacity_Ah.held is not None

    @pytest.mark.parametrize("growth", [0.75, 1.3])
    def test_resistances_that_have_changed(self, growth):
        told = Adaptive(MODEL).run(drive(MODEL.with_resistances(growth)), 0.7).parameters()
        assert told.resistance_scale.value == pytest.approx(growth, rel=0.06)
        assert told.soh_resistance == told.resistance_scale.value

    @pytest.mark.xfail(strict=True, reason="reported, not taken into the SOC: 1.35 %")
    @pytest.mark.parametrize("growth", [0.75, 1.3])
    def test_soc_where_resistances_have_changed(self, growth):
        log = drive(MODEL.with_resistances(growth))
        assert error_rms(Adaptive(MODEL).run(log, 0.7), truth(log)) < 0.01

    def test_an_aged_cell_capacity_and_resistance_at_once(self):
        aged = replace(MODEL.with_resistances(1.3), capacity_Ah=0.87 * CAPACITY)
        log = drive(aged, hours=1.9)
        trace = Adaptive(MODEL).run(log, 0.95, 0.02)
        told = trace.parameters()
        assert told.soh_capacity == pytest.approx(0.87, abs=0.03)
        assert told.soh_resistance == pytest.approx(1.3, rel=0.08)
        assert error_rms(trace, truth(log, capacity=0.87 * CAPACITY)) < 0.02

    def test_without_a_fault_none_is_named(self):
        trace, plain = Adaptive(MODEL).run(LOG, 0.7), Ekf(MODEL).run(LOG, 0.7)
        told = trace.parameters()
        assert not told.offset_A.shown
        assert not told.capacity_Ah.shown
        assert abs(told.offset_A.value) < 0.01
        assert told.soh_capacity == pytest.approx(1.0, abs=0.01)
        assert told.resistance_scale.value == pytest.approx(1.0, abs=0.03)
        assert error_rms(trace, truth(LOG)) < error_rms(plain, truth(LOG)) + 0.001

    def test_deviations_cover_the_truth(self):
        log = replace(LOG, current_A=LOG.current_A + 0.1)
        trace = Adaptive(MODEL).run(log, 0.7)
        assert np.mean(np.abs(trace.soc - truth(log)) < 2 * trace.soc_std) > 0.9


@pytest.mark.parametrize(
    ("hours", "mean", "soc0"), [(2.2, 1.1, 0.95), (12.0, 0.2, 0.95), (2.3, 1.1, 1.0)]
)
def test_where_nothing_may_be_wrong_it_is_the_ekf(hours, mean, soc0):
    """Beside a free capacity, which leaves the SOC unsure by points; from full, over hours."""
    model = curved_cell(error=ModelError.of_white_and_slow(0.001, (0.012,), 300.0, 0.02))
    log = drive(hours=hours, mean=mean, soc0=soc0)
    wave = 0.008 * np.cos(9.0 * truth(log, soc0))  # an error of the OCV
    log = replace(log, voltage_V=log.voltage_V + wave)
    learn = ("current_offset", "capacity")
    certain = AdaptiveSettings(learn=learn, fault_probability=1e-9)
    ours = Adaptive(model, settings=certain).run(log, soc0, 0.005)
    wander = WANDERS * Noise.of_model(model).soc_per_sqrt_h  # the rest is an offset's
    alone = replace(Noise.of_model(model), offset_share=0.0, soc_per_sqrt_h=wander)
    other = Ekf(model, alone).run(log, soc0, 0.005)
    assert np.max(np.abs(ours.soc - other.soc)) < 0.001


class TestHeld:
    def test_a_rest_shows_the_offset_and_nothing_else(self):
        log = run_protocol(MODEL, [Rest(600.0)], 0.6)
        trace = Adaptive(MODEL).run(log, 0.6, 0.05)
        told = trace.parameters()
        assert told.offset_A.std < 0.2 * AdaptiveSettings().offset_C * CAPACITY
        assert told.offset_A.probability < 0.05
        assert told.resistance_scale.value == 1.0
        assert "hardly moves" in told.resistance_scale.held
        assert not told.capacity_Ah.shown

    def test_a_small_constant_load_is_no_offset(self):
        """Above C/100 a current that stands still may as well be a load."""
        load = ConstantCurrent(current_A=0.033 * CAPACITY, duration_s=7200.0)
        log = run_protocol(MODEL, [load], 0.6)
        told = Adaptive(MODEL).run(log, 0.6, 0.02).parameters()
        assert abs(told.offset_A.value) < 0.2 * 0.033 * CAPACITY
        assert not told.offset_A.shown

    def test_a_steady_load_moves_no_resistance(self):
        log = run_protocol(
            MODEL, [Rest(60.0), ConstantCurrent(current_A=1.5, duration_s=3000.0)], 0.9
        )
        wrong = replace(MODEL, r0_ohm=1.2 * MODEL.r0_ohm)
        trace = Adaptive(wrong).run(log, 0.9, 0.02)
        late = trace.held[1, len(trace) // 2 :]
        assert np.all(late & WhyHeld.NO_EXCITATION)
        assert np.ptp(trace.resistance_scale[len(trace) // 2 :]) == 0.0

    def test_nothing_is_blamed_while_soc_is_unsure(self):
        flat = lfp_cell()
        log = drive(flat, hours=0.3, soc0=0.6)
        trace = Adaptive(flat).run(log, 0.35, 0.3)
        assert np.all(trace.held[2, 1:200] & WhyHeld.SOC_UNSURE)
        assert trace.parameters(200).capacity_Ah.held == reason(WhyHeld.SOC_UNSURE)

    def test_on_a_plateau_the_capacity_stays_the_models(self):
        flat = lfp_cell()
        log = drive(flat, hours=0.5, soc0=0.75)
        trace = Adaptive(replace(flat, capacity_Ah=0.9 * 2.3)).run(log, 0.75, 0.05)
        told = trace.parameters()
        assert told.soh_capacity == pytest.approx(1.0, abs=0.03)
        assert told.capacity_Ah.std > 0.01 * 2.3
        assert not told.capacity_Ah.shown

    @pytest.mark.parametrize("name", ["voltage_V", "current_A"])
    def test_a_channel_that_is_away(self, name):
        values = getattr(LOG, name).copy()
        values[3000:3600] = np.nan
        trace = Adaptive(MODEL).run(replace(LOG, **{name: values}), 0.95, 0.02)
        bit = WhyHeld.NO_VOLTAGE if name == "voltage_V" else WhyHeld.NO_CURRENT
        assert np.all(trace.held[:, 3010:3590] & bit)
        for parameter in (trace.gain, trace.resistance_scale):
            assert np.ptp(parameter[3010:3590]) == 0.0
        assert abs(trace.soc[-1] - truth(LOG)[-1]) < 0.02

    def test_what_is_not_chosen_does_not_move(self):
        log = replace(LOG, current_A=1.1 * LOG.current_A + 0.1)
        trace = Adaptive(MODEL, settings=AdaptiveSettings(learn=("resistance",))).run(log, 0.9)
        assert np.all(trace.offset_A == 0.0)
        assert np.all(trace.capacity_Ah == CAPACITY)
        told = trace.parameters()
        assert told.offset_A.held == told.capacity_Ah.held == reason(WhyHeld.NOT_CHOSEN)

    def test_capacity_and_gain_cannot_both_be_learnt(self):
        with pytest.raises(InputError, match="no data can separate them"):
            AdaptiveSettings(learn=ESTIMABLE)
        with pytest.raises(InputError, match="current_offset"):
            AdaptiveSettings(learn=("bias",))

    @pytest.mark.parametrize("wrong", [{"offset_C": -1.0}, {"fault_probability": 1.0},
                                       {"fast_s": 0.0}, {"charge": np.nan}])  # fmt: skip
    def test_impossible_settings_are_refused(self, wrong):
        with pytest.raises(InputError):
            AdaptiveSettings(**wrong)


class TestSteps:
    def test_a_state_that_is_not_finite_begins_anew(self):
        adaptive = Adaptive(MODEL)
        state = adaptive.init(0.5)
        lost = state.cell._replace(soc=np.nan)
        state = state._replace(filter=state.filter._replace(cell=lost))
        state, info = adaptive.step(state, 0.0, 3.7, dt_s=1.0)
        assert info.status & Status.STATE_RESET
        assert np.all(np.isfinite(state.cell))
        assert 0.0 <= info.soc <= 1.0
