"""How long a filter will need to find the SOC on a log, predicted from the model alone."""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.estimate.estimators import Estimator
from cellwise.estimate.replay import Replay, converged_row
from cellwise.typing import FloatArray


def expected_std(model: CellModel, replayed: Replay, estimator: Estimator) -> FloatArray:
    """The deviation of the SOC that a filter expects over a log's current, shape (rows,).

    The recursion of the covariance needs a trajectory and no measurement: here that of the log's
    current, counted back from the SOC at which the replay ends, with the voltage that the model
    itself gives. From the replay's own start deviation. It says what this drive can show
    (observability): nothing of how far the model is off beyond what it states.

    Parameters
    ----------
    replayed : Replay         its log, its start's deviation, its final SOC
    estimator : Estimator     as it made the replay; one that uses no voltage expects no convergence
    """
    log = replayed.log
    counted = simulate(model, log, 0.5).soc - 0.5
    start = float(np.clip(replayed.trace.soc[-1] - counted[-1], 0.0, 1.0))
    voltage = np.where(np.isfinite(log.voltage_V), simulate(model, log, start).voltage_V, np.nan)
    trace = estimator.run(replace(log, voltage_V=voltage), start, replayed.start.std)
    return np.asarray(trace.soc_std, dtype=np.float64)


def expected_convergence_s(
    model: CellModel, replayed: Replay, estimator: Estimator
) -> float | None:
    """Time from which an error of that deviation stays within 2 points as likely as not.

    Stays means for ten minutes or to the log's end; None: not on this log.
    """
    half = NormalDist().inv_cdf(0.75)  # half of a normal distribution lies within
    time_s = replayed.log.time_s
    row = converged_row(time_s, half * expected_std(model, replayed, estimator))
    return None if row is None else float(time_s[row] - time_s[0])
