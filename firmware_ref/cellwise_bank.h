/* Part of cellwise_ekf.c. One step of all of them, until they agree. Printed from src/cellwise/estimate by `python
 * -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_BANK_H
#define CELLWISE_BANK_H

#include "cellwise_block.h"

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

/* What a block has been, for the components whose turns come; the next one begins. */
static void end_block(const cellwise_model *m, cellwise_bank *b, const cellwise_state *of, uint32_t count,
                      const cellwise_place *place)
{
    cellwise_point p;
    look_up(m, place, of[0u].soc, b->block_A, &p);
    note_movement(m, b, &of[0u], &p);
    note_voltage(m, b, &of[0u], of[b->likeliest].soc, place, &p);
    ask_for_look(m, b);
    b->sum_V = 0.0f;
    b->square_V2 = 0.0f;
    b->own_V2 = 0.0f;
    b->turn = next_turn(of, count, 1u);
    begin_block(b, &of[0u]);
}

/* The estimate from where the last block ended to now; `before_V` is what it expected. The mean of the innovations
 * of the block that is open is taken beside the new one. */
static void carry_estimate(const cellwise_model *m, cellwise_bank *b, cellwise_state *x, const cellwise_place *place,
                           float before_V)
{
    add(&x->soc, &x->soc_carry, b->moved);
    cellwise_point p;
    look_up(m, place, x->soc, b->block_A, &p);
    cellwise_slopes slopes;
    no_slopes(&p, &slopes);
    carry_on(x, b, &p, &slopes);
    hold_within(x);
    b->off_V = b->off_V + (before_V - voltage_at(x, &p, p.r0_ohm * b->block_A));
}

/* Every component has had its turn: their weights, and the estimate as it is now. */
static void use_block(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                      const cellwise_place *place)
{
    const cellwise_constants *const c = &m->constant;
    of[0u].error_V2 = mixture_variance(b->own_V2, b->sum_V, b->square_V2);
    if (b->share > 0.0f) {
        const float most = at_most((b->sum_V * b->sum_V) / of[0u].error_V2, c->mismatch_cap);
        b->mismatch = lately_shown(b->mismatch, most, b->lately);
    }
    note_look(m, b);
    b->turn = 0u;
    if (has_voltage(&of[0u])) { /* else it is as it was stated */
        cellwise_point p;
        look_up(m, place, of[0u].soc, b->block_A, &p);
        const float before_V = voltage_at(&of[0u], &p, p.r0_ohm * b->block_A);
        note_movement(m, b, &of[0u], &p);
        weigh_components(of, count, likeliest_of(b, of, count));
        gather(b, of, count);
        note_estimate(b, &of[0u]);
        carry_estimate(m, b, &of[0u], place, before_V);
    }
}

/* The first component from `first` on that is not given up; behind the last one: none. */
static uint32_t next_turn(const cellwise_state *of, uint32_t count, uint32_t first)
{
    uint32_t due = first;
    while ((due <= count) && (of[due].cost >= GIVEN_UP)) {
        due = due + 1u;
    }
    return due;
}

/* The components over the block that has ended: one with every sample, or all at once. */
static void take_turns(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    cellwise_place place;
    place_now(m, &of[0u], &place);
    if (b->turn <= count) {
        step_component(m, b, &of[b->turn], &place);
        b->turn = next_turn(of, count, b->turn + 1u);
    } else {
        use_block(m, b, of, count, &place);
    }
}

/* Whether a block is: at the first sample, the first voltage, a gap, or after its time. */
static bool is_over(const cellwise_model *m, cellwise_bank *b, const cellwise_state *x)
{
    const bool begins = (b->looks == NEVER_LOOKED) || (has_voltage(x) && (b->known == 0u));
    return begins || (b->unknown_A2 > 0.0f) || (b->steps >= m->constant.block_steps);
}

/* One time step of components that do not agree yet: the status. The estimate goes on by the current. The components
 * follow in blocks of samples: their voltages share one error of the model, and say together what each would. */
static uint32_t step_spread(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                            const cellwise_input *sample, cellwise_output *out, float elapsed, bool lost)
{
    const bool begins = is_new(&of[0u]);
    const float before_A = of[0u].current_A;
    uint32_t status = coast(m, &of[0u], sample, out);
    if (of[0u].error_V2 > 0.0f) {
        out->innovation_variance_V2 = of[0u].error_V2;
    }
    if (begins || (elapsed > 0.0f)) {
        collect_sample(m, b, &of[0u], out->innovation_V, begins ? 0.0f : elapsed, lost, before_A);
        if (b->turn > 0u) {
            take_turns(m, b, of, count);
        } else if (is_over(m, b, &of[0u])) {
            end_block(m, b, of, count, &place_now(m, &of[0u]));
        } else { /* as before */
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
    if (!SIZE_WITHIN(b->sum_V, LARGE) || !NOT_NEGATIVE(b->square_V2, LARGE)) {
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
