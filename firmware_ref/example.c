/* Steps the filter through test_vector.h and compares every bit; prints some of it.
 *
 *     cc -std=c99 -O2 -ffp-contract=off example.c cellwise_ekf.c cellwise_store.c cell_table.c
 *
 * prints what expected_output.txt holds, and returns 0. */
#include <stdio.h>
#include <string.h>

#include "cellwise_cell.h"
#include "cellwise_store.h"
#include "test_vector.h"

int main(void)
{
    cellwise_state state;
    cellwise_stored slot[2]; /* in flash or FRAM, each on pages of its own */
    uint32_t newest;
    cellwise_output out;
#if CELLWISE_REMAINING
    cellwise_plan_result landing;
#endif
    unsigned wrong = 0u;
    unsigned k;

    if (cellwise_check_model(&cellwise_cell) != 0u) {
        puts("the tables are damaged");
        return 2;
    }
    cellwise_init(&cellwise_cell, &state, CELLWISE_VECTOR_SOC, CELLWISE_VECTOR_VARIANCE);
    for (k = 0u; k < CELLWISE_VECTOR_SAMPLES; k++) {
        cellwise_step(&cellwise_cell, &state, &cellwise_vector_inputs[k], &out);
        wrong += memcmp(&out, &cellwise_vector_outputs[k], sizeof out) != 0;
        if (k % 20u == 19u) {
            printf("%3u  soc %.6f  variance %.3e  status %lu\n", k + 1u, (double)out.soc,
                   (double)out.soc_variance, (unsigned long)out.status);
        }
    }
#if CELLWISE_REMAINING /* a plan of powers, and the chance to end it above a SOC */
    cellwise_plan(&cellwise_cell, &state, cellwise_plan_phases, CELLWISE_PLAN_PHASES, true,
                  CELLWISE_PLAN_ABOVE, &landing);
    wrong += memcmp(&landing, &cellwise_plan_end, sizeof landing) != 0;
#endif
    memset(slot, 0xFF, sizeof slot); /* erased */
    newest = cellwise_newest_slot(&slot[0], &slot[1]);
    cellwise_keep(&slot[1u - newest], &state, &slot[newest]); /* before switching off; at the next start: */
    newest = cellwise_newest_slot(&slot[0], &slot[1]);
    wrong += cellwise_restore(&cellwise_cell, &state, &slot[newest], CELLWISE_AGE_UNKNOWN) != 0u;
    puts(wrong == 0u ? "every bit as expected" : "DIFFERENT BITS");
    return wrong != 0u;
}
