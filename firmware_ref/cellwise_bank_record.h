/* What is kept of a start that is not known, beside its states. Printed from src/cellwise/estimate by `python -m
 * cellwise.printing`; do not edit. */
/* Kept by the caller beside the states of a bank: cellwise_bank_init sets it. The components follow the estimate in
 * blocks of samples, one of them with every sample. */
#ifndef CELLWISE_BANK_RECORD_H
#define CELLWISE_BANK_RECORD_H

#include <stdint.h>

typedef struct {
    float mean_A; /* of the load since a start under load, */
    float looked_A; /* and what it was at the last look */
    float mismatch; /* running mean of squared innovation over variance */
    uint32_t spread; /* 1: the components are stepped, 0: the estimate alone */
    uint32_t likeliest; /* which component, from 1 on */
    float since; /* steps since the start */
    uint32_t looks; /* how often the past has been looked at */
    float next_look; /* when it is next */
    float soc; /* of the estimate where a block began */
    float v1_V;
    float v2_V;
    float v3_V;
    float h;
    float ss;
    float steps; /* of the block, */
    float samples; /* its samples, */
    float readings; /* and those with a voltage; */
    float off_V; /* the mean of their innovations, */
    float block_A; /* of their current, */
    float unknown_A2; /* and of a current that nobody measured */
    float first_V2; /* its first innovation's variance */
    uint32_t known; /* 1: a voltage has been used before it */
    uint32_t turn; /* the component that follows the last block next; 0: none */
    uint32_t look; /* at the past, that goes with it */
    float moved; /* what it has done: to the SOC, */
    float grown; /* to its variance, */
    float gain1; /* to the branches, each */
    float gain2;
    float gain3;
    float current1; /* by a current, */
    float current2;
    float current3;
    float square_A2; /* of which so much is not known, */
    float keep_h; /* and to h */
    float rise_h;
    float said_V; /* its voltage, */
    float said_A; /* under this current, */
    float error_V2; /* its variance, */
    float weight_V2; /* and what it weighs with, */
    float below; /* over this; */
    float share; /* how much of it is new */
    float lately; /* its weight in the running mismatch */
    float mean_off_V; /* off what components have expected, their mean, */
    float square_V2; /* mean square, */
    float own_V2; /* and variance; */
    float left_V; /* the same after it, their mean, */
    float left_V2; /* mean square */
    uint32_t sequence; /* of the last sample */
} cellwise_bank;
#endif
