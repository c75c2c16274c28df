/* A patch of one cell in the field: a part of cellwise_store.c. */
#ifndef CELLWISE_PATCH_H
#define CELLWISE_PATCH_H

#include "cellwise_crc.h"
#include "cellwise_store.h"

#define PATCH_MAGIC 0x50573031u /* "PW01" */
#define PATCH_LAYOUT 1u
#define LEAST_PER_GAIN 0.5f /* a sensor further off is another one */
#define MOST_PER_GAIN 2.0f

static uint32_t crc_of_patch(const cellwise_patch *patch)
{
    return ~more_words(CRC_BEGIN, (const uint8_t *)patch, (uint32_t)(sizeof *patch) - WORD);
}

static void neutral_patch(cellwise_patch *taken, uint32_t generation)
{
    taken->magic = PATCH_MAGIC;
    taken->layout = PATCH_LAYOUT;
    taken->model_crc = CELLWISE_MODEL_CRC;
    taken->generation = generation;
    taken->capacity_share = 1.0f;
    taken->resistance_scale = 1.0f;
    taken->offset_A = 0.0f;
    taken->per_gain = 1.0f;
    taken->crc = crc_of_patch(taken);
}

/* An offset is less than what is assumed of a current that nobody measures. A NaN is beyond every bound. */
static bool is_sensor(const cellwise_model *m, const cellwise_patch *from)
{
    const bool is_gain = (from->per_gain >= LEAST_PER_GAIN) && (from->per_gain <= MOST_PER_GAIN);
    const bool is_offset = (from->offset_A * from->offset_A) <= m->constant.lost_A2;
    return is_gain && is_offset;
}

void cellwise_no_patch(cellwise_patch *taken)
{
    neutral_patch(taken, 0u);
}

/* CW-020: what is refused changes nothing. */
uint32_t cellwise_take_patch(const cellwise_model *m, cellwise_state *x, cellwise_patch *taken,
                             const cellwise_patch *from)
{
    const bool is_the_same = (from->generation == taken->generation) && (from->crc == taken->crc);
    uint32_t found = 0u;
    if (from->magic != PATCH_MAGIC) {
        found = CELLWISE_NOT_STORED;
    } else if (from->layout != PATCH_LAYOUT) {
        found = CELLWISE_OTHER_LAYOUT;
    } else if (from->crc != crc_of_patch(from)) {
        found = CELLWISE_BITS_DAMAGED;
    } else if (from->model_crc != CELLWISE_MODEL_CRC) {
        found = CELLWISE_OTHER_MODEL;
    } else if ((from->generation <= taken->generation) && !is_the_same) {
        found = CELLWISE_OLD_PATCH;
    } else if (!is_sensor(m, from)) {
        found = CELLWISE_BEYOND_BOUNDS;
    } else if (cellwise_set_health(m, x, from->capacity_share, from->resistance_scale) != 0u) {
        found = CELLWISE_BEYOND_BOUNDS;
    } else {
        *taken = *from;
    }
    return found;
}

uint32_t cellwise_undo_patch(const cellwise_model *m, cellwise_state *x, cellwise_patch *taken)
{
    uint32_t found = CELLWISE_BEYOND_BOUNDS;
    if (cellwise_set_health(m, x, 1.0f, 1.0f) == 0u) {
        neutral_patch(taken, taken->generation);
        found = 0u;
    }
    return found;
}

float cellwise_patched_current(const cellwise_patch *taken, float current_A)
{
    return (current_A - taken->offset_A) * taken->per_gain;
}

#endif
