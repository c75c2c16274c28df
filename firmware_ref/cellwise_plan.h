/* Part of cellwise_ekf.c. A plan of loads, and where it ends. Printed from src/cellwise/estimate by `python -m
 * cellwise.printing`; do not edit. */
#ifndef CELLWISE_PLAN_H
#define CELLWISE_PLAN_H

#include "cellwise_remaining.h"

/* Every phase a time and a load that are numbers, of a size that cells have. */
static bool is_plan_sound(const cellwise_phase *phases, uint32_t count)
{
    bool sound = true;
    for (uint32_t k = 0u; k < count; k++) {
        if (!(NOT_NEGATIVE(phases[k].seconds, LARGE) && SIZE_WITHIN(phases[k].load, LARGE))) {
            sound = false;
        }
    }
    return sound;
}

/* Through the plan from a SOC, with a capacity, as many times two deviations lower in voltage. A phase is gone
 * through in equal parts; a power finds its current by the voltage that it leaves. */
static NOINLINE void flown(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x,
                           const cellwise_phase *phases, uint32_t count, bool holds_power, float begun,
                           float per_capacity, float lower, cellwise_end *end)
{
    const cellwise_constants *const c = &m->constant;
    const float low_V = c->remaining_low_V;
    end->soc = begun;
    cellwise_along now;
    as_it_is(x, &now);
    cellwise_along then;
    go_on(m, place, x, &now, end->soc, 0.0f, 0.0f, &then);
    float voltage_V = then.voltage_V;
    end->least_V = voltage_V;
    end->energy_J = 0.0f;
    end->failed_s = LONGEST;
    float time_s = 0.0f;
    const uint32_t turns = holds_power ? PHASE_TURNS : 1u;
    for (uint32_t phase = 0u; phase < count; phase++) {
        const float load = phases[phase].load;
        float current = holds_power ? (load / at_least(voltage_V, low_V)) : load;
        current = clip(current, -c->current_limit_A, c->current_limit_A);
        uint32_t parts = 1u;
        if (magnitude(load) > 0.0f) {
            const float per_s = magnitude(taken(c, x, current)) / c->step_s;
            float asked = PHASE_PARTS_PER_S + (REMAINING_PARTS * per_s);
            asked = 1.0f + (phases[phase].seconds * asked);
            parts = (uint32_t)clip(asked, 1.0f, PHASE_PARTS_MOST);
        }
        const float part_s = phases[phase].seconds / (float)parts;
        const float steps = part_s / c->step_s;
        for (uint32_t k = 0u; k < parts; k++) {
            float after = end->soc;
            for (uint32_t kturn = 0u; kturn < turns; kturn++) {
                if (holds_power) {
                    current = load / at_least(voltage_V, low_V);
                    current = clip(current, -c->current_limit_A, c->current_limit_A);
                }
                after = end->soc - ((per_capacity * taken(c, x, current)) * steps);
                after = clip(after, -1.0f, 2.0f);
                go_on(m, place, x, &now, after, current, steps, &then);
                voltage_V = then.voltage_V - (lower * off_by(&then));
            }
            end->soc = after;
            now = then;
            time_s = clip(time_s + part_s, 0.0f, LONGEST);
            end->energy_J = clip(end->energy_J + ((current * voltage_V) * part_s), -LONGEST, LONGEST);
            end->least_V = clip(voltage_V, -LARGE, end->least_V);
            if (((voltage_V <= low_V) || (end->soc <= 0.0f)) && (end->failed_s >= LONGEST)) {
                end->failed_s = time_s;
            }
        }
    }
}

/* Probability that a normal number is below so many deviations, to 1e-6. Abramowitz and Stegun (1964), 26.2.19: a
 * polynomial to the power of -16. */
static NOINLINE float normal(float deviations)
{
    const float z = clip(magnitude(deviations), 0.0f, DEVIATIONS_MOST);
    const float far = NORMAL_4 + (z * (NORMAL_5 + (z * NORMAL_6)));
    float grown = 1.0f + (z * (NORMAL_1 + (z * (NORMAL_2 + (z * (NORMAL_3 + (z * far)))))));
    for (uint32_t k = 0u; k < 4u; k++) {
        grown = grown * grown;
    }
    const float tail = 0.5f / grown;
    return (deviations < 0.0f) ? tail : (1.0f - tail);
}

void cellwise_plan(const cellwise_model *m, const cellwise_state *x, const cellwise_phase *phases, uint32_t count,
                   bool holds_power, float above, cellwise_plan_result *out)
{
    const cellwise_constants *const c = &m->constant;
    out->soc = 0.0f;
    out->soc_low = 0.0f;
    out->soc_high = 0.0f;
    out->least_V = 0.0f;
    out->least_low_V = 0.0f;
    out->energy_J = 0.0f;
    out->failed_s = 0.0f;
    out->chance = 0.0f;
    if (is_sound(c, x) && is_plan_sound(phases, count) && NOT_NEGATIVE(above, 1.0f)) {
        cellwise_place place;
        place_now(m, x, &place);
        const float away = 2.0f * root(x->ss);
        /* Away from the nearer end of the SOC, where it would be cut off. */
        const float other_soc = clip(x->soc + ((x->soc < 0.5f) ? away : -away), 0.0f, 1.0f);
        const float less = 1.0f + c->remaining_share;
        cellwise_end usual;
        flown(m, &place, x, phases, count, holds_power, x->soc, 1.0f, 0.0f, &usual);
        cellwise_end other;
        flown(m, &place, x, phases, count, holds_power, other_soc, 1.0f, 0.0f, &other);
        const float soc_by_soc = magnitude(usual.soc - other.soc);
        const float low_by_soc_V = magnitude(usual.least_V - other.least_V);
        flown(m, &place, x, phases, count, holds_power, x->soc, less, 0.0f, &other);
        const float soc_by_capacity = magnitude(usual.soc - other.soc);
        const float low_by_capacity_V = magnitude(usual.least_V - other.least_V);
        flown(m, &place, x, phases, count, holds_power, x->soc, 1.0f, 1.0f, &other);
        const float soc_by_voltage = magnitude(usual.soc - other.soc);
        const float low_by_voltage_V = magnitude(usual.least_V - other.least_V);
        const float off_soc = at_least(apart_by(soc_by_soc, soc_by_capacity, soc_by_voltage), LEAST_SPAN_V);
        float off_V = apart_by(low_by_soc_V, low_by_capacity_V, low_by_voltage_V);
        off_V = at_least(off_V, LEAST_SPAN_V);
        out->soc = clip(usual.soc, 0.0f, 1.0f);
        out->soc_low = clip(usual.soc - off_soc, 0.0f, 1.0f);
        out->soc_high = clip(usual.soc + off_soc, 0.0f, 1.0f);
        out->least_V = usual.least_V;
        out->least_low_V = usual.least_V - off_V;
        out->energy_J = usual.energy_J;
        out->failed_s = usual.failed_s;
        const float by_soc = normal((2.0f * (usual.soc - above)) / off_soc);
        const float by_voltage = normal((2.0f * (usual.least_V - c->remaining_low_V)) / off_V);
        out->chance = by_soc * by_voltage;
    }
}

#endif
