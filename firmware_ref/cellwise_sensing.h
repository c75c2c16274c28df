/* Part of cellwise_ekf.c. What a sample means: numbers missing, currents and voltages that are invalid. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_SENSING_H
#define CELLWISE_SENSING_H

#include "cellwise_state.h"

/* A sample as the filter takes it. `news` says whether it ends an interval, `missing` how many were left out,
 * `silent` for how many steps there was no current that could be used. `current` is the one that is held,
 * `delayed_current_A` the one that the voltage has seen, `counted_current_A` the one whose charge is counted. */
typedef struct {
    uint32_t status;
    uint32_t news;
    uint32_t missing;
    uint32_t silent;
    float current;
    float delayed_current_A;
    float counted_current_A;
    float unmeasured_A2;
    float temperature_C;
} cellwise_reading;

/* What an interval took: samples missing, and the current that bridges them. */
typedef struct {
    uint32_t status;
    uint32_t missing;
    float bridge;
} cellwise_charge;

/* CW-001, CW-004, CW-005. Sequence number, current and temperature of a sample; the status `before` with theirs. */
static void see(const cellwise_constants *c, cellwise_state *x, const cellwise_input *sample, uint32_t before,
                cellwise_reading *reading)
{
    reading->status = before;
    reading->news = NO_INTERVAL;
    reading->missing = 0u;
    reading->silent = 0u;
    reading->current = sample->current_A;
    reading->unmeasured_A2 = 0.0f;
    /* The first sample ends no interval; a sequence number that was taken before ends none either. */
    if (x->evidence != NOT_BEGUN) {
        const uint32_t elapsed = sample->sequence - x->sequence;
        if (elapsed == 0u) {
            reading->news = REPEATED;
            reading->status = reading->status | CELLWISE_DUPLICATE;
        } else {
            reading->news = INTERVAL;
            reading->missing = elapsed - 1u;
        }
    }
    if (!SIZE_WITHIN(reading->current, c->current_limit_A)) {
        reading->status = (reading->status | CELLWISE_CURRENT_INVALID) | out_of_range(reading->current);
        reading->silent = 1u;
    }
    if ((reading->silent != 0u) || (reading->news == REPEATED)) {
        reading->current = x->current_A;
    }
    if (!is_same(reading->current, x->current_A)) {
        x->swings = 0.0f;
    } else if (is_dead(x->swings)) {
        reading->status = reading->status | CELLWISE_CURRENT_INVALID;
        reading->silent = 1u;
    } else { /* as before */
    }
    reading->temperature_C = 0.0f;
    if (!WITHIN(sample->temperature_C, COLDEST_C, HOTTEST_C)) {
        reading->status = reading->status | CELLWISE_TEMPERATURE_INVALID;
    } else if (reading->news != REPEATED) {
        x->temperature_C = sample->temperature_C;
    } else { /* as before */
    }
    reading->temperature_C = x->temperature_C + x->heat_K;
    reading->delayed_current_A = reading->current;
    if (reading->news == INTERVAL) {
        reading->delayed_current_A = reading->current + (c->skew_share * (x->current_A - reading->current));
    }
    reading->counted_current_A = reading->delayed_current_A;
    /* Held for a while; then whatever was held is no guide any more: nothing is counted, and as much as half a rate
     * may flow either way. */
    if ((reading->silent != 0u) || (reading->news == REPEATED)) {
        reading->silent = x->no_current;
        if ((reading->news == INTERVAL) && (reading->silent < COUNT_MOST)) {
            reading->silent = reading->silent + 1u;
        }
    }
    if (reading->silent > c->hold_steps) {
        reading->status = reading->status | CELLWISE_CURRENT_LOST;
        reading->delayed_current_A = 0.0f;
        reading->counted_current_A = 0.0f;
        reading->unmeasured_A2 = c->lost_A2;
    }
}

/* CW-003. SOC over the interval that ends now: charge comes first, then the branches at the new SOC. */
static void count_charge(const cellwise_constants *c, cellwise_state *x, const cellwise_reading *reading,
                         cellwise_charge *charge)
{
    charge->status = reading->status;
    charge->missing = reading->missing;
    charge->bridge = 0.0f;
    if (reading->news == INTERVAL) {
        float used = taken(c, x, reading->counted_current_A);
        if (charge->missing != 0u) {
            charge->status = charge->status | CELLWISE_SEQUENCE_GAP;
            if (charge->missing <= c->gap_steps) {
                charge->bridge = 0.5f * (reading->current + x->current_A);
                if (reading->silent > c->hold_steps) {
                    charge->bridge = 0.0f;
                }
                used = used + (taken(c, x, charge->bridge) * (float)charge->missing);
            } else { /* nobody knows what flowed; self-discharge goes on */
                charge->missing = (charge->missing < LONGEST_GAP) ? charge->missing : LONGEST_GAP;
                if (x->in_bank == ALONE) {
                    x->in_bank = UNCOUNTED;
                }
                const float lost = (c->leak_soc * (float)charge->missing) * x->per_capacity;
                used = used + lost;
            }
        }
        add(&x->soc, &x->soc_carry, -used);
        if (reading->unmeasured_A2 > 0.0f) {
            x->ss = drifted_variance(x->ss, c->lost_soc);
            if (x->in_bank == ALONE) {
                x->in_bank = UNCOUNTED;
            }
        }
    }
}

/* Samples are missing: the branches may hold what the currents on both sides can have left. With CELLWISE_WIDE they
 * relax towards the mean of these currents, too. Returns the variance of SOC that the voltage is asked for: of what
 * has flowed unseen, and beyond the tangent's reach. */
static float cross_gap(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p, uint32_t missing,
                       float current, float bridge)
{
    const float unknown_A2 = (current * current) + (x->current_A * x->current_A);
    const float steps = (float)missing;
    float spread = c->gap_variance;
    const float moved = c->soc_per_A * steps;
    if (missing <= c->gap_steps) {
        spread = (moved * moved) * unknown_A2;
    } else {
        spread = unseen_variance(c->gap_variance, unknown_A2, c->lost_A2, moved);
    }
    float unseen = 0.0f;
    const bool asks = (missing > c->gap_steps) && (x->evidence >= FIRST_VOLTAGE);
    if (!asks || (x->in_bank == COMPONENT)) {
        x->ss = x->ss + spread;
    } else {
        unseen = spread;
        if (x->ss > WIDE_VARIANCE) {
            unseen = unseen + (x->ss - WIDE_VARIANCE);
            x->ss = WIDE_VARIANCE;
            forget_correlations(x);
        }
    }
    const float gain1 = risen(steps * p->gain1);
    const float gain2 = risen(steps * p->gain2);
    const float gain3 = risen(steps * p->gain3);
    relax(x, p, gain1, gain2, gain3, bridge, bridge, bridge, unknown_A2);
    forget_hysteresis(x);
    x->heat_K = x->heat_K * vanishing(steps * c->heat_rate);
    return unseen;
}

/* Current that the particles' surface follows: over missing samples what bridges them. */
static void follow(const cellwise_constants *c, cellwise_state *x, const cellwise_reading *reading,
                   const cellwise_charge *charge)
{
    if (charge->missing != 0u) {
        const float left = vanishing((float)charge->missing * c->surface_rate);
        x->slow_A = charge->bridge + (left * (x->slow_A - charge->bridge));
    }
    if (reading->news == INTERVAL) {
        x->slow_A = x->slow_A + (c->surface_gain * (reading->counted_current_A - x->slow_A));
    }
}

/* What is stated of the SOC beside P's variance `known`; LARGE where it is no number. */
static float variance_of(const cellwise_state *x, float known)
{
    const float sure = known + ((x->reach * x->reach) * x->unsure);
    const float stated = stated_variance(sure, x->mismatch, x->persistent, x->contradicted);
    return NOT_NEGATIVE(stated, LARGE) ? stated : LARGE;
}

/* CW-007. Hold SOC within its bounds, remember the sample: the status of the clamp. A variance that memory which
 * lost a bit has driven below zero is none: this step knows nothing, and the next one re-initialises the state. */
static uint32_t finish(cellwise_state *x, const cellwise_reading *reading, uint32_t missing, uint32_t sequence,
                       cellwise_output *out)
{
    uint32_t status = 0u;
    if (!NOT_NEGATIVE(x->soc, 1.0f)) {
        x->soc = within_one(x->soc);
        x->soc_carry = 0.0f;
        status = CELLWISE_CLAMPED;
    }
    if (reading->news != REPEATED) {
        x->current_A = reading->current;
        x->sequence = sequence;
        x->no_current = reading->silent;
        if ((reading->news == INTERVAL) && ((x->evidence - FIRST_VOLTAGE) < EVIDENCE_MOST)) {
            x->evidence = (x->evidence + 1u) + missing;
        }
    }
    out->soc = x->soc;
    out->soc_variance = NOT_NEGATIVE(x->ss, LARGE) ? x->ss : KNOW_NOTHING_VARIANCE;
    out->soc_variance = variance_of(x, out->soc_variance);
    return status;
}

#endif
