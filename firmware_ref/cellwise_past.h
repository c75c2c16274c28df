/* Part of cellwise_ekf.c. What the branches of a component hold of the load before its start. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_PAST_H
#define CELLWISE_PAST_H

#include "cellwise_components.h"

/* What a load from full, or a charge from empty, has left in the slow branch at a SOC [V]. */
static NOINLINE float left_by_load(const cellwise_model *m, const cellwise_place *place, float mean_A, float soc)
{
    float before = 0.0f;
    const float size = at_least(magnitude(mean_A), m->constant.least_use_A);
    const float steps = PAST_PART / (m->constant.soc_per_A * size);
    const uint32_t parts = (uint32_t)parts_before(soc, mean_A);
    for (uint32_t k = 0u; k < parts; k++) {
        cellwise_slowbranch p;
        slow_branch(m, place, soc_on_way((float)(k + 1u), mean_A), mean_A, &p);
        const float end = p.r3_ohm * ((mean_A >= 0.0f) ? size : -size);
        before = before + (risen(steps * p.gain3) * (end - before));
    }
    return before;
}

/* A load under which a log begins was there before: what it has left in the slow branch. Half of that, and a
 * twentieth of a rate, may be otherwise. It is knowledge of the start that comes late: the slow branch has been
 * followed from nothing known. */
static NOINLINE void know_past(const cellwise_model *m, const cellwise_place *place, cellwise_state *a, float since,
                               float mean_A)
{
    cellwise_slowbranch p;
    slow_branch(m, place, a->soc, mean_A, &p);
    const float before = left_by_load(m, place, mean_A, a->soc);
    const float gone = risen(since * p.gain3);
    cellwise_past past;
    past_of(p.r3_ohm, gone, mean_A, before, m->constant.past_A, &past);
    cellwise_column d;
    column_of_slow_branch(a, &d);
    const float variance = a->p33 + past.variance_V2;
    const float off = past.held_V - a->v3_V;
    cellwise_column k;
    scaled(&d, 1.0f / variance, &k);
    a->cost = a->cost + cost_of_past(off, variance);
    move(a, &k, off);
    narrow(a, &k, &d);
    hold_within(a);
}

/* A longer mean of the load says more of the past: what that moves in the slow branch. What has been taken for the
 * branch's and was not is the SOC's, as far as they go together. */
static NOINLINE void know_past_better(const cellwise_model *m, const cellwise_place *place, cellwise_state *a,
                                      float since, float mean_A, float before_A)
{
    cellwise_slowbranch p;
    slow_branch(m, place, a->soc, mean_A, &p);
    const float taken = left_by_load(m, place, before_A, a->soc);
    const float more = left_by_load(m, place, mean_A, a->soc) - taken;
    const float gone = risen(since * p.gain3);
    cellwise_past past;
    past_of(p.r3_ohm, gone, 0.0f, taken, m->constant.past_A, &past);
    cellwise_column d;
    column_of_slow_branch(a, &d);
    cellwise_column k;
    scaled(&d, 1.0f / at_least(a->p33, past.variance_V2), &k);
    move(a, &k, (1.0f - gone) * more);
    hold_within(a);
}

/* What flowed for hours no first sample shows; it is looked at once more is known. */
static void open_slow_branch(const cellwise_model *m, const cellwise_place *place, cellwise_state *a, float current_A)
{
    cellwise_slowbranch p;
    slow_branch(m, place, a->soc, current_A, &p);
    const float wide_V = m->constant.bank_A * p.r3_ohm;
    a->p33 = a->p33 + (wide_V * wide_V);
}

/* What the load since a start under load says of the past, three times: to one component. */
static NOINLINE void look_back(const cellwise_model *m, cellwise_bank *b, const cellwise_place *place,
                               cellwise_state *a)
{
    if (b->look == OPENED) {
        open_slow_branch(m, place, a, b->said_A);
    } else if (b->look == FIRST_LOOK) {
        know_past(m, place, a, b->since, b->mean_A);
    } else {
        know_past_better(m, place, a, b->since, b->mean_A, b->looked_A);
    }
}

/* The mean of the load since a start under load, and whether the past is looked at now. */
static void ask_for_look(const cellwise_model *m, cellwise_bank *b)
{
    b->look = NO_LOOK;
    if (b->looks == NEVER_LOOKED) {
        if (!SIZE_BELOW(b->block_A, m->constant.rest_A)) {
            b->look = OPENED;
        }
    } else if (b->unknown_A2 > 0.0f) { /* nobody knows what flowed */
        b->looks = LOOKS;
    } else if ((b->looks < LOOKS) && (b->steps > 0.0f)) {
        b->since = b->since + b->steps;
        b->mean_A = b->mean_A + ((b->block_A - b->mean_A) * (b->steps / b->since));
        if (b->since >= b->next_look) {
            b->look = NEXT_LOOK;
            if (b->looks == 0u) {
                b->look = FIRST_LOOK;
            }
        }
    } else { /* as before */
    }
}

/* Every component has looked at it, or the first sample has gone by. */
static void note_look(const cellwise_model *m, cellwise_bank *b)
{
    if (b->look == OPENED) {
        b->looks = 0u;
        b->next_look = m->constant.look_steps;
    } else if (b->look != NO_LOOK) {
        b->looked_A = b->mean_A;
        b->looks = b->looks + 1u;
        b->next_look = b->next_look * LOOK_FACTOR;
    } else if (b->looks == NEVER_LOOKED) {
        b->looks = LOOKS;
    } else { /* as before */
    }
}

#endif
