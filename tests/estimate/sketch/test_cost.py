"""What a sketch adds to a step on a target, counted in an emulator."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.cross import has_tools, run_on_target
from example_cells import curved_cell

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not has_tools("cortex-m4f"), reason="no cross tools: make firmware"),
]
EVERY = 16  # beside rows every 15 steps: every step between two rows in turn


@pytest.mark.parametrize("core", ["cortex-m4f", "cortex-m0plus"])
@pytest.mark.parametrize(
    ("most", "wide"),
    [
        (256, True),
        (1024, True),
        pytest.param(1024, False, marks=pytest.mark.xfail(reason="28 and 20 %", strict=True)),
    ],
)
def test_a_sketch_costs_at_most_15_percent_of_a_step(core, most, wide):
    model = curved_cell()
    samples = samples_of(model, load_dataset("nmc_drive_b"), 1.0).records[:5000]
    samples["sequence"] = np.arange(samples.size)

    def cost(of, **asked):
        tables = fixed_step_tables(model, 1.0, points=101, wide=wide, **asked)
        run = run_on_target(tables, core, samples, 0.9, 1e-4, measure_every=EVERY, of=of)
        return run.cost.instructions_mean

    assert 0.0 < cost("sketch", sketch=most) <= 0.15 * cost("step")
