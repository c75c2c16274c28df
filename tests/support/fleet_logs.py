"""A drive as a fleet's vehicles log it."""

from __future__ import annotations

import numpy as np

from cellwise.fleet.store import all_rows
from example_cells import curved_cell
from virtual_tester import logged, planned

ROWS = 900


def drive(seed, soc0, rows=ROWS):
    """A drive after a rest; the voltage is the model's with a millivolt of noise."""
    rng = np.random.default_rng(seed)
    model = curved_cell()
    load = np.repeat(rng.normal(1.2, 2.0, rows // 10), 10)
    load[:60] = 0.0
    log = planned(load, temperature_C=25.0, counter=True)
    return logged(model, log, soc0, rng.normal(0.0, 1e-3, rows))


def rows_in(out):
    """Every row of the parts of a fleet's result, by log; none has two."""
    columns = all_rows(out)
    assert len(set(columns["log"])) == len(columns["log"])
    return {
        log: {name: values[k] for name, values in columns.items()}
        for k, log in enumerate(columns["log"])
    }
