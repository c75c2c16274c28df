"""Variable projection: it finds the circuit, nothing finds a better one, and it knows its error."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from cellwise.errors import InputError
from cellwise.identify.pulse_fit.pulse_data import PulseData, row_weights
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit, PulseTrend, TauBounds
from cellwise.identify.pulse_fit.pulse_problem import build_problem, window_tau_bounds
from cellwise.identify.pulse_fit.pulse_window import pulse_from_arrays
from cellwise.identify.pulse_fit.varpro import VarproOptions, fit_varpro
from cellwise.identify.pulse_fit.varpro_algebra_kernels import solve_linear
from cellwise.identify.pulse_fit.varpro_kernels import (
    COLUMN_OF,
    COLUMNS,
    LINEAR,
    TILE,
    accumulate,
)
from closed_form import Circuit, closed_form, closed_pulse, random_circuit, stamps

PLAIN = VarproOptions(bends=0, initial=False, weighting="rows")


def values(fit: PulseFit) -> np.ndarray:
    return np.array(fit.value)


def cost(fit: PulseFit, data: PulseData, weighting: str = "rows") -> float:
    return fit.rmse_V**2 * float(np.sum(row_weights(data, weighting)))


# --- recovery ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_recovers_closed_form_exactly(seed):
    rng = np.random.default_rng(seed)
    circuit = random_circuit(rng)
    t = stamps(rng, jitter=0.4, pulse_hz=float(rng.choice([2.0, 10.0, 40.0])))
    current = float(rng.choice([-80.0, -20.0, 20.0, 100.0]))
    fit = fit_varpro(closed_pulse(circuit, t, current))
    np.testing.assert_allclose(values(fit), circuit.values, rtol=2e-5)
    assert fit.converged
    assert fit.at_bound == ()
    assert all(fit.identified)


def test_rows_of_a_tenth_and_of_sixty_seconds():
    t = stamps(pulse_hz=10.0, rest_hz=1 / 60, fast_s=20.0, rest_s=3600.0, before_s=300.0)
    assert np.diff(t).max() > 500 * np.diff(t).min()
    fit = fit_varpro(closed_pulse(Circuit(), t))
    np.testing.assert_allclose(values(fit), Circuit().values, rtol=1e-6)


def test_current_that_changes_inside_the_pulse_is_exact():
    # Superposition: a pulse at 20 A for 60 s, and -8 A more in its last 30 s (a limit was held).
    t = stamps(pulse_hz=10.0)
    late = Circuit(ocv=0.0)
    first, v1 = closed_form(Circuit(), t, 20.0, 60.0, 40.0)
    second, v2 = closed_form(late, t - 30.0, -8.0, 30.0, 40.0)
    n, start = t.size, int(np.argmax(first != 0.0))
    # Each part counts SOC from its own middle; move both to one reference.
    shift = Circuit().slope * (-0.5 * 20.0 * 60.0 + 0.5 * 8.0 * 30.0) / 3600.0 / 40.0
    data = pulse_from_arrays(
        t, first + second, v1 + v2 + shift, start, start + 600, 40.0, rest_before_s=1e4
    )
    fit = fit_varpro(data, PLAIN)
    assert n == len(data)
    np.testing.assert_allclose(values(fit)[:5], Circuit().values[:5], rtol=1e-6)
    assert fit.ocv_slope_V == pytest.approx(0.8, rel=1e-6)


@pytest.mark.parametrize("rest_s", [4.0, 15.0, 60.0])
def test_pulse_after_an_incomplete_rest(rest_s):
    circuit = Circuit(v1=3e-3, v2=-20e-3)
    t = stamps(before_s=rest_s, rest_hz=5.0, rest_s=300.0)
    data = closed_pulse(circuit, t, rest_before_s=rest_s)
    fit = fit_varpro(data)
    np.testing.assert_allclose(values(fit), circuit.values, rtol=1e-4)
    assert fit.v2_start_V == pytest.approx(-20e-3, rel=1e-3)
    blind = fit_varpro(data, VarproOptions(initial=False))
    assert abs(blind.r2_ohm / circuit.r2 - 1.0) > 0.05


def test_ocv_slope_is_what_saves_tau2():
    """Without the slope a pulse near empty bends tau2: the LFP paper's distorted pulses."""
    data = closed_pulse(Circuit(slope=4.0), stamps(), 80.0)
    flat = PulseData(**{**vars(data), "ocv_change_V": np.zeros(len(data))})
    assert abs(fit_varpro(data).tau2_s / 60.0 - 1.0) < 1e-4
    assert abs(fit_varpro(flat).tau2_s / 60.0 - 1.0) > 0.3


def bent_pulse(current=80.0, noise=0.0):
    """OCV with an e-fold in 3 % of SOC, a pulse over 3.3 % of it."""

    def ocv(soc):
        return 3.3 + 0.2 * np.exp((soc - 0.5) / 0.03)

    t = stamps()
    flow, v = closed_form(Circuit(ocv=0.0, slope=0.0), t, current, 60.0, 40.0)
    soc = 0.5 - current * np.clip(t, 0.0, 60.0) / 3600.0 / 40.0
    start = int(np.argmax(flow != 0.0))
    args = (t, flow, v + ocv(soc) + noise, start, start + 600, 40.0)
    return args, ocv


@pytest.mark.parametrize("current", [-80.0, 80.0])
def test_bends_of_the_ocv_are_found_where_the_residual_shows_them(current):
    rng = np.random.default_rng(0)
    args, ocv = bent_pulse(current, 2e-4 * rng.standard_normal(stamps().size))
    data = pulse_from_arrays(*args, soc_start=0.5, rest_before_s=1e4)
    fit = fit_varpro(data)
    assert fit.ocv_bends_V[0] != 0.0
    np.testing.assert_allclose(values(fit)[:5], Circuit().values[:5], rtol=0.03)
    slope = (ocv(data.soc + 1e-6) - ocv(data.soc - 1e-6)) / 2e-6
    assert fit.ocv_slope_V == pytest.approx(slope, rel=0.02)
    assert fit.ocv_V == pytest.approx(ocv(data.soc), abs=2e-3)
    straight = fit_varpro(data, VarproOptions(bends=0))
    assert abs(straight.r1_ohm / Circuit().r1 - 1.0) > 0.1


def test_no_bends_where_there_are_none():
    rng = np.random.default_rng(1)
    kept = 0
    for _ in range(40):
        t = stamps()
        data = closed_pulse(Circuit(), t, noise=1e-3 * rng.standard_normal(t.size))
        kept += fit_varpro(data).ocv_bends_V[0] != 0.0
    assert kept <= 2


def test_tabulated_ocv_takes_the_place_of_slope_and_bends():
    args, ocv = bent_pulse()
    fit = fit_varpro(pulse_from_arrays(*args, soc_start=0.5, rest_before_s=1e4, ocv=ocv))
    np.testing.assert_allclose(values(fit)[:5], Circuit().values[:5], rtol=1e-5)
    assert fit.ocv_V == pytest.approx(ocv(0.5 - 80.0 * 30.0 / 3600.0 / 40.0), abs=1e-4)
    assert fit.error.ocv_slope_V == 0.0
    assert fit.ocv_bends_V == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("current", [-120.0, 120.0])
def test_trend_gives_the_parameters_at_the_mean_soc(current):
    """Parameters that change over the pulse: stepped finely here, told to the fit by slope."""
    trend = PulseTrend(r0=-2.0, r1=-4.0, r2=-5.0, tau1=3.0, tau2=2.0)
    t = stamps(pulse_hz=20.0)
    flow, _ = closed_form(Circuit(), t, current, 60.0, 40.0)
    dt = np.diff(t, prepend=t[0])
    dq = np.cumsum(flow * dt) / 3600.0 / 40.0
    x = 0.5 * dq[-1] - dq
    middle = x + 0.5 * flow * dt / 3600.0 / 40.0
    r1, r2 = 1e-3 * np.exp(trend.r1 * middle), 1.5e-3 * np.exp(trend.r2 * middle)
    a1 = np.exp(-dt / (4.0 * np.exp(trend.tau1 * middle)))
    a2 = np.exp(-dt / (60.0 * np.exp(trend.tau2 * middle)))
    v, u1, u2 = np.empty(t.size), 0.0, 0.0
    for k in range(t.size):
        u1 = a1[k] * u1 + (1.0 - a1[k]) * r1[k] * flow[k]
        u2 = a2[k] * u2 + (1.0 - a2[k]) * r2[k] * flow[k]
        v[k] = 3.6 + 0.8 * x[k] - 2e-3 * np.exp(trend.r0 * x[k]) * flow[k] - u1 - u2
    start = int(np.argmax(flow != 0.0))
    data = pulse_from_arrays(t, flow, v, start, start + 1200, 40.0, rest_before_s=1e4)
    told = fit_varpro(data, PLAIN, trend)
    np.testing.assert_allclose(values(told), Circuit().values, rtol=2e-3)
    alone = fit_varpro(data, PLAIN)
    assert np.max(np.abs(values(alone)[:5] / Circuit().values[:5] - 1.0)) > 0.03


# --- nothing finds a better fit ------------------------------------------------------------------


def residual(theta, t, flow, dq, voltage, centre):
    """Seven-parameter residual by convolution sums, for scipy."""
    r0, r1, log_tau1, r2, log_tau2, ocv, slope = theta
    dt = np.diff(t, prepend=t[0])
    model = ocv + slope * (centre - dq) - 1e-3 * r0 * flow
    for r, tau in ((r1, np.exp(log_tau1)), (r2, np.exp(log_tau2))):
        u, out = 0.0, np.empty(t.size)
        for k, a in enumerate(np.exp(-dt / tau)):
            u = a * u + (1.0 - a) * flow[k]
            out[k] = u
        model = model - 1e-3 * r * out
    return 1e3 * (voltage - model)


@pytest.mark.parametrize("method", ["trf", "lm"])
def test_scipy_reaches_no_lower_cost(method):
    rng = np.random.default_rng(11)
    for _ in range(25):
        circuit = random_circuit(rng)
        t = stamps(rng, jitter=0.3, pulse_s=40.0, rest_s=200.0, fast_s=10.0, pulse_hz=4.0)
        noise = 10 ** rng.uniform(-4.0, -2.5)
        data = closed_pulse(
            circuit, t, float(rng.choice([-30.0, 30.0])), 40.0, 40.0,
            noise * rng.standard_normal(t.size),
        )  # fmt: skip
        fit = fit_varpro(data, PLAIN)
        bounds = window_tau_bounds(data)
        low = [0.0, 0.0, np.log(bounds.tau1_min_s), 0.0, np.log(bounds.tau2_min_s), -9.0, 0.0]
        high = [99.0, 99.0, np.log(bounds.tau1_max_s), 99.0, np.log(bounds.tau2_max_s), 9.0, 99.0]
        for start in (circuit.values, values(fit)):
            x0 = start.copy()
            x0[[0, 1, 3]] *= 1e3
            x0[[2, 4]] = np.log(x0[[2, 4]])
            args = (t, data.current_A, data.charge_fraction, data.voltage_V, data.pulse_centre)
            if method == "trf":
                x0 = np.clip(x0, np.array(low) + 1e-9, np.array(high) - 1e-9)
                found = least_squares(residual, x0, args=args, bounds=(low, high), max_nfev=60)
            else:
                found = least_squares(residual, x0, args=args, method="lm", max_nfev=600)
                if np.any(found.x < low) or np.any(found.x > high):
                    continue  # outside the bounds that the fit keeps
            assert cost(fit, data) <= 2e-6 * found.cost * (1.0 + 1e-6)


def test_a_finer_search_finds_nothing_lower_on_pure_noise():
    """Data without any circuit have many minima; the grid of starts must not miss the lowest."""
    rng = np.random.default_rng(5)
    t = stamps(pulse_s=20.0, rest_s=100.0, pulse_hz=5.0)
    worse = 0
    for _ in range(10):
        data = closed_pulse(
            Circuit(r1=0.0, r2=0.0), t, 20.0, 20.0, 40.0, 1e-3 * rng.standard_normal(t.size)
        )
        fit = fit_varpro(data, PLAIN)
        assert fit.tau1_s < fit.tau2_s
        b = window_tau_bounds(data)
        grid = np.geomspace(b.tau1_min_s, b.tau2_max_s, 8)
        tries = [
            fit_varpro(data, PLAIN, start_tau_s=(a, c))
            for a in grid for c in grid if c >= 1.5 * a
        ]  # fmt: skip
        worse += fit.rmse_V > min(x.rmse_V for x in tries) * (1.0 + 1e-4)
    assert worse <= 1


def test_bounded_linear_part_is_the_bounded_optimum():
    rng = np.random.default_rng(2)
    hit = 0
    for _ in range(60):
        x = rng.standard_normal((40, 5))
        y = x @ rng.standard_normal(5) + 0.3 * rng.standard_normal(40)
        full = np.zeros((40, COLUMNS))
        full[:, 0], full[:, 1:6] = y, x
        include = np.arange(LINEAR) < 5
        positive = np.isin(np.arange(LINEAR), [1, 2, 3, 4])
        c, free = np.zeros(LINEAR), np.zeros(LINEAR, dtype=np.bool_)
        found = solve_linear(
            full.T @ full, include, positive, c, free,
            np.zeros(LINEAR, dtype=np.int64), np.zeros((LINEAR, LINEAR)), np.zeros(LINEAR),
        )  # fmt: skip
        low = np.where(positive[:5], 0.0, -np.inf)
        oracle = lsq_linear(x, y, bounds=(low, np.inf), method="bvls", tol=1e-14)
        np.testing.assert_allclose(c[:5], oracle.x, atol=1e-8)
        assert found == pytest.approx(2.0 * oracle.cost, rel=1e-10)
        hit += not free[:5].all()
    assert hit > 20


def test_columns_are_the_derivatives_of_the_model():
    rng = np.random.default_rng(3)
    t = stamps(rng, jitter=0.5, pulse_hz=3.0)
    data = closed_pulse(Circuit(v1=1e-3, v2=2e-3), t)
    trend = PulseTrend(1.0, -2.0, 3.0, 1.5, -1.0)
    problem = build_problem(data, "rows", trend)

    def gram(tau1, tau2, weight):
        out = np.empty((COLUMNS, COLUMNS))
        accumulate(
            problem.window._replace(weight=weight), tau1, tau2, COLUMNS,
            np.empty((COLUMNS, TILE)), np.empty(TILE), out,
        )  # fmt: skip
        return out

    # A weight on one row alone gives that row's products; against the constant column, its values.
    h = 1e-5
    for row in rng.integers(5, t.size, 12):
        weight = np.zeros(t.size)
        weight[row] = 1.0
        at = gram(4.0, 60.0, weight)[1]
        up1, down1 = (gram(4.0 * np.exp(s), 60.0, weight)[1] for s in (h, -h))
        up2, down2 = (gram(4.0, 60.0 * np.exp(s), weight)[1] for s in (h, -h))
        for value, derivative, up, down in (
            (4, 6, up1, down1), (5, 7, up2, down2), (11, 13, up1, down1), (12, 14, up2, down2),
        ):  # fmt: skip
            change = (up[value] - down[value]) / (2.0 * h)
            assert at[derivative] == pytest.approx(change, rel=1e-6, abs=1e-9)
    assert sorted(COLUMN_OF) == list(COLUMN_OF)


# --- invariances -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def noisy():
    t = stamps()
    return closed_pulse(Circuit(), t, noise=1e-3 * np.random.default_rng(7).standard_normal(t.size))


def changed(data, **fields):
    return PulseData(**{**vars(data), **fields})


def test_scaling_the_current_scales_the_resistances(noisy):
    k = 2.5
    scaled = changed(
        noisy, current_A=k * noisy.current_A, charge_Ah=k * noisy.charge_Ah,
        capacity_Ah=k * noisy.capacity_Ah,
    )  # fmt: skip
    a, b = values(fit_varpro(noisy)), values(fit_varpro(scaled))
    np.testing.assert_allclose(b, a * [1 / k, 1 / k, 1, 1 / k, 1, 1, 1], rtol=1e-5)


def test_shifting_the_voltage_shifts_the_ocv_only(noisy):
    moved = changed(noisy, voltage_V=noisy.voltage_V + 0.25)
    a, b = values(fit_varpro(noisy)), values(fit_varpro(moved))
    np.testing.assert_allclose(b - a, [0, 0, 0, 0, 0, 0.25, 0], atol=1e-5)


def test_a_charge_pulse_gives_the_same_parameters(noisy):
    mirrored = changed(
        noisy, current_A=-noisy.current_A, charge_Ah=-noisy.charge_Ah,
        voltage_V=2 * 3.6 - noisy.voltage_V,
    )  # fmt: skip
    a, b = fit_varpro(noisy), fit_varpro(mirrored)
    np.testing.assert_allclose(
        values(b)[[0, 1, 2, 3, 4, 6]], values(a)[[0, 1, 2, 3, 4, 6]], rtol=1e-5
    )
    assert b.current_A == -a.current_A
    np.testing.assert_allclose(b.error[:5], a.error[:5], rtol=1e-4)


def test_shifting_the_clock_changes_nothing(noisy):
    later = changed(noisy, time_s=noisy.time_s + 1e6)
    np.testing.assert_allclose(values(fit_varpro(later)), values(fit_varpro(noisy)), rtol=1e-5)


def test_stretching_the_clock_stretches_the_time_constants(noisy):
    slow = changed(noisy, time_s=3.0 * noisy.time_s)
    a, b = values(fit_varpro(noisy)), values(fit_varpro(slow))
    np.testing.assert_allclose(b, a * [1, 1, 3, 1, 3, 1, 1], rtol=1e-5)


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


@pytest.mark.parametrize("weighting", ["rows", "balanced"])
def test_standard_errors_agree_with_the_scatter(weighting):
    rng = np.random.default_rng(21)
    t = stamps(pulse_s=30.0, rest_s=400.0, fast_s=5.0)
    fits = [
        fit_varpro(
            closed_pulse(Circuit(), t, 40.0, 30.0, 40.0, 1e-3 * rng.standard_normal(t.size)),
            replace(PLAIN, weighting=weighting),
        )
        for _ in range(300)
    ]
    scatter = np.std([values(f) for f in fits], axis=0)
    stated = np.median([np.array(f.error) for f in fits], axis=0)
    assert np.all(stated / scatter > 0.7)
    assert np.all(stated / scatter < 1.3)
    assert np.median([f.noise_V for f in fits]) == pytest.approx(1e-3, rel=0.02)


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
        fits.append(fit_varpro(closed_pulse(Circuit(), t, 40.0, noise=1e-3 * noise), PLAIN))
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
    assert fit.error.tau2_s > 0.3 * fit.tau2_s
    assert not fit.identified.tau2_s
    assert fit.identified.r0_ohm
    assert not fit.identified.ocv_slope_V
    assert any("tau2" in said for said in fit.notices)
    long = fit_varpro(
        closed_pulse(Circuit(), stamps(), noise=5e-4 * rng.standard_normal(stamps().size))
    )
    assert all(long.identified)
    assert long.notices == ()
    assert long.condition < fit.condition


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


def test_a_branch_that_is_not_there_is_at_its_bound():
    data = closed_pulse(Circuit(r1=0.0, r2=0.0), stamps())
    fit = fit_varpro(data)
    assert fit.r1_ohm + fit.r2_ohm < 1e-7
    assert fit.r0_ohm == pytest.approx(2e-3, rel=1e-4)
    assert not fit.identified.r1_ohm


# --- options and bad input -----------------------------------------------------------------------


def test_bounds_hold():
    bounds = TauBounds(0.5, 3.0, 10.0, 45.0)
    fit = fit_varpro(closed_pulse(Circuit(), stamps()), VarproOptions(tau=bounds))
    assert 0.5 <= fit.tau1_s <= 3.0 + 1e-9
    assert fit.tau2_s <= 45.0 + 1e-9
    assert "tau2_s" in fit.at_bound
    assert not fit.identified.tau2_s


@pytest.mark.parametrize(
    "bounds",
    [
        TauBounds(5.0, 1.0, 10.0, 100.0),
        TauBounds(-1.0, 1.0, 10.0, 100.0),
        TauBounds(5.0, 9.0, 1.0, 6.0),
        TauBounds(1.0, 2.0, 3.0, np.inf),
        TauBounds(1.0, 2.0, 3.0, 100.0, ratio=0.5),
    ],
)
def test_bounds_without_room_are_refused(bounds, noisy):
    with pytest.raises(InputError, match="time constants"):
        fit_varpro(noisy, VarproOptions(tau=bounds))


@pytest.mark.parametrize("wrong", [{"bends": 4}, {"initial": "yes"}])
def test_unknown_choices_are_refused(wrong):
    with pytest.raises(InputError, match="expected bends"):
        VarproOptions(**wrong)
