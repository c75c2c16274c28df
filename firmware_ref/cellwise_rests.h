/* Part of cellwise_ekf.c. The charge between rests, and how long a cell has rested. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_RESTS_H
#define CELLWISE_RESTS_H

#include "cellwise_capacity.h"

/* SOC of the tables' capacity that a current takes in one step. */
static float moved_by(const cellwise_constants *c, const cellwise_state *x, float current_A)
{
    float used = taken(c, x, current_A);
    used = used / x->per_capacity;
    return used;
}

/* The charge of an interval, and of samples that are missing, as the step counts them. */
static void count_on(const cellwise_constants *c, const cellwise_state *x, cellwise_soh *a, uint32_t missing)
{
    float used = moved_by(c, x, x->current_A);
    if (missing != 0u) {
        if (missing <= c->gap_steps) {
            used = used + (moved_by(c, x, 0.5f * (x->current_A + a->current_A)) * (float)missing);
        } else {
            /* A load that many gaps hide takes the same way in all of them. */
            const float off = root(a->unsure) + root(c->gap_variance);
            a->unsure = at_most(off * off, 1.0f);
        }
    }
    add(&a->counted, &a->counted_carry, -used);
    a->moved = at_most(a->moved + magnitude(used), SINCE_MOST);
    if (a->steps < COUNT_MOST) {
        a->steps = (a->steps + missing) + 1u;
    }
}

/* How long the cell has rested, and what its voltage was last. */
static void watch_rest(const cellwise_constants *c, const cellwise_state *x, cellwise_soh *a, uint32_t missing,
                       float voltage_V)
{
    if (SIZE_BELOW(x->current_A, c->soh_rest_A)) {
        if (a->rest < COUNT_MOST) {
            a->rest = (a->rest + missing) + 1u;
        }
        const bool shown = POSITIVE_WITHIN(voltage_V, c->voltage_low_V, c->voltage_high_V);
        if (shown && (a->rest >= c->soh_steps)) {
            const float held_V = ((0.0f + x->v1_V) + x->v2_V) + x->v3_V;
            a->voltage_V = voltage_V;
            a->held_V = magnitude(held_V);
        }
    } else {
        a->rest = 0u;
        a->voltage_V = 0.0f;
    }
}

void cellwise_soh_step(const cellwise_model *m, const cellwise_state *x, cellwise_soh *a, const cellwise_input *sample)
{
    const cellwise_constants *const c = &m->constant;
    const bool shown = NOT_NEGATIVE(a->share_variance, LARGE);
    if (!(shown && POSITIVE_WITHIN(a->share, LEAST_SHARE, MOST_SHARE))) {
        cellwise_soh_init(m, a);
    }
    const uint32_t elapsed = sample->sequence - a->sequence;
    if (a->begun == 0u) {
        a->begun = 1u;
    } else if (elapsed != 0u) {
        uint32_t missing = elapsed - 1u;
        missing = (missing < LONGEST_GAP) ? missing : LONGEST_GAP;
        if ((a->voltage_V > 0.0f) && !SIZE_BELOW(x->current_A, c->soh_rest_A)) {
            end_rest(m, x, a);
        }
        count_on(c, x, a, missing);
        a->silent = SIZE_WITHIN(sample->current_A, c->current_limit_A) ? 0u : (a->silent + 1u);
        if (x->no_current > c->gap_steps) {
            a->silent = x->no_current;
        }
        if (a->silent > c->gap_steps) {
            begin_at_rest(a, 0.0f, 0.0f);
            a->rest = 0u;
            a->voltage_V = 0.0f;
        } else {
            watch_rest(c, x, a, missing, sample->voltage_V);
        }
    } else { /* as before */
    }
    a->sequence = sample->sequence;
    a->current_A = x->current_A;
}

#endif
