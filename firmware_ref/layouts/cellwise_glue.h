/* What an application keeps around the step: start-up checks, a clock, mean current, validity, two slots.
 *
 *     (read what was kept into glue.slots, or leave them zero)
 *     (void)cellwise_glue_begin(&glue, now_ms, DT_MS);
 *     if (cellwise_glue_sample(&glue, now_ms, current_A, voltage_V, temperature_C)) {  as often as you like
 *         glue.soc, glue.soc_std, glue.status, cellwise_glue_is_valid(&glue)
 *     every ten minutes, and where cellwise_glue_has_moved(&glue):
 *     which = cellwise_glue_keep(&glue);   write glue.slots[which], then nothing but that
 */
#ifndef CELLWISE_GLUE_H
#define CELLWISE_GLUE_H

#include "cellwise_cell.h"
#include "cellwise_clock.h"
#include "cellwise_store.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define CELLWISE_GLUE_COMPONENTS (@COMPONENTS@u)
#define CELLWISE_GLUE_START_SOC (0.5f) /* nobody says where it begins */
#define CELLWISE_GLUE_START_VARIANCE (0.09f)
#define CELLWISE_GLUE_MOVED_SOC (0.01f) /* what a loss of power costs at most */
/* Readings without which a SOC is no estimate any more. */
#define CELLWISE_GLUE_BLIND (CELLWISE_STATE_RESET | CELLWISE_CURRENT_LOST | CELLWISE_VOLTAGE_LOST)

typedef struct {
#if CELLWISE_BANK
    cellwise_bank bank;
#endif
    cellwise_state state[CELLWISE_GLUE_COMPONENTS + 1u]; /* the estimate first */
    cellwise_stored slots[2];
    cellwise_clock clock;
    float charge_As; /* since the last step, positive on discharge, */
    uint32_t since_ms; /* and over how long */
    uint32_t called_ms;
    uint32_t faults; /* what the check of the tables has found; 0: they are whole */
    uint32_t restored; /* what the restore has found; 0: it goes on where it was */
    uint32_t status; /* bits of the last step */
    float soc;
    float soc_std;
    float kept_soc; /* of the last write; NAN: there was none */
    bool is_begun; /* a step has been made */
} cellwise_glue;

static inline void cellwise_glue_start(cellwise_glue *g, float soc, float variance)
{
#if CELLWISE_BANK
    g->status = cellwise_bank_init(&cellwise_cell, &g->bank, g->state, CELLWISE_GLUE_COMPONENTS, soc, variance);
#else
    g->status = cellwise_init(&cellwise_cell, &g->state[0], soc, variance);
#endif
    g->soc = g->state[0].soc;
    g->soc_std = sqrtf(g->state[0].ss);
    g->is_begun = false;
}

/* Check the tables, begin, and take back what the slots hold: of one that is damaged, or was cut, nothing. */
static inline uint32_t cellwise_glue_begin(cellwise_glue *g, uint32_t now_ms, uint32_t step_ms)
{
    const cellwise_stored *const newest = &g->slots[cellwise_newest_slot(&g->slots[0], &g->slots[1])];
    g->faults = cellwise_check_model(&cellwise_cell);
    cellwise_glue_start(g, CELLWISE_GLUE_START_SOC, CELLWISE_GLUE_START_VARIANCE);
#if CELLWISE_BANK
    g->restored = cellwise_bank_restore(&cellwise_cell, &g->bank, g->state, CELLWISE_GLUE_COMPONENTS, newest,
                                        CELLWISE_AGE_UNKNOWN);
#else
    g->restored = cellwise_restore(&cellwise_cell, &g->state[0], newest, CELLWISE_AGE_UNKNOWN);
#endif
    g->soc = g->state[0].soc;
    g->soc_std = sqrtf(g->state[0].ss);
    g->kept_soc = ((g->restored == 0u) || (g->restored == CELLWISE_OTHER_MODEL)) ? g->soc : NAN;
    g->charge_As = 0.0f;
    g->since_ms = 0u;
    g->called_ms = now_ms;
    cellwise_clock_begin(&g->clock, now_ms, step_ms);
    return g->faults;
}

static inline void cellwise_glue_step(cellwise_glue *g, float voltage_V, float temperature_C)
{
    cellwise_input in;
    cellwise_output out;
    in.current_A = g->charge_As / ((float)g->since_ms / 1000.0f);
    in.voltage_V = voltage_V;
    in.temperature_C = temperature_C;
    in.sequence = g->clock.sequence - 1u; /* the first interval ends with number 0 */
#if CELLWISE_BANK
    g->status = cellwise_bank_step(&cellwise_cell, &g->bank, g->state, CELLWISE_GLUE_COMPONENTS, &in, &out);
#else
    g->status = cellwise_step(&cellwise_cell, &g->state[0], &in, &out);
#endif
    g->soc = out.soc;
    g->soc_std = sqrtf(out.soc_variance);
    g->is_begun = true;
    g->charge_As = 0.0f;
    g->since_ms = 0u;
}

/* Whether a step was due and made: the mean current since the last one counts. NAN for what is not measured; on
 * damaged tables nothing is stepped. */
static inline bool cellwise_glue_sample(cellwise_glue *g, uint32_t now_ms, float current_A, float voltage_V,
                                        float temperature_C)
{
    const uint32_t passed_ms = now_ms - g->called_ms;
    bool is_due = false;
    g->charge_As = g->charge_As + (current_A * ((float)passed_ms / 1000.0f));
    g->since_ms = g->since_ms + passed_ms;
    g->called_ms = now_ms;
    if ((g->faults == 0u) && (g->since_ms > 0u)) {
        is_due = cellwise_clock_steps(&g->clock, now_ms) > 0u;
    }
    if (is_due) {
        cellwise_glue_step(g, voltage_V, temperature_C);
    }
    return is_due;
}

/* Whether the SOC may be shown: tables whole, a step made, its readings there. */
static inline bool cellwise_glue_is_valid(const cellwise_glue *g)
{
    return (g->faults == 0u) && g->is_begun && ((g->status & CELLWISE_GLUE_BLIND) == 0u);
}

/* Whether the SOC is a point from what was written last: counted, or learnt. A start that nobody knows waits for its
 * regular write, so that slots which are read late are not written over. */
static inline bool cellwise_glue_has_moved(const cellwise_glue *g)
{
    return fabsf(g->soc - g->kept_soc) >= CELLWISE_GLUE_MOVED_SOC;
}

/* Fill the slot that is not the newest; which one is to be written. A loss of power leaves the other as it is. */
static inline uint32_t cellwise_glue_keep(cellwise_glue *g)
{
    const uint32_t newest = cellwise_newest_slot(&g->slots[0], &g->slots[1]);
    cellwise_keep(&g->slots[1u - newest], &g->state[0], &g->slots[newest]);
    g->kept_soc = g->soc;
    return 1u - newest;
}

#ifdef __cplusplus
}
#endif

#endif
