"""All figures of replays as a table: the estimators beside one another."""

from __future__ import annotations

from collections.abc import Sequence

from cellwise.estimate.replay import CONVERGED_SOC, Replay, SocErrors
from cellwise.report.page.markup import Markup, paragraph, table
from cellwise.report.page.numerals import (
    counted,
    duration,
    millivolt,
    percent,
    points,
    significant,
)

# Beyond this many replays the table is turned: one row each.
MOST_COLUMNS = 6
EXPLAINED = (
    "± is two standard deviations. "
    "Errors are estimate minus reference, in points of SOC. Settled: after the error has come "
    "within 2 points and stayed there for ten minutes; where it never did, the log's second half. "
    "Inside 2σ: share of rows whose error is within two of the filter's own standard deviations. "
    "NIS: mean squared innovation over what the model states, by time scale; 1 where its statement "
    "is right."
)


def replay_content(replays: Sequence[Replay]) -> Markup:
    """All figures of every replay."""
    columns = [replay_figures(r) for r in replays]
    names = [name for name, _ in columns[0]]
    if len(columns) <= MOST_COLUMNS:
        head = ("", *(r.estimator for r in replays))
        body = [(name, *(column[k][1] for column in columns)) for k, name in enumerate(names)]
        return Markup(paragraph(EXPLAINED, "note") + table(head, body))
    rows = [(r.estimator, *(text for _, text in c)) for r, c in zip(replays, columns, strict=True)]
    return Markup(
        paragraph(EXPLAINED, "note") + table(("estimator", *names), rows, text_columns=(0, 1))
    )


def replay_figures(replay: Replay) -> list[tuple[str, str]]:
    """Every figure of a replay by its name, as text."""
    trace = replay.trace
    start, end = replay.start, (float(trace.soc[-1]), float(trace.soc_std[-1]))
    return [
        ("log", replay.log.name or "log"),
        ("samples", counted(len(trace))),
        ("initial SOC", f"{points(start.soc)} ± {points(2.0 * start.std)}, {start.how}"),
        ("final SOC", f"{points(end[0])} ± {percent(2.0 * end[1])}"),
        *_errors("", replay.errors),
        (f"within {percent(CONVERGED_SOC, 0)} after", reached(replay)),
        *_errors("settled: ", replay.settled),
        ("error inside 2σ", percent(replay.coverage_2sigma, 1)),
        ("NIS", nis_text(replay)),
        ("voltage RMSE", millivolt(replay.voltage_rmse_V)),
        ("time per step", f"{significant(replay.ns_per_step)} ns"),
    ]


def nis_text(replay: Replay) -> str:
    """NIS of every time scale, or the mean where the model is not known."""
    if replay.nis is None or replay.model is None:
        return significant(replay.nis_mean)
    each = zip(replay.nis, replay.model.error.scales_s, strict=True)
    return ", ".join(f"{significant(nis, 2)} ({significant(scale)} s)" for nis, scale in each)


def reached(replay: Replay) -> str:
    """How long the error took to come within two points and stay."""
    if replay.soc_error is None:
        return duration(None)
    if replay.convergence_s is None:
        return "never"
    return "at once" if replay.convergence_s == 0.0 else duration(replay.convergence_s)


def _errors(prefix: str, errors: SocErrors | None) -> list[tuple[str, str]]:
    values = (None, None, None) if errors is None else (errors.rmse, errors.mae, errors.max)
    names = ("SOC RMSE", "SOC MAE", "SOC max. error")
    return [(prefix + n, percent(v)) for n, v in zip(names, values, strict=True)]
