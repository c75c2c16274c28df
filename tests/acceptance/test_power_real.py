"""Power at ten seconds of measured pulses that no identification has seen: Panasonic, 25 to -20."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from benchmarks.accuracy.panasonic import CELL, TAGS
from benchmarks.accuracy.power import panasonic_model, pulse_powers
from benchmarks.measured_data import measured_log

from cellwise.estimate.estimators import make_estimator
from cellwise.estimate.replay import expected_convergence_s, replay

CAPACITY_AH = 2.9973
# The issue asks for 3 % in the median; measured with the EKF.
SHORT = {
    -10.0: "5.5 %: C/2 gives 7 % less than predicted, 2C 7 % more, at SOC levels of the fit, too",
    -20.0: "5.2 %: as at -10 degC",
}


@pytest.fixture(scope="module")
def identified(real_data):
    return panasonic_model(real_data)


@pytest.fixture(scope="module")
def predicted(identified, real_data):
    """Pulses left out at every temperature, with what the EKF said just before."""
    model, left_out = identified
    return {
        t: pulse_powers(model, measured_log(real_data, f"{CELL}/hppc_{TAGS[t]}"), pulses)
        for t, pulses in left_out.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "temperature_C",
    [
        pytest.param(
            t, marks=[pytest.mark.xfail(strict=True, reason=SHORT[t])] if t in SHORT else []
        )
        for t in TAGS
    ],
)
def test_pulse_power_within_the_bounds_of_the_issue(predicted, temperature_C):
    off = np.abs([p.error for p in predicted[temperature_C]])
    assert np.median(off) <= 0.03


@pytest.fixture(scope="module")
def sustained(predicted):
    """Share of the pulses that gave the lower bound, which is stated with 95 %."""
    pulses = [p for found in predicted.values() for p in found]
    return np.mean([p.predicted_low_W <= p.power_W for p in pulses])


@pytest.mark.slow
def test_the_lower_bound_is_sustained(sustained):
    assert sustained >= 0.90


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="98.2 % of the pulses: a little too wide")
def test_the_lower_bound_is_not_sustained_by_every_pulse(sustained):
    assert sustained <= 0.98


@pytest.mark.slow
def test_convergence_from_the_middle_is_predicted(identified, real_data):
    """30 points wrong under load: half converge by then, and where none is predicted few do."""
    model, _ = identified
    ekf = make_estimator("ekf", model)
    early, late = [], []
    for tag, cycle in product(TAGS.values(), ("us06", "nn")):
        log = measured_log(real_data, f"{CELL}/drive_{tag}_{cycle}")
        soc = 1.0 - (log.charge_Ah - log.charge_Ah[0]) / CAPACITY_AH
        for cut, wrong in ((0.65, -0.30), (0.50, 0.30)):
            row = int(np.argmax(soc < cut))
            row += int(np.argmax(log.current_A[row:] > 1.0))
            run = replay(
                model, log.part(row, len(log)), "ekf", soc0=float(soc[row]) + wrong,
                reference_soc0=float(soc[row]), reference_capacity_Ah=CAPACITY_AH,
            )  # fmt: skip
            predicted_s = expected_convergence_s(model, run, ekf)
            took_s = np.inf if run.convergence_s is None else run.convergence_s
            if predicted_s is None:
                late.append(took_s)
            else:
                early.append(took_s / max(predicted_s, 60.0))
    assert len(early) >= 10
    assert late
    assert np.mean(np.array(early) <= 4.0) >= 0.5  # of its order where one is predicted
    assert np.mean(np.isinf(late)) > 2.0 * np.mean(np.isinf(early))  # rarely where none is
