/* Part of cellwise_ekf.c. One step of all of them, until they agree. Printed from src/cellwise/estimate by `python
 * -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_BANK_H
#define CELLWISE_BANK_H

#include "cellwise_block.h"

/* Every component over the block that ends now, and what they have expected together. */
static void step_components(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count, bool begins,
                            bool alone)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_place place;
    place_now(m, &of[0u], &place);
    cellwise_point p;
    look_up(m, &place, of[0u].soc, b->block_A, &p);
    cellwise_movement o;
    movement_of(m, b, &of[0u], &p, &o);
    cellwise_block block;
    block_of(m, b, &of[0u], of[b->likeliest].soc, &place, &p, alone, &block);
    float mean_V = 0.0f;
    float square_V2 = 0.0f;
    float variance_V2 = 0.0f;
    for (uint32_t k = 0u; k < count; k++) {
        if (of[k + 1u].cost < GIVEN_UP) {
            cellwise_expected expected;
            step_component(m, &of[k + 1u], &place, &o, &block, begins, b->mismatch, &expected);
            const float off_V = block.voltage_V - expected.voltage_V;
            mean_V = mean_V + (of[k + 1u].weight * off_V);
            square_V2 = square_V2 + (of[k + 1u].weight * (off_V * off_V));
            variance_V2 = variance_V2 + (of[k + 1u].weight * expected.variance_V2);
        }
    }
    of[0u].error_V2 = mixture_variance(variance_V2, mean_V, square_V2);
    if (block.share > 0.0f) {
        const float most = at_most((mean_V * mean_V) / of[0u].error_V2, c->mismatch_cap);
        b->mismatch = lately_shown(b->mismatch, most, at_most(c->lately * b->steps, 1.0f));
    }
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

/* The components over a block, what it says of the past, their weights and the estimate. */
static void close_block(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count, bool begins,
                        bool alone, bool lost)
{
    step_components(m, b, of, count, begins, alone);
    look_back(m, b, of, count, lost);
    if (has_voltage(&of[0u])) { /* else it is as it was stated */
        weigh_components(of, count, likeliest_of(b, of, count));
        gather(b, of, count);
    }
    begin_block(b, &of[0u]);
}

/* One time step of components that do not agree yet: the status. The estimate goes on by the current. The components
 * follow in blocks of samples: their voltages share one error of the model, and say together what each would. */
static uint32_t step_spread(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                            const cellwise_input *sample, cellwise_output *out, float elapsed, bool lost)
{
    const bool begins = is_new(&of[0u]);
    const bool knew = has_voltage(&of[0u]);
    const float before_A = of[0u].current_A;
    uint32_t status = coast(m, &of[0u], sample, out);
    if (of[0u].error_V2 > 0.0f) {
        out->innovation_variance_V2 = of[0u].error_V2;
    }
    if (begins || (elapsed > 0.0f)) {
        const bool first = has_voltage(&of[0u]) && !knew;
        collect_sample(m, b, &of[0u], out->innovation_V, begins ? 0.0f : elapsed, lost, before_A);
        if (begins || first || lost || (b->steps >= m->constant.block_steps)) {
            const bool alone = first && SIZE_BELOW(of[0u].current_A, m->constant.rest_A);
            close_block(m, b, of, count, begins, alone, lost && !begins);
        }
        if (uses_voltage(&of[0u])) {
            const float square = out->innovation_V * out->innovation_V;
            if (square > (m->constant.gate_square * out->innovation_variance_V2)) {
                status = status | CELLWISE_INNOVATION_REJECTED;
            }
        }
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

/* The numbers of a block in their range. */
static bool is_block_sound(cellwise_bank *b)
{
    bool good = WITHIN(b->off_V, -LARGE, LARGE) && WITHIN(b->block_A, -LARGE, LARGE);
    if (!WITHIN(b->soc, -LARGE, LARGE)) {
        good = false;
    }
    if (!WITHIN(b->v1_V, -LARGE, LARGE)) {
        good = false;
    }
    if (!WITHIN(b->v2_V, -LARGE, LARGE)) {
        good = false;
    }
    if (!WITHIN(b->v3_V, -LARGE, LARGE)) {
        good = false;
    }
    if (!WITHIN(b->h, -LARGE, LARGE)) {
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

/* CW-019. Every number of a bank in its range: memory that lost its content is noticed. */
static bool bank_is_sound(const cellwise_constants *c, cellwise_bank *b, const cellwise_state *of, uint32_t count)
{
    bool good = WITHIN(b->mean_A, -LARGE, LARGE) && WITHIN(b->looked_A, -LARGE, LARGE);
    if (!is_block_sound(b)) {
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
        if ((of[k + 1u].cost < GIVEN_UP) && !is_sound(c, &of[k + 1u])) {
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
        if ((b->spread != 0u) && !bank_is_sound(&m->constant, b, of, count)) {
            damaged = know_nothing(m, b, of, count);
        }
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
