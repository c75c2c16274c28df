"""The papers' tables as people read them."""

from __future__ import annotations

from collections.abc import Sequence
from io import StringIO

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from cellwise.studies.lfp_paper import CHOICES, LFP_EMBEDDED, LfpTables
from cellwise.studies.ncr_paper import METHODS, NMC_EMBEDDED, RateResult
from cellwise.studies.published import (
    LFP_CAPACITIES,
    LFP_CELL,
    LFP_ERRORS,
    LFP_POLYNOMIALS,
    LFP_TEST_CHARGES_AH,
    NCA_CELL,
    NCA_RESIDUALS,
)

PAPER = "published"


def papers_text(lfp: LfpTables, ncr: Sequence[RateResult], width: int = 120) -> str:
    """All tables as plain text of at most ``width`` columns."""
    console = Console(file=StringIO(), width=width, no_color=True, highlight=False)
    print_papers(lfp, ncr, console)
    out = console.file
    return out.getvalue() if isinstance(out, StringIO) else ""


def print_papers(lfp: LfpTables, ncr: Sequence[RateResult], console: Console) -> None:
    """All tables on a console."""
    console.print(f"[bold]LFP040AHA paper[/bold] on {LFP_EMBEDDED}.")
    console.print(
        f"Columns headed '{PAPER}' are the paper's own, measured on another cell: {LFP_CELL}.",
        style="dim",
    )
    for table in lfp_rich(lfp):
        console.print(table)
    console.print(f"[bold]NCR18650B paper[/bold] on {NMC_EMBEDDED}.")
    console.print(
        f"Rows headed '{PAPER}' are the paper's own, measured on another cell: {NCA_CELL}.",
        style="dim",
    )
    for table in ncr_rich(ncr):
        console.print(table)


def lfp_rich(found: LfpTables) -> list[Table]:
    """Capacity, pulses, polynomials, error by capacity."""
    return [_capacity(found), _pulses(found), _polynomials(found), _errors(found)]


def ncr_rich(found: Sequence[RateResult]) -> list[Table]:
    """Errors and residuals by characterization rate."""
    errors = _table(
        "Voltage error on the same HPPC current",
        "rate",
        "capacity Ah",
        "method",
        "RMSE mV",
        "MAE mV",
        "max mV",
    )
    residuals = _table(
        "Residuals, measured minus simulated",
        "rate",
        "method",
        "mean mV",
        "std mV",
        "95 % interval mV",
    )
    for row in found:
        for k, (name, m) in enumerate(row.errors.items()):
            first = (row.rate, f"{row.capacity_Ah:.3f}") if k == 0 else ("", "")
            errors.add_row(
                *first,
                METHODS[name],
                *(f"{1e3 * x:.1f}" for x in (m.rmse_V, m.mae_V, m.max_error_V)),
            )
            residuals.add_row(
                first[0],
                METHODS[name],
                f"{1e3 * m.mean_error_V:.1f}",
                f"{1e3 * m.std_error_V:.1f}",
                _interval(*(1e3 * x for x in m.ci95_V)),
            )
        there = NCA_RESIDUALS.get(row.rate)
        if there is not None:
            errors.add_row(
                "",
                f"{there.capacity_Ah:.3f}",
                f"{PAPER}, segments",
                f"{there.rmse_mV:.1f}",
                f"{there.mae_mV:.1f}",
                f"{there.max_mV:.1f}",
                style="dim",
            )
            residuals.add_row(
                "",
                f"{PAPER}, segments",
                f"{there.mean_mV:.1f}",
                f"{there.std_mV:.1f}",
                _interval(*there.ci95_mV),
                style="dim",
            )
        errors.add_section()
        residuals.add_section()
    return [errors, residuals]


def _capacity(found: LfpTables) -> Table:
    table = _table(
        "Capacity by discharge tests",
        "rate",
        "total Ah",
        "CC part",
        "CV part",
        f"{PAPER}: total",
        "CC",
        "CV",
    )
    for row in found.capacities:
        there = LFP_CAPACITIES.get(row.rate)
        values = ("", "", "") if there is None else tuple(f"{x:.4g}" for x in there)
        table.add_row(
            row.rate, f"{row.total_Ah:.3f}", f"{row.cc_Ah:.3f}", f"{row.cv_Ah:.3f}", *values
        )
    return table


def _pulses(found: LfpTables) -> Table:
    table = _table(
        "Pulses of the HPPC tests",
        "test",
        "from SOC",
        "Ah",
        "healthy",
        "trimmed",
        "distorted",
        "spurious",
        f"{PAPER}: Ah",
    )
    for k, t in enumerate(found.tests):
        there = f"{LFP_TEST_CHARGES_AH[k]:.2f}" if k < len(LFP_TEST_CHARGES_AH) else ""
        table.add_row(
            str(t.number),
            f"{t.soc_start:.3f}",
            f"{t.charge_Ah:.4f}",
            str(t.healthy),
            str(t.trimmed),
            str(t.distorted),
            str(t.spurious),
            there,
        )
    table.add_section()
    sums = [
        sum(getattr(t, q) for t in found.tests)
        for q in ("healthy", "trimmed", "distorted", "spurious")
    ]
    table.add_row(
        "all", "", f"{found.hppc_Ah:.4f}", *map(str, sums), f"{sum(LFP_TEST_CHARGES_AH):.2f}"
    )
    return table


def _polynomials(found: LfpTables) -> Table:
    table = _table(
        f"Polynomials a + b s + c s^2 + d s^3 ({found.method} on healthy pulses)",
        "",
        "a",
        "b",
        "c",
        "d",
        f"{PAPER}: a",
        "b",
        "c",
        "d",
    )
    for p in found.polynomials:
        unit = "ohm" if p.parameter.startswith("R") else "F"
        table.add_row(
            f"{p.parameter} [{unit}]".replace("[", r"\["),
            *(f"{x:.4g}" for x in (p.a, p.b, p.c, p.d)),
            *(f"{x:.4g}" for x in LFP_POLYNOMIALS[p.parameter]),
        )
    return table


def _errors(found: LfpTables) -> Table:
    table = _table(
        "Charge-depleting cycle by capacity choice; % of the measured voltage; window 5-180 min",
        "Q Ah",
        "chosen as",
        "method",
        "RMS mV",
        "mean %",
        "in window",
        "peak %",
        "in window",
    )
    for e in found.errors:
        there = LFP_ERRORS[e.choice]
        for k, (name, x) in enumerate(
            ((f"{found.method}, cubic", e.paper), ("varpro, refined", e.ours))
        ):
            first = (f"{e.capacity_Ah:.3f}", CHOICES[e.choice]) if k == 0 else ("", "")
            shares = (x.mean_abs, x.mean_abs_window, x.peak, x.peak_window)
            table.add_row(*first, name, f"{1e3 * x.rms_V:.1f}", *(f"{100 * s:.3g}" for s in shares))
        table.add_row(
            f"{there.capacity_Ah:.1f}",
            "",
            f"{PAPER}, pso, cubic",
            *(f"{x:.3g}" for x in there[1:]),
            style="dim",
        )
        table.add_section()
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE, pad_edge=False)
    text_columns = {"method", "chosen as", "rate", ""}
    for name in columns:
        table.add_column(name, justify="left" if name in text_columns else "right")
    return table


def _interval(low: float, high: float) -> str:
    return f"[{low:.1f}, {high:.1f}]".replace("[", r"\[")
