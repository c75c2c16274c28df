/* Part of cellwise_ekf.c. State of power: what a constant current makes of the cell, and the largest one. Printed
 * from src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_POWER_H
#define CELLWISE_POWER_H

#include "cellwise_bank.h"

/* A cell after a constant current: branches, voltage, variances of it. `variance_V2` is the model's, `kept_V2` what
 * remains of the branches' and of hysteresis. */
typedef struct {
    float voltage_V;
    float variance_V2;
    float kept_V2;
    float h;
    float slow_A;
    float v1;
    float v2;
    float v3;
} cellwise_along;

/* Power one way: the value, what is sustained with 95 %, the current of the value. */
typedef struct {
    float power_W;
    float low_W;
    float current_A;
} cellwise_way;

/* The cell's state, under no load yet. */
static void as_it_is(const cellwise_state *x, cellwise_along *along)
{
    along->v1 = x->v1_V;
    along->v2 = x->v2_V;
    along->v3 = x->v3_V;
    along->h = x->h;
    along->slow_A = x->slow_A;
    along->voltage_V = 0.0f;
    along->variance_V2 = 0.0f;
    along->kept_V2 = 0.0f;
}

/* The same place with another lag of the particles' surface. */
static void behind(const cellwise_place *at, float lag, cellwise_place *place)
{
    place->low = at->low;
    place->weight = at->weight;
    place->scale = at->scale;
    place->lag = lag;
}

/* A state of first order of which that share of its way to its end is left. */
static float toward(float old, float end, float left)
{
    return clip(end + (left * (old - end)), -LARGE, LARGE);
}

/* So many time steps of a constant current later, at a SOC, in one interval. The exponent of a branch comes from its
 * gain g over one time step, as g / (1 - g / 2). What the states share is left out of the variance: it mostly takes
 * away from it. */
static NOINLINE void go_on(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x,
                           const cellwise_along *was, float soc, float current, float steps, cellwise_along *along)
{
    const cellwise_constants *const c = &m->constant;
    along->slow_A = was->slow_A;
    float lag = 0.0f;
    along->slow_A = toward(along->slow_A, current, 1.0f - risen(steps * c->surface_rate));
    const float depth = depth_at(c, effective_temperature(x));
    lag = clip(depth * along->slow_A, -1.0f, 1.0f);
    cellwise_place here;
    behind(place, lag, &here);
    cellwise_point p;
    look_up(m, &here, soc, current, &p);
    const float drop = p.r0_ohm * current;
    float held_V = magnitude(drop);
    along->voltage_V = p.ocv_V - drop;
    along->kept_V2 = 0.0f;
    const float left1 = vanishing(steps * (p.gain1 / (1.0f - (0.5f * p.gain1))));
    along->v1 = toward(was->v1, p.r1_ohm * current, left1);
    held_V = held_V + magnitude(along->v1);
    along->voltage_V = along->voltage_V - along->v1;
    along->kept_V2 = along->kept_V2 + ((left1 * left1) * x->p11);
    const float left2 = vanishing(steps * (p.gain2 / (1.0f - (0.5f * p.gain2))));
    along->v2 = toward(was->v2, p.r2_ohm * current, left2);
    held_V = held_V + magnitude(along->v2);
    along->voltage_V = along->voltage_V - along->v2;
    along->kept_V2 = along->kept_V2 + ((left2 * left2) * x->p22);
    const float left3 = vanishing(steps * (p.gain3 / (1.0f - (0.5f * p.gain3))));
    along->v3 = toward(was->v3, p.r3_ohm * current, left3);
    held_V = held_V + magnitude(along->v3);
    along->voltage_V = along->voltage_V - along->v3;
    along->kept_V2 = along->kept_V2 + ((left3 * left3) * x->p33);
    along->h = was->h;
    const float keep = vanishing((c->hysteresis_per_A * magnitude(current)) * steps);
    along->h = toward(along->h, (current < 0.0f) ? 1.0f : -1.0f, keep);
    along->voltage_V = along->voltage_V + (p.m_V * along->h);
    const float spread_V = p.m_V * keep;
    along->kept_V2 = along->kept_V2 + ((spread_V * spread_V) * x->phh);
    along->variance_V2 = single_variance(c, p.noise_V2, current, held_V, 0.0f, p.r0_ohm);
    const float beyond_V = extrapolated(c, x, current, held_V);
    along->variance_V2 = along->variance_V2 + (beyond_V * beyond_V);
    if (POSITIVE_ABOVE(x->mismatch, 1.0f)) {
        along->variance_V2 = along->variance_V2 * x->mismatch;
    }
    along->voltage_V = clip(along->voltage_V, -LARGE, LARGE);
}

/* A constant current over the horizon of the power, from `soc`. */
static NOINLINE void ending(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x, float soc,
                            float current, cellwise_along *along)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_along now;
    as_it_is(x, &now);
    const float end = soc - (c->power_steps * taken(c, x, current));
    go_on(m, place, x, &now, end, current, c->power_steps, along);
}

/* Largest size of a current, discharged (`side` 1) or charged (-1), up to `most_A`. By false position (Illinois)
 * between none and `most_A`; 0 where no current keeps the limit. */
static NOINLINE float able(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x, float soc,
                           float side, float limit_V, float most_A)
{
    float found = 0.0f;
    cellwise_along none;
    ending(m, place, x, soc, 0.0f, &none);
    float room = side * (none.voltage_V - limit_V);
    if ((room > 0.0f) && (most_A > 0.0f)) {
        float near = 0.0f;
        float far = most_A;
        cellwise_along full;
        ending(m, place, x, soc, side * most_A, &full);
        float lack = side * (limit_V - full.voltage_V);
        bool near_again = false;
        bool far_again = false;
        if (lack > 0.0f) {
            for (uint32_t k = 0u; k < POWER_TRIALS; k++) {
                const float share = clip(room / at_least(room + lack, LEAST_SPAN_V), 0.0f, 1.0f);
                const float middle = near + ((far - near) * share);
                cellwise_along there;
                ending(m, place, x, soc, side * middle, &there);
                const float left = side * (there.voltage_V - limit_V);
                if (left >= 0.0f) {
                    near = middle;
                    room = left;
                    if (near_again) {
                        lack = 0.5f * lack;
                    }
                    near_again = true;
                    far_again = false;
                } else {
                    far = middle;
                    lack = -left;
                    if (far_again) {
                        room = 0.5f * room;
                    }
                    far_again = true;
                    near_again = false;
                }
            }
        } else {
            near = most_A;
        }
        found = near;
    }
    return found;
}

/* Value and lower bound of one way: the bound keeps 1.645 deviations from the limits. `soc`, of variance `ss`, is
 * the cell's own. The slope over SOC is the chord to the SOC that is as many deviations worse. */
static NOINLINE void one_way(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x, float soc,
                             float ss, float side, float limit_V, float most_A, float room_soc, cellwise_way *way)
{
    const cellwise_constants *const c = &m->constant;
    const float per_soc_A = (1.0f / (c->soc_per_A * c->power_steps)) / x->per_capacity;
    const float by_soc_A = at_least(room_soc * per_soc_A, 0.0f);
    way->current_A = able(m, place, x, soc, side, limit_V, (most_A < by_soc_A) ? most_A : by_soc_A);
    cellwise_along end;
    ending(m, place, x, soc, side * way->current_A, &end);
    const float shift = SUSTAINED * root(ss);
    cellwise_along worse;
    ending(m, place, x, soc - (side * shift), side * way->current_A, &worse);
    const float by_soc_V = end.voltage_V - worse.voltage_V;
    const float variance_V2 = end.variance_V2 + end.kept_V2;
    const float square = (by_soc_V * by_soc_V) + ((SUSTAINED * SUSTAINED) * variance_V2);
    const float off_V = root(at_most(square, SQUARE_MOST));
    const float low_soc_A = at_least((room_soc - shift) * per_soc_A, 0.0f);
    const float low_V = limit_V + (side * off_V);
    const float sure = able(m, place, x, soc, side, low_V, (most_A < low_soc_A) ? most_A : low_soc_A);
    cellwise_along last;
    ending(m, place, x, soc, side * sure, &last);
    way->power_W = at_least(way->current_A * end.voltage_V, 0.0f);
    way->low_W = at_least(sure * (last.voltage_V - off_V), 0.0f);
    if (way->low_W > way->power_W) {
        way->low_W = way->power_W;
    }
}

void cellwise_power(const cellwise_model *m, const cellwise_state *x, cellwise_capability *out)
{
    const cellwise_constants *const c = &m->constant;
    out->discharge_W = 0.0f;
    out->discharge_low_W = 0.0f;
    out->charge_W = 0.0f;
    out->charge_low_W = 0.0f;
    if (is_sound(c, x)) {
        cellwise_place place;
        place_now(m, x, &place);
        float most_A = c->power_discharge_A;
        float room_soc = x->soc - c->power_soc_low;
        cellwise_way down;
        one_way(m, &place, x, x->soc, x->ss, 1.0f, c->power_low_V, most_A, room_soc, &down);
        most_A = c->power_charge_A;
        room_soc = c->power_soc_high - x->soc;
        cellwise_way up;
        one_way(m, &place, x, x->soc, x->ss, -1.0f, c->power_high_V, most_A, room_soc, &up);
        out->discharge_W = down.power_W;
        out->discharge_low_W = down.low_W;
        out->charge_W = up.power_W;
        out->charge_low_W = up.low_W;
    }
}

#endif
