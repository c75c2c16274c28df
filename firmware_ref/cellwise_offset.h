/* Part of cellwise_ekf.c. What rests and voltages say of a current that is off all the time. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_OFFSET_H
#define CELLWISE_OFFSET_H

#include "cellwise_likelihood.h"

/* How long the current has stood still near zero, at what, and how much that shows now. */
typedef struct {
    float lasts;
    float current_A;
    float weight;
} cellwise_standstill;

/* After an interval of which `counted` were counted by the sensor; `rate_A` is 1C. A current that stands still near
 * zero for `least` is what the sensor adds: once for each rest, so that a small constant load that is taken for one
 * can be outvoted by the voltages. Within REST_BAND of zero it shows an offset to a fifth of the deviation that it
 * has beforehand; what is more may as well be a load, and shows as much as is known beforehand. */
static void rest_after(float lasts, float since_A, float current_A, float counted, float rate_A, float least,
                       cellwise_standstill *standstill)
{
    standstill->lasts = 0.0f;
    standstill->current_A = current_A;
    standstill->weight = 0.0f;
    const float size_A = magnitude(current_A);
    if ((size_A <= (REST_LIMIT * rate_A)) && (magnitude(current_A - since_A) <= (REST_BAND * rate_A))) {
        standstill->current_A = since_A;
        standstill->lasts = REST_USED;
        if (lasts >= 0.0f) {
            standstill->lasts = lasts + counted;
        }
        if (standstill->lasts >= least) {
            standstill->lasts = REST_USED;
            standstill->weight = (size_A <= (REST_BAND * rate_A)) ? REST_SHOWS : MAY_BE_LOAD;
        }
    }
}

/* How likely a mean of that square over its variance is beside none: Student's t. Of 31 degrees of freedom, in place
 * of the normal density: how sure the voltages are is itself not quite sure, and it takes no exponential. */
static float student(float square)
{
    float base = 1.0f + (square * PER_FREEDOM);
    base = base * base;
    base = base * base;
    base = base * base;
    return base * base;
}

/* What the voltages say of an offset, and its mean and variance over both hypotheses. `information` is one over its
 * variance if there is one, `score` that times its mean. */
typedef struct {
    float score;
    float information;
    float believed;
    float unsure;
} cellwise_offset;

/* After a voltage. `of_offset_V` is what one deviation moves the voltage by, `own_V` the innovation of the filter's
 * own estimate, `inverse` one over the variance that weighed it. */
static void offset_after(float score, float information, float of_offset_V, float own_V, float inverse,
                         cellwise_offset *offset)
{
    const float per_V = inverse * of_offset_V;
    offset->information = information + (per_V * of_offset_V);
    offset->score = score + (per_V * own_V);
    if (!(offset->information <= INFORMATION_MOST)) {
        offset->information = information;
        offset->score = score;
    }
    const float variance = 1.0f / offset->information;
    const float square = at_most((offset->score * offset->score) * variance, SURE_SQUARE);
    const float odds = (ODDS * student(square)) * root(variance);
    const float weight = odds / (odds + 1.0f);
    const float mean = offset->score * variance;
    offset->unsure = weight * (variance + ((1.0f - weight) * (mean * mean)));
    offset->believed = weight * mean;
}

#endif
