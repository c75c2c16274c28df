/* Part of cellwise_ekf.c. What a block of samples does to the estimate, and says to a component. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_BLOCK_H
#define CELLWISE_BLOCK_H

#include "cellwise_past.h"

/* What a block of samples has done to the estimate, and does to every component. Charge has moved the SOC, and its
 * variance has grown. Each branch has followed a constant `current`, by its `gain`; what is not known of that has a
 * mean square of `square_A2`. Of h the share `keep_h` is left, and `rise_h` has come. */
typedef struct {
    float soc;
    float variance;
    float gain1;
    float gain2;
    float gain3;
    float current1;
    float current2;
    float current3;
    float square_A2;
    float keep_h;
    float rise_h;
} cellwise_movement;

/* What the voltages of a block say, as one voltage under its mean current. `error_V2` is the variance of that
 * voltage, `weight_V2` over `below` what it weighs with, `share` of it is new; 0 where there is none. */
typedef struct {
    float voltage_V;
    float current_A;
    float error_V2;
    float weight_V2;
    float below;
    float share;
} cellwise_block;

/* The voltage that a component expects, and the variance of an innovation. */
typedef struct {
    float voltage_V;
    float variance_V2;
} cellwise_expected;

/* A sample into its block; `before_A` is the current of the one before. */
static void collect_sample(const cellwise_model *m, cellwise_bank *b, const cellwise_state *x, float off_V,
                           float elapsed, bool lost, float before_A)
{
    const float unmeasured_A2 = unmeasured(m, x);
    const float current_A = (unmeasured_A2 > 0.0f) ? 0.0f : x->current_A;
    b->steps = b->steps + elapsed;
    b->samples = b->samples + 1.0f;
    b->block_A = b->block_A + ((current_A - b->block_A) / b->samples);
    if (uses_voltage(x)) {
        b->readings = b->readings + 1.0f;
        b->off_V = b->off_V + ((off_V - b->off_V) / b->readings);
    }
    b->unknown_A2 = at_least(b->unknown_A2, unmeasured_A2);
    if (lost) {
        b->unknown_A2 = at_least(b->unknown_A2, (current_A * current_A) + (before_A * before_A));
    }
}

/* Of the estimate `x` since the block began; `p` are the tables where it is now. */
static void movement_of(const cellwise_model *m, cellwise_bank *b, const cellwise_state *x, const cellwise_point *p,
                        cellwise_movement *movement)
{
    movement->gain1 = risen(b->steps * p->gain1);
    movement->current1 = b->block_A;
    if ((p->r1_ohm > 0.0f) && (movement->gain1 > 0.0f)) {
        movement->current1 = (b->v1_V + ((x->v1_V - b->v1_V) / movement->gain1)) / p->r1_ohm;
    }
    movement->gain2 = risen(b->steps * p->gain2);
    movement->current2 = b->block_A;
    if ((p->r2_ohm > 0.0f) && (movement->gain2 > 0.0f)) {
        movement->current2 = (b->v2_V + ((x->v2_V - b->v2_V) / movement->gain2)) / p->r2_ohm;
    }
    movement->gain3 = risen(b->steps * p->gain3);
    movement->current3 = b->block_A;
    if ((p->r3_ohm > 0.0f) && (movement->gain3 > 0.0f)) {
        movement->current3 = (b->v3_V + ((x->v3_V - b->v3_V) / movement->gain3)) / p->r3_ohm;
    }
    movement->keep_h = 1.0f;
    movement->rise_h = 0.0f;
    movement->keep_h = 1.0f - risen((m->constant.hysteresis_per_A * magnitude(b->block_A)) * b->steps);
    movement->rise_h = x->h - (movement->keep_h * b->h);
    movement->soc = x->soc - b->soc;
    movement->variance = at_least(x->ss - b->ss, 0.0f);
    movement->square_A2 = unknown_square(share_of(&m->constant, b->block_A), b->block_A, b->unknown_A2);
}

/* What the voltages say beside the estimate `x`, which has been at `p`. Their variance is that at the likeliest
 * component, for all: one whose tables state a larger error must not explain everything. */
static void block_of(const cellwise_model *m, cellwise_bank *b, const cellwise_state *x, float likeliest_soc,
                     const cellwise_place *place, const cellwise_point *p, bool alone, cellwise_block *block)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_point here;
    look_up(m, place, likeliest_soc, b->block_A, &here);
    const float held_V = ((magnitude(here.r0_ohm * b->block_A) + magnitude(x->v1_V)) + magnitude(x->v2_V)) +
        magnitude(x->v3_V);
    const float beyond_V = beyond_data(m, x, b->block_A, held_V);
    block->error_V2 = single_variance(c, here.noise_V2, b->block_A, held_V, unmeasured(m, x), here.r0_ohm) +
        (beyond_V * beyond_V);
    const float since = time_of_evidence(x);
    cellwise_shared shared;
    shared_evidence(c, since, alone ? 1.0f : b->steps, alone, &shared);
    block->share = 0.0f;
    if ((b->readings > 0.0f) && (shared.below > 0.0f)) {
        block->share = evidence_share(c->fades, c->stays, c->shared, since);
    }
    block->voltage_V = voltage_at(x, p, p->r0_ohm * b->block_A) + b->off_V;
    block->current_A = b->block_A;
    block->weight_V2 = as_shown(block->error_V2 * at_least(shared.above, shared.below), b->mismatch);
    block->below = shared.below;
}

/* The voltage of a block to a component: none is rejected, each moves by what the gate lets. */
static void use_block(const cellwise_model *m, cellwise_state *x, const cellwise_block *block, const cellwise_point *p,
                      const cellwise_slopes *slopes, float mismatch, cellwise_expected *expected)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_column column;
    column_of(x, slopes->slope_V, p->m_V, &column);
    const float explained_V2 = bent_variance(explained(&column, slopes->slope_V, p->m_V), slopes->bend_V);
    expected->voltage_V = voltage_at(x, p, p->r0_ohm * block->current_A);
    expected->variance_V2 = explained_V2 + block->error_V2;
    if (block->share > 0.0f) {
        cellwise_componentupdate used;
        component_update(block->voltage_V - expected->voltage_V, expected->variance_V2, c->gate_square, explained_V2,
                         block->weight_V2, block->below, block->share, &used);
        cellwise_column gain;
        scaled(&column, used.inverse, &gain);
        x->cost = x->cost + used.cost;
        move(x, &gain, used.off_V);
        narrow(x, &gain, &column);
        const float error_V = persistent_V(c->persistent, p->noise_V2 - c->fixed_V2, mismatch);
        const float persistent = persistent_step(gain.s, slopes->slope_V, x->persistent, error_V);
        x->persistent = clip(persistent, -1.0f, 1.0f);
    }
}

/* A component over a block: what the estimate has done, at its own SOC, then the voltage. */
static void step_component(const cellwise_model *m, cellwise_state *x, const cellwise_place *place,
                           const cellwise_movement *o, const cellwise_block *block, bool begins, float mismatch,
                           cellwise_expected *expected)
{
    add(&x->soc, &x->soc_carry, o->soc);
    cellwise_point p;
    look_up(m, place, x->soc, block->current_A, &p);
    if (begins) {
        guess_branches(&m->constant, x, &p, block->current_A);
    }
    cellwise_slopes slopes;
    no_slopes(&p, &slopes);
    if (x->ss > WIDE_VARIANCE) {
        slopes_of(m, place, x->soc, root(x->ss), block->current_A, &p, &slopes);
    }
    relax(x, &p, o->gain1, o->gain2, o->gain3, o->current1, o->current2, o->current3, o->square_A2);
    x->h = clip((o->keep_h * x->h) + o->rise_h, -1.0f, 1.0f);
    fade_hysteresis(x, o->keep_h);
    if (slopes.spread > 0.0f) {
        tilt(x, &slopes, o->gain1 * o->current1, o->gain2 * o->current2, o->gain3 * o->current3);
    }
    if (POSITIVE_ABOVE(1.0f, x->ss)) {
        add_variance(x, o->variance);
    }
    cellwise_expected said;
    use_block(m, x, block, &p, &slopes, mismatch, &said);
    hold_within(x);
    *expected = said;
}

#endif
