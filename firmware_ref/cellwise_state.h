/* Part of cellwise_ekf.c. Whether a state is sound, where it starts, what an interval does to it. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_STATE_H
#define CELLWISE_STATE_H

#include "cellwise_weighing.h"

/* CW-006. Every number in its range: memory that lost its content, or was never set, is noticed. */
static bool is_sound(const cellwise_constants *c, const cellwise_state *x)
{
    (void)c;
    if (!NOT_NEGATIVE(x->soc, 1.0f)) { return false; }
    if (!SIZE_WITHIN(x->ss_carry, CARRY_MOST)) { return false; }
    if (!SIZE_WITHIN(x->soc_carry, CARRY_MOST)) { return false; }
    if (!SIZE_WITHIN(x->v3_carry_V, CARRY_MOST)) { return false; }
    if (!SIZE_WITHIN(x->v1_V, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->v2_V, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->v3_V, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->h, 1.0f)) { return false; }
    if (!(SIZE_WITHIN(x->current_A, LARGE) && NOT_NEGATIVE(x->mismatch, LARGE))) { return false; }
    if (!WITHIN(x->heat_K, -HEAT_MOST_K, HEAT_MOST_K)) { return false; }
    if (!SIZE_WITHIN(x->slow_A, LARGE)) { return false; }
    if (!WITHIN(x->temperature_C, COLDEST_C, HOTTEST_C)) { return false; }
    if (!(SIZE_WITHIN(x->contradicted, 1.0f) && SIZE_WITHIN(x->persistent, LARGE))) { return false; }
    if (!(SIZE_WITHIN(x->voltage_V, LARGE) && SIZE_WITHIN(x->frozen_A, LARGE))) { return false; }
    if (!(SIZE_WITHIN(x->swings, SWINGS_MOST) && NOT_NEGATIVE(x->repeats, FOUND_FROZEN))) { return false; }
    if (!(SIZE_WITHIN(x->reach, REACH_MOST) && SIZE_WITHIN(x->score, SCORE_MOST))) { return false; }
    if (!POSITIVE_WITHIN(x->information, 1.0f, INFORMATION_MOST)) { return false; }
    if (!(SIZE_WITHIN(x->believed, REACH_MOST) && NOT_NEGATIVE(x->unsure, LARGE))) { return false; }
    if (!(WITHIN(x->rest, REST_USED, SCORE_MOST) && SIZE_WITHIN(x->rest_A, LARGE))) { return false; }
    if (!SIZE_WITHIN(x->d1_V, REACH_MOST)) { return false; }
    if (!SIZE_WITHIN(x->d2_V, REACH_MOST)) { return false; }
    if (!SIZE_WITHIN(x->d3_V, REACH_MOST)) { return false; }
    if (!POSITIVE_WITHIN(x->per_capacity, 1.0f / MOST_SHARE, 1.0f / LEAST_SHARE)) { return false; }
    if (!POSITIVE_WITHIN(x->resistance_scale, LEAST_SCALE, MOST_SCALE)) { return false; }
    if (!SIZE_WITHIN(x->mean_V, LARGE)) { return false; }
    if (!(NOT_NEGATIVE(x->error_V2, LARGE) && (x->in_bank <= UNCOUNTED))) { return false; }
    return covariance_is_sound(x);
}

uint32_t cellwise_set_health(const cellwise_model *m, cellwise_state *x, float capacity_share, float resistance_scale)
{
    uint32_t status = CELLWISE_OUT_OF_RANGE;
    const bool share = POSITIVE_WITHIN(capacity_share, LEAST_SHARE, MOST_SHARE);
    const bool scale = POSITIVE_WITHIN(resistance_scale, LEAST_SCALE, MOST_SCALE);
    if (share && scale && is_sound(&m->constant, x)) {
        x->per_capacity = 1.0f / capacity_share;
        x->resistance_scale = resistance_scale;
        status = 0u;
    }
    return status;
}

/* Nothing counted yet, nothing known of an offset. */
static void forget_offset(cellwise_state *x)
{
    x->reach = 0.0f;
    x->score = 0.0f;
    x->information = 1.0f;
    x->believed = 0.0f;
    x->unsure = CHANCE;
    x->d1_V = 0.0f;
    x->d2_V = 0.0f;
    x->d3_V = 0.0f;
    x->rest = 0.0f;
    x->rest_A = 0.0f;
}

/* A cell at rest; its branches are guessed at the first sample. */
static NOINLINE void start(const cellwise_constants *c, cellwise_state *x, float soc, float soc_variance)
{
    x->soc = soc;
    x->v1_V = 0.0f;
    x->v2_V = 0.0f;
    x->v3_V = 0.0f;
    x->soc_carry = 0.0f;
    x->v3_carry_V = 0.0f;
    x->h = (soc > 0.5f) ? 1.0f : -1.0f;
    start_covariance(x, soc_variance);
    x->current_A = 0.0f;
    x->mismatch = 1.0f;
    x->heat_K = 0.0f;
    x->slow_A = 0.0f;
    x->temperature_C = c->temperature_C;
    x->ss_carry = 0.0f;
    x->contradicted = 0.0f;
    x->persistent = 0.0f;
    x->voltage_V = 0.0f;
    x->frozen_A = 0.0f;
    x->repeats = 0.0f;
    x->swings = 0.0f;
    x->no_current = 0u;
    x->no_voltage = 0u;
    forget_offset(x);
    x->per_capacity = 1.0f;
    x->resistance_scale = 1.0f;
    x->cost = 0.0f;
    x->weight = 1.0f;
    x->error_V2 = 0.0f;
    x->in_bank = ALONE;
    x->mean_V = 0.0f;
    x->cells_at = 0u;
    x->turn = 0u;
    x->sequence = 0u;
    x->rejections = 0u;
    x->evidence = NOT_BEGUN;
}

/* Whether it has seen no sample yet. */
static bool is_new(const cellwise_state *x)
{
    return x->evidence == NOT_BEGUN;
}

/* Whether it has used a voltage. */
static bool has_voltage(const cellwise_state *x)
{
    return x->evidence >= FIRST_VOLTAGE;
}

/* Whether the last sample had a voltage that can be used. */
static bool uses_voltage(const cellwise_state *x, cellwise_output *out)
{
    (void)out;
    return has_voltage(x) && (x->no_voltage == 0u);
}

/* What rounding has kept from the sums is dropped: they are set. */
static void forget_rounding(cellwise_state *x)
{
    x->soc_carry = 0.0f;
    x->v3_carry_V = 0.0f;
    x->ss_carry = 0.0f;
}

/* A component of a bank, whose numbers are set. */
static void stand_in_bank(cellwise_state *x)
{
    forget_rounding(x);
    x->in_bank = COMPONENT;
}

/* The estimate of one, whose numbers are. */
static void stand_alone(cellwise_state *x)
{
    forget_rounding(x);
    x->in_bank = ALONE;
}

/* SOC held within 0..1. */
static void hold_within(cellwise_state *x)
{
    if (!NOT_NEGATIVE(x->soc, 1.0f)) {
        x->soc = within_one(x->soc);
        x->soc_carry = 0.0f;
    }
}

/* After voltages that contradicted it for long the SOC is open, branches may hold anything. Without CELLWISE_WIDE
 * they are what they would be at a start. */
static void open_up(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p, float delayed_current_A)
{
    (void)delayed_current_A;
    x->ss = at_least(x->ss, RECOVERY_VARIANCE);
    forget_correlations(x);
    float kept = x->v1_V * x->v1_V;
    float held = held_variance(c->branch_variance_V2, p->r1_ohm, c->recovery_A, LOAD_LIMIT_V);
    x->p11 = held + kept;
    kept = x->v2_V * x->v2_V;
    held = held_variance(c->branch_variance_V2, p->r2_ohm, c->recovery_A, LOAD_LIMIT_V);
    x->p22 = held + kept;
    kept = x->v3_V * x->v3_V;
    held = held_variance(c->branch_variance_V2, p->r3_ohm, c->recovery_A, LOAD_LIMIT_V);
    x->p33 = held + kept;
}

/* Charge that leaves the cell in one step, in SOC. */
static float taken(const cellwise_constants *c, const cellwise_state *x, float current)
{
    float used = current;
    if (used < 0.0f) {
        used = used * c->charge_efficiency;
    }
    used = ((c->soc_per_A * used) + c->leak_soc) * x->per_capacity;
    return used;
}

/* One interval of constant current. */
static void predict(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                    const cellwise_slopes *slopes, float counted_current_A, float unmeasured_A2)
{
    const float square_A2 = unknown_square(share_of(c, counted_current_A), counted_current_A, unmeasured_A2);
    relax(x, p, p->gain1, p->gain2, p->gain3, counted_current_A, counted_current_A, counted_current_A, square_A2);
    const float rise = risen(c->hysteresis_per_A * magnitude(counted_current_A));
    const float keep = 1.0f - rise;
    x->h = clip((keep * x->h) + ((counted_current_A < 0.0f) ? rise : -rise), -1.0f, 1.0f);
    fade_hysteresis(x, keep);
    if (slopes->spread > 0.0f) {
        tilt(x, slopes, p->gain1 * counted_current_A, p->gain2 * counted_current_A, p->gain3 * counted_current_A);
    }
    if (POSITIVE_ABOVE(SOC_VARIANCE_MOST, x->ss)) {
        add_variance(x, c->soc_walk + (c->capacity_walk * magnitude(counted_current_A)));
    }
}

/* The cell's own warming over one interval. */
static void heat(const cellwise_constants *c, cellwise_state *x, float r0_ohm, float delayed_current_A,
                 float counted_current_A)
{
    const float fall = (((r0_ohm * delayed_current_A) + x->v1_V) + x->v2_V) + x->v3_V;
    const float change_K = c->heat_gain * ((c->heat_K_per_W * (counted_current_A * fall)) - x->heat_K);
    x->heat_K = clip(x->heat_K + change_K, -HEAT_MOST_K, HEAT_MOST_K);
}

#endif
