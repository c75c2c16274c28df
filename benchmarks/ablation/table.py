"""What is lost without a mechanism: differences of cases, with an interval over logs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwise.typing import FloatArray

DRAWS, INTERVAL, SEED = 2000, (2.5, 97.5), 27
Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Loss:
    """Of one filter without one mechanism, positive where it does worse.

    ``rmse`` in points of SOC, its ``interval``; ``sigma_over_rmse`` and ``inside`` [%] without it,
    and with everything; ``worst_group`` is where most is lost, ``worst`` how much there.
    """

    mechanism: str
    estimator: str
    rmse: float
    interval: tuple[float, float]
    sigma_over_rmse: tuple[float, float]
    inside: tuple[float, float]
    worst_group: str
    worst: float
    worst_interval: tuple[float, float]

    @property
    def is_noise(self) -> bool:
        """Nothing is lost beyond the interval, neither over all nor where most is."""
        return self.interval[0] <= 0.0 and self.worst_interval[0] <= 0.0


def losses(whole: Rows, without: Mapping[str, Rows]) -> list[Loss]:
    """Every mechanism and filter; a filter that a switch does not touch is left out."""
    found = []
    for mechanism, rows in without.items():
        for estimator in dict.fromkeys(str(r["estimator"]) for r in whole):
            before = [r for r in whole if r["estimator"] == estimator]
            after = [r for r in rows if r["estimator"] == estimator]
            if [r["rmse"] for r in before] != [r["rmse"] for r in after] or [
                r["sigma"] for r in before
            ] != [r["sigma"] for r in after]:
                found.append(_loss(mechanism, estimator, before, after))
    return found


def _loss(mechanism: str, estimator: str, before: Rows, after: Rows) -> Loss:
    groups = np.array([str(r["group"]) for r in before])
    logs = np.array([str(r["log"]) for r in before])
    lost = _column(after, "rmse") - _column(before, "rmse")
    by_group = {str(g): float(lost[groups == g].mean()) for g in dict.fromkeys(groups)}
    worst = max(by_group, key=lambda g: by_group[g])
    inside = groups == worst
    return Loss(
        mechanism,
        estimator,
        float(lost.mean()),
        over_logs(lost, logs),
        (_ratio(before), _ratio(after)),
        (float(_column(before, "inside").mean()), float(_column(after, "inside").mean())),
        worst,
        by_group[worst],
        over_logs(lost[inside], logs[inside]),
    )


def over_logs(values: FloatArray, logs: FloatArray) -> tuple[float, float]:
    """Interval of a mean, drawn over logs: runs of one log are no evidence of their own."""
    names = list(dict.fromkeys(logs))
    sums = np.array([[values[logs == n].sum(), (logs == n).sum()] for n in names])
    draws = np.random.default_rng(SEED).integers(len(names), size=(DRAWS, len(names)))
    drawn = sums[draws].sum(axis=1)
    low, high = np.percentile(drawn[:, 0] / drawn[:, 1], INTERVAL)
    return float(low), float(high)


def _column(rows: Rows, key: str) -> FloatArray:
    return np.array([float(r[key]) for r in rows])


def _ratio(rows: Rows) -> float:
    """Stated deviation over error, in the mean of the logarithm."""
    return float(np.exp(np.mean(np.log(_column(rows, "sigma") / _column(rows, "rmse")))))


def as_markdown(found: Iterable[Loss]) -> str:
    """The table of the docs."""
    head = (
        "| without | filter | points lost (95 %) | sigma/RMSE | rows inside | most lost at |",
        "|---|---|---|---|---|---|",
    )
    return "\n".join([*head, *(_row(loss) for loss in found)]) + "\n"


def _row(loss: Loss) -> str:
    low, high = loss.interval
    at, to = loss.worst_interval
    cells = (
        loss.mechanism,
        loss.estimator,
        f"{loss.rmse:+.2f} ({low:+.2f} .. {high:+.2f})",
        f"{loss.sigma_over_rmse[0]:.2f} -> {loss.sigma_over_rmse[1]:.2f}",
        f"{loss.inside[0]:.0f} -> {loss.inside[1]:.0f} %",
        f"{loss.worst_group}: {loss.worst:+.2f} ({at:+.2f} .. {to:+.2f})",
    )
    return f"| {' | '.join(cells)} |"
