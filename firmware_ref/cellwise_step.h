/* Part of cellwise_ekf.c. A start and one step. Printed from src/cellwise/estimate by `python -m cellwise.printing`;
 * do not edit. */
#ifndef CELLWISE_STEP_H
#define CELLWISE_STEP_H

#include "cellwise_correction.h"

/* As `init`, for the estimate of a bank, too. */
static uint32_t begin_at(const cellwise_model *m, cellwise_state *x, float soc, float soc_variance)
{
    const float positive = soc + 0.0f; /* never -0 */
    uint32_t status = 0u;
    const bool known = POSITIVE_WITHIN(soc_variance, VARIANCE_FLOOR, SOC_VARIANCE_MOST);
    if (NOT_NEGATIVE(positive, 1.0f) && known) {
        start(&m->constant, x, positive, soc_variance);
    } else {
        start(&m->constant, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE);
        status = CELLWISE_STATE_RESET;
    }
    return status;
}

uint32_t cellwise_init(const cellwise_model *m, cellwise_state *x, float soc, float soc_variance)
{
    return begin_at(m, x, soc, soc_variance);
}

uint32_t cellwise_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *sample, cellwise_output *out)
{
    const cellwise_constants *const c = &m->constant;
    uint32_t status = 0u;
    if (!is_sound(c, x)) {
        start(c, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE);
        status = CELLWISE_STATE_RESET;
        x->in_bank = CONTRADICTED;
    }
    cellwise_reading reading;
    see(c, x, sample, status, &reading);
    cellwise_place place;
    place_of(m, reading.temperature_C, &place);
    cellwise_charge charge;
    count_charge(c, x, &reading, &charge);
    follow(c, x, &reading, &charge);
    under_surface(c, x, &place, reading.temperature_C, &place);
    aged(x, &place, &place);
    cellwise_point p;
    look_up(m, &place, x->soc, reading.delayed_current_A, &p);
    if (x->evidence == NOT_BEGUN) {
        guess_branches(c, x, &p, reading.delayed_current_A);
        x->evidence = NO_VOLTAGE_YET;
    }
    float unseen = 0.0f;
    if (charge.missing != 0u) {
        unseen = cross_gap(c, x, &p, charge.missing, reading.current, charge.bridge);
    }
    cellwise_slopes slopes;
    no_slopes(&p, &slopes);
    if ((x->ss > WIDE_VARIANCE) && !(x->in_bank == COMPONENT)) {
        slopes_of(m, &place, x->soc, root(x->ss), reading.delayed_current_A, &p, &slopes);
    }
    if (reading.news == INTERVAL) {
        predict(c, x, &p, &slopes, reading.counted_current_A, reading.unmeasured_A2);
        heat(c, x, p.r0_ohm, reading.delayed_current_A, reading.counted_current_A);
        count_offset(c, x, &p, &reading, charge.missing);
    }
    const uint32_t beyond = outside(c, x, &reading);
    status = charge.status | correct(c, x, &p, &slopes, &reading, sample->voltage_V, beyond, unseen, out);
    status = status | finish(x, &reading, charge.missing, sample->sequence, out);
    status = status | beyond;
    out->status = status;
    return status;
}

/* The estimate over an interval, and the voltage it expects, which moves the components. */
static uint32_t coast(const cellwise_model *m, cellwise_state *x, const cellwise_input *sample, cellwise_output *out)
{
    x->in_bank = COMPONENT;
    return cellwise_step(m, x, sample, out);
}

#endif
