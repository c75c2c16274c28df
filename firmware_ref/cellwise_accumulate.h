/* Part of cellwise_ekf.c. What a sketch adds up after a step. Printed from src/cellwise/estimate by `python -m
 * cellwise.printing`; do not edit. */
#ifndef CELLWISE_ACCUMULATE_H
#define CELLWISE_ACCUMULATE_H

#include "cellwise_rests.h"

/* Of one block: mean SOC and current, voltage, OCV slope, drops, what of it may be off. */
typedef struct {
    float soc;
    float current;
    float voltage_V;
    float slope_V;
    float drop_V;
    float drop_per_A;
    float fast_V2;
    float slow_V2;
} cellwise_block;

void cellwise_sketch_init(const cellwise_model *m, cellwise_sketch *k)
{
    (void)m;
    k->generation = 0u;
    k->sequence = 0u;
    k->segments = 0u;
    k->rows = 0u;
    k->on = 0u;
    for (uint32_t a = 0u; a < REGRESSORS; a++) {
        k->past[a] = 0.0f;
        k->now[a] = 0.0f;
    }
    for (uint32_t a = 0u; a < SKETCH_SUMS; a++) {
        k->sum[a] = 0.0f;
        k->carry[a] = 0.0f;
    }
}

/* The simulation's SOC is the filter's from here on. */
static void anchor(const cellwise_state *x, cellwise_sketch *k)
{
    k->soc = x->soc;
    k->start_soc = x->soc;
    k->offset_soc = 0.0f;
    k->blocks = 0u;
    k->counted = 0u;
    for (uint32_t a = 0u; a < REGRESSORS; a++) {
        k->past[a] = 0.0f;
    }
}

/* A cell at rest. What the filter guesses of its branches under load is no evidence. */
static void begin_segment(const cellwise_state *x, cellwise_sketch *k)
{
    anchor(x, k);
    k->v1_V = 0.0f;
    k->d1_V = 0.0f;
    k->v2_V = 0.0f;
    k->d2_V = 0.0f;
    k->v3_V = 0.0f;
    k->d3_V = 0.0f;
    k->h = x->h;
    k->slow_A = 0.0f;
    k->path = 0.0f;
    k->last_V = 0.0f;
    k->sum_A = 0.0f;
    k->sum_V = 0.0f;
    k->count = 0u;
    k->read = 0u;
    k->on = 1u;
}

/* Over one block at its mean current; voltages are means of the block. */
static void simulate_block(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k, float current,
                           float steps, cellwise_block *block)
{
    const cellwise_constants *const c = &m->constant;
    const float used = steps * taken(c, x, current);
    block->soc = k->soc - (0.5f * used);
    k->soc = clip(k->soc - used, -1.0f, 2.0f);
    cellwise_place place;
    place_now(m, x, &place);
    cellwise_point p;
    look_up(m, &place, block->soc, current, &p);
    block->drop_V = p.r0_ohm * current;
    block->drop_per_A = p.r0_ohm;
    const float z1 = steps * (p.gain1 / (1.0f - (0.5f * p.gain1)));
    const float left1 = vanishing(z1);
    const float share1 = (1.0f - left1) / z1;
    const float end1 = p.r1_ohm * current;
    block->drop_V = block->drop_V + (end1 + (share1 * (k->v1_V - end1)));
    k->v1_V = end1 + (left1 * (k->v1_V - end1));
    block->drop_per_A = block->drop_per_A + (p.r1_ohm + (share1 * (k->d1_V - p.r1_ohm)));
    k->d1_V = p.r1_ohm + (left1 * (k->d1_V - p.r1_ohm));
    const float z2 = steps * (p.gain2 / (1.0f - (0.5f * p.gain2)));
    const float left2 = vanishing(z2);
    const float share2 = (1.0f - left2) / z2;
    const float end2 = p.r2_ohm * current;
    block->drop_V = block->drop_V + (end2 + (share2 * (k->v2_V - end2)));
    k->v2_V = end2 + (left2 * (k->v2_V - end2));
    block->drop_per_A = block->drop_per_A + (p.r2_ohm + (share2 * (k->d2_V - p.r2_ohm)));
    k->d2_V = p.r2_ohm + (left2 * (k->d2_V - p.r2_ohm));
    const float z3 = steps * (p.gain3 / (1.0f - (0.5f * p.gain3)));
    const float left3 = vanishing(z3);
    const float share3 = (1.0f - left3) / z3;
    const float end3 = p.r3_ohm * current;
    block->drop_V = block->drop_V + (end3 + (share3 * (k->v3_V - end3)));
    k->v3_V = end3 + (left3 * (k->v3_V - end3));
    block->drop_per_A = block->drop_per_A + (p.r3_ohm + (share3 * (k->d3_V - p.r3_ohm)));
    k->d3_V = p.r3_ohm + (left3 * (k->d3_V - p.r3_ohm));
    block->voltage_V = p.ocv_V - block->drop_V;
    const float keep = vanishing((c->hysteresis_per_A * magnitude(current)) * steps);
    const float end_h = (current < 0.0f) ? 1.0f : -1.0f;
    k->h = end_h + (keep * (k->h - end_h));
    block->voltage_V = block->voltage_V + (p.m_V * k->h);
    block->fast_V2 = c->sketch_V2 + (c->share_variance * (block->drop_V * block->drop_V));
    block->slow_V2 = p.noise_V2 - c->fixed_V2;
    block->current = current;
    block->slope_V = p.slope_V;
}

/* Derivatives of the voltage by every cause, in the order of `cellwise.diagnose.sketched`. */
static void derive(const cellwise_constants *c, cellwise_sketch *k, const cellwise_block *b, float steps)
{
    const float gone = k->start_soc - b->soc;
    const float offset_soc = k->offset_soc + ((0.5f * steps) * c->soc_per_A);
    k->offset_soc = k->offset_soc + (steps * c->soc_per_A);
    k->slow_A = b->current + (c->sketch_slow * (k->slow_A - b->current));
    const float keep = vanishing((c->sketch_path * magnitude(b->current)) * steps);
    const float end = (b->current < 0.0f) ? 1.0f : -1.0f;
    k->path = end + (keep * (k->path - end));
    k->now[0u] = b->drop_per_A + (b->slope_V * offset_soc);
    k->now[1u] = b->drop_V + (b->slope_V * gone);
    k->now[2u] = 1.0f;
    k->now[3u] = 0.0f;
    if (k->blocks > 0u) {
        k->now[3u] = (k->last_V - b->voltage_V) / c->sketch_s;
    }
    k->now[4u] = -b->current;
    k->now[5u] = -b->drop_V;
    k->now[6u] = -k->slow_A;
    k->now[7u] = k->path;
    k->now[8u] = b->slope_V * gone;
    k->now[9u] = b->slope_V;
    k->last_V = b->voltage_V;
}

/* What the last blocks do not explain of this one; returns one over its variance. */
static float whiten(const cellwise_constants *c, cellwise_sketch *k, float fast_V2, float slow_V2)
{
    const float keep = c->sketch_keep;
    const float square = keep * keep;
    float before = slow_V2;
    if (k->counted == 1u) {
        before = (square * k->slow_V2) + ((1.0f - square) * slow_V2);
    }
    const float inverse = 1.0f / (before + fast_V2);
    const float gain = before * inverse;
    k->slow_V2 = before * (1.0f - gain);
    for (uint32_t a = 0u; a < REGRESSORS; a++) {
        const float known = keep * k->past[a];
        const float news = k->now[a] - known;
        k->past[a] = known + (gain * news);
        k->now[a] = news;
    }
    return inverse;
}

/* Products of all pairs, weighed, into compensated sums. */
static void sum_up(cellwise_sketch *k, float inverse)
{
    uint32_t at = 0u;
    for (uint32_t a = 0u; a < REGRESSORS; a++) {
        const float weighed = inverse * k->now[a];
        for (uint32_t b = 0u; b < a + 1u; b++) {
            const float more = weighed * k->now[b];
            add(&k->sum[at], &k->carry[at], more);
            at = at + 1u;
        }
    }
    k->rows = k->rows + 1u;
}

/* Simulate the block, and sum it where the model says what it should. */
static NOINLINE void end_block(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k)
{
    const cellwise_constants *const c = &m->constant;
    const float steps = (float)k->count;
    cellwise_block b;
    simulate_block(m, x, k, k->sum_A / steps, steps, &b);
    derive(c, k, &b, steps);
    if ((k->read > 0u) && (b.soc > c->sketch_low)) {
        k->now[RESIDUAL] = (k->sum_V / (float)k->read) - b.voltage_V;
        sum_up(k, whiten(c, k, b.fast_V2, b.slow_V2));
        if (k->counted == 0u) {
            k->segments = k->segments + 1u;
            k->counted = 1u;
        }
    }
    k->blocks = k->blocks + 1u;
    k->count = 0u;
    k->read = 0u;
    k->sum_A = 0.0f;
    k->sum_V = 0.0f;
    if ((k->blocks >= c->sketch_most) && (x->ss <= c->sketch_soc2)) {
        anchor(x, k);
    }
}

void cellwise_sketch_add(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k,
                         const cellwise_input *sample)
{
    const cellwise_constants *const c = &m->constant;
    if ((k->on == 0u) || (sample->sequence != k->sequence)) {
        if ((k->on == 1u) && (sample->sequence != (k->sequence + 1u))) {
            k->on = 0u;
        }
        k->sequence = sample->sequence;
        if (!SIZE_WITHIN(sample->current_A, c->current_limit_A)) {
            k->on = 0u;
        } else if (k->on == 0u) {
            if (x->ss <= c->sketch_soc2) {
                begin_segment(x, k);
            }
        } else {
            k->sum_A = k->sum_A + sample->current_A;
            if (POSITIVE_WITHIN(sample->voltage_V, c->voltage_low_V, c->voltage_high_V)) {
                k->sum_V = k->sum_V + sample->voltage_V;
                k->read = k->read + 1u;
            }
            k->count = k->count + 1u;
            if (k->count >= c->sketch_steps) {
                end_block(m, x, k);
            }
        }
    }
}

#endif
