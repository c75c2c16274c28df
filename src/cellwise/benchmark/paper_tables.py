"""Results for papers: a LaTeX table, paired differences with intervals."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from cellwise.typing import FloatArray

SEED = 0  # of the resampling: the same table from the same rows
RESAMPLES = 10_000
FIGURE = "settled_rmse"
SHARES = (2.5, 97.5)
LIBRARIES = ("numpy", "scipy", "numba")
_MARKS = {"&": r"\&", "%": r"\%", "_": r"\_", "#": r"\#", "$": r"\$", "{": r"\{", "}": r"\}"}


class Difference(NamedTuple):
    """One estimator against another on the runs that both have finished.

    ``mean`` is the first's figure less the second's, ``low`` and ``high`` the ends of its 95 %
    interval; ``better`` the share of logs on which the first is better.
    """

    estimator: str
    against: str
    logs: int
    mean: float
    low: float
    high: float
    better: float


def differences(
    rows: Sequence[Mapping[str, Any]], figure: str = FIGURE, against: str | None = None
) -> tuple[Difference, ...]:
    """Every estimator against one of them, on the same logs, faults and starts.

    Runs of one log are not independent, so logs are resampled, not runs (cluster bootstrap: Field
    and Welsh 2007, doi:10.1111/j.1467-9868.2007.00593.x): the mean difference of each log counts
    once.

    Parameters
    ----------
    rows : sequence       as of ``results.parquet``
    figure : str          the smaller the better
    against : str         whom every other one is compared with; None: the best

    Returns
    -------
    tuple of Difference   none of a single estimator; intervals NaN of fewer than three logs
    """
    table: dict[str, dict[tuple[Any, ...], float]] = {}
    for row in rows:
        value = float(row[figure])
        if np.isfinite(value) and not row["problem"]:
            run = (row["log"], row["fault"], row["start_error"], row["dt_s"])
            table.setdefault(str(row["estimator"]), {})[run] = value
    if len(table) < 2:
        return ()
    if against is not None:
        if against not in table:
            return ()
        table = {name: runs for name, runs in table.items() if set(runs) & set(table[against])}
    common = set.intersection(*(set(runs) for runs in table.values()))
    if not common:
        return ()
    mean = {name: float(np.mean([runs[r] for r in common])) for name, runs in table.items()}
    other = min(mean, key=lambda name: mean[name]) if against is None else against
    return tuple(
        _difference(name, other, table[name], table[other])
        for name in sorted(table, key=lambda name: mean[name])
        if name != other
    )


def _difference(
    name: str, best: str, own: Mapping[tuple[Any, ...], float], other: Mapping[Any, float]
) -> Difference:
    of_log: dict[str, list[float]] = {}
    for run in sorted(set(own) & set(other), key=str):
        of_log.setdefault(str(run[0]), []).append(own[run] - other[run])
    means = np.array([np.mean(values) for values in of_log.values()])
    low, high = _interval(means)
    return Difference(
        name, best, means.size, float(means.mean()), low, high, float(np.mean(means < 0))
    )


def _interval(means: FloatArray) -> tuple[float, float]:
    """95 % interval of a mean, by resampling; NaN of fewer than three values."""
    if means.size < 3:
        return float("nan"), float("nan")
    rng = np.random.default_rng(SEED)
    drawn = means[rng.integers(0, means.size, (RESAMPLES, means.size))].mean(axis=1)
    low, high = np.percentile(drawn, SHARES)
    return float(low), float(high)


def latex_text(suite: str, rows: Sequence[Mapping[str, Any]], found: Sequence[Difference]) -> str:
    """A table for a paper (booktabs), with what it was made with."""
    names = list(dict.fromkeys(str(row["estimator"]) for row in rows))
    by = {one.estimator: one for one in found}
    lines = [
        f"% Suite {suite}, {len(rows)} runs. {provenance()}",
        f"% Differences: paired by log, 95 % of {RESAMPLES} resamples of logs, seed {SEED}.",
        r"\begin{tabular}{lrrrrr}",
        r"\toprule",
        r"Estimator & runs & settled RMSE [\%] & settled largest [\%] & ns/step "
        r"& difference [\%] \\",
        r"\midrule",
    ]
    for name in names:
        own = [r for r in rows if r["estimator"] == name and not r["problem"]]
        if own:
            cells = (
                "".join(_MARKS.get(ch, ch) for ch in name),
                str(len(own)),
                _figure(own, "settled_rmse", np.mean, "{:.2f}", 100.0),
                _figure(own, "settled_max", np.max, "{:.2f}", 100.0),
                _figure(own, "ns_per_step", np.median, "{:,.0f}"),
                interval_text(by[name]) if name in by else "--",
            )
            lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def provenance() -> str:
    """Versions that the figures depend on."""
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return f"cellwise {version('cellwise')}, {libraries}, Python {platform.python_version()}"


def difference_text(one: Difference) -> str:
    """One difference as a line, in points of SOC."""
    text = f"{one.estimator} against {one.against}: {100 * one.mean:+.2f} points"
    if np.isfinite(one.low):
        text += f" (95 %: {100 * one.low:+.2f} to {100 * one.high:+.2f})"
    return text + f", better on {100 * one.better:.0f} % of {one.logs} logs"


def interval_text(one: Difference) -> str:
    """A difference with its interval where it has one, in points of SOC."""
    text = f"{100 * one.mean:+.2f}"
    if np.isfinite(one.low):
        text += f" [{100 * one.low:+.2f}, {100 * one.high:+.2f}]"
    return text


def _figure(
    rows: Sequence[Mapping[str, Any]],
    name: str,
    of: Callable[[list[float]], Any],
    form: str,
    scale: float = 1.0,
) -> str:
    known = [row[name] for row in rows if np.isfinite(row[name])]
    return form.format(scale * float(of(known))) if known else "--"
