/* Part of cellwise_ekf.c. How much a voltage weighs, and what stays of the model's error. Printed from
 * src/cellwise/estimate by `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_EVIDENCE_H
#define CELLWISE_EVIDENCE_H

#include "cellwise_scalar.h"

/* The voltage over SOC as a straight line between two points, and how far it is off between. */
typedef struct {
    float slope_V;
    float bend_V;
} cellwise_chord;

/* From the OCV and R0 at two SOCs `1 / per` apart, seen from `away` above the lower one. A far-off start must not be
 * corrected with the slope of the spot where it happens to stand, nor be thought of as right afterwards when the OCV
 * is no straight line: the bend is the distance from the OCV there to the chord. A SOC that is far off brings the
 * resistances of another SOC with it, so R0's slope joins the OCV's. */
static void chord_of(float low_V, float low_ohm, float high_V, float high_ohm, float per, float current_A, float away,
                     float ocv_V, cellwise_chord *chord)
{
    const float rise_V = (high_V - low_V) * per;
    chord->slope_V = rise_V - (((high_ohm - low_ohm) * per) * current_A);
    chord->bend_V = (low_V - ocv_V) + (rise_V * away);
}

/* What two branches have in common because a SOC that is off drives both. Each by the slope of its resistance;
 * `with1` is the covariance of the first with the SOC, `after2` that of the second once it is driven. */
static float covariance_by_soc(float drive1, float drive2, float with1, float after2)
{
    return (drive1 * after2) + (drive2 * with1);
}

/* Of a voltage that bends by c at one deviation of SOC: off its tangent by c z^2, 3 c^2. */
static float bent_variance(float variance_V2, float bend_V)
{
    return variance_V2 + (3.0f * (bend_V * bend_V));
}

/* Mean square of a current that is not known, as a branch sees it [A^2]. A resistance that is off by a share drives
 * its branch like a current that is off by it, and so does a current that nobody measured. */
static float unknown_square(float share_variance, float current_A, float lost_A2)
{
    return (share_variance * (current_A * current_A)) + lost_A2;
}

/* Of one voltage, by the sensor and the model's error at this SOC [V^2]. A SOC scale that is off matters where the
 * OCV is steep. */
static float error_variance(float fixed_V2, float error_V, float ocv_soc2, float slope_V)
{
    return (fixed_V2 + (error_V * error_V)) + (ocv_soc2 * (slope_V * slope_V));
}

/* Of one measured voltage about a perfect state [V^2]. Beside sensor and model, resistances that are off by a share
 * (of what the ohmic drop and the branches hold, `held_V` in absolute values) and a current that is not known. */
static float voltage_variance(float error_V2, float share_variance, float held_V, float current_A2, float r0_ohm)
{
    return error_V2 + ((share_variance * (held_V * held_V)) + (current_A2 * (r0_ohm * r0_ohm)));
}

/* By what share the resistances may be wrong under a current, squared. */
static float share_of(const cellwise_constants *c, float current_A)
{
    return (current_A >= 0.0f) ? c->share_variance : c->charge_variance;
}

/* Of one measured voltage about a perfect state, under a current [V^2]. */
static float single_variance(const cellwise_constants *c, float error_V2, float current_A, float held_V, float lost_A2,
                             float r0_ohm)
{
    const float current_A2 = c->current_variance_A2 + lost_A2;
    return voltage_variance(error_V2, share_of(c, current_A), held_V, current_A2, r0_ohm);
}

/* A variance as many times as innovations have lately shown beyond it. */
static float as_shown(float variance, float mismatch)
{
    float shown = variance;
    if (POSITIVE_ABOVE(mismatch, 1.0f)) {
        shown = mismatch * variance;
    }
    return shown;
}

/* Running mean of the squared innovation, in units of its variance. A model of another temperature, age or cell is
 * wrong all the time: evidence weighs less by what the innovations have lately shown beyond their variance. */
static float lately_shown(float mean, float square, float lately)
{
    return mean + (lately * (square - mean));
}

/* How many samples share one model error: `above / below`, never divided. */
typedef struct {
    float above;
    float below;
} cellwise_shared;

/* How many samples share one model error, `since` the first one: at least 1. An error of memory tau counts once in 2
 * tau (its spectral density at rest): `c.shared`. It is a sum of processes with memories of a second to half an
 * hour: the quick ones average out first, so the rest of a mean has an ever longer memory. Just after the first it
 * is `shared_early / shared_half`, half way between after `shared_half`. Evidence that stands `alone` (the first
 * voltage at rest) shares nothing. A repeated sample has no `period`: over zero. */
static void shared_evidence(const cellwise_constants *c, float since, float period, bool alone, cellwise_shared *shared)
{
    shared->below = (since + c->shared_half) * period;
    shared->above = shared->below;
    if (!alone) {
        shared->above = (c->shared * since) + c->shared_early;
    }
}

/* One over the variance that weighs a voltage; `weight_V2` is to be taken over `below`. */
static float inverse_weight(float explained_V2, float weight_V2, float below)
{
    return below / ((explained_V2 * below) + weight_V2);
}

/* Persistent model error, one deviation [V]: at this SOC, and along its axis. */
static float persistent_V(float share, float error_V2, float mismatch)
{
    return share * root(at_most(as_shown(error_V2, mismatch), SQUARE_MOST));
}

/* SOC error brought in by a persistent model error, after an update with a gain of the SOC. No further voltage
 * averages such an error out: with every voltage the SOC goes where the error leads, error over slope in the end.
 * Beside P, which takes each memory of the error for new, it makes up the stated variance (consider covariance;
 * Schmidt 1966, p. 293). Where the SOC hangs on a branch its gain can be negative, and what the branch takes of the
 * error holds the two back; it is not followed here, so nothing is amplified. */
static float persistent_step(float gain, float slope_V, float persistent, float error_V)
{
    const float kept = clip(1.0f - (gain * slope_V), 0.0f, 1.0f);
    return (kept * persistent) + (gain * error_V);
}

/* Running mean of the SOC that the voltages say is missing, as far as the count may be off. A known start and a
 * small P leave a voltage little weight, and rightly so while the current is right: what innovations show is the
 * model's error then. They show the same where the counted charge drifts. Were the current off, the count would by
 * now be off by `drift`, and of an innovation drift^2 slope^2 of drift^2 slope^2 + `error_V2` would be the count's.
 * No SOC is off by more than 1. */
static float contradicted_step(float contradicted, float innovation_V, float slope_V, float error_V2, float drift,
                               float lately)
{
    const float off = at_most(drift, 1.0f);
    const float swing_V = (off * off) * slope_V;
    const float missing = (swing_V * innovation_V) / ((swing_V * slope_V) + error_V2);
    return contradicted + (lately * (clip(missing, -1.0f, 1.0f) - contradicted));
}

/* Variance of the SOC: P's, a persistent error's, and what voltages contradict. P trusted the errors as stated.
 * Where innovations show `mismatch` times as much, so much more may be wrong with the SOC (Birge 1932,
 * doi:10.1103/PhysRev.40.207). */
static float stated_variance(float known, float mismatch, float persistent, float contradicted)
{
    const float beside = (persistent * persistent) + (contradicted * contradicted);
    return as_shown(known, mismatch) + beside;
}

#endif
