"""Noise of a filter from logs of the cell in use: what its own innovations say."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.noise import Noise
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.units import check_is_log
from cellwise.plotting import Tabular
from cellwise.typing import FloatArray

# How far a figure may leave its prior, as a factor of one standard deviation: the sensors' are
# known from their data sheets, the model's own from one validation. The drift of the counted charge
# is left alone: a SOC that drifts explains any slow error of the voltage.
SENSORS = ("voltage_V", "current_A")
MODEL = ("error_scale", "branch_share")
SENSOR_FACTOR = 1.3
MODEL_FACTOR = 3.0
EVALUATIONS = 250
SMALLEST = 1e-6
LARGEST_SQUARE = 25.0  # a rejected voltage counts as one at the gate


@dataclass(frozen=True)
class NoiseTuning(Tabular):
    """Tuned noise, and the mean NIS of every log before and after.

    ``log_likelihood`` is of independent innovations, prior included, before and after.
    """

    noise: Noise
    before: Noise
    logs: tuple[str, ...]
    nis_before: tuple[float, ...]
    nis_after: tuple[float, ...]
    log_likelihood: tuple[float, float]

    @property
    def changed(self) -> dict[str, tuple[float, float]]:
        """Every tuned figure, before and after."""
        return {
            name: (getattr(self.before, name), getattr(self.noise, name))
            for name in (*SENSORS, *MODEL)
        }

    def columns(self) -> dict[str, list[Any]]:
        """One row for each tuned figure of :class:`Noise`, before and after."""
        before, after = zip(*self.changed.values(), strict=True)
        return {"figure": list(self.changed), "before": list(before), "after": list(after)}

    def __repr__(self) -> str:
        given = ", ".join(f"{k} {a:.3g} -> {b:.3g}" for k, (a, b) in self.changed.items())
        return (
            f"NoiseTuning(mean NIS {np.mean(self.nis_before):.2f} -> "
            f"{np.mean(self.nis_after):.2f}; {given})"
        )


def tune_noise(
    model: CellModel,
    logs: CellLog | Sequence[CellLog],
    soc0: float | Sequence[float | None] | None = None,
    *,
    sensors: Noise | None = None,
) -> NoiseTuning:
    r"""Noise under which the innovations of some logs are likeliest.

    .. math:: \max_\theta \sum_k w_k \log N(\nu_k; 0, S_k(\theta))
       - \tfrac12 \sum_j \left( \frac{\ln \theta_j - \ln \theta_{j0}}{\ln f_j} \right)^2

    The weight :math:`w_k = \min(\Delta t / 2 \tau_c, 1)` counts the samples that share one model
    error once. Tuned are the sensors' noise (f = 1.3 about what is stated), the model error's scale
    and the resistances' share (f = 3 about the model's own validation).

    Parameters
    ----------
    model : CellModel
    logs : CellLog or several      of the cell in use; never those on which it is judged afterwards
    soc0 : float, several or None  initial SOC of every log, None where it has to be found
    sensors : Noise or None        where to start, with the sensors' data; None: from the model

    Raises
    ------
    InputError        no log; as many starts as logs are needed; a log without a usable voltage
    """
    check_is_model(model)
    logs = (logs,) if isinstance(logs, CellLog) else logs
    if not logs:
        raise InputError("no log to tune with", "at least one", "Give a log of the cell in use.")
    for log in logs:
        check_is_log(log)
    given: list[float | None] = [None] * len(logs)
    if isinstance(soc0, Iterable) and not isinstance(soc0, str):
        given = list(soc0)
    elif soc0 is not None:
        given = [soc0] * len(logs)
    if len(given) != len(logs):
        raise InputError(
            f"{len(given)} initial SOCs for {len(logs)} logs",
            "one each",
            "Give None where unknown.",
        )
    before = Noise.of_model(model) if sensors is None else sensors
    starts = [initial_soc(model, log, s) for log, s in zip(logs, given, strict=True)]
    names = tuple(n for n in (*SENSORS, *MODEL) if getattr(before, n) > SMALLEST)
    first = np.log([getattr(before, n) for n in names])
    width = np.log([SENSOR_FACTOR if n in SENSORS else MODEL_FACTOR for n in names])

    def noise_of(theta: FloatArray) -> Noise:
        return replace(before, **dict(zip(names, np.exp(theta).tolist(), strict=True)))

    def run(noise: Noise) -> list[Trace]:
        ekf = Ekf(model, noise)
        return [ekf.run(g, s.soc, s.std) for g, s in zip(logs, starts, strict=True)]

    def cost(theta: FloatArray) -> float:
        noise = noise_of(theta)
        seen = sum(
            log_likelihood(log, trace, noise) for log, trace in zip(logs, run(noise), strict=True)
        )
        return float(0.5 * np.sum(((theta - first) / width) ** 2) - seen)

    found = minimize(
        cost,
        first,
        method="Nelder-Mead",
        options={
            "maxfev": EVALUATIONS,
            "xatol": 0.02,
            "fatol": 0.02,
            "initial_simplex": np.vstack([first, first + 0.5 * np.diag(width)]),
        },
    )
    after = noise_of(found.x)
    old, new = (tuple(t.nis_mean or np.nan for t in run(n)) for n in (before, after))
    if not np.all(np.isfinite(old)):
        bad = logs[int(np.argmin(np.isfinite(old)))].name
        raise InputError(
            f"no usable voltage in log '{bad}'", "a log that the model can follow", "Leave it out."
        )
    return NoiseTuning(
        noise=after,
        before=before,
        logs=tuple(log.name for log in logs),
        nis_before=old,
        nis_after=new,
        log_likelihood=(-cost(first), -float(found.fun)),
    )


def log_likelihood(log: CellLog, trace: Trace, noise: Noise) -> float:
    """Of the innovations of one replay, samples that share an error counted once."""
    known = np.isfinite(trace.innovation_V)
    known[: int(np.argmax(known)) + 1] = False  # the first is about the start, not of the noise
    variance = trace.innovation_variance_V2[known]
    square = np.minimum(trace.innovation_V[known] ** 2 / variance, LARGEST_SQUARE)
    memory = 2.0 * noise.slow_s
    dt = log.interval_s[known]
    weight = np.minimum(dt / memory, 1.0) if memory > 0.0 else np.ones_like(dt)
    return float(-0.5 * np.sum(weight * (square + np.log(2.0 * np.pi * variance))))
