"""Each cell of a car's pack at rest, in months that took no part in any fit."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.simulate import simulate
from cellwise.logs.reading import read_pack
from cellwise.pack.differences import MeanCell, OcvSlope, mean_cell, regressors
from cellwise.pack.pack_estimate import estimate_pack
from measured_models import identified_leaf

FITTED = "06"
OTHERS = ("03", "04", "05", "07", "08", "09", "10", "11")
REST_A = 2.0  # what the car takes while it stands
SETTLED_S = 60.0
FEWEST_ROWS = 80


def resting(log):
    """Seconds for which the car has stood, at every row."""
    still = np.abs(log.current_A) < REST_A
    age = np.zeros(len(log))
    for k in range(1, len(log)):
        if still[k] and still[k - 1]:
            age[k] = age[k - 1] + log.time_s[k] - log.time_s[k - 1]
    return age


def at_rest(model, differences, log):
    """Errors of every cell's voltage [V] in the rests of one pack log, and their lengths [s]."""
    low, high = model.validity.soc
    mean, found, lengths = mean_cell(model, log.mean), [], []
    for part in range(int(mean.part.max()) + 1):
        rows = np.flatnonzero(mean.part == part)
        if rows.size < FEWEST_ROWS:
            continue
        one = log.mean.part(int(rows[0]), int(rows[-1]) + 1)
        start = initial_soc(model, one, whole_log=True)
        simulated = simulate(model, one, start.soc)
        age = resting(one)
        used = (age >= SETTLED_S) & (simulated.soc >= low) & (simulated.soc <= high)
        if not np.any(used):
            continue
        zero = np.zeros(len(one))
        placed = MeanCell(one, start, simulated.soc, zero, one.voltage_V, zero.astype(np.intp))
        apart = regressors(placed, OcvSlope(model, one), 0.0).rows @ differences.T
        found.append((log.cell_V[rows] - simulated.voltage_V[:, None] - apart)[used])
        lengths.append(float(age[used].max()))
    return found, lengths


@pytest.fixture(scope="module")
def rests(real_data):
    """Errors of all cells at rest by month, and the lengths of the rests."""
    model = identified_leaf(real_data).model

    def month(which):
        paths = sorted((real_data / "leaf_pack").glob(f"leaf_2017{which}*.parquet"))
        return [read_pack(path) for path in paths]

    differences = estimate_pack(model, month(FITTED)).state.deltas.mean
    differences = differences - differences.mean(axis=0)
    errors, lengths = {}, []
    for which in OTHERS:
        of_logs = [at_rest(model, differences, log) for log in month(which)]
        errors[which] = np.concatenate([e for found, _ in of_logs for e in found])
        lengths += [s for _, of_log in of_logs for s in of_log]
    return errors, np.array(lengths)


def test_every_cell_is_within_10_mV_at_rest(rests):
    errors, lengths = rests
    together = np.sqrt(np.nanmean(np.concatenate(list(errors.values())) ** 2, axis=0))
    assert together.shape == (96,)
    assert together.max() < 0.010
    # Few rests are long: the figure is of these, and no other.
    assert np.count_nonzero(lengths >= SETTLED_S) >= 50
    assert 5 <= np.count_nonzero(lengths >= 300.0) <= 20
