/* Part of cellwise_ekf.c. The charge between rests, how long a cell has rested, the first load after. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_RESTS_H
#define CELLWISE_RESTS_H

#include "cellwise_capacity.h"

/* What a load from a rest on drops by the tables' resistances, and by the OCV's slope [V]. */
typedef struct {
    float tables_V;
    float ocv_V;
} cellwise_dropsincerest;

/* SOC of the tables' capacity that a current takes in one step. */
static float moved_by(const cellwise_constants *c, const cellwise_state *x, float current_A)
{
    float used = taken(c, x, current_A);
    used = used / x->per_capacity;
    return used;
}

/* How far a branch has come after so many steps. */
static float risen_after(float gain, uint32_t steps)
{
    float left = 1.0f;
    for (uint32_t k = 0u; k < steps; k++) {
        left = left * (1.0f - gain);
    }
    return 1.0f - left;
}

/* What the tables' resistances drop after so many steps of a current from rest on. */
static void drop_since_rest(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x,
                            float current_A, uint32_t steps, cellwise_dropsincerest *dropsincerest)
{
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    const cellwise_constants *const c = &m->constant;
    const uint32_t points = CELLWISE_POINTS;
    cellwise_socplace z;
    soc_place(place, points, x->soc, &z);
    cellwise_loaded under;
    resistances_at(m, place, &z, current_A, &under);
    float ohm = under.r0_ohm;
    float gain = 1.0f / READ(z.at, lag1, z.share);
    ohm = ohm + (under.r1_ohm * risen_after(gain, steps));
    gain = 1.0f / READ(z.at, lag2, z.share);
    ohm = ohm + (under.r2_ohm * risen_after(gain, steps));
    gain = 1.0f / READ(z.at, lag3, z.share);
    ohm = (ohm + (under.r3_ohm * risen_after(gain, steps))) / x->resistance_scale;
    const float slope_V = RISE(z.k, ocv_V) * (float)(points - 1u);
    dropsincerest->ocv_V = slope_V * (moved_by(c, x, current_A) * (float)steps);
    dropsincerest->tables_V = ohm * current_A;
}

/* A voltage under the first load after a rest: the drop since, over that of the tables. A reading that is far off
 * moves the estimate no further than one at the gate, so that a contact that came loose is found by and by. As of
 * the capacity, what is stated is no surer than the model's own resistances. */
static void use_load(const cellwise_constants *c, cellwise_soh *a, float current_A, const cellwise_dropsincerest *drop,
                     float voltage_V)
{
    const float per_V = 1.0f / drop->tables_V;
    const float shown = ((a->voltage_V - voltage_V) - drop->ocv_V) * per_V;
    const float volts_V2 = (c->fixed_V2 + c->fixed_V2) + (a->held_V * a->held_V);
    const float amperes = c->current_variance_A2 / (current_A * current_A);
    const float single = (volts_V2 * (per_V * per_V)) + ((a->resistance * a->resistance) * amperes);
    const float share = (current_A < 0.0f) ? c->charge_variance : c->share_variance;
    const float model = (a->resistance * a->resistance) * share;
    const float total = a->rr + (single + model);
    const float most = root(at_most(c->gate_square * total, 4.0f * MOST_SCALE));
    const float gain = a->rr / total;
    const float missed = clip(shown - a->resistance, -most, most);
    a->resistance = clip(a->resistance + (gain * missed), LEAST_SCALE, MOST_SCALE);
    a->rr = clip(a->rr - (gain * a->rr), VARIANCE_FLOOR, 1.0f);
    a->resistance_variance = at_most(a->rr + model, SOH_RESISTANCE);
    a->loads = a->loads + 1u;
}

/* Under load after a long rest: its SOC at once, and the resistance once the current stands. Of the first interval
 * nobody knows how much of it was under load. */
static NOINLINE void after_rest(const cellwise_model *m, const cellwise_state *x, cellwise_soh *a,
                                const cellwise_input *sample)
{
    const cellwise_constants *const c = &m->constant;
    if (!soh_is_sound(a)) {
        const uint32_t last = a->sequence;
        cellwise_soh_init(m, a);
        a->sequence = last;
        a->begun = 1u;
    }
    if (a->watched == RESTED) {
        end_rest(m, x, a);
        a->watched = FIRST_LOAD;
        a->rest_end = a->sequence;
    }
    const uint32_t steps = sample->sequence - a->rest_end;
    const float small = 0.1f * magnitude(x->current_A);
    bool stands = SIZE_BELOW(x->current_A - a->current_A, small) && (steps >= 2u);
    stands = stands && (a->watched == FIRST_LOAD);
    const bool shown = POSITIVE_WITHIN(sample->voltage_V, c->voltage_low_V, c->voltage_high_V);
    bool over = steps > c->soh_load_steps;
    if (stands && shown && !(over || SIZE_BELOW(x->current_A, c->soh_load_A))) {
        cellwise_place place;
        place_now(m, x, &place);
        cellwise_dropsincerest drop;
        drop_since_rest(m, &place, x, x->current_A, steps, &drop);
        if (magnitude(drop.tables_V) >= LEAST_SPAN_V) {
            use_load(c, a, x->current_A, &drop, sample->voltage_V);
        }
        over = true;
    }
    if (over) {
        a->watched = 0u;
    }
}

/* SOC that samples which are missing have taken, as the step counts it. Numbers that may have begun again go on from
 * where the count and the rest were. */
static float bridged(const cellwise_constants *c, const cellwise_state *x, cellwise_soh *a, uint32_t missing)
{
    float used = 0.0f;
    if (missing <= c->gap_steps) {
        used = moved_by(c, x, 0.5f * (x->current_A + a->current_A)) * (float)missing;
    } else {
        /* A load that many gaps hide takes the same way in all of them. */
        const float off = root(a->unsure) + root(c->gap_variance);
        a->unsure = at_most(off * off, 1.0f);
    }
    if (missing > LONGEST_GAP) {
        const uint32_t more = missing - LONGEST_GAP;
        a->counted_from = a->counted_from + more;
        a->loaded = a->loaded + more;
    }
    return used;
}

/* After so long a rest a voltage is the OCV, but for what the branches hold. */
static NOINLINE void keep_rested(const cellwise_constants *c, const cellwise_state *x, cellwise_soh *a, float voltage_V)
{
    if (POSITIVE_WITHIN(voltage_V, c->voltage_low_V, c->voltage_high_V)) {
        const float held_V = ((0.0f + x->v1_V) + x->v2_V) + x->v3_V;
        a->voltage_V = voltage_V;
        a->held_V = magnitude(held_V);
        a->watched = RESTED;
    }
}

/* For how many steps nobody knows what flows. */
static uint32_t silence(const cellwise_constants *c, const cellwise_state *x, const cellwise_soh *a, float current_A)
{
    (void)c;
    (void)a;
    (void)current_A;
    return x->no_current;
}

void cellwise_soh_step(const cellwise_model *m, const cellwise_state *x, cellwise_soh *a, const cellwise_input *sample)
{
    const cellwise_constants *const c = &m->constant;
    const uint32_t elapsed = sample->sequence - a->sequence;
    if (a->begun == 0u) {
        if (!soh_is_sound(a)) {
            cellwise_soh_init(m, a);
        }
        a->begun = 1u;
        a->loaded = sample->sequence;
        a->watched = 0u;
    } else if (elapsed != 0u) {
        if (!SIZE_BELOW(x->current_A, c->soh_rest_A)) {
            if (a->watched != 0u) {
                after_rest(m, x, a, sample);
            }
            a->loaded = sample->sequence;
        } else if ((sample->sequence - a->loaded) >= c->soh_steps) {
            keep_rested(c, x, a, sample->voltage_V);
        } else { /* as before */
        }
        float used = moved_by(c, x, x->current_A);
        if (elapsed > 1u) {
            used = used + bridged(c, x, a, elapsed - 1u);
        }
        add(&a->counted, &a->counted_carry, used);
        a->moved = a->moved + magnitude(used);
        if (silence(c, x, a, sample->current_A) > c->gap_steps) {
            begin_at_rest(a, 0.0f, 0.0f);
            a->loaded = sample->sequence;
            a->watched = 0u;
        }
    } else { /* as before */
    }
    a->sequence = sample->sequence;
    a->current_A = x->current_A;
}

void cellwise_soh_of(const cellwise_model *m, cellwise_soh *a, cellwise_soh_output *out)
{
    if (!soh_is_sound(a)) {
        cellwise_soh_init(m, a);
    }
    out->share = a->share;
    out->share_variance = a->share_variance;
    out->resistance = a->resistance;
    out->resistance_variance = a->resistance_variance;
}

#endif
