"""A start that nobody knows: filters side by side over the SOC, weighed by what they predict.

A sum of Gaussians (D. Alspach, H. Sorenson, IEEE Trans. Automatic Control 17 (1972) 439,
doi:10.1109/TAC.1972.1100034). Each component knows its SOC well enough for slopes; what the
branches hold it has to find. Once the components agree, the estimate goes on alone; where its
voltages contradict it for long, or nobody knows what flowed, they begin again.

A filter that begins under load knows neither the SOC nor what a slow branch holds, and in the cold
both move the voltage alike. What flowed before is taken to be like what flows after: said once a
minute of the load is known, and better twice, each four times as long after the start.

The C of the fixed step does the same (:mod:`cellwise.estimate.fixed.bank`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import inline, part
from cellwise.cell.description import BRANCHES, CELL, V3
from cellwise.cell.equations import CellState, CellTables, loaded, rc_step
from cellwise.cell.packed import changed, place_of, put_record, record_at, size_of
from cellwise.cell.point_kernels import CellScalars
from cellwise.cell.unrolled import ByState, unrolled
from cellwise.estimate.equations.components import (
    component_from,
    component_update,
    cost_of_past,
    evidence_share,
    kept_cost,
    mixture_variance,
    parts_before,
    past_of,
    soc_on_way,
)
from cellwise.estimate.equations.constants import (
    BANK_RATE,
    GIVEN_UP,
    LEAST_USE_RATE,
    LOAD_LIMIT_V,
    LOOK_FACTOR,
    LOOK_S,
    LOOKS,
    PAST_PART,
    PAST_RATE,
    PERSISTENT_MOST,
    RECOVERY_RATE,
    RECOVERY_VARIANCE,
    REST_RATE,
    SPREAD_VARIANCE,
    WIDE_VARIANCE,
)
from cellwise.estimate.equations.evidence import as_shown
from cellwise.estimate.equations.start import held_variance
from cellwise.estimate.evidence_kernels import (
    InnovationSources,
    Verdict,
    mismatch_step,
    repeated_evidence,
    stated_deviation,
)
from cellwise.estimate.filters.covariance_kernels import (
    Branches,
    Column,
    corrected,
    moved,
    scaled,
    uncorrelated,
)
from cellwise.estimate.filters.drift_kernels import drift_variance, no_drift
from cellwise.estimate.filters.filter_state import EkfInfo, EkfStart, EkfState
from cellwise.estimate.filters.predict_kernels import RESTED_V2
from cellwise.estimate.filters.sigma_kernels import SigmaScalars
from cellwise.estimate.filters.step_kernels import innovate, predict, say
from cellwise.estimate.filters.update_kernels import counted, update
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    NOT_BEGUN_S,
    CheckedReading,
    MeasuredSample,
    read_sample,
    watch_on,
    watch_voltage,
)
from cellwise.estimate.status import (
    CURRENT_LOST,
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    SEQUENCE_GAP,
    VOLTAGE_INVALID,
)
from cellwise.typing import FloatArray

COMPONENTS = 11  # with 7 to 31 of them errors differ by less than their scatter


class BankRecord(NamedTuple):
    """What a bank carries beside its states.

    ``spread`` says that the components are stepped, and not the estimate alone; ``likeliest`` is
    one of them, from 1 on. Since a start ``since_s`` ago the mean current was ``mean_A``,
    ``looked_A`` at the last of ``looks`` at the past; the next is due at ``next_s``.
    """

    spread: float
    likeliest: float
    mismatch: float
    since_s: float
    mean_A: float
    looked_A: float
    looks: float
    next_s: float


LIKELIEST_AT, OFF_AT, LOOKS_AT = (
    place_of(BankRecord, name) for name in ("likeliest", "mismatch", "looks")
)
NEVER_SPREAD = BankRecord(0.0, 1.0, 1.0, 0.0, 0.0, 0.0, float(LOOKS), 0.0)

# A bank in memory: the estimate, the components, the record, one in each row. Behind a state
# stand its cost, minus the logarithm of its likelihood beside the likeliest's, and its weight.
FIELDS = size_of(EkfState)
COST, WEIGHT = FIELDS, FIELDS + 1
STATES = len(CELL)  # the first numbers of a state
P_AT, PERSISTENT_AT, MISMATCH_AT = (
    place_of(EkfState, name) for name in ("p", "persistent", "mismatch")
)
RECORD = -1  # the last row


def empty_bank(components: int = COMPONENTS) -> FloatArray:
    """Memory of a bank, shape (components and 2, numbers of a state and 2)."""
    return np.zeros((components + 2, FIELDS + 2))


@inline
def end_of(bank: FloatArray) -> int:
    """Behind the last component."""
    return int(bank.shape[0]) - 1


@inline
def state_in(bank: FloatArray, k: int) -> EkfState:
    """The estimate (0) or a component (1 on)."""
    state: EkfState = record_at(EkfState, bank[k], 0, 1)
    return state


@inline
def record_of(bank: FloatArray) -> BankRecord:
    """What is carried beside the states."""
    record: BankRecord = record_at(BankRecord, bank[RECORD], 0, 1)
    return record


@inline
def is_spread(bank: FloatArray) -> bool:
    """Whether components are stepped."""
    return bool(bank[RECORD, 0] > 0.0)


@inline
def begin_alone(bank: FloatArray, state: EkfState) -> None:
    """The estimate alone."""
    put_record(bank[0], 0, 1, state, True)
    put_record(bank[RECORD], 0, 1, NEVER_SPREAD, True)


@part
def weigh_components(bank: FloatArray, least: float) -> None:
    """Weights that add up to one; the likeliest component costs nothing."""
    total = 0.0
    for k in range(1, end_of(bank)):
        bank[k, COST] = kept_cost(bank[k, COST] - least)
        bank[k, WEIGHT] = math.exp(-bank[k, COST])
        total += bank[k, WEIGHT]
    for k in range(1, end_of(bank)):
        bank[k, WEIGHT] /= total


@part
@unrolled
def spread_out(bank: FloatArray, state: EkfState) -> None:
    """Components over all of the SOC, densely about a state; all else is as it is.

    A start under load is yet to be looked at.
    """
    p, x, begun = state.p, state.cell, state.watch.evidence_s != NOT_BEGUN_S
    soc, std = min(max(x.soc, 0.0), 1.0), math.sqrt(p.ss)
    likeliest, least = 1, math.inf
    apart = 2.0 / (end_of(bank) - 1)
    for k in range(1, end_of(bank)):
        begins = component_from(apart * (k - 1) - 1.0, apart, soc, p.ss, std)
        h = x.h if begun else (1.0 if begins.soc > 0.5 else -1.0)
        one = changed(changed(x, "soc", begins.soc), "h", h)
        narrow = uncorrelated(begins.variance, Branches(*(p[i, i] for i in BRANCHES)), p.phh)
        put_record(bank[k], 0, 1, changed(changed(state, "cell", one), "p", narrow), True)
        bank[k, COST] = begins.cost
        if bank[k, COST] < least:
            likeliest, least = k, bank[k, COST]
    weigh_components(bank, least)
    looks = float(LOOKS) if begun else 0.0
    # fmt: off
    put_record(
        bank[RECORD], 0, 1,
        BankRecord(1.0, float(likeliest), state.mismatch, 0.0, 0.0, 0.0, looks, LOOK_S), True,
    )
    # fmt: on
    put_record(bank[0], 0, 1, state, True)


@inline
def begin_bank(bank: FloatArray, state: EkfState) -> None:
    """A cell that nobody has seen yet, or the estimate alone where its start is known."""
    unknown = state.p.ss > WIDE_VARIANCE and math.isfinite(state.cell.soc)
    if unknown and end_of(bank) > 2:
        spread_out(bank, state)
    else:
        begin_alone(bank, state)


@part
@unrolled
def loosened(tables: CellTables, start: EkfStart, state: EkfState) -> EkfState:
    """After voltages that contradicted it for long the SOC is open, branches may hold anything."""
    x: ByState = state.cell
    p = state.p
    held_A = RECOVERY_RATE * tables.cell.charge_As / 3600.0
    warm_C = state.watch.temperature_C
    if not math.isfinite(warm_C):
        warm_C = start.temperature_C
    at: ByState = loaded(tables, x.soc, warm_C, state.watch.current_A, x.slow_A)
    v = Branches(
        *(
            held_variance(RESTED_V2, at.r[i], held_A, LOAD_LIMIT_V) + x.state[i] * x.state[i]
            for i in BRANCHES
        )
    )
    state = changed(changed(state, "persistent", 0.0), "contradicted", 0.0)
    state = changed(state, "drift", no_drift())
    return changed(state, "p", uncorrelated(max(p.ss, RECOVERY_VARIANCE), v, p.phh))


@inline
def begin_again(
    tables: CellTables, start: EkfStart, bank: FloatArray, state: EkfState, status: int
) -> EkfState:
    """After a step alone: the state, with components around it where they have to begin again."""
    if status & GATE_RECOVERY:
        state = loosened(tables, start, state)
        if end_of(bank) > 2:
            spread_out(bank, state)
        return state
    seen = state.watch.evidence_s >= 0.0 and state.watch.no_voltage_s == 0.0
    uncounted = status & (SEQUENCE_GAP | CURRENT_LOST) != 0
    if seen and uncounted and state.p.ss > SPREAD_VARIANCE and end_of(bank) > 2:
        spread_out(bank, state)
    return state


@part
def gather(bank: FloatArray) -> EkfState:
    """The estimate: mean and covariance of the whole bank; the rest is the likeliest one's."""
    main, likeliest = bank[0], int(bank[RECORD, LIKELIEST_AT])
    for i in range(FIELDS):
        main[i] = bank[likeliest, i]
    main[PERSISTENT_AT] = 0.0
    main[MISMATCH_AT] = bank[RECORD, OFF_AT]
    for i in range(STATES):
        main[i] = 0.0
        for k in range(1, end_of(bank)):
            main[i] += bank[k, WEIGHT] * bank[k, i]
    main[0] = min(max(main[0], 0.0), 1.0)  # weights add up to one but for rounding
    for k in range(1, end_of(bank)):
        main[PERSISTENT_AT] += bank[k, WEIGHT] * bank[k, PERSISTENT_AT]
    entry = P_AT
    for i in range(STATES):
        for j in range(i, STATES):
            main[entry] = 0.0
            for k in range(1, end_of(bank)):
                away = (bank[k, i] - main[i]) * (bank[k, j] - main[j])
                main[entry] += bank[k, WEIGHT] * (bank[k, entry] + away)
            entry += 1
    if main[P_AT] <= WIDE_VARIANCE and bank[RECORD, LOOKS_AT] >= LOOKS:
        put_record(bank[RECORD], 0, 1, NEVER_SPREAD, True)
    return state_in(bank, 0)


@part
def left_by_load(
    tables: CellTables, mean_A: float, soc: float, temperature_C: float, slow_A: float
) -> float:
    """What a load from full, or a charge from empty, has left in the slow branch at a SOC [V]."""
    size = max(abs(mean_A), LEAST_USE_RATE * tables.cell.charge_As / 3600.0)
    flowed_A = size if mean_A >= 0.0 else -size
    step_s = PAST_PART * tables.cell.charge_As / size
    before = 0.0
    for k in range(1, int(parts_before(soc, mean_A)) + 1):
        at = loaded(tables, soc_on_way(float(k), mean_A), temperature_C, mean_A, slow_A)
        before = rc_step(before, flowed_A, at.r3_ohm, at.tau3_s, step_s)
    return before


@inline
def past_A(cell: CellScalars) -> float:
    """What may have flowed before a start beside a load like the one after it [A]."""
    return PAST_RATE * cell.charge_As / 3600.0


@inline
def held_within(x: CellState) -> CellState:
    """SOC held within 0..1."""
    return changed(x, "soc", min(max(x.soc, 0.0), 1.0))


@part
@unrolled
def know_past(
    tables: CellTables, state: EkfState, temperature_C: float, since_s: float, mean_A: float
) -> tuple[EkfState, float]:
    """A load under which a log begins was there before: what it has left in the slow branch.

    Half of that, and a twentieth of a rate, may be otherwise. It is knowledge of the start that
    comes late: the slow branch has been followed from nothing known. Returns the state, and what
    it says against the component.
    """
    x, p = state.cell, state.p
    at = loaded(tables, x.soc, temperature_C, mean_A, x.slow_A)
    if at.r3_ohm <= 0.0:
        return state, 0.0
    before = left_by_load(tables, mean_A, x.soc, temperature_C, x.slow_A)
    left = math.exp(-since_s / at.tau3_s)
    past = past_of(at.r3_ohm, 1.0 - left, mean_A, before, past_A(tables.cell))
    variance = p[V3, V3] + past.variance_V2
    off = past.held_V - x.v3_V
    d = Column(*(p[i, V3] for i in CELL))
    k = scaled(d, 1.0 / variance)
    cost = cost_of_past(off, variance)
    return changed(
        changed(state, "cell", held_within(moved(x, k, off))), "p", corrected(p, k, d)
    ), cost


@part
@unrolled
def know_past_better(
    tables: CellTables,
    state: EkfState,
    temperature_C: float,
    since_s: float,
    mean_A: float,
    before_A: float,
) -> EkfState:
    """A longer mean of the load says more of the past: what that moves in the slow branch.

    What has been taken for the branch's and was not is the SOC's, as far as they go together.
    """
    x, p = state.cell, state.p
    at = loaded(tables, x.soc, temperature_C, mean_A, x.slow_A)
    if at.r3_ohm <= 0.0:
        return state
    taken = left_by_load(tables, before_A, x.soc, temperature_C, x.slow_A)
    held = left_by_load(tables, mean_A, x.soc, temperature_C, x.slow_A)
    left = math.exp(-since_s / at.tau3_s)
    past = past_of(at.r3_ohm, 1.0 - left, 0.0, taken, past_A(tables.cell))
    k = scaled(Column(*(p[i, V3] for i in CELL)), 1.0 / max(past.variance_V2, p[V3, V3]))
    return changed(state, "cell", held_within(moved(x, k, left * (held - taken))))


@part
def look_back(tables: CellTables, bank: FloatArray, s: CheckedReading, first: bool) -> None:
    """The mean of the load since a start under load, and what it says of the past, three times."""
    b = record_of(bank)
    resting = abs(s.seen_A) * 3600.0 < REST_RATE * tables.cell.charge_As
    if b.looks >= LOOKS:
        return
    if s.gap or (first and resting):  # nobody knows what flowed; a cell at rest needs no look
        bank[RECORD, LOOKS_AT] = LOOKS
        return
    if first:
        for k in range(1, end_of(bank)):
            state = state_in(bank, k)
            at = loaded(tables, state.cell.soc, s.temperature_C, s.seen_A, state.cell.slow_A)
            wide_V = BANK_RATE * tables.cell.charge_As / 3600.0 * at.r3_ohm
            p = changed(state.p, "p33", state.p.p33 + wide_V * wide_V)
            put_record(bank[k], 0, 1, changed(state, "p", p), True)
        return
    if s.dt_s <= 0.0:
        return
    since_s = b.since_s + s.dt_s
    mean_A = b.mean_A + (s.current_A - b.mean_A) * (s.dt_s / since_s)
    looks, looked_A, next_s = b.looks, b.looked_A, b.next_s
    if since_s >= next_s:
        for k in range(1, end_of(bank)):
            if bank[k, COST] < GIVEN_UP:
                state = state_in(bank, k)
                warm_C = s.temperature_C + state.cell.heat_K
                if looks == 0.0:
                    state, cost = know_past(tables, state, warm_C, since_s, mean_A)
                    bank[k, COST] += cost
                else:
                    state = know_past_better(tables, state, warm_C, since_s, mean_A, looked_A)
                put_record(bank[k], 0, 1, state, True)
        looks, looked_A, next_s = looks + 1.0, mean_A, next_s * LOOK_FACTOR
    now = BankRecord(1.0, b.likeliest, b.mismatch, since_s, mean_A, looked_A, looks, next_s)
    put_record(bank[RECORD], 0, 1, now, True)


class Seen(NamedTuple):
    """What a component makes of a sample: how the voltage weighs, what it says against it."""

    verdict: Verdict
    cost: float


@inline
def new_share(noise: NoiseScalars, since_s: float) -> float:
    """How much of a voltage's evidence is new, ``since_s`` after the first."""
    if noise.slow_s <= 0.0:
        return 1.0
    stays = min(noise.persistent * noise.persistent, PERSISTENT_MOST)
    shared_s = 2.0 * noise.slow_s
    return evidence_share((1.0 - stays) * shared_s, stays, shared_s, max(since_s, 0.0))


@inline
def use_in_bank(
    cell: CellScalars,
    noise: NoiseScalars,
    state: EkfState,
    s: CheckedReading,
    evidence_s: float,
    i: InnovationSources,
    error_V2: float,
    mismatch: float,
) -> Seen:
    """A voltage to a component: none is rejected, each moves by what the gate lets pass.

    The variance of a voltage is that of the likeliest component, for all: one whose tables state
    a larger error must not explain everything.
    """
    variance = i.state_variance + (i.one + i.free_variance)
    innovation_V, square = i.innovation_V, i.innovation_V * i.innovation_V
    last, swings, frozen = watch_voltage(noise, state.watch, s, innovation_V, i.r0_ohm)
    used = math.isfinite(innovation_V) and frozen == 0
    inverse, cost, ratio = 0.0, 0.0, math.nan
    if used:
        ratio = square / variance * noise.per_gate2
        resting = abs(s.seen_A) * 3600.0 < REST_RATE * cell.charge_As
        shared = repeated_evidence(noise, evidence_s, s.dt_s, resting)
        weight = as_shown(error_V2 * shared.above, mismatch)
        innovation_V, inverse, cost = component_update(
            innovation_V, variance, noise.gate * noise.gate,
            i.state_variance, weight, shared.below, new_share(noise, evidence_s),
        )  # fmt: skip
        evidence_s = max(evidence_s, 0.0)
    if evidence_s >= 0.0:
        evidence_s += s.dt_s
    after, away = watch_on(noise, s, used, evidence_s, state.watch.no_voltage_s, last, swings)
    status = frozen | away
    if not math.isfinite(innovation_V):
        status |= VOLTAGE_INVALID
    # fmt: off
    v = Verdict(
        used, used, inverse, innovation_V, variance, ratio, 0.0, mismatch, after, status
    )
    # fmt: on
    return Seen(v, cost)


@part
def step_component(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    start: EkfStart,
    state: EkfState,
    s: CheckedReading,
    error_V2: float,
    mismatch: float,
) -> tuple[EkfState, EkfInfo, float, float]:
    """A component over an interval: state, info, its cost, variance of one voltage."""
    now = predict(tables, noise, sigma, None, start, state, None, s)
    i, seen = innovate(tables, noise, sigma, s, now)
    if error_V2 <= 0.0:
        error_V2 = i.one
    # fmt: off
    used = use_in_bank(
        tables.cell, noise, now.state, s, now.evidence_s, i, error_V2, mismatch
    )
    # fmt: on
    v = used.verdict
    e = update(noise, None, s, now, seen, i, v) if v.accepted else counted(now)
    after, info = say(i, v, e, s.status | now.status | v.status)
    return after, info, used.cost, error_V2


@part
def step_bank(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    start: EkfStart,
    bank: FloatArray,
    reading: MeasuredSample,
) -> EkfInfo:
    """Every component over one interval, the likeliest first; the estimate is in the first row."""
    b = record_of(bank)
    main = state_in(bank, int(b.likeliest))
    s = read_sample(tables, noise, main.watch, start.temperature_C, reading)
    first = main.watch.evidence_s == NOT_BEGUN_S
    error_V2, status, likeliest, least = 0.0, 0, int(b.likeliest), math.inf
    mean_V, square_V2, variance, first_V = 0.0, 0.0, 0.0, 0.0
    for turn in range(end_of(bank) - 1):
        k = likeliest if turn == 0 else (turn if turn < likeliest else turn + 1)
        if bank[k, COST] >= GIVEN_UP:
            continue
        # fmt: off
        after, info, cost, error_V2 = step_component(
            tables, noise, sigma, start, state_in(bank, k), s, error_V2, b.mismatch
        )
        # fmt: on
        put_record(bank[k], 0, 1, after, True)
        bank[k, COST] += cost
        if turn == 0:
            status, first_V = info.status, info.voltage_V
        away_V, weight = info.voltage_V - first_V, bank[k, WEIGHT]
        mean_V += weight * away_V
        square_V2 += weight * away_V * away_V
        variance += weight * info.innovation_variance_V2
    variance = mixture_variance(variance, mean_V, square_V2)
    predicted_V = first_V + mean_V
    off = s.voltage_V - predicted_V
    if math.isfinite(off):
        mismatch = mismatch_step(noise, b.mismatch, off * off, variance, s.dt_s) / variance
        bank[RECORD, OFF_AT] = mismatch
    look_back(tables, bank, s, first)
    if state_in(bank, likeliest).watch.evidence_s < 0.0:  # no voltage yet: as it was stated
        after, info, _, _ = step_component(
            tables, noise, sigma, start, state_in(bank, 0), s, error_V2, b.mismatch
        )
        put_record(bank[0], 0, 1, after, True)
        return info
    for k in range(1, end_of(bank)):
        if bank[k, COST] < least:
            likeliest, least = k, bank[k, COST]
    bank[RECORD, LIKELIEST_AT] = float(likeliest)
    weigh_components(bank, least)
    now = gather(bank)
    known = now.p.ss + drift_variance(now.drift)
    std = stated_deviation(known, now.mismatch, now.persistent, now.contradicted)
    ratio = off * off / variance * noise.per_gate2
    if ratio > 1.0:
        status |= INNOVATION_REJECTED
    # fmt: off
    return EkfInfo(now.cell.soc, std, predicted_V, off, variance, ratio, status)
    # fmt: on
