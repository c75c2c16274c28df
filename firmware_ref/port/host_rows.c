/* Many steps in one call, and what a test asks about the layout: for the host library only. */
#include <stddef.h>

#include "../cellwise_ekf.h"

void cellwise_rows(const cellwise_model *model, cellwise_state *x, const cellwise_input *in,
                   cellwise_output *out, uint32_t samples);
void cellwise_power_of(const cellwise_model *model, const cellwise_state *x,
                       cellwise_capability *out);

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

void cellwise_rows(const cellwise_model *model, cellwise_state *x, const cellwise_input *in,
                   cellwise_output *out, uint32_t samples)
{
    for (uint32_t k = 0u; k < samples; k++) {
        (void)cellwise_step(model, x, &in[k], &out[k]);
    }
}
