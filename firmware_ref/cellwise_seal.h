/* The header and the CRC of a sketch: a part of cellwise_store.c. */
#ifndef CELLWISE_SEAL_H
#define CELLWISE_SEAL_H

#include "cellwise_crc.h"
#include "cellwise_store.h"

#define SKETCH_MAGIC (0x534B3230u + CELLWISE_SKETCH) /* "SK", the version, what is kept */

void cellwise_seal_sketch(cellwise_sketch *sketch)
{
    sketch->magic = SKETCH_MAGIC;
    sketch->model_crc = CELLWISE_MODEL_CRC;
    sketch->crc = ~more_words(CRC_BEGIN, (const uint8_t *)sketch, (uint32_t)(sizeof *sketch) - WORD);
}

#endif
