/* Part of cellwise_ekf.c. Where a temperature and a SOC lie between the tables. Printed from src/cellwise/estimate
 * by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_PLACE_H
#define CELLWISE_PLACE_H

#include "cellwise_start.h"

/* Where a temperature lies between two tables, and what it does to every resistance. `lag` is the SOC that the
 * particles' surface is below the mean. */
typedef struct {
    uint32_t low;
    float weight;
    float scale;
    float lag;
} cellwise_place;

/* Where a SOC lies between two points of the tables. `beyond` is the fraction for the OCV, which goes on outside
 * 0..1, `within` that for the others; `at` and `share` are those of the particles' surface. */
typedef struct {
    uint32_t k;
    float beyond;
    float within;
    uint32_t at;
    float share;
} cellwise_socplace;

/* Resistances at one SOC, temperature and current. */
typedef struct {
    float r0_ohm;
    float r1_ohm;
    float r2_ohm;
    float r3_ohm;
} cellwise_loaded;

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
static float effective_temperature(const cellwise_state *x)
{
    const float temperature_C = x->temperature_C + x->heat_K;
    return temperature_C;
}

/* Where the cell's temperature lies between the tables. */
static void place_now(const cellwise_model *m, const cellwise_state *x, cellwise_place *place)
{
    const float effective_temperature_C = effective_temperature(x);
    cellwise_place here;
    place_of(m, effective_temperature_C, &here);
    under_surface(&m->constant, x, &here, effective_temperature_C, &here);
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
static void soc_place(const cellwise_place *place, uint32_t points, float soc, cellwise_socplace *socplace)
{
    const float x = soc * (float)(points - 1u);
    socplace->k = index_of(x, points);
    socplace->beyond = x - (float)socplace->k;
    socplace->beyond = clip(socplace->beyond, -(BEYOND * (float)(points - 1u)), 1.0f + (BEYOND * (float)(points - 1u)));
    socplace->within = clip(socplace->beyond, 0.0f, 1.0f);
    socplace->at = socplace->k;
    socplace->share = socplace->within;
    const float below = within_one(soc - place->lag) * (float)(points - 1u);
    socplace->at = index_of(below, points);
    socplace->share = KNOWN_FRACTION(below - (float)socplace->at);
}

#endif
