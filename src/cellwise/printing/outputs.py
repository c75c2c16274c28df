"""What is printed, and where it goes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cellwise.cell.description import CELL, SOC, V1, V2, V3
from cellwise.printing.covariance import CovariancePrinter
from cellwise.printing.lanes import lanes_text
from cellwise.printing.points import points_text

# The repository's root: files are named from there.
SOURCE = Path(__file__).resolve().parents[3]
FILTERS = "src/cellwise/estimate/filters"


def covariance_text() -> str:
    """Covariance of EKF and UKF."""
    p = CovariancePrinter(CELL)
    lean = "A SOC that is off drives the branches by the resistances' slopes: x_j += f_j soc."
    return p.text(
        "Covariance of the filters over SOC, branches and hysteresis.",
        [
            *p.coupled("leaned", SOC, {V1: "f1", V2: "f2", V3: "f3"}, lean),
            *p.soc_row_set(),
            *p.given_soc(),
            *p.plus_outer(),
            *p.rejudged(CELL),
        ],
    )


OUTPUTS: dict[str, Callable[[], str]] = {
    "src/cellwise/cell/point_kernels.py": points_text,
    f"{FILTERS}/covariance_kernels.py": covariance_text,
    "src/cellwise/estimate/lockstep/lane_kernels.py": lanes_text,
}
