#include "cellwise_store.h"
#include "cellwise_crc.h"
#if CELLWISE_HEALTH
#include "cellwise_patch.h"
#endif
#if CELLWISE_SKETCH
#include "cellwise_seal.h"
#endif

#define MAGIC 0x43573032u /* "CW02" */
#define LAYOUT 2u
#define HALF 0x80000000u
#define LONGEST_GAP 0x100000u /* time steps; a step counts no more */

/* What a state holds: with other tables it goes on where this is the same. */
#if CELLWISE_NEEDS_TEMPERATURE
#define WARM_PART 1u
#else
#define WARM_PART 0u
#endif
#define STATE_PARTS \
    (WARM_PART + (2u * (uint32_t)CELLWISE_SLOW) + (4u * (uint32_t)CELLWISE_HYSTERESIS) + \
     (8u * (uint32_t)CELLWISE_HEATING) + (16u * (uint32_t)CELLWISE_SURFACE) + (32u * (uint32_t)CELLWISE_WIDE) + \
     (64u * (uint32_t)CELLWISE_OFFSET) + (128u * (uint32_t)CELLWISE_BANK) + (256u * (uint32_t)CELLWISE_HEALTH) + \
     (512u * (uint32_t)CELLWISE_CELLS))
#define STATE_KIND ((uint32_t)sizeof(cellwise_state) + (0x10000u * STATE_PARTS))

/* Of a head but for the CRC at its end. */
static uint32_t crc_of_head(const cellwise_stored_head *head)
{
    return ~more_words(CRC_BEGIN, (const uint8_t *)head, (uint32_t)(sizeof *head) - WORD);
}

/* Goes on from the head's: over the head with its CRC behind it every CRC is the same, and the state of one slot
 * would fit the head of another. */
static uint32_t crc_of_state(const cellwise_stored *stored)
{
    return ~more_words(stored->head.crc, (const uint8_t *)&stored->state, (uint32_t)sizeof(cellwise_state));
}

/* CW-015: in pieces as in one go. */
uint32_t cellwise_check_model_part(const cellwise_model *m, cellwise_check *check, uint32_t words)
{
    const uint32_t all = (uint32_t)sizeof(cellwise_model) / WORD;
    uint32_t found = 0u;
    if (sizeof(cellwise_model) != CELLWISE_MODEL_BYTES) {
        found = CELLWISE_OTHER_LAYOUT;
    }
    if ((check->words == 0u) || (check->words >= all)) {
        check->words = 0u;
        check->crc = CRC_BEGIN;
    }
    const uint32_t left = all - check->words;
    const uint32_t now = (words < left) ? words : left;
    const uint8_t *const at = (const uint8_t *)m;
    check->crc = more_words(check->crc, &at[check->words * WORD], now * WORD);
    check->words = check->words + now;
    if (check->words < all) {
        found = CELLWISE_CHECK_GOES_ON;
    } else {
        check->words = 0u;
        if (~check->crc != CELLWISE_MODEL_CRC) {
            found |= CELLWISE_BITS_DAMAGED;
        }
    }
    return found;
}

uint32_t cellwise_check_model(const cellwise_model *m)
{
    cellwise_check check = {0u, 0u};
    return cellwise_check_model_part(m, &check, CELLWISE_MODEL_BYTES);
}

/* CW-011: what is not whole is not used. Of a state of another kind the head alone can be checked. */
static uint32_t fault_of(const cellwise_stored *from)
{
    const cellwise_stored_head *const head = &from->head;
    uint32_t found = 0u;
    if (head->magic != MAGIC) {
        found = CELLWISE_NOT_STORED;
    } else if (head->layout != LAYOUT) {
        found = CELLWISE_OTHER_LAYOUT;
    } else if (head->crc != crc_of_head(head)) {
        found = CELLWISE_BITS_DAMAGED;
    } else if (head->kind != STATE_KIND) {
        found = CELLWISE_OTHER_MODEL;
    } else if (from->crc != crc_of_state(from)) {
        found = CELLWISE_BITS_DAMAGED;
    } else if (head->model_crc != CELLWISE_MODEL_CRC) {
        found = CELLWISE_OTHER_MODEL;
    } else { /* whole, and of these tables */
    }
    return found;
}

static bool is_usable(const cellwise_stored *from)
{
    const uint32_t fault = fault_of(from);
    return (fault == 0u) || (fault == CELLWISE_OTHER_MODEL);
}

/* CW-012: the later generation of the slots that are whole. */
uint32_t cellwise_newest_slot(const cellwise_stored *first, const cellwise_stored *second)
{
    uint32_t newest = 0u;
    if (is_usable(second)) {
        const bool is_later = (second->head.generation - first->head.generation) < HALF;
        if (is_later || !is_usable(first)) {
            newest = 1u;
        }
    }
    return newest;
}

void cellwise_keep(cellwise_stored *into, const cellwise_state *x, const cellwise_stored *newest)
{
    uint32_t generation = 0u;
    if (is_usable(newest)) {
        generation = newest->head.generation + 1u;
    }
    into->head.magic = MAGIC;
    into->head.layout = LAYOUT;
    into->head.kind = STATE_KIND;
    into->head.model_crc = CELLWISE_MODEL_CRC;
    into->head.generation = generation;
    into->head.soc = x->soc;
    into->head.soc_variance = x->ss;
    into->head.crc = crc_of_head(&into->head);
    into->state = *x;
    into->crc = crc_of_state(into);
}

/* Time steps of an age. */
static uint32_t steps_of(uint32_t age_s)
{
    const float steps = (float)age_s / CELLWISE_DT_S;
    return (steps < (float)LONGEST_GAP) ? (uint32_t)steps : LONGEST_GAP;
}

uint32_t cellwise_restore(const cellwise_model *m, cellwise_state *x, const cellwise_stored *from, uint32_t age_s)
{
    const uint32_t fault = fault_of(from);
    const uint32_t missing = steps_of(age_s);
    const bool is_gap = missing > m->constant.gap_steps;
    float variance = from->head.soc_variance;
    if (is_gap) {
        variance = variance + m->constant.gap_variance;
    }
    const bool is_other = fault == CELLWISE_OTHER_MODEL;
    if (is_other) {
        variance = variance + CELLWISE_CARRIED_VARIANCE;
    }
    const bool is_another_kind = is_other && (from->head.kind != STATE_KIND);
    const bool is_at_rest = is_gap && (CELLWISE_WIDE == 0); /* its step leaves branches over a gap where they are */
    if ((fault != 0u) && !is_other) { /* nothing to go on with */
    } else if (is_another_kind || is_at_rest) { /* CW-013: the SOC goes on */
        (void)cellwise_init(m, x, from->head.soc, variance);
    } else {
        *x = from->state;
        x->sequence = 0xFFFFFFFFu - missing; /* CW-014: the step at number 0 sees what is missing */
        if (is_other) { /* CW-013: known less well, and no patch of the other tables */
            x->ss = x->ss + CELLWISE_CARRIED_VARIANCE;
#if CELLWISE_HEALTH
            x->per_capacity = 1.0f;
            x->resistance_scale = 1.0f;
#endif
        }
    }
    return fault;
}

#if CELLWISE_BANK
uint32_t cellwise_bank_restore(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                               const cellwise_stored *from, uint32_t age_s)
{
    cellwise_state kept;
    const uint32_t fault = cellwise_restore(m, &kept, from, age_s);
    if ((fault == 0u) || (fault == CELLWISE_OTHER_MODEL)) {
        const bool has_seen = kept.evidence > 1u; /* a voltage: it is no start */
        const bool is_gap = steps_of(age_s) > m->constant.gap_steps;
        (void)cellwise_bank_init(m, b, of, count, kept.soc, kept.ss);
        if (has_seen && is_gap) { /* CW-014: its step begins components again where the SOC is not known by then */
            b->spread = 0u;
        }
        if (b->spread == 0u) {
            of[0] = kept;
        }
    }
    return fault;
}
#endif

#if CELLWISE_CELLS
static uint32_t crc_of_cells(const cellwise_stored_cells *head, const cellwise_pack_cell *cells, uint32_t count)
{
    const uint32_t crc = more_words(CRC_BEGIN, (const uint8_t *)head, (uint32_t)(sizeof *head) - WORD);
    return ~more_words(crc, (const uint8_t *)cells, count * (uint32_t)sizeof(cellwise_pack_cell));
}

void cellwise_keep_cells(cellwise_stored_cells *into, const cellwise_stored *with, const cellwise_pack_cell *cells,
                         uint32_t count)
{
    into->magic = MAGIC;
    into->layout = LAYOUT;
    into->bytes = (uint32_t)sizeof(cellwise_pack_cell);
    into->model_crc = CELLWISE_MODEL_CRC;
    into->generation = with->head.generation;
    into->count = count;
    into->crc = crc_of_cells(into, cells, count);
}

uint32_t cellwise_restore_cells(const cellwise_stored_cells *from, const cellwise_stored *with,
                                const cellwise_pack_cell *cells, uint32_t count)
{
    const bool is_of_another = (from->layout != LAYOUT) || (from->count != count) ||
        (from->bytes != (uint32_t)sizeof(cellwise_pack_cell));
    uint32_t found = 0u;
    if (from->magic != MAGIC) {
        found = CELLWISE_NOT_STORED;
    } else if (is_of_another) {
        found = CELLWISE_OTHER_LAYOUT;
    } else if (from->crc != crc_of_cells(from, cells, count)) {
        found = CELLWISE_BITS_DAMAGED;
    } else if (from->model_crc != CELLWISE_MODEL_CRC) {
        found = CELLWISE_OTHER_MODEL;
    } else if (from->generation != with->head.generation) {
        found = CELLWISE_BITS_DAMAGED; /* one of the two was written in part */
    } else { /* whole, and of this state */
    }
    return found;
}
#endif
