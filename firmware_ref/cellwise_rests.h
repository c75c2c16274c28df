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

/* SOC that samples which are missing have taken, as the step counts it. Numbers that may have begun again go on from
 * where the count and the rest were. */
static float bridged(const cellwise_constants *c, const cellwise_state *x, cellwise_soh *a, uint32_t missing)
{
    float used = 0.0f;
    if (missing <= c->gap_steps) {
        used = moved_by(c, x, 0.5f * (x->current_A + a->current_A)) * (float)missing;
    } else {
        /* A load that many gaps hide takes the same way in all of them. */
        const float off = root(a->unsure) + root(c->gap_variance);
        a->unsure = at_most(off * off, 1.0f);
    }
    if (missing > LONGEST_GAP) {
        const uint32_t more = missing - LONGEST_GAP;
        a->counted_from = a->counted_from + more;
        a->loaded = a->loaded + more;
    }
    return used;
}

/* After so long a rest a voltage is the OCV, but for what the branches hold. */
static NOINLINE void keep_rested(const cellwise_constants *c, const cellwise_state *x, cellwise_soh *a, float voltage_V)
{
    if (POSITIVE_WITHIN(voltage_V, c->voltage_low_V, c->voltage_high_V)) {
        const float held_V = ((0.0f + x->v1_V) + x->v2_V) + x->v3_V;
        a->voltage_V = voltage_V;
        a->held_V = magnitude(held_V);
    }
}

/* Whether nobody knows what flows. */
static bool is_silent(const cellwise_constants *c, const cellwise_state *x, const cellwise_soh *a, float current_A)
{
    (void)a;
    (void)current_A;
    const bool silent = x->no_current > c->gap_steps;
    return silent;
}

void cellwise_soh_step(const cellwise_model *m, const cellwise_state *x, cellwise_soh *a, const cellwise_input *sample)
{
    const cellwise_constants *const c = &m->constant;
    const bool shown = NOT_NEGATIVE(a->share_variance, LARGE);
    if (!(shown && POSITIVE_WITHIN(a->share, LEAST_SHARE, MOST_SHARE))) {
        cellwise_soh_init(m, a);
    }
    const uint32_t elapsed = sample->sequence - a->sequence;
    const bool is_loaded = !SIZE_BELOW(x->current_A, c->soh_rest_A);
    if (a->begun == 0u) {
        a->begun = 1u;
        a->loaded = sample->sequence;
    } else if (elapsed != 0u) {
        if (is_loaded && (a->voltage_V > 0.0f)) {
            end_rest(m, x, a);
        }
        float used = moved_by(c, x, x->current_A);
        if (elapsed > 1u) {
            used = used + bridged(c, x, a, elapsed - 1u);
        }
        add(&a->counted, &a->counted_carry, -used);
        a->moved = a->moved + magnitude(used);
        const bool silent = is_silent(c, x, a, sample->current_A);
        if (silent) {
            begin_at_rest(a, 0.0f, 0.0f);
        }
        if (silent || is_loaded) {
            a->loaded = sample->sequence;
            a->voltage_V = 0.0f;
        } else if ((sample->sequence - a->loaded) >= c->soh_steps) {
            keep_rested(c, x, a, sample->voltage_V);
        } else { /* as before */
        }
    } else { /* as before */
    }
    a->sequence = sample->sequence;
    a->current_A = x->current_A;
}

#endif
