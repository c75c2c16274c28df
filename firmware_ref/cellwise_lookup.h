/* Part of cellwise_ekf.c. Tables at one SOC, temperature and current. Printed from src/cellwise/estimate by `python
 * -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_LOOKUP_H
#define CELLWISE_LOOKUP_H

#include "cellwise_place.h"

/* Resistances by temperature, age and current. */
static INLINED void resistances_at(const cellwise_model *m, const cellwise_place *place, const cellwise_socplace *z,
                                   float current, cellwise_loaded *loaded)
{
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    loaded->r0_ohm = READ(z->at, r0_ohm, z->share);
    loaded->r1_ohm = READ(z->at, r1_ohm, z->share);
    loaded->r2_ohm = READ(z->at, r2_ohm, z->share);
    loaded->r3_ohm = READ(z->at, r3_ohm, z->share);
    float scale = place->scale;
    if (current < 0.0f) {
        scale = scale * m->constant.charge_scale;
    }
    loaded->r3_ohm = loaded->r3_ohm * scale;
    const float fall = 1.0f + (m->constant.rate_per_A * magnitude(current));
    scale = scale / clip(fall, LEAST_FALL, LARGE);
    loaded->r0_ohm = loaded->r0_ohm * scale;
    loaded->r1_ohm = loaded->r1_ohm * scale;
    loaded->r2_ohm = loaded->r2_ohm * scale;
    const float overvoltage = (m->constant.asinh_per_V * loaded->r1_ohm) * magnitude(current);
    loaded->r1_ohm = loaded->r1_ohm * KNOWN_FRACTION(charge_transfer(at_most(overvoltage, LARGE)));
}

/* All of the tables. */
static void look_up(const cellwise_model *m, const cellwise_place *place, float soc, float current,
                    cellwise_point *point)
{
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    const uint32_t points = CELLWISE_POINTS;
    cellwise_socplace z;
    soc_place(place, points, soc, &z);
    point->ocv_V = READ(z.k, ocv_V, z.beyond);
    point->slope_V = RISE(z.k, ocv_V) * (float)(points - 1u);
    const float error_V = READ(z.k, error_V, z.within);
    point->noise_V2 = error_variance(m->constant.fixed_V2, error_V, m->constant.ocv_soc2, point->slope_V);
    point->gain1 = 1.0f / READ(z.at, lag1, z.share);
    point->gain2 = 1.0f / READ(z.at, lag2, z.share);
    point->gain3 = 1.0f / READ(z.at, lag3, z.share);
    point->m_V = READ(z.k, m_V, z.within);
    cellwise_loaded under;
    resistances_at(m, place, &z, current, &under);
    point->r0_ohm = under.r0_ohm;
    point->r1_ohm = under.r1_ohm;
    point->r2_ohm = under.r2_ohm;
    point->r3_ohm = under.r3_ohm;
}

/* What a load at a SOC does to the slow branch. */
static void slow_branch(const cellwise_model *m, const cellwise_place *place, float soc, float current,
                        cellwise_slowbranch *slowbranch)
{
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    cellwise_socplace z;
    soc_place(place, CELLWISE_POINTS, soc, &z);
    cellwise_loaded under;
    resistances_at(m, place, &z, current, &under);
    slowbranch->gain3 = 1.0f / READ(z.at, lag3, z.share);
    slowbranch->r3_ohm = under.r3_ohm;
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
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    const float low_soc = clip(soc - spread, 0.0f, 1.0f);
    const float high_soc = clip(soc + spread, 0.0f, 1.0f);
    slopes->slope_V = p->slope_V;
    slopes->bend_V = 0.0f;
    slopes->rise1 = 0.0f;
    slopes->rise2 = 0.0f;
    slopes->rise3 = 0.0f;
    if ((high_soc - low_soc) >= SHORTEST_CHORD) {
        const float per = 1.0f / (high_soc - low_soc);
        cellwise_socplace z;
        soc_place(place, CELLWISE_POINTS, low_soc, &z);
        const float low_V = READ(z.k, ocv_V, z.beyond);
        cellwise_loaded end;
        resistances_at(m, place, &z, current, &end);
        const float ohmic = end.r0_ohm;
        slopes->rise1 = end.r1_ohm;
        slopes->rise2 = end.r2_ohm;
        slopes->rise3 = end.r3_ohm;
        soc_place(place, CELLWISE_POINTS, high_soc, &z);
        const float high_V = READ(z.k, ocv_V, z.beyond);
        resistances_at(m, place, &z, current, &end);
        slopes->rise1 = (end.r1_ohm - slopes->rise1) * per;
        slopes->rise2 = (end.r2_ohm - slopes->rise2) * per;
        slopes->rise3 = (end.r3_ohm - slopes->rise3) * per;
        cellwise_chord chord;
        chord_of(low_V, ohmic, high_V, end.r0_ohm, per, current, soc - low_soc, p->ocv_V, &chord);
        slopes->slope_V = chord.slope_V;
        slopes->bend_V = chord.bend_V;
    }
    slopes->spread = spread;
}

#endif
