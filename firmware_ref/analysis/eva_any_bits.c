/* Frama-C Eva: whatever bits stand in state and input, a step has no undefined behaviour and its
 * outputs are finite and in range; nor has the step after it. */
#include "cellwise_cell.h"
#include "cellwise_soh.h"

#define WORDS (sizeof(cellwise_state) / sizeof(float))

volatile float any_float; /* to Eva: every bit pattern, NaN and infinities too */
volatile uint32_t any_integer;

static void any_state(cellwise_state *x)
{
    float *const field = (float *)x;
    /*@ loop unroll WORDS; */
    for (uint32_t k = 0u; k < WORDS; k++) {
        field[k] = any_float;
    }
#if CELLWISE_WIDE
    x->repeats = any_integer;
    x->no_current = any_integer;
    x->no_voltage = any_integer;
#endif
#if CELLWISE_BANK
    x->in_bank = any_integer;
#endif
#if CELLWISE_CELLS
    x->cells_at = any_integer;
    x->turn = any_integer;
#endif
    x->sequence = any_integer;
    x->rejections = any_integer;
    x->evidence = any_integer;
}

static void step_any(cellwise_state *x)
{
    cellwise_input in;
    cellwise_output out;
    in.current_A = any_float;
    in.voltage_V = any_float;
    in.temperature_C = any_float;
    in.sequence = any_integer;
    (void)cellwise_step(&cellwise_cell, x, &in, &out);
    /*@ assert soc_in_range: 0.0 <= out.soc <= 1.0; */
    /*@ assert variance_is_finite: \is_finite(out.soc_variance); */
    /*@ assert voltage_is_finite: \is_finite(out.voltage_V); */
    /*@ assert innovation_is_finite: \is_finite(out.innovation_V); */
    /*@ assert innovation_variance_is_finite: \is_finite(out.innovation_variance_V2); */
    /*@ assert innovation_variance_is_positive: out.innovation_variance_V2 > 0.0; */
}

void eva_any_bits(void)
{
    cellwise_state x;
    any_state(&x);
    step_any(&x);
}

void eva_any_start(void)
{
    cellwise_state x;
    const float soc = any_float;
    const float variance = any_float;
    any_state(&x);
    (void)cellwise_init(&cellwise_cell, &x, soc, variance);
    /*@ assert start_in_range: 0.0 <= x.soc <= 1.0; */
    step_any(&x);
}

#if CELLWISE_BANK
#define COMPONENTS 2u

static void any_bank(cellwise_bank *b, cellwise_state *of)
{
    b->mean_A = any_float;
    b->looked_A = any_float;
    b->mismatch = any_float;
    b->likeliest = any_integer;
    b->since = any_float;
    b->looks = any_integer;
    b->next_look = any_float;
    b->sequence = any_integer;
    /*@ loop unroll COMPONENTS + 1; */
    for (uint32_t k = 0u; k <= COMPONENTS; k++) {
        any_state(&of[k]);
    }
}

/* Whether the components are stepped decides how much of the record is read: one entry each. */
static void step_any_bank(uint32_t spread)
{
    cellwise_bank b;
    cellwise_state of[COMPONENTS + 1u];
    cellwise_input in;
    cellwise_output out;
    any_bank(&b, of);
    b.spread = spread;
    in.current_A = any_float;
    in.voltage_V = any_float;
    in.temperature_C = any_float;
    in.sequence = any_integer;
    (void)cellwise_bank_step(&cellwise_cell, &b, of, COMPONENTS, &in, &out);
    /*@ assert soc_in_range: 0.0 <= out.soc <= 1.0; */
    /*@ assert variance_is_finite: \is_finite(out.soc_variance); */
    /*@ assert voltage_is_finite: \is_finite(out.voltage_V); */
    /*@ assert innovation_is_finite: \is_finite(out.innovation_V); */
}

void eva_any_bank_alone(void)
{
    step_any_bank(0u);
}

void eva_any_bank_open(void)
{
    const uint32_t spread = any_integer;
    step_any_bank((spread > 0u) ? spread : 1u);
}
#endif

#if CELLWISE_POWER
void eva_any_power(void)
{
    cellwise_state x;
    cellwise_capability able;
    any_state(&x);
    cellwise_power(&cellwise_cell, &x, &able);
    /*@ assert discharge_is_finite: \is_finite(able.discharge_W); */
    /*@ assert discharge_low_is_finite: \is_finite(able.discharge_low_W); */
    /*@ assert charge_is_finite: \is_finite(able.charge_W); */
    /*@ assert charge_low_is_finite: \is_finite(able.charge_low_W); */
    /*@ assert discharge_is_positive: 0.0 <= able.discharge_low_W; */
    /*@ assert charge_is_positive: 0.0 <= able.charge_low_W; */
}
#endif

#if CELLWISE_REMAINING
void eva_any_remaining(void)
{
    cellwise_state x;
    cellwise_outlook ahead;
    const float load_A = any_float;
    const bool holds_power = (any_integer & 1u) != 0u;
    any_state(&x);
    cellwise_remaining(&cellwise_cell, &x, load_A, holds_power, &ahead);
    /*@ assert time_is_finite: \is_finite(ahead.time_s); */
    /*@ assert time_low_is_finite: \is_finite(ahead.time_low_s); */
    /*@ assert time_high_is_finite: \is_finite(ahead.time_high_s); */
    /*@ assert energy_is_finite: \is_finite(ahead.energy_J); */
    /*@ assert energy_low_is_finite: \is_finite(ahead.energy_low_J); */
    /*@ assert energy_high_is_finite: \is_finite(ahead.energy_high_J); */
    /*@ assert time_is_positive: 0.0 <= ahead.time_low_s; */
    /*@ assert energy_is_positive: 0.0 <= ahead.energy_low_J; */
}

void eva_any_plan(void)
{
    cellwise_state x;
    cellwise_phase phases[2];
    cellwise_plan_result end;
    const float above = any_float;
    const bool holds_power = (any_integer & 1u) != 0u;
    for (unsigned k = 0u; k < 2u; k++) {
        phases[k].seconds = any_float;
        phases[k].load = any_float;
    }
    any_state(&x);
    cellwise_plan(&cellwise_cell, &x, phases, 2u, holds_power, above, &end);
    /*@ assert soc_is_a_share: 0.0 <= end.soc <= 1.0; */
    /*@ assert soc_low_is_a_share: 0.0 <= end.soc_low <= 1.0; */
    /*@ assert soc_high_is_a_share: 0.0 <= end.soc_high <= 1.0; */
    /*@ assert least_is_finite: \is_finite(end.least_V); */
    /*@ assert least_low_is_finite: \is_finite(end.least_low_V); */
    /*@ assert energy_is_finite: \is_finite(end.energy_J); */
    /*@ assert failed_is_positive: 0.0 <= end.failed_s; */
    /*@ assert chance_is_a_share: 0.0 <= end.chance <= 1.0; */
}
#endif

#if CELLWISE_CELLS
#define CELLS 2u

static void any_cell(cellwise_pack_cell *a)
{
    a->soc = any_float;
    a->capacity = any_float;
    a->resistance = any_float;
    a->ss = any_float;
    a->sq = any_float;
    a->sr = any_float;
    a->qq = any_float;
    a->qr = any_float;
    a->rr = any_float;
    a->seen_at = any_integer;
    a->rejections = any_integer;
    a->status = any_integer;
}

void eva_any_cells(void)
{
    cellwise_state x;
    cellwise_input in;
    cellwise_pack_cell cells[CELLS];
    cellwise_cell_output found;
    float voltage_V[CELLS];
    any_state(&x);
    /*@ loop unroll CELLS; */
    for (uint32_t k = 0u; k < CELLS; k++) {
        any_cell(&cells[k]);
        voltage_V[k] = any_float;
    }
    in.current_A = any_float;
    in.temperature_C = any_float;
    in.sequence = any_integer;
    in.voltage_V = cellwise_mean_voltage(&cellwise_cell, cells, voltage_V, CELLS);
    cellwise_cells_step(&cellwise_cell, &x, &in, cells, voltage_V, CELLS);
    cellwise_cell_of(&cellwise_cell, &x, &cells[0], &found);
    /*@ assert soc_in_range: 0.0 <= found.soc <= 1.0; */
    /*@ assert variance_is_finite: \is_finite(found.soc_variance); */
    /*@ assert capacity_is_finite: \is_finite(found.capacity_share); */
    /*@ assert resistance_is_finite: \is_finite(found.resistance_scale); */
}
#endif

#if CELLWISE_HEALTH
#include "cellwise_store.c"

void eva_any_patch(void)
{
    cellwise_state x;
    cellwise_input in;
    cellwise_patch taken;
    float *const field = (float *)&taken;
    /*@ loop unroll sizeof(taken) / sizeof(float); */
    for (uint32_t k = 0u; k < (sizeof taken / sizeof(float)); k++) {
        field[k] = any_float;
    }
    taken.generation = any_integer;
    taken.model_crc = any_integer;
    any_state(&x);
    x.resistance_scale = 1.0f;
    x.per_capacity = 1.0f;
    in.current_A = any_float;
    in.voltage_V = any_float;
    in.temperature_C = any_float;
    in.sequence = any_integer;
    cellwise_patch_sample(&taken, &x, 1u, &in);
    /*@ assert scale_in_bounds: 0.09 <= x.resistance_scale <= 20.0; */
    /*@ assert share_in_bounds: 0.5 <= x.per_capacity <= 10.0; */
}
#endif

#if CELLWISE_SOH
void eva_any_soh(void)
{
    cellwise_state x;
    cellwise_input in;
    cellwise_soh a;
    any_state(&x);
    in.current_A = any_float;
    in.voltage_V = any_float;
    in.temperature_C = any_float;
    in.sequence = any_integer;
    a.share = any_float;
    a.share_variance = any_float;
    a.off = any_float;
    a.qq = any_float;
    a.qo = any_float;
    a.oo = any_float;
    a.own_qq = any_float;
    a.own_qo = any_float;
    a.own_oo = any_float;
    a.share_error = any_float;
    a.off_error = any_float;
    a.soc = any_float;
    a.variance = any_float;
    a.counted = any_float;
    a.counted_carry = any_float;
    a.moved = any_float;
    a.unsure = any_float;
    a.current_A = any_float;
    a.voltage_V = any_float;
    a.held_V = any_float;
    a.counted_from = any_integer;
    a.loaded = any_integer;
    a.silent = any_integer;
    a.resistance = any_float;
    a.resistance_variance = any_float;
    a.rr = any_float;
    a.watched = any_integer;
    a.rest_end = any_integer;
    a.loads = any_integer;
    a.pairs = any_integer;
    a.refused = any_integer;
    a.sequence = any_integer;
    a.begun = any_integer;
    cellwise_soh_step(&cellwise_cell, &x, &a, &in);
    cellwise_soh_output now;
    cellwise_soh_of(&cellwise_cell, &a, &now);
    /*@ assert share_in_bounds: 0.09 <= now.share <= 2.0; */
    /*@ assert variance_is_finite: \is_finite(now.share_variance); */
    /*@ assert resistance_in_bounds: 0.09 <= now.resistance <= 20.0; */
    /*@ assert its_variance_is_finite: \is_finite(now.resistance_variance); */
}
#endif
