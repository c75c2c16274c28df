/* Steps the samples of in.bin and writes every output to out.bin, then the state, then what was
 * measured: instructions (ticks.h), stack by paint.
 *
 * in.bin: soc, soc_variance (float), every how many samples to measure and the first of them (uint32),
 * then records of cellwise_input. With MEASURE_POWER it is cellwise_power that is measured, with
 * MEASURE_REMAINING cellwise_remaining at LOAD_A, its power held, MEASURE_PLAN cellwise_plan of four phases, MEASURE_SOH
 * cellwise_soh_step, MEASURE_SKETCH cellwise_sketch_add, with
 * MEASURE_BANK a step of a bank of COMPONENTS. With MEASURE_CELLS a sample is one of a pack of so many cells, whose voltages are the sample's and
 * OFFSET_V times -6..6 each; the cells follow the state in out.bin. */
#include <stddef.h>

#include "cellwise_cell.h"
#include "cellwise_sketch.h"
#include "cellwise_soh.h"
#include "semihosting.h"
#include "ticks.h"

#define CHUNK 64u
#define REPEATS 48u
#define PAINTED 512u
#define PAINT 0xA5A5A5A5u

typedef struct {
    float soc;
    float soc_variance;
    uint32_t measure_every;
    uint32_t measure_first;
} request;

typedef struct {
    uint32_t measured;       /* steps */
    uint32_t ticks_sum_low;  /* of REPEATS steps each, overhead included */
    uint32_t ticks_sum_high;
    uint32_t ticks_most;
    uint32_t ticks_empty;    /* of REPEATS calls that do nothing */
    uint32_t stack_bytes;
    uint32_t state_bytes;
    uint32_t model_bytes;
} findings;

static cellwise_input samples[CHUNK];
static cellwise_output outputs[CHUNK];
static cellwise_state state;
static cellwise_state copies[REPEATS];
static cellwise_output scratch;

typedef uint32_t (*step_function)(const cellwise_model *, cellwise_state *, const cellwise_input *,
                                  cellwise_output *);

#if defined(MEASURE_BANK)
#define COMPONENTS 7u
static cellwise_bank bank;
static cellwise_bank trial_bank;
static cellwise_state of[COMPONENTS + 1u];
static cellwise_state trial[COMPONENTS + 1u];

static __attribute__((noinline)) void begin_trial(void)
{
    trial_bank = bank;
    for (uint32_t k = 0u; k <= COMPONENTS; k++) {
        trial[k] = of[k];
    }
}
#elif defined(MEASURE_SOH)
static cellwise_soh soh;
static cellwise_soh trial_soh;

static __attribute__((noinline)) void begin_trial(void)
{
    trial_soh = soh;
}
#elif defined(MEASURE_SKETCH)
static cellwise_sketch sketch;
static cellwise_sketch trial_sketch;

static __attribute__((noinline)) void begin_trial(void)
{
    trial_sketch = sketch;
}
#else
static void begin_trial(void)
{
}
#endif

static __attribute__((noinline)) uint32_t nothing(const cellwise_model *m, cellwise_state *x,
                                                  const cellwise_input *in, cellwise_output *out)
{
    (void)m;
    (void)x;
    (void)in;
    (void)out;
    begin_trial();
    return 0u;
}

#if defined(MEASURE_BANK)
static __attribute__((noinline)) uint32_t measured_step(const cellwise_model *m, cellwise_state *x,
                                                        const cellwise_input *in,
                                                        cellwise_output *out)
{
    (void)x;
    begin_trial();
    return cellwise_bank_step(m, &trial_bank, trial, COMPONENTS, in, out);
}

static uint32_t whole_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *in,
                           cellwise_output *out)
{
    const uint32_t status = cellwise_bank_step(m, &bank, of, COMPONENTS, in, out);
    *x = of[0];
    return status;
}
#elif defined(MEASURE_CELLS)
#define OFFSET_V 0x1p-10f
static cellwise_pack_cell cells[MEASURE_CELLS];
static float voltages[MEASURE_CELLS];

static __attribute__((noinline)) uint32_t measured_step(const cellwise_model *m, cellwise_state *x,
                                                        const cellwise_input *in,
                                                        cellwise_output *out)
{
    cellwise_input mean = *in;
    uint32_t status;
    mean.voltage_V = cellwise_mean_voltage(m, cells, voltages, MEASURE_CELLS);
    status = cellwise_step(m, x, &mean, out);
    cellwise_cells_step(m, x, &mean, cells, voltages, MEASURE_CELLS);
    return status;
}

static void read_cells(float voltage_V)
{
    for (uint32_t k = 0u; k < MEASURE_CELLS; k++) {
        voltages[k] = voltage_V + (OFFSET_V * ((float)((k * 7u) % 13u) - 6.0f));
    }
}
#define whole_step measured_step
#elif defined(MEASURE_POWER)
static cellwise_capability capability;

static __attribute__((noinline)) uint32_t measured_step(const cellwise_model *m, cellwise_state *x,
                                                        const cellwise_input *in,
                                                        cellwise_output *out)
{
    (void)in;
    (void)out;
    cellwise_power(m, x, &capability);
    return 0u;
}
#define whole_step cellwise_step
#elif defined(MEASURE_REMAINING)
#define LOAD_A 3.0f
static cellwise_outlook outlook;

static __attribute__((noinline)) uint32_t measured_step(const cellwise_model *m, cellwise_state *x,
                                                        const cellwise_input *in,
                                                        cellwise_output *out)
{
    (void)in;
    (void)out;
    cellwise_remaining(m, x, LOAD_A, true, &outlook);
    return 0u;
}
#define whole_step cellwise_step
#elif defined(MEASURE_PLAN)
static const cellwise_phase phases[4] = {{60.0f, 30.0f}, {600.0f, 12.0f}, {90.0f, 0.0f}, {60.0f, 25.0f}};
static cellwise_plan_result landing;

static __attribute__((noinline)) uint32_t measured_step(const cellwise_model *m, cellwise_state *x,
                                                        const cellwise_input *in,
                                                        cellwise_output *out)
{
    (void)in;
    (void)out;
    cellwise_plan(m, x, phases, 4u, true, 0.3f, &landing);
    return 0u;
}
#define whole_step cellwise_step
#elif defined(MEASURE_SOH)
static __attribute__((noinline)) uint32_t measured_step(const cellwise_model *m, cellwise_state *x,
                                                        const cellwise_input *in,
                                                        cellwise_output *out)
{
    (void)out;
    begin_trial();
    cellwise_soh_step(m, x, &trial_soh, in);
    return 0u;
}

static uint32_t whole_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *in,
                           cellwise_output *out)
{
    const uint32_t status = cellwise_step(m, x, in, out);
    cellwise_soh_step(m, x, &soh, in);
    return status;
}
#elif defined(MEASURE_SKETCH)
static __attribute__((noinline)) uint32_t measured_step(const cellwise_model *m, cellwise_state *x,
                                                        const cellwise_input *in,
                                                        cellwise_output *out)
{
    (void)out;
    begin_trial();
    cellwise_sketch_add(m, x, &trial_sketch, in);
    return 0u;
}

static uint32_t whole_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *in,
                           cellwise_output *out)
{
    const uint32_t status = cellwise_step(m, x, in, out);
    cellwise_sketch_add(m, x, &sketch, in);
    return status;
}
#else
#define measured_step cellwise_step
#define whole_step cellwise_step
#endif

static __attribute__((noinline)) uint32_t ticks_of(step_function step, const cellwise_input *in)
{
    const step_function volatile called = step;
    uint32_t before;
    for (uint32_t k = 0u; k < REPEATS; k++) {
        copies[k] = state;
    }
    before = ticks();
    for (uint32_t k = 0u; k < REPEATS; k++) {
        (void)called(&cellwise_cell, &copies[k], in, &scratch);
    }
    return (ticks() - before) & TICKS_MASK;
}

/* Bytes below this function's own frame that one step has written. */
static __attribute__((noinline)) uint32_t stack_of(const cellwise_input *in)
{
    const step_function volatile called = measured_step;
    uint32_t top;
    uint32_t untouched = 0u;
    copies[0] = state;
    STACK_POINTER(top);
    for (uint32_t k = 1u; k <= PAINTED; k++) {
        ((volatile uint32_t *)top)[-(int32_t)k] = PAINT;
    }
    (void)called(&cellwise_cell, &copies[0], in, &scratch);
    while ((untouched < PAINTED) &&
           (((volatile uint32_t *)top)[(int32_t)untouched - (int32_t)PAINTED] == PAINT)) {
        untouched++;
    }
    return 4u * (PAINTED - untouched);
}

static void measure(findings *found, const cellwise_input *in)
{
    const uint32_t ticks = ticks_of(measured_step, in);
    const uint32_t stack = stack_of(in);
    const uint32_t low = found->ticks_sum_low;
    found->measured++;
    found->ticks_sum_low += ticks;
    found->ticks_sum_high += (found->ticks_sum_low < low) ? 1u : 0u;
    found->ticks_most = (ticks > found->ticks_most) ? ticks : found->ticks_most;
    found->stack_bytes = (stack > found->stack_bytes) ? stack : found->stack_bytes;
}

int main(void)
{
    const int32_t in = host_open("in.bin", 1u);
    const int32_t out = host_open("out.bin", 5u);
    request asked;
    findings found = {0u, 0u, 0u, 0u, 0u, 0u, sizeof(cellwise_state), sizeof(cellwise_model)};
    uint32_t row = 0u;
    uint32_t got;

    if ((in < 0) || (out < 0) || (host_read(in, &asked, sizeof asked) != sizeof asked)) {
        return 1;
    }
    ticks_begin();
    (void)cellwise_init(&cellwise_cell, &state, asked.soc, asked.soc_variance);
#if defined(MEASURE_BANK)
    (void)cellwise_bank_init(&cellwise_cell, &bank, of, COMPONENTS, asked.soc, asked.soc_variance);
#endif
#if defined(MEASURE_SOH)
    cellwise_soh_init(&cellwise_cell, &soh);
#elif defined(MEASURE_SKETCH)
    cellwise_sketch_init(&cellwise_cell, &sketch, 1u);
#endif
#if defined(MEASURE_CELLS)
    cellwise_cells_init(&cellwise_cell, cells, MEASURE_CELLS);
#endif
    while ((got = host_read(in, samples, sizeof samples)) >= sizeof samples[0]) {
        const uint32_t rows = got / (uint32_t)sizeof samples[0];
        for (uint32_t k = 0u; k < rows; k++) {
#if defined(MEASURE_CELLS)
            read_cells(samples[k].voltage_V);
#endif
            if ((asked.measure_every != 0u) && (row >= asked.measure_first) &&
                (((row - asked.measure_first) % asked.measure_every) == 0u)) {
                measure(&found, &samples[k]);
            }
            (void)whole_step(&cellwise_cell, &state, &samples[k], &outputs[k]);
            row++;
        }
        host_write(out, outputs, rows * (uint32_t)sizeof outputs[0]);
    }
    found.ticks_empty = ticks_of(nothing, &samples[0]);
    host_write(out, &state, sizeof state);
#if defined(MEASURE_CELLS)
    host_write(out, cells, sizeof cells);
#endif
    host_write(out, &found, sizeof found);
    host_close(out);
    return 0;
}
