/* CRC-32 (IEEE 802.3) over 32-bit words: a part of cellwise_store.c. */
#ifndef CELLWISE_CRC_H
#define CELLWISE_CRC_H

#include "cellwise_ekf.h"

#include <string.h>

#define POLYNOMIAL 0xEDB88320u
#define CRC_BEGIN 0xFFFFFFFFu
#define WORD ((uint32_t)sizeof(uint32_t))

/* One bit at a time: a start has milliseconds, flash has no room for a table. */
static uint32_t more_words(uint32_t crc, const uint8_t *at, uint32_t bytes)
{
    uint32_t found = crc;
    for (uint32_t done = 0u; (done + WORD) <= bytes; done += WORD) {
        uint32_t word;
        (void)memcpy(&word, &at[done], sizeof word);
        for (uint32_t bit = 0u; bit < 32u; bit++) {
            const bool is_odd = ((found ^ word) & 1u) != 0u;
            found >>= 1u;
            word >>= 1u;
            if (is_odd) {
                found ^= POLYNOMIAL;
            }
        }
    }
    return found;
}

#endif
