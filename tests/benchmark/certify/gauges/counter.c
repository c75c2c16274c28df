/* Counts, and is full where a charger holds the last voltage and its current has tapered off. */
#include "planted.h"

static float soc;

void gauge_init(const gauge_config *config)
{
    take(config);
    soc = held(cell.soc0);
}

float gauge_step(float current_A, float voltage_V, float temperature_C, float dt_s, float *soc_std)
{
    (void)temperature_C;
    soc = held(soc - moved(current_A, dt_s));
    if (current_A < 0.0f && current_A > -0.06f * cell.capacity_Ah &&
        voltage_V > ocv[cell.points - 1] - 0.01f)
        soc = 1.0f;
    *soc_std = NAN;
    return soc;
}
