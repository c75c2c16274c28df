/* Many steps in one call, and what a test asks about the layout: for the host library only. */
#include <stddef.h>

#include "../cellwise_ekf.h"

void cellwise_rows(const cellwise_model *model, cellwise_state *x, const cellwise_input *in,
                   cellwise_output *out, uint32_t samples);
void cellwise_power_of(const cellwise_model *model, const cellwise_state *x,
                       cellwise_capability *out);
void cellwise_remaining_of(const cellwise_model *model, const cellwise_state *x, float load_A,
                           bool holds_power, cellwise_outlook *out);
void cellwise_plan_of(const cellwise_model *model, const cellwise_state *x,
                      const cellwise_phase *phases, uint32_t count, bool holds_power, float above,
                      cellwise_landing *out);
uint32_t cellwise_set_health_of(const cellwise_model *model, cellwise_state *x, float share,
                           float scale);
void cellwise_cells_begin(const cellwise_model *model, cellwise_pack_cell *cells, uint32_t count);
void cellwise_pack_rows(const cellwise_model *model, cellwise_state *x, cellwise_pack_cell *cells,
                        uint32_t count, cellwise_input *in, const float *voltage_V,
                        cellwise_output *out, uint32_t samples);
void cellwise_cells_of(const cellwise_model *model, const cellwise_state *x,
                       const cellwise_pack_cell *cells, uint32_t count, cellwise_cell_output *out);
void cellwise_pack_power_of(const cellwise_model *model, const cellwise_state *x,
                            const cellwise_pack_cell *cells, uint32_t count, cellwise_capability *out);

void cellwise_power_of(const cellwise_model *model, const cellwise_state *x,
                       cellwise_capability *out)
{
#if CELLWISE_POWER
    cellwise_power(model, x, out);
#else
    (void)model;
    (void)x;
    (void)out;
#endif
}

void cellwise_remaining_of(const cellwise_model *model, const cellwise_state *x, float load_A,
                           bool holds_power, cellwise_outlook *out)
{
#if CELLWISE_REMAINING
    cellwise_remaining(model, x, load_A, holds_power, out);
#else
    (void)model;
    (void)x;
    (void)load_A;
    (void)holds_power;
    (void)out;
#endif
}

void cellwise_rows(const cellwise_model *model, cellwise_state *x, const cellwise_input *in,
                   cellwise_output *out, uint32_t samples)
{
    for (uint32_t k = 0u; k < samples; k++) {
        (void)cellwise_step(model, x, &in[k], &out[k]);
    }
}

/* Called only where their options are compiled in. */
#if CELLWISE_REMAINING
void cellwise_plan_of(const cellwise_model *model, const cellwise_state *x,
                      const cellwise_phase *phases, uint32_t count, bool holds_power, float above,
                      cellwise_landing *out)
{
    cellwise_plan(model, x, phases, count, holds_power, above, out);
}
#endif

#if CELLWISE_HEALTH
uint32_t cellwise_set_health_of(const cellwise_model *model, cellwise_state *x, float share, float scale)
{
    return cellwise_set_health(model, x, share, scale);
}
#endif

#if CELLWISE_CELLS
void cellwise_cells_begin(const cellwise_model *model, cellwise_pack_cell *cells, uint32_t count)
{
    cellwise_cells_init(model, cells, count);
}

void cellwise_pack_rows(const cellwise_model *model, cellwise_state *x, cellwise_pack_cell *cells,
                        uint32_t count, cellwise_input *in, const float *voltage_V,
                        cellwise_output *out, uint32_t samples)
{
    for (uint32_t k = 0u; k < samples; k++) {
        const float *const row = &voltage_V[k * count];
        in[k].voltage_V = cellwise_mean_voltage(model, cells, row, count);
        (void)cellwise_step(model, x, &in[k], &out[k]);
        cellwise_cells_step(model, x, &in[k], cells, row, count);
    }
}

void cellwise_cells_of(const cellwise_model *model, const cellwise_state *x,
                       const cellwise_pack_cell *cells, uint32_t count, cellwise_cell_output *out)
{
    for (uint32_t k = 0u; k < count; k++) {
        cellwise_cell_of(model, x, &cells[k], &out[k]);
    }
}
#endif

#if CELLWISE_CELLS && CELLWISE_POWER
void cellwise_pack_power_of(const cellwise_model *model, const cellwise_state *x,
                            const cellwise_pack_cell *cells, uint32_t count, cellwise_capability *out)
{
    cellwise_pack_power(model, x, cells, count, out);
}
#endif
