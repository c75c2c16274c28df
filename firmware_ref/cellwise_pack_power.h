/* Part of cellwise_ekf.c. What a pack gives and takes as its weakest cell allows. Printed from src/cellwise/estimate
 * by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_PACK_POWER_H
#define CELLWISE_PACK_POWER_H

#include "cellwise_cells.h"

/* The same place with one cell's resistance. */
static NOINLINE void with_cell(const cellwise_place *at, const cellwise_pack_cell *a, cellwise_place *place)
{
    place->low = at->low;
    place->weight = at->weight;
    place->scale = at->scale * (1.0f + a->resistance);
    place->lag = at->lag;
}

/* The cell that a current over the horizon brings nearest to its limit of voltage. */
static NOINLINE uint32_t weakest(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x,
                                 const cellwise_pack_cell *cells, uint32_t count, float side, float current)
{
    uint32_t found = 0u;
    float least_V = LARGEST_FLOAT;
    for (uint32_t k = 0u; k < count; k++) {
        if (cell_is_sound(&cells[k])) {
            cellwise_place own;
            with_cell(place, &cells[k], &own);
            cellwise_along end;
            ending(m, &own, x, own_soc(x, &cells[k]), side * current, &end);
            const float left_V = side * end.voltage_V;
            if (left_V < least_V) {
                least_V = left_V;
                found = k;
            }
        }
    }
    return found;
}

/* The emptiest cell (`side` 1), or the fullest (-1). */
static NOINLINE uint32_t nearest_to_end(const cellwise_state *x, const cellwise_pack_cell *cells, uint32_t count,
                                        float side)
{
    uint32_t found = 0u;
    float least = LARGEST_FLOAT;
    for (uint32_t k = 0u; k < count; k++) {
        if (cell_is_sound(&cells[k])) {
            const float room = side * own_soc(x, &cells[k]);
            if (room < least) {
                least = room;
                found = k;
            }
        }
    }
    return found;
}

/* What one cell can give (`side` 1) or take (-1) over the horizon. */
static NOINLINE void way_of(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x,
                            const cellwise_pack_cell *a, float side, cellwise_way *way)
{
    const cellwise_constants *const c = &m->constant;
    const float soc = own_soc(x, a);
    const float ss = own_variance(c, x, a);
    cellwise_place own;
    with_cell(place, a, &own);
    const float held_V = (x->v1_V + x->v2_V) + x->v3_V;
    const float worse_V = at_least(side * (a->resistance * held_V), 0.0f);
    float limit_V = c->power_low_V;
    float most_A = c->power_discharge_A;
    float room = soc - c->power_soc_low;
    if (side < 0.0f) {
        limit_V = c->power_high_V;
        most_A = c->power_charge_A;
        room = c->power_soc_high - soc;
    }
    limit_V = limit_V + (side * worse_V);
    cellwise_way one;
    one_way(m, &own, x, soc, ss, side, limit_V, most_A, room, &one);
    *way = one;
}

/* Power of the pack one way: the least of what its weakest cells allow. These are the cell that is nearest to its
 * end, the one whose voltage is at the largest current, and the one whose voltage is at the current that these two
 * allow. */
static NOINLINE void pack_way(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x,
                              const cellwise_pack_cell *cells, uint32_t count, float side, cellwise_way *way)
{
    const cellwise_constants *const c = &m->constant;
    way->current_A = (side > 0.0f) ? c->power_discharge_A : c->power_charge_A;
    way->low_W = LARGEST_FLOAT;
    for (uint32_t turn = 0u; turn < THREE_CELLS; turn++) {
        uint32_t at = nearest_to_end(x, cells, count, side);
        if (turn != 0u) {
            at = weakest(m, place, x, cells, count, side, way->current_A);
        }
        cellwise_way one;
        way_of(m, place, x, &cells[at], side, &one);
        if (one.current_A < way->current_A) {
            way->current_A = one.current_A;
        }
        if (one.low_W < way->low_W) {
            way->low_W = one.low_W;
        }
    }
    cellwise_along end;
    ending(m, place, x, x->soc, side * way->current_A, &end);
    const float many = (float)count;
    way->power_W = at_least(many * (way->current_A * end.voltage_V), 0.0f);
    way->low_W = many * way->low_W;
    if (way->low_W > way->power_W) {
        way->low_W = way->power_W;
    }
}

void cellwise_pack_power(const cellwise_model *m, const cellwise_state *x, const cellwise_pack_cell *cells,
                         uint32_t count, cellwise_capability *out)
{
    out->discharge_W = 0.0f;
    out->discharge_low_W = 0.0f;
    out->charge_W = 0.0f;
    out->charge_low_W = 0.0f;
    if ((count != 0u) && is_sound(&m->constant, x)) {
        cellwise_place place;
        place_now(m, x, &place);
        cellwise_way down;
        pack_way(m, &place, x, cells, count, 1.0f, &down);
        cellwise_way up;
        pack_way(m, &place, x, cells, count, -1.0f, &up);
        out->discharge_W = down.power_W;
        out->discharge_low_W = down.low_W;
        out->charge_W = up.power_W;
        out->charge_low_W = up.low_W;
    }
}

#endif
