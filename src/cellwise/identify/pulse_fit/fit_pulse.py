"""Parameters of pulses by variable projection, and one interface for it and the papers' methods.

Only the two time constants enter a pulse's voltage nonlinearly. At given ones the rest is a small
linear problem with R >= 0 (Golub and Pereyra, doi:10.1137/0710036), so the search runs over two
numbers: a grid, then downhill from its best pair.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import least_squares, nnls

from cellwise.errors import InputError
from cellwise.identify.papers.segments import fit_segments
from cellwise.identify.papers.swarm import fit_swarm
from cellwise.identify.pulse_fit.circuit import Circuit, PulseFit, PulseParameters
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.typing import FloatArray

Method = Literal["varpro", "segments", "pso"]
GRID = 16  # time constants from which the search begins, in every pair
RIDGE = 1e-12  # of the scaled normal equations: two branches may be alike
AT_BOUND = 1e-3  # of the range of ln tau


def fit_pulse(
    data: PulseData, method: Method = "varpro", rng: np.random.Generator | None = None
) -> PulseFit:
    """Parameters of one pulse.

    Parameters
    ----------
    data : PulseData          see `cut_pulse`
    method : str              ``varpro``: least squares by variable projection (default);
                              ``segments``: closed formulas on three points; ``pso``: swarm
    rng : numpy Generator     of the swarm; by default one seeded with 0

    Returns
    -------
    PulseFit

    Raises
    ------
    InputError        unknown method, too few settled rows
    """
    if method == "varpro":
        return fit_varpro(data)
    if method == "segments":
        return fit_segments(data)
    if method == "pso":
        return fit_swarm(data, rng=rng)
    raise InputError(
        f"method {method!r}", "'varpro', 'segments' or 'pso'", "Choose one of the three."
    )


def fit_varpro(data: PulseData) -> PulseFit:
    """Fit one pulse and its relaxation by variable projection.

    Searched are ln tau1 and ln(tau2 / tau1), within what the window can show.

    Raises
    ------
    InputError        too few settled rows
    """
    circuit = Circuit(data)
    fastest_s, slowest_s, ratio = circuit.tau_bounds()
    fast, slow, apart = np.log([fastest_s, slowest_s, ratio])
    share = circuit.weight / np.sum(circuit.weight)

    def rows_of(tau_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Voltage and responses less their means, as rows count; the means."""
        rows = np.vstack((circuit.known, -circuit.current_A, -circuit.responses(tau_s)))
        mean = rows @ share
        return (rows - mean[:, None]) * np.sqrt(share), mean

    def tau_of(at: FloatArray) -> FloatArray:
        return np.exp([at[0], min(at[0] + at[1], slow)])

    def left_V(at: FloatArray) -> FloatArray:
        rows, _ = rows_of(tau_of(at))
        return np.asarray(rows[0] - _resistances((rows @ rows.T)[None])[0] @ rows[1:])

    ln_tau = np.linspace(fast, slow, GRID)
    rows, _ = rows_of(np.exp(ln_tau))
    gram = rows @ rows.T
    pairs = np.argwhere(ln_tau - ln_tau[:, None] >= apart)
    chosen = np.hstack((np.tile([0, 1], (len(pairs), 1)), 2 + pairs))
    costs = _costs(gram[chosen[:, :, None], chosen[:, None, :]])
    first, second = ln_tau[pairs[int(np.argmin(costs))]]
    low, high = np.array([fast, apart]), np.array([slow - apart, slow - fast])
    start = np.clip([first, second - first], low, high)
    at = least_squares(
        left_V, start, bounds=(low, high), method="dogbox", xtol=1e-6, ftol=1e-10, gtol=None
    ).x
    tau = tau_of(at)
    rows, mean = rows_of(tau)
    x = _resistances((rows @ rows.T)[None])[0]
    r0, r1, r2 = x.tolist()
    value = PulseParameters(r0, r1, float(tau[0]), r2, float(tau[1]), float(mean[0] - mean[1:] @ x))
    held = [n for n in ("r0_ohm", "r1_ohm", "r2_ohm") if getattr(value, n) <= 0.0]
    room = AT_BOUND * (slow - fast)
    if at[0] < fast + room or at[1] < apart + room or at[0] + at[1] > slow - room:
        held += ["tau1_s", "tau2_s"]  # where one is held, the other stands for both
    return circuit.described("varpro", value, value._fields, held)


def _resistances(grams: FloatArray) -> FloatArray:
    """Least squares with no resistance below zero, from products of voltage and columns.

    Parameters
    ----------
    grams : (m, 4, 4) float     of m pairs of time constants
    """
    scale = np.sqrt(np.maximum(np.diagonal(grams, axis1=1, axis2=2)[:, 1:], 1e-300))
    part = grams[:, 1:, 1:] / (scale[:, :, None] * scale[:, None, :]) + RIDGE * np.eye(3)
    right = grams[:, 1:, 0] / scale
    x = np.linalg.solve(part, right[:, :, None])[:, :, 0]
    for k in np.flatnonzero((x < 0.0).any(axis=1)):  # the best of all is not the best allowed
        factor = np.linalg.cholesky(part[k])
        x[k] = nnls(factor.T, np.linalg.solve(factor, right[k]))[0]
    return np.asarray(x / scale)


def _costs(grams: FloatArray) -> FloatArray:
    """Mean square of what the best resistances leave, (m,) [V^2]."""
    x = _resistances(grams)
    squares = np.einsum("mi,mij,mj->m", x, grams[:, 1:, 1:], x)
    return np.asarray(grams[:, 0, 0] - 2.0 * np.einsum("mi,mi->m", x, grams[:, 1:, 0]) + squares)
