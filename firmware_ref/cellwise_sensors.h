/* Part of cellwise_ekf.c. Readings that a sensor cannot have meant, and a charge that nobody counted. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_SENSORS_H
#define CELLWISE_SENSORS_H

#include "cellwise_evidence.h"

/* How often the voltage has gone up and down under a current that repeats itself. A constant current moves a voltage
 * one way. Where it goes both ways by as much as would call a voltage frozen, nobody measures the current. The sign
 * is that of the last move. */
static float swings_after(float swings, float moved_V, float frozen_V)
{
    const float count = at_most(magnitude(swings) + 1.0f, SWINGS_MOST);
    float after = swings;
    if ((magnitude(moved_V) > frozen_V) && !((swings * moved_V) > 0.0f)) {
        after = (moved_V > 0.0f) ? count : -count;
    }
    return after;
}

/* Whether a current that repeats itself is not measured at all. */
static bool is_dead(float swings)
{
    return magnitude(swings) >= DEAD_SWINGS;
}

/* Whether a voltage that repeats itself, but for its last digits, must have moved. R0 times the change of current
 * says so, and the prediction is off by half of that: a held voltage (the end of a charge) repeats itself, too, but
 * the model expects it there. */
static bool is_frozen(float change_A, float r0_ohm, float innovation_V, float frozen_V)
{
    const float moved_V = magnitude(r0_ohm * change_A);
    return (moved_V > frozen_V) && (magnitude(innovation_V) > (0.5f * moved_V));
}

/* SOC's variance of what may have flowed unseen over a gap. The currents on either side, or half a rate, for as long
 * as it lasts (`per_A` is the SOC that one ampere moves in it), and no more than `gap_variance`. */
static float unseen_variance(float gap_variance, float gap_A2, float lost_A2, float per_A)
{
    return at_most((per_A * per_A) * at_least(gap_A2, lost_A2), gap_variance);
}

/* SOC's variance after an interval of which nobody knows the current. It may keep one sign for as long as it is
 * away: the deviation grows, not the variance. */
static float drifted_variance(float variance, float moved)
{
    const float deviation = root(variance) + moved;
    return deviation * deviation;
}

#endif
