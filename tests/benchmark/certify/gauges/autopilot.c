/* An autopilot's: counted, and drawn to the SOC of the compensated voltage, the more the emptier.
 *
 * Written after the equations that PX4 documents of its battery estimate: the weight of the voltage is
 * a small constant times what is missing to full. */
#include "planted.h"

static const float WEIGHT = 3e-4f; /* of the voltage in one second, at empty */

static float soc;

void gauge_init(const gauge_config *config)
{
    take(config);
    soc = held(cell.soc0);
}

float gauge_step(float current_A, float voltage_V, float temperature_C, float dt_s, float *soc_std)
{
    float slope, seen = soc_of(voltage_V + cell.r0_ohm * (current_A + OFFSET_A), &slope);
    float weight = fminf(WEIGHT * (1.0f - seen) * dt_s, 1.0f);
    (void)temperature_C;
    soc = held((1.0f - weight) * (soc - moved(current_A, dt_s)) + weight * seen);
    *soc_std = NAN;
    return soc;
}
