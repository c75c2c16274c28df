"""What the filters and the C of the fixed step take for granted of any cell.

Rates are shares of 1C: a current over the capacity [1/h].
"""

from __future__ import annotations

# A sample. Beyond these temperatures a reading is the sensor's fault [degC].
COLDEST_C = -60.0
HOTTEST_C = 120.0
IMPOSSIBLE_RATE = 200.0  # no cell gives that; a sensor fault does
FROZEN_READINGS = 3.0  # repeats of a voltage, before which nobody calls it frozen;
FOUND_FROZEN = 4.0  # a count that says it was
DITHER_V = 0.0025  # a reading that moves by less repeats itself: the last digits of a converter
DEAD_SWINGS = 8.0  # of the voltage, up and down, under a current that repeats itself bit by bit
SWINGS_MOST = 100.0  # counting on says nothing more
REST_RATE = 0.01  # below C/100 a cell counts as resting
LOST_RATE = 0.5  # a current that nobody measures is taken to be of this size

# A start. A cell that starts at rest still carries a few millivolts of its past in each branch, and
# what a tenth of a rate would leave there.
START_BRANCH_V = 0.005
START_REST_RATE = 0.1
REST_LIMIT_V = 0.03  # a rested branch holds no more, whatever its resistance
# One that starts under load holds anything from nothing to the load's steady voltage.
START_LOAD_SHARE = 0.5
START_LOAD_RATE = 0.25
NO_LIMIT_V = 1000.0  # no cell's branch holds that

LARGE = 1048576.0  # no sound state goes beyond it, in V, A or their squares
# A SOC that is not known.
VARIANCE_FLOOR = 1e-12  # of the SOC: rounding takes no more away
WIDE_VARIANCE = 4e-4  # beyond 2 points of SOC the tangent is no guide
SHORTEST_CHORD = 1e-6  # of the SOC: both ends are beyond the same end of the tables
RECOVERY_VARIANCE = 0.09  # after voltages that contradicted it for long: anywhere
RECOVERY_RATE = 0.3  # what branches may hold then,
LOAD_LIMIT_V = 0.3  # and the most

# Evidence.
CONTRADICTED_S = 600.0  # a change of load is over, a drift of the counted charge has hardly begun
COUNT_ROUNDING = 1e-6  # a sum of thousands of small counts reaches a whole number
PERSISTENT_MOST = 0.9  # of the model's error: some of it always fades
SQUARE_MOST = 4.0  # [V^2] of an error: no cell's voltage is off by more

# Components.
SPREAD_VARIANCE = 1.6e-3  # beyond it a SOC is no longer known well enough for one filter
COMPONENT_WIDTH = 0.6  # deviation of a component over the distance to the next
DENSE = 3.0  # deviations of a start within which the components lie close
LEAST_WIDTH = 1e-3  # of a component in SOC
TAIL = 4.0  # degrees of freedom of a stated start: how sure it is, is itself not sure
COST_MOST = 20.0  # a component less likely than exp(-20) is given up:
GIVEN_UP = 1048576.0  # its cost, and nobody steps it any more
LEAST_PASSED = 1e-4  # of an innovation that the gate lets pass
BLOCK_S = 10.0  # of samples, whose mean is one piece of evidence
BANK_RATE = 0.5  # what a slow branch may hold where a bank begins under load

# What flowed before a start under load.
LOOK_S = 60.0  # of the load until it is looked at
LOOK_FACTOR = 4.0  # and each time so much longer
LOOKS = 3  # times
NEVER_LOOKED = 0xFFFFFFFF  # before the first sample
NO_LOOK, OPENED, FIRST_LOOK, NEXT_LOOK = 0, 1, 2, 3
PAST_PART = 1.0 / 32.0  # of the SOC: the way of a load before the start goes in such parts
PAST_SPREAD = 0.5  # of what a load has left before the start may be otherwise
PAST_RATE = 0.05  # may have flowed before beside it
LEAST_USE_RATE = 0.02  # a use takes no longer from full to empty, or back
LEAST_PAST_V2 = 1e-6  # a millivolt of what it has left is always open

# An offset of the current.
CHANCE = 0.2  # of one, before any data, as in the adaptive filter
ODDS = 0.25  # the same, over the chance of none
PER_FREEDOM = 1.0 / 31.0
SURE_SQUARE = 1000.0  # of a mean over its variance: more says nothing
INFORMATION_MOST = 1048576.0  # an offset is known better than any sensor has it
# A rest: the current stands still near zero, as shares of 1C.
OFFSET_REST_S = 120.0
REST_LIMIT = 0.04
REST_BAND = 0.01  # within which it stands still; as near zero nobody takes it for a load
REST_USED = -1.0  # in place of how long it lasts
REST_SHOWS = 25.0  # by a rest, as one over the variance
MAY_BE_LOAD = 1.0
