/* Capacity that is left, between rests far apart, and resistance, after one. Printed from src/cellwise/estimate by
 * `python -m cellwise.printing`; do not edit. */
/* Where it is compiled in: cellwise_soh_step after each cellwise_step, on a record that is kept over a switch-off beside
 * the state, for the tables it was made with: cellwise_soh_init for others. What it says is asked for by
 * cellwise_soh_of. As the current sensor counts it: one that shows too much shows too much capacity, and too little
 * resistance. */
#ifndef CELLWISE_SOH_H
#define CELLWISE_SOH_H

#include "cellwise_ekf.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    float share; /* of the tables' capacity that is left, */
    float share_variance; /* and its variance */
    float off; /* offset of the current, in its deviations beforehand */
    float qq; /* covariance of the two that weighs, */
    float qo;
    float oo;
    float own_qq; /* and that beside an error of the OCV's table */
    float own_qo;
    float own_oo;
    float share_error; /* what an error of the OCV's table has moved in them */
    float off_error;
    float soc; /* of the rest that is counted from, */
    float variance; /* its variance; 0: there is none */
    float counted; /* SOC that has left since */
    float counted_carry; /* what rounding has kept from it */
    float moved; /* SOC that flowed since, either way */
    float unsure; /* variance of what flowed in gaps since */
    float current_A; /* of the last sample */
    float voltage_V; /* last one of a long rest */
    float held_V; /* by the branches then */
    uint32_t counted_from; /* sequence of the sample that ended it */
    uint32_t loaded; /* sequence of the last sample with a load */
    uint32_t silent; /* steps without a current; not with CELLWISE_WIDE */
    float resistance; /* scale of the tables' resistances, */
    float resistance_variance; /* and its variance */
    float rr; /* that which weighs, beside the model's own error */
    uint32_t watched; /* 1: a long rest, 2: the first load after it */
    uint32_t rest_end; /* sequence of its last sample */
    uint32_t loads; /* after a rest that were used */
    uint32_t pairs; /* of rests that were used */
    uint32_t refused; /* pairs in a row that were not */
    uint32_t sequence; /* of the last sample */
    uint32_t begun; /* 0: no sample yet */
} cellwise_soh;

typedef struct {
    float share; /* of the tables' capacity that is left, */
    float share_variance; /* and its variance */
    float resistance; /* scale of the tables' resistances, */
    float resistance_variance; /* and its variance */
} cellwise_soh_output;

/* Before the first sample: the capacity of the tables, known as that of any used cell. */
void cellwise_soh_init(const cellwise_model *m, cellwise_soh *a);

/* After each step, with its sample: count, watch for rests, and use a pair of them. A current that is missing for
 * longer than what is bridged makes the count worthless: it begins again at the next rest. A load after a rest shows
 * the resistance. */
void cellwise_soh_step(const cellwise_model *m, const cellwise_state *x, cellwise_soh *a, const cellwise_input *sample);

/* What is known of the cell now; a record whose memory lost its content begins again. */
void cellwise_soh_of(const cellwise_model *m, cellwise_soh *a, cellwise_soh_output *out);

#ifdef __cplusplus
}
#endif

#endif
