"""The adaptive filter's start under load, looked at again as the other filters' is."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.equations import CellState, CellTables
from cellwise.estimate.adaptive.covariance_kernels import leaned, uncorrelated, with_parameters
from cellwise.estimate.adaptive.predict_kernels import Predicted
from cellwise.estimate.adaptive.state_kernels import Estimate
from cellwise.estimate.filters.past_kernels import (
    Past,
    looked_for_long,
    looks_now,
    no_past,
    past_step,
    soc_of_level,
)
from cellwise.estimate.gate_kernels import Verdict
from cellwise.estimate.noise import NoiseScalars


@inline
def look_again(
    tables: CellTables,
    noise: NoiseScalars,
    now: Predicted,
    v: Verdict,
    own_V: float,
    e: Estimate,
    persistent: float,
) -> tuple[Estimate, float, Past]:
    """What becomes of a start under load an interval after ``now.evidence_s``.

    ``own_V`` is the innovation that the model's own resistances would have shown. Offset and
    capacity keep what they are known to.
    """
    past = now.past
    if past.first_variance > 0.0:
        since = v.watch.evidence_s
        past = past_step(tables.cell, past, now.s, since, v.used, own_V)
        if v.recover:
            past = no_past()
        if past.first_variance > 0.0 and looks_now(now.evidence_s, since):
            x, p = e.x, e.p
            # fmt: off
            soc, ss, v3, p33, s3 = soc_of_level(
                tables, noise, past, now.warm_C, x, since, p.phh
            )
            # fmt: on
            apart = uncorrelated(ss, p.p11, p.p22, p33 - s3 * s3 / ss, p.phh, p.poo, p.pqq)
            p = with_parameters(leaned(apart, 0.0, 0.0, s3 / ss), p.poo, p.poq, p.pqq)
            x = CellState(soc, x.v1_V, x.v2_V, v3, x.h, x.heat_K, x.slow_A)
            e = Estimate(x, e.offset_A, e.charge, p)
            persistent = 0.0
            if looked_for_long(since):
                past = no_past()
    return e, persistent, past
