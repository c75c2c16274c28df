/* Part of cellwise_ekf.c. What a measured voltage is expected to be, and how far it may be off. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_INNOVATION_H
#define CELLWISE_INNOVATION_H

#include "cellwise_sensing.h"

/* CW-010. How often the voltage has gone up and down under a current that repeats itself. */
static void watch_current(const cellwise_constants *c, cellwise_state *x, float voltage)
{
    if (x->evidence >= FIRST_VOLTAGE) {
        x->swings = swings_after(x->swings, voltage - x->voltage_V, c->frozen_V);
    }
}

/* CW-009. Whether the voltage is frozen: CELLWISE_VOLTAGE_FROZEN, or 0. */
static uint32_t watch_voltage(const cellwise_constants *c, cellwise_state *x, float voltage, float delayed_current_A,
                              float r0_ohm, float innovation_V)
{
    cellwise_heldvoltage now;
    repeats_after(x->voltage_V, x->frozen_A, x->repeats, voltage, delayed_current_A, r0_ohm, innovation_V, c->frozen_V,
                  &now);
    x->voltage_V = now.voltage_V;
    x->frozen_A = now.since_A;
    x->repeats = now.repeats;
    return (now.repeats >= FOUND_FROZEN) ? CELLWISE_VOLTAGE_FROZEN : 0u;
}

/* Steps since the first voltage, or since a recovery. */
static float time_of_evidence(const cellwise_state *x)
{
    uint32_t since = 0u;
    if (x->evidence >= FIRST_VOLTAGE) {
        since = x->evidence - FIRST_VOLTAGE;
        since = (since < EVIDENCE_MOST) ? since : EVIDENCE_MOST;
    }
    return (float)since;
}

/* How many samples share one model error; the first voltage at rest stands alone. */
static void shared_by(const cellwise_constants *c, const cellwise_state *x, float delayed_current_A,
                      cellwise_shared *shared)
{
    const bool alone = (x->evidence < FIRST_VOLTAGE) && SIZE_BELOW(delayed_current_A, c->rest_A);
    shared_evidence(c, time_of_evidence(x), 1.0f, alone, shared);
}

/* CW-018. Whether SOC, current or temperature is beyond the model's data: CELLWISE_OUTSIDE, or 0. */
static uint32_t outside(const cellwise_constants *c, const cellwise_state *x, const cellwise_reading *reading)
{
    uint32_t status = 0u;
    if (!WITHIN(x->soc, c->valid_soc_low, c->valid_soc_high)) {
        status = CELLWISE_OUTSIDE;
    }
    if (!WITHIN(reading->delayed_current_A, c->valid_charge_A, c->valid_discharge_A)) {
        status = CELLWISE_OUTSIDE;
    }
    if (!WITHIN(x->temperature_C, c->valid_cold_C, c->valid_warm_C)) {
        status = CELLWISE_OUTSIDE;
    }
    return status;
}

/* What the model can be off by beyond its data's current and temperature, one deviation. The law of the float64
 * filters: a share of the polarisation, as of an exponential to its third order; what lies beyond in SOC is in the
 * table of the error. */
static float extrapolated(const cellwise_constants *c, const cellwise_state *x, float delayed_current_A,
                          float polarisation_V)
{
    float share = c->share_per_A * distance_beyond(delayed_current_A, c->valid_charge_A, c->valid_discharge_A);
    float moved_V = 0.0f;
    const float far_K = distance_beyond(x->temperature_C, c->valid_cold_C, c->valid_warm_C);
    share = share + exponential_rise(c->share_per_K * far_K);
    moved_V = c->voltage_per_K * far_K;
    return (share * polarisation_V) + moved_V;
}

/* What the model can be off by beyond its data, one deviation [V]. */
static float beyond_data(const cellwise_model *m, const cellwise_state *x, float current, float held_V)
{
    const float beyond_V = extrapolated(&m->constant, x, current, held_V);
    return beyond_V;
}

/* Mean square of a current that nobody measures [A^2]. */
static float unmeasured(const cellwise_model *m, const cellwise_state *x)
{
    return (x->no_current > m->constant.hold_steps) ? m->constant.lost_A2 : 0.0f;
}

/* How far an offset leads over one interval: the count, where there was one, and the branches. What is believed of
 * it moves the SOC. */
static void count_offset(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                         const cellwise_reading *reading, uint32_t missing)
{
    float counted = 1.0f;
    if ((missing != 0u) || (reading->unmeasured_A2 > 0.0f)) {
        counted = 0.0f;
    }
    const float moved = counted * c->drift_soc;
    x->reach = at_most(x->reach + moved, REACH_MOST);
    add(&x->soc, &x->soc_carry, x->believed * moved);
    x->d1_V = followed(x->d1_V, p->gain1, p->r1_ohm * c->offset_A);
    x->d2_V = followed(x->d2_V, p->gain2, p->r2_ohm * c->offset_A);
    x->d3_V = followed(x->d3_V, p->gain3, p->r3_ohm * c->offset_A);
    cellwise_standstill now;
    rest_after(x->rest, x->rest_A, reading->current, counted, c->rate_A, c->rest_steps, &now);
    x->rest = now.lasts;
    x->rest_A = now.current_A;
    if ((now.weight > 0.0f) && (c->offset_A > 0.0f) && (x->information < (INFORMATION_MOST - now.weight))) {
        x->information = x->information + now.weight;
        x->score = x->score + ((now.weight * reading->current) / c->offset_A);
    }
}

/* By what one deviation of an offset puts the drop over R0 and branches too high [V]. */
static float dropped_by_offset(const cellwise_constants *c, const cellwise_state *x, const cellwise_point *p)
{
    const float dropped_V = (((p->r0_ohm * c->offset_A) + x->d1_V) + x->d2_V) + x->d3_V;
    return dropped_V;
}

/* What a voltage that has moved the state says of an offset, and where that moves the SOC. */
static void ask_for_offset(cellwise_state *x, const cellwise_innovation *innovation, float innovation_V, float gain,
                           float inverse)
{
    const float before = x->believed * x->reach;
    const float own_V = innovation_V + innovation->bias_V;
    cellwise_offset now;
    offset_after(x->score, x->information, innovation->of_offset_V, own_V, inverse, &now);
    x->reach = x->reach - (gain * innovation->of_offset_V);
    x->score = now.score;
    x->information = now.information;
    x->believed = now.believed;
    x->unsure = now.unsure;
    const float more = (gain * innovation->bias_V) + ((x->believed * x->reach) - before);
    add(&x->soc, &x->soc_carry, more);
}

/* Predicted voltage, and the variances of what is measured about it. */
static void innovate(const cellwise_constants *c, const cellwise_state *x, const cellwise_point *p,
                     const cellwise_slopes *slopes, const cellwise_reading *reading, cellwise_innovation *innovation)
{
    const float drop = p->r0_ohm * reading->delayed_current_A;
    const float polarisation_V = ((magnitude(drop) + magnitude(x->v1_V)) + magnitude(x->v2_V)) + magnitude(x->v3_V);
    innovation->voltage_V = voltage_at(x, p, drop);
    innovation->single_V2 =
        single_variance(c, p->noise_V2, reading->delayed_current_A, polarisation_V, reading->unmeasured_A2, p->r0_ohm);
    const float beyond_V = extrapolated(c, x, reading->delayed_current_A, polarisation_V);
    innovation->single_V2 = innovation->single_V2 + (beyond_V * beyond_V);
    column_of(x, slopes->slope_V, p->m_V, &innovation->column);
    innovation->explained_V2 = explained(&innovation->column, slopes->slope_V, p->m_V);
    innovation->explained_V2 = bent_variance(innovation->explained_V2, slopes->bend_V);
    innovation->variance_V2 = innovation->explained_V2 + innovation->single_V2;
    innovation->of_offset_V = 0.0f;
    innovation->bias_V = 0.0f;
    /* What is believed of an offset has moved the drop, too; what is not known of it may have. */
    const float dropped_V = dropped_by_offset(c, x, p);
    innovation->of_offset_V = (slopes->slope_V * x->reach) + dropped_V;
    innovation->bias_V = x->believed * innovation->of_offset_V;
    innovation->voltage_V = innovation->voltage_V + (x->believed * dropped_V);
    innovation->variance_V2 = innovation->variance_V2 +
        ((innovation->of_offset_V * innovation->of_offset_V) * x->unsure);
    innovation->slope_V = slopes->slope_V;
}

#endif
