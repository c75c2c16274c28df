"""The adaptive filter's start under load, looked at again as the other filters' is."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.equations import CellState, CellTables
from cellwise.estimate.adaptive.covariance_kernels import (
    AdaptiveColumn,
    AdaptiveCovariance,
    leaned,
    uncorrelated,
    with_parameters,
)
from cellwise.estimate.adaptive.predict_kernels import Predicted
from cellwise.estimate.adaptive.state_kernels import CHARGE_HIGH, CHARGE_LOW, Estimate, Persistent
from cellwise.estimate.filters.covariance_kernels import Column
from cellwise.estimate.filters.ekf_kernels import moved as cell_moved
from cellwise.estimate.filters.past_kernels import (
    Past,
    having_looked,
    looks_now,
    no_past,
    past_step,
    soc_of_level,
)
from cellwise.estimate.gate_kernels import Verdict
from cellwise.estimate.noise import NoiseScalars


@inline
def moved(e: Estimate, p: AdaptiveCovariance, k: AdaptiveColumn, by: float) -> Estimate:
    """Estimate + k times an innovation, with its new covariance."""
    cell = cell_moved(e.x, Column(k.s, k.v1, k.v2, k.v3, k.h), by)
    charge = min(max(e.charge + k.q * by, CHARGE_LOW), CHARGE_HIGH)
    return Estimate(cell, e.offset_A + k.o * by, charge, p)


@inline
def look_again(
    tables: CellTables,
    noise: NoiseScalars,
    now: Predicted,
    v: Verdict,
    own_V: float,
    e: Estimate,
    persistent: Persistent,
) -> tuple[Estimate, Persistent, Past]:
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
            persistent = Persistent(0.0, persistent.offset_A, persistent.charge)
            past = having_looked(past, since)
    return e, persistent, past
