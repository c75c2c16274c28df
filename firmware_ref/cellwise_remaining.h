/* Part of cellwise_ekf.c. A load carried on: time and energy to its cutoff or to empty. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_REMAINING_H
#define CELLWISE_REMAINING_H

#include "cellwise_power.h"

/* Where a plan ends; `failed_s` is when its voltage was at the cutoff or its charge gone. */
typedef struct {
    float soc;
    float least_V;
    float energy_J;
    float failed_s;
} cellwise_end;

/* Two deviations of the voltage by what the model is off by. */
static float off_by(const cellwise_along *at)
{
    return 2.0f * root(at_most(at->variance_V2, SQUARE_MOST));
}

/* Time until a voltage, taken as linear within a part, is at a cutoff; it ends there for good. `least_V` is its
 * lowest value so far. */
static NOINLINE float lasted(float so_far_s, float least_V, float after_V, float low_V, float part_s)
{
    float share = 0.0f;
    if (least_V > low_V) {
        share = 1.0f;
        if (after_V <= low_V) {
            const float fall_V = at_least(least_V - after_V, LEAST_SPAN_V);
            share = clip((least_V - low_V) / fall_V, 0.0f, 1.0f);
        }
    }
    return clip(so_far_s + (share * part_s), 0.0f, LONGEST);
}

/* Root of the sum of three squares, each at least 0: by the largest of them. */
static NOINLINE float apart_by(float a, float b, float d)
{
    const float most = at_least(at_least(a, b), d);
    float found = 0.0f;
    if (most > 0.0f) {
        a = KNOWN_FRACTION(a / most);
        b = KNOWN_FRACTION(b / most);
        d = KNOWN_FRACTION(d / most);
        found = most * root(((a * a) + (b * b)) + (d * d));
    }
    return found;
}

void cellwise_remaining(const cellwise_model *m, const cellwise_state *x, float load_A, bool holds_power,
                        cellwise_outlook *out)
{
    const cellwise_constants *const c = &m->constant;
    out->time_s = 0.0f;
    out->time_low_s = 0.0f;
    out->time_high_s = 0.0f;
    out->energy_J = 0.0f;
    out->energy_low_J = 0.0f;
    out->energy_high_J = 0.0f;
    if (is_sound(c, x) && SIZE_WITHIN(load_A, c->current_limit_A)) {
        cellwise_place place;
        place_now(m, x, &place);
        float current = at_least(load_A, c->remaining_least_A);
        const float low_V = c->remaining_low_V;
        cellwise_along then;
        as_it_is(x, &then);
        cellwise_along now;
        go_on(m, &place, x, &then, x->soc, current, 0.0f, &now);
        const float power_W = current * at_least(now.voltage_V, low_V);
        const float per_A = c->soc_per_A * x->per_capacity;
        const float part = x->soc / REMAINING_PARTS;
        float off_V = off_by(&now);
        float usual_V = now.voltage_V;
        float worse_V = usual_V - off_V;
        float better_V = usual_V + off_V;
        float usual_s = 0.0f;
        float usual_J = 0.0f;
        float worse_s = 0.0f;
        float better_s = 0.0f;
        float ahead = REMAINING_PARTS;
        while (ahead > 0.0f) {
            ahead = ahead - 1.0f;
            if (holds_power) {
                const float asked_A = power_W / at_least(now.voltage_V, low_V);
                current = clip(asked_A, c->remaining_least_A, c->current_limit_A);
            }
            const float steps = part / (per_A * current);
            go_on(m, &place, x, &now, part * ahead, current, steps, &then);
            const float part_s = steps * c->step_s;
            off_V = off_by(&then);
            const float before_s = usual_s;
            usual_s = lasted(usual_s, usual_V, then.voltage_V, low_V, part_s);
            worse_s = lasted(worse_s, worse_V, then.voltage_V - off_V, low_V, part_s);
            better_s = lasted(better_s, better_V, then.voltage_V + off_V, low_V, part_s);
            const float middle_V = at_least(0.5f * (now.voltage_V + then.voltage_V), low_V);
            usual_J = usual_J + ((current * middle_V) * (usual_s - before_s));
            usual_J = clip(usual_J, 0.0f, LONGEST);
            usual_V = clip(then.voltage_V, -LARGE, usual_V);
            worse_V = clip(then.voltage_V - off_V, -LARGE, worse_V);
            better_V = clip(then.voltage_V + off_V, -LARGE, better_V);
            now = then;
        }
        const float load_W = current * at_least(now.voltage_V, low_V);
        const float by_soc_s = ((2.0f * root(x->ss)) / (per_A * current)) * c->step_s;
        const float by_capacity_s = c->remaining_share * usual_s;
        const float below_s = apart_by(by_soc_s, by_capacity_s, at_least(usual_s - worse_s, 0.0f));
        const float above_s = apart_by(by_soc_s, by_capacity_s, at_least(better_s - usual_s, 0.0f));
        out->time_s = usual_s;
        out->time_low_s = at_least(usual_s - below_s, 0.0f);
        out->time_high_s = usual_s + above_s;
        out->energy_J = usual_J;
        out->energy_low_J = at_least(usual_J - (below_s * load_W), 0.0f);
        out->energy_high_J = usual_J + (above_s * load_W);
    }
}

#endif
