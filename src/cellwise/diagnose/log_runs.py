"""Every log simulated as `simulate` does it: the model as it was, as it is now, the log corrected.

What a diagnosis says of itself is said in these figures: all rows, every row counts once, the
start that `simulate` takes, the same one for both models. The likelihood forgives what is
correlated, a simulation does not: so causes that leave the held-out rows no better off are not
kept. Whether the extended model is better, in voltage and in the EKF's SOC, is said of logs that
the fit has not seen.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.metrics import drawn_sums
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation, simulate
from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.decision.outcome import Outcome
from cellwise.diagnose.extension import correct_log, extend_model, split_skew
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit
from cellwise.diagnose.fit.rows import FITTED, HELD, START, Evidence
from cellwise.errors import InputError
from cellwise.estimate.replay import replay
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

Use = Literal["fit", "holdout"]
UsedLog = tuple[CellLog, InitialSoc, Use]


@dataclass(frozen=True, eq=False)
class LogRun:
    """One log with the model as it was and as it is now, from the same start.

    ``corrected`` is the corrected log from the estimated start with the model as it is now, where a
    cause corrects the log or its start instead of the model; else None. ``own_start``: with the
    model as it is now from the start that this model finds itself, where nobody states one and it
    is another than the old model's: what `simulate` shows of the new model by itself.
    """

    log: CellLog
    used: Use
    before: Simulation
    after: Simulation
    corrected: Simulation | None = None
    own_start: Simulation | None = None

    @property
    def explained(self) -> Simulation:
        """With all causes known: of the log, or of its start, too."""
        return self.after if self.corrected is None else self.corrected

    @property
    def gain(self) -> float:
        """1 - after / before of the RMSE, all causes known."""
        rmse = self.before.metrics.rmse_V
        return 1.0 - self.explained.metrics.rmse_V / rmse if rmse > 0.0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        known = {
            "log": self.log.name,
            "used": self.used,
            "soc0": self.before.soc0,
            "rmse_before_V": self.before.metrics.rmse_V,
            "rmse_after_V": self.after.metrics.rmse_V,
        }
        if self.corrected is not None:
            known["rmse_corrected_V"] = self.corrected.metrics.rmse_V
            known["soc0_corrected"] = self.corrected.soc0
        if self.own_start is not None:
            known["rmse_own_start_V"] = self.own_start.metrics.rmse_V
            known["soc0_own_start"] = self.own_start.soc0
        return known


@dataclass(frozen=True, eq=False)
class Explanation:
    """Causes as a user applies them: an extended model, what the logs lose, where they start.

    ``of_log`` are coordinates of the instrument; ``starts`` are None where every log starts where
    it did: the model alone is corrected, and no start was found by taking it for right.
    """

    model: CellModel
    of_log: Mapping[str, float]
    starts: tuple[float, ...] | None

    def corrected(self, log: CellLog, found: Fit) -> CellLog:
        """The log without the instrument's errors."""
        return correct_log(log, found.coordinates, self.of_log)


def explanation(
    found: Fit,
    point: Mapping[str, float],
    kinds: Sequence[str],
    evidence: Evidence,
    note: Mapping[str, Any],
) -> Explanation:
    """What a fit's ``point`` (causes alone) makes of the model, the logs and their starts.

    ``kinds`` are those of the causes; starts that were given stay, unless a cause is one. Where the
    model alone is corrected, only those move that all of the log had chosen with the model as it
    was, and all that a rest or a minute had shown through an OCV that is another one now.
    """
    interval = float(np.median(np.concatenate([g.dt_s[1:] for g in evidence.logs])))
    of_model, of_log = split_skew(found.coordinates, point, interval)
    model = extend_model(found.coordinates, of_model, note)
    moved = not np.array_equal(model.ocv_V, found.coordinates.model.ocv_V)
    moved = moved or point.get("m_V", 0.0) != 0.0
    as_stated = {
        name: _starts_as_stated(g.start, set(kinds), moved)
        for name, g in zip(evidence.starts(), evidence.logs, strict=True)
    }
    starts = None
    if not all(as_stated.values()) or {"measurement", "start"} & set(kinds):
        starts = tuple(
            g.start.soc if same else _inside(g.start.soc + found.z.get(name, 0.0))
            for (name, same), g in zip(as_stated.items(), evidence.logs, strict=True)
        )
    return Explanation(model, of_log, starts)


def _starts_as_stated(start: InitialSoc, kinds: set[str], ocv_moved: bool) -> bool:
    """Whether a log starts where it did once causes of these kinds are known.

    A rest is read through the OCV: where that has ``ocv_moved``, by a hysteresis or otherwise, it
    says another SOC.
    """
    if "start" in kinds:
        return False
    if "measurement" in kinds or ocv_moved:
        return start.how in ("given", "stated")
    return start.beginning is None


def with_use(logs: Sequence[tuple[CellLog, InitialSoc]], fitted: int) -> list[UsedLog]:
    """Logs with their use: the first ``fitted`` were fitted, the others held out."""
    return [(g, start, "fit" if k < fitted else "holdout") for k, (g, start) in enumerate(logs)]


def log_runs(
    model: CellModel,
    logs: Sequence[UsedLog],
    found: Fit | None = None,
    explained: Explanation | None = None,
) -> tuple[LogRun, ...]:
    """Every log before and after; without an explanation nothing changes."""
    runs = []
    for k, (log, start, used) in enumerate(logs):
        soc0 = _inside(start.soc)
        before = simulate(model, log, soc0)
        if explained is None or found is None:
            runs.append(LogRun(log, used, before, before))
            continue
        after = simulate(explained.model, log, soc0)
        corrected = None
        if explained.starts is not None:
            seen = explained.corrected(log, found)
            corrected = simulate(explained.model, seen, explained.starts[k])
        runs.append(LogRun(log, used, before, after, corrected))
    return tuple(runs)


def judged_runs(runs: Sequence[LogRun]) -> tuple[LogRun, ...]:
    """The logs that were held out; where none was, the first."""
    return tuple(r for r in runs if r.used == "holdout") or tuple(runs[:1])


def with_own_starts(
    model: CellModel, runs: Sequence[LogRun], logs: Sequence[UsedLog]
) -> tuple[LogRun, ...]:
    """The runs with what a new model shows from the starts that it finds itself."""
    found = []
    for run, (log, start, _) in zip(runs, logs, strict=True):
        if start.how not in ("given", "stated"):
            own = _inside(initial_soc(model, log, whole_log=True).soc)
            if own != run.after.soc0:
                run = replace(run, own_start=simulate(model, log, own))
        found.append(run)
    return tuple(found)


@dataclass(frozen=True)
class Step:
    """RMSE [V] without and with a cause, and 1 - after / before with its 95 % interval."""

    train_before_V: float
    train_after_V: float
    held_before_V: float
    held_after_V: float
    gain: float
    low: float
    high: float


def step_between(
    evidence: Evidence,
    one: Sequence[Simulation],
    two: Sequence[Simulation],
    rng: np.random.Generator,
) -> Step:
    """What one more cause gains; simulations of all logs without and with it.

    Held out are whole logs, else the later blocks of every log. Blocks of time are drawn whole.
    """
    before, after = (np.concatenate([s.error_V for s in runs]) for runs in (one, two))
    held, fitted, block = _parts(evidence, before.size)
    used = held & np.isfinite(before) & np.isfinite(after)
    squares = np.column_stack((before, after))[used] ** 2
    low = high = gain = float("nan")
    if used.any():
        totals = drawn_sums(block[used], squares, rng)
        gains = 1.0 - np.sqrt(totals[:, 1] / np.maximum(totals[:, 0], 1e-30))
        low, high = (float(x) for x in np.quantile(gains, (0.025, 0.975)))
    held_before, held_after = _rms(before, held), _rms(after, held)
    gain = 1.0 - held_after / held_before if held_before > 0.0 else 0.0
    return Step(_rms(before, fitted), _rms(after, fitted), held_before, held_after, gain, low, high)


def _parts(evidence: Evidence, rows: int) -> tuple[BoolArray, BoolArray, FloatArray]:
    """Held-out and fitted rows and the block of every row, from those of the scored rows."""
    held, fitted, block = [], [], []
    for g in evidence.logs:
        place = np.arange(len(g.log)) // g.stride
        role = g.role[place]
        held.append((role == HELD) | (role == START))
        fitted.append(role == FITTED)
        block.append(g.block[place])
    return np.concatenate(held), np.concatenate(fitted), np.concatenate(block)


def _rms(error: FloatArray, rows: BoolArray) -> float:
    used = error[rows & np.isfinite(error)]
    return float(np.sqrt(np.mean(used * used))) if used.size else float("nan")


def _inside(soc: float) -> float:
    return min(max(float(soc), 0.0), 1.0)


@dataclass(frozen=True, eq=False)
class Applied:
    """Causes, the fit that they are taken from, and every log before and after."""

    causes: tuple[Cause, ...]
    fit: Fit
    explained: Explanation
    runs: tuple[LogRun, ...]
    step: Step


def apply(fits: CauseFits, causes: Sequence[Cause], near: Fit, logs: Sequence[UsedLog]) -> Applied:
    """The causes applied to all logs, the cell's tolerances at neutral."""
    point = fits.point(near, kept_coordinates(causes))
    note = {"causes": [c.name for c in causes]}
    explained = explanation(near, point, [c.kind for c in causes], fits.evidence, note)
    runs = log_runs(fits.coordinates.model, logs, near, explained)
    step = step_between(
        fits.evidence,
        [r.before for r in runs],
        [r.explained for r in runs],
        np.random.default_rng(fits.seed),
    )
    return Applied(tuple(causes), near, explained, runs, step)


def applied(fits: CauseFits, outcome: Outcome, logs: Sequence[UsedLog]) -> Applied | None:
    """The accepted causes applied; those that leave held-out rows no better off, the last first.

    None where nothing is left.
    """
    causes = [a.cause for a in outcome.accepted]
    near = outcome.fit
    while causes:
        found = apply(fits, causes, near, logs)
        if found.step.held_after_V < found.step.held_before_V:
            return found
        causes = causes[:-1]
        if causes:
            near = fits.fit_causes(causes, near, outcome.noise)
    return None


def kept(outcome: Outcome, found: Applied | None) -> Outcome:
    """The outcome with the causes that were kept."""
    known = () if found is None else found.causes
    return replace(outcome, accepted=tuple(a for a in outcome.accepted if a.cause in known))


@dataclass(frozen=True)
class Reference:
    """A capacity [Ah] and where it is from, or why there is none (``capacity_Ah`` is None)."""

    capacity_Ah: float | None
    source: str


def reference_for(model: CellModel, stated_Ah: float | None, named: Collection[str]) -> Reference:
    """What SOC is judged over: the stated capacity, else the model file's.

    Parameters
    ----------
    stated_Ah : float or None     capacity that the user states [Ah]
    named : names of the causes that were found
    """
    if "initial_soc" in named:
        return Reference(None, "the initial SOC is one of the causes, so no SOC is known")
    if stated_Ah is not None:
        return Reference(float(stated_Ah), "stated")
    if "capacity" in named:
        return Reference(
            None,
            "the capacity is one of the causes, and a SOC over it would prove itself; "
            "state one that was measured (`reference_capacity_Ah=X`)",
        )
    choice = model.provenance.get("capacity", {})
    how = choice.get("choice", "") if isinstance(choice, dict) else ""
    return Reference(model.capacity_Ah, f"the model's own ({how or 'as its file says'})")


def soc_gain(
    model: CellModel, extended: CellModel, runs: Sequence[LogRun], reference: Reference
) -> tuple[dict[str, Any] | None, str]:
    """SOC RMSE [1] of the EKF with the model as it was and as it is now.

    Of several logs the one that loses most, where one loses; else the first. The referee is the
    tester's own counter over a capacity that the diagnosis did not estimate, from a start that it
    did not estimate: else what is to be judged would judge itself.

    Returns
    -------
    dict or None      ``log``, ``soc_rmse_before``, ``soc_rmse_after``, ``reference_capacity_Ah``,
                      ``reference``
    str               why there is none; empty if there is
    """
    if reference.capacity_Ah is None:
        return None, reference.source
    gains: list[dict[str, Any]] = []
    why = ""
    for run in runs:
        try:
            gains.append(_soc_gain(model, extended, run, reference))
        except InputError as error:
            why = why or error.found
    if not gains:
        return None, why

    def loss(gain: dict[str, Any]) -> float:
        return float(gain["soc_rmse_after"] - gain["soc_rmse_before"])

    worst = max(gains, key=loss)
    return (worst if loss(worst) > 0.0 else gains[0]), ""


def _soc_gain(
    model: CellModel, extended: CellModel, run: LogRun, reference: Reference
) -> dict[str, Any]:
    """Of one log.

    Raises
    ------
    InputError        there is no counter, or it does not cover the log
    """
    name = run.log.name or "the log"
    if run.log.charge_Ah is None:
        raise InputError(f"{name} has no counter of the tester", "one", "")
    start = run.before.soc0
    errors = []
    for cell, seen in ((model, run.log), (extended, run.explained.log)):
        found = replay(
            cell,
            seen,
            "ekf",
            soc0=start,
            reference_soc0=start,
            reference_capacity_Ah=reference.capacity_Ah,
        ).errors
        if found is None:
            raise InputError(f"the counter does not cover {name}", "one that does", "")
        errors.append(found.rmse)
    return {
        "log": run.log.name,
        "soc_rmse_before": errors[0],
        "soc_rmse_after": errors[1],
        "reference_capacity_Ah": reference.capacity_Ah,
        "reference": reference.source,
    }
