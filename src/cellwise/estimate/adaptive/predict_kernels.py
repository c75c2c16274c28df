"""The adaptive filter's prediction: the state over an interval, then its covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import CellState, CellTables, soc_step
from cellwise.cell.point_kernels import CellPoint
from cellwise.estimate.adaptive.covariance_kernels import (
    AdaptiveCovariance,
    branches_noisy,
    charge_column,
    charge_driven,
    corrected,
    decayed,
    leaned,
    noisy,
    offset_column,
    offset_driven,
    scaled,
    uncorrelated,
    with_soc_variance,
)
from cellwise.estimate.adaptive.state_kernels import (
    AdaptiveScalars,
    AdaptiveState,
    Persistent,
    adaptive_start,
    is_sound,
    settled_variance,
)
from cellwise.estimate.filters.filter_state import EkfStart
from cellwise.estimate.filters.past_kernels import Past, past_at_start
from cellwise.estimate.filters.predict_kernels import (
    branch_variance,
    drifted,
    driven_by_soc,
    over_interval,
    soc_walk,
    unseen_variance,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import NO_VOLTAGE_YET, NOT_BEGUN, Sample
from cellwise.estimate.slopes_kernels import Slopes, slopes_at
from cellwise.estimate.status import OUTSIDE, STATE_RESET

FORGET_S = 10.0


class Predicted(NamedTuple):
    """What the prediction hands to the update; ``s`` is the sample without the sensor's offset."""

    state: AdaptiveState
    s: Sample
    x: CellState
    p: AdaptiveCovariance
    point: CellPoint
    at: Slopes
    warm_C: float
    evidence_s: float
    past: Past
    persistent: Persistent
    status: int


@inline
def without_offset(s: Sample, offset_A: float) -> Sample:
    """The sample less what the sensor adds; nothing is counted where nobody knows what flowed.

    A current that is lost has no offset, either.
    """
    known = 0.0 if s.gap or s.lost_A > 0.0 else 1.0
    seen = s.seen_A if s.lost_A > 0.0 else s.seen_A - offset_A
    # fmt: off
    return Sample(
        s.current_A, seen, known * (s.flow_A - offset_A), s.gap_A2, s.lost_A,
        s.voltage_V, s.temperature_C, s.no_current_s, s.no_warm_s, s.dt_s, s.gap, s.status,
    )
    # fmt: on


@inline
def forgets_for(evidence_s: float, dt_s: float) -> float:
    """Time whose wandering an interval forgets, ``evidence_s`` after the first voltage [s].

    Wandering is slow and takes a rank-one update of P for either parameter: once in FORGET_S.
    """
    if dt_s >= FORGET_S:
        return dt_s
    before = max(evidence_s, 0.0) / FORGET_S
    return FORGET_S if math.floor(before + dt_s / FORGET_S) > math.floor(before) else 0.0


@inline
def forgotten(p: AdaptiveCovariance, offset_A2: float, charge2: float) -> AdaptiveCovariance:
    """Offset and capacity wander: what was known of them is forgotten by so much variance.

    What the states would be at any fixed offset and capacity stays what it was, so a hypothesis
    with both at the model's values knows nothing of their wandering.
    """
    if offset_A2 > 0.0 and p.poo > 0.0:
        d = offset_column(p)
        p = corrected(p, scaled(d, -offset_A2 / (p.poo * p.poo)), d)
    if charge2 > 0.0 and p.pqq > 0.0:
        d = charge_column(p)
        p = corrected(p, scaled(d, -charge2 / (p.pqq * p.pqq)), d)
    return p


@inline
def predict(
    tables: CellTables,
    noise: NoiseScalars,
    rules: AdaptiveScalars,
    start: EkfStart,
    state: AdaptiveState,
    raw: Sample,
) -> Predicted:
    """Over the interval that ends now: the state with the tables at the new SOC, then P."""
    cell = tables.cell
    status = 0
    s = without_offset(raw, state.offset_A)
    soc = soc_step(cell, state.cell.soc, state.charge * s.flow_A, s.dt_s)
    if not is_sound(soc, state.p):
        state = adaptive_start(start, rules, raw.current_A)
        soc = state.cell.soc
        s = without_offset(raw, 0.0)
        status = STATE_RESET
    p = state.p
    evidence = state.watch.evidence_s
    past = state.past
    now = over_interval(tables, noise, state.cell, soc, s, evidence == NOT_BEGUN)
    status |= now.status
    if evidence == NOT_BEGUN:
        p = uncorrelated(p.ss, now.v11, now.v22, now.v33, p.phh, p.poo, p.pqq)
        evidence = NO_VOLTAGE_YET
        past = past_at_start(cell, s, soc, p.ss)
    point, t, end = now.point, now.t, now.end

    # One ampere of offset is one ampere that did not flow; a share of charge, one of what flowed.
    counts = 0.0 if s.gap or s.lost_A > 0.0 else 1.0
    per_A = t.gs * (1.0 if s.flow_A > 0.0 else cell.charge_efficiency)
    p = offset_driven(
        decayed(p, t),
        -counts * state.charge * per_A,
        -counts * t.g1,
        -counts * t.g2,
        -counts * t.g3,
    )
    # Beyond the model's data no voltage can separate a capacity from the model's error.
    judged_A = 0.0 if now.status & OUTSIDE else per_A * s.flow_A
    p = charge_driven(p, judged_A)
    p = branches_noisy(
        p,
        branch_variance(noise, s, point.r1_ohm, t.a1),
        branch_variance(noise, s, point.r2_ohm, t.a2),
        branch_variance(noise, s, point.r3_ohm, t.a3),
    )
    ss = drifted(tables, s, unseen_variance(tables, noise, s, p.ss))
    p = with_soc_variance(p, ss)
    # A SOC that is unsure only because offset and capacity are free is no start that is far off:
    # chords would then lead the hypotheses with both fixed astray, too.
    at = slopes_at(tables, soc, settled_variance(p), point, now.warm_C, s.seen_A, end.slow_A)
    if at.spread > 0.0:
        p = leaned(p, *driven_by_soc(at, t, s.flow_A))
    q = noise.current_A * noise.current_A
    p = noisy(p, t, q, q + s.gap_A2, soc_walk(noise, s.dt_s), 0.0, 0.0, 0.0)
    stays = state.persistent
    moved = stays.charge * judged_A - counts * state.charge * per_A * stays.offset_A
    stays = Persistent(stays.soc + moved, stays.offset_A, stays.charge)
    forget_s = forgets_for(evidence, s.dt_s)
    if forget_s > 0.0:
        p = forgotten(p, rules.offset_walk * forget_s, rules.charge_walk * forget_s)
    return Predicted(state, s, end, p, point, at, now.warm_C, evidence, past, stays, status)
