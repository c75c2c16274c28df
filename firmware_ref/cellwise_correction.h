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
        widen(c, x, p, seen);
    }
    return status;
}

/* Running mean of the SOC that the voltages say is missing, as far as the count may be off. Were the current off,
 * the count would by now be off by `drift`, and of an innovation the part that this explains would be the count's.
 * It widens what is said of the SOC, and nothing else. Beyond the model's data a voltage may contradict the count,
 * but confirms nothing. */
static void contradict(const cellwise_constants *c, cellwise_state *x, const cellwise_slopes *w,
                       const cellwise_reading *s, float one_V2, float innovation)
{
    float drift = c->drift_soc * (float)(x->evidence - FIRST_VOLTAGE);
    drift = (drift < 1.0f) ? drift : 1.0f;
    const float swing_V = (drift * drift) * w->slope_V;
    float missing = (swing_V * innovation) / ((swing_V * w->slope_V) + one_V2);
    missing = clip(missing, -1.0f, 1.0f);
    if (SIZE_WITHIN(missing, 1.0f)) { /* a number */
        const float now = x->contradicted + (c->contradicted_share * (missing - x->contradicted));
        uint32_t beyond = 0u;
        if (magnitude(now) < magnitude(x->contradicted)) {
            beyond = outside(c, x, s);
        }
        if (beyond == 0u) {
            x->contradicted = now;
        }
    }
}

/* SOC error that a persistent error of the model has brought in, after a voltage with a gain. No further voltage
 * averages it out: in the end the SOC is off by that error over the slope. */
static void persist(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p, float slope_V, float gain)
{
    float square = p->noise_V2 - c->fixed_V2;
    if (POSITIVE_ABOVE(x->mismatch, 1.0f)) {
        square = square * x->mismatch;
    }
    const float error_V = c->persistent * root((square < SQUARE_MOST) ? square : SQUARE_MOST);
    const float kept = clip(1.0f - (gain * slope_V), 0.0f, 1.0f);
    float now = (kept * x->persistent) + (gain * error_V);
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
    float weight = i->one_V2 * shared.above;
    if (POSITIVE_ABOVE(x->mismatch, 1.0f)) {
        weight = weight * x->mismatch;
    }
    if ((s->news == INTERVAL) || (shared.above <= shared.below)) {
        const float inverse = shared.below / ((i->explained_V2 * shared.below) + weight);
        move(x, &i->column, inverse, innovation);
        narrow(x, &i->column, inverse);
        persist(c, x, p, w->slope_V, i->column.s * inverse);
        if ((s->news == INTERVAL) && (x->evidence >= FIRST_VOLTAGE)) {
            contradict(c, x, w, s, i->one_V2, innovation);
        }
    }
    x->rejections = 0u;
    if (x->evidence < FIRST_VOLTAGE) {
        x->evidence = FIRST_VOLTAGE;
    }
}

/* How much of a voltage's evidence is new, where a part of the model's error stays for good. What a mean says never
 * exceeds one error over that part, however long it is taken. */
static float evidence_share(const cellwise_constants *c, const cellwise_state *x)
{
    uint32_t since = 0u;
    if (x->evidence > FIRST_VOLTAGE) {
        since = x->evidence - FIRST_VOLTAGE;
    }
    since = (since < EVIDENCE_MOST) ? since : EVIDENCE_MOST;
    const float left = c->fades + (c->stays * (float)since);
    const float share = (c->fades * c->shared) / (left * left);
    return (share < 1.0f) ? share : 1.0f;
}

/* A voltage to a component of a bank: none is rejected, each moves by what the gate lets pass. Beyond that it speaks
 * against a component in proportion to how far it is off (Huber): below empty the lowest of them is the nearest. The
 * variance of a voltage is that of the likeliest component, for all: one whose tables state a larger error must not
 * explain everything. What a voltage says against a component counts as often as it moves the state: samples that
 * share one error of the model are one. */
static void use_in_bank(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                        const cellwise_slopes *w, const cellwise_reading *s, const cellwise_innovation *i,
                        float innovation)
{
    if (!(x->error_V2 > 0.0f)) {
        x->error_V2 = i->one_V2;
    }
    cellwise_shared shared;
    shared_by(c, x, s->seen, &shared);
    float weight = x->error_V2 * shared.above;
    if (POSITIVE_ABOVE(x->mismatch, 1.0f)) {
        weight = weight * x->mismatch;
    }
    if ((s->news == INTERVAL) || (shared.above <= shared.below)) {
        float off = innovation;
        const float most = c->gate_square * i->variance_V2;
        const float square = off * off;
        float grows = 1.0f;
        if (POSITIVE_ABOVE(square, most)) {
            const float passed = at_least(root(most / square), LEAST_PASSED);
            off = off * passed;
            grows = (2.0f / passed) - 1.0f;
        }
        const float explained = i->explained_V2 * shared.below;
        const float inverse = shared.below / (explained + weight);
        const float against = (grows * ((off * off) * inverse)) + log_of_more(explained / weight);
        x->cost = x->cost + (evidence_share(c, x) * (0.5f * against));
        move(x, &i->column, inverse, off);
        narrow(x, &i->column, inverse);
        persist(c, x, p, w->slope_V, i->column.s * inverse);
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
            float ratio = square / i->variance_V2;
            ratio = (ratio < c->mismatch_cap) ? ratio : c->mismatch_cap;
            x->mismatch = x->mismatch + (c->lately * (ratio - x->mismatch));
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
