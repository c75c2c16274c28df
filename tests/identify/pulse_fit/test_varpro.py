"""Variable projection: it finds the circuit, nothing finds a better one, and it knows its error."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify.pulse_fit.fit_pulse import fit_varpro
from cellwise.identify.pulse_fit.pulse_data import pulse_data
from closed_form import Circuit, closed_form, closed_pulse, random_circuit, stamps


def values(fit) -> np.ndarray:
    return np.array(fit.value)


@pytest.mark.parametrize("seed", range(6))
def test_recovers_closed_form_exactly(seed):
    rng = np.random.default_rng(seed)
    circuit = random_circuit(rng)
    t = stamps(rng, jitter=0.4, pulse_hz=float(rng.choice([2.0, 10.0, 40.0])))
    current = float(rng.choice([-80.0, -20.0, 20.0, 100.0]))
    fit = fit_varpro(closed_pulse(circuit, t, current))
    middle_V = circuit.slope * (0.5 - 0.5 * current * 60.0 / 3600.0 / 40.0)
    np.testing.assert_allclose(values(fit)[:5], circuit.values[:5], rtol=1e-3)
    assert fit.ocv_V == pytest.approx(circuit.ocv, abs=1e-4 + abs(middle_V) * 1e-6)
    assert fit.at_bound == ()
    assert all(fit.identified)


def test_current_that_changes_inside_the_pulse_is_exact():
    # Superposition: a pulse at 20 A for 60 s, and -8 A more in its last 30 s (a limit was held).
    t = stamps(pulse_hz=10.0)
    flat = Circuit(slope=0.0)
    first, v1 = closed_form(flat, t, 20.0, 60.0, 40.0)
    second, v2 = closed_form(replace(flat, ocv=0.0), t - 30.0, -8.0, 30.0, 40.0)
    start = int(np.argmax(first != 0.0))
    soc = np.full(t.size, 0.5)
    fit = fit_varpro(pulse_data(t, first + second, v1 + v2, soc, start, start + 600))
    np.testing.assert_allclose(values(fit), flat.values, rtol=1e-3)


@pytest.mark.parametrize("rest_s", [4.0, 15.0, 60.0])
def test_pulse_after_an_incomplete_rest(rest_s):
    """What a pulse before it has left in the branches comes from the rows before."""
    t = stamps(before_s=300.0, rest_hz=5.0, rest_s=300.0)
    before, v1 = closed_form(Circuit(ocv=0.0, slope=0.0), t + 60.0 + rest_s, -60.0, 60.0, 40.0)
    flow, v2 = closed_form(Circuit(slope=0.0), t, 20.0, 60.0, 40.0)
    start = int(np.argmax(flow != 0.0))
    first = int(np.searchsorted(t, -rest_s))
    soc = np.full(t.size, 0.5)
    fit = fit_varpro(pulse_data(t, before + flow, v1 + v2, soc, start, start + 600, first=first))
    np.testing.assert_allclose(values(fit), Circuit().values, rtol=1e-3)
    rows = slice(first, None)
    blind = fit_varpro(
        pulse_data(t[rows], (before + flow)[rows], (v1 + v2)[rows], soc[rows], start - first,
                   start + 600 - first)
    )  # fmt: skip
    assert blind.rows == fit.rows
    assert abs(blind.r2_ohm / Circuit().r2 - 1.0) > 0.05


def test_tabulated_ocv_is_what_saves_tau2():
    """OCV with an e-fold in 3 % of SOC, a pulse over 3.3 % of it: the paper's distorted pulses."""

    def ocv(soc):
        return 3.3 + 0.2 * np.exp((soc - 0.5) / 0.03)

    t = stamps()
    flow, v = closed_form(Circuit(ocv=0.0, slope=0.0), t, 80.0, 60.0, 40.0)
    soc = 0.5 - 80.0 * np.clip(t, 0.0, 60.0) / 3600.0 / 40.0
    start = int(np.argmax(flow != 0.0))
    args = (t, flow, v + ocv(soc), soc, start, start + 600)
    fit = fit_varpro(pulse_data(*args, ocv=ocv))
    np.testing.assert_allclose(values(fit)[:5], Circuit().values[:5], rtol=1e-3)
    assert fit.ocv_V == pytest.approx(ocv(0.5 - 80.0 * 30.0 / 3600.0 / 40.0), abs=1e-4)
    assert abs(fit_varpro(pulse_data(*args)).tau2_s / Circuit().tau2 - 1.0) > 0.3


@pytest.mark.parametrize("seed", range(5))
def test_the_branches_cannot_be_swapped(seed):
    rng = np.random.default_rng(seed)
    t = stamps(pulse_s=20.0, rest_s=100.0)
    circuit = Circuit(r1=2e-3, tau1=50.0, r2=0.5e-3, tau2=2.0)  # named the wrong way round
    data = closed_pulse(circuit, t, 20.0, 20.0, 40.0, 1e-4 * rng.standard_normal(t.size))
    fit = fit_varpro(data)
    assert fit.tau2_s >= 1.5 * fit.tau1_s * (1.0 - 1e-6)
    assert fit.tau1_s == pytest.approx(2.0, rel=0.1)


def test_a_short_window_says_that_it_does_not_see_tau2():
    rng = np.random.default_rng(4)
    t = stamps(pulse_s=10.0, rest_s=10.0, before_s=20.0)
    data = closed_pulse(Circuit(), t, 20.0, 10.0, 40.0, 5e-4 * rng.standard_normal(t.size))
    fit = fit_varpro(data)
    assert not fit.identified.tau2_s
    assert fit.identified.r0_ohm
    long = fit_varpro(
        closed_pulse(Circuit(), stamps(), noise=5e-4 * rng.standard_normal(stamps().size))
    )
    assert all(long.identified)


@pytest.mark.parametrize(("pulse_s", "rest_s"), [(30.0, 40.0), (10.0, 300.0), (60.0, 1200.0)])
@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_two_standard_errors_hold_the_truth(pulse_s, rest_s, memory):
    """Also in the short windows of a standard HPPC, and with noise that remembers ten rows."""
    rng = np.random.default_rng(9)
    t = stamps(pulse_s=pulse_s, rest_s=rest_s, rest_hz=10.0 if memory else 1.0)
    held = np.zeros(6)
    trials = 40
    for _ in range(trials):
        noise = np.sqrt(1.0 - memory**2) * rng.standard_normal(t.size)
        for k in range(1, t.size if memory else 1):
            noise[k] += memory * noise[k - 1]
        fit = fit_varpro(closed_pulse(Circuit(), t, 40.0, pulse_s, 40.0, 1e-3 * noise))
        held += np.abs(values(fit) - Circuit().values) < 2.0 * np.array(fit.error)
    assert np.all(held[:5] > 0.8 * trials)
