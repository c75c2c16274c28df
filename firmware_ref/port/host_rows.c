/* Many steps in one call: for the host library and the page only. */
#include "../cellwise_ekf.h"
#include "../cellwise_soh.h"
#include "../cellwise_sketch.h"
#include "../cellwise_store.h"

void cellwise_rows(const cellwise_model *model, cellwise_state *x, const cellwise_input *in,
                   cellwise_output *out, uint32_t samples);
#if CELLWISE_BANK
void cellwise_bank_rows(const cellwise_model *model, cellwise_bank *bank, cellwise_state *of,
                        uint32_t count, const cellwise_input *in, cellwise_output *out,
                        uint32_t samples);
#endif
#if CELLWISE_SOH
void cellwise_soh_rows(const cellwise_model *model, cellwise_state *x, cellwise_soh *soh,
                         const cellwise_input *in, cellwise_output *out, uint32_t samples);
#endif
#if CELLWISE_HEALTH
uint32_t cellwise_patched_rows(const cellwise_model *model, const cellwise_patch *from,
                               cellwise_state *x, const cellwise_input *in, cellwise_output *out,
                               uint32_t samples);
#if CELLWISE_BANK
uint32_t cellwise_patched_bank_rows(const cellwise_model *model, const cellwise_patch *from,
                                    cellwise_bank *bank, cellwise_state *of, uint32_t count,
                                    const cellwise_input *in, cellwise_output *out,
                                    uint32_t samples);
#endif
#endif
#if CELLWISE_SKETCH
void cellwise_sketch_rows(const cellwise_model *model, cellwise_state *x, cellwise_sketch *sketch,
                          const cellwise_input *in, cellwise_output *out, uint32_t samples);
#endif
void cellwise_pack_rows(const cellwise_model *model, cellwise_state *x, cellwise_pack_cell *cells,
                        uint32_t count, cellwise_input *in, const float *voltage_V,
                        cellwise_output *out, uint32_t samples);
void cellwise_cells_of(const cellwise_model *model, const cellwise_state *x,
                       const cellwise_pack_cell *cells, uint32_t count, cellwise_cell_output *out);

void cellwise_rows(const cellwise_model *model, cellwise_state *x, const cellwise_input *in,
                   cellwise_output *out, uint32_t samples)
{
    for (uint32_t k = 0u; k < samples; k++) {
        (void)cellwise_step(model, x, &in[k], &out[k]);
    }
}

#if CELLWISE_BANK
void cellwise_bank_rows(const cellwise_model *model, cellwise_bank *bank, cellwise_state *of,
                        uint32_t count, const cellwise_input *in, cellwise_output *out,
                        uint32_t samples)
{
    for (uint32_t k = 0u; k < samples; k++) {
        (void)cellwise_bank_step(model, bank, of, count, &in[k], &out[k]);
    }
}
#endif

#if CELLWISE_SOH
void cellwise_soh_rows(const cellwise_model *model, cellwise_state *x, cellwise_soh *soh,
                         const cellwise_input *in, cellwise_output *out, uint32_t samples)
{
    for (uint32_t k = 0u; k < samples; k++) {
        (void)cellwise_step(model, x, &in[k], &out[k]);
        cellwise_soh_step(model, x, soh, &in[k]);
    }
}
#endif

#if CELLWISE_HEALTH
uint32_t cellwise_patched_rows(const cellwise_model *model, const cellwise_patch *from,
                               cellwise_state *x, const cellwise_input *in, cellwise_output *out,
                               uint32_t samples)
{
    cellwise_patch taken;
    cellwise_no_patch(&taken);
    const uint32_t refused = cellwise_take_patch(model, &taken, from);
    for (uint32_t k = 0u; k < samples; k++) {
        cellwise_input sample = in[k];
        cellwise_patch_sample(&taken, x, 1u, &sample);
        (void)cellwise_step(model, x, &sample, &out[k]);
    }
    return refused;
}

#if CELLWISE_BANK
uint32_t cellwise_patched_bank_rows(const cellwise_model *model, const cellwise_patch *from,
                                    cellwise_bank *bank, cellwise_state *of, uint32_t count,
                                    const cellwise_input *in, cellwise_output *out,
                                    uint32_t samples)
{
    cellwise_patch taken;
    cellwise_no_patch(&taken);
    const uint32_t refused = cellwise_take_patch(model, &taken, from);
    for (uint32_t k = 0u; k < samples; k++) {
        const uint32_t stepped = (bank->spread == 0u) ? 1u : (count + 1u);
        cellwise_input sample = in[k];
        cellwise_patch_sample(&taken, of, stepped, &sample);
        (void)cellwise_bank_step(model, bank, of, count, &sample, &out[k]);
    }
    return refused;
}
#endif
#endif

#if CELLWISE_CELLS
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

#if CELLWISE_SKETCH
void cellwise_sketch_rows(const cellwise_model *model, cellwise_state *x, cellwise_sketch *sketch,
                          const cellwise_input *in, cellwise_output *out, uint32_t samples)
{
    for (uint32_t k = 0u; k < samples; k++) {
        (void)cellwise_step(model, x, &in[k], &out[k]);
        cellwise_sketch_add(model, x, sketch, &in[k]);
    }
}
#endif
