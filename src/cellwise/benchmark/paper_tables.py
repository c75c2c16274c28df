"""Results for papers: every run as CSV, a LaTeX table, paired differences with intervals."""

from __future__ import annotations

import csv
import io
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


def csv_text(rows: Sequence[Mapping[str, Any]], columns: Sequence[str], seed: int) -> str:
    """Every run as CSV, with the seed and the versions; a figure that is not known is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    made_with = provenance()
    writer.writerow([*columns, "seed", "made_with"])
    for row in rows:
        writer.writerow([*(_cell(row[name]) for name in columns), seed, made_with])
    return out.getvalue()


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
        if not own:
            continue
        cells = [
            _latex(name),
            str(len(own)),
            _percent([r["settled_rmse"] for r in own], np.mean),
            _percent([r["settled_max"] for r in own], np.max),
            _number([r["ns_per_step"] for r in own]),
            _against(by.get(name)),
        ]
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


def _against(one: Difference | None) -> str:
    return "--" if one is None else interval_text(one)


def interval_text(one: Difference) -> str:
    """A difference with its interval where it has one, in points of SOC."""
    text = f"{100 * one.mean:+.2f}"
    if np.isfinite(one.low):
        text += f" [{100 * one.low:+.2f}, {100 * one.high:+.2f}]"
    return text


def _percent(values: Sequence[float], of: Callable[[list[float]], Any]) -> str:
    known = [v for v in values if np.isfinite(v)]
    return f"{100 * float(of(known)):.2f}" if known else "--"


def _number(values: Sequence[float]) -> str:
    known = [v for v in values if np.isfinite(v)]
    return f"{np.median(known):,.0f}" if known else "--"


def _latex(text: str) -> str:
    return "".join(_MARKS.get(ch, ch) for ch in text)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return repr(value) if np.isfinite(value) else ""
    return str(value)
