/* What a test makes wrong with a gauge; as it stands here, nothing. */
#ifndef TABLE_V
#define TABLE_V(soc) 0.0f /* added to its OCV */
#endif
#ifndef CAPACITY
#define CAPACITY 1.0f /* factor */
#endif
#ifndef OFFSET_A
#define OFFSET_A 0.0f
#endif
#ifndef START
#define START 0.0f /* added to what it is told */
#endif
#ifndef RESISTANCE
#define RESISTANCE 1.0f /* factor */
#endif

#include "cellwise_gauge.h"

#include <math.h>
#include <string.h>

static gauge_config cell;
static float ocv[512];

static void take(const gauge_config *config)
{
    int k;
    cell = *config;
    cell.capacity_Ah *= CAPACITY;
    cell.r0_ohm *= RESISTANCE;
    cell.soc0 += START;
    for (k = 0; k < cell.points; k++) ocv[k] = config->ocv_V[k] + TABLE_V(config->soc[k]);
}

static float held(float soc) { return soc < 0.0f ? 0.0f : soc > 1.0f ? 1.0f : soc; }

/* SOC of an OCV, and the slope there [V]. */
static float soc_of(float voltage, float *slope)
{
    int k = 0;
    while (k < cell.points - 2 && voltage > ocv[k + 1]) k++;
    *slope = fmaxf((ocv[k + 1] - ocv[k]) / (cell.soc[k + 1] - cell.soc[k]), 0.02f);
    return held(cell.soc[k] + (voltage - ocv[k]) / *slope);
}

static float ocv_of(float soc, float *slope)
{
    float at = held(soc) * (float)(cell.points - 1);
    int k = (int)at;
    k = k > cell.points - 2 ? cell.points - 2 : k;
    *slope = fmaxf((ocv[k + 1] - ocv[k]) / (cell.soc[k + 1] - cell.soc[k]), 0.02f);
    return ocv[k] + (soc - cell.soc[k]) * *slope;
}

static float moved(float current_A, float dt_s)
{
    return (current_A + OFFSET_A) * dt_s / (3600.0f * cell.capacity_Ah);
}
