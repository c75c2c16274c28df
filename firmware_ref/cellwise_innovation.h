/* Part of cellwise_ekf.c. What a measured voltage is expected to be, and how far it may be off. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_INNOVATION_H
#define CELLWISE_INNOVATION_H

#include "cellwise_sensing.h"

/* The voltage that the state gives at a point of the tables. */
static float voltage_of(const cellwise_state *x, const cellwise_point *p, float drop)
{
    const float voltage = ((((p->ocv_V - drop) - x->v1_V) - x->v2_V) - x->v3_V) + (p->m_V * x->h);
    return voltage;
}

/* The gate may have locked the truth out: anything is admitted, and the next voltage passes. */
static void widen(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p, float seen)
{
    x->ss = RECOVERY_VARIANCE;
    x->evidence = FIRST_VOLTAGE;
    guess_branches(c, x, p, seen);
}

/* What the state says of the next voltage, before it is looked at. `variance_V2` is that of a single innovation,
 * `explained_V2` what the state and `one_V2` what the voltage brings to it; `polarisation_V` how much of the voltage
 * is current's doing. */
typedef struct {
    float voltage_V;
    float variance_V2;
    float explained_V2;
    float one_V2;
    float polarisation_V;
    cellwise_column column;
} cellwise_innovation;

/* How many samples share one model error: `above / below`, never divided. */
typedef struct {
    float above;
    float below;
} cellwise_shared;

/* CW-010. How often the voltage has gone up and down under a current that repeats itself. A constant current moves a
 * voltage one way. Where it goes both ways by as much as would call a voltage frozen, nobody measures the current. */
static void watch_current(const cellwise_constants *c, cellwise_state *x, float voltage)
{
    const float moved = voltage - x->voltage_V;
    if (!SIZE_WITHIN(moved, c->frozen_V) && !((x->swings * moved) > 0.0f)) {
        float count = magnitude(x->swings) + 1.0f;
        count = (count < SWINGS_MOST) ? count : SWINGS_MOST;
        x->swings = (moved > 0.0f) ? count : -count;
    }
}

/* CW-009. Whether the voltage is frozen. A reading that repeats itself, but for its last digits, is frozen once R0
 * times the change of current says that it must have moved, and the prediction is off by half of that: a held
 * voltage repeats itself, too, but the model expects it there. It stays frozen until it changes. */
static uint32_t watch_voltage(const cellwise_constants *c, cellwise_state *x, float voltage, float seen, float r0_ohm,
                              float innovation)
{
    uint32_t status = 0u;
    if (!SIZE_WITHIN(voltage - x->voltage_V, DITHER_V)) {
        x->voltage_V = voltage;
        x->frozen_A = seen;
        x->repeats = 0u;
    } else if (x->repeats == FROZEN) {
        status = CELLWISE_VOLTAGE_FROZEN;
    } else {
        const float moved = magnitude(r0_ohm * (seen - x->frozen_A));
        const bool off = magnitude(innovation) > (0.5f * moved);
        if (x->repeats < COUNT_MOST) {
            x->repeats = x->repeats + 1u;
        }
        if ((x->repeats >= FROZEN_READINGS) && (moved > c->frozen_V) && off) {
            x->repeats = FROZEN;
            status = CELLWISE_VOLTAGE_FROZEN;
        }
    }
    return status;
}

/* How many samples share one model error, as a fraction: at least 1. The model's error is a sum of processes with
 * memories of a second to half an hour. The quick ones average out first, so the rest of a mean has an ever longer
 * memory. The first voltage at rest is evidence by itself. */
static void shared_by(const cellwise_constants *c, const cellwise_state *x, float seen, cellwise_shared *shared)
{
    uint32_t seen_before = 0u;
    if (x->evidence >= FIRST_VOLTAGE) {
        seen_before = x->evidence - FIRST_VOLTAGE;
        seen_before = (seen_before < EVIDENCE_MOST) ? seen_before : EVIDENCE_MOST;
    }
    const float since = (float)seen_before;
    shared->below = since + c->shared_half;
    shared->above = shared->below;
    if ((x->evidence >= FIRST_VOLTAGE) || !SIZE_BELOW(seen, c->rest_A)) {
        shared->above = (c->shared * since) + c->shared_early;
    }
}

/* CW-018. Whether SOC, current or temperature is beyond the model's data: CELLWISE_OUTSIDE, or 0. */
static uint32_t outside(const cellwise_constants *c, const cellwise_state *x, const cellwise_reading *s)
{
    uint32_t status = 0u;
    if (!WITHIN(x->soc, c->valid_soc_low, c->valid_soc_high)) {
        status = CELLWISE_OUTSIDE;
    }
    if (!WITHIN(s->seen, c->valid_charge_A, c->valid_discharge_A)) {
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
static float extrapolated(const cellwise_constants *c, const cellwise_state *x, float seen, float polarisation_V)
{
    const float far_A = at_least(c->valid_charge_A - seen, seen - c->valid_discharge_A);
    float share = c->share_per_A * at_least(far_A, 0.0f);
    float moved_V = 0.0f;
    float far_K = at_least(c->valid_cold_C - x->temperature_C, x->temperature_C - c->valid_warm_C);
    far_K = at_least(far_K, 0.0f);
    const float z = c->share_per_K * far_K;
    share = share + (z * (1.0f + (z * (0.5f + (z * SIXTH)))));
    moved_V = c->voltage_per_K * far_K;
    return (share * polarisation_V) + moved_V;
}

/* Predicted voltage, and the variances of what is measured about it. */
static void innovate(const cellwise_constants *c, const cellwise_state *x, const cellwise_point *p,
                     const cellwise_slopes *w, const cellwise_reading *s, cellwise_innovation *innovation)
{
    const float drop = p->r0_ohm * s->seen;
    innovation->polarisation_V = ((magnitude(drop) + magnitude(x->v1_V)) + magnitude(x->v2_V)) + magnitude(x->v3_V);
    innovation->voltage_V = voltage_of(x, p, drop);
    const float share = (s->seen >= 0.0f) ? c->share_variance : c->charge_variance;
    innovation->one_V2 = p->noise_V2 +
        ((share * (innovation->polarisation_V * innovation->polarisation_V)) +
         ((c->current_variance_A2 + s->unmeasured_A2) * (p->r0_ohm * p->r0_ohm)));
    const float beyond_V = extrapolated(c, x, s->seen, innovation->polarisation_V);
    innovation->one_V2 = innovation->one_V2 + (beyond_V * beyond_V);
    /* An OCV that bends by c at one standard deviation is off its tangent by c z^2. */
    column_of(x, p, w->slope_V, &innovation->column);
    innovation->explained_V2 = innovation->column.variance + (3.0f * (w->bend_V * w->bend_V));
    innovation->variance_V2 = innovation->explained_V2 + innovation->one_V2;
}

#endif
