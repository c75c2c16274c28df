/* Tables that are whole, and a state that outlives a switch-off: checked at start.
 * Every check is a CRC-32 (IEEE 802.3) over 32-bit words, least significant byte first: the same on
 * every byte order. No heap, no static data, no tables. */
#ifndef CELLWISE_STORE_H
#define CELLWISE_STORE_H

#include "cellwise_ekf.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a check found; 0: nothing. */
#define CELLWISE_NOT_STORED 1u /* no magic number: never written, or erased */
#define CELLWISE_OTHER_LAYOUT 2u /* written by a build with other options or another version */
#define CELLWISE_OTHER_MODEL 4u /* of tables other than the ones at hand */
#define CELLWISE_BITS_DAMAGED 8u /* the CRC does not fit */

typedef struct {
    uint32_t magic;
    uint32_t layout; /* version of this layout */
    uint32_t bytes; /* of the state */
    uint32_t model_crc; /* of the tables that it was estimated with */
    cellwise_state state;
    uint32_t crc; /* of everything before */
} cellwise_stored;

/* Compare the tables with the CRC that the export wrote beside them. */
uint32_t cellwise_check_model(const cellwise_model *m);

/* Fill what is to be written to non-volatile memory. */
void cellwise_keep(cellwise_stored *into, const cellwise_state *x);

/* Take the state back. Where it returns anything but 0, `x` is untouched: call cellwise_init. */
uint32_t cellwise_restore(cellwise_state *x, const cellwise_stored *from);

#if CELLWISE_CELLS
typedef struct {
    uint32_t magic;
    uint32_t layout;
    uint32_t bytes; /* of one cell */
    uint32_t model_crc;
    uint32_t count; /* of cells */
    uint32_t crc; /* of everything before, and of the cells */
} cellwise_stored_cells;

/* Fill what is written beside the array of cells. */
void cellwise_keep_cells(cellwise_stored_cells *into, const cellwise_pack_cell *cells,
                         uint32_t count);

/* Whether an array of cells that was read back is what was written. Where it returns anything but
 * 0: call cellwise_cells_init. */
uint32_t cellwise_restore_cells(const cellwise_stored_cells *from, const cellwise_pack_cell *cells,
                                uint32_t count);
#endif

#ifdef __cplusplus
}
#endif

#endif
