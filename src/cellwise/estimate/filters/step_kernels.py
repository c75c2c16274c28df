"""One way through a filter's step: read, predict, innovate, gate, update, report.

Each station of :func:`filter_step` takes the records of those before it and returns one:

- ``read_sample``, a `CheckedReading`: faults replaced; which current the voltage has seen, of
  which one the charge is counted;
- ``predict``, a `Predicted`: SOC by that charge, tables at the new SOC, branches and covariance P
  over the interval;
- ``innovate``, an `Innovation`: the predicted voltage, P H', and the variance that the state
  explains, H P H', beside that of a single voltage, r;
- ``gate``, a `GateResult`: used or rejected, and 1 / (H P H' + n r), what it weighs with;
- ``update``, an `Estimate`: gain and correction; ``without_voltage`` where none is accepted;
- ``report``: the `EkfState` that is carried, the `EkfInfo` that may be looked at.

n is how many samples share one error: the model's voltage error is remembered for minutes, so
consecutive voltages repeat the same evidence, and each is weighed with n times its variance
(2 tau / dt: the spectral density of an exponentially correlated error at rest). Gate and NIS look
at the plain variance of one sample. What no variance of a sample describes is carried beside P:
``mismatch``, ``persistent``, ``contradicted`` (see `EkfState`), and in ``drift`` a constant offset
of the current as a second hypothesis. P is that of a right current; the SOC that is carried is the
mean of both hypotheses, the filter's own and ``bias_soc``.

Every filter is this step. They differ in how the moments are taken, by tangents and chords
(EKF, ``sigma`` None) or by sigma points (UKF), and in what is free beside the cell's states:
nothing (``rules`` and ``free`` None), or capacity and resistances (adaptive). What is None is no
part of the compiled code. There are no matrix calls, and nothing is allocated.

``c`` are the constants of a step, ``x`` the cell's state, ``p`` the upper triangle of P, ``t`` a
transition, ``point`` the tables at one SOC. Equations: docs/theory.md, section 10.
"""

from __future__ import annotations

import math

from cellwise.cell.compiled import inline
from cellwise.cell.equations import (
    CellTables,
    heat_step,
    held_in_branches,
    polarisation_of,
    soc_step,
    voltage_of,
    with_heat,
    with_soc,
)
from cellwise.estimate.equations.covariance import column_of, explained
from cellwise.estimate.equations.evidence import bent_variance
from cellwise.estimate.equations.weighing import Innovation
from cellwise.estimate.evidence_kernels import (
    GateResult,
    StepConstants,
    gate,
    stated_deviation,
    step_constants,
    variance_about,
)
from cellwise.estimate.filters.capacity_kernels import (
    Free,
    FreeRules,
    capacity_soc,
    capacity_variance,
    capacity_variance_V2,
    counted_capacity,
    nothing_known,
    watched_resistances,
)
from cellwise.estimate.filters.covariance_kernels import uncorrelated
from cellwise.estimate.filters.filter_state import EkfInfo, EkfStart, EkfState, ekf_start
from cellwise.estimate.filters.offset_kernels import (
    counted_on,
    drift_variance,
    dropped_by_offset,
)
from cellwise.estimate.filters.predict_kernels import SOC_HIGH, SOC_LOW, by_tangents, over_interval
from cellwise.estimate.filters.sigma_kernels import (
    PredictedVoltage,
    SigmaScalars,
    by_points,
    voltage_by_points,
)
from cellwise.estimate.filters.update_kernels import Estimate, Predicted, update, without_voltage
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import (
    NO_VOLTAGE_YET_S,
    NOT_BEGUN_S,
    CheckedReading,
    MeasuredSample,
    read_sample,
)
from cellwise.estimate.status import CLAMPED, OUTSIDE, STATE_RESET


@inline
def predict(
    c: StepConstants,
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    rules: FreeRules | None,
    start: EkfStart,
    state: EkfState,
    free: Free | None,
    reading: CheckedReading,
) -> Predicted:
    """Charge first, then the tables at the new SOC; a state that is not finite starts again."""
    cell = tables.cell
    status = 0
    soc = soc_step(cell, state.cell.soc, reading.counted_current_A, reading.dt_s)
    if not (math.isfinite(soc) and math.isfinite(state.p.ss)):
        state, free = ekf_start(start, reading.current_A), nothing_known(rules)
        soc = state.cell.soc
        status = STATE_RESET
    p, evidence_s = state.p, state.watch.evidence_s
    interval = over_interval(tables, noise, state.cell, soc, reading, evidence_s == NOT_BEGUN_S)
    if evidence_s == NOT_BEGUN_S:
        p = uncorrelated(p.ss, interval.unknown, p.phh)
        evidence_s = NO_VOLTAGE_YET_S
    bias_soc = state.drift.believed * state.drift.reach + capacity_soc(free)
    counted = 0.0 if reading.gap or reading.lost_A > 0.0 else 1.0
    drift = counted_on(
        noise, state.drift, interval.t, cell.charge_As, counted * reading.dt_s, reading.current_A
    )
    within_data_A = 0.0 if interval.status & OUTSIDE else counted * reading.counted_current_A
    free, drift = counted_capacity(
        cell, rules, free, drift, interval.t.gs, within_data_A, reading.dt_s
    )
    if sigma is None:
        x, p, slopes = by_tangents(c, tables, noise, reading, interval, p, state.watch.no_voltage_s)
    else:
        x, p, slopes = by_points(
            c, tables, noise, sigma, reading, interval, p, state.watch.no_voltage_s
        )
    polarisation_V = polarisation_of(interval.point, x, reading.delayed_current_A)
    x = with_heat(
        x, heat_step(cell, x.heat_K, reading.counted_current_A, polarisation_V, reading.dt_s)
    )
    status |= interval.status
    # fmt: off
    return Predicted(
        state, x, p, interval.point, slopes, interval.effective_temperature_C, evidence_s, drift,
        free, bias_soc, status,
    )
    # fmt: on


@inline
def innovate(
    c: StepConstants,
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    reading: CheckedReading,
    predicted: Predicted,
) -> Innovation:
    """Predicted voltage and its variances; H = [slope, -1, -1, -1, m], d = P H'."""
    x, point, slopes = predicted.x, predicted.point, predicted.slopes
    branches_V = held_in_branches(x)
    single_V2 = variance_about(
        c, noise, point, reading.delayed_current_A, reading.lost_A, branches_V
    )
    if sigma is None:
        column = column_of(predicted.p, slopes.slope_V, point.m_V)
        explained_V2 = bent_variance(explained(column, slopes.slope_V, point.m_V), slopes.bend_V)
        voltage_V = voltage_of(point, x, reading.delayed_current_A)
        voltage = PredictedVoltage(voltage_V, column, explained_V2, slopes.slope_V)
    else:
        voltage = voltage_by_points(
            tables, sigma, reading, point, slopes, predicted.effective_temperature_C, x, predicted.p
        )
    # An offset has moved the polarisation, too: by what is believed of it, and what is not known.
    drift, slope_V = predicted.drift, voltage.slope_V
    dropped_V = dropped_by_offset(noise, drift, point.r0_ohm, tables.cell.charge_As)
    of_offset_V = slope_V * drift.reach + dropped_V
    free_V2 = of_offset_V * of_offset_V * drift.unsure
    free_V2 += capacity_variance_V2(predicted.free, slope_V, of_offset_V)
    bias_V = slope_V * predicted.bias_soc + drift.believed * dropped_V
    # fmt: off
    return Innovation(
        voltage.voltage_V + drift.believed * dropped_V,
        voltage.explained_V2 + (single_V2 + free_V2), voltage.explained_V2, single_V2,
        slope_V, of_offset_V, bias_V, voltage.column,
    )
    # fmt: on


@inline
def report(
    innovation: Innovation, gate_result: GateResult, estimate: Estimate, status: int
) -> tuple[EkfState, EkfInfo]:
    """SOC held within 0..1, and what there is to report."""
    soc = estimate.x.soc
    if soc < SOC_LOW or soc > SOC_HIGH:
        soc = min(max(soc, SOC_LOW), SOC_HIGH)
        status |= CLAMPED
    # fmt: off
    state = EkfState(
        with_soc(estimate.x, soc), estimate.p, gate_result.rejections, gate_result.mismatch,
        estimate.persistent, estimate.contradicted, estimate.drift, gate_result.watch,
    )
    # fmt: on
    drift = estimate.drift
    known = estimate.p.ss + drift_variance(drift) + capacity_variance(estimate.free, drift.reach)
    std = stated_deviation(known, gate_result.mismatch, estimate.persistent, estimate.contradicted)
    # fmt: off
    info = EkfInfo(
        soc, std, innovation.voltage_V, gate_result.innovation_V, innovation.variance_V2,
        gate_result.ratio, status,
    )
    # fmt: on
    return state, info


@inline
def filter_step(
    tables: CellTables,
    noise: NoiseScalars,
    sigma: SigmaScalars | None,
    rules: FreeRules | None,
    start: EkfStart,
    state: EkfState,
    free: Free | None,
    sample: MeasuredSample,
) -> tuple[EkfState, Free | None, EkfInfo]:
    """Over the interval that ends now, then the voltage read now."""
    reading = read_sample(tables, noise, state.watch, start.temperature_C, sample)
    c = step_constants(tables.cell, noise, sample.dt_s)
    predicted = predict(c, tables, noise, sigma, rules, start, state, free, reading)
    innovation = innovate(c, tables, noise, sigma, reading, predicted)
    gate_result = gate(
        c, noise, predicted.state, reading, predicted.evidence_s, predicted.point.r0_ohm, innovation
    )
    estimate = (
        update(c, noise, rules, reading, predicted, innovation, gate_result)
        if gate_result.accepted
        else without_voltage(predicted)
    )
    after, info = report(
        innovation, gate_result, estimate, reading.status | predicted.status | gate_result.status
    )
    drop_V = predicted.point.r0_ohm * reading.delayed_current_A + predicted.x.v1_V
    free = watched_resistances(
        rules, estimate.free, noise, reading, drop_V, gate_result, predicted.p.ss
    )
    return after, free, info
