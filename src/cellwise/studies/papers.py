"""The tables of the two papers that cellwise starts from, on the embedded data, in one call.

The embedded cells are not the papers' cells: the published numbers stand beside ours as a
reference for the method, not as a target.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cellwise.cell.metrics import metrics_to_dict
from cellwise.errors import InputError
from cellwise.identify.pipeline import Progress
from cellwise.identify.pulse_fit.fit_pulse import Method
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.studies.lfp_paper import LFP_EMBEDDED, LfpTables, lfp_tables
from cellwise.studies.ncr_paper import NMC_EMBEDDED, RateResult, ncr_tables
from cellwise.studies.published import (
    LFP_CAPACITIES,
    LFP_CELL,
    LFP_ERRORS,
    LFP_POLYNOMIALS,
    LFP_TEST_CHARGES_AH,
    NCA_CELL,
    NCA_RESIDUALS,
)

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
