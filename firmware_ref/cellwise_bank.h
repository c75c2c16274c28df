/* Part of cellwise_ekf.c. A bank's memory, its start, its step. Printed from src/cellwise/estimate by `python -m
 * cellwise.printing`; do not edit. */
#ifndef CELLWISE_BANK_H
#define CELLWISE_BANK_H

#include "cellwise_spread.h"

/* Whether nobody knows what flowed, one filter is not enough, and a voltage is there. */
static bool is_lost(const cellwise_state *x)
{
    bool lost = false;
    if ((x->in_bank == UNCOUNTED) && (x->evidence >= FIRST_VOLTAGE) && (x->no_voltage == 0u)) {
        lost = x->ss > SPREAD_VARIANCE;
    }
    return lost;
}

/* The numbers of a block in their range. */
static bool is_block_sound(cellwise_bank *b)
{
    bool good = SIZE_WITHIN(b->off_V, LARGE) && SIZE_WITHIN(b->block_A, LARGE);
    if (!SIZE_WITHIN(b->soc, LARGE)) {
        good = false;
    }
    if (!SIZE_WITHIN(b->v1_V, LARGE)) {
        good = false;
    }
    if (!SIZE_WITHIN(b->v2_V, LARGE)) {
        good = false;
    }
    if (!SIZE_WITHIN(b->v3_V, LARGE)) {
        good = false;
    }
    if (!SIZE_WITHIN(b->h, LARGE)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->first_V2, SINCE_MOST)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->ss, LARGE) || !NOT_NEGATIVE(b->unknown_A2, LARGE)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->steps, SINCE_MOST) || !NOT_NEGATIVE(b->samples, SINCE_MOST)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->readings, SINCE_MOST)) {
        good = false;
    }
    return good;
}

/* Those of the block that the components follow. */
static bool is_past_block_sound(cellwise_bank *b)
{
    bool good = SIZE_WITHIN(b->moved, LARGE) && NOT_NEGATIVE(b->grown, LARGE);
    if (!NOT_NEGATIVE(b->gain1, 1.0f) || !SIZE_WITHIN(b->current1, LARGE)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->gain2, 1.0f) || !SIZE_WITHIN(b->current2, LARGE)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->gain3, 1.0f) || !SIZE_WITHIN(b->current3, LARGE)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->square_A2, LARGE) || !NOT_NEGATIVE(b->lately, 1.0f)) {
        good = false;
    }
    if (!(NOT_NEGATIVE(b->keep_h, 1.0f) && SIZE_WITHIN(b->rise_h, LARGE))) {
        good = false;
    }
    if (!SIZE_WITHIN(b->said_V, LARGE) || !SIZE_WITHIN(b->said_A, LARGE)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->error_V2, SINCE_MOST) || !NOT_NEGATIVE(b->weight_V2, SINCE_MOST)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->below, SINCE_MOST) || !NOT_NEGATIVE(b->share, 1.0f)) {
        good = false;
    }
    if (!SIZE_WITHIN(b->mean_off_V, LARGE) || !NOT_NEGATIVE(b->square_V2, LARGE)) {
        good = false;
    }
    if (!SIZE_WITHIN(b->left_V, LARGE) || !NOT_NEGATIVE(b->left_V2, LARGE)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->own_V2, LARGE)) {
        good = false;
    }
    return good;
}

/* CW-019. Every number of a bank in its range: memory that lost its content is noticed. */
static bool bank_is_sound(const cellwise_constants *c, cellwise_bank *b, const cellwise_state *of, uint32_t count)
{
    bool good = WITHIN(b->mean_A, -LARGE, LARGE) && WITHIN(b->looked_A, -LARGE, LARGE);
    if (!is_block_sound(b) || (b->turn > (count + 1u)) || (b->known > 1u) || (b->look > NEXT_LOOK)) {
        good = false;
    }
    if ((b->turn > 0u) && !is_past_block_sound(b)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->mismatch, LARGE) || !NOT_NEGATIVE(b->since, SINCE_MOST)) {
        good = false;
    }
    if (!NOT_NEGATIVE(b->next_look, SINCE_MOST)) {
        good = false;
    }
    if ((b->likeliest < 1u) || (b->likeliest > count)) {
        good = false;
    }
    for (uint32_t k = 0u; k < count; k++) {
        if (!NOT_NEGATIVE(of[k + 1u].cost, GIVEN_UP) || !NOT_NEGATIVE(of[k + 1u].weight, 2.0f)) {
            good = false;
        }
        if ((of[k + 1u].cost < GIVEN_UP) && (of[k + 1u].in_bank != COMPONENT)) {
            good = false;
        }
        const bool now = (b->turn == (k + 1u)) || (b->turn > count) || (b->likeliest == (k + 1u));
        if (now && (of[k + 1u].cost < GIVEN_UP) && !is_sound(c, &of[k + 1u])) {
            good = false;
        }
    }
    return good;
}

/* A bank whose memory is damaged begins over all of the SOC. */
static uint32_t know_nothing(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    start(&m->constant, &of[0u], KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE);
    begin_bank(b, of, count);
    return CELLWISE_STATE_RESET;
}

uint32_t cellwise_bank_init(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count, float soc,
                            float soc_variance)
{
    const uint32_t status = begin_at(m, &of[0u], soc, soc_variance);
    begin_bank(b, of, count);
    b->sequence = 0u;
    return status;
}

uint32_t cellwise_bank_step(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                            const cellwise_input *sample, cellwise_output *out)
{
    uint32_t status = 0u;
    uint32_t damaged = 0u;
    const uint32_t elapsed = sample->sequence - b->sequence;
    b->sequence = sample->sequence;
    if ((b->spread != 0u) && !bank_is_sound(&m->constant, b, of, count)) {
        damaged = know_nothing(m, b, of, count);
    }
    if (b->spread == 0u) {
        of[0u].in_bank = ALONE;
        status = cellwise_step(m, &of[0u], sample, out);
    } else {
        status = step_spread(m, b, of, count, sample, out, (float)elapsed, elapsed > 1u);
    }
    if ((of[0u].in_bank == CONTRADICTED) || is_lost(&of[0u])) {
        spread_again(b, of, count);
    }
    status = status | damaged;
    out->soc = of[0u].soc;
    out->soc_variance = variance_of(&of[0u], of[0u].ss);
    out->status = status;
    return status;
}

#endif
