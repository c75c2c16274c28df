"""What is printed, and where it goes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cellwise.cell.description import ADAPTIVE, CELL, CHARGE, OFFSET, SOC, V1, V2, V3
from cellwise.printing.c.firmware import print_header, print_source
from cellwise.printing.covariance import CovariancePrinter
from cellwise.printing.derivatives import derivatives_text, part_derivatives_text
from cellwise.printing.formulas import theory_text
from cellwise.printing.lanes import lanes_text
from cellwise.printing.text import formatted

# The repository's root: files are named from there.
SOURCE = Path(__file__).resolve().parents[3]
LEAN = "A SOC that is off drives the branches by the resistances' slopes: x_j += f_j soc."
FILTERS = "src/cellwise/estimate/filters"


def covariance_text() -> str:
    """Covariance of EKF and UKF."""
    p = CovariancePrinter(CELL)
    return p.text(
        "Covariance of the filters over SOC, branches and hysteresis.",
        [
            *p.coupled("leaned", SOC, {V1: "f1", V2: "f2", V3: "f3"}, LEAN),
            *p.soc_row_set(),
            *p.given_soc(),
            *p.rejudged(CELL),
        ],
    )


def adaptive_covariance_text() -> str:
    """Covariance of the adaptive filter."""
    p = CovariancePrinter(ADAPTIVE, "Adaptive")
    offset = "The sensor's offset drives what the current drives: x_i += c_i offset."
    charge = "The capacity drives the SOC: soc += cs charge."
    return p.text(
        "Covariance of the adaptive filter: that of the EKF, and offset and capacity.",
        [
            *p.coupled("leaned", SOC, {V1: "f1", V2: "f2", V3: "f3"}, LEAN),
            *p.coupled("offset_driven", OFFSET, {SOC: "cs", V1: "c1", V2: "c2", V3: "c3"}, offset),
            *p.coupled("charge_driven", CHARGE, {SOC: "cs"}, charge),
            *p.rejudged(CELL),
            *p.parameters_set(),
            *p.column_of(OFFSET, "offset_column"),
            *p.column_of(CHARGE, "charge_column"),
        ],
    )


PRINTED: dict[str, Callable[[], str]] = {
    "src/cellwise/cell/derivative_kernels.py": derivatives_text,
    "src/cellwise/identify/refinement/derivative_kernels.py": part_derivatives_text,
    f"{FILTERS}/covariance_kernels.py": covariance_text,
    "src/cellwise/estimate/adaptive/covariance_kernels.py": adaptive_covariance_text,
    "src/cellwise/estimate/lockstep/lane_kernels.py": lanes_text,
    "docs/theory.md": lambda: theory_text(SOURCE / "docs" / "theory.md"),
    "firmware_ref/cellwise_ekf.h": print_header,
    "firmware_ref/cellwise_ekf.c": print_source,
}


def printed(name: str) -> str:
    """The text of one of them, Python as the project's formatter writes it."""
    text = PRINTED[name]()
    return formatted(text) if name.endswith(".py") else text
