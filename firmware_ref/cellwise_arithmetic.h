/* Part of cellwise_ekf.c. Constants of the algorithm, small helpers. Printed from src/cellwise/estimate by `python
 * -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_ARITHMETIC_H
#define CELLWISE_ARITHMETIC_H

#include "cellwise_float.h"

#define COLDEST_C (-60.0f)
#define HOTTEST_C 120.0f
#define FROZEN_READINGS 3.0f /* repeats of a voltage, before which nobody calls it frozen; */
#define FOUND_FROZEN 4.0f /* a count that says it was */
#define DITHER_V 0x1.47ae14p-9f /* 0.0025: a reading that moves by less repeats itself: the last digits of a converter */
#define DEAD_SWINGS 8.0f /* of the voltage, up and down, under a current that repeats itself bit by bit */
#define SWINGS_MOST 100.0f /* counting on says nothing more */
#define REST_LIMIT_V 0x1.eb851ep-6f /* 0.03: a rested branch holds no more, whatever its resistance */
#define START_LOAD_SHARE 0.5f
#define NO_LIMIT_V 1000.0f /* no cell's branch holds that */
#define LARGE 0x1p+20f /* no sound state goes beyond it, in V, A or their squares */
#define VARIANCE_FLOOR 0x1.197998p-40f /* 1e-12: of the SOC: rounding takes no more away */
#define WIDE_VARIANCE 0x1.a36e2ep-12f /* 0.0004: beyond 2 points of SOC the tangent is no guide */
#define SHORTEST_CHORD 0x1.0c6f7ap-20f /* 1e-06: of the SOC: both ends are beyond the same end of the tables */
#define RECOVERY_VARIANCE 0x1.70a3d8p-4f /* 0.09: after voltages that contradicted it for long: anywhere */
#define LOAD_LIMIT_V 0x1.333334p-2f /* 0.3: and the most */
#define SQUARE_MOST 4.0f /* [V^2] of an error: no cell's voltage is off by more */
#define SPREAD_VARIANCE 0x1.a36e2ep-10f /* 0.0016: beyond it a SOC is no longer known well enough for one filter */
#define COMPONENT_WIDTH 0x1.333334p-1f /* 0.6: deviation of a component over the distance to the next */
#define DENSE 3.0f /* deviations of a start within which the components lie close */
#define LEAST_WIDTH 0x1.0624dep-10f /* 0.001: of a component in SOC */
#define TAIL 4.0f /* degrees of freedom of a stated start: how sure it is, is itself not sure */
#define COST_MOST 20.0f /* a component less likely than exp(-20) is given up: */
#define GIVEN_UP 0x1p+20f /* its cost, and nobody steps it any more */
#define LEAST_PASSED 0x1.a36e2ep-14f /* 0.0001: of an innovation that the gate lets pass */
#define LOOK_FACTOR 4.0f /* and each time so much longer */
#define LOOKS 3u /* times */
#define NEVER_LOOKED 0xFFFFFFFFu /* before the first sample */
#define NO_LOOK 0u
#define OPENED 1u
#define FIRST_LOOK 2u
#define NEXT_LOOK 3u
#define PAST_PART 0.03125f /* of the SOC: the way of a load before the start goes in such parts */
#define PAST_SPREAD 0.5f /* of what a load has left before the start may be otherwise */
#define LEAST_PAST_V2 0x1.0c6f7ap-20f /* 1e-06: a millivolt of what it has left is always open */
#define CHANCE 0x1.99999ap-3f /* 0.2: of one, before any data, as in the adaptive filter */
#define ODDS 0.25f /* the same, over the chance of none */
#define PER_FREEDOM 0x1.08421p-5f /* 0.0322581 */
#define SURE_SQUARE 1000.0f /* of a mean over its variance: more says nothing */
#define INFORMATION_MOST 0x1p+20f /* an offset is known better than any sensor has it */
#define REST_LIMIT 0x1.47ae14p-5f /* 0.04 */
#define REST_BAND 0x1.47ae14p-7f /* 0.01: within which it stands still; as near zero nobody takes it for a load */
#define REST_USED (-1.0f) /* in place of how long it lasts */
#define REST_SHOWS 25.0f /* by a rest, as one over the variance */
#define MAY_BE_LOAD 1.0f
#define SIXTH 0x1.555556p-3f /* 0.166667 */
#define TWENTY_FOURTH 0x1.555556p-5f /* 0.0416667 */
#define THIRD 0x1.555556p-2f /* 0.333333 */
#define FIFTH 0x1.99999ap-3f /* 0.2 */
#define SEVENTH 0x1.24924ap-3f /* 0.142857 */
#define LINE_OF_ROOT 0x1.5f619ap-1f /* 0.686292: 4 (3 - 2 sqrt 2): as far above a root at 1/4 and 1 as below between */
#define LARGEST_FLOAT 0x1.fffffep+127f /* 3.40282e+38 */
#define KNOW_NOTHING_SOC 0.5f
#define KNOW_NOTHING_VARIANCE 0x1.70a3d8p-4f /* 0.09 */
#define SOC_VARIANCE_MOST 1.0f /* SOC lies in 0..1: more says nothing */
#define BEYOND 0x1.99999ap-5f /* 0.05: how far the OCV goes on outside 0..1 */
#define HEAT_MOST_K 200.0f
#define CARRY_MOST 0x1p-10f
#define LEAST_FALL 0x1.99999ap-4f /* 0.1: with the current a resistance rises by ten at most */
#define LONGEST_GAP 0x100000u /* samples */
#define NOT_BEGUN 0u /* evidence before the first sample */
#define NO_VOLTAGE_YET 1u
#define FIRST_VOLTAGE 2u
#define EVIDENCE_MOST 0x200000u
#define REPEATED 0u /* a sample that was seen before, */
#define NO_INTERVAL 1u /* the first one, which ends no interval, */
#define INTERVAL 2u /* and one that ends an interval */
#define ALONE 0u /* a state that stands for itself, */
#define COMPONENT 1u /* one of a bank, */
#define CONTRADICTED 2u /* one whose voltages have contradicted it for long, */
#define UNCOUNTED 3u /* and one of whose charge a part is not known */
#define LN_2 0x1.62e43p-1f /* 0.693147 */
#define FURTHEST 2000.0f /* beyond it exp(-z) is nothing */
#define POWER_TRIALS 8u
#define LONGEST 0x1.dcd65p+29f /* 1e+09: remaining seconds, and joules: no cell lasts for more */
#define REMAINING_PARTS 64.0f /* of the SOC down to empty */
#define PHASE_PARTS_PER_S 0x1.111112p-5f /* 0.0333333: of a plan's phase, beside those by its SOC */
#define PHASE_PARTS_MOST 4096.0f
#define PHASE_TURNS 3u /* of a power to its current: off by less than 1e-6 then */
#define DEVIATIONS_MOST 8.0f /* nothing is beyond */
#define NORMAL_1 0x1.988368p-5f /* 0.0498673 */
#define NORMAL_2 0x1.5a5fcep-6f /* 0.021141 */
#define NORMAL_3 0x1.ad9ae4p-9f /* 0.00327763 */
#define NORMAL_4 0x1.3ecc1cp-15f /* 3.80036e-05 */
#define NORMAL_5 0x1.9a1fc4p-15f /* 4.88906e-05 */
#define NORMAL_6 0x1.693f3cp-18f /* 5.383e-06 */
#define LEAST_SPAN_V 0x1.12e0bep-30f /* 1e-09: between the ends of a bracket: it is divided by */
#define USUAL_DEGREES 25.0f /* of a sketch without a temperature */
#define NOT_SIMULATED 0xFFFFFFFFu /* a sketch that waits for a SOC that is known */
#define THREE_CELLS 3u /* that may limit a pack's power */
#define CELL_MOST 0x1.ccccccp-1f /* 0.9: of a cell's capacity or resistance may be missing, */
#define SCALE_MOST 19.0f /* and as many times its resistance be added */
#define LEAST_SHARE 0x1.99999ap-4f /* 0.1: of the capacity that a history gives */
#define MOST_SHARE 2.0f /* of the capacity that a history gives */
#define LEAST_SCALE 0x1.99999ap-4f /* 0.1: of the resistances */
#define MOST_SCALE 20.0f /* of the resistances */
#define SUSTAINED 0x1.a5182ap+0f /* 1.6449: one-sided 95 % of a normal distribution */
#define COUNT_MOST 2000000000u
#define REACH_MOST 1024.0f /* of an offset: SOC, deviations, and volts */
#define SCORE_MOST 0x1.dcd65p+29f /* 1e+09: of what is known of an offset */
#define SINCE_MOST 0x1.dcd65p+29f /* 1e+09: steps, until the past is looked at */
#define SOH_VARIANCE 0x1.70a3d8p-6f /* 0.0225: of a used cell's share of capacity: 0.15, half of what a life takes */
#define SOH_WALK 0x1.4f8b58p-17f /* 1e-05: and per SOC that flows: 0.1 over 500 cycles of two each */
#define SOH_RESISTANCE 0.25f /* of a used cell's resistances: 0.5, half of what a life adds, */
#define SOH_RESISTANCE_WALK 0x1.0624dep-12f /* 0.00025: and per SOC that flows: 0.5 over 500 cycles of two each */
#define SOH_APART 0x1.333334p-2f /* 0.3: SOC between two rests of a pair */
#define SOH_SOC_VARIANCE 0x1.47ae14p-9f /* 0.0025: an OCV that says the SOC no better than to 0.05 is none */
#define RESTED 1u /* what is watched: a long rest, the load after it */
#define FIRST_LOAD 2u /* what is watched: a long rest, the load after it */
#define SOH_REFUSED 3u /* pairs in a row beyond the gate, then the estimate begins again */

/* Whether two numbers are the same. */
static bool is_same(float a, float b)
{
    return (a >= b) && (a <= b);
}

/* The unit in which a ratio over `y` goes on: 1, since a product costs more than it saves. */
static float unit_of(float y)
{
    (void)y;
    return 1.0f;
}

/* The ratio x / y in that unit. */
static float in_units(float x, float y)
{
    return x / y;
}

/* From a at f = 0 to b at f = 1. */
static float between(float a, float b, float f)
{
    return a + (f * (b - a));
}

/* Bit for a number that no cell of this kind gives; asked of readings that were refused. */
static NOINLINE uint32_t out_of_range(float x)
{
    return IS_NUMBER(x) ? CELLWISE_OUT_OF_RANGE : 0u;
}

/* 1 - exp(-z) for z >= 0, with exp(z) by its first five terms: exact at 0, rises to 1. */
static NOINLINE float risen(float z)
{
    const float fourth = SIXTH + (z * TWENTY_FOURTH);
    const float grown = z * (1.0f + (z * (0.5f + (z * fourth))));
    return grown / (1.0f + grown);
}

/* exp(-z) for z >= 0, to 1e-4 of itself. */
static float vanishing(float z)
{
    float left = 1.0f - risen(((z < FURTHEST) ? z : FURTHEST) * 0.015625f);
    for (uint32_t k = 0u; k < 6u; k++) {
        left = left * left;
    }
    return left;
}

/* Square root of a number up to 4, to 1e-7 of itself. It is brought into 1/4..1 by fours (at first six of them at
 * once), where a straight line is off by 3 % at most; a Newton step leaves half the square of that. */
static NOINLINE float root(float square)
{
    float scaled = square;
    float unit = 1.0f;
    if (scaled > 1.0f) {
        scaled = 0.25f * scaled;
        unit = 2.0f;
    }
    for (uint32_t k = 0u; k < 4u; k++) {
        if (scaled >= 0x1p-12f) { break; }
        scaled = 4096.0f * scaled;
        unit = 0.015625f * unit;
    }
    for (uint32_t k = 0u; k < 6u; k++) {
        if (scaled >= 0.25f) { break; }
        scaled = 4.0f * scaled;
        unit = 0.5f * unit;
    }
    float r = LINE_OF_ROOT * (0.5f + scaled);
    for (uint32_t k = 0u; k < 2u; k++) {
        r = 0.5f * (r + (scaled / r));
    }
    return r * unit;
}

/* ln(1 + z) for z >= 0, to 1e-5: halved until it is below 2, then the series of atanh. */
static NOINLINE float log_of_more(float z)
{
    float y = 1.0f + ((z < LARGE) ? z : LARGE);
    float whole = 0.0f;
    for (uint32_t k = 0u; k < 21u; k++) {
        if (y <= 2.0f) { break; }
        y = 0.5f * y;
        whole = whole + LN_2;
    }
    const float t = (y - 1.0f) / (y + 1.0f);
    const float square = t * t;
    const float series = 1.0f + (square * (THIRD + (square * (FIFTH + (square * SEVENTH)))));
    return whole + ((2.0f * t) * series);
}

#endif
