"""`diagnose`: from a model and measured logs to causes, an extended model, a measured gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from cellwise.arguments import number
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.sizes import check_is_model, check_log_of
from cellwise.diagnose.applied import (
    Applied,
    Gain,
    applied,
    apply,
    correct_log,
    extended_validity,
    gain_between,
    plain_runs,
    soc_gain,
    with_error_at,
    with_own_starts,
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
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.priors import GOOD
from cellwise.diagnose.fit.rows import gather
from cellwise.diagnose.limits import LONGER_LOG, DetectionLimits, limits, next_test
from cellwise.diagnose.odds import NAMING, RARE, Rarity, probability_of
from cellwise.diagnose.residual import residual_analysis
from cellwise.diagnose.result import Diagnosis, FoundCause, LogRun, TriedCause
from cellwise.diagnose.sensor_faults import with_faults, without_faults
from cellwise.diagnose.sets import (
    Accepted,
    Explanation,
    Explanations,
    Progress,
    SearchOutcome,
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
    soc0: float | Sequence[float | None] | None = None,
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
    soc0 : float, None (not known) or a sequence of them, one per log (logs, holdout, baseline); a
        log's own stated start (``CellLog.soc0``) goes before None and before one number for all
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
    for log in chain(*groups):
        check_log_of(model, log)
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
    used, held, good = _starts(model, cleaned, stated)
    logs, holdout, _ = cleaned
    runs = plain_runs(model, used, held)
    both = model, groups[0] + groups[1], logs + holdout
    # What is said where no cause can be judged; else what is found takes its place.
    open_ = Diagnosis(
        "undetermined", (), (), residual_analysis(model, logs[0], runs[0].before.soc0), LONGER_LOG,
        (), model, None, logs, holdout, logs, tuple(s.to_dict() for _, s in used + held), runs=runs,
    )  # fmt: skip
    if missing := too_little(model, logs):
        return with_faults(replace(open_, reasons=(missing,)), faults, *both)
    evidence = gather(model, used, held)
    unseen_C = unseen_temperature_C(model, evidence)
    coordinates = Coordinates(model, unseen_C=unseen_C)
    if unseen_C is not None:
        chosen = [UNSEEN_TEMPERATURE if c.name == UNSEEN_TEMPERATURE.name else c for c in chosen]
    chosen = [c for c in chosen if all(coordinates.possible(n) for n in c.coordinates)]
    if evidence.rest.zero:
        chosen = [c for c in chosen if c.name != "current_offset"]
    fits = CauseFits.of(evidence, coordinates, seed)
    if good:
        fits.calibrate(CauseFits.of(gather(model, good, whole=True), coordinates, seed))
    base, scale = fits.base()
    if other := another_cell(model, evidence, base):
        return with_faults(replace(open_, reasons=(other,)), faults, *both)
    asked = RARE.one_cause + NAMING.nats  # what a single cause needs to be named
    shown = limits(fits, chosen, base, scale, asked)
    sets = Explanations(fits, Rarity(unseen_C is not None, fits.same_age), progress)
    sets.search(chosen, base, scale)
    found = _judged(open_, fits, decide(sets), shown, reference_capacity_Ah)
    return with_faults(found, faults, *both)


def _starts(
    model: CellModel, groups: Sequence[Sequence[CellLog]], stated: Sequence[float | None]
) -> list[list[StartedLog]]:
    """Every log with its start; a log's own where it states one."""

    def start_of(log: CellLog, value: float | None) -> InitialSoc:
        known = log.soc0 if value is None else value
        if known is None:
            # As `simulate` takes it: what is said of a log is said from there.
            return initial_soc(model, log, whole_log=True)
        return initial_soc(model, log, known, GOOD.soc0_std)

    said = iter(stated)
    return [[(log, start_of(log, next(said))) for log in group] for group in groups]


def _judged(
    plain: Diagnosis,
    fits: CauseFits,
    outcome: SearchOutcome,
    shown: DetectionLimits,
    reference_Ah: float | None,
) -> Diagnosis:
    """What was decided, applied to the logs."""
    evidence, model, logs, runs = fits.evidence, plain.model, plain.logs, plain.runs
    known = applied(fits, outcome, runs)
    chosen = () if known is None else known.causes
    refused = [c.name for c in outcome.causes if c not in chosen]
    outcome = replace(outcome, accepted=tuple(a for a in outcome.accepted if a.cause in chosen))
    said = replace(
        plain,
        candidates=tuple(_tried(e, fits, outcome.none, runs) for e in outcome.first),
        noise={"scale": outcome.scale},
        limits=shown.sizes,
        inseparable=shown.inseparable,
        competing=tuple(w for w in outcome.weighed if w.probability >= NAMING.shown),
        next_test=next_test(outcome, model, evidence),
    )
    reasons = list(outcome.reasons)
    if refused:
        reasons.insert(
            0, f"{' and '.join(refused)} fit, but leave held-out rows no better simulated"
        )
    if known is not None:
        corrected = tuple(correct_log(g, known.of_log, k) for k, g in enumerate(logs))
        seen = [r.explained.soc0 for r in known.runs[: len(logs)]]
        validity = extended_validity(known.model, corrected, seen)
        extended = _with_own_error(replace(known.model, validity=validity), known.runs, fits)
        gain, no_gain = soc_gain(known, model, extended, reference_Ah)
        causes = _found_causes(fits, outcome, runs, known)
        return replace(
            said,
            verdict=causes[0].name,
            causes=causes,
            reasons=tuple(reasons),
            extended_model=extended,
            corrected=corrected,
            soc_gain=gain,
            no_soc_gain=no_gain,
            runs=with_own_starts(extended, known.runs, evidence),
        )
    beyond = [c.text() for c in claim_checks(model, runs, evidence) if c.beyond]
    verdict = "unexplained" if beyond else "none"
    if outcome.open_between:
        verdict = "undetermined"
        names = " or ".join(" with ".join(e.names) for e in outcome.open_between[:3])
        reasons.append(f"{names}: these logs do not separate them")
    if verdict == "none":
        said = replace(said, next_test="")
    return replace(said, verdict=verdict, reasons=(*beyond, *reasons))


def _with_own_error(new: CellModel, runs: Sequence[LogRun], fits: CauseFits) -> CellModel:
    """A model with a further temperature states there what its error on these logs is."""
    unseen_C = fits.coordinates.unseen_C
    if unseen_C is None or unseen_C not in new.temperature_C:
        return new
    left = claim_checks(new, [replace(r, before=r.explained) for r in runs], fits.evidence)
    times = math.sqrt(float(np.mean([c.times**2 for c in left])))
    return with_error_at(new, unseen_C, max(times, 1.0))


def _found_causes(
    fits: CauseFits, outcome: SearchOutcome, runs: Sequence[LogRun], known: Applied
) -> tuple[FoundCause, ...]:
    """Every cause with what it gains on top of those before it, as `simulate` would show it."""
    logs, final = fits.evidence.logs, known.fit
    prior = fits.widened_for(known.causes, final.coordinates)
    before, found = [r.before for r in runs], []
    for k, accepted in enumerate(outcome.accepted, 1):
        part, cause = known, accepted.cause
        if k < len(known.causes):
            near = fits.fit_causes(known.causes[:k], final, outcome.scale)
            part = apply(fits, known.causes[:k], near, runs)
        after = [r.explained for r in part.runs]
        gain = gain_between(fits.evidence, before, after, fits.seed)
        before, soc0 = after, logs[0].start.soc
        points = {p.name: (p, final.z.get(p.key, 0.0), final.std(p.key)) for p in cause.parameters}
        intervals = {
            name: sorted(p.value(x + way * 1.96 * std, final.coordinates, soc0) for way in (-1, 1))
            for name, (p, x, std) in points.items()
        }
        found.append(
            FoundCause(
                name=cause.name,
                kind=cause.kind,
                meaning=cause.meaning,
                parameters=cause.values(final.coordinates, final.z, soc0),
                ci95={name: (low, high) for name, (low, high) in intervals.items()},
                **gain._asdict(),
                evidence=_evidence(accepted, gain),
                confusable_with=cause.confused_with,
                probability=probability_of(cause.name, outcome.weighed),
                prior_only=tuple(
                    name
                    for name, (p, _, std) in points.items()
                    if std > NAMING.narrower * prior.std[p.key]
                ),
                log=None if cause.log is None else logs[cause.log].log.name,
            )
        )
    return tuple(found)


def _evidence(accepted: Accepted, gain: Gain) -> tuple[str, ...]:
    """Why a cause was accepted."""
    before_V, after_V, (low, high) = (
        gain.holdout_rmse_before_V,
        gain.holdout_rmse_after_V,
        gain.gain_ci95,
    )
    least = f"{100 * low:.0f}" if low >= 0.0 else f"{-100 * low:.0f} % more"
    needed = "" if after_V <= before_V else "; needed by the others"
    return (
        f"held-out RMSE goes from {1e3 * before_V:.1f} to {1e3 * after_V:.1f} mV "
        f"({least} to {100 * high:.0f} % less{needed}, 95 % interval over blocks of time)",
        f"e^{accepted.score:.0f} times as probable as the best explanation without it"
        + (f" ({' with '.join(accepted.instead)})" if accepted.instead else ""),
        accepted.cause.signature,
    )


def _tried(
    candidate: Explanation, fits: CauseFits, none: Explanation, runs: Sequence[LogRun]
) -> TriedCause:
    """A single cause as a user would apply it: its error is what `simulate` shows with it."""
    (c,), f = candidate.causes, candidate.fit
    values = c.values(f.coordinates, f.z, fits.evidence.logs[0].start.soc)
    error_V = apply(fits, (c,), f, runs).gain.holdout_rmse_after_V
    return TriedCause(c.name, error_V, values, candidate.found.total - none.found.total)
