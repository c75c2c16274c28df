/* Part of cellwise_ekf.c. What branches may hold that nobody has seen before. Printed from src/cellwise/estimate by
 * `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_START_H
#define CELLWISE_START_H

#include "cellwise_covariance.h"

/* What may have flowed before a start: its mean, how far it may be off, the most it leaves. */
typedef struct {
    float mean_A;
    float spread_A;
    float limit_V;
} cellwise_before;

/* Nearly nothing at rest, half of the load under load. */
static void load_before(float current_A, float rest_A, float start_rest_A, float start_load_A, cellwise_before *before)
{
    before->mean_A = 0.0f;
    before->spread_A = start_rest_A;
    before->limit_V = REST_LIMIT_V;
    if (!(magnitude(current_A) < rest_A)) {
        before->mean_A = START_LOAD_SHARE * current_A;
        before->spread_A = at_least(magnitude(before->mean_A), start_load_A);
        before->limit_V = NO_LIMIT_V;
    }
}

/* Variance of a branch that holds anything up to what a current leaves there; 0 without it. */
static float held_variance(float rested_V2, float r_ohm, float most_A, float limit_V)
{
    float variance_V2 = 0.0f;
    if (r_ohm > 0.0f) {
        const float held_V = at_most(most_A * r_ohm, limit_V);
        variance_V2 = rested_V2 + (held_V * held_V);
    }
    return variance_V2;
}

/* What the branches hold when nobody knows what was before. */
static NOINLINE void guess_branches(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                                    float current)
{
    const float rested_V2 = c->branch_variance_V2;
    forget_correlations(x);
    cellwise_before before;
    load_before(current, c->rest_A, c->start_rest_A, c->start_load_A, &before);
    x->v1_V = p->r1_ohm * before.mean_A;
    x->p11 = held_variance(rested_V2, p->r1_ohm, before.spread_A, before.limit_V);
    x->v2_V = p->r2_ohm * before.mean_A;
    x->p22 = held_variance(rested_V2, p->r2_ohm, before.spread_A, before.limit_V);
    x->v3_V = p->r3_ohm * before.mean_A;
    x->v3_carry_V = 0.0f;
    x->p33 = held_variance(rested_V2, p->r3_ohm, before.spread_A, before.limit_V);
}

#endif
