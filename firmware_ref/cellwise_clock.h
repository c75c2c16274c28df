/* A free-running clock as time steps: whole ones since the last sample, and its sequence number.
 *
 *     cellwise_clock_begin(&clock, timer(), TICKS_PER_STEP);     with the first sample, number 0
 *     if (cellwise_clock_steps(&clock, timer()) > 0u) {          as often as you like
 *         in.sequence = clock.sequence;
 *
 * `now` counts up and wraps at 2^32. Ticks that are left over are counted with the next step, so that nothing
 * drifts; a call up to half a step early or late is on time. More than one step: samples are missing, and
 * cellwise_step says so. Call it at least once in 2^32 ticks (49 days of milliseconds). */
#ifndef CELLWISE_CLOCK_H
#define CELLWISE_CLOCK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    uint32_t at; /* half a step before the last sample was due */
    uint32_t per_step; /* ticks of one time step, 1 or more */
    uint32_t sequence; /* of the last sample */
} cellwise_clock;

static inline void cellwise_clock_begin(cellwise_clock *clock, uint32_t now, uint32_t ticks_per_step)
{
    clock->per_step = (ticks_per_step > 0u) ? ticks_per_step : 1u;
    clock->at = now - (clock->per_step / 2u);
    clock->sequence = 0u;
}

/* CW-016: no step is lost or counted twice where the clock wraps or a call is late. */
static inline uint32_t cellwise_clock_steps(cellwise_clock *clock, uint32_t now)
{
    const uint32_t steps = (now - clock->at) / clock->per_step;
    clock->at = clock->at + (steps * clock->per_step);
    clock->sequence = clock->sequence + steps;
    return steps;
}

#ifdef __cplusplus
}
#endif

#endif
