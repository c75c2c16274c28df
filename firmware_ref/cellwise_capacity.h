/* Part of cellwise_ekf.c. What a pair of rests far apart says of the capacity. Printed from src/cellwise/estimate by
 * `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_CAPACITY_H
#define CELLWISE_CAPACITY_H

#include "cellwise_record.h"

/* Where the OCV has a voltage, within 0..1: halved down to a millionth. With a `side` of 1 or -1 the OCV is higher
 * or lower by the deviation that the model states there, and `more_V2`. */
static float soc_of_ocv(const cellwise_model *m, const cellwise_place *place, float ocv_V, float side, float more_V2)
{
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    const uint32_t points = CELLWISE_POINTS;
    float below = 0.0f;
    float above = 1.0f;
    for (uint32_t k = 0u; k < 20u; k++) {
        const float middle = 0.5f * (below + above);
        cellwise_socplace z;
        soc_place(place, points, middle, &z);
        const float error_V = READ(z.k, error_V, z.within);
        const float off_V = side * root(at_most((error_V * error_V) + more_V2, 4.0f)); /* as far as it takes */
        if ((READ(z.k, ocv_V, z.beyond) + off_V) < ocv_V) {
            below = middle;
        } else {
            above = middle;
        }
    }
    return 0.5f * (below + above);
}

/* The SOC that the last voltage of a rest says. What the branches still hold is part of its error: they were
 * corrected by voltages that the capacity has moved, and say nothing independent of it. Its deviation is the way to
 * where the voltage is one of the OCV's deviations off, the longer one: beside a plateau no slope says it. */
static NOINLINE void rested(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x,
                            const cellwise_soh *a, cellwise_restedsoc *restedsoc)
{
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    const cellwise_constants *const c = &m->constant;
    const uint32_t points = CELLWISE_POINTS;
    float ocv_V = a->voltage_V;
    cellwise_socplace before;
    soc_place(place, points, x->soc, &before);
    ocv_V = ocv_V - (READ(before.k, m_V, before.within) * x->h);
    restedsoc->soc = soc_of_ocv(m, place, ocv_V, 0.0f, 0.0f);
    cellwise_socplace z;
    soc_place(place, points, restedsoc->soc, &z);
    const float missed_V = ocv_V - READ(z.k, ocv_V, z.beyond);
    float more_V2 = c->fixed_V2 + ((a->held_V * a->held_V) + (missed_V * missed_V));
    const float m_V = READ(z.k, m_V, z.within);
    more_V2 = more_V2 + ((m_V * m_V) * x->phh);
    const float beyond_V = extrapolated(c, x, 0.0f, a->held_V);
    more_V2 = more_V2 + (beyond_V * beyond_V);
    const float above = soc_of_ocv(m, place, ocv_V, -1.0f, more_V2) - restedsoc->soc;
    const float below = restedsoc->soc - soc_of_ocv(m, place, ocv_V, 1.0f, more_V2);
    const float wide = (above > below) ? above : below;
    restedsoc->variance = clip((wide * wide) + c->ocv_soc2, VARIANCE_FLOOR, 1.0f);
}

/* What a pair of rests weighs: errors of the OCV as if each pair had its own. */
static void weigh_pair(const cellwise_soh *a, float far, float gone, float count_soc2, float both_soc2,
                       cellwise_weight *weight)
{
    const float qh = (a->qq * far) + (a->qo * gone);
    const float oh = (a->qo * far) + (a->oo * gone);
    weight->total = ((far * qh) + (gone * oh)) + (count_soc2 + both_soc2);
    const float per = 1.0f / weight->total;
    weight->share = qh * per;
    weight->off = oh * per;
}

/* A pair of rests: counted = share far + off gone. `count_soc2` is the variance of the count, `both_soc2` that of
 * both OCVs. Two covariances: one weighs, as if each pair had an error of the OCV of its own; of what is stated the
 * other one is the part beside that error. */
static void use_pair(const cellwise_constants *c, cellwise_soh *a, float far, float gone, float counted,
                     float count_soc2, float both_soc2)
{
    cellwise_weight w;
    weigh_pair(a, far, gone, count_soc2, both_soc2, &w);
    const float missed = counted - ((a->share * far) + (a->off * gone));
    if ((missed * missed) > (c->gate_square * w.total)) {
        a->refused = a->refused + 1u;
        if (a->refused >= SOH_REFUSED) {
            forget_share(a);
        }
    } else {
        a->share = clip(a->share + (w.share * missed), LEAST_SHARE, MOST_SHARE);
        a->off = clip(a->off + (w.off * missed), -REACH_MOST, REACH_MOST);
        a->qq = clip(a->qq - ((w.share * w.share) * w.total), VARIANCE_FLOOR, 1.0f);
        a->qo = clip(a->qo - ((w.share * w.off) * w.total), -1.0f, 1.0f);
        a->oo = clip(a->oo - ((w.off * w.off) * w.total), VARIANCE_FLOOR, 1.0f);
        /* (I - K H) own (I - K H)' + K K' count_soc2 */
        const float qh = (a->own_qq * far) + (a->own_qo * gone);
        const float oh = (a->own_qo * far) + (a->own_oo * gone);
        const float whole = ((far * qh) + (gone * oh)) + count_soc2;
        const float qq = (a->own_qq - ((2.0f * w.share) * qh)) + ((w.share * w.share) * whole);
        const float qo = (a->own_qo - ((w.share * oh) + (w.off * qh))) + ((w.share * w.off) * whole);
        const float oo = (a->own_oo - ((2.0f * w.off) * oh)) + ((w.off * w.off) * whole);
        a->own_qq = clip(qq, VARIANCE_FLOOR, 1.0f);
        a->own_qo = clip(qo, -1.0f, 1.0f);
        a->own_oo = clip(oo, VARIANCE_FLOOR, 1.0f);
        const float more = root(both_soc2) - ((far * a->share_error) + (gone * a->off_error));
        a->share_error = clip(a->share_error + (w.share * more), -1.0f, 1.0f);
        a->off_error = clip(a->off_error + (w.off * more), -REACH_MOST, REACH_MOST);
        state_variance(c, a);
        a->refused = 0u;
        a->pairs = a->pairs + 1u;
    }
}

/* A long rest is over: its SOC, and with the rest that was counted from what that shows. A rest that is near is
 * passed over, until the count from the older one is worse than both OCVs. A pair is taken from the lower to the
 * higher rest, so that an error of the table is the same in every pair, either way. */
static NOINLINE void end_rest(const cellwise_model *m, const cellwise_state *x, cellwise_soh *a)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_place place;
    place_now(m, x, &place);
    cellwise_restedsoc now;
    rested(m, &place, x, a, &now);
    if (now.variance <= SOH_SOC_VARIANCE) {
        age(c, a);
        const float steps = (float)(a->sequence - a->counted_from);
        const float drift = steps * c->soh_drift;
        const float both_soc2 = a->variance + now.variance;
        const float count_soc2 = a->unsure + (steps * c->soc_walk);
        const float offset_soc2 = a->oo * (drift * drift);
        const float apart = now.soc - a->soc;
        const float side = (apart > 0.0f) ? 1.0f : -1.0f;
        const float far = side * apart;
        if ((a->variance > 0.0f) && (far >= SOH_APART)) {
            use_pair(c, a, far, -(side * drift), -(side * a->counted), count_soc2, both_soc2);
            begin_at_rest(a, now.soc, now.variance);
        } else if (!(a->variance > 0.0f) || ((count_soc2 + offset_soc2) > both_soc2)) {
            begin_at_rest(a, now.soc, now.variance);
        } else { /* as before */
        }
    }
}

#endif
