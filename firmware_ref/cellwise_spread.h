/* Part of cellwise_ekf.c. One sample of all of them, until they agree. Printed from src/cellwise/estimate by `python
 * -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_SPREAD_H
#define CELLWISE_SPREAD_H

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

/* The first component from `first` on that is not given up; behind the last one: none. */
static uint32_t next_turn(const cellwise_state *of, uint32_t count, uint32_t first)
{
    uint32_t due = first;
    while ((due <= count) && (of[due].cost >= GIVEN_UP)) {
        due = due + 1u;
    }
    return due;
}

/* What a block has been, for the components whose turns come; the next one begins. */
static void end_block(const cellwise_model *m, cellwise_bank *b, const cellwise_state *of, uint32_t count)
{
    cellwise_place place;
    place_now(m, &of[0u], &place);
    cellwise_point p;
    look_up(m, &place, of[0u].soc, b->block_A, &p);
    note_movement(m, b, &of[0u], &p);
    note_voltage(m, b, &of[0u], of[b->likeliest].soc, &place, &p);
    ask_for_look(m, b);
    b->mean_off_V = 0.0f;
    b->square_V2 = 0.0f;
    b->own_V2 = 0.0f;
    b->left_V = 0.0f;
    b->left_V2 = 0.0f;
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

/* Variance of the next innovation: that of each by its weight, and how far they lie apart. */
static void expect_together(cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    float own_V2 = 0.0f;
    for (uint32_t k = 0u; k < count; k++) {
        if (of[k + 1u].cost < GIVEN_UP) {
            own_V2 = own_V2 + (of[k + 1u].weight * of[k + 1u].error_V2);
        }
    }
    of[0u].error_V2 = mixture_variance(own_V2, b->left_V, b->left_V2);
}

/* Every component has had its turn: their weights, and the estimate as it is now. */
static void use_block(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                      const cellwise_place *place)
{
    const cellwise_constants *const c = &m->constant;
    if (b->share > 0.0f) {
        const float variance_V2 = mixture_variance(b->own_V2, b->mean_off_V, b->square_V2);
        const float most = at_most((b->mean_off_V * b->mean_off_V) / variance_V2, c->mismatch_cap);
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
        expect_together(b, of, count);
        gather(b, of, count);
        note_estimate(b, &of[0u]);
        carry_estimate(m, b, &of[0u], place, before_V);
    }
}

/* Whether every component follows in the sample that ends a block: where each one does. */
static bool follow_at_once(const cellwise_model *m)
{
    const bool at_once = m->constant.block_steps <= 1.0f;
    return at_once;
}

/* The components over the block that has ended: one with every sample, or all at once. */
static void take_turns(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    cellwise_place place;
    place_now(m, &of[0u], &place);
    if (follow_at_once(m)) {
        while (b->turn <= count) {
            step_component(m, b, &of[b->turn], &place);
            b->turn = next_turn(of, count, b->turn + 1u);
        }
        use_block(m, b, of, count, &place);
    } else if (b->turn <= count) {
        step_component(m, b, &of[b->turn], &place);
        b->turn = next_turn(of, count, b->turn + 1u);
    } else {
        use_block(m, b, of, count, &place);
    }
}

/* Whether a block is: at the first sample, the first voltage, a gap, or after its time. */
static bool is_over(const cellwise_model *m, cellwise_bank *b, const cellwise_state *x)
{
    bool over = (b->unknown_A2 > 0.0f) || (b->steps >= m->constant.block_steps);
    if ((b->looks == NEVER_LOOKED) || (has_voltage(x) && (b->known == 0u))) {
        over = true;
    }
    return over;
}

/* One time step of components that do not agree yet: the status. The estimate goes on by the current. The components
 * follow in blocks of samples: their voltages share one error of the model, and say together what each would. */
static uint32_t step_spread(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                            const cellwise_input *sample, cellwise_output *out, float elapsed, bool lost)
{
    const bool begins = is_new(&of[0u]);
    const float before_A = of[0u].current_A;
    uint32_t status = coast(m, &of[0u], sample, out);
    if (!(b->samples > 0.0f)) {
        b->first_V2 = out->innovation_variance_V2;
    }
    if (of[0u].error_V2 > 0.0f) { /* that of the components, and by what it has grown since */
        const float grown_V2 = at_least(out->innovation_variance_V2 - b->first_V2, 0.0f);
        out->innovation_variance_V2 = of[0u].error_V2 + grown_V2;
    }
    if (begins || (elapsed > 0.0f)) {
        collect_sample(m, b, &of[0u], out, begins ? 0.0f : elapsed, lost, before_A);
        if (b->turn > 0u) {
            take_turns(m, b, of, count);
        } else if (is_over(m, b, &of[0u])) {
            end_block(m, b, of, count);
            if (follow_at_once(m)) {
                take_turns(m, b, of, count);
            }
        } else { /* as before */
        }
        if (uses_voltage(&of[0u], out)) {
            const float square = out->innovation_V * out->innovation_V;
            if (square > (m->constant.gate_square * out->innovation_variance_V2)) {
                status = status | CELLWISE_INNOVATION_REJECTED;
            }
        }
    }
    return status;
}

#endif
