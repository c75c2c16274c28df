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
from cellwise.diagnose.applied import (
    Applied,
    LogRun,
    Step,
    UsedLog,
    applied,
    apply,
    plain_runs,
    soc_gain,
    step_between,
    with_own_starts,
    with_use,
)
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
from cellwise.diagnose.extension import (
    correct_log,
    extended_validity,
    parameters_of,
    value_of,
    with_error_at,
)
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit, Prior
from cellwise.diagnose.fit.priors import GOOD
from cellwise.diagnose.fit.rows import gather
from cellwise.diagnose.limits import LONGER_LOG, Limits, limits, next_test
from cellwise.diagnose.odds import NAMING, RARE, Rarity, probability_of
from cellwise.diagnose.residual import residual_analysis
from cellwise.diagnose.result import Diagnosis, FoundCause, TriedCause
from cellwise.diagnose.sensor_faults import with_faults, without_faults
from cellwise.diagnose.sets import (
    Accepted,
    Explanation,
    Explanations,
    Outcome,
    Progress,
    decide,
)
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
    cleaned, stated, faults = without_faults(groups, stated_starts(groups, soc0))
    logs, holdout, _ = cleaned
    both = model, groups[0] + groups[1], logs + holdout
    missing = too_little(model, logs)
    starts = _starts(model, cleaned, stated)
    used = with_use([*starts[0], *starts[1]], len(logs))
    if missing:
        said = _undetermined(model, logs, holdout, used, missing)
        return with_faults(said, faults, *both)
    evidence = gather(model, starts[0], starts[1], _slowest_s(model))
    unseen_C = unseen_temperature_C(model, evidence)
    coordinates = Coordinates(model, unseen_C=unseen_C)
    if unseen_C is not None:
        chosen = [UNSEEN_TEMPERATURE if c.name == UNSEEN_TEMPERATURE.name else c for c in chosen]
    chosen = [c for c in chosen if all(coordinates.possible(n) for n in c.coordinates)]
    fits = CauseFits.of(evidence, coordinates, seed)
    if starts[2]:
        fits.calibrate(CauseFits.of(gather(model, starts[2], whole=True), coordinates, seed))
    base, scale = fits.base()
    if other := another_cell(model, evidence, base):
        why = f"this looks like another cell: {other}"
        said = _undetermined(model, logs, holdout, used, why)
        return with_faults(said, faults, *both)
    if evidence.rest.zero:
        chosen = [c for c in chosen if c.name != "current_offset"]
    asked = RARE.one_cause + NAMING.nats  # what a single cause needs to be named
    shown = limits(fits, chosen, base, scale, asked)
    sets = Explanations(fits, Rarity(unseen_C is not None, fits.same_age), progress)
    sets.search(chosen, base, scale)
    found = _diagnosis(logs, holdout, used, fits, decide(sets), shown, reference_capacity_Ah)
    return with_faults(found, faults, *both)


def _undetermined(
    model: CellModel,
    logs: tuple[CellLog, ...],
    holdout: tuple[CellLog, ...],
    used: Sequence[UsedLog],
    why: str,
) -> Diagnosis:
    """No verdict, and what is missing for one."""
    runs = plain_runs(model, used)
    error = residual_analysis(model, logs[0], runs[0].before.soc0)
    return Diagnosis(
        "undetermined", (), (), error, LONGER_LOG, (why,), model, None, logs, holdout, logs,
        tuple(start.to_dict() for _, start, _ in used), runs=runs,
    )  # fmt: skip


def _slowest_s(model: CellModel) -> float:
    """The slowest memory of the model [s]."""
    table, _, _ = model.parameters()
    columns = [TAU2, TAU3] if np.any(table[..., R3]) else [TAU2]
    return max(float(np.median(table[..., c])) for c in columns)


def _starts(
    model: CellModel, groups: Sequence[Sequence[CellLog]], stated: Sequence[float | str]
) -> list[list[StartedLog]]:
    """Every log with its start; a log's own where it states one."""

    def start_of(log: CellLog, value: float | str) -> InitialSoc:
        known = log.soc0 if value == "auto" else float(value)
        if known is None:
            # As `simulate` takes it: what is said of a log is said from there.
            return initial_soc(model, log, whole_log=True)
        return initial_soc(model, log, known, GOOD.soc0_std)

    said = iter(stated)
    return [[(log, start_of(log, next(said))) for log in group] for group in groups]


def _diagnosis(
    logs: tuple[CellLog, ...],
    holdout: tuple[CellLog, ...],
    used: Sequence[UsedLog],
    fits: CauseFits,
    outcome: Outcome,
    shown: Limits,
    reference_Ah: float | None,
) -> Diagnosis:
    evidence, model = fits.evidence, fits.coordinates.model
    known = applied(fits, outcome, used)
    chosen = () if known is None else known.causes
    refused = [c.name for c in outcome.causes if c not in chosen]
    outcome = replace(outcome, accepted=tuple(a for a in outcome.accepted if a.cause in chosen))
    runs = plain_runs(model, used) if known is None else known.runs
    beyond = [c for c in claim_checks(model, runs, evidence) if c.beyond]
    causes: tuple[FoundCause, ...] = ()
    corrected, extended, gain, no_gain = logs, None, None, ""
    if known is not None:
        causes = _found_causes(fits, outcome, used, known)
        corrected = tuple(correct_log(g, known.of_log, k) for k, g in enumerate(logs))
        seen = [r.explained.soc0 for r in runs[: len(logs)]]
        validity = extended_validity(known.model, corrected, seen)
        extended = _with_own_error(replace(known.model, validity=validity), runs, fits)
        runs = with_own_starts(extended, runs, used)
        gain, no_gain = soc_gain(known, model, extended, reference_Ah)
    open_between = outcome.open_between
    if causes:
        verdict = causes[0].name
    elif open_between:
        verdict = "undetermined"
    else:
        verdict = "unexplained" if beyond else "none"
    reasons = [c.text() for c in beyond if not causes]
    if refused:
        names = " and ".join(refused)
        reasons.append(f"{names} fit, but leave held-out rows no better simulated")
    reasons += outcome.reasons
    if open_between:
        names = " or ".join(" with ".join(e.names) for e in open_between[:3])
        reasons.append(f"{names}: these logs do not separate them")
    return Diagnosis(
        verdict,
        causes,
        tuple(_tried(e, fits, outcome.none, used) for e in outcome.first),
        residual_analysis(model, logs[0], runs[0].before.soc0),
        "" if verdict == "none" else next_test(outcome, model, evidence),
        tuple(reasons),
        model,
        extended,
        logs,
        holdout,
        corrected,
        tuple(start.to_dict() for _, start, _ in used),
        gain,
        {"scale": outcome.scale},
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
        part = known
        if k < len(known.causes):
            near = fits.fit_causes(known.causes[:k], known.fit, outcome.scale)
            part = apply(fits, known.causes[:k], near, used)
        after = [r.explained for r in part.runs]
        step = step_between(fits.evidence, before, after, fits.seed)
        start, cause = fits.evidence.logs[0].start.soc, accepted.cause
        one = _found(accepted, step, known.fit, prior, start)
        log = None if cause.log is None else fits.evidence.logs[cause.log].log.name
        probability = probability_of(cause.name, outcome.weighed)
        found.append(replace(one, probability=probability, log=log))
        before = after
    return tuple(found)


def _found(accepted: Accepted, step: Step, final: Fit, prior: Prior, soc0: float) -> FoundCause:
    cause = accepted.cause
    intervals, usual = {}, []
    for p in cause.parameters:
        x, std = final.z.get(p.key, 0.0), final.std(p.key)
        if std > NAMING.narrower * prior.std[p.key]:
            usual.append(p.name)
        ends = sorted(value_of(p, x + k * std, final.coordinates, soc0) for k in (-1.96, 1.96))
        intervals[p.name] = (ends[0], ends[1])
    return FoundCause(
        cause.name,
        cause.kind,
        cause.meaning,
        parameters_of(cause, final.coordinates, final.z, soc0),
        intervals,
        step.train_before_V,
        step.train_after_V,
        step.held_before_V,
        step.held_after_V,
        step.gain,
        (step.low, step.high),
        _evidence(accepted, step),
        cause.confused_with,
        prior_only=tuple(usual),
    )


def _evidence(accepted: Accepted, step: Step) -> tuple[str, ...]:
    """Why a cause was accepted."""
    least = f"{100 * step.low:.0f}" if step.low >= 0.0 else f"{-100 * step.low:.0f} % more"
    needed = "" if step.held_after_V <= step.held_before_V else "; needed by the others"
    return (
        f"held-out RMSE goes from {1e3 * step.held_before_V:.1f} to "
        f"{1e3 * step.held_after_V:.1f} mV ({least} to {100 * step.high:.0f} % less{needed}, "
        "95 % interval over blocks of time)",
        f"e^{accepted.score:.0f} times as probable as the best explanation without it"
        + (f" ({' with '.join(accepted.instead)})" if accepted.instead else ""),
        accepted.cause.signature,
    )


def _tried(
    candidate: Explanation, fits: CauseFits, none: Explanation, used: Sequence[UsedLog]
) -> TriedCause:
    """A single cause as a user would apply it: its error is what `simulate` shows with it."""
    (c,), f = candidate.causes, candidate.fit
    values = parameters_of(c, f.coordinates, f.z, fits.evidence.logs[0].start.soc)
    error = apply(fits, (c,), f, used).step.held_after_V
    return TriedCause(c.name, error, values, candidate.found.total - none.found.total)
