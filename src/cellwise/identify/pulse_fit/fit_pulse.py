"""Parameters of pulses by variable projection, and one interface for it and the papers' methods.

Only the two time constants enter a pulse's voltage nonlinearly. At given ones the rest is a small
linear problem with R >= 0 (Golub and Pereyra, doi:10.1137/0710036), so the search runs over two
numbers: a grid, then downhill from its best pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares

from cellwise.errors import InputError
from cellwise.identify.papers.segments import fit_segments
from cellwise.identify.papers.swarm import fit_swarm
from cellwise.identify.pulse_fit.circuit import NUMERICS, Circuit, TauBounds
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit, PulseParameters
from cellwise.typing import FloatArray

Method = Literal["varpro", "segments", "pso"]
GRID = 16  # time constants from which the search begins, in every pair
SEARCH: dict[str, Any] = {"method": "dogbox", "xtol": 1e-8, "ftol": 1e-12, "gtol": None}


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
    InputError        unknown method, too few rows
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


def fit_pulses(pulses: Sequence[PulseData], method: Method = "varpro") -> list[PulseFit]:
    """Parameters of all pulses of a test, in the order given; see `fit_pulse`."""
    rng = np.random.default_rng(0)  # one for all: alike draws would err alike
    return [fit_pulse(data, method, rng) for data in pulses]


def fit_varpro(data: PulseData, bounds: TauBounds | None = None) -> PulseFit:
    """Fit one pulse and its relaxation by variable projection.

    Parameters
    ----------
    data : PulseData
    bounds : TauBounds        of the time constants; by default what the window can show

    Returns
    -------
    PulseFit

    Raises
    ------
    InputError        too few settled rows
    """
    circuit = Circuit(data)
    search = _Search(circuit, circuit.tau_bounds() if bounds is None else bounds)
    found = least_squares(search.residual, search.start(), bounds=(0.0, 1.0), **SEARCH)
    return circuit.described("varpro", *search.result(found.x))


class _Search:
    """The plane of both time constants, as a unit square.

    Its first coordinate is where ln tau2 lies in its range, the second where ln tau1 lies between
    its least and the most that tau2 leaves it: every point of the square keeps the bounds.
    """

    def __init__(self, circuit: Circuit, bounds: TauBounds) -> None:
        self.circuit = circuit
        self.low, self.apart = np.log(bounds.fastest_s), np.log(bounds.ratio)
        self.room = np.log(bounds.slowest_s) - self.apart - self.low
        slope = [circuit.x] if circuit.table_slope_V is None else []
        self.plain = np.vstack((circuit.known, -circuit.current_A, *slope))
        self.share = circuit.weight / np.sum(circuit.weight)

    def tau_s(self, at: FloatArray) -> FloatArray:
        """Time constants of a point, shape (2,)."""
        fast = self.low + at[0] * at[1] * self.room
        return np.asarray(np.exp([fast, self.low + at[0] * self.room + self.apart]))

    def start(self) -> FloatArray:
        """The best pair of a grid, all else fitted."""
        ln_tau = np.linspace(self.low, self.low + self.room + self.apart, GRID)
        rows, _ = self._rows(np.exp(ln_tau))
        head = len(self.plain)
        pairs = np.argwhere(ln_tau - ln_tau[:, None] >= self.apart)
        at = np.column_stack((np.tile(np.arange(head), (len(pairs), 1)), head + pairs))
        left, _ = _solved((rows @ rows.T)[at[:, :, None], at[:, None, :]])
        fast, slow = ln_tau[pairs[int(np.argmin(left))]]
        far = (slow - self.apart - self.low) / self.room
        near = (fast - self.low) / self.room / max(far, 1e-12)
        return np.asarray(np.clip([far, near], 0.0, 1.0))

    def residual(self, at: FloatArray) -> FloatArray:
        """Residual of the voltage at a point, as its rows count [V], shape (n,)."""
        rows, _ = self._rows(self.tau_s(at))
        return np.asarray(rows[0] - _solved(rows @ rows.T)[1] @ rows[1:])

    def result(self, at: FloatArray) -> tuple[PulseParameters, list[str], list[str]]:
        """Parameters at a point, which of them were free, and which a bound holds."""
        tau = self.tau_s(at)
        rows, mean = self._rows(tau)
        x = _solved(rows @ rows.T)[1]
        slope = self.circuit.table_slope_V
        value = PulseParameters(
            r0_ohm=float(x[0]),
            r1_ohm=float(x[-2]),
            tau1_s=float(tau[0]),
            r2_ohm=float(x[-1]),
            tau2_s=float(tau[1]),
            ocv_V=float(mean[0] - mean[1:] @ x),
            ocv_slope_V=float(x[1]) if slope is None else slope,
        )
        free = [n for n in value._fields if n != "ocv_slope_V" or slope is None]
        held = [n for n in free if n not in ("tau1_s", "tau2_s") and getattr(value, n) <= 0.0]
        if np.any(np.abs(at - 0.5) > 0.5 - NUMERICS.at_bound):
            held += ["tau1_s", "tau2_s"]  # where one is held, the other stands for both
        return value, free, held

    def _rows(self, tau_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Voltage, linear columns and branches less their means, as rows count; the means."""
        rows = np.vstack((self.plain, -self.circuit.responses(tau_s)))
        mean = rows @ self.share
        return (rows - mean[:, None]) * np.sqrt(self.share), mean


def _solved(gram: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares with no unknown below zero: every choice of those that are zero is tried.

    For a convex quadratic the best feasible choice is the bounded optimum.

    Parameters
    ----------
    gram : (..., k + 1, k + 1) float      products of voltage and columns, the voltage first

    Returns
    -------
    left : (...) float            mean square of the residual [V^2]
    unknowns : (..., k) float
    """
    k = gram.shape[-1] - 1
    free = (np.arange(1 << k)[:, None] >> np.arange(k) & 1).astype(np.float64)  # (2^k, k)
    part = gram[..., 1:, 1:]
    scale = np.sqrt(np.maximum(np.diagonal(part, axis1=-2, axis2=-1), 1e-300))[..., None, :]
    products = gram[..., None, 0, 1:] / scale * free
    scaled = (part / scale / np.swapaxes(scale, -1, -2))[..., None, :, :]
    system = scaled * (free[:, :, None] * free[:, None, :]) + (1.0 + NUMERICS.ridge - free)[
        ..., None
    ] * np.eye(k)
    tried = np.linalg.solve(system, products[..., None])[..., 0]
    explained = np.where(np.all(tried >= 0.0, axis=-1), np.sum(tried * products, axis=-1), -np.inf)
    best = np.argmax(explained, axis=-1)[..., None]
    left = gram[..., 0, 0] - np.take_along_axis(explained, best, axis=-1)[..., 0]
    unknowns = np.take_along_axis(tried, best[..., None], axis=-2)[..., 0, :] / scale[..., 0, :]
    return np.maximum(left, 0.0), unknowns
