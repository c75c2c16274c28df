/* Part of cellwise_ekf.c. What a step does to P, and to the state through it. Printed from src/cellwise/estimate by
 * `python -m cellwise.printing`; do not edit. */
#ifndef CELLWISE_COVARIANCE_H
#define CELLWISE_COVARIANCE_H

#include "cellwise_offset.h"

/* The tables at one SOC and temperature; a gain is 1 - exp(-dt/tau). */
typedef struct {
    float ocv_V;
    float slope_V;
    float noise_V2;
    float r0_ohm;
    float m_V;
    float r1_ohm;
    float r2_ohm;
    float r3_ohm;
    float gain1;
    float gain2;
    float gain3;
} cellwise_point;

/* Slopes over SOC, while it is badly known: of the voltage, the OCV's bend, of the branches. `spread` is the
 * standard deviation of SOC, 0 while it is well known. */
typedef struct {
    float slope_V;
    float bend_V;
    float spread;
    float rise1;
    float rise2;
    float rise3;
} cellwise_slopes;

/* P H', the covariance of every state with the voltage, or a gain. */
typedef struct {
    float s;
    float v1;
    float v2;
    float v3;
    float h;
} cellwise_column;

/* P H' with H = [slope, -1, -1, -1, m]. */
static void column_of(const cellwise_state *x, float slope_V, float m_V, cellwise_column *column)
{
    column->s = ((((slope_V * x->ss) - x->s1) - x->s2) - x->s3) + (m_V * x->sh);
    column->v1 = ((((slope_V * x->s1) - x->p11) - x->p12) - x->p13) + (m_V * x->p1h);
    column->v2 = ((((slope_V * x->s2) - x->p12) - x->p22) - x->p23) + (m_V * x->p2h);
    column->v3 = ((((slope_V * x->s3) - x->p13) - x->p23) - x->p33) + (m_V * x->p3h);
    column->h = ((((slope_V * x->sh) - x->p1h) - x->p2h) - x->p3h) + (m_V * x->phh);
}

/* H P H', the variance of the voltage that the state explains [V^2]. */
static float explained(const cellwise_column *d, float slope_V, float m_V)
{
    const float variance = ((((slope_V * d->s) - d->v1) - d->v2) - d->v3) + (m_V * d->h);
    return (variance > 0.0f) ? variance : 0.0f;
}

/* A column times a number: a gain. */
static void scaled(const cellwise_column *d, float factor, cellwise_column *column)
{
    column->s = d->s * factor;
    column->v1 = d->v1 * factor;
    column->v2 = d->v2 * factor;
    column->v3 = d->v3 * factor;
    column->h = d->h * factor;
}

/* P H' where the slow branch itself is measured. */
static void column_of_slow_branch(const cellwise_state *x, cellwise_column *column)
{
    column->s = x->s3;
    column->v1 = x->p13;
    column->v2 = x->p23;
    column->v3 = x->p33;
    column->h = x->p3h;
}

/* Only the diagonal stays. */
static void forget_correlations(cellwise_state *x)
{
    x->s1 = 0.0f;
    x->s2 = 0.0f;
    x->s3 = 0.0f;
    x->sh = 0.0f;
    x->p12 = 0.0f;
    x->p13 = 0.0f;
    x->p1h = 0.0f;
    x->p23 = 0.0f;
    x->p2h = 0.0f;
    x->p3h = 0.0f;
}

/* What goes from where it is towards an end, by a gain. */
static float followed(float now, float gain, float end)
{
    return now + (gain * (end - now));
}

/* A variance of SOC that is large changes by less than rounding keeps of it. */
static void add_variance(cellwise_state *x, float value)
{
    add(&x->ss, &x->ss_carry, value);
}

/* The branches over an interval of a constant current each, exactly, and their covariance. A current that is not
 * known to `square_A2` drives them too; 1 - a^2 keeps the stationary spread independent of the time step. What
 * decays slowly is stated by how much it loses: 1 - 1e-5 as a float is off by 0.3 % of that. */
static void relax(cellwise_state *x, const cellwise_point *p, float gain1, float gain2, float gain3, float current1,
                  float current2, float current3, float square_A2)
{
    const float a1 = 1.0f - gain1;
    x->v1_V = followed(x->v1_V, gain1, p->r1_ohm * current1);
    x->s1 = x->s1 - (gain1 * x->s1);
    x->p1h = x->p1h - (gain1 * x->p1h);
    x->p11 = x->p11 + ((gain1 * (1.0f + a1)) * ((square_A2 * (p->r1_ohm * p->r1_ohm)) - x->p11));
    const float a2 = 1.0f - gain2;
    x->v2_V = followed(x->v2_V, gain2, p->r2_ohm * current2);
    x->s2 = x->s2 - (gain2 * x->s2);
    x->p2h = x->p2h - (gain2 * x->p2h);
    x->p22 = x->p22 + ((gain2 * (1.0f + a2)) * ((square_A2 * (p->r2_ohm * p->r2_ohm)) - x->p22));
    const float a3 = 1.0f - gain3;
    add(&x->v3_V, &x->v3_carry_V, gain3 * ((p->r3_ohm * current3) - x->v3_V));
    x->s3 = x->s3 - (gain3 * x->s3);
    x->p3h = x->p3h - (gain3 * x->p3h);
    x->p33 = x->p33 + ((gain3 * (1.0f + a3)) * ((square_A2 * (p->r3_ohm * p->r3_ohm)) - x->p33));
    x->p12 = x->p12 - ((gain1 + (gain2 * a1)) * x->p12);
    x->p13 = x->p13 - ((gain1 + (gain3 * a1)) * x->p13);
    x->p23 = x->p23 - ((gain2 + (gain3 * a2)) * x->p23);
}

/* The row of h where a share of h is kept. */
static void fade_hysteresis(cellwise_state *x, float keep)
{
    x->sh = keep * x->sh;
    x->p1h = keep * x->p1h;
    x->p2h = keep * x->p2h;
    x->p3h = keep * x->p3h;
    x->phh = (keep * keep) * x->phh;
}

/* A SOC that is off drives the branches by the resistances' slopes, as `drive` [A] does. */
static void tilt(cellwise_state *x, const cellwise_slopes *slopes, float drive1, float drive2, float drive3)
{
    const float f1 = slopes->rise1 * drive1;
    const float after1 = x->s1 + (f1 * x->ss);
    const float f2 = slopes->rise2 * drive2;
    const float after2 = x->s2 + (f2 * x->ss);
    const float f3 = slopes->rise3 * drive3;
    const float after3 = x->s3 + (f3 * x->ss);
    x->p11 = x->p11 + covariance_by_soc(f1, f1, x->s1, after1);
    x->p12 = x->p12 + covariance_by_soc(f1, f2, x->s1, after2);
    x->p13 = x->p13 + covariance_by_soc(f1, f3, x->s1, after3);
    x->p22 = x->p22 + covariance_by_soc(f2, f2, x->s2, after2);
    x->p23 = x->p23 + covariance_by_soc(f2, f3, x->s2, after3);
    x->p33 = x->p33 + covariance_by_soc(f3, f3, x->s3, after3);
    x->p1h = x->p1h + (f1 * x->sh);
    x->s1 = after1;
    x->p2h = x->p2h + (f2 * x->sh);
    x->s2 = after2;
    x->p3h = x->p3h + (f3 * x->sh);
    x->s3 = after3;
}

/* State + K innovation. */
static void move(cellwise_state *x, const cellwise_column *k, float innovation_V)
{
    add(&x->soc, &x->soc_carry, k->s * innovation_V);
    x->v1_V = x->v1_V + (k->v1 * innovation_V);
    x->v2_V = x->v2_V + (k->v2 * innovation_V);
    add(&x->v3_V, &x->v3_carry_V, k->v3 * innovation_V);
    x->h = x->h + (k->h * innovation_V);
    x->h = clip(x->h, -1.0f, 1.0f);
}

/* P - K d', row by row. */
static void narrow(cellwise_state *x, const cellwise_column *k, const cellwise_column *d)
{
    add_variance(x, -(k->s * d->s));
    x->ss = clip(x->ss, VARIANCE_FLOOR, LARGE);
    x->s1 = x->s1 - (k->s * d->v1);
    x->s2 = x->s2 - (k->s * d->v2);
    x->s3 = x->s3 - (k->s * d->v3);
    x->sh = x->sh - (k->s * d->h);
    x->p11 = at_least(x->p11 - (k->v1 * d->v1), 0.0f);
    x->p12 = x->p12 - (k->v1 * d->v2);
    x->p13 = x->p13 - (k->v1 * d->v3);
    x->p1h = x->p1h - (k->v1 * d->h);
    x->p22 = at_least(x->p22 - (k->v2 * d->v2), 0.0f);
    x->p23 = x->p23 - (k->v2 * d->v3);
    x->p2h = x->p2h - (k->v2 * d->h);
    x->p33 = at_least(x->p33 - (k->v3 * d->v3), 0.0f);
    x->p3h = x->p3h - (k->v3 * d->h);
    x->phh = at_least(x->phh - (k->h * d->h), 0.0f);
}

/* Every entry in its range. A variance of SOC is never 0: that is memory that was cleared. */
static bool covariance_is_sound(const cellwise_state *x)
{
    if (!POSITIVE_WITHIN(x->ss, VARIANCE_FLOOR, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->s1, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->s2, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->s3, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->sh, LARGE)) { return false; }
    if (!NOT_NEGATIVE(x->p11, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->p12, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->p13, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->p1h, LARGE)) { return false; }
    if (!NOT_NEGATIVE(x->p22, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->p23, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->p2h, LARGE)) { return false; }
    if (!NOT_NEGATIVE(x->p33, LARGE)) { return false; }
    if (!SIZE_WITHIN(x->p3h, LARGE)) { return false; }
    if (!NOT_NEGATIVE(x->phh, LARGE)) { return false; }
    return true;
}

/* SOC known with a variance, branches at rest, nothing known of hysteresis. */
static void start_covariance(cellwise_state *x, float soc_variance)
{
    forget_correlations(x);
    x->ss = soc_variance;
    x->p11 = 0.0f;
    x->p22 = 0.0f;
    x->p33 = 0.0f;
    x->phh = 1.0f;
}

/* Nothing is known of h. */
static void forget_hysteresis(cellwise_state *x)
{
    x->sh = 0.0f;
    x->p1h = 0.0f;
    x->p2h = 0.0f;
    x->p3h = 0.0f;
    x->phh = 1.0f;
}

#endif
