"""What a filter does when nobody knows what was before: a start, or a gate that was locked out."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.point_kernels import CellScalars
from cellwise.estimate.sensing_kernels import REST_RATE

RECOVERY_VARIANCE = 0.09
RECOVERY_RATE = 0.3
# A cell that starts at rest still carries a few millivolts of its past in each branch, and what a
# tenth of a rate would leave there.
START_BRANCH_V = 0.005
START_REST_RATE = 0.1
REST_LIMIT_V = 0.03  # a rested branch holds no more, whatever its resistance
LOAD_LIMIT_V = 0.3
# One that starts under load holds anything from nothing to the load's steady voltage.
START_LOAD_SHARE = 0.5
START_LOAD_RATE = 0.25


@inline
def start_branch(cell: CellScalars, r_ohm: float, current_A: float) -> tuple[float, float]:
    """What a branch holds when nobody knows what was before: mean [V] and variance [V^2]."""
    capacity = cell.charge_As / 3600.0
    if r_ohm <= 0.0:
        return 0.0, 0.0
    if abs(current_A) < REST_RATE * capacity:
        past = min(START_REST_RATE * capacity * r_ohm, REST_LIMIT_V)
        return 0.0, START_BRANCH_V * START_BRANCH_V + past * past
    spread = max(START_LOAD_SHARE * abs(current_A), START_LOAD_RATE * capacity) * r_ohm
    return (
        START_LOAD_SHARE * current_A * r_ohm,
        START_BRANCH_V * START_BRANCH_V + spread * spread,
    )
