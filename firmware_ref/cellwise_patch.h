/* A patch of one cell in the field: a part of cellwise_store.c. */
#ifndef CELLWISE_PATCH_H
#define CELLWISE_PATCH_H

#include "cellwise_crc.h"
#include "cellwise_store.h"

#define PATCH_MAGIC 0x50573031u /* "PW01" */
#define PATCH_LAYOUT 2u
#define LEAST_PER_CAPACITY 0.5f /* as in a state that is sound, */
#define MOST_PER_CAPACITY 10.0f
#define LEAST_RESISTANCE 0.1f
#define MOST_RESISTANCE 20.0f
#define LEAST_PER_GAIN 0.5f /* a sensor further off is another one, */
#define MOST_PER_GAIN 2.0f
#define MOST_SHIFT_V 0.2f /* an OCV another cell's, */
#define MOST_C 100.0f /* no cell is so warm, or as far from 20 degC */
#define LEAST_C -60.0f
#define MOST_PER_K 1.0f /* nearer rows would magnify what a temperature is off by */
#ifndef WITHIN /* as in cellwise_float.h: a NaN is beyond every bound */
#define WITHIN(x, low, high) (((x) >= (low)) && ((x) <= (high)))
#endif

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
    taken->per_capacity = 1.0f;
    taken->offset_A = 0.0f;
    taken->per_gain = 1.0f;
    taken->cold_C = 0.0f;
    taken->per_K = MOST_PER_K;
    for (uint32_t k = 0u; k < CELLWISE_PATCH_KNOTS; k++) {
        taken->resistance[0][k] = 1.0f;
        taken->resistance[1][k] = 1.0f;
    }
    for (uint32_t k = 0u; k < CELLWISE_PATCH_SHIFTS; k++) {
        taken->shift_V[k] = 0.0f;
    }
    taken->crc = crc_of_patch(taken);
}

/* An offset is less than what is assumed of a current that nobody measures. */
static bool is_sensor(const cellwise_model *m, const cellwise_patch *from)
{
    const bool is_offset = (from->offset_A * from->offset_A) <= m->constant.lost_A2;
    return WITHIN(from->per_gain, LEAST_PER_GAIN, MOST_PER_GAIN) && is_offset;
}

static bool is_cell(const cellwise_patch *from)
{
    bool found = WITHIN(from->per_capacity, LEAST_PER_CAPACITY, MOST_PER_CAPACITY) &&
        WITHIN(from->cold_C, LEAST_C, MOST_C) && WITHIN(from->per_K, 0.0f, MOST_PER_K);
    for (uint32_t k = 0u; k < CELLWISE_PATCH_KNOTS; k++) {
        found = found && WITHIN(from->resistance[0][k], LEAST_RESISTANCE, MOST_RESISTANCE) &&
            WITHIN(from->resistance[1][k], LEAST_RESISTANCE, MOST_RESISTANCE);
    }
    for (uint32_t k = 0u; k < CELLWISE_PATCH_SHIFTS; k++) {
        found = found && WITHIN(from->shift_V[k], -MOST_SHIFT_V, MOST_SHIFT_V);
    }
    return found;
}

void cellwise_no_patch(cellwise_patch *taken)
{
    neutral_patch(taken, 0u);
}

/* CW-020: what is refused changes nothing. */
uint32_t cellwise_take_patch(const cellwise_model *m, cellwise_patch *taken, const cellwise_patch *from)
{
    const bool is_the_same = (from->generation == taken->generation) && (from->crc == taken->crc);
    uint32_t found = 0u;
    if (from->magic != PATCH_MAGIC) {
        found = CELLWISE_NOT_STORED;
    } else if (from->layout != PATCH_LAYOUT) { /* of version 1 no more than this was read */
        found = CELLWISE_OTHER_LAYOUT;
    } else if (from->crc != crc_of_patch(from)) {
        found = CELLWISE_BITS_DAMAGED;
    } else if (from->model_crc != CELLWISE_MODEL_CRC) {
        found = CELLWISE_OTHER_MODEL;
    } else if ((from->generation <= taken->generation) && !is_the_same) {
        found = CELLWISE_OLD_PATCH;
    } else if (!is_sensor(m, from) || !is_cell(from)) {
        found = CELLWISE_BEYOND_BOUNDS;
    } else {
        *taken = *from;
    }
    return found;
}

void cellwise_undo_patch(cellwise_patch *taken)
{
    neutral_patch(taken, taken->generation);
}

/* Within a range; what is no number at its lower end. */
static float held_in(float value, float least, float most)
{
    float found = least;
    if (WITHIN(value, least, most)) {
        found = value;
    } else if (value > most) {
        found = most;
    } else { /* below, or none */
    }
    return found;
}

/* A line between even knots over SOC, which is within 0..1. */
static float at_knots(const float *over, uint32_t last, float soc)
{
    const float place = soc * (float)last;
    const uint32_t under = (uint32_t)place;
    const uint32_t k = (under < last) ? under : (last - 1u);
    return over[k] + ((place - (float)k) * (over[k + 1u] - over[k]));
}

/* Of memory that lost its content, too, a state stays sound. */
static void patch_state(const cellwise_patch *taken, cellwise_state *x)
{
    const float soc = held_in(x->soc, 0.0f, 1.0f);
    const float cold = at_knots(taken->resistance[0], CELLWISE_PATCH_KNOTS - 1u, soc);
#if CELLWISE_NEEDS_TEMPERATURE
    const float weight = held_in((x->temperature_C - taken->cold_C) * taken->per_K, 0.0f, 1.0f);
    const float warm = at_knots(taken->resistance[1], CELLWISE_PATCH_KNOTS - 1u, soc);
    const float scale = cold + (weight * (warm - cold));
#else
    const float scale = cold;
#endif
    x->resistance_scale = held_in(scale, LEAST_RESISTANCE, MOST_RESISTANCE);
    x->per_capacity = held_in(taken->per_capacity, LEAST_PER_CAPACITY, MOST_PER_CAPACITY);
}

void cellwise_patch_sample(const cellwise_patch *taken, cellwise_state *x, uint32_t count, cellwise_input *sample)
{
    if ((taken->generation != 0u) && (taken->model_crc == CELLWISE_MODEL_CRC)) {
        const float soc = held_in(x->soc, 0.0f, 1.0f);
        sample->current_A = (sample->current_A - taken->offset_A) * taken->per_gain;
        sample->voltage_V = sample->voltage_V - at_knots(taken->shift_V, CELLWISE_PATCH_SHIFTS - 1u, soc);
        for (uint32_t k = 0u; k < count; k++) {
            patch_state(taken, &x[k]);
        }
    }
}

#endif
