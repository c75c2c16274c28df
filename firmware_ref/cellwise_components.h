/* Part of cellwise_ekf.c. A start that is not known: filters side by side, weighed, gathered. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_COMPONENTS_H
#define CELLWISE_COMPONENTS_H

#include "cellwise_step.h"

/* A component from `t` on about the estimate, whose copy `a` is. */
static void component_start(cellwise_state *a, float t, float apart, float std)
{
    cellwise_component begins;
    component_from(t, apart, a->soc, a->ss, std, &begins);
    a->cost = begins.cost;
    a->soc = begins.soc;
    a->soc_carry = 0.0f;
    a->ss = begins.variance;
    a->ss_carry = 0.0f;
    forget_correlations(a);
    if (a->evidence == NOT_BEGUN) {
        a->h = (a->soc > 0.5f) ? 1.0f : -1.0f;
    }
    a->in_bank = COMPONENT;
}

/* Weights that add up to one; the likeliest component costs nothing. */
static void weigh_components(cellwise_state *of, uint32_t count, float least)
{
    float total = 0.0f;
    for (uint32_t k = 0u; k < count; k++) {
        of[k + 1u].cost = kept_cost(of[k + 1u].cost - least);
        of[k + 1u].weight = vanishing(of[k + 1u].cost);
        total = total + of[k + 1u].weight;
    }
    for (uint32_t k = 0u; k < count; k++) {
        of[k + 1u].weight = of[k + 1u].weight / total;
    }
}

/* Components over all of the SOC, densely about the estimate. */
static void spread_out(cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    const float std = root(of[0u].ss);
    const float apart = 2.0f / (float)count;
    float least = GIVEN_UP;
    for (uint32_t k = 0u; k < count; k++) {
        of[k + 1u] = of[0u];
        component_start(&of[k + 1u], (apart * (float)k) - 1.0f, apart, std);
        if (of[k + 1u].cost < least) {
            least = of[k + 1u].cost;
            b->likeliest = k + 1u;
        }
    }
    of[0u].in_bank = ALONE;
    b->spread = 1u;
    b->mismatch = of[0u].mismatch;
    weigh_components(of, count, least);
}

/* SOC held within 0..1. */
static void hold_within(cellwise_state *a)
{
    if (!NOT_NEGATIVE(a->soc, 1.0f)) {
        a->soc = within_one(a->soc);
        a->soc_carry = 0.0f;
    }
}

/* The components' mean state, as a column. */
static void mean_of(const cellwise_state *of, uint32_t count, cellwise_column *column)
{
    column->s = 0.0f;
    column->v1 = 0.0f;
    column->v2 = 0.0f;
    column->v3 = 0.0f;
    column->h = 0.0f;
    for (uint32_t k = 0u; k < count; k++) {
        if (of[k + 1u].cost < GIVEN_UP) { /* else dropped: nobody looks after its memory */
            column->s = column->s + (of[k + 1u].weight * of[k + 1u].soc);
            column->v1 = column->v1 + (of[k + 1u].weight * of[k + 1u].v1_V);
            column->v2 = column->v2 + (of[k + 1u].weight * of[k + 1u].v2_V);
            column->v3 = column->v3 + (of[k + 1u].weight * of[k + 1u].v3_V);
            column->h = column->h + (of[k + 1u].weight * of[k + 1u].h);
        }
    }
    column->variance = 0.0f;
}

/* A state at the mean, with no covariance yet. */
static void take_mean(cellwise_state *x, const cellwise_column *mean)
{
    x->soc = mean->s;
    x->v1_V = mean->v1;
    x->v2_V = mean->v2;
    x->v3_V = mean->v3;
    x->h = mean->h;
    x->soc_carry = 0.0f;
    x->v3_carry_V = 0.0f;
    x->ss = 0.0f;
    x->s1 = 0.0f;
    x->s2 = 0.0f;
    x->s3 = 0.0f;
    x->sh = 0.0f;
    x->p11 = 0.0f;
    x->p12 = 0.0f;
    x->p13 = 0.0f;
    x->p1h = 0.0f;
    x->p22 = 0.0f;
    x->p23 = 0.0f;
    x->p2h = 0.0f;
    x->p33 = 0.0f;
    x->p3h = 0.0f;
    x->phh = 0.0f;
    x->ss_carry = 0.0f;
    x->persistent = 0.0f;
    x->in_bank = ALONE;
}

/* What a component adds to the covariance of the state `x` at the mean. */
static void collect(cellwise_state *x, cellwise_state *a)
{
    const float aways = a->soc - x->soc;
    const float away1 = a->v1_V - x->v1_V;
    const float away2 = a->v2_V - x->v2_V;
    const float away3 = a->v3_V - x->v3_V;
    const float awayh = a->h - x->h;
    x->ss = x->ss + (a->weight * (a->ss + (aways * aways)));
    x->s1 = x->s1 + (a->weight * (a->s1 + (aways * away1)));
    x->s2 = x->s2 + (a->weight * (a->s2 + (aways * away2)));
    x->s3 = x->s3 + (a->weight * (a->s3 + (aways * away3)));
    x->sh = x->sh + (a->weight * (a->sh + (aways * awayh)));
    x->p11 = x->p11 + (a->weight * (a->p11 + (away1 * away1)));
    x->p12 = x->p12 + (a->weight * (a->p12 + (away1 * away2)));
    x->p13 = x->p13 + (a->weight * (a->p13 + (away1 * away3)));
    x->p1h = x->p1h + (a->weight * (a->p1h + (away1 * awayh)));
    x->p22 = x->p22 + (a->weight * (a->p22 + (away2 * away2)));
    x->p23 = x->p23 + (a->weight * (a->p23 + (away2 * away3)));
    x->p2h = x->p2h + (a->weight * (a->p2h + (away2 * awayh)));
    x->p33 = x->p33 + (a->weight * (a->p33 + (away3 * away3)));
    x->p3h = x->p3h + (a->weight * (a->p3h + (away3 * awayh)));
    x->phh = x->phh + (a->weight * (a->phh + (awayh * awayh)));
    x->persistent = x->persistent + (a->weight * a->persistent);
}

/* The estimate: mean and covariance of the whole bank; the rest is the likeliest one's. */
static void gather(cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    cellwise_column mean;
    mean_of(of, count, &mean);
    of[0u] = of[b->likeliest];
    take_mean(&of[0u], &mean);
    hold_within(&of[0u]);
    for (uint32_t k = 0u; k < count; k++) {
        if (of[k + 1u].cost < GIVEN_UP) {
            collect(&of[0u], &of[k + 1u]);
        }
    }
    of[0u].mismatch = b->mismatch;
    if ((of[0u].ss <= WIDE_VARIANCE) && (b->looks == LOOKS)) {
        b->spread = 0u;
    }
}

#endif
