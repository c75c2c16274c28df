"""The extended Kalman filter as scalar code: no matrix calls, no allocation in a step.

While the SOC is well known the transition is taken as diagonal: no state drives another within an
interval, the current drives them all. While it is known to worse than WIDE_VARIANCE, slopes are
chords over one standard deviation to either side, the resistances' slopes join them, and the
covariance after an update is that of the slope where the estimate lands.

The model's voltage error is remembered for minutes, so consecutive voltages repeat the same
evidence. Each is therefore weighed with its variance times the number of samples that share one
error (2 tau / dt: the spectral density of an exponentially correlated error at rest), while the
gate and NIS look at the plain variance of one sample.
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    heat_step,
    polarisation,
    terminal_voltage,
    with_heat,
    with_soc,
)
from cellwise.cell.point_kernels import CellPoint
from cellwise.estimate.evidence_kernels import (
    contradicted_step,
    persistent_step,
    persistent_V,
    stated_deviation,
    voltage_variance,
)
from cellwise.estimate.filters.covariance_kernels import (
    Column,
    Covariance,
    branches_noisy,
    column,
    corrected,
    decayed,
    explained,
    leaned,
    noisy,
    rejudged,
    scaled,
    soc_row,
    uncorrelated,
    with_soc_variance,
)
from cellwise.estimate.filters.drift_kernels import (
    Drift,
    counted_move,
    drift_step,
    drift_variance,
    no_drift,
)
from cellwise.estimate.filters.filter_state import (
    OUT_INNOVATION,
    OUT_RATIO,
    OUT_SOC,
    OUT_STD,
    OUT_VARIANCE,
    OUT_VOLTAGE,
    EkfInfo,
    EkfStart,
    EkfState,
    LogArrays,
    TraceArrays,
    ekf_start,
)
from cellwise.estimate.filters.past_kernels import (
    Past,
    having_looked,
    looked_again,
    looks_now,
    no_past,
    past_step,
    reconsidered,
    reconsiders_now,
    share_of_past,
)
from cellwise.estimate.filters.predict_kernels import (
    SOC_HIGH,
    SOC_LOW,
    begin_interval,
    branch_variance,
    drifted,
    driven_by_soc,
    soc_wander,
    unseen_variance,
)
from cellwise.estimate.gate_kernels import Innovation, Verdict, gate
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.recovery_kernels import Contradiction, Variances, recovered
from cellwise.estimate.sensing_kernels import Reading, Sample, read_sample
from cellwise.estimate.slopes_kernels import WIDE_VARIANCE, Slopes, bends, landing_slope, slopes_at
from cellwise.estimate.status import CLAMPED, OUTSIDE


class Beside(NamedTuple):
    """What is stated of the SOC's error beside P: see the fields of :class:`EkfState`."""

    persistent: float
    contradicted: float
    drift: Drift


@inline
def nothing_beside() -> Beside:
    """After a SOC that was searched for or looked at again."""
    return Beside(0.0, 0.0, no_drift())


class Predicted(NamedTuple):
    """State, covariance and slopes at the end of an interval, before its voltage is used."""

    state: EkfState
    x: CellState
    p: Covariance
    point: CellPoint
    at: Slopes
    warm_C: float
    evidence_s: float
    past: Past
    drift: Drift
    status: int


@inline
def predict(
    tables: CellTables, noise: NoiseScalars, start: EkfStart, state: EkfState, s: Sample
) -> Predicted:
    """Over the interval that ends now: the state with the tables at the new SOC, then P."""
    begun = begin_interval(tables, noise, start, state, s)
    now = begun.now
    point, t = now.point, now.t
    p = branches_noisy(
        decayed(begun.p, t),
        branch_variance(noise, s, point.r1_ohm, t.a1),
        branch_variance(noise, s, point.r2_ohm, t.a2),
        branch_variance(noise, s, point.r3_ohm, t.a3),
    )
    ss = drifted(tables, s, unseen_variance(tables, noise, s, p.ss))
    p = with_soc_variance(p, ss)
    at = slopes_at(tables, now.end.soc, ss, point, now.warm_C, s.seen_A, now.end.slow_A)
    if at.spread > 0.0:
        p = leaned(p, *driven_by_soc(at, t, s.flow_A))
    q = noise.current_A * noise.current_A
    p = noisy(
        p,
        t,
        q,
        q + s.gap_A2,
        soc_wander(noise, begun.state.watch.no_voltage_s, s.dt_s),
        0.0,
        0.0,
        0.0,
    )
    drop = polarisation(point.r0_ohm, s.seen_A, now.end.v1_V, now.end.v2_V, now.end.v3_V)
    heat = heat_step(tables.cell, now.end.heat_K, s.flow_A, drop, s.dt_s)
    x = with_heat(now.end, heat)
    # fmt: off
    return Predicted(
        begun.state, x, p, point, at, now.warm_C, begun.evidence_s, begun.past, begun.drift,
        begun.status,
    )
    # fmt: on


@inline
def innovate(
    tables: CellTables, noise: NoiseScalars, s: Sample, now: Predicted, d: Column
) -> Innovation:
    """Measured less predicted voltage; H = [slope, -1, -1, -1, m], d = P H'."""
    x, point = now.x, now.point
    drop = polarisation(point.r0_ohm, s.seen_A, x.v1_V, x.v2_V, x.v3_V)
    predicted = terminal_voltage(point, x.h, drop)
    # An OCV that bends by c at one standard deviation is off its tangent by c z^2, 3 c^2 in square.
    bend2 = 3.0 * now.at.bend_V * now.at.bend_V
    state_variance = explained(d, now.at.slope_V, point.m_V) + bend2
    branches = abs(x.v1_V) + (abs(x.v2_V) + abs(x.v3_V))
    one = voltage_variance(noise, point, point.r0_ohm, s.seen_A, s.lost_A, branches)
    bent = bends(tables, now.at, bend2, one)
    # fmt: off
    return Innovation(
        predicted, s.voltage_V - predicted, state_variance, one, point.r0_ohm, branches,
        now.p.ss > WIDE_VARIANCE, bent,
    )
    # fmt: on


@inline
def recover(
    tables: CellTables,
    s: Sample,
    x: CellState,
    p: Covariance,
    i: Innovation,
    warm_C: float,
    followed: bool,
) -> tuple[CellState, Covariance]:
    """The gate may have locked the truth out: the SOC is searched for over all of 0..1."""
    drop = abs(i.r0_ohm * s.seen_A) + i.branches_V
    seen = Contradiction(s.voltage_V, s.seen_A, warm_C, i.one, drop, followed)
    soc, v = recovered(tables, x, Variances(p.ss, p.p11, p.p22, p.p33, p.phh), seen)
    return with_soc(x, soc), uncorrelated(v.soc, v.v1_V2, v.v2_V2, v.v3_V2, v.h)


@inline
def moved(x: CellState, k: Column, innovation_V: float) -> CellState:
    """State + k innovation."""
    return CellState(
        x.soc + k.s * innovation_V,
        x.v1_V + k.v1 * innovation_V,
        x.v2_V + k.v2 * innovation_V,
        x.v3_V + k.v3 * innovation_V,
        min(max(x.h + k.h * innovation_V, -1.0), 1.0),
        x.heat_K,
        x.slow_A,
    )


@inline
def update(
    tables: CellTables,
    noise: NoiseScalars,
    s: Sample,
    now: Predicted,
    d: Column,
    v: Verdict,
    i: Innovation,
) -> tuple[CellState, Covariance, Beside]:
    """State, covariance, and what is stated beside it, after an accepted voltage."""
    k = scaled(d, v.inverse)
    x = moved(now.x, k, v.innovation_V)
    p = now.p
    gained = True
    if now.at.spread > 0.0:
        # The gain was that of the slope here; what it is worth is said by the slope where it
        # leads, if that is flatter (Joseph's form): on a plateau nothing was gained.
        move = k.s * v.innovation_V
        # fmt: off
        flat = landing_slope(
            tables, now.x.soc, now.at, now.warm_C, s.seen_A, now.x.slow_A, move
        )
        # fmt: on
        less = flat - now.at.slope_V
        e = less * (2.0 * d.s + less * p.ss)
        c = soc_row(p, less)
        gained = k.s * (k.s * e - 2.0 * c.s) < k.s * d.s
        if gained:
            p = rejudged(p, k, c, e)
    if gained:
        p = corrected(p, k, d)
    beside, move = beside_step(
        noise,
        now.point,
        s,
        v,
        now.state,
        now.drift,
        now.at.slope_V,
        k.s,
        i,
        tables.cell.charge_As,
        now.status,
    )
    return with_soc(x, x.soc + move), p, beside


@inline
def beside_step(
    noise: NoiseScalars,
    point: CellPoint,
    s: Sample,
    v: Verdict,
    old: EkfState,
    drift: Drift,
    slope_V: float,
    gain: float,
    i: Innovation,
    charge_As: float,
    status: int,
) -> tuple[Beside, float]:
    """What is stated beside P, after an accepted voltage that moved the SOC with a ``gain``.

    With what the hypothesis of an offset moves the SOC beside; ``drift`` is before the voltage.
    Beyond the model's data a voltage may contradict the counted charge, but confirms nothing.
    """
    since = old.watch.evidence_s
    contradicted = contradicted_step(
        noise, old.contradicted, v.innovation_V, slope_V, i.one, since, s.dt_s
    )
    if status & OUTSIDE and abs(contradicted) < abs(old.contradicted):
        contradicted = old.contradicted
    stays_V = persistent_V(noise, point, v.mismatch)
    persistent = persistent_step(gain, slope_V, old.persistent, stays_V)
    offset_V = i.r0_ohm * noise.offset_soc_per_s * charge_As
    drift, move = drift_step(
        noise, old.drift, drift, offset_V, v.innovation_V, slope_V, gain, v.inverse
    )
    return Beside(persistent, contradicted, drift), move


@inline
def counted(x: CellState, old: EkfState, drift: Drift) -> tuple[CellState, Beside]:
    """An interval without a voltage: what is believed of an offset goes on."""
    x = with_soc(x, x.soc + counted_move(old.drift, drift))
    return x, Beside(old.persistent, old.contradicted, drift)


@inline
def look_again(
    tables: CellTables,
    noise: NoiseScalars,
    s: Sample,
    warm_C: float,
    before_s: float,
    past: Past,
    v: Verdict,
    x: CellState,
    p: Covariance,
    beside: Beside,
) -> tuple[CellState, Covariance, Beside, Past]:
    """What becomes of a start under load ``before_s`` after its first voltage, an interval ago."""
    if past.first_variance > 0.0:
        since = v.watch.evidence_s
        past = past_step(tables.cell, past, s, since, v.used, v.innovation_V)
        if v.recover:
            past = no_past()
        if past.first_variance > 0.0 and looks_now(before_s, since):
            x, p = looked_again(tables, noise, past, warm_C, x, p, since)
            beside = nothing_beside()
            past = having_looked(past, since)
        if past.first_variance > 0.0 and reconsiders_now(before_s, since):
            more_V, variance = reconsidered(tables, past, warm_C, x, since)
            if variance > 0.0:
                k = Column(p.s3, p.p13, p.p23, p.p33, p.p3h)
                x = moved(x, scaled(k, share_of_past(p.p33, variance)), more_V)
            past = having_looked(past, since)
    return x, p, beside, past


@inline
def finish(
    x: CellState,
    p: Covariance,
    beside: Beside,
    past: Past,
    i: Innovation,
    v: Verdict,
    status: int,
) -> tuple[EkfState, EkfInfo]:
    """SOC held within 0..1, and what there is to report."""
    soc = x.soc
    if soc < SOC_LOW or soc > SOC_HIGH:
        soc = min(max(soc, SOC_LOW), SOC_HIGH)
        status |= CLAMPED
    # fmt: off
    state = EkfState(
        with_soc(x, soc), p, v.rejections, v.mismatch, beside.persistent, beside.contradicted,
        beside.drift, v.watch, past,
    )
    # fmt: on
    known = p.ss + drift_variance(beside.drift)
    std = stated_deviation(known, v.mismatch, beside.persistent, beside.contradicted)
    info = EkfInfo(soc, std, i.predicted_V, v.innovation_V, v.variance, v.ratio, status)
    return state, info


@inline
def ekf_step_inline(
    tables: CellTables, noise: NoiseScalars, start: EkfStart, state: EkfState, reading: Reading
) -> tuple[EkfState, EkfInfo]:
    """One step: predict over the interval that ends now, then use the voltage read now."""
    s = read_sample(tables, noise, state.watch, start.temperature_C, reading)
    now = predict(tables, noise, start, state, s)
    d = column(now.p, now.at.slope_V, now.point.m_V)
    i = innovate(tables, noise, s, now, d)
    old = now.state
    # fmt: off
    v = gate(
        tables.cell, noise, old.watch, s, now.evidence_s, old.rejections, old.mismatch, i
    )
    # fmt: on
    p = now.p
    x, beside = counted(now.x, old, now.drift)
    if v.recover:
        x, p = recover(tables, s, now.x, p, i, now.warm_C, now.evidence_s >= 0.0)
        beside = nothing_beside()
    elif v.accepted:
        x, p, beside = update(tables, noise, s, now, d, v, i)
    # fmt: off
    x, p, beside, past = look_again(
        tables, noise, s, now.warm_C, now.evidence_s, now.past, v, x, p, beside
    )
    # fmt: on
    return finish(x, p, beside, past, i, v, s.status | now.status | v.status)


@kernel
def ekf_step(
    tables: CellTables, noise: NoiseScalars, start: EkfStart, state: EkfState, reading: Reading
) -> tuple[EkfState, EkfInfo]:
    """One step for online use."""
    return ekf_step_inline(tables, noise, start, state, reading)


@inline
def put_info(out: TraceArrays, k: int, info: EkfInfo) -> None:
    """One row of a trace."""
    out.values[OUT_SOC, k] = info.soc
    out.values[OUT_STD, k] = info.soc_std
    out.values[OUT_VOLTAGE, k] = info.voltage_V
    out.values[OUT_INNOVATION, k] = info.innovation_V
    out.values[OUT_VARIANCE, k] = info.innovation_variance_V2
    out.values[OUT_RATIO, k] = info.test_ratio
    out.status[k] = info.status


@inline
def reading_of(log: LogArrays, k: int) -> Reading:
    """What the sensors say in one row."""
    return Reading(
        log.current_A[k], log.voltage_V[k], log.temperature_C[k], log.dt_s[k], log.gap[k]
    )


@rows
def ekf_rows(
    tables: CellTables,
    noise: NoiseScalars,
    first: EkfStart,
    start: EkfStart,
    log: LogArrays,
    out: TraceArrays,
) -> EkfState:
    """Every row of a log through one step each; ``start`` re-initialises a state gone wrong."""
    state = ekf_start(first, log.current_A[0])
    for k in range(log.dt_s.size):
        state, info = ekf_step_inline(tables, noise, start, state, reading_of(log, k))
        put_info(out, k, info)
    return state
