/* Part of cellwise_ekf.c. What is known of capacity and resistance, and whether that is sound. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_RECORD_H
#define CELLWISE_RECORD_H

#include "cellwise_pack_power.h"

/* SOC of a cell at rest by its OCV, and the variance of that. */
typedef struct {
    float soc;
    float variance;
} cellwise_restedsoc;

/* Of a pair of rests for the share and the offset; `total` is the variance of its count. */
typedef struct {
    float total;
    float share;
    float off;
} cellwise_weight;

/* Nothing is known of the capacity, nor of an offset, but what is usual. */
static void forget_share(cellwise_soh *a)
{
    a->share_variance = SOH_VARIANCE;
    a->off = 0.0f;
    a->qq = SOH_VARIANCE;
    a->qo = 0.0f;
    a->oo = CHANCE;
    a->own_qq = SOH_VARIANCE;
    a->own_qo = 0.0f;
    a->own_oo = CHANCE;
    a->share_error = 0.0f;
    a->off_error = 0.0f;
    a->refused = 0u;
}

/* Nothing is known of the resistances but what is usual. */
static void forget_resistance(cellwise_soh *a)
{
    a->resistance = 1.0f;
    a->rr = SOH_RESISTANCE;
    a->resistance_variance = SOH_RESISTANCE;
}

/* Count from a rest; a variance of 0: from none. */
static void begin_at_rest(cellwise_soh *a, float soc, float variance)
{
    a->soc = soc;
    a->variance = variance;
    a->counted = 0.0f;
    a->counted_carry = 0.0f;
    a->unsure = 0.0f;
    a->counted_from = a->sequence;
}

/* What is stated of the share: beside the pairs' error, that of the OCV and of the model. The model's capacity is
 * that of another sample: by as much a share of it may be none of what this cell had when it was new, however many
 * pairs there are. */
static void state_variance(const cellwise_constants *c, cellwise_soh *a)
{
    const float model = a->share * c->soh_capacity;
    const float error = a->own_qq + ((a->share_error * a->share_error) + (model * model));
    a->share_variance = at_most(error, SOH_VARIANCE);
}

/* What has flowed may have aged the cell. */
static void age(const cellwise_constants *c, cellwise_soh *a)
{
    const float more = SOH_WALK * a->moved;
    a->rr = at_most(a->rr + (SOH_RESISTANCE_WALK * a->moved), SOH_RESISTANCE);
    a->qq = at_most(a->qq + more, SOH_VARIANCE);
    a->own_qq = at_most(a->own_qq + more, SOH_VARIANCE);
    state_variance(c, a);
    a->moved = 0.0f;
}

void cellwise_soh_init(const cellwise_model *m, cellwise_soh *a)
{
    (void)m;
    a->share = 1.0f;
    forget_share(a);
    forget_resistance(a);
    a->moved = 0.0f;
    a->sequence = 0u;
    begin_at_rest(a, 0.0f, 0.0f);
    a->current_A = 0.0f;
    a->voltage_V = 0.0f;
    a->held_V = 0.0f;
    a->loaded = 0u;
    a->silent = 0u;
    a->pairs = 0u;
    a->loads = 0u;
    a->watched = 0u;
    a->rest_end = 0u;
    a->begun = 0u;
}

/* Every number in its range: memory that lost its content, or was never set, is noticed. */
static bool soh_is_sound(const cellwise_soh *a)
{
    if (!POSITIVE_WITHIN(a->share, LEAST_SHARE, MOST_SHARE)) { return false; }
    if (!(NOT_NEGATIVE(a->share_variance, LARGE) && SIZE_WITHIN(a->off, REACH_MOST))) { return false; }
    if (!(POSITIVE_WITHIN(a->qq, VARIANCE_FLOOR, 1.0f) && SIZE_WITHIN(a->qo, 1.0f))) { return false; }
    if (!(POSITIVE_WITHIN(a->oo, VARIANCE_FLOOR, 1.0f) && SIZE_WITHIN(a->share_error, REACH_MOST))) { return false; }
    if (!(POSITIVE_WITHIN(a->own_qq, VARIANCE_FLOOR, 1.0f) && SIZE_WITHIN(a->own_qo, 1.0f))) { return false; }
    if (!POSITIVE_WITHIN(a->own_oo, VARIANCE_FLOOR, 1.0f)) { return false; }
    if (!(SIZE_WITHIN(a->off_error, REACH_MOST) && NOT_NEGATIVE(a->soc, 1.0f))) { return false; }
    if (!(NOT_NEGATIVE(a->variance, 1.0f) && SIZE_WITHIN(a->counted, REACH_MOST))) { return false; }
    if (!(SIZE_WITHIN(a->counted_carry, CARRY_MOST) && NOT_NEGATIVE(a->moved, SINCE_MOST))) { return false; }
    if (!(NOT_NEGATIVE(a->unsure, 1.0f) && SIZE_WITHIN(a->current_A, LARGE))) { return false; }
    if (!(POSITIVE_WITHIN(a->rr, VARIANCE_FLOOR, 1.0f) && NOT_NEGATIVE(a->held_V, LARGE))) { return false; }
    if (!(NOT_NEGATIVE(a->resistance_variance, LARGE) && NOT_NEGATIVE(a->voltage_V, LARGE))) { return false; }
    return POSITIVE_WITHIN(a->resistance, LEAST_SCALE, MOST_SCALE);
}

#endif
