/* Part of cellwise_ekf.c. What a voltage and the past say against one of several filters. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_LIKELIHOOD_H
#define CELLWISE_LIKELIHOOD_H

#include "cellwise_start.h"

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

/* What speaks against a component `away` from a stated start, and of a `width` in SOC. How sure a stated start is,
 * is itself not sure: Student's t of TAIL degrees of freedom. */
static float start_cost(float away, float variance, float width)
{
    const float off = (away * away) / (TAIL * variance);
    return ((0.5f * (TAIL + 1.0f)) * log_of_more(off)) + log_of_more((1.0f / width) - 1.0f);
}

/* How much of a voltage's evidence is new, where a part p of the model's error stays for good. Of a mean over t the
 * variance is ((1 - p) 2 tau / t + p) times an error's: what it says never exceeds one error over p, however long it
 * is taken. `shared` is 2 tau, `fades` (1 - p) of that, `stays` is p. */
static float evidence_share(float fades, float stays, float shared, float since)
{
    const float left = fades + (stays * since);
    return at_most((fades * shared) / (left * left), 1.0f);
}

/* What the gate lets pass of an innovation, and how the rest `grows` what it says. */
typedef struct {
    float off_V;
    float grows;
} cellwise_passed;

/* An innovation as a component takes it: as far as the gate. Beyond that it speaks against a component in proportion
 * to how far it is off (Huber): below empty the lowest of them is the nearest. */
static void let_pass(float innovation_V, float variance_V2, float gate_square, cellwise_passed *passed)
{
    const float most = gate_square * variance_V2;
    const float square = innovation_V * innovation_V;
    passed->off_V = innovation_V;
    passed->grows = 1.0f;
    if (square > most) {
        const float share = at_least(root(most / square), LEAST_PASSED);
        passed->off_V = innovation_V * share;
        passed->grows = (2.0f / share) - 1.0f;
    }
}

/* What a voltage says against a component: minus the logarithm of its likelihood. It counts as often as it moves the
 * state: samples that share one error of the model are one. */
static float cost_of_voltage(float share, float off_V, float grows, float inverse, float explained_V2, float weight_V2)
{
    const float against = (grows * ((off_V * off_V) * inverse)) + log_of_more(explained_V2 / weight_V2);
    return share * (0.5f * against);
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
