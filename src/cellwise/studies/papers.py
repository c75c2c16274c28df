"""The tables of the two papers that cellwise starts from, on the embedded data.

The embedded cells are not the papers' cells: the published numbers stand beside ours as a
reference for the method, not as a target.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.cell.metrics import metrics_to_dict
from cellwise.errors import InputError
from cellwise.identify.pipeline import Progress
from cellwise.identify.pulse_fit.fit_pulse import Method
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.studies.paper_tables import (
    LFP_EMBEDDED,
    NMC_EMBEDDED,
    LfpTables,
    RateResult,
    lfp_tables,
    ncr_tables,
)

LFP_CELL = "ThunderSky Winston LFP040AHA, 40 Ah"
NCA_CELL = "NCR18650B, 3.4 Ah"


class PublishedCapacity(NamedTuple):
    """Discharged charge at one rate [Ah]."""

    total_Ah: float
    cc_Ah: float
    cv_Ah: float


class PublishedError(NamedTuple):
    """Voltage error on the charge-depleting cycle for one capacity; window is 5 to 180 min."""

    capacity_Ah: float
    rms_mV: float
    mean_pct: float
    mean_window_pct: float
    peak_pct: float
    peak_window_pct: float


class PublishedResidual(NamedTuple):
    """Voltage error of one characterization rate on its own HPPC current [mV]."""

    capacity_Ah: float
    rmse_mV: float
    mae_mV: float
    max_mV: float
    mean_mV: float
    std_mV: float
    ci95_mV: tuple[float, float]


LFP_CAPACITIES = {
    "C/2": PublishedCapacity(47.71, 46.30, 1.407),
    "1C": PublishedCapacity(47.71, 45.78, 1.934),
    "2C": PublishedCapacity(47.70, 45.21, 2.495),
    "3C": PublishedCapacity(47.62, 45.41, 2.212),
}

LFP_TEST_CHARGES_AH = (
    2.41, 2.21, 4.21, 4.21, 4.22, 4.23, 4.22, 4.21, 4.22,
    2.16, 2.18, 2.20, 2.21, 2.22, 2.20, 2.22, 0.92, 0.25,
)  # fmt: skip

# Coefficients of a + b s + c s^2 + d s^3, R in ohm, C in farad (equation 9).
LFP_POLYNOMIALS = {
    "R0": (3.551e-3, -6.172e-3, 8.993e-3, -4.267e-3),
    "R1": (9.601e-4, -1.154e-3, 1.611e-3, -5.716e-4),
    "R2": (6.169e-3, -2.678e-2, 4.690e-2, -2.485e-2),
    "C1": (5549.0, -1.359e4, 5.058e4, -3.397e4),
    "C2": (1.712e4, 8.510e4, -2.850e4, -4.243e4),
}

LFP_ERRORS = {
    "cc-average": PublishedError(45.7, 43.2, 0.977, 0.751, 14.9, 9.62),
    "cc-cv-average": PublishedError(47.7, 48.7, 1.07, 0.805, 14.6, 9.83),
    "hppc-total": PublishedError(50.7, 120.0, 2.44, 0.873, 22.9, 10.1),
    "nominal": PublishedError(40.0, 167.0, 2.73, 0.579, 20.4, 9.04),
}

NCA_RESIDUALS = {
    "C/20": PublishedResidual(3.327, 21.3, 12.2, 196.9, -10.2, 18.7, (-46.8, 26.4)),
    "C/5": PublishedResidual(3.375, 25.8, 16.8, 155.0, 2.1, 25.7, (-48.2, 52.5)),
    "C/3": PublishedResidual(3.290, 21.4, 14.4, 195.5, -2.0, 21.3, (-43.7, 39.7)),
}


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
        "ocv": [{**asdict(found.ocv), "spline_rmse_V": found.spline_rmse_V}],
        "polynomials": [
            {**asdict(p), "published": dict(zip("abcd", LFP_POLYNOMIALS[p.parameter], strict=True))}
            for p in found.polynomials
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
