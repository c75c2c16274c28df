/* Part of cellwise_ekf.c. What a measured voltage does: refused, weighed, used. Printed from src/cellwise/estimate
 * by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_CORRECTION_H
#define CELLWISE_CORRECTION_H

#include "cellwise_innovation.h"

/* CW-008. A voltage beyond the gate, and what follows too long a time of them in a row. With CELLWISE_BANK the state
 * asks for a bank, which begins again over all of the SOC. */
static uint32_t reject(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p, float seen)
{
    uint32_t status = CELLWISE_INNOVATION_REJECTED;
    x->rejections = x->rejections + 1u;
    if (x->rejections >= c->recovery_after) {
        status = status | CELLWISE_GATE_RECOVERY;
        x->rejections = 0u;
        x->mismatch = 1.0f;
        x->contradicted = 0.0f;
        x->persistent = 0.0f;
        x->in_bank = CONTRADICTED;
        x->evidence = FIRST_VOLTAGE;
        open_up(c, x, p, seen);
        forget_offset(x);
    }
    return status;
}

/* What the voltages say against the count. Beyond the model's data they confirm nothing. */
static void contradict(const cellwise_constants *c, cellwise_state *x, const cellwise_slopes *w,
                       const cellwise_reading *s, float one_V2, float innovation)
{
    const float drift = c->drift_soc * (float)(x->evidence - FIRST_VOLTAGE);
    const float now = contradicted_step(x->contradicted, innovation, w->slope_V, one_V2, drift, c->contradicted_share);
    if (SIZE_WITHIN(now, 1.0f)) { /* a number */
        uint32_t beyond = 0u;
        if (magnitude(now) < magnitude(x->contradicted)) {
            beyond = outside(c, x, s);
        }
        if (beyond == 0u) {
            x->contradicted = now;
        }
    }
}

/* SOC error by a persistent error of the model, after a voltage with a gain. */
static void persist(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p, float slope_V, float gain)
{
    const float error_V = persistent_V(c->persistent, p->noise_V2 - c->fixed_V2, x->mismatch);
    float now = persistent_step(gain, slope_V, x->persistent, error_V);
    if (!SIZE_WITHIN(now, 1.0f)) {
        now = 1.0f;
    }
    x->persistent = now;
}

/* State and covariance after a voltage within the gate. What the innovations have lately shown beyond their variance
 * makes evidence weigh less. A first sample under load says more of the load than of the SOC. */
static void fuse(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p, const cellwise_slopes *w,
                 const cellwise_reading *s, const cellwise_innovation *i, float innovation)
{
    cellwise_shared shared;
    shared_by(c, x, s->seen, &shared);
    const float weight = as_shown(i->one_V2 * shared.above, x->mismatch);
    if ((s->news == INTERVAL) || (shared.above <= shared.below)) {
        const float inverse = inverse_weight(i->explained_V2, weight, shared.below);
        cellwise_column k;
        scaled(&i->column, inverse, &k);
        move(x, &k, innovation);
        narrow(x, &k, &i->column);
        persist(c, x, p, w->slope_V, k.s);
        if ((s->news == INTERVAL) && (x->evidence >= FIRST_VOLTAGE)) {
            contradict(c, x, w, s, i->one_V2, innovation);
        }
        ask_for_offset(x, i, innovation, k.s, inverse);
    }
    x->rejections = 0u;
    if (x->evidence < FIRST_VOLTAGE) {
        x->evidence = FIRST_VOLTAGE;
    }
}

/* A voltage to a component of a bank: none is rejected, each moves by what the gate lets pass. The variance of a
 * voltage is that of the likeliest component, for all: one whose tables state a larger error must not explain
 * everything. */
static void use_in_bank(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                        const cellwise_slopes *w, const cellwise_reading *s, const cellwise_innovation *i,
                        float innovation)
{
    if (!(x->error_V2 > 0.0f)) {
        x->error_V2 = i->one_V2;
    }
    cellwise_shared shared;
    shared_by(c, x, s->seen, &shared);
    const float weight = as_shown(x->error_V2 * shared.above, x->mismatch);
    if ((s->news == INTERVAL) || (shared.above <= shared.below)) {
        const float share = evidence_share(c->fades, c->stays, c->shared, steps_of_evidence(x));
        cellwise_componentupdate used;
        component_update(innovation, i->variance_V2, c->gate_square, i->explained_V2, weight, shared.below, share,
                         &used);
        x->cost = x->cost + used.cost;
        cellwise_column k;
        scaled(&i->column, used.inverse, &k);
        move(x, &k, used.off_V);
        narrow(x, &k, &i->column);
        persist(c, x, p, w->slope_V, k.s);
        ask_for_offset(x, i, used.off_V, k.s, used.inverse);
    }
    if (x->evidence < FIRST_VOLTAGE) {
        x->evidence = FIRST_VOLTAGE;
    }
}

/* A voltage that is looked at: rejected, or used. */
static uint32_t weigh(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                      const cellwise_slopes *w, const cellwise_reading *s, const cellwise_innovation *i,
                      float innovation)
{
    const float square = innovation * innovation;
    const float most = c->gate_square * i->variance_V2;
    uint32_t status = 0u;
    if (x->in_bank == COMPONENT) {
        use_in_bank(c, x, p, w, s, i, innovation);
    } else {
        if (s->news == INTERVAL) {
            const float own_V2 = i->explained_V2 + i->one_V2;
            const float ratio = at_most(square / own_V2, c->mismatch_cap);
            x->mismatch = lately_shown(x->mismatch, ratio, c->lately);
        }
        if (POSITIVE_ABOVE(square, most)) {
            status = reject(c, x, p, s->seen);
        } else {
            fuse(c, x, p, w, s, i, innovation);
        }
    }
    return status;
}

/* CW-002. Predicted voltage, innovation, and what follows from it. */
static uint32_t correct(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                        const cellwise_slopes *w, const cellwise_reading *s, float voltage, cellwise_output *out)
{
    uint32_t status = 0u;
    uint32_t away = x->no_voltage;
    if ((s->news == INTERVAL) && (away < COUNT_MOST)) {
        away = away + 1u;
    }
    cellwise_innovation i;
    innovate(c, x, p, w, s, &i);
    out->voltage_V = i.voltage_V;
    out->innovation_variance_V2 = i.variance_V2;
    out->innovation_V = 0.0f;
    if (!POSITIVE_WITHIN(voltage, c->voltage_low_V, c->voltage_high_V)) {
        status = CELLWISE_VOLTAGE_INVALID | out_of_range(voltage);
    } else {
        const float innovation = voltage - i.voltage_V;
        out->innovation_V = innovation;
        if (s->news != REPEATED) { /* a repeated sample is no evidence */
            watch_current(c, x, voltage);
            status = watch_voltage(c, x, voltage, s->seen, p->r0_ohm, innovation);
            if (status == 0u) {
                away = 0u;
            }
            if (status == 0u) {
                status = weigh(c, x, p, w, s, &i, innovation);
            }
        }
    }
    if (s->news != REPEATED) {
        x->no_voltage = away;
    }
    if (away > c->hold_steps) {
        status = status | CELLWISE_VOLTAGE_LOST;
    }
    return status;
}

#endif
