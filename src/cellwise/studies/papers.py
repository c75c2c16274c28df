"""The tables of the two papers that cellwise starts from, on the embedded data, and as text.

The embedded cells are not the papers' cells: the published numbers stand beside ours as a
reference for the method, not as a target.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cellwise.cell.metrics import metrics_to_dict
from cellwise.errors import InputError
from cellwise.identify.pipeline import Progress
from cellwise.identify.pulse_fit.fit_pulse import Method
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.studies.paper_tables import (
    CHOICES,
    LFP_EMBEDDED,
    METHODS,
    NMC_EMBEDDED,
    QUALITIES,
    LfpTables,
    RateResult,
    lfp_tables,
    ncr_tables,
)
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
TEXT_WIDTH = 120
TEXT_COLUMNS = {"method", "chosen as", "rate", ""}  # to the left; numbers to the right
# A row of a table: ours, the paper's (dim), or None for a line between two groups.
Rows = Iterator[tuple[str, ...] | None]


def papers_text(found: PaperTables, width: int = TEXT_WIDTH) -> str:
    """All tables as plain text of at most ``width`` columns."""
    out = StringIO()
    print_papers(found, Console(file=out, width=width, no_color=True, highlight=False))
    return out.getvalue()


def print_papers(found: PaperTables, console: Console | None = None) -> None:
    """All tables on a console; without one, on standard output."""
    if console is None:
        console = Console()
        if not console.is_terminal:
            console.width = TEXT_WIDTH
    lfp, ncr = found.lfp, found.ncr
    parts: tuple[tuple[str, str, str, str, tuple[Table, ...]], ...] = (
        ("LFP040AHA", LFP_EMBEDDED, "Columns", LFP_CELL,
         (_capacity(lfp), _pulses(lfp), _ocv(lfp), _polynomials(lfp), _errors(lfp))),
        ("NCR18650B", NMC_EMBEDDED, "Rows", NCA_CELL, (_rate_errors(ncr), _residuals(ncr))),
    )  # fmt: skip
    for paper, cell, what, published_cell, tables in parts:
        console.print(f"[bold]{paper} paper[/bold] on {cell}.")
        console.print(
            f"{what} headed '{PAPER}' are the paper's own, measured on another cell: "
            f"{published_cell}.",
            style="dim",
        )
        for table in tables:
            console.print(table)


def tabled(title: str, *columns: str) -> Callable[[Callable[..., Rows]], Callable[..., Table]]:
    """Decorator: what yields rows gives a table; a row that says ``published`` is dim."""

    def decorate(rows: Callable[..., Rows]) -> Callable[..., Table]:
        def inside(found: LfpTables | Sequence[RateResult]) -> Table:
            method = found.method if isinstance(found, LfpTables) else ""
            table = Table(
                title=title.format(method=method), title_justify="left", title_style="bold",
                box=SIMPLE, pad_edge=False,
            )  # fmt: skip
            for name in columns:
                table.add_column(name, justify="left" if name in TEXT_COLUMNS else "right")
            for row in rows(found):
                if row is None:
                    table.add_section()
                else:
                    dim = any(cell.startswith(PAPER) for cell in row)
                    table.add_row(*map(escape, row), style="dim" if dim else None)
            return table

        return inside

    return decorate


@tabled(
    "Capacity by discharge tests",
    "rate", "total Ah", "CC part", "CV part", f"{PAPER}: total", "CC", "CV",
)  # fmt: skip
def _capacity(found: LfpTables) -> Rows:
    for row in found.capacities:
        there = LFP_CAPACITIES.get(row.rate)
        values = ("", "", "") if there is None else tuple(f"{x:.4g}" for x in there)
        ours = (f"{x:.3f}" for x in (row.total_Ah, row.cc_Ah, row.cv_Ah))
        yield (row.rate, *ours, *values)


@tabled("Pulses of the HPPC tests", "test", "from SOC", "Ah", *QUALITIES, f"{PAPER}: Ah")
def _pulses(found: LfpTables) -> Rows:
    counts = [[getattr(t, q) for q in QUALITIES] for t in found.tests]
    for k, (test, count) in enumerate(zip(found.tests, counts, strict=True)):
        there = f"{LFP_TEST_CHARGES_AH[k]:.2f}" if k < len(LFP_TEST_CHARGES_AH) else ""
        ours = (str(test.number), f"{test.soc_start:.3f}", f"{test.charge_Ah:.4f}")
        yield (*ours, *map(str, count), there)
    yield None
    sums = map(str, map(sum, zip(*counts, strict=True)))
    yield ("all", "", f"{found.hppc_Ah:.4f}", *sums, f"{sum(LFP_TEST_CHARGES_AH):.2f}")


@tabled(
    "OCV a + b ln(s + c) + d s + exp(e (s - f)) through the rests, beside the spline of identify",
    "a V", "b V", "c", "d V", "e", "f", "RMSE mV", "spline",
)  # fmt: skip
def _ocv(found: LfpTables) -> Rows:
    ocv = found.ocv
    values = (ocv.a, ocv.b, ocv.c, ocv.d, ocv.e, ocv.f)
    yield (
        *(f"{x:.4g}" for x in values),
        f"{1e3 * ocv.rmse_V:.2f}",
        f"{1e3 * found.spline_rmse_V:.2f}",
    )


@tabled(
    "Polynomials a + b s + c s^2 + d s^3 ({method} on healthy pulses)",
    "", "a", "b", "c", "d", f"{PAPER}: a", "b", "c", "d",
)  # fmt: skip
def _polynomials(found: LfpTables) -> Rows:
    for p in found.polynomials:
        unit = "ohm" if p.parameter.startswith("R") else "F"
        values = (p.a, p.b, p.c, p.d, *LFP_POLYNOMIALS[p.parameter])
        yield (f"{p.parameter} [{unit}]", *(f"{x:.4g}" for x in values))


@tabled(
    "Charge-depleting cycle by capacity choice; % of the measured voltage; window 5-180 min",
    "Q Ah", "chosen as", "method", "RMS mV", "mean %", "in window", "peak %", "in window",
)  # fmt: skip
def _errors(found: LfpTables) -> Rows:
    for e in found.errors:
        first = (f"{e.capacity_Ah:.3f}", CHOICES[e.choice])
        for name, x in ((f"{found.method}, cubic", e.paper), ("varpro, refined", e.ours)):
            shares = (x.mean_abs, x.mean_abs_window, x.peak, x.peak_window)
            yield (*first, name, f"{1e3 * x.rms_V:.1f}", *(f"{100 * s:.3g}" for s in shares))
            first = ("", "")
        capacity, *there = LFP_ERRORS[e.choice]
        yield (f"{capacity:.1f}", "", f"{PAPER}, pso, cubic", *(f"{x:.3g}" for x in there))
        yield None


@tabled(
    "Voltage error on the same HPPC current",
    "rate", "capacity Ah", "method", "RMSE mV", "MAE mV", "max mV",
)  # fmt: skip
def _rate_errors(found: Sequence[RateResult]) -> Rows:
    for row in found:
        first = (row.rate, f"{row.capacity_Ah:.3f}")
        for name, m in row.errors.items():
            sizes = (1e3 * m.rmse_V, 1e3 * m.mae_V, 1e3 * m.max_error_V)
            yield (*first, METHODS[name], *(f"{x:.1f}" for x in sizes))
            first = ("", "")
        there = NCA_RESIDUALS.get(row.rate)
        if there is not None:
            sizes = (there.rmse_mV, there.mae_mV, there.max_mV)
            capacity = f"{there.capacity_Ah:.3f}"
            yield ("", capacity, f"{PAPER}, segments", *(f"{x:.1f}" for x in sizes))
        yield None


@tabled(
    "Residuals, measured minus simulated",
    "rate", "method", "mean mV", "std mV", "95 % interval mV",
)  # fmt: skip
def _residuals(found: Sequence[RateResult]) -> Rows:
    for row in found:
        rate = row.rate
        for name, m in row.errors.items():
            in_mV = (1e3 * v for v in (m.mean_error_V, m.std_error_V, *m.ci95_V))
            yield (rate, METHODS[name], *_with_interval(*in_mV))
            rate = ""
        there = NCA_RESIDUALS.get(row.rate)
        if there is not None:
            theirs = _with_interval(there.mean_mV, there.std_mV, *there.ci95_mV)
            yield ("", f"{PAPER}, segments", *theirs)
        yield None


def _with_interval(mean: float, std: float, low: float, high: float) -> tuple[str, str, str]:
    return f"{mean:.1f}", f"{std:.1f}", f"[{low:.1f}, {high:.1f}]"


LFP_NOMINAL_AH = 2.3
NMC_NOMINAL_AH = 5.0
LFP_CAPACITY_TESTS = ("cap_0p5c", "cap_1c", "cap_2c", "cap_3c")
NMC_RATES = {"C/20": "c20", "C/5": "c5", "C/3": "c3"}


@dataclass(frozen=True)
class PaperTables:
    """What `paper_tables` found; ``lfp`` and ``ncr`` are named after the papers' cells."""

    lfp: LfpTables
    ncr: tuple[RateResult, ...]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Every table as JSON values, with the published numbers beside ours."""
        return {
            "lfp": _lfp_dict(self.lfp),
            "ncr18650b": _ncr_dict(self.ncr),
            "seconds": self.seconds,
        }


def paper_tables(
    datasets: Path, progress: Progress | None = None, *, method: Method = "pso"
) -> PaperTables:
    """Produce both papers' tables from the embedded data.

    Parameters
    ----------
    datasets : Path           folder with ``lfp`` and ``nmc``
    progress : callable       called with what is being done
    method : str              for the pulses of the LFP paper: ``pso`` as printed there, or
                              ``varpro``, which is quicker

    Raises
    ------
    InputError        a log is missing
    """
    began = time.perf_counter()
    lfp = lfp_tables(
        _log(datasets, "lfp/hppc"),
        [_log(datasets, f"lfp/{name}") for name in LFP_CAPACITY_TESTS],
        _log(datasets, "lfp/cdc"),
        LFP_NOMINAL_AH,
        method=method,
        progress=progress,
    )
    pairs = {
        rate: (_log(datasets, f"nmc/hppc_{tag}"), _log(datasets, f"nmc/cap_{tag}"))
        for rate, tag in NMC_RATES.items()
    }
    ncr = ncr_tables(pairs, NMC_NOMINAL_AH, progress=progress)
    return PaperTables(lfp, ncr, round(time.perf_counter() - began, 1))


def _log(datasets: Path, name: str) -> CellLog:
    file = datasets / f"{name}.parquet"
    if not file.exists():
        raise InputError(
            f"no file '{name}.parquet' in the folder of embedded data",
            "the embedded logs of lfp and nmc",
            "Run `cellwise data generate`, or give the folder that holds them.",
        )
    return read_log(file)


def _lfp_dict(found: LfpTables) -> dict[str, Any]:
    charges = dict(enumerate(LFP_TEST_CHARGES_AH, start=1))
    return {
        "cell": LFP_EMBEDDED,
        "published_cell": LFP_CELL,
        "pulse_method": found.method,
        "capacity": [
            {
                "rate": row.rate,
                "total_Ah": row.total_Ah,
                "cc_Ah": row.cc_Ah,
                "cv_Ah": row.cv_Ah,
                "published": _published(LFP_CAPACITIES.get(row.rate)),
            }
            for row in found.capacities
        ],
        "pulses": [
            {**asdict(test), "published_charge_Ah": charges.get(test.number)}
            for test in found.tests
        ],
        "hppc_total_Ah": found.hppc_Ah,
        "ocv": {**asdict(found.ocv), "spline_rmse_V": found.spline_rmse_V},
        "polynomials": [
            {**asdict(p), "published": LFP_POLYNOMIALS[p.parameter]} for p in found.polynomials
        ],
        "errors": [
            {
                "choice": e.choice,
                "capacity_Ah": e.capacity_Ah,
                "paper_method": asdict(e.paper),
                "ours": asdict(e.ours),
                "published": _published(LFP_ERRORS[e.choice]),
            }
            for e in found.errors
        ],
    }


def _ncr_dict(found: tuple[RateResult, ...]) -> dict[str, Any]:
    return {
        "cell": NMC_EMBEDDED,
        "published_cell": NCA_CELL,
        "rates": [
            {
                "rate": row.rate,
                "capacity_Ah": row.capacity_Ah,
                "methods": {name: metrics_to_dict(m) for name, m in row.errors.items()},
                "published": _published(NCA_RESIDUALS.get(row.rate)),
            }
            for row in found
        ],
    }


def _published(row: Any) -> dict[str, Any] | None:
    return None if row is None else row._asdict()
