/* Part of cellwise_ekf.c. What a measured voltage does: refused, weighed, used. Printed from src/cellwise/estimate
 * by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_CORRECTION_H
#define CELLWISE_CORRECTION_H

#include "cellwise_innovation.h"

/* After too long a time of rejected voltages in a row: the SOC is open. With CELLWISE_BANK the state asks for a
 * bank, which begins again over all of the SOC. */
static void recover(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p, float delayed_current_A)
{
    x->contradicted = 0.0f;
    x->persistent = 0.0f;
    x->in_bank = CONTRADICTED;
    x->evidence = FIRST_VOLTAGE;
    open_up(c, x, p, delayed_current_A);
    forget_offset(x);
}

/* What the voltages say against the count. Beyond the model's data they confirm nothing. */
static void contradict(const cellwise_constants *c, cellwise_state *x, const cellwise_innovation *innovation,
                       float innovation_V, uint32_t beyond)
{
    const float now = contradicted_after(c, x, innovation, innovation_V, time_of_evidence(x));
    const bool confirms = (beyond != 0u) && (magnitude(now) < magnitude(x->contradicted));
    if (SIZE_WITHIN(now, 1.0f) && !confirms) { /* a number */
        x->contradicted = now;
    }
}

/* SOC error by a persistent error of the model, after a voltage with a gain. */
static void persist(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                    const cellwise_innovation *innovation, float gain)
{
    float now = persistent_after(c, x, innovation, p->noise_V2 - c->fixed_V2, x->mismatch, gain);
    if (!SIZE_WITHIN(now, 1.0f)) {
        now = 1.0f;
    }
    x->persistent = now;
}

/* State and covariance after a voltage, by one over the variance that weighs it. */
static void fuse(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                 const cellwise_innovation *innovation, float innovation_V, float inverse)
{
    cellwise_column gain;
    scaled(&innovation->column, inverse, &gain);
    move(x, &gain, innovation_V);
    narrow(x, &gain, &innovation->column);
    persist(c, x, p, innovation, gain.s);
    ask_for_offset(x, innovation, innovation_V, gain.s, inverse);
}

/* A voltage has been used. */
static void begin_evidence(cellwise_state *x)
{
    if (x->evidence < FIRST_VOLTAGE) {
        x->evidence = FIRST_VOLTAGE;
    }
}

/* A voltage that is looked at: rejected, or used. A first sample under load says more of the load than of the SOC. */
static uint32_t weigh(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                      const cellwise_reading *reading, const cellwise_innovation *innovation, float innovation_V,
                      uint32_t beyond)
{
    uint32_t status = 0u;
    if (x->in_bank == COMPONENT) { /* its components use it */
        begin_evidence(x);
    } else {
        const float lately = (reading->news == INTERVAL) ? c->lately : 0.0f;
        cellwise_verdict verdict;
        judge(c, x, innovation, innovation_V, lately, 1u, &verdict);
        status = verdict.status;
        x->rejections = verdict.rejections;
        x->mismatch = verdict.mismatch;
        if (verdict.accepted) {
            cellwise_shared shared;
            shared_by(c, x, reading->delayed_current_A, &shared);
            if ((reading->news == INTERVAL) || (shared.above <= shared.below)) {
                fuse(c, x, p, innovation, innovation_V, weight_of(innovation, verdict.shown, verdict.unit, &shared));
                contradict(c, x, innovation, innovation_V, beyond);
            }
            begin_evidence(x);
        } else if (verdict.recovers) {
            recover(c, x, p, reading->delayed_current_A);
        } else { /* as before */
        }
    }
    return status;
}

/* SOC's variance of what has flowed unseen, as far as a voltage shows it, at most `unseen`. The likeliest one (of
 * greatest likelihood): a voltage that is off by no more than `known_V2` says that nothing has flowed, and takes
 * nothing away from what is known of the SOC. */
static float shown_unseen(float unseen, float off_V, float known_V2, float slope_V)
{
    const float beyond_V2 = (off_V * off_V) - known_V2;
    const float slope2 = slope_V * slope_V;
    float shown = unseen;
    if (!(beyond_V2 > 0.0f)) {
        shown = 0.0f;
    } else if (beyond_V2 < (unseen * slope2)) {
        shown = beyond_V2 / slope2;
    } else { /* as before */
    }
    return shown;
}

/* The variance that a voltage has shown is the SOC's; the rest of it is stated beside P. */
static void open_up_to(cellwise_state *x, float unseen, float shown)
{
    x->ss = x->ss + shown;
    x->persistent = root((x->persistent * x->persistent) + (unseen - shown));
}

/* CW-002. Predicted voltage, innovation, and what follows from it. Of the variance of what has flowed `unseen` the
 * SOC gets what the voltage shows, or all of it where there is none; this one is weighed without it, so the next
 * ones say how far it moves. */
static uint32_t correct(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                        const cellwise_slopes *slopes, const cellwise_reading *reading, float voltage, uint32_t beyond,
                        float unseen, cellwise_output *out)
{
    uint32_t status = 0u;
    uint32_t away = x->no_voltage;
    if ((reading->news == INTERVAL) && (away < COUNT_MOST)) {
        away = away + 1u;
    }
    float shown = unseen;
    cellwise_innovation innovation;
    innovate(c, x, p, slopes, reading, &innovation);
    out->voltage_V = innovation.voltage_V;
    out->innovation_variance_V2 = innovation.variance_V2;
    out->innovation_V = 0.0f;
    if (!POSITIVE_WITHIN(voltage, c->voltage_low_V, c->voltage_high_V)) {
        status = CELLWISE_VOLTAGE_INVALID | out_of_range(voltage);
    } else {
        const float innovation_V = voltage - innovation.voltage_V;
        out->innovation_V = innovation_V;
        if (reading->news != REPEATED) { /* a repeated sample is no evidence */
            watch_current(c, x, voltage);
            status = watch_voltage(c, x, voltage, reading->delayed_current_A, p->r0_ohm, innovation_V);
            if (status == 0u) {
                away = 0u;
            }
            if (status == 0u) {
                if (unseen > 0.0f) {
                    const float known_V2 = as_shown(innovation.variance_V2, x->mismatch);
                    shown = shown_unseen(unseen, innovation_V, known_V2, innovation.slope_V);
                }
                status = weigh(c, x, p, reading, &innovation, innovation_V, beyond);
            }
        }
    }
    if (unseen > 0.0f) {
        open_up_to(x, unseen, shown);
    }
    if (reading->news != REPEATED) {
        x->no_voltage = away;
    }
    if (away > c->hold_steps) {
        status = status | CELLWISE_VOLTAGE_LOST;
    }
    return status;
}

#endif
