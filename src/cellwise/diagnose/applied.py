"""Causes as a user applies them: an extended model, corrected logs, other starts, and the gain.

What a diagnosis says of itself is said in the figures of `simulate`: all rows, every row counts
once, the start that `simulate` takes, the same one for both models. The likelihood forgives what is
correlated, a simulation does not: so causes that leave the held-out rows no better off are not
kept. Whether the extended model is better, in voltage and in the EKF's SOC, is said of logs that
the fit has not seen.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.metrics import drawn_sums
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation, simulate
from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.extension import correct_log, extend_model, split_skew
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit
from cellwise.diagnose.fit.rows import FITTED, Evidence
from cellwise.diagnose.sets import Outcome
from cellwise.estimate.replay import replay
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

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
        return _gain(self.before.metrics.rmse_V, self.explained.metrics.rmse_V)

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        known = {
            "log": self.log.name,
            "used": self.used,
            "soc0": self.before.soc0,
            "rmse_before_V": self.before.metrics.rmse_V,
            "rmse_after_V": self.after.metrics.rmse_V,
        }
        for key, one in (("corrected", self.corrected), ("own_start", self.own_start)):
            if one is not None:
                known |= {f"rmse_{key}_V": one.metrics.rmse_V, f"soc0_{key}": one.soc0}
        return known


def with_use(logs: Sequence[tuple[CellLog, InitialSoc]], fitted: int) -> list[UsedLog]:
    """Logs with their use: the first ``fitted`` were fitted, the others held out."""
    return [(g, start, "fit" if k < fitted else "holdout") for k, (g, start) in enumerate(logs)]


def plain_runs(model: CellModel, logs: Sequence[UsedLog]) -> tuple[LogRun, ...]:
    """Every log with the model as it is."""
    simulated = (simulate(model, log, _inside(start.soc)) for log, start, _ in logs)
    return tuple(LogRun(g[0], g[2], s, s) for g, s in zip(logs, simulated, strict=True))


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
    evidence: Evidence, one: Iterable[Simulation], two: Iterable[Simulation], seed: int
) -> Step:
    """What one more cause gains; simulations of all logs without and with it.

    Held out are whole logs, else the later blocks of every log. Blocks of time are drawn whole.
    """
    before, after = (np.concatenate([s.error_V for s in runs]) for runs in (one, two))
    # A row that was thinned away is what the scored row before it is.
    of_rows = [(g, np.arange(len(g.log)) // g.stride) for g in evidence.logs]
    fitted = np.concatenate([g.role[place] == FITTED for g, place in of_rows])
    block = np.concatenate([g.block[place] for g, place in of_rows])
    low = high = float("nan")
    used = ~fitted & np.isfinite(before) & np.isfinite(after)
    if used.any():
        squares = np.column_stack((before, after))[used] ** 2
        totals = drawn_sums(block[used], squares, np.random.default_rng(seed))
        gains = 1.0 - np.sqrt(totals[:, 1] / np.maximum(totals[:, 0], 1e-30))
        low, high = (float(x) for x in np.quantile(gains, (0.025, 0.975)))
    train = _rms(before[fitted]), _rms(after[fitted])
    held = _rms(before[~fitted]), _rms(after[~fitted])
    return Step(*train, *held, _gain(*held), low, high)


def _rms(error: FloatArray) -> float:
    used = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(used * used))) if used.size else float("nan")


def _gain(before: float, after: float) -> float:
    return 1.0 - after / before if before > 0.0 else 0.0


def _inside(soc: float) -> float:
    return min(max(float(soc), 0.0), 1.0)


@dataclass(frozen=True, eq=False)
class Applied:
    """Causes, the fit that they are taken from, and every log before and after.

    ``of_log`` are coordinates of the instrument.
    """

    causes: tuple[Cause, ...]
    fit: Fit
    model: CellModel
    of_log: Mapping[str, float]
    runs: tuple[LogRun, ...]
    step: Step


def apply(fits: CauseFits, causes: Sequence[Cause], near: Fit, logs: Sequence[UsedLog]) -> Applied:
    """The causes applied to all logs, the cell's tolerances at neutral."""
    evidence, old = fits.evidence, fits.coordinates.model
    interval = float(np.median(np.concatenate([g.dt_s[1:] for g in evidence.logs])))
    point = fits.point(near, kept_coordinates(causes))
    of_model, of_log = split_skew(near.coordinates, point, interval)
    model = extend_model(near.coordinates, of_model, {"causes": [c.name for c in causes]})
    moved = not np.array_equal(model.ocv_V, old.ocv_V) or point.get("m_V", 0.0) != 0.0
    starts = starts_with({c.kind for c in causes}, moved, near.z, [g.start for g in evidence.logs])
    runs = []
    for k, run in enumerate(plain_runs(old, logs)):
        seen = None
        if starts is not None:
            seen = simulate(model, correct_log(run.log, of_log, k), starts[k])
        runs.append(replace(run, after=simulate(model, run.log, run.before.soc0), corrected=seen))
    step = step_between(evidence, (r.before for r in runs), (r.explained for r in runs), fits.seed)
    return Applied(tuple(causes), near, model, of_log, tuple(runs), step)


def starts_with(
    kinds: set[str], ocv_moved: bool, z: Mapping[str, float], starts: Sequence[InitialSoc]
) -> tuple[float, ...] | None:
    """Where every log starts once causes of these kinds are known; None: where it did.

    Starts that were given stay, unless a cause is one. A rest is read through the OCV: where that
    has ``ocv_moved``, by a hysteresis or otherwise, it says another SOC. Where the model alone is
    corrected, only those move that all of the log had chosen with the model as it was.
    """

    def stays(start: InitialSoc) -> bool:
        if "start" in kinds:
            return False
        if "measurement" in kinds or ocv_moved:
            return start.how in ("given", "stated")
        return start.beginning is None

    if all(map(stays, starts)) and not {"measurement", "start"} & kinds:
        return None
    return tuple(
        s.soc if stays(s) else _inside(s.soc + z.get(f"soc0:{k}", 0.0))
        for k, s in enumerate(starts)
    )


def applied(fits: CauseFits, outcome: Outcome, logs: Sequence[UsedLog]) -> Applied | None:
    """The accepted causes applied, without those that leave held-out rows no better off.

    The last first; None where nothing is left. What is of one fitted log alone moves no other, and
    is judged there.
    """
    causes, near = list(outcome.causes), outcome.fit
    while causes:
        found = apply(fits, causes, near, logs)
        step = found.step
        if step.held_after_V < step.held_before_V:
            return found
        alone = all(c.log is not None for c in causes) and step.train_after_V < step.train_before_V
        if alone and step.held_after_V == step.held_before_V:
            return found
        causes.pop()
        if causes:
            near = fits.fit_causes(causes, near, outcome.scale)
    return None


def soc_gain(
    known: Applied, old: CellModel, extended: CellModel, stated_Ah: float | None
) -> tuple[dict[str, Any] | None, str]:
    """SOC RMSE [1] of the EKF with the model as it was and as it is now.

    Of several logs the one that loses most, where one loses; else the first. The referee is the
    tester's own counter over a capacity that the diagnosis did not estimate (``stated_Ah``, else
    the model file's), from a start that it did not estimate: else what is to be judged would judge
    itself.

    Returns
    -------
    dict or None      ``log``, ``soc_rmse_before``, ``soc_rmse_after``, ``reference_capacity_Ah``,
                      ``reference``
    str               why there is none; empty if there is
    """
    named = {c.name for c in known.causes}
    if "initial_soc" in named:
        return None, "the initial SOC is one of the causes, so no SOC is known"
    if stated_Ah is None and "capacity" in named:
        return None, (
            "the capacity is one of the causes, and a SOC over it would prove itself; "
            "state one that was measured (`reference_capacity_Ah=X`)"
        )
    choice = old.provenance.get("capacity", {})
    how = choice.get("choice", "") if isinstance(choice, dict) else ""
    source = f"the model's own ({how or 'as its file says'})" if stated_Ah is None else "stated"
    reference_Ah = old.capacity_Ah if stated_Ah is None else float(stated_Ah)
    gains: list[dict[str, Any]] = []
    why = ""
    for run in judged_runs(known.runs):
        name, start, errors = run.log.name or "the log", run.before.soc0, []
        if run.log.charge_Ah is None:
            why = why or f"{name} has no counter of the tester"
            continue
        for cell, seen in ((old, run.log), (extended, run.explained.log)):
            errors.append(
                replay(
                    cell, seen, "ekf", soc0=start, reference_soc0=start,
                    reference_capacity_Ah=reference_Ah,
                ).errors
            )  # fmt: skip
        if None in errors:
            why = why or f"the counter does not cover {name}"
            continue
        before, after = (e.rmse for e in errors if e is not None)
        gains.append(
            {
                "log": run.log.name,
                "soc_rmse_before": before,
                "soc_rmse_after": after,
                "reference_capacity_Ah": reference_Ah,
                "reference": source,
            }
        )
    if not gains:
        return None, why
    worst = max(gains, key=lambda g: g["soc_rmse_after"] - g["soc_rmse_before"])
    return (worst if worst["soc_rmse_after"] > worst["soc_rmse_before"] else gains[0]), ""
