"""What lies in memory beside the cells' states: the tables of one step, and scratch."""

from __future__ import annotations

from cellwise.estimate.filters.filter_state import OUTPUTS as OUTPUTS

# Columns of the table of one time step: decays a, what one ampere adds g, R^2 (1 - a^2) as b.
T_OCV, T_R0, T_A1, T_G1, T_B1, T_A2, T_G2, T_B2, T_ERROR, T_A3, T_G3, T_B3, T_M = range(13)
PLAIN_COLUMNS = 9  # what a model without third branch and hysteresis needs
TABLE_COLUMNS = 16  # whole vectors
# Rows of the scratch of a block: the table at every lane's SOC, what the lanes have read, what is
# reported. All in one array: LLVM gives up checking more of them for overlaps ("too many memory
# checks needed"), and then vectorises nothing.
W_SLOPE = 16
W_SOC, W_FLOW, W_PLAIN, W_DECAY, W_AT, W_BEYOND, W_INSIDE = range(17, 24)
W_CURRENT, W_VOLTAGE, W_WARM = range(24, 27)
W_OUT = 27
SCRATCH_ROWS = W_OUT + OUTPUTS
LONG_FROZEN = 1e300
SERIES_LIMIT = 0.25  # beyond it the series of the decay is left to the exponential
