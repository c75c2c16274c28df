"""Effects are accepted where a cell has them, on drives held out, and refused where it has not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import SurfaceSoc
from cellwise.fit.rows import FitLog
from cellwise.fit.unknowns import FitSettings
from cellwise.identify.effect_selection import (
    NEEDED,
    JointFit,
    every_second_load,
    fit_with_effects,
    held_out,
)
from cellwise.identify.joint_fit import JointLogs
from cellwise.identify.stated_error import leave_out
from fit_cases import (
    CAPACITY_AH,
    Truth,
    _branch,
    cells_like,
    constant,
    joint_logs,
    log_of,
    pulse_current,
)
from synthetic import drive_current

SLOW = (constant(0.020), constant(90.0))
TRUTH = Truth(pairs=((constant(0.030), constant(6.0)), SLOW))
SHARP_PER_V = 25.0


def with_charge_transfer(log, soc):
    """The voltage of `TRUTH` with the fast branch on asinh instead of on a resistance."""
    r1, tau1 = TRUTH.pairs[0]
    decay = np.exp(-log.interval_s / tau1(soc))
    linear = _branch(decay, r1(soc) * log.current_A)
    law = np.arcsinh(SHARP_PER_V * r1(soc) * log.current_A) / SHARP_PER_V
    return replace(log, voltage_V=log.voltage_V + linear - _branch(decay, law))


def logs_of(change=None):
    rng = np.random.default_rng(11)
    found = []
    drives = [drive_current(2500, 1.0, 9.0, np.random.default_rng(k)) for k in (1, 2, 3)]
    for k, current in enumerate([pulse_current(), *drives]):
        log, soc = log_of(current, TRUTH, noise=5e-4, rng=rng)
        log = log if change is None else change(log, soc)
        found.append(FitLog(log, 1.0, skewed=k > 0, temperature_C=25.0))
    return found


def rated_pulses(change=None):
    """A pulse test of three rates at every tenth of SOC, each pulse with a rest behind it."""
    level = [0.0, 0.5, 0.0, 2.0, 0.0, 6.0, 0.0, 1.0, 0.0]
    current = np.tile(np.repeat(level, [300, 10, 120, 10, 120, 10, 120, 900, 300]), 9)
    log, soc = log_of(current, TRUTH, noise=5e-4, rng=np.random.default_rng(12))
    log = log if change is None else change(log, soc)
    return FitLog(log, 1.0, temperature_C=25.0)


def decided(logs):
    settings = FitSettings(branches=2)
    found = fit_with_effects(joint_logs(logs, cells_like(1.2), settings))
    return {d.name: d for d in found.decided}, found.result


def test_a_charge_transfer_is_found_with_its_size():
    verdicts, result = decided(logs_of(with_charge_transfer))
    assert verdicts["charge_transfer"].accepted
    assert verdicts["charge_transfer"].gain > 0.5
    assert result.asinh_per_V == pytest.approx(SHARP_PER_V, rel=0.2)
    assert not verdicts["surface_soc"].accepted


def test_a_plain_cell_needs_none():
    verdicts, result = decided(logs_of())
    assert [d.name for d in verdicts.values() if d.accepted] == []
    assert result.asinh_per_V == 0.0
    assert all("held out" in d.reason for d in verdicts.values())


def test_without_drives_to_hold_out_only_what_pulses_show_is_tried():
    logs = logs_of()[: NEEDED.fewest]
    assert held_out(logs) == ()
    verdicts, result = decided(logs)
    others = [d for d in verdicts.values() if d.name != "charge_transfer"]
    assert others
    assert all(d.gain is None and "not tried" in d.reason for d in others)
    assert not verdicts["charge_transfer"].accepted
    assert "load of the pulse tests held out" in verdicts["charge_transfer"].reason
    assert result.asinh_per_V == 0.0


@pytest.mark.parametrize("change", [with_charge_transfer, None])
def test_pulses_of_several_rates_show_a_charge_transfer_without_a_drive(change):
    verdicts, result = decided([rated_pulses(change)])
    assert verdicts["charge_transfer"].accepted == (change is not None)
    assert result.asinh_per_V == pytest.approx(SHARP_PER_V if change else 0.0, rel=0.25)


def test_of_two_pulses_at_every_soc_each_is_held_out_somewhere():
    current = np.tile(np.repeat([0.0, 4.0, 0.0, -3.0, 0.0, 1.0], [60, 10, 60, 10, 60, 720]), 8)
    log, _ = log_of(current, TRUTH)
    left = every_second_load(FitLog(log, 1.0), CAPACITY_AH)
    for kind in (4.0, -3.0):
        rows = log.current_A == kind
        assert np.any(left[rows])
        assert not np.all(left[rows])


def test_one_drive_of_each_temperature_with_several_is_held_out():
    logs = logs_of()
    cold = [replace(item, temperature_C=0.0) for item in logs[1:]]
    assert held_out([*logs, *cold]) == (3, 6)
    assert held_out([*logs, cold[0]]) == (3,)


def test_what_is_left_out_in_turn_is_fitted_with_the_effects_of_the_model(monkeypatch):
    joint = joint_logs(logs_of(), cells_like(), FitSettings(branches=2))
    result = joint.fit(joint.logs, joint.settings, quick=3)
    effect = SurfaceSoc(0.05, 300.0)
    below = tuple(replace(item, surface=effect) for item in joint.logs)
    fit = JointFit(joint, result, (), (effect,), below, joint.settings)
    fitted = []

    def fit_quickly(self, logs, *args, **kwargs):
        fitted.extend(logs)
        return result

    monkeypatch.setattr(JointLogs, "fit", fit_quickly)
    assert len(leave_out(fit)) > 1
    assert all(item.surface == effect for item in fitted)
