/* Part of cellwise_ekf.c. What a block of samples does to the estimate, and says to a component. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_BLOCK_H
#define CELLWISE_BLOCK_H

#include "cellwise_past.h"

/* A sample into its block; `before_A` is the current of the one before. */
static void collect_sample(const cellwise_model *m, cellwise_bank *b, const cellwise_state *x, cellwise_output *out,
                           float elapsed, bool lost, float before_A)
{
    const float unmeasured_A2 = unmeasured(m, x);
    const float current_A = (unmeasured_A2 > 0.0f) ? 0.0f : x->current_A;
    b->steps = b->steps + elapsed;
    b->samples = b->samples + 1.0f;
    b->block_A = b->block_A + ((current_A - b->block_A) / b->samples);
    if (uses_voltage(x, out)) {
        b->readings = b->readings + 1.0f;
        b->off_V = b->off_V + ((out->innovation_V - b->off_V) / b->readings);
    }
    b->unknown_A2 = at_least(b->unknown_A2, unmeasured_A2);
    if (lost) {
        b->unknown_A2 = at_least(b->unknown_A2, (current_A * current_A) + (before_A * before_A));
    }
}

/* What the block has done to the estimate `x`, so it does to every component. Charge has moved the SOC, and its
 * variance has grown. Each branch has followed a constant current, by its gain; what is not known of that has a mean
 * square. Of h a share is left, and some has come. `p` are the tables where the estimate is now. */
static void note_movement(const cellwise_model *m, cellwise_bank *b, const cellwise_state *x, const cellwise_point *p)
{
    b->moved = x->soc - b->soc;
    b->grown = at_least(x->ss - b->ss, 0.0f);
    b->gain1 = risen(b->steps * p->gain1);
    b->current1 = b->block_A;
    if ((p->r1_ohm > 0.0f) && (b->gain1 > 0.0f)) {
        float constant_A = (b->v1_V + ((x->v1_V - b->v1_V) / b->gain1)) / p->r1_ohm;
        b->current1 = clip(constant_A, -LARGE, LARGE);
    }
    b->gain2 = risen(b->steps * p->gain2);
    b->current2 = b->block_A;
    if ((p->r2_ohm > 0.0f) && (b->gain2 > 0.0f)) {
        float constant_A = (b->v2_V + ((x->v2_V - b->v2_V) / b->gain2)) / p->r2_ohm;
        b->current2 = clip(constant_A, -LARGE, LARGE);
    }
    b->gain3 = risen(b->steps * p->gain3);
    b->current3 = b->block_A;
    if ((p->r3_ohm > 0.0f) && (b->gain3 > 0.0f)) {
        float constant_A = (b->v3_V + ((x->v3_V - b->v3_V) / b->gain3)) / p->r3_ohm;
        b->current3 = clip(constant_A, -LARGE, LARGE);
    }
    b->square_A2 = unknown_square(share_of(&m->constant, b->block_A), b->block_A, b->unknown_A2);
    b->keep_h = 1.0f - risen((m->constant.hysteresis_per_A * magnitude(b->block_A)) * b->steps);
    b->rise_h = x->h - (b->keep_h * b->h);
}

/* What the voltages of a block say, as one under its mean current, beside the estimate `x`. Its variance is that at
 * the likeliest component, for all: one whose tables state a larger error must not explain everything. `share` of it
 * is new, 0 where there is none. */
static void note_voltage(const cellwise_model *m, cellwise_bank *b, const cellwise_state *x, float likeliest_soc,
                         const cellwise_place *place, const cellwise_point *p)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_point here;
    look_up(m, place, likeliest_soc, b->block_A, &here);
    const float held_V = ((magnitude(here.r0_ohm * b->block_A) + magnitude(x->v1_V)) + magnitude(x->v2_V)) +
        magnitude(x->v3_V);
    const float beyond_V = beyond_data(m, x, b->block_A, held_V);
    b->error_V2 = single_variance(c, here.noise_V2, b->block_A, held_V, unmeasured(m, x), here.r0_ohm) +
        (beyond_V * beyond_V);
    const bool alone = (b->known == 0u) && SIZE_BELOW(b->block_A, c->rest_A);
    const float since = time_of_evidence(x);
    cellwise_shared shared;
    shared_evidence(c, since, alone ? 1.0f : b->steps, alone, &shared);
    b->said_V = voltage_at(x, p, p->r0_ohm * b->block_A) + b->off_V;
    b->said_A = b->block_A;
    const float least = shared.below / at_least(b->readings, 1.0f); /* a mean of readings that share nothing */
    b->weight_V2 = as_shown(b->error_V2 * at_least(shared.above, least), b->mismatch);
    b->below = shared.below;
    b->share = 0.0f;
    if ((b->readings > 0.0f) && (shared.below > 0.0f)) {
        b->share = evidence_share(c->fades, c->stays, c->shared, since);
    }
    b->lately = at_most(c->lately * b->steps, 1.0f);
}

/* A state over a block, its SOC apart: what the estimate has done, by its own tables. */
static void carry_on(cellwise_state *x, cellwise_bank *b, const cellwise_point *p, const cellwise_slopes *slopes)
{
    const float gain1 = b->gain1;
    const float current1 = b->current1;
    const float gain2 = b->gain2;
    const float current2 = b->current2;
    const float gain3 = b->gain3;
    const float current3 = b->current3;
    relax(x, p, gain1, gain2, gain3, current1, current2, current3, b->square_A2);
    x->h = clip((b->keep_h * x->h) + b->rise_h, -1.0f, 1.0f);
    fade_hysteresis(x, b->keep_h);
    if (slopes->spread > 0.0f) {
        tilt(x, slopes, gain1 * current1, gain2 * current2, gain3 * current3);
    }
    if (POSITIVE_ABOVE(1.0f, x->ss)) {
        add_variance(x, b->grown);
    }
}

/* The voltage of a block to a component: none is rejected, each moves by what the gate lets. What all of them have
 * expected is kept for the mixture, and what of it is left for the next. */
static void weigh_block(const cellwise_model *m, cellwise_state *x, cellwise_bank *b, const cellwise_point *p,
                        const cellwise_slopes *slopes)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_column column;
    column_of(x, slopes->slope_V, p->m_V, &column);
    const float explained_V2 = bent_variance(explained(&column, slopes->slope_V, p->m_V), slopes->bend_V);
    const float off_V = b->said_V - voltage_at(x, p, p->r0_ohm * b->said_A);
    const float variance_V2 = explained_V2 + b->error_V2;
    b->mean_off_V = b->mean_off_V + (x->weight * off_V);
    b->square_V2 = b->square_V2 + (x->weight * (off_V * off_V));
    b->own_V2 = b->own_V2 + (x->weight * variance_V2);
    float left_V2 = explained_V2;
    float left_V = off_V;
    if (b->share > 0.0f) {
        cellwise_componentupdate used;
        component_update(off_V, variance_V2, c->gate_square, explained_V2, b->weight_V2, b->below, b->share, &used);
        cellwise_column gain;
        scaled(&column, used.inverse, &gain);
        x->cost = x->cost + used.cost;
        move(x, &gain, used.off_V);
        narrow(x, &gain, &column);
        const float error_V = persistent_V(c->persistent, p->noise_V2 - c->fixed_V2, b->mismatch);
        const float persistent = persistent_step(gain.s, slopes->slope_V, x->persistent, error_V);
        x->persistent = clip(persistent, -1.0f, 1.0f);
        const float taken = explained_V2 * used.inverse;
        left_V2 = explained_V2 - (taken * explained_V2);
        left_V = off_V - (taken * used.off_V);
    }
    x->error_V2 = left_V2 + b->error_V2;
    b->left_V = b->left_V + (x->weight * left_V);
    b->left_V2 = b->left_V2 + (x->weight * (left_V * left_V));
    hold_within(x);
}

/* A component over a block: what the estimate has done, at its own SOC, then the voltage. */
static void step_component(const cellwise_model *m, cellwise_bank *b, cellwise_state *x, const cellwise_place *place)
{
    add(&x->soc, &x->soc_carry, b->moved);
    cellwise_point p;
    look_up(m, place, x->soc, b->said_A, &p);
    if (b->looks == NEVER_LOOKED) {
        guess_branches(&m->constant, x, &p, b->said_A);
    }
    cellwise_slopes slopes;
    no_slopes(&p, &slopes);
    if (x->ss > WIDE_VARIANCE) {
        slopes_of(m, place, x->soc, root(x->ss), b->said_A, &p, &slopes);
    }
    carry_on(x, b, &p, &slopes);
    weigh_block(m, x, b, &p, &slopes);
    if (b->look != NO_LOOK) {
        look_back(m, b, place, x);
    }
}

#endif
