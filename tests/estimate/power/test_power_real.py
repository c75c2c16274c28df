"""Power at ten seconds of measured pulses that no identification has seen: Panasonic, 25 to -20."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from benchmarks.accuracy.cold import PANASONIC, TAGS
from benchmarks.accuracy.power import panasonic_model, pulse_powers
from benchmarks.measured_data import measured_log

from cellwise.estimate.estimators import make_estimator
from cellwise.estimate.replay import replay
from cellwise.forecast.convergence import expected_convergence

CAPACITY_AH = 2.9973
# The issue asks for 2 and 6 %; measured with the EKF, and why, see docs/tried.md.
SHORT = {
    25.0: "6.4 and 16 %: up to 2C pulses after a rest meet more resistance than drives do",
    10.0: "4.7 and 16 %: as at 25 degC",
    0.0: "7.5 and 23 %: below 1C as at 25 degC, above it too little power",
    -10.0: "7.9 and 20 %: as at 0 degC",
}


@pytest.fixture(scope="module")
def identified(real_data):
    return panasonic_model(real_data)


@pytest.fixture(scope="module")
def predicted(identified, real_data):
    """Pulses left out at every temperature, with what the EKF said just before."""
    model, left_out = identified
    return {
        t: pulse_powers(model, measured_log(real_data, f"{PANASONIC}/hppc_{TAGS[t]}"), pulses)
        for t, pulses in left_out.items()
        if t in SHORT
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "temperature_C",
    [pytest.param(t, marks=pytest.mark.xfail(strict=True, reason=why)) for t, why in SHORT.items()],
)
def test_pulse_power_within_the_bounds_of_the_issue(predicted, temperature_C):
    off = np.abs([p.error for p in predicted[temperature_C]])
    assert np.median(off) <= 0.02
    assert np.quantile(off, 0.95) <= 0.06


@pytest.mark.slow
def test_the_middle_of_the_range_is_predicted(predicted):
    """Of 2C and more above 20 % SOC, where a power limit is asked for: at 25 and 10 degC."""
    pulses = [p for t in (25.0, 10.0) for p in predicted[t] if p.current_A > 5.0 and p.soc > 0.2]
    assert len(pulses) >= 20
    off = np.abs([p.error for p in pulses])
    assert np.median(off) <= 0.06


@pytest.mark.slow
def test_the_lower_bound_is_sustained(predicted):
    pulses = [p for found in predicted.values() for p in found]
    assert np.mean([p.predicted_low_W <= p.power_W for p in pulses]) >= 0.9


@pytest.mark.slow
def test_convergence_from_the_middle_is_predicted(identified, real_data):
    """30 points wrong under load: half converge by then, and where none is predicted few do."""
    model, _ = identified
    ekf = make_estimator("ekf", model)
    early, late = [], []
    for tag, cycle in product(TAGS.values(), ("us06", "nn")):
        log = measured_log(real_data, f"{PANASONIC}/drive_{tag}_{cycle}")
        soc = 1.0 - (log.charge_Ah - log.charge_Ah[0]) / CAPACITY_AH
        for cut, wrong in ((0.65, -0.30), (0.50, 0.30)):
            row = int(np.argmax(soc < cut))
            row += int(np.argmax(log.current_A[row:] > 1.0))
            run = replay(
                model, log.part(row, len(log)), "ekf", soc0=float(soc[row]) + wrong,
                reference_soc0=float(soc[row]), reference_capacity_Ah=CAPACITY_AH,
            )  # fmt: skip
            predicted_s = expected_convergence(model, run, ekf).convergence_s
            took_s = np.inf if run.convergence_s is None else run.convergence_s
            if predicted_s is None:
                late.append(took_s)
            else:
                early.append(took_s / max(predicted_s, 60.0))
    assert len(early) >= 10
    assert late
    assert np.mean(np.array(early) <= 4.0) >= 0.5  # of its order where one is predicted
    assert np.mean(np.isinf(late)) > 2.0 * np.mean(np.isinf(early))  # rarely where none is
