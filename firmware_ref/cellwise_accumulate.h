/* Part of cellwise_ekf.c. What a sketch adds up after a step. Printed from src/cellwise/estimate by `python -m
 * cellwise.printing`; do not edit. */
#ifndef CELLWISE_ACCUMULATE_H
#define CELLWISE_ACCUMULATE_H

#include "cellwise_rests.h"

/* Of a row: voltage, OCV slope, drops, their change in a step, what of it may be off. */
typedef struct {
    float voltage_V;
    float slope_V;
    float drop_V;
    float drop_per_A;
    float change_V;
    float fast_V2;
    float slow_V;
    float share_V;
} cellwise_simulated;

void cellwise_sketch_init(const cellwise_model *m, cellwise_sketch *k, uint32_t unit)
{
    (void)m;
    k->unit = unit;
    k->degrees = 0.0f;
    k->segments = 0.0f;
    k->rows = 0.0f;
    k->count = NOT_SIMULATED;
    k->blocks = 0u;
    for (uint32_t a = 0u; a < CELLWISE_SKETCH; a++) {
        k->past[a] = 0.0f;
        k->now[a] = 0.0f;
    }
    for (uint32_t a = 0u; a < CELLWISE_SKETCH_SUMS; a++) {
        k->sum[a] = 0.0f;
        k->part[a] = 0.0f;
    }
}

/* What was summed counts for less after the rows of one more simulation. */
static void fade(const cellwise_constants *c, cellwise_sketch *k)
{
    const float keep = 1.0f - (c->sketch_fade * (float)k->blocks);
    k->segments = keep * k->segments;
    k->rows = keep * k->rows;
    k->degrees = keep * k->degrees;
    for (uint32_t a = 0u; a < CELLWISE_SKETCH_SUMS; a++) {
        k->sum[a] = k->sum[a] + k->part[a];
        k->part[a] = 0.0f;
        k->sum[a] = keep * k->sum[a];
    }
}

/* The simulation's SOC is the filter's from here on. */
static void anchor(const cellwise_constants *c, const cellwise_state *x, cellwise_sketch *k)
{
    fade(c, k);
    k->soc = x->soc;
    k->start_soc = x->soc;
    k->blocks = 0u;
    k->slow = -1.0f;
    for (uint32_t a = 0u; a < CELLWISE_SKETCH; a++) {
        k->past[a] = 0.0f;
        k->past_share[a] = 0.0f;
    }
}

/* A cell at rest. What the filter guesses of its branches under load is no evidence. */
static NOINLINE void begin_segment(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k)
{
    anchor(&m->constant, x, k);
    cellwise_place place;
    place_now(m, x, &place);
    cellwise_point p;
    look_up(m, &place, k->soc, 0.0f, &p);
    k->fast_ohm = p.r1_ohm;
    k->fast_gain = p.gain1;
    k->v1_V = 0.0f;
    k->v2_V = 0.0f;
    k->v3_V = 0.0f;
    k->h = x->h;
    k->slow_A = 0.0f;
    k->path = 0.0f;
    k->sum_A = 0.0f;
    k->last_A = 0.0f;
    k->count = 0u;
}

/* A hysteresis after a row's mean current. */
static float follow_path(float h, float current, float per_A)
{
    const float end = (current < 0.0f) ? 1.0f : -1.0f;
    return h + (risen(per_A * magnitude(current)) * (end - h));
}

/* The voltage now: slow states over the row's mean current, the fast one has followed. */
static void simulate_row(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k, float current,
                         float jump_A, float mean_A, cellwise_simulated *simulated)
{
    const cellwise_constants *const c = &m->constant;
    k->soc = k->soc - (c->sketch_steps * taken(c, x, mean_A));
    cellwise_place place;
    place_now(m, x, &place);
    cellwise_point p;
    look_up(m, &place, k->soc, current, &p);
    simulated->change_V = (p.r0_ohm * jump_A) + (k->fast_gain * ((k->fast_ohm * current) - k->v1_V));
    simulated->drop_V = (p.r0_ohm * current) + k->v1_V;
    simulated->drop_per_A = p.r0_ohm + p.r1_ohm;
    k->fast_ohm = p.r1_ohm;
    k->fast_gain = p.gain1;
    const float gain2 = risen(c->sketch_steps * p.gain2);
    k->v2_V = k->v2_V + (gain2 * ((p.r2_ohm * mean_A) - k->v2_V));
    simulated->drop_V = simulated->drop_V + k->v2_V;
    simulated->drop_per_A = simulated->drop_per_A + p.r2_ohm;
    const float gain3 = risen(c->sketch_steps * p.gain3);
    k->v3_V = k->v3_V + (gain3 * ((p.r3_ohm * mean_A) - k->v3_V));
    simulated->drop_V = simulated->drop_V + k->v3_V;
    simulated->drop_per_A = simulated->drop_per_A + p.r3_ohm;
    simulated->voltage_V = p.ocv_V - simulated->drop_V;
    k->h = follow_path(k->h, mean_A, c->sketch_steps * c->hysteresis_per_A);
    simulated->voltage_V = simulated->voltage_V + (p.m_V * k->h);
    const float stated_V2 = p.noise_V2 - c->fixed_V2;
    const float square_V2 = simulated->drop_V * simulated->drop_V;
    simulated->fast_V2 = c->sketch_V2 + ((c->sketch_fast * stated_V2) + (c->sketch_fast_share * square_V2));
    simulated->slow_V = 0.0f;
    simulated->share_V = 0.0f;
    simulated->slow_V = root(c->sketch_slow * stated_V2);
    simulated->share_V = c->sketch_slow_share * simulated->drop_V;
    simulated->slope_V = p.slope_V;
}

/* Derivatives of the voltage by every cause, in the order of `cellwise.diagnose.sketched`. */
static void derive(const cellwise_constants *c, cellwise_sketch *k, const cellwise_simulated *r, float current,
                   float mean_A)
{
    k->slow_A = mean_A + (c->sketch_branch * (k->slow_A - mean_A));
    k->path = follow_path(k->path, mean_A, c->sketch_path);
    k->now[1u] = r->drop_per_A + (r->slope_V * ((float)k->blocks * c->sketch_soc));
    k->now[2u] = r->change_V * c->sketch_per_s;
    k->now[3u] = -k->slow_A;
    k->now[4u] = k->path;
    k->now[5u] = r->slope_V;
    k->now[6u] = 1.0f;
    k->now[7u] = -r->drop_V;
    k->now[8u] = -current;
    k->now[9u] = r->slope_V * (k->start_soc - k->soc);
}

/* What the rows before do not explain of this one; returns one over its variance. */
static float whiten(const cellwise_constants *c, cellwise_sketch *k, const cellwise_simulated *r)
{
    const float keep = c->sketch_keep;
    const float square = keep * keep;
    if (k->slow < 0.0f) {
        k->segments = k->segments + 1.0f;
        k->slow = 1.0f;
        k->share = 1.0f;
        k->both = 0.0f;
    }
    k->slow = (square * k->slow) + (1.0f - square);
    float slow = k->slow * r->slow_V;
    float inverse = 1.0f / (r->fast_V2 + (r->slow_V * slow));
    k->share = (square * k->share) + (1.0f - square);
    k->both = square * k->both;
    slow = slow + (k->both * r->share_V);
    const float share = (k->both * r->slow_V) + (k->share * r->share_V);
    inverse = 1.0f / (r->fast_V2 + ((r->slow_V * slow) + (r->share_V * share)));
    const float share_gain = share * inverse;
    k->share = k->share - (share * share_gain);
    k->both = k->both - (slow * share_gain);
    const float slow_gain = slow * inverse;
    k->slow = k->slow - (slow * slow_gain);
    for (uint32_t a = 0u; a < CELLWISE_SKETCH; a++) {
        const float known = keep * k->past[a];
        float news = k->now[a] - (r->slow_V * known);
        const float known_share = keep * k->past_share[a];
        news = news - (r->share_V * known_share);
        k->past_share[a] = known_share + (share_gain * news);
        k->past[a] = known + (slow_gain * news);
        k->now[a] = news;
    }
    return inverse;
}

/* Products of all pairs, weighed; a simulation has sums of its own where there is room. */
static void sum_up(cellwise_sketch *k, float inverse)
{
    uint32_t at = 0u;
    for (uint32_t a = 0u; a < CELLWISE_SKETCH; a++) {
        const float weighed = inverse * k->now[a];
        for (uint32_t b = 0u; b < a + 1u; b++) {
            const float more = weighed * k->now[b];
            k->part[at] = k->part[at] + more;
            at = at + 1u;
        }
    }
    k->rows = k->rows + 1.0f;
}

/* Simulate the voltage that was read now, and sum where the model says what it should be. */
static NOINLINE void end_row(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k,
                             const cellwise_input *sample, float current, float jump_A)
{
    const cellwise_constants *const c = &m->constant;
    k->blocks = k->blocks + 1u;
    const float mean_A = k->sum_A * c->sketch_share;
    cellwise_simulated r;
    simulate_row(m, x, k, current, jump_A, mean_A, &r);
    derive(c, k, &r, current, mean_A);
    const bool shown = POSITIVE_WITHIN(sample->voltage_V, c->voltage_low_V, c->voltage_high_V);
    if (shown && (k->soc > c->sketch_low)) {
        k->now[0u] = sample->voltage_V - r.voltage_V;
        sum_up(k, whiten(c, k, &r));
        const bool warm = SIZE_WITHIN(sample->temperature_C, HOTTEST_C);
        k->degrees = k->degrees + (warm ? sample->temperature_C : USUAL_DEGREES);
    }
    k->count = 0u;
    k->sum_A = 0.0f;
    if ((k->blocks >= c->sketch_most) && (x->ss <= c->sketch_soc2)) {
        anchor(c, x, k);
    }
}

void cellwise_sketch_add(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k,
                         const cellwise_input *sample)
{
    const cellwise_constants *const c = &m->constant;
    const uint32_t elapsed = sample->sequence - k->sequence;
    k->sequence = sample->sequence;
    const float read_A = sample->current_A;
    const bool usable = SIZE_WITHIN(read_A, c->current_limit_A);
    if ((k->count == NOT_SIMULATED) || (elapsed > 1u) || !usable) {
        k->count = NOT_SIMULATED;
        if (usable && (x->ss <= c->sketch_soc2)) {
            begin_segment(m, x, k);
        }
    } else if (elapsed == 1u) {
        const float jump_A = read_A - k->last_A;
        k->last_A = read_A;
        const float current = read_A - (c->skew_share * jump_A);
        k->sum_A = k->sum_A + current;
        k->v1_V = k->v1_V + (k->fast_gain * ((k->fast_ohm * current) - k->v1_V));
        k->count = k->count + 1u;
        if (k->count >= c->sketch_rows) {
            end_row(m, x, k, sample, current, jump_A);
        }
    } else { /* as before */
    }
}

#endif
