"""Variable projection: it finds the circuit, nothing finds a better one, and it knows its error."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from cellwise.identify.fitted_pulses import pulse_from_arrays
from cellwise.identify.pulse_fit.circuit import Circuit as Window
from cellwise.identify.pulse_fit.fit_pulse import fit_varpro
from cellwise.identify.pulse_fit.pulse_data import PulseData, row_weights
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit
from closed_form import Circuit, closed_form, closed_pulse, random_circuit, stamps


def values(fit: PulseFit) -> np.ndarray:
    return np.array(fit.value)


# --- recovery ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_recovers_closed_form_exactly(seed):
    rng = np.random.default_rng(seed)
    circuit = random_circuit(rng)
    t = stamps(rng, jitter=0.4, pulse_hz=float(rng.choice([2.0, 10.0, 40.0])))
    current = float(rng.choice([-80.0, -20.0, 20.0, 100.0]))
    fit = fit_varpro(closed_pulse(circuit, t, current))
    np.testing.assert_allclose(values(fit), circuit.values, rtol=1e-3)
    assert fit.at_bound == ()
    assert all(fit.identified)


def test_current_that_changes_inside_the_pulse_is_exact():
    # Superposition: a pulse at 20 A for 60 s, and -8 A more in its last 30 s (a limit was held).
    t = stamps(pulse_hz=10.0)
    late = Circuit(ocv=0.0)
    first, v1 = closed_form(Circuit(), t, 20.0, 60.0, 40.0)
    second, v2 = closed_form(late, t - 30.0, -8.0, 30.0, 40.0)
    n, start = t.size, int(np.argmax(first != 0.0))
    # Each part counts SOC from its own middle; move both to one reference.
    shift = Circuit().slope * (-0.5 * 20.0 * 60.0 + 0.5 * 8.0 * 30.0) / 3600.0 / 40.0
    data = pulse_from_arrays(t, first + second, v1 + v2 + shift, start, start + 600, 40.0)
    fit = fit_varpro(data)
    assert n == len(data)
    np.testing.assert_allclose(values(fit)[:5], Circuit().values[:5], rtol=1e-3)
    assert fit.ocv_slope_V == pytest.approx(0.8, rel=1e-3)


@pytest.mark.parametrize("rest_s", [4.0, 15.0, 60.0])
def test_pulse_after_an_incomplete_rest(rest_s):
    """What a pulse before it has left in the branches comes from the rows before."""
    t = stamps(before_s=300.0, rest_hz=5.0, rest_s=300.0)
    before, v1 = closed_form(Circuit(ocv=0.0, slope=0.0), t + 60.0 + rest_s, -60.0, 60.0, 40.0)
    flow, v2 = closed_form(Circuit(slope=0.0), t, 20.0, 60.0, 40.0)
    start = int(np.argmax(flow != 0.0))
    first = int(np.searchsorted(t, -rest_s))
    args = (t, before + flow, v1 + v2, start, start + 600, 40.0)
    fit = fit_varpro(pulse_from_arrays(*args, first=first))
    np.testing.assert_allclose(values(fit)[:6], Circuit().values[:6], rtol=1e-3)
    blind = fit_varpro(pulse_from_arrays(*args, first=first).alone())
    assert blind.rows == fit.rows
    assert abs(blind.r2_ohm / Circuit().r2 - 1.0) > 0.05


def test_ocv_slope_is_what_saves_tau2():
    """Without the slope a pulse near empty bends tau2: the LFP paper's distorted pulses."""
    data = closed_pulse(Circuit(slope=4.0), stamps(), 80.0)
    flat = PulseData(**{**vars(data), "ocv_change_V": np.zeros(len(data))})
    assert abs(fit_varpro(data).tau2_s / 60.0 - 1.0) < 1e-3
    assert abs(fit_varpro(flat).tau2_s / 60.0 - 1.0) > 0.3


def test_tabulated_ocv_takes_the_place_of_the_slope():
    """OCV with an e-fold in 3 % of SOC, a pulse over 3.3 % of it."""

    def ocv(soc):
        return 3.3 + 0.2 * np.exp((soc - 0.5) / 0.03)

    t = stamps()
    flow, v = closed_form(Circuit(ocv=0.0, slope=0.0), t, 80.0, 60.0, 40.0)
    soc = 0.5 - 80.0 * np.clip(t, 0.0, 60.0) / 3600.0 / 40.0
    start = int(np.argmax(flow != 0.0))
    args = (t, flow, v + ocv(soc), start, start + 600, 40.0)
    fit = fit_varpro(pulse_from_arrays(*args, soc_start=0.5, ocv=ocv))
    np.testing.assert_allclose(values(fit)[:5], Circuit().values[:5], rtol=1e-3)
    assert fit.ocv_V == pytest.approx(ocv(0.5 - 80.0 * 30.0 / 3600.0 / 40.0), abs=1e-4)
    assert fit.error.ocv_slope_V == 0.0
    straight = fit_varpro(pulse_from_arrays(*args, soc_start=0.5))
    assert abs(straight.r1_ohm / Circuit().r1 - 1.0) > 0.1


# --- nothing finds a better fit ------------------------------------------------------------------


def residual(theta, data):
    """Seven-parameter residual by convolution sums, for scipy."""
    r0, r1, log_tau1, r2, log_tau2, ocv, slope = theta
    flow = data.current_A
    model = ocv + slope * (data.pulse_centre - data.charge_fraction) - 1e-3 * r0 * flow
    for r, tau in ((r1, np.exp(log_tau1)), (r2, np.exp(log_tau2))):
        u, out = 0.0, np.empty(flow.size)
        for k, a in enumerate(np.exp(-data.interval_s / tau)):
            u = a * u + (1.0 - a) * flow[k]
            out[k] = u
        model = model - 1e-3 * r * out
    return 1e3 * np.sqrt(row_weights(data)) * (data.voltage_V - model)


def test_scipy_reaches_no_lower_cost():
    rng = np.random.default_rng(11)
    for _ in range(25):
        circuit = random_circuit(rng)
        t = stamps(rng, jitter=0.3, pulse_s=40.0, rest_s=200.0, fast_s=10.0, pulse_hz=4.0)
        noise = 10 ** rng.uniform(-4.0, -2.5)
        data = closed_pulse(
            circuit, t, float(rng.choice([-30.0, 30.0])), 40.0, 40.0,
            noise * rng.standard_normal(t.size),
        )  # fmt: skip
        fit = fit_varpro(data)
        bounds = Window(data).tau_bounds()
        fast, slow = np.log([bounds.fastest_s, bounds.slowest_s])
        low = np.array([0.0, 0.0, fast, 0.0, fast, -9.0, 0.0])
        high = np.array([99.0, 99.0, slow, 99.0, slow, 9.0, 99.0])
        for start in (circuit.values, values(fit)):
            x0 = start * [1e3, 1e3, 1, 1e3, 1, 1, 1]
            x0[[2, 4]] = np.log(x0[[2, 4]])
            x0 = np.clip(x0, low + 1e-9, high - 1e-9)
            found = least_squares(residual, x0, args=(data,), bounds=(low, high), max_nfev=60)
            assert fit.rmse_V**2 * np.sum(row_weights(data)) <= 2e-6 * found.cost * (1.0 + 1e-4)


# --- invariances -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def noisy():
    t = stamps()
    return closed_pulse(Circuit(), t, noise=1e-3 * np.random.default_rng(7).standard_normal(t.size))


def changed(data, **fields):
    return PulseData(**{**vars(data), **fields})


def test_stretching_the_clock_stretches_the_time_constants(noisy):
    slow = changed(noisy, time_s=3.0 * noisy.time_s)
    a, b = values(fit_varpro(noisy)), values(fit_varpro(slow))
    np.testing.assert_allclose(b, a * [1, 1, 3, 1, 3, 1, 1], rtol=2e-3)


@pytest.mark.parametrize("seed", range(5))
def test_the_branches_cannot_be_swapped(seed):
    rng = np.random.default_rng(seed)
    t = stamps(pulse_s=20.0, rest_s=100.0)
    circuit = Circuit(r1=2e-3, tau1=50.0, r2=0.5e-3, tau2=2.0)  # named the wrong way round
    data = closed_pulse(circuit, t, 20.0, 20.0, 40.0, 1e-4 * rng.standard_normal(t.size))
    fit = fit_varpro(data)
    assert fit.tau2_s >= 1.5 * fit.tau1_s * (1.0 - 1e-6)
    assert fit.tau1_s == pytest.approx(2.0, rel=0.1)


# --- standard errors -----------------------------------------------------------------------------


def test_standard_errors_respect_correlated_noise():
    """Noise with a memory of ten rows: errors that took it for white would be three times short."""
    rng = np.random.default_rng(22)
    t = stamps(pulse_s=60.0, rest_s=400.0, rest_hz=10.0)
    fits = []
    for _ in range(120):
        white = rng.standard_normal(t.size)
        noise = np.empty(t.size)
        state = 0.0
        for k in range(t.size):
            state = 0.9 * state + np.sqrt(1 - 0.81) * white[k]
            noise[k] = state
        fits.append(fit_varpro(closed_pulse(Circuit(), t, 40.0, noise=1e-3 * noise)))
    scatter = np.std([values(f) for f in fits], axis=0)
    stated = np.median([np.array(f.error) for f in fits], axis=0)
    slow = [3, 4, 5, 6]  # what many rows tell: R2, tau2, OCV and its slope
    assert np.all(stated[slow] / scatter[slow] > 0.65)
    assert np.all(stated[slow] / scatter[slow] < 1.5)
    assert np.median([f.rows_per_residual for f in fits]) > 8.0


def test_a_short_window_says_that_it_does_not_see_tau2():
    rng = np.random.default_rng(4)
    t = stamps(pulse_s=10.0, rest_s=10.0, before_s=20.0)
    data = closed_pulse(Circuit(), t, 20.0, 10.0, 40.0, 5e-4 * rng.standard_normal(t.size))
    fit = fit_varpro(data)
    assert not fit.identified.tau2_s
    assert fit.identified.r0_ohm
    assert not fit.identified.ocv_slope_V
    long = fit_varpro(
        closed_pulse(Circuit(), stamps(), noise=5e-4 * rng.standard_normal(stamps().size))
    )
    assert all(long.identified)


@pytest.mark.parametrize(("pulse_s", "rest_s"), [(30.0, 40.0), (10.0, 300.0), (60.0, 1200.0)])
def test_two_standard_errors_hold_the_truth(pulse_s, rest_s):
    """Also in the short windows of a standard HPPC, where the minimum lies in a long valley."""
    rng = np.random.default_rng(9)
    t = stamps(pulse_s=pulse_s, rest_s=rest_s)
    held = np.zeros(7)
    trials = 80
    for _ in range(trials):
        noise = 1e-3 * rng.standard_normal(t.size)
        fit = fit_varpro(closed_pulse(Circuit(), t, 40.0, pulse_s, 40.0, noise))
        held += np.abs(values(fit) - Circuit().values) < 2.0 * np.array(fit.error)
    assert np.all(held[:5] > 0.82 * trials)
