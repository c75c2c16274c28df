"""The initial SOC by the likelihood of a whole log, simulated from each candidate."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import announce
from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.initial_soc.best_start import (
    Pieces,
    PieceSums,
    Starts,
    rows_to_fit,
    start_errors,
)
from cellwise.cell.initial_soc.rest import RELAXED_S, SHORT_REST_V
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C, start_hysteresis
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class WholeLogFit(NamedTuple):
    """How the start of a whole log is weighed."""

    piece: float = 0.02  # throughput over which the error hardly changes [capacities]
    independent: float = 2.0  # of a log: one OCV and one capacity are wrong everywhere
    outlying: float = 25.0  # no piece counts more than at five deviations, squared
    beyond: float = 0.01  # how far a counter may run beyond full or empty
    past_s: float = 600.0  # load that an unknown past is taken to be like [s]


WHOLE_LOG = WholeLogFit()

ALIKE = 0.25  # half a standard deviation, as minus twice the log likelihood
COARSE, FINE = 51, 41  # starts tried over 0..1, then around the likeliest


def likeliest_soc(
    model: CellModel, log: CellLog, past_V: tuple[float, float], beginning: float
) -> tuple[float, float]:
    """The likeliest initial SOC of a log with at least two voltages, and its standard deviation.

    The squared error of a piece of 2 % throughput counts once, against the model's own claim and
    the best fit; what an unknown past left in the slow states is a voltage that fades, integrated
    over its normal distribution (``past_V``: mean and standard deviation). What the ``beginning``
    says is one of the starts that are tried, as full and empty are.
    """
    grid = np.union1d(np.linspace(0.0, 1.0, COARSE), beginning)
    best = float(grid[np.argmin(start_cost(model, log, grid, past_V)[0])])
    step = 1.0 / (COARSE - 1)
    near = np.linspace(max(0.0, best - step), min(1.0, best + step), FINE)
    soc = np.union1d(grid, near)
    cost, error_V2 = start_cost(model, log, soc, past_V)
    weight = np.exp(-0.5 * (cost - cost.min())) * np.gradient(soc)
    mean = float(np.average(soc, weights=weight))
    variance = float(np.average((soc - mean) ** 2, weights=weight))
    # Of starts that the likelihood cannot separate, that from which the simulation is nearest.
    alike = np.flatnonzero(cost <= cost.min() + ALIKE)
    likeliest = float(soc[alike[np.argmin(error_V2[alike])]])
    return likeliest, math.hypot(math.sqrt(variance), likeliest - mean)


def start_cost(
    model: CellModel, log: CellLog, soc0: FloatArray, past_V: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Minus twice the log likelihood of every start, and its mean squared error [V^2], (m,)."""
    charge = log.counted_charge_Ah() / model.capacity_Ah
    moved = np.cumsum(np.abs(np.diff(charge, prepend=charge[0])))
    piece = (moved / WHOLE_LOG.piece).astype(np.int64)
    past = np.exp(-(log.time_s - log.time_s[0]) / RELAXED_S)
    finite = np.isfinite(log.voltage_V)
    pieces = int(piece[-1]) + 1
    rows = np.bincount(piece[finite], minlength=pieces)
    squares, products, known = (np.zeros((soc0.size, pieces)) for _ in range(3))
    beyond = np.zeros(soc0.size)
    announce(start_errors, "the initial SOC")
    start_errors(
        model.parameters(),
        Starts(soc0, np.array([start_hysteresis(s) for s in soc0])),
        rows_to_fit(model, log),
        Pieces(piece, past),
        np.array(model.slow_error_V(np.linspace(0.0, 1.0, 101))),
        PieceSums(squares, products, known, beyond),
    )
    seen = rows > 0
    count = rows[seen]
    left = np.bincount(piece[finite], past[finite] ** 2, minlength=pieces)[seen] / count
    mean2, mixed = squares[:, seen] / count, products[:, seen] / count
    error_V2 = np.sum(squares, axis=1) / float(np.sum(rows))
    best_V2 = float(np.min(error_V2))
    variance = known[:, seen] / count + best_V2
    share = min(1.0, WHOLE_LOG.independent / count.size)
    # Without its logarithm the likeliest start would be where the model claims least.
    claimed = share * np.sum(np.log(variance), axis=1)
    normal = np.linspace(-3.0, 3.0, 25)
    costs = np.empty((normal.size, soc0.size))
    gap_V = float(np.max(np.abs(np.asarray(model.effect(Hysteresis).m_V))))
    for place, shift in enumerate(past_V[0] + normal * math.hypot(past_V[1], gap_V)):
        error2 = mean2 - 2.0 * shift * mixed + shift**2 * left
        errors = np.minimum(error2 / variance, WHOLE_LOG.outlying)
        costs[place] = share * np.sum(errors, axis=1) + claimed
    least = costs.min(axis=0)
    prior = np.exp(-0.5 * normal**2)
    likelihood = np.average(np.exp(-0.5 * (costs - least)), axis=0, weights=prior)
    cost = least - 2.0 * np.log(likelihood) + (beyond / WHOLE_LOG.beyond) ** 2
    return np.asarray(cost), np.asarray(error_V2)


def past_voltage(model: CellModel, log: CellLog) -> tuple[float, float]:
    """What the slow states may hold of a past that was like the first minutes of the log [V].

    Between nothing (the load has just begun) and all of it: the middle, and half of the range.
    """
    cell = model.at_temperature(float(known_temperature_C(model, log)[0]))
    slow_ohm = float(np.median(np.asarray(cell.effect(SlowDiffusion).r3_ohm)))
    early = log.time_s <= log.time_s[0] + WHOLE_LOG.past_s
    full_V = -slow_ohm * float(np.mean(log.known_current_A()[early]))
    return 0.5 * full_V, math.hypot(SHORT_REST_V, full_V)
