"""The result of a diagnosis: records with the keys of the command's JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation
from cellwise.diagnose.odds import Weighed
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Notice
from cellwise.plotting import Line, Panel, Plottable, Summarised, Tabular

if TYPE_CHECKING:
    from cellwise.diagnose.sensor_faults import SensorFault


@dataclass(frozen=True, eq=False)
class LogRun:
    """One log with the model as it was and as it is now, from the same start.

    ``corrected`` is the corrected log from the estimated start with the model as it is now, where a
    cause corrects the log or its start instead of the model; else None. ``own_start``: with the
    model as it is now from the start that this model finds itself, where nobody states one and it
    is another than the old model's: what `simulate` shows of the new model by itself.
    """

    log: CellLog
    used: Literal["fit", "holdout"]
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
        before_V = self.before.rmse_V
        return 1.0 - self.explained.rmse_V / before_V if before_V > 0.0 else 0.0

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        known = {
            "log": self.log.name,
            "used": self.used,
            "soc0": self.before.soc0,
            "rmse_before_V": self.before.rmse_V,
            "rmse_after_V": self.after.rmse_V,
        }
        for key, one in (("corrected", self.corrected), ("own_start", self.own_start)):
            if one is not None:
                known |= {f"rmse_{key}_V": one.rmse_V, f"soc0_{key}": one.soc0}
        return known


def judged_runs(runs: Sequence[LogRun]) -> tuple[LogRun, ...]:
    """The logs that were held out; where none was, the first."""
    return tuple(r for r in runs if r.used == "holdout") or tuple(runs[:1])


@dataclass(frozen=True)
class FoundCause:
    """A cause that was accepted.

    ``parameters`` carry their unit in the name, ``ci95`` their 95 % intervals; ``gain`` is
    1 - after / before of the held-out RMSE with its interval from whole blocks of time.
    ``probability`` is what the sets of causes that hold it weigh together. ``kind`` says whether
    the log ("measurement", "start") or the model ("cell") is corrected. ``prior_only`` names
    parameters of which these logs say nothing: their intervals only repeat what is usual. ``log``
    is the name of the one log that it is of, where it is not of all.
    """

    name: str
    kind: str
    meaning: str
    parameters: dict[str, float]
    ci95: dict[str, tuple[float, float]]
    train_rmse_before_V: float
    train_rmse_after_V: float
    holdout_rmse_before_V: float
    holdout_rmse_after_V: float
    gain: float
    gain_ci95: tuple[float, float]
    evidence: tuple[str, ...]
    confusable_with: tuple[str, ...]
    probability: float = float("nan")
    prior_only: tuple[str, ...] = ()
    log: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {**vars(self), "probability": finite(self.probability)}


@dataclass(frozen=True)
class TriedCause:
    """A candidate of the first round: RMSE on held-out data with it alone, and how likely it is.

    ``score`` is ln of how much more likely the data are with it than with none.
    """

    name: str
    holdout_rmse_V: float
    parameters: dict[str, float]
    score: float

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Plottable, Summarised, Tabular):
    """The causes that were found, in order, and the model extended by them.

    ``verdict`` is the first cause, "none", "undetermined" or "unexplained"; ``reasons`` say why the
    search ended; ``limits`` is the smallest change of every parameter that these logs could show,
    ``inseparable`` groups of causes that they do not separate, ``competing`` explanations left;
    ``runs`` are all logs simulated before and after, which every figure is taken from;
    ``no_soc_gain`` says why there is no ``soc_gain``; ``faults`` what sensors did
    wrong; ``candidates`` are all causes that were tried first, ``noise`` is what no cause explains,
    ``anatomy`` where the residual of the first log lies, ``next_test`` the experiment that would
    decide; ``extended_model`` has the causes of the cell, ``corrected`` are the logs without those
    of the measurement; ``soc0`` and ``holdout`` are as given.
    """

    verdict: str
    causes: tuple[FoundCause, ...]
    candidates: tuple[TriedCause, ...]
    anatomy: dict[str, Any]
    next_test: str
    reasons: tuple[str, ...]
    model: CellModel
    extended_model: CellModel | None
    logs: tuple[CellLog, ...] = ()
    holdout: tuple[CellLog, ...] = ()
    corrected: tuple[CellLog, ...] = ()
    soc0: tuple[dict[str, Any], ...] = ()
    soc_gain: dict[str, Any] | None = None
    noise: dict[str, float] = field(default_factory=dict)
    runs: tuple[LogRun, ...] = ()
    no_soc_gain: str = ""
    limits: dict[str, dict[str, float]] = field(default_factory=dict)
    competing: tuple[Weighed, ...] = ()
    inseparable: tuple[tuple[str, ...], ...] = ()
    faults: tuple[SensorFault, ...] = ()

    @property
    def judged(self) -> tuple[LogRun, ...]:
        """The logs that were held out; where none was, the first."""
        return judged_runs(self.runs)

    @property
    def worse(self) -> tuple[LogRun, ...]:
        """Of these logs those whose voltage is further off with the causes known."""
        return tuple(r for r in self.judged if r.gain < 0.0)

    @property
    def soc_worse(self) -> bool:
        """Whether the SOC is further off with the causes known."""
        gain = self.soc_gain or {"soc_rmse_before": 0.0, "soc_rmse_after": 0.0}
        return bool(gain["soc_rmse_after"] > gain["soc_rmse_before"])

    @property
    def adopt(self) -> bool | None:
        """Whether to take the extended model: no log that was held out loses voltage or SOC.

        None where there is none to take: nothing was found, or the logs alone are corrected.
        """
        if self.extended_model is None or all(
            np.array_equal(r.after.voltage_V, r.before.voltage_V) for r in self.runs
        ):
            return None
        return not (self.worse or self.soc_worse)

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What `simulate` says of the logs with the model as it was, beside their reading."""
        every = (n for r in self.runs for n in r.before.notices if n not in r.log.notices)
        return tuple(dict.fromkeys(every))

    def to_dict(self) -> dict[str, Any]:
        """JSON values, keys as the command prints them."""
        return {
            "verdict": self.verdict,
            "adopt": self.adopt,
            "causes": [c.to_dict() for c in self.causes],
            "candidates": [c.to_dict() for c in self.candidates],
            "anatomy": self.anatomy,
            "next_test": self.next_test,
            "reasons": list(self.reasons),
            "soc0": list(self.soc0),
            "soc_gain": self.soc_gain,
            "no_soc_gain": self.no_soc_gain,
            "noise": self.noise,
            "limits": self.limits,
            "competing": [w.to_dict() for w in self.competing],
            "inseparable": [list(g) for g in self.inseparable],
            "logs": [r.to_dict() for r in self.runs],
        }

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Errors of every log over time, before and after [mV]."""
        shown = []
        for run in self.runs:
            hours = (run.log.time_s - run.log.time_s[0]) / 3600.0
            lines = (
                Line(name, hours, 1e3 * one.residual_V)
                for name, one in (("before", run.before), ("after", run.explained))
            )
            shown.append(Panel(f"{run.log.name or 'log'} [mV]", tuple(lines)))
        return "time [h]", tuple(shown)

    def columns(self) -> dict[str, list[Any]]:
        """One row for each parameter of each cause; none where no cause was found."""
        rows = [
            (c.name, c.probability, name, value, *c.ci95.get(name, (np.nan, np.nan)), c.gain)
            for c in self.causes
            for name, value in c.parameters.items()
        ]
        heads = ("cause", "probability", "parameter", "value", "ci95_low", "ci95_high", "gain")
        return {head: [row[k] for row in rows] for k, head in enumerate(heads)}

    def facts(self) -> dict[str, str]:
        """The verdict, every cause with its range, the errors before and after, the next test."""
        causes = {
            cause.name: ", ".join(
                f"{name} {value:.4g} ({cause.ci95[name][0]:.4g} to {cause.ci95[name][1]:.4g})"
                if name in cause.ci95
                else f"{name} {value:.4g}"
                for name, value in cause.parameters.items()
            )
            for cause in self.causes
        }
        errors = (
            f"{run.log.name or 'log'} {1e3 * run.before.rmse_V:.1f} -> "
            f"{1e3 * run.explained.rmse_V:.1f} mV"
            for run in self.runs
        )
        return {
            "verdict": self.verdict, **causes, "RMSE": "; ".join(errors),
            "next test": self.next_test,
        }  # fmt: skip

    def __repr__(self) -> str:
        if not self.causes:
            return f"Diagnosis({self.verdict}: {'; '.join(self.reasons)})"
        parts = []
        for c in self.causes:
            values = ", ".join(f"{k} {v:.4g}" for k, v in list(c.parameters.items())[:3])
            parts.append(f"{c.name} ({values}; held-out RMSE -{100 * c.gain:.0f} %)")
        return f"Diagnosis({', then '.join(parts)})"


def finite(value: float) -> float | None:
    """A JSON number, or null."""
    return float(value) if np.isfinite(value) else None
