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

/* CW-010. How often the voltage has gone up and down under a current that repeats itself. */
static void watch_current(const cellwise_constants *c, cellwise_state *x, float voltage)
{
    if (x->evidence >= FIRST_VOLTAGE) {
        x->swings = swings_after(x->swings, voltage - x->voltage_V, c->frozen_V);
    }
}

/* CW-009. Whether the voltage is frozen: CELLWISE_VOLTAGE_FROZEN, or 0. */
static uint32_t watch_voltage(const cellwise_constants *c, cellwise_state *x, float voltage, float seen, float r0_ohm,
                              float innovation)
{
    cellwise_heldvoltage now;
    repeats_after(x->voltage_V, x->frozen_A, x->repeats, voltage, seen, r0_ohm, innovation, c->frozen_V, &now);
    x->voltage_V = now.voltage_V;
    x->frozen_A = now.since_A;
    x->repeats = now.repeats;
    return (now.repeats >= FOUND_FROZEN) ? CELLWISE_VOLTAGE_FROZEN : 0u;
}

/* Steps since the first voltage, or since a recovery. */
static float steps_of_evidence(const cellwise_state *x)
{
    uint32_t since = 0u;
    if (x->evidence >= FIRST_VOLTAGE) {
        since = x->evidence - FIRST_VOLTAGE;
        since = (since < EVIDENCE_MOST) ? since : EVIDENCE_MOST;
    }
    return (float)since;
}

/* How many samples share one model error; the first voltage at rest stands alone. */
static void shared_by(const cellwise_constants *c, const cellwise_state *x, float seen, cellwise_shared *shared)
{
    const float since = steps_of_evidence(x);
    const bool alone = (x->evidence < FIRST_VOLTAGE) && SIZE_BELOW(seen, c->rest_A);
    shared_evidence(c->shared, c->shared_early, c->shared_half, since, 1.0f, alone, shared);
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
    float share = c->share_per_A * distance_beyond(seen, c->valid_charge_A, c->valid_discharge_A);
    float moved_V = 0.0f;
    const float far_K = distance_beyond(x->temperature_C, c->valid_cold_C, c->valid_warm_C);
    share = share + exponential_rise(c->share_per_K * far_K);
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
    const float current_A2 = c->current_variance_A2 + s->unmeasured_A2;
    innovation->one_V2 = voltage_variance(p->noise_V2, share, innovation->polarisation_V, current_A2, p->r0_ohm);
    const float beyond_V = extrapolated(c, x, s->seen, innovation->polarisation_V);
    innovation->one_V2 = innovation->one_V2 + (beyond_V * beyond_V);
    column_of(x, p, w->slope_V, &innovation->column);
    innovation->explained_V2 = bent_variance(innovation->column.variance, w->bend_V);
    innovation->variance_V2 = innovation->explained_V2 + innovation->one_V2;
}

#endif
