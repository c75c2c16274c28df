/* Part of cellwise_ekf.c. What becomes of a voltage: gate, recovery, weight, what contradicts the count. Printed
 * from src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_WEIGHING_H
#define CELLWISE_WEIGHING_H

#include "cellwise_lookup.h"

/* The voltage that the state gives at a point of the tables [V]. */
static float voltage_at(const cellwise_state *x, const cellwise_point *p, float drop)
{
    const float voltage = ((((p->ocv_V - drop) - x->v1_V) - x->v2_V) - x->v3_V) + (p->m_V * x->h);
    return voltage;
}

/* What the state says of the next voltage, before it is looked at. `variance_V2` is that of a single innovation,
 * `explained_V2` what the state brings to it and `single_V2` what the voltage; `slope_V` is the voltage's over SOC,
 * `column` P H'. One deviation of an offset moves the voltage by `of_offset_V`, all that is believed of offset (and
 * capacity) has moved it by `bias_V`. */
typedef struct {
    float voltage_V;
    float variance_V2;
    float explained_V2;
    float single_V2;
    float slope_V;
    float of_offset_V;
    float bias_V;
    cellwise_column column;
} cellwise_innovation;

/* What becomes of a voltage: a rejected one only moves the counts. After too long a time of them in a row the state
 * `recovers`: the SOC is open again. `shown` is the mismatch in units of `unit`, which `weight_of` takes. */
typedef struct {
    bool accepted;
    bool recovers;
    uint32_t rejections;
    float shown;
    float unit;
    float mismatch;
    uint32_t status;
} cellwise_verdict;

/* CW-008. Gate and count one innovation. It moves the running mismatch by `lately` and counts as a rejection for
 * `turn`. */
static void judge(const cellwise_constants *c, const cellwise_state *x, const cellwise_innovation *innovation,
                  float innovation_V, float lately, uint32_t turn, cellwise_verdict *verdict)
{
    const float square = innovation_V * innovation_V;
    const float own_V2 = innovation->explained_V2 + innovation->single_V2;
    verdict->unit = unit_of(own_V2);
    /* one counts for so much at most */
    const float most = at_most(in_units(square, own_V2), c->mismatch_cap * verdict->unit);
    verdict->shown = lately_shown(x->mismatch * verdict->unit, most, lately);
    verdict->mismatch = verdict->shown / verdict->unit;
    verdict->accepted = !POSITIVE_ABOVE(square, c->gate_square * innovation->variance_V2);
    verdict->recovers = false;
    verdict->rejections = 0u;
    verdict->status = 0u;
    if (!verdict->accepted) {
        verdict->status = CELLWISE_INNOVATION_REJECTED;
        verdict->rejections = x->rejections + turn;
        if (verdict->rejections >= c->recovery_after) {
            verdict->recovers = true;
            verdict->status = CELLWISE_INNOVATION_REJECTED | CELLWISE_GATE_RECOVERY;
            verdict->rejections = 0u;
            verdict->mismatch = 1.0f;
        }
    }
}

/* One over the variance that weighs an accepted voltage. What the innovations have lately shown beyond their
 * variance makes evidence weigh less. */
static float weight_of(const cellwise_innovation *innovation, float shown, float unit, const cellwise_shared *shared)
{
    const float of_single = innovation->single_V2 * shared->above;
    float weight = unit * of_single;
    if (POSITIVE_ABOVE(shown, unit)) {
        weight = shown * of_single;
    }
    return inverse_weight(innovation->explained_V2, weight, unit * shared->below);
}

/* SOC that the voltages say is missing, were the current off for all of the time `since`. */
static float contradicted_after(const cellwise_constants *c, const cellwise_state *x,
                                const cellwise_innovation *innovation, float innovation_V, float since)
{
    const float drift = c->drift_soc * since;
    return contradicted_step(x->contradicted, innovation_V, innovation->slope_V, innovation->single_V2, drift,
                             c->contradicted_share);
}

/* SOC error by a persistent error of the model, after a voltage with a `gain` of the SOC. */
static float persistent_after(const cellwise_constants *c, const cellwise_state *x,
                              const cellwise_innovation *innovation, float error_V2, float mismatch, float gain)
{
    const float error_V = persistent_V(c->persistent, error_V2, mismatch);
    return persistent_step(gain, innovation->slope_V, x->persistent, error_V);
}

#endif
