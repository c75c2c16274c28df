"""OCV functions: strictly rising, exact slopes, robust fits, accuracy between the points."""

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.capacity.half_cycles import find_half_cycles, join_logs
from cellwise.identify.ocv.curve import fit_monotone_spline
from cellwise.logs import read_log


def lfp(s):
    """Two flat steps and two steep ends, 2.6 to 3.5 V."""
    return (
        3.29
        + 0.02 * np.tanh((s - 0.68) / 0.03)
        + 0.03 * np.tanh((s - 0.3) / 0.05)
        - 0.6 * np.exp(-s / 0.025)
        + 0.2 * np.exp((s - 1.0) / 0.015)
    )


def narrow(s):
    """A cell used between 2.9 and 4.1 V."""
    return 2.9 + 0.45 * (1 - np.exp(-s / 0.04)) + 0.75 * s


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


CURVES = {"lfp": lfp, "narrow": narrow}


@pytest.mark.parametrize("curve", CURVES)
def test_it_rises_strictly_everywhere(curve):
    rng = np.random.default_rng(3)
    s = np.sort(rng.uniform(0.02, 0.99, 40))
    fit = fit_monotone_spline(s, CURVES[curve](s) + rng.normal(0.0, 4e-3, s.size))
    assert np.all(np.diff(fit.evaluate(np.linspace(-0.1, 1.1, 2401))) > 0.0)


@pytest.mark.parametrize("curve", CURVES)
def test_slope_is_the_derivative(curve):
    s = np.linspace(0.0, 1.0, 60)
    f = fit_monotone_spline(s, CURVES[curve](s))
    at = np.arange(-0.0953, 1.1, 0.005)
    h = 1e-6
    numeric = (f.evaluate(at + h) - f.evaluate(at - h)) / (2 * h)
    assert f.slope(at) == pytest.approx(numeric, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("curve", CURVES)
def test_spline_averages_noise_out(curve):
    rng = np.random.default_rng(5)
    s = np.linspace(0.0, 1.0, 2000)
    noise = rng.normal(0.0, 5e-3, s.size)
    f = fit_monotone_spline(s, CURVES[curve](s) + noise)
    middle = (s > 0.05) & (s < 0.95)
    assert rms((f.evaluate(s) - CURVES[curve](s))[middle]) < 0.4 * 5e-3


@pytest.mark.parametrize(
    ("soc", "voltage", "said"),
    [
        ([0.1, 0.5, 0.9], [3.1, 3.5, 3.9], "3 usable"),
        ([0.1, 0.5, 0.7, 0.9], [3.1, np.nan, 3.7, 3.9], "3 usable"),
        ([0.5] * 6, [3.5] * 6, "does not rise"),
        ([0.1, 0.3, 0.6, 0.9], [3.9, 3.7, 3.4, 3.1], "does not rise"),
        ([10.0, 30.0, 60.0, 90.0], [3.1, 3.3, 3.6, 3.9], "percent"),
    ],
)
def test_bad_points_are_refused(soc, voltage, said):
    with pytest.raises(InputError, match=said):
        fit_monotone_spline(np.array(soc), np.array(voltage))


def discharge_curve(path):
    trace = join_logs(read_log(path))
    half = next(h for h in find_half_cycles(trace) if h.charge_Ah > 0.0)
    rows = half.at_main_current(trace)
    q = trace.charge_Ah[rows]
    return 1.0 - (q - q[0]) / (q[-1] - q[0]), trace.voltage_V[rows]


@pytest.mark.parametrize(
    ("path", "limit_V"),
    [
        ("panasonic_18650pf/ocv_c20_p25", 4e-3),
        ("plett_a123/ocv_p25_s1", 7e-3),
        ("plett_a123/ocv_n25_s1", 6e-3),
        ("lg_18650hg2/ocv_c20_p25_549", 4e-3),
    ],
)
def test_spline_through_every_twentieth_predicts_the_rest_of_a_real_curve(real_data, path, limit_V):
    s, v = discharge_curve(real_data / f"{path}.csv.gz")
    order = np.argsort(s)
    some = np.interp(np.arange(0.05, 1.0, 0.05), s[order], v[order])
    between = (s > 0.05) & (s < 0.95)
    f = fit_monotone_spline(np.arange(0.05, 1.0, 0.05), some)
    assert rms(f.evaluate(s[between]) - v[between]) < limit_V
