"""A drive as a fleet's vehicles log it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.cell.simulate import simulate
from cellwise.fleet.store import all_rows
from cellwise.logs import CellLog
from example_cells import curved_cell

ROWS = 900


def drive(seed, soc0, rows=ROWS):
    """A drive after a rest; the voltage is the model's with a millivolt of noise."""
    rng = np.random.default_rng(seed)
    model = curved_cell()
    load = np.repeat(rng.normal(1.2, 2.0, rows // 10), 10)
    load[:60] = 0.0
    drawn = np.cumsum(load) / 3600.0
    log = CellLog(np.arange(float(rows)), load, np.full(rows, 3.7), np.full(rows, 25.0), drawn)
    voltage = simulate(model, log, soc0).voltage_V + rng.normal(0.0, 1e-3, rows)
    return replace(log, voltage_V=voltage)


def rows_in(out):
    """Every row of the parts of a fleet's result, by log; none has two."""
    columns = all_rows(out)
    assert len(set(columns["log"])) == len(columns["log"])
    return {
        log: {name: values[k] for name, values in columns.items()}
        for k, log in enumerate(columns["log"])
    }
