/* Part of cellwise_ekf.c. Tables at one SOC, temperature and current. Printed from src/cellwise/estimate by `python
 * -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_LOOKUP_H
#define CELLWISE_LOOKUP_H

#include "cellwise_offset.h"

/* Where a temperature lies between two tables, and what it does to every resistance. `lag` is the SOC that the
 * particles' surface is below the mean. */
typedef struct {
    uint32_t low;
    float weight;
    float scale;
    float lag;
} cellwise_place;

/* The tables at one SOC and temperature; a gain is 1 - exp(-dt/tau). */
typedef struct {
    float ocv_V;
    float slope_V;
    float noise_V2;
    float r0_ohm;
    float m_V;
    float r1_ohm;
    float r2_ohm;
    float r3_ohm;
    float gain1;
    float gain2;
    float gain3;
} cellwise_point;

/* Slopes over SOC, while it is badly known: of the voltage, the OCV's bend, of the branches. `spread` is the
 * standard deviation of SOC, 0 while it is well known. */
typedef struct {
    float slope_V;
    float bend_V;
    float spread;
    float rise1;
    float rise2;
    float rise3;
} cellwise_slopes;

/* Neighbouring tables of a temperature, and the Arrhenius factor. */
static void place_of(const cellwise_model *m, float temperature_C, cellwise_place *place)
{
    place->low = 0u;
    place->weight = 0.0f;
    place->scale = 1.0f;
    while ((place->low < (CELLWISE_TEMPERATURES - 2u)) && (temperature_C > m->constant.grid_C[place->low + 1u])) {
        place->low = place->low + 1u;
    }
    place->weight = (temperature_C - m->constant.grid_C[place->low]) * m->constant.per_K[place->low];
    place->weight = clip(place->weight, 0.0f, 1.0f);
    const float most = (float)(CELLWISE_ARRHENIUS - 1u);
    float y = (temperature_C - m->constant.arrhenius_low_C) * m->constant.arrhenius_per_K;
    y = clip(y, 0.0f, most);
    uint32_t k = (uint32_t)y;
    if (k > (CELLWISE_ARRHENIUS - 3u)) {
        k = CELLWISE_ARRHENIUS - 3u;
    }
    /* The parabola through three neighbouring points: an exponential bends too much for a line. */
    const float f = y - (float)k;
    const float start = m->constant.arrhenius[k];
    const float first = m->constant.arrhenius[k + 1u] - start;
    const float second = m->constant.arrhenius[k + 2u] - m->constant.arrhenius[k + 1u];
    place->scale = start + (f * (first + ((0.5f * (f - 1.0f)) * (second - first))));
    place->lag = 0.0f;
}

/* The nearer end of 0..1 for a SOC beyond it. */
static float within_one(float soc)
{
    return NOT_NEGATIVE(soc, 1.0f) ? soc : ((soc < 0.5f) ? 0.0f : 1.0f);
}

/* SOC that the particles' surface is below the mean at 1 A and one temperature. */
static float depth_at(const cellwise_constants *c, float temperature_C)
{
    const float most = (float)(CELLWISE_DEPTH - 1u);
    float y = (temperature_C - c->depth_low_C) * c->depth_per_K;
    y = clip(y, 0.0f, most);
    uint32_t k = (uint32_t)y;
    if (k > (CELLWISE_DEPTH - 2u)) {
        k = CELLWISE_DEPTH - 2u;
    }
    const float f = KNOWN_FRACTION(y - (float)k);
    return between(c->depth[k], c->depth[k + 1u], f);
}

/* The same place with the lag of the particles' surface. */
static void under_surface(const cellwise_constants *c, const cellwise_state *x, const cellwise_place *at,
                          float temperature_C, cellwise_place *place)
{
    const float depth = depth_at(c, temperature_C);
    place->lag = clip(depth * x->slow_A, -1.0f, 1.0f);
    place->low = at->low;
    place->weight = at->weight;
    place->scale = at->scale;
}

/* The same place with the resistances that a history gives. */
static void aged(const cellwise_state *x, const cellwise_place *at, cellwise_place *place)
{
    place->low = at->low;
    place->weight = at->weight;
    place->scale = at->scale * x->resistance_scale;
    place->lag = at->lag;
}

/* Temperature of the cell: what was measured last, and its own warming. */
static float warmth_of(const cellwise_state *x)
{
    const float warm_C = x->temperature_C + x->heat_K;
    return warm_C;
}

/* Where the cell's temperature lies between the tables. */
static void place_now(const cellwise_model *m, const cellwise_state *x, cellwise_place *place)
{
    const float warm_C = warmth_of(x);
    cellwise_place here;
    place_of(m, warm_C, &here);
    under_surface(&m->constant, x, &here, warm_C, &here);
    aged(x, &here, &here);
    *place = here;
}

/* Lower point of the SOC interval that holds x, a SOC in units of the grid. */
static uint32_t index_of(float x, uint32_t points)
{
    const float held = (x > 0.0f) ? x : 0.0f;
    const uint32_t k = (held < (float)(points - 2u)) ? (uint32_t)held : (points - 2u);
    return k;
}

/* Outside 0..1 the OCV goes on along its last segment, every other table stays at its end. Without CELLWISE_WIDE the
 * OCV stays, too. With CELLWISE_SURFACE resistances and gains are those of the particles' surface. */
static void look_up(const cellwise_model *m, const cellwise_place *place, float soc, float current,
                    cellwise_point *point)
{
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    const uint32_t points = CELLWISE_POINTS;
    const float x = soc * (float)(points - 1u);
    const uint32_t k = index_of(x, points);
    float f = x - (float)k;
    f = clip(f, -(BEYOND * (float)(points - 1u)), 1.0f + (BEYOND * (float)(points - 1u)));
    const float g = clip(f, 0.0f, 1.0f);
    point->ocv_V = READ(k, ocv_V, f);
    point->slope_V = RISE(k, ocv_V) * (float)(points - 1u);
    const float error_V = READ(k, error_V, g);
    point->noise_V2 = error_variance(m->constant.fixed_V2, error_V, m->constant.ocv_soc2, point->slope_V);
    uint32_t at = k;
    float share = g;
    const float below = within_one(soc - place->lag) * (float)(points - 1u);
    at = index_of(below, points);
    share = KNOWN_FRACTION(below - (float)at);
    point->r0_ohm = READ(at, r0_ohm, share);
    point->r1_ohm = READ(at, r1_ohm, share);
    point->gain1 = 1.0f / READ(at, lag1, share);
    point->r2_ohm = READ(at, r2_ohm, share);
    point->gain2 = 1.0f / READ(at, lag2, share);
    point->r3_ohm = READ(at, r3_ohm, share);
    point->gain3 = 1.0f / READ(at, lag3, share);
    point->m_V = READ(k, m_V, g);
    float scale = place->scale;
    if (current < 0.0f) {
        scale = scale * m->constant.charge_scale;
    }
    point->r3_ohm = point->r3_ohm * scale;
    const float fall = 1.0f + (m->constant.rate_per_A * magnitude(current));
    scale = scale / clip(fall, LEAST_FALL, LARGE);
    point->r0_ohm = point->r0_ohm * scale;
    point->r1_ohm = point->r1_ohm * scale;
    point->r2_ohm = point->r2_ohm * scale;
    const float overvoltage = (m->constant.asinh_per_V * point->r1_ohm) * magnitude(current);
    point->r1_ohm = point->r1_ohm * KNOWN_FRACTION(charge_transfer(at_most(overvoltage, LARGE)));
}

/* SOC is well known: the OCV's tangent, and nothing else. */
static void no_slopes(const cellwise_point *p, cellwise_slopes *slopes)
{
    slopes->slope_V = p->slope_V;
    slopes->bend_V = 0.0f;
    slopes->spread = 0.0f;
    slopes->rise1 = 0.0f;
    slopes->rise2 = 0.0f;
    slopes->rise3 = 0.0f;
}

/* While SOC is badly known slopes are chords over one standard deviation to either side. */
static NOINLINE void slopes_of(const cellwise_model *m, const cellwise_place *place, float soc, float spread,
                               float current, const cellwise_point *p, cellwise_slopes *slopes)
{
    const float low = clip(soc - spread, 0.0f, 1.0f);
    const float high = clip(soc + spread, 0.0f, 1.0f);
    slopes->slope_V = p->slope_V;
    slopes->bend_V = 0.0f;
    slopes->rise1 = 0.0f;
    slopes->rise2 = 0.0f;
    slopes->rise3 = 0.0f;
    if ((high - low) >= SHORTEST_CHORD) {
        const float per = 1.0f / (high - low);
        cellwise_point end;
        look_up(m, place, low, current, &end);
        const float ocv = end.ocv_V;
        const float ohmic = end.r0_ohm;
        slopes->rise1 = end.r1_ohm;
        slopes->rise2 = end.r2_ohm;
        slopes->rise3 = end.r3_ohm;
        look_up(m, place, high, current, &end);
        slopes->rise1 = (end.r1_ohm - slopes->rise1) * per;
        slopes->rise2 = (end.r2_ohm - slopes->rise2) * per;
        slopes->rise3 = (end.r3_ohm - slopes->rise3) * per;
        cellwise_chord chord;
        chord_of(ocv, ohmic, end.ocv_V, end.r0_ohm, per, current, soc - low, p->ocv_V, &chord);
        slopes->slope_V = chord.slope_V;
        slopes->bend_V = chord.bend_V;
    }
    slopes->spread = spread;
}

#endif
