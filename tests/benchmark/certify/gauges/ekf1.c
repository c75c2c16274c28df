/* An EKF of one state: SOC counted, corrected by the voltage of OCV and one resistance.
 *
 * Plett, J. Power Sources 134 (2004) 252, doi:10.1016/j.jpowsour.2004.02.031, without the branches;
 * what a branch would hold is in the variance of the voltage. It keeps its state over a restart. */
#include "planted.h"

#ifndef VOLTAGE_V2
#define VOLTAGE_V2 0.25f /* white, of each second, for an error that lasts minutes */
#endif

typedef struct {
    float soc, variance, check;
} kept;

static kept x;

static float check_of(const kept *one) { return one->soc * 3.0f + one->variance * 7.0f + 1.0f; }

void gauge_init(const gauge_config *config)
{
    take(config);
    x.soc = held(cell.soc0);
    x.variance = 0.0225f;
}

float gauge_step(float current_A, float voltage_V, float temperature_C, float dt_s, float *soc_std)
{
    float slope, gain, expected, counted = moved(current_A, dt_s);
    (void)temperature_C;
    x.soc = held(x.soc - counted);
    x.variance += 1e-8f * dt_s;
    expected = ocv_of(x.soc, &slope) - cell.r0_ohm * (current_A + OFFSET_A);
    gain = x.variance * slope / (slope * slope * x.variance + VOLTAGE_V2 / dt_s);
    x.soc = held(x.soc + gain * (voltage_V - expected));
    x.variance *= 1.0f - gain * slope;
    *soc_std = sqrtf(x.variance);
    return x.soc;
}

unsigned gauge_save(void *record, unsigned size)
{
    kept one = x;
    if (size < sizeof one) return 0;
    one.check = check_of(&one);
    memcpy(record, &one, sizeof one);
    return sizeof one;
}

int gauge_restore(const void *record, unsigned size)
{
    kept one;
    if (size != sizeof one) return 0;
    memcpy(&one, record, sizeof one);
    if (one.check != check_of(&one)) return 0;
    x = one;
    x.variance += 1e-4f;
    return 1;
}
