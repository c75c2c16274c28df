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
    stand_in_bank(a);
    forget_correlations(a);
    a->cost = begins.cost;
    a->soc = begins.soc;
    a->ss = begins.variance;
    if (is_new(a)) {
        a->h = (a->soc > 0.5f) ? 1.0f : -1.0f;
    }
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

/* Where the estimate is as a block begins. */
static void note_estimate(cellwise_bank *b, const cellwise_state *x)
{
    b->soc = x->soc;
    b->v1_V = x->v1_V;
    b->v2_V = x->v2_V;
    b->v3_V = x->v3_V;
    b->h = x->h;
    b->ss = x->ss;
}

/* Nothing seen yet; where the estimate `x` is now. */
static void begin_block(cellwise_bank *b, const cellwise_state *x)
{
    note_estimate(b, x);
    b->known = has_voltage(x) ? 1u : 0u;
    b->steps = 0.0f;
    b->samples = 0.0f;
    b->readings = 0.0f;
    b->off_V = 0.0f;
    b->block_A = 0.0f;
    b->unknown_A2 = 0.0f;
    b->first_V2 = 0.0f;
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
    stand_alone(&of[0u]);
    of[0u].error_V2 = 0.0f;
    begin_block(b, &of[0u]);
    b->spread = 1u;
    b->turn = 0u;
    b->mismatch = of[0u].mismatch;
    weigh_components(of, count, least);
}

/* About an estimate that has been stepped alone: what was before its start is long over. */
static void spread_again(cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    b->looks = LOOKS;
    if (count > 1u) {
        spread_out(b, of, count);
    }
}

/* A cell that nobody has seen yet, or the estimate alone where its start is known. */
static void begin_bank(cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    b->spread = 0u;
    b->likeliest = 1u;
    b->looks = NEVER_LOOKED;
    b->since = 0.0f;
    b->next_look = 0.0f;
    b->mean_A = 0.0f;
    b->looked_A = 0.0f;
    b->mismatch = 1.0f;
    if ((count > 1u) && (of[0u].ss > WIDE_VARIANCE)) {
        spread_out(b, of, count);
    }
}

/* No mean and no covariance yet: what it goes on to collect. */
static void clear(cellwise_state *x)
{
    x->soc = 0.0f;
    x->v1_V = 0.0f;
    x->v2_V = 0.0f;
    x->v3_V = 0.0f;
    x->h = 0.0f;
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
    x->persistent = 0.0f;
    stand_alone(x);
}

/* What a component adds to the mean. */
static void collect_mean(cellwise_state *x, cellwise_state *a)
{
    x->soc = x->soc + (a->weight * a->soc);
    x->v1_V = x->v1_V + (a->weight * a->v1_V);
    x->v2_V = x->v2_V + (a->weight * a->v2_V);
    x->v3_V = x->v3_V + (a->weight * a->v3_V);
    x->h = x->h + (a->weight * a->h);
}

/* What a component adds to the covariance of the state `x` at the mean. */
static void collect(cellwise_state *x, cellwise_state *a)
{
    const float aways = a->soc - x->soc;
    const float shares = a->weight * aways;
    const float away1 = a->v1_V - x->v1_V;
    const float share1 = a->weight * away1;
    const float away2 = a->v2_V - x->v2_V;
    const float share2 = a->weight * away2;
    const float away3 = a->v3_V - x->v3_V;
    const float share3 = a->weight * away3;
    const float awayh = a->h - x->h;
    const float shareh = a->weight * awayh;
    x->ss = (x->ss + (a->weight * a->ss)) + (shares * aways);
    x->s1 = (x->s1 + (a->weight * a->s1)) + (shares * away1);
    x->s2 = (x->s2 + (a->weight * a->s2)) + (shares * away2);
    x->s3 = (x->s3 + (a->weight * a->s3)) + (shares * away3);
    x->sh = (x->sh + (a->weight * a->sh)) + (shares * awayh);
    x->p11 = (x->p11 + (a->weight * a->p11)) + (share1 * away1);
    x->p12 = (x->p12 + (a->weight * a->p12)) + (share1 * away2);
    x->p13 = (x->p13 + (a->weight * a->p13)) + (share1 * away3);
    x->p1h = (x->p1h + (a->weight * a->p1h)) + (share1 * awayh);
    x->p22 = (x->p22 + (a->weight * a->p22)) + (share2 * away2);
    x->p23 = (x->p23 + (a->weight * a->p23)) + (share2 * away3);
    x->p2h = (x->p2h + (a->weight * a->p2h)) + (share2 * awayh);
    x->p33 = (x->p33 + (a->weight * a->p33)) + (share3 * away3);
    x->p3h = (x->p3h + (a->weight * a->p3h)) + (share3 * awayh);
    x->phh = (x->phh + (a->weight * a->phh)) + (shareh * awayh);
    x->persistent = x->persistent + (a->weight * a->persistent);
}

/* The estimate: mean and covariance of the whole bank. Where the components agree, however unsure each is, it goes
 * on alone. */
static void gather(cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    clear(&of[0u]);
    for (uint32_t k = 0u; k < count; k++) {
        if (of[k + 1u].cost < GIVEN_UP) { /* else dropped: nobody looks after its memory */
            collect_mean(&of[0u], &of[k + 1u]);
        }
    }
    hold_within(&of[0u]);
    float within = 0.0f;
    for (uint32_t k = 0u; k < count; k++) {
        if (of[k + 1u].cost < GIVEN_UP) {
            collect(&of[0u], &of[k + 1u]);
            within = within + (of[k + 1u].weight * of[k + 1u].ss);
        }
    }
    of[0u].mismatch = b->mismatch;
    if (((of[0u].ss - within) <= WIDE_VARIANCE) && (b->looks == LOOKS)) {
        b->spread = 0u;
    }
}

#endif
