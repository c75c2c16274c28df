/* Part of cellwise_ekf.c. One step of all of them, until they agree. Printed from src/cellwise/estimate by `python
 * -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_BANK_H
#define CELLWISE_BANK_H

#include "cellwise_past.h"

/* Every component by its own step, the likeliest first: all share what it says of the noise. */
static uint32_t step_components(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                                const cellwise_input *sample, cellwise_output *out)
{
    const cellwise_constants *const c = &m->constant;
    float error_V2 = 0.0f;
    uint32_t status = 0u;
    float first_V = 0.0f;
    float mean_V = 0.0f;
    float square_V2 = 0.0f;
    float variance_V2 = 0.0f;
    for (uint32_t turn = 0u; turn < count; turn++) {
        uint32_t k = b->likeliest;
        if (turn > 0u) {
            k = (turn <= (b->likeliest - 1u)) ? turn : (turn + 1u);
        }
        if (of[k].cost < GIVEN_UP) {
            of[k].error_V2 = error_V2;
            of[k].mismatch = b->mismatch;
            const uint32_t said = cellwise_step(m, &of[k], sample, out);
            if (turn == 0u) {
                error_V2 = of[k].error_V2;
                status = said;
                first_V = out->voltage_V;
            }
            const float away_V = out->voltage_V - first_V;
            mean_V = mean_V + (of[k].weight * away_V);
            square_V2 = square_V2 + (of[k].weight * (away_V * away_V));
            variance_V2 = variance_V2 + (of[k].weight * out->innovation_variance_V2);
        }
    }
    out->voltage_V = first_V + mean_V;
    out->innovation_variance_V2 = mixture_variance(variance_V2, mean_V, square_V2);
    out->innovation_V = 0.0f;
    if (POSITIVE_WITHIN(sample->voltage_V, c->voltage_low_V, c->voltage_high_V)) {
        out->innovation_V = sample->voltage_V - out->voltage_V;
        const float ratio = (out->innovation_V * out->innovation_V) / out->innovation_variance_V2;
        if (ratio > c->gate_square) {
            status = status | CELLWISE_INNOVATION_REJECTED;
        }
        b->mismatch = lately_shown(b->mismatch, at_most(ratio, c->mismatch_cap), c->lately);
    }
    return status;
}

/* The cost of the likeliest component. */
static float likeliest_of(cellwise_bank *b, const cellwise_state *of, uint32_t count)
{
    float least = of[b->likeliest].cost;
    for (uint32_t k = 0u; k < count; k++) {
        if (of[k + 1u].cost < least) {
            least = of[k + 1u].cost;
            b->likeliest = k + 1u;
        }
    }
    return least;
}

/* One time step of components that do not agree yet: the status. */
static uint32_t step_spread(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                            const cellwise_input *sample, cellwise_output *out, float elapsed, bool lost)
{
    uint32_t status = step_components(m, b, of, count, sample, out);
    look_back(m, b, of, count, elapsed, lost);
    if (has_voltage(&of[b->likeliest])) {
        weigh_components(of, count, likeliest_of(b, of, count));
        gather(b, of, count);
    } else { /* as it was stated */
        status = cellwise_step(m, &of[0u], sample, out);
    }
    return status;
}

/* Whether nobody knows what flowed, one filter is not enough, and a voltage is there. */
static bool is_lost(const cellwise_state *x)
{
    bool lost = false;
    if ((x->in_bank == UNCOUNTED) && (x->evidence >= FIRST_VOLTAGE) && (x->no_voltage == 0u)) {
        lost = x->ss > SPREAD_VARIANCE;
    }
    return lost;
}

/* CW-019. Every number of a bank in its range: memory that lost its content is noticed. */
static bool bank_is_sound(cellwise_bank *b, const cellwise_state *of, uint32_t count)
{
    bool good = WITHIN(b->mean_A, -LARGE, LARGE) && WITHIN(b->looked_A, -LARGE, LARGE);
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
    if ((b->spread != 0u) && !bank_is_sound(b, of, count)) {
        damaged = know_nothing(m, b, of, count);
    }
    if (b->spread == 0u) {
        of[0u].in_bank = ALONE;
        status = cellwise_step(m, &of[0u], sample, out);
        if ((of[0u].in_bank == CONTRADICTED) || is_lost(&of[0u])) {
            spread_again(b, of, count);
        }
    } else {
        status = step_spread(m, b, of, count, sample, out, (float)elapsed, elapsed > 1u);
        if (!bank_is_sound(b, of, count)) {
            damaged = know_nothing(m, b, of, count);
        }
    }
    status = status | damaged;
    out->soc = of[0u].soc;
    out->soc_variance = variance_of(&of[0u], of[0u].ss);
    out->status = status;
    return status;
}

#endif
