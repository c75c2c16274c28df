/* A sketch of the residual: sums for a diagnosis from nothing else. Printed from src/cellwise/estimate by `python -m
 * cellwise.printing`; do not edit. */
/* After each step, with the sample of that step. cellwise_store.h seals what is read out. */
#ifndef CELLWISE_SKETCH_H
#define CELLWISE_SKETCH_H

#include "cellwise_ekf.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    uint32_t magic; /* set with the CRC by `cellwise_seal_sketch` */
    uint32_t model_crc; /* of the tables */
    uint32_t generation; /* counts what was sealed */
    uint32_t segments; /* simulations that were summed, */
    uint32_t rows; /* and their blocks */
    float sum[CELLWISE_SKETCH]; /* of products, by pairs */
    float carry[CELLWISE_SKETCH]; /* what rounding has kept from them */
    float past[CELLWISE_SKETCH - 55u]; /* slow part of every regressor */
    float now[CELLWISE_SKETCH - 55u]; /* news of the last block */
    float slow_V2; /* variance of the slow part */
    float soc; /* of the simulation */
    float start_soc;
    float v1_V;
    float v2_V;
    float v3_V;
    float d1_V; /* that 1 A more would add */
    float d2_V; /* that 1 A more would add */
    float d3_V; /* that 1 A more would add */
    float h;
    float offset_soc; /* SOC by 1 A more */
    float slow_A; /* current that a slow branch has followed */
    float path; /* hysteresis that the model may lack */
    float last_V; /* of the block before */
    float sum_A; /* in this block */
    float sum_V;
    uint32_t count; /* its samples, */
    uint32_t read; /* and their voltages */
    uint32_t blocks; /* since the simulation began */
    uint32_t counted; /* whether one of them was summed */
    uint32_t on; /* whether it runs */
    uint32_t sequence; /* of the last sample */
    uint32_t crc; /* of all before it */
} cellwise_sketch;

/* An empty sketch. */
void cellwise_sketch_init(const cellwise_model *m, cellwise_sketch *k);

/* After a step: the sample of that step to the sketch. The simulation begins where the deviation of SOC is small. A
 * gap, or a current that no sensor can have meant, ends it. A sample that comes again is left out. */
void cellwise_sketch_add(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k,
                         const cellwise_input *sample);

#ifdef __cplusplus
}
#endif

#endif
