"""`diagnose`: from a model and measured logs to causes, an extended model, a measured gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellwise.arguments import number
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel, check_is_model
from cellwise.cell.point_kernels import R3, TAU2, TAU3
from cellwise.diagnose.causes.catalogue import UNSEEN_TEMPERATURE
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.checks import (
    Logs,
    another_cell,
    causes_of,
    claim_checks,
    logs_of,
    stated_starts,
    too_little,
    unseen_temperature_C,
)
from cellwise.diagnose.decision.explanations import Explanation, Explanations, Progress
from cellwise.diagnose.decision.odds import (
    NAMING,
    RARE,
    Rarity,
    probability_of,
)
from cellwise.diagnose.decision.outcome import Accepted, Outcome, decide
from cellwise.diagnose.extension import extended_validity, parameters_of, value_of, with_error_at
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit, Prior
from cellwise.diagnose.fit.priors import GOOD, tolerances
from cellwise.diagnose.fit.rests import rest_voltages
from cellwise.diagnose.fit.rows import Evidence, gather
from cellwise.diagnose.identifiability import LONGER_LOG, Limits, limits, next_test
from cellwise.diagnose.log_runs import (
    Applied,
    LogRun,
    Step,
    UsedLog,
    applied,
    apply,
    judged_runs,
    kept,
    log_runs,
    reference_for,
    soc_gain,
    step_between,
    with_own_starts,
    with_use,
)
from cellwise.diagnose.residual import residual_analysis
from cellwise.diagnose.result import Diagnosis, FoundCause, TriedCause
from cellwise.diagnose.sensor_faults import with_faults, without_faults
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.threads import one_blas_thread

StartedLog = tuple[CellLog, InitialSoc]


@one_blas_thread
def diagnose(
    model: CellModel,
    logs: Logs,
    holdout: Logs = (),
    baseline: Logs = (),
    soc0: float | str | Sequence[float | str] = "auto",
    *,
    causes: Sequence[str] | None = None,
    reference_capacity_Ah: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find where a model is wrong on measured logs, name the cause, measure the gain.

    Parameters
    ----------
    model : CellModel
    logs : CellLog or sequence        what is to be explained
    holdout : CellLog or sequence     on which gains are judged; without it later blocks of time of
                                      ``logs``, never used in the fit
    baseline : CellLog or sequence    logs known to be good, of the same cell and instruments: what
                                      the model gets wrong there is calibrated, not diagnosed
    soc0 : float, "auto" or a sequence of them, one per log (logs, holdout, baseline); a log's own
        stated start (``CellLog.soc0``) goes before "auto" and before one number for all
    causes : names to try; default all but `charge_transfer`, which is tried where it is named
    reference_capacity_Ah : measured apart from these logs [Ah]: what SOC is judged over; default
        the model's own, unless that is found to be wrong
    seed : of the block bootstrap
    progress : called with the share done and what is being tried

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError        no log, a start outside 0..1, an unknown cause, a capacity not above zero
    """
    check_is_model(model)
    groups = tuple(logs_of(g) for g in (logs, holdout, baseline))
    if not groups[0]:
        raise InputError("no log", "at least one log to explain", "Name a log.")
    if reference_capacity_Ah is not None:
        reference_capacity_Ah = number("reference_capacity_Ah", reference_capacity_Ah, "Ah")
        if not reference_capacity_Ah > 0.0:
            raise InputError(
                f"a reference capacity of {reference_capacity_Ah:g} Ah", "above zero", "Correct it."
            )
    chosen = causes_of(causes)
    with_all_rows = groups[0] + groups[1]
    cleaned, stated, faults = without_faults(groups, stated_starts(groups, soc0))
    groups = tuple(cleaned)

    def said(found: Diagnosis) -> Diagnosis:
        return with_faults(found, faults, model, with_all_rows)

    missing = too_little(model, groups[0])
    starts = _starts(model, groups, stated)
    if missing:
        return said(_undetermined(model, starts, missing))
    slowest = _slowest(model)
    evidence = gather(model, starts[0], starts[1], slowest)
    unseen_C = unseen_temperature_C(model, evidence)
    coordinates = Coordinates(model, unseen_C=unseen_C)
    if unseen_C is not None:
        chosen = [UNSEEN_TEMPERATURE if c.name == UNSEEN_TEMPERATURE.name else c for c in chosen]
    chosen = [c for c in chosen if all(coordinates.possible(n) for n in c.coordinates)]
    fits = _cause_fits(evidence, coordinates, seed)
    if groups[2]:
        fits.calibrate(_cause_fits(gather(model, starts[2], whole=True), coordinates, seed))
    base, noise = fits.base(fits.prior)
    other = another_cell(model, evidence, base, base.soc)
    if other:
        return said(_undetermined(model, starts, f"this looks like another cell: {other}"))
    if evidence.rest.zero:
        chosen = [c for c in chosen if c.name != "current_offset"]
    asked = RARE.one_cause + NAMING.nats  # what a single cause needs to be named
    shown = limits(fits, chosen, base, noise, asked)
    sets = Explanations(fits, Rarity(unseen_C is not None, fits.same_age), progress)
    sets.search(chosen, base, noise)
    outcome = decide(sets)
    found = _diagnosis(model, groups[0], groups[1], fits, outcome, shown, reference_capacity_Ah)
    return said(found)


def _undetermined(model: CellModel, starts: list[list[StartedLog]], why: str) -> Diagnosis:
    """No verdict, and what is missing for one."""
    logs, holdout = (tuple(g for g, _ in group) for group in starts[:2])
    every = [*starts[0], *starts[1]]
    runs = log_runs(model, with_use(every, len(logs)))
    error = residual_analysis(model, logs[0], runs[0].before.soc0)
    return Diagnosis(
        "undetermined", (), (), error, LONGER_LOG, (why,), model, None, logs, holdout, logs,
        tuple(start.to_dict() for _, start in every), runs=runs,
    )  # fmt: skip


def _slowest(model: CellModel) -> float:
    """The slowest memory of the model [s]."""
    table, _, _ = model.parameters()
    slow = float(np.median(table[..., TAU2]))
    if np.any(table[..., R3]):
        slow = max(slow, float(np.median(table[..., TAU3])))
    return slow


def _starts(
    model: CellModel,
    groups: Sequence[Sequence[CellLog]],
    stated: Sequence[float | str],
) -> list[list[StartedLog]]:
    """Every log with its start."""

    def start_of(log: CellLog, value: float | str) -> InitialSoc:
        known = log.soc0 if value == "auto" else float(value)
        if known is None:
            # As `simulate` takes it: what is said of a log is said from there.
            return initial_soc(model, log, whole_log=True)
        return initial_soc(model, log, known, GOOD.soc0_std)

    said = iter(stated)
    return [[(log, start_of(log, next(said))) for log in group] for group in groups]


def _cause_fits(evidence: Evidence, coordinates: Coordinates, seed: int) -> CauseFits:
    """Fits with the tolerances of a good laboratory."""
    model = coordinates.model
    return CauseFits(
        evidence,
        coordinates,
        tolerances(coordinates, evidence),
        rest_voltages(evidence.logs, model.capacity_Ah, model.charge_efficiency),
        seed,
    )


def _diagnosis(
    model: CellModel,
    logs: tuple[CellLog, ...],
    holdout: tuple[CellLog, ...],
    fits: CauseFits,
    outcome: Outcome,
    shown: Limits,
    reference_Ah: float | None,
) -> Diagnosis:
    evidence = fits.evidence
    used = with_use([(g.log, g.start) for g in evidence.logs], len(logs))
    known = applied(fits, outcome, used)
    chosen = () if known is None else known.causes
    refused = [a.cause.name for a in outcome.accepted if a.cause not in chosen]
    outcome = kept(outcome, known)
    runs = log_runs(model, used) if known is None else known.runs
    causes = () if known is None else _found_causes(fits, outcome, used, known)
    beyond = [c for c in claim_checks(model, runs, evidence) if c.beyond]
    if causes:
        verdict = causes[0].name
    elif outcome.open_between:
        verdict = "undetermined"
    else:
        verdict = "unexplained" if beyond else "none"
    corrected = tuple(logs)
    extended, gain, no_gain = None, None, ""
    if known is not None:
        corrected = tuple(known.explained.corrected(g, known.fit) for g in logs)
        seen = runs[: len(logs)]
        new = known.explained.model
        validity = extended_validity(new, corrected, [r.explained.soc0 for r in seen])
        extended = _with_own_error(replace(new, validity=validity), runs, fits)
        runs = with_own_starts(extended, runs, used)
        reference = reference_for(model, reference_Ah, [c.name for c in causes])
        gain, no_gain = soc_gain(model, extended, judged_runs(runs), reference)
    reasons = outcome.reasons
    if refused:
        names = " and ".join(refused)
        reasons = (f"{names} fit, but leave held-out rows no better simulated", *reasons)
    if outcome.open_between:
        names = " or ".join(" with ".join(e.names) for e in outcome.open_between[:3])
        reasons = (*reasons, f"{names}: these logs do not separate them")
    if not causes:
        reasons = (*(c.text() for c in beyond), *reasons)
    return Diagnosis(
        verdict,
        causes,
        tuple(_tried(e, fits, outcome.none, used) for e in outcome.first),
        residual_analysis(model, logs[0], runs[0].before.soc0),
        "" if verdict == "none" else next_test(outcome, model, evidence),
        reasons,
        model,
        extended,
        logs,
        holdout,
        corrected,
        tuple(g.start.to_dict() for g in evidence.logs),
        gain,
        outcome.noise._asdict(),
        runs,
        no_gain,
        shown.sizes,
        tuple(w for w in outcome.weighed if w.probability >= NAMING.shown),
        shown.inseparable,
    )


def _with_own_error(new: CellModel, runs: Sequence[LogRun], fits: CauseFits) -> CellModel:
    """A model with a further temperature states there what its error on these logs is."""
    unseen_C = fits.coordinates.unseen_C
    if unseen_C is None or unseen_C not in new.temperature_C:
        return new
    left = claim_checks(new, [replace(r, before=r.explained) for r in runs], fits.evidence)
    times = math.sqrt(float(np.mean([c.times**2 for c in left])))
    return with_error_at(new, unseen_C, max(times, 1.0))


def _found_causes(
    fits: CauseFits, outcome: Outcome, used: Sequence[UsedLog], known: Applied
) -> tuple[FoundCause, ...]:
    """Every cause with what it gains on top of those before it, as `simulate` would show it."""
    before = [r.before for r in known.runs]
    prior = fits.widened_for(known.causes, known.fit.coordinates)
    found = []
    for k, accepted in enumerate(outcome.accepted, 1):
        after = [r.explained for r in known.runs]
        if k < len(known.causes):
            near = fits.fit_causes(known.causes[:k], known.fit, outcome.noise)
            part = apply(fits, known.causes[:k], near, used)
            after = [r.explained for r in part.runs]
        step = step_between(fits.evidence, before, after, np.random.default_rng(fits.seed))
        found.append(_found(accepted, step, known.fit, prior, outcome, fits.evidence))
        before = after
    return tuple(found)


def _found(
    accepted: Accepted, step: Step, final: Fit, prior: Prior, outcome: Outcome, evidence: Evidence
) -> FoundCause:
    cause = accepted.cause
    soc0 = evidence.logs[0].start.soc
    values = parameters_of(cause, final.coordinates, final.z, soc0)
    intervals, usual = {}, []
    for p in cause.parameters:
        key = "soc0:0" if p.coordinate == "soc0" else p.coordinate
        x = final.z.get(key, 0.0)
        std = final.std(key)
        if std > NAMING.narrower * prior.std[key]:
            usual.append(p.name)
        ends = (
            value_of(p.coordinate, x - 1.96 * std, final.coordinates, soc0),
            value_of(p.coordinate, x + 1.96 * std, final.coordinates, soc0),
        )
        intervals[p.name] = (min(ends), max(ends))
    return FoundCause(
        cause.name,
        cause.kind,
        cause.meaning,
        values,
        intervals,
        step.train_before_V,
        step.train_after_V,
        step.held_before_V,
        step.held_after_V,
        step.gain,
        (step.low, step.high),
        _evidence(accepted, step),
        cause.confused_with,
        probability_of(cause.name, outcome.weighed),
        tuple(usual),
    )


def _evidence(accepted: Accepted, step: Step) -> tuple[str, ...]:
    """Why a cause was accepted."""
    least = f"{100 * step.low:.0f}" if step.low >= 0.0 else f"{-100 * step.low:.0f} % more"
    needed = "" if step.held_after_V <= step.held_before_V else "; needed by the others"
    lines = [
        f"held-out RMSE goes from {1e3 * step.held_before_V:.1f} to "
        f"{1e3 * step.held_after_V:.1f} mV ({least} to {100 * step.high:.0f} % less{needed}, "
        "95 % interval over blocks of time)",
        f"e^{accepted.score:.0f} times as probable as the best explanation without it"
        + (f" ({' with '.join(accepted.instead)})" if accepted.instead else ""),
    ]
    lines.append(accepted.cause.signature)
    return tuple(lines)


def _tried(
    candidate: Explanation, fits: CauseFits, none: Explanation, used: Sequence[UsedLog]
) -> TriedCause:
    """A single cause as a user would apply it: its error is what `simulate` shows with it."""
    (c,), f = candidate.causes, candidate.fit
    score = candidate.found.total - none.found.total
    error = apply(fits, (c,), f, used).step.held_after_V
    values = parameters_of(c, f.coordinates, f.z, fits.evidence.logs[0].start.soc)
    return TriedCause(c.name, error, values, score)
