/* Tables that are whole, and a state that outlives a switch-off.
 * Every check is a CRC-32 (IEEE 802.3) over 32-bit words, least significant byte first: the same on every byte
 * order. No heap, no static data, no tables. */
#ifndef CELLWISE_STORE_H
#define CELLWISE_STORE_H

#include "cellwise_ekf.h"
#if CELLWISE_SKETCH
#include "cellwise_sketch.h"
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* What a check found; 0: nothing. */
#define CELLWISE_NOT_STORED 1u /* no magic number: never written, or erased */
#define CELLWISE_OTHER_LAYOUT 2u /* written by another version, or cells of another number */
#define CELLWISE_OTHER_MODEL 4u /* of tables other than the ones at hand */
#define CELLWISE_BITS_DAMAGED 8u /* the CRC does not fit, or only a part was written */
#define CELLWISE_CHECK_GOES_ON 16u /* no fault so far, and not all of the tables read yet */

#define CELLWISE_AGE_UNKNOWN 0xFFFFFFFFu
/* Added to the variance of a SOC that goes on with other tables: 5 % of capacity, which is what two fits of one
 * cell may differ by. */
#define CELLWISE_CARRIED_VARIANCE 0.0025f

/* How far a check of the tables in pieces has come. {0u, 0u}: at the beginning. */
typedef struct {
    uint32_t words; /* read so far */
    uint32_t crc; /* of them */
} cellwise_check;

/* The same in every build, so that a SOC can be read by one with other tables. */
typedef struct {
    uint32_t magic;
    uint32_t layout; /* version of this struct */
    uint32_t kind; /* of the state behind it: its size and its parts */
    uint32_t model_crc; /* of the tables that it was estimated with */
    uint32_t generation; /* counts what was kept, wraps */
    float soc;
    float soc_variance;
    uint32_t crc; /* of everything before */
} cellwise_stored_head;

typedef struct {
    cellwise_stored_head head;
    cellwise_state state;
    uint32_t crc; /* of it, from the head's on */
} cellwise_stored;

/* Compare the tables with the CRC that the export wrote beside them. */
uint32_t cellwise_check_model(const cellwise_model *m);

/* The same a few words at a time, for a test in the background: CELLWISE_CHECK_GOES_ON until all are read, then
 * what cellwise_check_model returns, and from the beginning again. A row is sizeof(cellwise_row) / 4 words. */
uint32_t cellwise_check_model_part(const cellwise_model *m, cellwise_check *check, uint32_t words);

/* Which of two slots holds what was kept last: 0 the first, 1 the second. One that is damaged, or was written in
 * part, is passed over. Keep in the other one: a loss of power then leaves this one as it is. */
uint32_t cellwise_newest_slot(const cellwise_stored *first, const cellwise_stored *second);

/* Fill what is to be written to the slot that is not the newest; `newest` gives the generation. */
void cellwise_keep(cellwise_stored *into, const cellwise_state *x, const cellwise_stored *newest);

/* Take the state back after `age_s` seconds, or CELLWISE_AGE_UNKNOWN. Sequence numbers begin again: the first sample
 * is number 0, or as much later as it comes, and its step takes the time off into account.
 * 0: the state as it was kept, without CELLWISE_WIDE and after a gap its SOC at rest.
 * CELLWISE_OTHER_MODEL: the same with a variance that is wider for the other tables; where they come with another
 * kind of state the SOC alone, at rest.
 * Anything else: `x` is untouched, call cellwise_init. */
uint32_t cellwise_restore(const cellwise_model *m, cellwise_state *x, const cellwise_stored *from, uint32_t age_s);

#if CELLWISE_BANK
/* The same with a bank in front of the state: components are not kept. After a gap the estimate goes on as in a bank
 * that was not off: where the step finds its SOC too uncertain it begins components again, about what the state knows.
 * Without one they begin here, as at a start, where the SOC's variance asks for them. */
uint32_t cellwise_bank_restore(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                               const cellwise_stored *from, uint32_t age_s);
#endif

#if CELLWISE_SKETCH
/* Before a sketch is read out: its header and its CRC. Then begin a new one: cellwise_sketch_init. */
void cellwise_seal_sketch(cellwise_sketch *sketch);
#endif

#if CELLWISE_CELLS
/* Written beside the state of the mean cell and the array of cells, in the same slot. */
typedef struct {
    uint32_t magic;
    uint32_t layout;
    uint32_t bytes; /* of one cell */
    uint32_t model_crc;
    uint32_t generation; /* of the state that they belong to */
    uint32_t count; /* of cells */
    uint32_t crc; /* of everything before, and of the cells */
} cellwise_stored_cells;

/* Fill what is written beside the array of cells; `with` is the state that was kept. */
void cellwise_keep_cells(cellwise_stored_cells *into, const cellwise_stored *with, const cellwise_pack_cell *cells,
                         uint32_t count);

/* Whether an array of cells that was read back is what was written, with the state of this slot. Where it returns
 * anything but 0: call cellwise_cells_init. */
uint32_t cellwise_restore_cells(const cellwise_stored_cells *from, const cellwise_stored *with,
                                const cellwise_pack_cell *cells, uint32_t count);
#endif

#if CELLWISE_HEALTH
/* Beside the faults above: the block is older than the one that was taken, or says what no cell or sensor has. */
#define CELLWISE_OLD_PATCH 32u
#define CELLWISE_BEYOND_BOUNDS 64u

#define CELLWISE_PATCH_KNOTS 5u /* of resistances over SOC, evenly from 0 to 1, */
#define CELLWISE_PATCH_SHIFTS 9u /* and of the OCV's shift */

/* What is known of one cell and its current sensor beside the tables; `cellwise.export.patch` writes it. */
typedef struct {
    uint32_t magic;
    uint32_t layout;
    uint32_t model_crc; /* of the tables that it corrects */
    uint32_t generation; /* 0: none was taken; a later block has a larger one */
    float per_capacity; /* inverse of the share of the capacity that is left */
    float offset_A; /* what the sensor shows without a current */
    float per_gain; /* amperes that flow for each that it shows beside the offset */
    float cold_C; /* temperature of the first row of resistances, */
    float per_K; /* and 1 / the way from there to the second */
    float resistance[2][CELLWISE_PATCH_KNOTS]; /* factors on all resistances, cold and warm */
    float shift_V[CELLWISE_PATCH_SHIFTS]; /* of the OCV */
    uint32_t crc; /* of everything before */
} cellwise_patch;

/* Begin without a patch; `taken` is kept beside the state. */
void cellwise_no_patch(cellwise_patch *taken);

/* Take a block for all steps that follow: 0, or why it was refused, and then `taken` is as it was. */
uint32_t cellwise_take_patch(const cellwise_model *m, cellwise_patch *taken, const cellwise_patch *from);

/* Back to the tables as they were made. Generation stays: the same block is not taken again. */
void cellwise_undo_patch(cellwise_patch *taken);

/* Before each step, with its sample: of what the sensors show what they would show of the tables' own cell, and in
 * the states capacity and resistances at their SOC and temperature. `count` states are stepped: 1, or all of a bank
 * whose `spread` is 1. Nothing without a patch, nor with one of other tables. A state that was restored or reset
 * needs no more. */
void cellwise_patch_sample(const cellwise_patch *taken, cellwise_state *x, uint32_t count, cellwise_input *sample);
#endif

#ifdef __cplusplus
}
#endif

#endif
