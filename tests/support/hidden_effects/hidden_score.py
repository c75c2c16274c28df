"""How a diagnosis of a sealed case is judged, and what a run of cases is allowed to miss."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binom

from emulator_cells import FINE
from emulator_effects import PRINCIPAL
from hidden_cases import HiddenEffect, Sealed, Truth

# What the sizes of cases are multiples of [V], alike for every effect; limits are in README.
SMALL_V = 0.005


@dataclass(frozen=True)
class Outcome:
    """What was hidden in a case and what was found."""

    label: str
    about: str
    hidden: tuple[str, ...]
    size_V: float
    verdict: str
    causes: tuple[str, ...]
    parameter_error: float  # of the first hidden effect, relative to its own size; NaN: not named
    gain_share: float  # of the held-out gain that removing the truth would give; NaN: not named
    seconds: float
    true_parameters: dict[str, float]
    found_parameters: dict[str, float]
    runners_up: tuple[str, ...]

    @property
    def right(self) -> bool:
        """Nothing hidden: nothing found. One: it is the first cause. Two: both are named."""
        if not self.hidden:
            return self.verdict == "none"
        if len(self.hidden) == 1:
            return self.verdict == self.hidden[0]
        return set(self.hidden) <= set(self.causes)

    def line(self) -> str:
        truth = " + ".join(self.hidden) or "nothing"
        said = self.verdict if len(self.causes) < 2 else " + ".join(self.causes)
        values = ", ".join(
            f"{k} {v:.4g}"
            + (f" (found {self.found_parameters[k]:.4g})" if k in self.found_parameters else "")
            for k, v in self.true_parameters.items()
        )
        return (
            f"{'ok ' if self.right else 'NO '} {self.label}: {truth} of {1e3 * self.size_V:.1f} mV "
            f"-> {said}; {values}; gain share {self.gain_share:.2f}; {self.about}; "
            f"runners-up {', '.join(self.runners_up)}; {self.seconds:.1f} s"
        )


def judge(case: Sealed, diagnosis: Any, seconds: float = math.nan) -> Outcome:
    """Open the case with its diagnosis and compare."""
    truth = case.open(diagnosis)
    causes = tuple(diagnosis.causes)
    first = truth.effects[0] if truth.effects else None
    named = {c.name: c for c in causes}
    error, share = math.nan, math.nan
    if first is not None and first.name in named:
        error = parameter_error(case, truth, first, named[first.name], diagnosis)
        share = gain_share(truth, causes)
    return Outcome(
        label=case.label,
        about=truth.about,
        hidden=truth.names,
        size_V=first.size_V if first else 0.0,
        verdict=diagnosis.verdict,
        causes=tuple(c.name for c in causes),
        parameter_error=error,
        gain_share=share,
        seconds=seconds,
        true_parameters=dict(first.parameters) if first else {},
        found_parameters=_numbers(named[first.name].parameters)
        if first and first.name in named
        else {},
        runners_up=_runners_up(diagnosis),
    )


def parameter_error(
    case: Sealed, truth: Truth, effect: HiddenEffect, cause: Any, diagnosis: Any
) -> float:
    """Error of the parameter that says how large the effect is, relative to the true change."""
    if effect.name == "ocv_shift":
        return _curve_error(case, truth, diagnosis)
    name, neutral = PRINCIPAL[effect.name]
    if neutral == "told":
        neutral = truth.soc0[0]
    elif neutral == "model":
        neutral = case.model.capacity_Ah
    found = _numbers(cause.parameters).get(name, math.nan)
    true = effect.parameters[name]
    return abs(found - true) / max(abs(true - float(neutral)), 1e-12)


def _curve_error(case: Sealed, truth: Truth, diagnosis: Any) -> float:
    """Of the OCV's change over the SOC that the logs visited, root mean square over its own."""
    extended = diagnosis.extended_model
    if extended is None:
        return math.nan
    charge = [log.counted_charge_Ah() / case.model.capacity_Ah for log in case.logs]
    soc = np.concatenate([s - c for s, c in zip(truth.soc0, charge, strict=True)])
    at = np.linspace(max(soc.min(), 0.0), min(soc.max(), 1.0), 101)
    fine = np.linspace(0.0, 1.0, FINE)
    true = np.interp(at, fine, truth.world.cell.ocv_V(fine) - truth.plain.cell.ocv_V(fine))
    old, new = (
        np.interp(at, m.soc, m.at_temperature(25.0).ocv_V[0]) for m in (case.model, extended)
    )
    return float(np.sqrt(np.mean((new - old - true) ** 2) / np.mean(true**2)))


def gain_share(truth: Truth, causes: tuple[Any, ...]) -> float:
    """Held-out RMSE taken away, as a share of what removing the hidden effects would take away."""
    before, after = causes[0].holdout_rmse_before_V, causes[-1].holdout_rmse_after_V
    return float((before - after) / max(before - truth.possible_rmse_V, 1e-9))


def allowed_misses(cases: int, miss_rate: float, once_in: float = 1000.0) -> int:
    """Most misses that a build with this ``miss_rate`` exceeds less than once in so many runs.

    The number of misses of independent cases is binomial.
    """
    return int(binom.isf(1.0 / once_in, cases, miss_rate))


def _numbers(parameters: Any) -> dict[str, float]:
    return {k: float(v) for k, v in dict(parameters).items() if np.ndim(v) == 0}


def _runners_up(diagnosis: Any) -> tuple[str, ...]:
    """The three best candidates with their held-out RMSE, whatever the form of the record."""
    listed = []
    for c in getattr(diagnosis, "candidates", ()):
        get = c.get if isinstance(c, dict) else lambda k, c=c: getattr(c, k, None)
        rmse = get("holdout_rmse_V")
        if rmse is not None and np.isfinite(rmse):
            listed.append((float(rmse), str(get("name"))))
    return tuple(f"{name} {1e3 * rmse:.2f} mV" for rmse, name in sorted(listed)[:4])
