"""Where a log may begin on the SOC axis: every start tried with a prior over cells, and weighed."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.fit.population import CellPrior, prior_of
from cellwise.fit.problem import Problem
from cellwise.fit.rows import ROWS, FitLog
from cellwise.fit.unknowns import FitSettings, layout_of
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray


class Trials(NamedTuple):
    """How starts are tried.

    Parameters
    ----------
    step : float            of SOC between two starts that are tried
    full_std : float        how far full is from full, from one charge to the next
    block_s : float         a log is thinned to means over so long, or to ``ROWS.most`` [s]
    steps : int             of Gauss and Newton from each
    trust : float           of a log's evidence, as a power: the prior's model is nobody's cell, and
                            full logs of measured cells lost to starts at 0.96 by up to 4 in the
                            logarithm, logs cut at 0.9 by 4 and more
    """

    step: float = 0.1
    full_std: float = 0.01
    block_s: float = 10.0
    steps: int = 5
    trust: float = 0.5


TRIALS = Trials()


class Beginning(NamedTuple):
    """A log's start: the most probable, its deviation, and how probable it is that it was full.

    ``full`` is a probability; where it is above a half, ``std`` is of the other starts about full.
    ``ln_evidence`` is that of the log over all starts.
    """

    soc: float
    std: float
    full: float
    ln_evidence: float


def find_beginning(
    item: FitLog,
    cells: CellPrior,
    capacity_Ah: float,
    ln_capacity_std: float,
    temperature_C: float,
    full_before: float,
    charged_Ah: float = 0.0,
) -> Beginning:
    """Weigh every start of one log by its likelihood, full before all.

    Parameters
    ----------
    full_before : float       how probable it is, whatever the voltages, that the cell is full at
                              ``charged_Ah`` after the first row (negative: charged by then)
    """
    thin = replace(item, log=thinned(item.log, item.compare), compare=None)
    used = thin.log.counted_charge_Ah() / capacity_Ah
    slack = 3.0 * ln_capacity_std + 0.03
    lowest, highest = float(used.max()) * (1.0 - slack), 1.0 + float(used.min()) * (1.0 + slack)
    wide = TRIALS.step / np.sqrt(12.0)
    first = np.arange(0.5 * TRIALS.step, 1.0, TRIALS.step)
    tried = [(s, wide) for s in first if lowest - TRIALS.step < s < highest + TRIALS.step]
    tried = tried or [(float(np.clip(0.5 * (lowest + highest), 0.0, 1.0)), wide)]
    full = float(np.clip(1.0 + charged_Ah / capacity_Ah, 0.0, 1.0))
    found = [
        _try(
            replace(thin, soc0=s, soc0_std=std), cells, capacity_Ah, ln_capacity_std, temperature_C
        )
        for s, std in [(full, TRIALS.full_std), *tried]
    ]
    odds = np.log(
        np.maximum([full_before, *(1.0 - full_before) / 10.0 * np.ones(len(tried))], 1e-9)
    )
    weights = odds + TRIALS.trust * np.array([evidence for _, _, evidence in found])
    total = float(np.logaddexp.reduce(weights))
    share = np.exp(weights - total)
    if share[0] > 0.5:
        from_full = np.array([soc - full for soc, _, _ in found])
        std = float(np.sqrt(TRIALS.full_std**2 + share[1:] @ from_full[1:] ** 2))
        return Beginning(full, std, float(share[0]), total)
    best = int(np.argmax(share))
    soc = np.array([s for s, _, _ in found])
    stds = np.array([std for _, std, _ in found])
    mean = float(share @ soc)
    std = float(np.sqrt(share @ (stds**2 + (soc - mean) ** 2)))
    return Beginning(float(soc[best]), std, float(share[0]), total)


def _try(
    item: FitLog,
    cells: CellPrior,
    capacity_Ah: float,
    ln_capacity_std: float,
    temperature_C: float,
) -> tuple[float, float, float]:
    """Start, deviation and evidence of one log from one start."""
    layout = layout_of(3, cells.name == "lfp")
    grid = np.array([temperature_C])
    settings = FitSettings(hysteresis=layout.hysteresis, ln_capacity_std=ln_capacity_std)
    prior = prior_of(cells, layout, (item,), capacity_Ah, grid, temperature_C, settings)
    problem = Problem(
        [item], cells.base(), prior, layout, capacity_Ah, grid, temperature_C, ROWS.most
    )
    theta, _, normal, _ = problem.minimise(problem.inside(prior.mean), TRIALS.steps)
    std = float(np.sqrt(problem.prior.covariance(normal.matrix)[layout.start, layout.start]))
    return item.soc0 + float(theta[layout.start]), std, problem.log_evidence(normal)


def thinned(log: CellLog, compare: BoolArray | None = None) -> CellLog:
    """Means over blocks of time; voltages of rows that are not compared are left out."""
    voltage = log.voltage_V if compare is None else np.where(compare, log.voltage_V, np.nan)
    block_s = max(TRIALS.block_s, log.duration_s / ROWS.most)
    block = np.floor((log.time_s - log.time_s[0]) / block_s).astype(np.int64)
    _, place = np.unique(block, return_inverse=True)
    count = np.bincount(place)
    last = np.cumsum(count) - 1
    if last.size < 2:
        return log

    def mean(values: FloatArray) -> FloatArray:
        known = np.isfinite(values)
        number = np.bincount(place[known], minlength=count.size)
        total = np.bincount(place[known], values[known], minlength=count.size)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(total / number)

    time_s = log.time_s[last]
    charge = log.counted_charge_Ah()[last]
    dt = np.diff(time_s, prepend=log.time_s[0])
    moved = np.diff(charge, prepend=0.0)
    current = np.where(dt > 0, 3600.0 * moved / np.maximum(dt, 1e-9), log.known_current_A()[last])
    warm = None if log.temperature_C is None else mean(log.temperature_C)
    return CellLog(
        time_s, current, mean(voltage), warm if warm is None or np.isfinite(warm).any() else None,
        charge_Ah=charge, name=log.name, soc0=log.soc0,
    )  # fmt: skip
