#include "cellwise_store.h"

#include <string.h>

#define MAGIC 0x43573031u /* "CW01" */
#define LAYOUT 1u
#define POLYNOMIAL 0xEDB88320u
#define WORD ((uint32_t)sizeof(uint32_t))

/* One bit at a time: a start has milliseconds, flash has no room for a table. */
static uint32_t more_words(uint32_t crc, const void *data, uint32_t bytes)
{
    const unsigned char *at = (const unsigned char *)data;
    uint32_t done;

    for (done = 0u; done + WORD <= bytes; done += WORD) {
        uint32_t word;
        uint32_t bit;

        memcpy(&word, at + done, sizeof word);
        for (bit = 0u; bit < 32u; bit++) {
            uint32_t low = (crc ^ word) & 1u;

            crc >>= 1;
            word >>= 1;
            if (low != 0u) {
                crc ^= POLYNOMIAL;
            }
        }
    }
    return crc;
}

static uint32_t crc_of_words(const void *data, uint32_t bytes)
{
    return ~more_words(0xFFFFFFFFu, data, bytes);
}

uint32_t cellwise_check_model(const cellwise_model *m)
{
    uint32_t found = 0u;

    if (sizeof *m != CELLWISE_MODEL_BYTES) {
        found |= CELLWISE_OTHER_LAYOUT;
    }
    if (crc_of_words(m, (uint32_t)sizeof *m) != CELLWISE_MODEL_CRC) {
        found |= CELLWISE_BITS_DAMAGED;
    }
    return found;
}

void cellwise_keep(cellwise_stored *into, const cellwise_state *x)
{
    into->magic = MAGIC;
    into->layout = LAYOUT;
    into->bytes = (uint32_t)sizeof(cellwise_state);
    into->model_crc = CELLWISE_MODEL_CRC;
    into->state = *x;
    into->crc = crc_of_words(into, (uint32_t)(sizeof *into) - WORD);
}

uint32_t cellwise_restore(cellwise_state *x, const cellwise_stored *from)
{
    if (from->magic != MAGIC) {
        return CELLWISE_NOT_STORED;
    }
    if (from->layout != LAYOUT || from->bytes != (uint32_t)sizeof(cellwise_state)) {
        return CELLWISE_OTHER_LAYOUT;
    }
    if (from->crc != crc_of_words(from, (uint32_t)(sizeof *from) - WORD)) {
        return CELLWISE_BITS_DAMAGED;
    }
    if (from->model_crc != CELLWISE_MODEL_CRC) {
        return CELLWISE_OTHER_MODEL;
    }
    *x = from->state;
    return 0u;
}

#if CELLWISE_CELLS
static uint32_t crc_of_cells(const cellwise_stored_cells *head, const cellwise_pack_cell *cells,
                             uint32_t count)
{
    const uint32_t crc = more_words(0xFFFFFFFFu, head, (uint32_t)(sizeof *head) - WORD);

    return ~more_words(crc, cells, count * (uint32_t)sizeof(cellwise_pack_cell));
}

void cellwise_keep_cells(cellwise_stored_cells *into, const cellwise_pack_cell *cells,
                         uint32_t count)
{
    into->magic = MAGIC;
    into->layout = LAYOUT;
    into->bytes = (uint32_t)sizeof(cellwise_pack_cell);
    into->model_crc = CELLWISE_MODEL_CRC;
    into->count = count;
    into->crc = crc_of_cells(into, cells, count);
}

uint32_t cellwise_restore_cells(const cellwise_stored_cells *from, const cellwise_pack_cell *cells,
                                uint32_t count)
{
    if (from->magic != MAGIC) {
        return CELLWISE_NOT_STORED;
    }
    if ((from->layout != LAYOUT) || (from->bytes != (uint32_t)sizeof(cellwise_pack_cell)) ||
        (from->count != count)) {
        return CELLWISE_OTHER_LAYOUT;
    }
    if (from->crc != crc_of_cells(from, cells, count)) {
        return CELLWISE_BITS_DAMAGED;
    }
    if (from->model_crc != CELLWISE_MODEL_CRC) {
        return CELLWISE_OTHER_MODEL;
    }
    return 0u;
}
#endif
