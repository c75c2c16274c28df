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

/* The last reading of a voltage, the current when it came, and how often it has come since. */
typedef struct {
    float voltage_V;
    float since_A;
    float repeats;
} cellwise_heldvoltage;

/* After a voltage: FOUND_FROZEN of them where it is frozen, and so until it changes. It repeats itself, but for its
 * last digits, where R0 times the change of current says that it must have moved, and the prediction is off by half
 * of that: a held voltage (the end of a charge) repeats itself, too, but the model expects it there. */
static void repeats_after(float last_V, float since_A, float repeats, float voltage_V, float current_A, float r0_ohm,
                          float innovation_V, float frozen_V, cellwise_heldvoltage *heldvoltage)
{
    heldvoltage->voltage_V = voltage_V;
    heldvoltage->since_A = current_A;
    heldvoltage->repeats = 0.0f;
    if (magnitude(voltage_V - last_V) <= DITHER_V) {
        heldvoltage->voltage_V = last_V;
        heldvoltage->since_A = since_A;
        heldvoltage->repeats = at_most(repeats + 1.0f, FROZEN_READINGS);
        const float moved_V = magnitude(r0_ohm * (current_A - since_A));
        const bool frozen = (moved_V > frozen_V) && (magnitude(innovation_V) > (0.5f * moved_V));
        if ((repeats >= FOUND_FROZEN) || ((heldvoltage->repeats >= FROZEN_READINGS) && frozen)) {
            heldvoltage->repeats = FOUND_FROZEN;
        }
    }
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
