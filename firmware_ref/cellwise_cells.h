/* Part of cellwise_ekf.c. Cells of a pack on one table: their difference from the mean cell. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_CELLS_H
#define CELLWISE_CELLS_H

#include "cellwise_plan.h"

/* Derivatives of a cell's voltage minus the mean's, and its variance about that. `single_V2` is that of one sample,
 * `variance_V2` of one that shares its error with others. */
typedef struct {
    float soc_V;
    float capacity_V;
    float resistance_V;
    float single_V2;
    float variance_V2;
} cellwise_difference;

/* Every number in its range: memory that lost its content, or was never set, is noticed. */
static bool cell_is_sound(const cellwise_pack_cell *a)
{
    if (!(SIZE_WITHIN(a->soc, 1.0f) && SIZE_WITHIN(a->capacity, CELL_MOST))) { return false; }
    if (!WITHIN(a->resistance, -CELL_MOST, SCALE_MOST)) { return false; }
    if (!(NOT_NEGATIVE(a->ss, LARGE) && NOT_NEGATIVE(a->qq, LARGE) && NOT_NEGATIVE(a->rr, LARGE))) { return false; }
    return SIZE_WITHIN(a->sq, LARGE) && SIZE_WITHIN(a->sr, LARGE) && SIZE_WITHIN(a->qr, LARGE);
}

/* A cell of which only is known how far cells usually differ. */
static NOINLINE void start_cell(const cellwise_constants *c, cellwise_pack_cell *a)
{
    a->soc = 0.0f;
    a->capacity = 0.0f;
    a->resistance = 0.0f;
    a->ss = c->cell_soc2;
    a->sq = 0.0f;
    a->sr = 0.0f;
    a->qq = c->cell_capacity2;
    a->qr = 0.0f;
    a->rr = c->cell_resistance2;
    a->seen_at = 0u;
    a->rejections = 0u;
    a->status = 0u;
}

void cellwise_cells_init(const cellwise_model *m, cellwise_pack_cell *cells, uint32_t count)
{
    for (uint32_t k = 0u; k < count; k++) {
        start_cell(&m->constant, &cells[k]);
    }
}

float cellwise_mean_voltage(const cellwise_model *m, const cellwise_pack_cell *cells, const float *voltage_V,
                            uint32_t count)
{
    const cellwise_constants *const c = &m->constant;
    float first = -1.0f;
    float total = 0.0f;
    float unsure = 0.0f;
    uint32_t used = 0u;
    uint32_t left_out = 0u;
    for (uint32_t k = 0u; k < count; k++) {
        if (WITHIN(voltage_V[k], c->voltage_low_V, c->voltage_high_V)) {
            if (first < 0.0f) {
                first = voltage_V[k];
            }
            if (cells[k].rejections == 0u) {
                total = total + (voltage_V[k] - first);
                used = used + 1u;
            } else {
                unsure = unsure + (voltage_V[k] - first);
                left_out = left_out + 1u;
            }
        }
    }
    if (left_out >= used) {
        total = total + unsure;
        used = used + left_out;
    }
    if (used != 0u) {
        first = first + (total / (float)used);
    }
    return first;
}

/* The derivatives at the mean cell's SOC. A cell that is polled late reads what the mean voltage moved by meanwhile. */
static void difference_of(const cellwise_model *m, const cellwise_place *place, const cellwise_state *x, float mean_V,
                          cellwise_difference *difference)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_point p;
    look_up(m, place, x->soc, x->current_A, &p);
    const float moved_V = mean_V - x->mean_V;
    difference->single_V2 = c->cell_V2 + (c->cell_lag * (moved_V * moved_V));
    difference->variance_V2 = difference->single_V2 * c->cell_shared;
    difference->capacity_V = p.slope_V * (0.5f - x->soc);
    difference->resistance_V = mean_V - p.ocv_V;
    difference->soc_V = p.slope_V;
}

/* After many rejections in a row a cell's SOC is unknown. */
static NOINLINE void look_again(cellwise_pack_cell *a)
{
    a->ss = RECOVERY_VARIANCE;
    a->sq = 0.0f;
    a->sr = 0.0f;
    a->rejections = 0u;
    a->status = a->status | CELLWISE_GATE_RECOVERY;
}

/* Use a cell's voltage above the mean: three states, one measurement. */
static void use_voltage(const cellwise_constants *c, cellwise_pack_cell *a, const cellwise_difference *d, float above_V)
{
    const float gain_s = ((a->ss * d->soc_V) + (a->sq * d->capacity_V)) + (a->sr * d->resistance_V);
    const float gain_q = ((a->sq * d->soc_V) + (a->qq * d->capacity_V)) + (a->qr * d->resistance_V);
    const float gain_r = ((a->sr * d->soc_V) + (a->qr * d->capacity_V)) + (a->rr * d->resistance_V);
    float explained_V2 = (d->soc_V * gain_s) + ((d->capacity_V * gain_q) + (d->resistance_V * gain_r));
    explained_V2 = at_least(explained_V2, 0.0f);
    const float said_V = ((d->soc_V * a->soc) + (d->capacity_V * a->capacity)) + (d->resistance_V * a->resistance);
    const float off_V = above_V - said_V;
    if ((off_V * off_V) > (c->gate_square * (explained_V2 + d->single_V2))) {
        a->status = a->status | CELLWISE_INNOVATION_REJECTED;
        if (a->rejections < c->cell_recovery) {
            a->rejections = a->rejections + 1u;
        } else {
            look_again(a);
        }
    } else {
        a->rejections = 0u;
        const float per = 1.0f / (explained_V2 + d->variance_V2);
        a->soc = clip(a->soc + (gain_s * (off_V * per)), -1.0f, 1.0f);
        a->capacity = clip(a->capacity + (gain_q * (off_V * per)), -CELL_MOST, CELL_MOST);
        a->resistance = clip(a->resistance + (gain_r * (off_V * per)), -CELL_MOST, SCALE_MOST);
        a->ss = at_least(a->ss - (gain_s * (gain_s * per)), c->cell_least_soc2);
        a->sq = a->sq - (gain_s * (gain_q * per));
        a->sr = a->sr - (gain_s * (gain_r * per));
        a->qq = at_least(a->qq - (gain_q * (gain_q * per)), VARIANCE_FLOOR);
        a->qr = a->qr - (gain_q * (gain_r * per));
        a->rr = at_least(a->rr - (gain_r * (gain_r * per)), VARIANCE_FLOOR);
    }
}

/* One cell in its turn: it has drifted from the mean, then its voltage is used. */
static void step_cell(const cellwise_constants *c, cellwise_pack_cell *a, const cellwise_difference *d,
                      float voltage_V, float mean_V, uint32_t sequence)
{
    const float steps = (float)(sequence - a->seen_at);
    if (cell_is_sound(a)) {
        a->status = 0u;
    } else {
        start_cell(c, a);
        a->status = CELLWISE_STATE_RESET;
    }
    a->ss = clip(a->ss + (steps * c->cell_soc_walk), 0.0f, SOC_VARIANCE_MOST);
    a->qq = clip(a->qq + (steps * c->cell_capacity_walk), 0.0f, SOC_VARIANCE_MOST);
    a->rr = clip(a->rr + (steps * c->cell_resistance_walk), 0.0f, SOC_VARIANCE_MOST);
    a->seen_at = sequence;
    if (WITHIN(voltage_V, c->voltage_low_V, c->voltage_high_V)) {
        use_voltage(c, a, d, voltage_V - mean_V);
    } else {
        a->status = a->status | CELLWISE_VOLTAGE_INVALID;
    }
}

void cellwise_cells_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *sample,
                         cellwise_pack_cell *cells, const float *voltage_V, uint32_t count)
{
    const cellwise_constants *const c = &m->constant;
    const float mean_V = sample->voltage_V;
    const bool there = WITHIN(mean_V, c->voltage_low_V, c->voltage_high_V);
    const uint32_t elapsed = sample->sequence - x->cells_at;
    if (there && (x->evidence > NO_VOLTAGE_YET) && (elapsed != 0u) && is_sound(c, x)) {
        cellwise_place place;
        place_now(m, x, &place);
        if (!(x->mean_V > 0.0f)) {
            x->mean_V = mean_V;
        }
        cellwise_difference d;
        difference_of(m, &place, x, mean_V, &d);
        uint32_t due = x->turn;
        for (uint32_t k = 0u; k < count; k++) {
            if (k == due) {
                step_cell(c, &cells[k], &d, voltage_V[k], mean_V, sample->sequence);
                due = due + c->cell_turns;
            }
        }
        x->turn = ((x->turn + 1u) < c->cell_turns) ? (x->turn + 1u) : 0u;
        x->mean_V = mean_V;
        x->cells_at = sample->sequence;
    }
}

/* SOC of one cell. */
static float own_soc(const cellwise_state *x, const cellwise_pack_cell *a)
{
    return clip(x->soc + (a->soc + (a->capacity * (0.5f - x->soc))), 0.0f, 1.0f);
}

/* Variance of one cell's SOC: the mean's and its difference's. */
static float own_variance(const cellwise_constants *c, const cellwise_state *x, const cellwise_pack_cell *a)
{
    const float away = 0.5f - x->soc;
    const float difference2 = a->ss + (away * ((2.0f * a->sq) + (away * a->qq)));
    return x->ss + at_least(difference2, c->cell_least_soc2);
}

void cellwise_cell_of(const cellwise_model *m, const cellwise_state *x, const cellwise_pack_cell *a,
                      cellwise_cell_output *out)
{
    const cellwise_constants *const c = &m->constant;
    if (is_sound(c, x) && cell_is_sound(a)) {
        out->soc = own_soc(x, a);
        out->soc_variance = own_variance(c, x, a);
        out->capacity_share = 1.0f + a->capacity;
        out->capacity_variance = a->qq;
        out->resistance_scale = 1.0f + a->resistance;
        out->resistance_variance = a->rr;
        out->status = a->status;
    } else {
        out->soc = KNOW_NOTHING_SOC;
        out->soc_variance = KNOW_NOTHING_VARIANCE;
        out->capacity_share = 1.0f;
        out->capacity_variance = c->cell_capacity2;
        out->resistance_scale = 1.0f;
        out->resistance_variance = c->cell_resistance2;
        out->status = CELLWISE_STATE_RESET;
    }
}

#endif
