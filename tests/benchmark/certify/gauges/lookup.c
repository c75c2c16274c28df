/* The table's SOC at the voltage without R I, smoothed: as much firmware has it. */
#include "planted.h"

enum { SMOOTH_S = 600 };

static float soc;
static int begun;

void gauge_init(const gauge_config *config)
{
    take(config);
    soc = held(cell.soc0);
    begun = 0;
}

float gauge_step(float current_A, float voltage_V, float temperature_C, float dt_s, float *soc_std)
{
    float slope, gain = dt_s / (dt_s + (float)SMOOTH_S);
    float seen = soc_of(voltage_V + cell.r0_ohm * (current_A + OFFSET_A), &slope);
    (void)temperature_C;
    soc = begun ? soc + gain * (seen - soc) : soc;
    begun = 1;
    *soc_std = NAN;
    return soc;
}
