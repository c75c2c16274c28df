/* Part of cellwise_ekf.c. What a voltage and the past say against one of several filters. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_LIKELIHOOD_H
#define CELLWISE_LIKELIHOOD_H

#include "cellwise_sensors.h"

/* SOC between two components: `t` from -1 to 1 goes from 0 to 1, densely about the start. */
static float edge(float t, float soc, float std)
{
    float room = soc;
    if (t > 0.0f) {
        room = 1.0f - soc;
    }
    const float near = at_most(DENSE * std, room);
    const float size = magnitude(t);
    const float away = size * (near + ((room - near) * (size * size)));
    float at = soc - away;
    if (t > 0.0f) {
        at = soc + away;
    }
    return at;
}

/* The slow branch at one SOC: resistance, and what it loses or gains in a unit of time. */
typedef struct {
    float r3_ohm;
    float gain3;
} cellwise_slowbranch;

/* Where a component begins: its SOC, the variance of that, and what speaks against it. */
typedef struct {
    float soc;
    float variance;
    float cost;
} cellwise_component;

/* The component from `t` to `t + apart` in -1..1, about a start known to `std`. How sure a stated start is, is
 * itself not sure: Student's t of TAIL degrees of freedom. */
static void component_from(float t, float apart, float soc, float variance, float std, cellwise_component *component)
{
    const float low = edge(t, soc, std);
    const float high = edge(t + apart, soc, std);
    const float width = at_least(high - low, LEAST_WIDTH);
    const float wide = COMPONENT_WIDTH * width;
    component->soc = 0.5f * (low + high);
    const float away = component->soc - soc;
    const float off = (away * away) / (TAIL * variance);
    component->cost = ((0.5f * (TAIL + 1.0f)) * log_of_more(off)) + log_of_more((1.0f / width) - 1.0f);
    component->variance = wide * wide;
}

/* Of a component beside the likeliest's; once it is given up, it stays so. */
static float kept_cost(float cost)
{
    return (cost > COST_MOST) ? GIVEN_UP : cost;
}

/* Of components' predictions: their own, and how far they lie apart. */
static float mixture_variance(float own_V2, float mean_V, float square_V2)
{
    return own_V2 + at_least(square_V2 - (mean_V * mean_V), 0.0f);
}

/* How much of a voltage's evidence is new, where a part p of the model's error stays for good. Of a mean over t the
 * variance is ((1 - p) 2 tau / t + p) times an error's: what it says never exceeds one error over p, however long it
 * is taken. `shared` is 2 tau, `fades` (1 - p) of that, `stays` is p. */
static float evidence_share(float fades, float stays, float shared, float since)
{
    const float left = fades + (stays * since);
    return at_most((fades * shared) / (left * left), 1.0f);
}

/* The innovation that a component takes, one over its variance, minus the log likelihood. */
typedef struct {
    float off_V;
    float inverse;
    float cost;
} cellwise_componentupdate;

/* None is rejected: it moves a component as far as the gate. Beyond that it speaks against it in proportion to how
 * far it is off (Huber): below empty the lowest of them is the nearest. It counts as often as it moves the state:
 * samples that share one error of the model are one, of which `share` is new. */
static void component_update(float innovation_V, float variance_V2, float gate_square, float explained_V2,
                             float weight_V2, float below, float share, cellwise_componentupdate *componentupdate)
{
    const float most = gate_square * variance_V2;
    const float square = innovation_V * innovation_V;
    componentupdate->off_V = innovation_V;
    float grows = 1.0f;
    if (square > most) {
        const float passed = at_least(root(most / square), LEAST_PASSED);
        componentupdate->off_V = innovation_V * passed;
        grows = (2.0f / passed) - 1.0f;
    }
    componentupdate->inverse = inverse_weight(explained_V2, weight_V2, below);
    const float unlikely = log_of_more((explained_V2 * below) / weight_V2);
    componentupdate->cost = share *
        (0.5f * ((grows * ((componentupdate->off_V * componentupdate->off_V) * componentupdate->inverse)) + unlikely));
}

/* Of a load's way from full to a SOC, a charge's from empty, PAST_PART each; to be cut off. */
static float parts_before(float soc, float mean_A)
{
    float way = soc;
    if (mean_A >= 0.0f) {
        way = 1.0f - soc;
    }
    return (way / PAST_PART) + 0.5f;
}

/* SOC after so many parts. */
static float soc_on_way(float parts, float mean_A)
{
    float soc = parts * PAST_PART;
    if (mean_A >= 0.0f) {
        soc = 1.0f - soc;
    }
    return soc;
}

/* What the slow branch holds of a load before the start: mean, and variance of it. */
typedef struct {
    float held_V;
    float variance_V2;
} cellwise_past;

/* When of `before_V` the share `gone` has gone, under a load of `mean_A` since. Half of what it has left, and what
 * `past_A` would have, may be otherwise. */
static void past_of(float r_ohm, float gone, float mean_A, float before_V, float past_A, cellwise_past *past)
{
    const float left = 1.0f - gone;
    past->held_V = (gone * (r_ohm * mean_A)) + (left * before_V);
    const float spread_V = left * ((PAST_SPREAD * magnitude(before_V)) + (r_ohm * past_A));
    past->variance_V2 = (spread_V * spread_V) + LEAST_PAST_V2;
}

/* What the slow branch's past says against a component. */
static float cost_of_past(float off_V, float variance_V2)
{
    const float against = ((off_V * off_V) / variance_V2) + log_of_more(variance_V2 / LEAST_PAST_V2);
    return 0.5f * against;
}

#endif
