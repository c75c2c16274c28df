"""How the cells of a fleet lie in memory: blocks of LANES, field by field."""

from __future__ import annotations

LANES = 16  # fewer than sixteen turns are not worth a vector to the compiler
# Fields of a cell's state: EkfState's, then Watch's, then the Arrhenius factor and its temperature.
SOC, V1, V2, V3, H = range(5)
SS, S1, S2, S3, SH = range(5, 10)
P11, P12, P13, P1H, P22, P23, P2H, P33, P3H, PHH = range(10, 20)
HEAT, REJECTIONS, MISMATCH, LASTING = range(20, 24)
CURRENT, WARM, EVIDENCE, NO_CURRENT, NO_VOLTAGE, VOLTAGE, FROZEN_A, REPEATS = range(24, 32)
FACTOR, FACTOR_C = range(32, 34)
FIELDS = 34
# Columns of the table of one time step.
T_OCV, T_R0, T_A1, T_G1, T_B1, T_A2, T_G2, T_B2, T_ERROR, T_A3, T_G3, T_B3, T_M = range(13)
PLAIN_COLUMNS = 9  # what a model without third branch and hysteresis needs
TABLE_COLUMNS = 16  # whole vectors
# Rows of the scratch of a block: the table at every lane's SOC, then what the lanes have read.
W_SLOPE = 16
W_SOC, W_FLOW, W_PLAIN, W_DECAY, W_AT, W_BEYOND, W_INSIDE = range(17, 24)
SCRATCH_ROWS = 24
O_SOC, O_STD, O_VOLTAGE, O_INNOVATION, O_VARIANCE, O_RATIO = range(6)
OUTPUTS = 6
LONG_FROZEN = 1e300
SERIES_LIMIT = 0.25  # beyond it the series of the decay is left to the exponential
