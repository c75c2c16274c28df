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
    uint32_t unit; /* number of the target */
    float degrees; /* sum of temperatures, over rows */
    float segments; /* simulations that were summed, */
    float rows; /* and their rows, faded as the sums are */
    float sum[CELLWISE_SKETCH_SUMS]; /* of products, by pairs */
    float part[CELLWISE_SKETCH_SUMS]; /* those of this simulation */
    float past[CELLWISE_SKETCH]; /* slow part of residual and derivatives, */
    float past_share[CELLWISE_SKETCH]; /* and what is a share of the drop */
    float now[CELLWISE_SKETCH]; /* their news in the last row */
    float slow; /* variance of the slow part, of its own; below 0: no row yet */
    float share; /* that of the share, */
    float both; /* and their covariance */
    float soc; /* of the simulation */
    float start_soc;
    float v1_V;
    float v2_V;
    float v3_V;
    float fast_ohm; /* of the first branch, since the last row, */
    float fast_gain; /* and what it follows in a step */
    float h;
    float slow_A; /* current that a slow branch has followed */
    float path; /* hysteresis that the model may lack */
    float sum_A; /* since the last row */
    float last_A; /* current of the last sample */
    uint32_t count; /* samples since the last row; all bits set: no simulation */
    uint32_t blocks; /* rows since the simulation began */
    uint32_t sequence; /* of the last sample */
    uint32_t crc; /* of all before it */
} cellwise_sketch;

/* An empty sketch of the target with that number. */
void cellwise_sketch_init(const cellwise_model *m, cellwise_sketch *k, uint32_t unit);

/* After a step: the sample of that step to the sketch. The simulation begins where the deviation of SOC is small. A
 * gap, or a current that no sensor can have meant, ends it. A sample that comes again is left out. */
void cellwise_sketch_add(const cellwise_model *m, const cellwise_state *x, cellwise_sketch *k,
                         const cellwise_input *sample);

#ifdef __cplusplus
}
#endif

#endif
