#include "cellwise_ekf.h"

/* Constants of the algorithm, the same in fixed_step_kernels.py. Hex literals are exact. */
#define KNOW_NOTHING_SOC 0.5f
#define KNOW_NOTHING_VARIANCE 0x1.70a3d8p-4f /* 0.09 */
#define SOC_VARIANCE_MOST 1.0f
#define VARIANCE_FLOOR 0x1.197998p-40f /* 1e-12 */
#define GROW 0x1.000004p+0f            /* above rounding, so that P stays positive */
#define BEYOND 0x1.99999ap-5f          /* 0.05: how far the OCV goes on outside 0..1 */
#define WIDE_VARIANCE 0x1.a36e2ep-12f  /* 4e-4: beyond it the tangent is no guide */
#define SMALL_MOVE 0x1.99999ap-5f /* 0.05 of a deviation: the slope is that of the spot left */
#define SHORTEST_CHORD 0x1.0c6f7ap-20f /* 1e-6 */
#define SLOPE_FLOOR_V 0x1.99999ap-5f   /* 0.05 */
#define RECOVERY_VARIANCE 0x1.70a3d8p-4f
#define TEMPERATURE_LOW_C (-60.0f)
#define TEMPERATURE_HIGH_C 120.0f
#define HEAT_MOST_K 200.0f
#define LARGE 0x1.e848p+19f /* 1e6: no sound state goes beyond it, in V, A or their squares */
#define CARRY_MOST 0x1.0624dep-10f /* 1e-3 */
#define LEAST_FALL 0x1.99999ap-4f /* 0.1: with the current a resistance rises by ten at most */
#define LONGEST_GAP 1000000u
#define NOT_BEGUN 0u /* evidence before the first sample */
#define NO_VOLTAGE_YET 1u
#define FIRST_VOLTAGE 2u
#define EVIDENCE_MOST 2000000u
#define SHARED_GROWTH 4.0f /* twice the growth of the memory, in steps a step */
#define REST_RATE 0x1.47ae14p-7f /* 0.01: below C/100 a cell counts as resting */
#define START_REST_RATE 0x1.99999ap-4f /* 0.1 */
#define START_LOAD_SHARE 0.5f
#define START_LOAD_RATE 0.25f
#define RECOVERY_RATE 0x1.333334p-2f /* 0.3 */
#define REJECTION 20u
#define UNDER_LOAD 1u /* a rejection that wrong resistances could explain */
#define FORGIVEN 2u
#define LARGEST_FLOAT 0x1.fffffep+127f

/* False for NaN too. Macros, so that what is tested is known of the object itself afterwards, to
 * people and to analysers. */
#ifndef WITHIN /* analysis/eva_within.h says the same to Frama-C */
#define WITHIN(x, low, high) (((x) >= (low)) && ((x) <= (high)))
#endif
#define IS_VARIANCE(x) WITHIN(x, 0.0f, LARGE)
#define IS_SMALL(x) WITHIN(x, -LARGE, LARGE)

/* What few steps need is kept out of the others' registers and stack. */
#if defined(__GNUC__) && !defined(__FRAMAC__)
#define APART __attribute__((noinline))
#else
#define APART
#endif

/* The tables at one SOC and temperature. */
typedef struct {
    float ocv_V;
    float slope_V;
    float noise_V2;
    float r0_ohm;
    float r1_ohm;
    float gain1;
    float r2_ohm;
    float gain2;
#if CELLWISE_SLOW
    float r3_ohm;
    float gain3;
#endif
#if CELLWISE_HYSTERESIS
    float m_V;
#endif
} cellwise_point;

/* Slopes over SOC, while it is badly known: of the voltage, the OCV's bend, of the branches. */
typedef struct {
    float slope_V;
    float bend_V;
    float spread; /* standard deviation of SOC; 0 while it is well known */
    float rise1;
    float rise2;
#if CELLWISE_SLOW
    float rise3;
#endif
} cellwise_slopes;

/* Where a temperature lies between two tables, and what it does to every resistance. */
typedef struct {
    uint32_t low;
    float weight;
    float scale;
} cellwise_place;

static float between(float a, float b, float f)
{
    return a + (f * (b - a));
}

static float clip(float x, float low, float high)
{
    return (x < low) ? low : ((x > high) ? high : x);
}

static float magnitude(float x)
{
    return (x < 0.0f) ? -x : x;
}

/* A number, but one that no cell of this kind gives; asked only of readings that were refused. */
static uint32_t out_of_range(float x)
{
    return WITHIN(x, -LARGEST_FLOAT, LARGEST_FLOAT) ? CELLWISE_OUT_OF_RANGE : 0u;
}

/* Compensated sum: what rounding keeps from `sum` stays in `carry`. */
static void add(float *sum, float *carry, float value)
{
    const float missed = value - *carry;
    const float total = *sum + missed;
    *carry = (total - *sum) - missed;
    *sum = total;
}

/* exp(-z) for z >= 0 by the first five terms of exp(z): exact at 0, falls to 0, never negative. */
static float decay(float z)
{
    const float fourth = 0x1.555556p-3f + (z * 0x1.555556p-5f); /* 1/6, 1/24 */
    return 1.0f / (1.0f + (z * (1.0f + (z * (0.5f + (z * fourth))))));
}

#if CELLWISE_WIDE
/* Square root of a variance between WIDE_VARIANCE and 4, to 1e-4: three Newton steps. */
static float root(float square)
{
    float r = 0x1.1eb852p-5f; /* 0.035 */
    if (square > 0x1.70a3d8p-4f) {
        r = 0.5f;
    } else if (square > 0x1.d7dbf4p-7f) { /* 0.0144 */
        r = 0x1.99999ap-3f;               /* 0.2 */
    } else if (square > 0x1.47ae14p-9f) { /* 0.0025 */
        r = 0x1.47ae14p-4f;               /* 0.08 */
    } else {
        /* the start above */
    }
    r = 0.5f * (r + (square / r));
    r = 0.5f * (r + (square / r));
    return 0.5f * (r + (square / r));
}
#endif

/* ---- tables ---- */

static cellwise_place place_of(const cellwise_model *m, float temperature_C)
{
    cellwise_place place = {0u, 0.0f, 1.0f};
#if CELLWISE_TEMPERATURES > 1
    while ((place.low < (CELLWISE_TEMPERATURES - 2u)) &&
           (temperature_C > m->constant.grid_C[place.low + 1u])) {
        place.low++;
    }
    place.weight =
        clip((temperature_C - m->constant.grid_C[place.low]) * m->constant.per_K[place.low], 0.0f,
             1.0f);
#endif
#if CELLWISE_ARRHENIUS > 0
    {
        const float y = clip((temperature_C - m->constant.arrhenius_low_C) *
                                 m->constant.arrhenius_per_K,
                             0.0f, (float)(CELLWISE_ARRHENIUS - 1u));
        uint32_t k = (uint32_t)y;
        if (k > (CELLWISE_ARRHENIUS - 2u)) {
            k = CELLWISE_ARRHENIUS - 2u;
        }
        place.scale = between(m->constant.arrhenius[k], m->constant.arrhenius[k + 1u],
                              y - (float)k);
    }
#endif
#if !CELLWISE_NEEDS_TEMPERATURE
    (void)m;
    (void)temperature_C;
#endif
    return place;
}

/* Lower point of the SOC interval that holds x, a SOC in units of the grid. */
static uint32_t index_of(float x)
{
    uint32_t k = 0u;
    if (x > 0.0f) {
        k = (x < (float)(CELLWISE_POINTS - 2u)) ? (uint32_t)x : (CELLWISE_POINTS - 2u);
    }
    return k;
}

#define POINTS_SCALE ((float)(CELLWISE_POINTS - 1u))

#if CELLWISE_TEMPERATURES > 1
#define READ(field, f)                                                                     \
    between(between(low[k].field, low[k + 1u].field, (f)),                                 \
            between(high[k].field, high[k + 1u].field, (f)), place->weight)
#define RISE(field)                                                                        \
    between(low[k + 1u].field - low[k].field, high[k + 1u].field - high[k].field, place->weight)
#else
#define READ(field, f) between(low[k].field, low[k + 1u].field, (f))
#define RISE(field) (low[k + 1u].field - low[k].field)
#endif

/* Outside 0..1 the OCV goes on along its last segment, every other table stays at its end. */
static void look_up(const cellwise_model *m, const cellwise_place *place, float soc,
                    float current, cellwise_point *p)
{
    const float x = soc * POINTS_SCALE;
    const uint32_t k = index_of(x);
    const float f = clip(x - (float)k, -(BEYOND * POINTS_SCALE), 1.0f + (BEYOND * POINTS_SCALE));
    const float g = clip(f, 0.0f, 1.0f);
    const cellwise_row *const low = m->row[place->low];
#if CELLWISE_TEMPERATURES > 1
    const cellwise_row *const high = m->row[place->low + 1u];
#endif
    p->ocv_V = READ(ocv_V, f);
    p->slope_V = RISE(ocv_V) * POINTS_SCALE;
    p->noise_V2 = READ(noise_V2, g);
    p->r0_ohm = READ(r0_ohm, g);
    p->r1_ohm = READ(r1_ohm, g);
    p->gain1 = 1.0f / READ(lag1, g);
    p->r2_ohm = READ(r2_ohm, g);
    p->gain2 = 1.0f / READ(lag2, g);
#if CELLWISE_SLOW
    p->r3_ohm = READ(r3_ohm, g);
    p->gain3 = 1.0f / READ(lag3, g);
#endif
#if CELLWISE_HYSTERESIS
    p->m_V = READ(m_V, g);
#endif
#if (CELLWISE_ARRHENIUS > 0) || CELLWISE_ASYMMETRY || CELLWISE_RATE
    {
        float scale = place->scale;
#if CELLWISE_ASYMMETRY
        if (current < 0.0f) {
            scale = scale * m->constant.charge_scale;
        }
#endif
#if CELLWISE_SLOW
        p->r3_ohm = p->r3_ohm * scale;
#endif
#if CELLWISE_RATE
        scale = scale / clip(1.0f + (m->constant.rate_per_A * magnitude(current)), LEAST_FALL,
                             LARGE);
#endif
        p->r0_ohm = p->r0_ohm * scale;
        p->r1_ohm = p->r1_ohm * scale;
        p->r2_ohm = p->r2_ohm * scale;
    }
#endif
#if !CELLWISE_ASYMMETRY && !CELLWISE_RATE
    (void)current;
#endif
}

/* SOC is well known: the OCV's tangent, and nothing else. */
static void no_slopes(const cellwise_point *p, cellwise_slopes *w)
{
    w->slope_V = p->slope_V;
    w->bend_V = 0.0f;
    w->spread = 0.0f;
    w->rise1 = 0.0f;
    w->rise2 = 0.0f;
#if CELLWISE_SLOW
    w->rise3 = 0.0f;
#endif
}

/* While SOC is known to worse than WIDE_VARIANCE slopes are chords over one standard deviation to
 * either side: a far-off start must not be corrected with the slope of where it stands. A SOC that
 * is far off brings the resistances of another SOC with it, so R0's slope joins the OCV's. */
#if CELLWISE_WIDE
static APART void slopes_of(const cellwise_model *m, const cellwise_place *place, float soc,
                            float spread, float current, const cellwise_point *p,
                            cellwise_slopes *w)
{
    const float low = clip(soc - spread, 0.0f, 1.0f);
    const float high = clip(soc + spread, 0.0f, 1.0f);
    w->spread = spread;
    if ((high - low) >= SHORTEST_CHORD) {
        const float per = 1.0f / (high - low);
        cellwise_point end;
        float ocv;
        float ohmic;
        look_up(m, place, low, current, &end);
        ocv = end.ocv_V;
        ohmic = end.r0_ohm;
        w->rise1 = end.r1_ohm;
        w->rise2 = end.r2_ohm;
#if CELLWISE_SLOW
        w->rise3 = end.r3_ohm;
#endif
        w->bend_V = end.ocv_V - p->ocv_V;
        look_up(m, place, high, current, &end);
        ocv = (end.ocv_V - ocv) * per;
        ohmic = (end.r0_ohm - ohmic) * per;
        w->rise1 = (end.r1_ohm - w->rise1) * per;
        w->rise2 = (end.r2_ohm - w->rise2) * per;
#if CELLWISE_SLOW
        w->rise3 = (end.r3_ohm - w->rise3) * per;
#endif
        w->slope_V = ocv - (ohmic * current);
        w->bend_V = w->bend_V + (ocv * (soc - low));
    } else {
        no_slopes(p, w);
        w->spread = spread;
    }
}
#endif

/* ---- state ---- */

/* Every number in its range: memory that lost its content, or was never initialised, is noticed. */
static uint32_t is_sound(const cellwise_model *m, const cellwise_state *x)
{
    if (!WITHIN(x->soc, 0.0f, 1.0f) ||
        !WITHIN(x->soc_carry, -CARRY_MOST, CARRY_MOST)) {
        return 0u;
    }
    if (!IS_SMALL(x->v1_V) || !IS_SMALL(x->v2_V)) {
        return 0u;
    }
    if (!IS_VARIANCE(x->ss) || !IS_SMALL(x->s1) ||
        !IS_SMALL(x->s2)) {
        return 0u;
    }
    if (!IS_VARIANCE(x->p11) || !IS_SMALL(x->p12) ||
        !IS_VARIANCE(x->p22)) {
        return 0u;
    }
    if (!WITHIN(x->current_A, -m->constant.current_limit_A, m->constant.current_limit_A)) {
        return 0u;
    }
    if (!IS_VARIANCE(x->mismatch)) {
        return 0u;
    }
#if CELLWISE_SLOW
    if (!IS_SMALL(x->v3_V) || !WITHIN(x->v3_carry_V, -CARRY_MOST, CARRY_MOST)) {
        return 0u;
    }
    if (!IS_SMALL(x->s3) || !IS_SMALL(x->p13) || !IS_SMALL(x->p23) ||
        !IS_VARIANCE(x->p33)) {
        return 0u;
    }
#endif
#if CELLWISE_HYSTERESIS
    if (!WITHIN(x->h, -1.0f, 1.0f)) {
        return 0u;
    }
    if (!IS_SMALL(x->sh) || !IS_SMALL(x->p1h) || !IS_SMALL(x->p2h) ||
        !IS_VARIANCE(x->phh)) {
        return 0u;
    }
#if CELLWISE_SLOW
    if (!IS_SMALL(x->p3h)) {
        return 0u;
    }
#endif
#endif
#if CELLWISE_OFFSET
    if (!WITHIN(x->offset_A, -m->constant.current_limit_A, m->constant.current_limit_A)) {
        return 0u;
    }
    if (!IS_SMALL(x->so) || !IS_SMALL(x->p1o) || !IS_SMALL(x->p2o) ||
        !IS_VARIANCE(x->poo)) {
        return 0u;
    }
#if CELLWISE_SLOW
    if (!IS_SMALL(x->p3o)) {
        return 0u;
    }
#endif
#if CELLWISE_HYSTERESIS
    if (!IS_SMALL(x->pho)) {
        return 0u;
    }
#endif
#endif
#if CELLWISE_HEATING
    if (!WITHIN(x->heat_K, -HEAT_MOST_K, HEAT_MOST_K)) {
        return 0u;
    }
#endif
#if CELLWISE_NEEDS_TEMPERATURE
    if (!WITHIN(x->temperature_C, TEMPERATURE_LOW_C, TEMPERATURE_HIGH_C)) {
        return 0u;
    }
#endif
    return 1u;
}

static void start(const cellwise_model *m, cellwise_state *x, float soc, float soc_variance)
{
    x->soc = soc;
    x->soc_carry = 0.0f;
    x->v1_V = 0.0f;
    x->v2_V = 0.0f;
    x->ss = soc_variance;
    x->s1 = 0.0f;
    x->s2 = 0.0f;
    x->p11 = m->constant.branch_variance_V2;
    x->p12 = 0.0f;
    x->p22 = m->constant.branch_variance_V2;
#if CELLWISE_SLOW
    x->v3_V = 0.0f;
    x->v3_carry_V = 0.0f;
    x->s3 = 0.0f;
    x->p13 = 0.0f;
    x->p23 = 0.0f;
    x->p33 = m->constant.branch_variance_V2;
#endif
#if CELLWISE_HYSTERESIS
    x->h = (soc > 0.5f) ? 1.0f : -1.0f;
    x->sh = 0.0f;
    x->p1h = 0.0f;
    x->p2h = 0.0f;
    x->phh = 1.0f;
#if CELLWISE_SLOW
    x->p3h = 0.0f;
#endif
#endif
#if CELLWISE_OFFSET
    x->offset_A = 0.0f;
    x->so = 0.0f;
    x->p1o = 0.0f;
    x->p2o = 0.0f;
    x->poo = m->constant.offset_variance_A2;
#if CELLWISE_SLOW
    x->p3o = 0.0f;
#endif
#if CELLWISE_HYSTERESIS
    x->pho = 0.0f;
#endif
#endif
    x->current_A = 0.0f;
    x->mismatch = 1.0f;
#if CELLWISE_HEATING
    x->heat_K = 0.0f;
#endif
#if CELLWISE_NEEDS_TEMPERATURE
    x->temperature_C = m->constant.temperature_C;
#endif
    x->sequence = 0u;
    x->rejections = 0u;
    x->evidence = NOT_BEGUN;
}

/* What a branch holds when nobody knows what was before: nearly nothing at rest, half of the load's
 * steady voltage under load. */
static void guess_branch(const cellwise_constants *c, float r_ohm, float current, float *v_V,
                         float *variance_V2)
{
    float spread = START_REST_RATE * c->capacity_A;
    *v_V = 0.0f;
    if (magnitude(current) >= (REST_RATE * c->capacity_A)) {
        const float least = START_LOAD_RATE * c->capacity_A;
        spread = START_LOAD_SHARE * magnitude(current);
        spread = (spread > least) ? spread : least;
        *v_V = (START_LOAD_SHARE * current) * r_ohm;
    }
    spread = spread * r_ohm;
    *variance_V2 = c->branch_variance_V2 + (spread * spread);
}

static void guess_branches(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                           float current)
{
    guess_branch(c, p->r1_ohm, current, &x->v1_V, &x->p11);
    guess_branch(c, p->r2_ohm, current, &x->v2_V, &x->p22);
#if CELLWISE_SLOW
    guess_branch(c, p->r3_ohm, current, &x->v3_V, &x->p33);
#endif
}

/* ---- predict ---- */

/* Charge that leaves the cell in one step, in SOC. */
static float taken(const cellwise_constants *c, float current)
{
    float used = current;
#if CELLWISE_EFFICIENCY
    if (used < 0.0f) {
        used = used * c->charge_efficiency;
    }
#endif
#if CELLWISE_LEAK
    return (c->soc_per_A * used) + c->leak_soc;
#else
    return c->soc_per_A * used;
#endif
}

/* Samples are missing: the branches relax towards the mean of the currents on both sides, and may
 * hold what these currents can have left in them. */
static void cross_gap(cellwise_state *x, const cellwise_point *p, float missing, float flow,
                      float unknown_A2)
{
    const float left1 = decay(missing * p->gain1);
    const float left2 = decay(missing * p->gain2);
    const float fed1 = (1.0f - left1) * p->r1_ohm;
    const float fed2 = (1.0f - left2) * p->r2_ohm;
    x->v1_V = (left1 * x->v1_V) + (fed1 * flow);
    x->v2_V = (left2 * x->v2_V) + (fed2 * flow);
    x->s1 = left1 * x->s1;
    x->s2 = left2 * x->s2;
    x->p11 = ((left1 * left1) * x->p11) + ((fed1 * fed1) * unknown_A2);
    x->p12 = (left1 * left2) * x->p12;
    x->p22 = ((left2 * left2) * x->p22) + ((fed2 * fed2) * unknown_A2);
#if CELLWISE_SLOW
    {
        const float left3 = decay(missing * p->gain3);
        const float fed3 = (1.0f - left3) * p->r3_ohm;
        x->v3_V = (left3 * x->v3_V) + (fed3 * flow);
        x->s3 = left3 * x->s3;
        x->p13 = (left1 * left3) * x->p13;
        x->p23 = (left2 * left3) * x->p23;
        x->p33 = ((left3 * left3) * x->p33) + ((fed3 * fed3) * unknown_A2);
#if CELLWISE_OFFSET
        x->p3o = left3 * x->p3o;
#endif
    }
#endif
#if CELLWISE_HYSTERESIS
    x->sh = 0.0f;
    x->p1h = 0.0f;
    x->p2h = 0.0f;
    x->phh = 1.0f;
#if CELLWISE_SLOW
    x->p3h = 0.0f;
#endif
#if CELLWISE_OFFSET
    x->pho = 0.0f;
#endif
#endif
#if CELLWISE_OFFSET
    x->p1o = left1 * x->p1o;
    x->p2o = left2 * x->p2o;
#endif
}

/* Currents that nobody measured: over `missing` samples, and in this one. */
static void admit_doubt(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                        uint32_t missing, float current, float bridge, float missing_A2)
{
    x->ss = x->ss + ((c->soc_per_A * c->soc_per_A) * missing_A2);
    if (missing != 0u) {
        const float unknown_A2 = (current * current) + (x->current_A * x->current_A);
        float spread = c->gap_variance;
        if (missing <= c->gap_steps) {
            const float steps = c->soc_per_A * (float)missing;
            spread = (steps * steps) * unknown_A2;
        }
        x->ss = x->ss + spread;
        cross_gap(x, p, (float)missing, bridge, unknown_A2);
    }
}

/* SOC lies in 0..1: a standard deviation beyond that is halved, its correlations kept. */
static void shrink_soc_variance(cellwise_state *x)
{
    x->ss = 0.25f * x->ss;
    x->s1 = 0.5f * x->s1;
    x->s2 = 0.5f * x->s2;
#if CELLWISE_SLOW
    x->s3 = 0.5f * x->s3;
#endif
#if CELLWISE_HYSTERESIS
    x->sh = 0.5f * x->sh;
#endif
#if CELLWISE_OFFSET
    x->so = 0.5f * x->so;
#endif
}

#if CELLWISE_OFFSET
/* The sensor's offset drives every state that the current drives: P* is P with the offset's column
 * already decayed, e is what one ampere of offset does to a state in one step. */
static void spread_offset(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p)
{
    const float es = c->soc_per_A;
    const float e1 = -(p->gain1 * p->r1_ohm);
    const float e2 = -(p->gain2 * p->r2_ohm);
    const float cs = x->so + (es * x->poo);
    const float c1 = x->p1o + (e1 * x->poo);
    const float c2 = x->p2o + (e2 * x->poo);
    x->ss = x->ss + (es * (x->so + cs));
    x->s1 = x->s1 + ((e1 * x->so) + (es * c1));
    x->s2 = x->s2 + ((e2 * x->so) + (es * c2));
    x->p11 = x->p11 + (e1 * (x->p1o + c1));
    x->p12 = x->p12 + ((e2 * x->p1o) + (e1 * c2));
    x->p22 = x->p22 + (e2 * (x->p2o + c2));
#if CELLWISE_SLOW
    {
        const float e3 = -(p->gain3 * p->r3_ohm);
        const float c3 = x->p3o + (e3 * x->poo);
        x->s3 = x->s3 + ((e3 * x->so) + (es * c3));
        x->p13 = x->p13 + ((e3 * x->p1o) + (e1 * c3));
        x->p23 = x->p23 + ((e3 * x->p2o) + (e2 * c3));
        x->p33 = x->p33 + (e3 * (x->p3o + c3));
#if CELLWISE_HYSTERESIS
        x->p3h = x->p3h + (e3 * x->pho);
#endif
        x->p3o = c3;
    }
#endif
#if CELLWISE_HYSTERESIS
    x->sh = x->sh + (es * x->pho);
    x->p1h = x->p1h + (e1 * x->pho);
    x->p2h = x->p2h + (e2 * x->pho);
#endif
    x->so = cs;
    x->p1o = c1;
    x->p2o = c2;
    x->poo = x->poo * GROW;
    if (x->poo < c->offset_variance_A2) {
        x->poo = x->poo + c->offset_walk_A2;
    }
}
#endif

#if CELLWISE_WIDE
/* A SOC that is off drives the branches by the resistances' slopes. */
static void tilt(cellwise_state *x, const cellwise_point *p, const cellwise_slopes *w, float flow)
{
    const float f1 = (w->rise1 * p->gain1) * flow;
    const float f2 = (w->rise2 * p->gain2) * flow;
    x->p11 = x->p11 + (f1 * ((2.0f * x->s1) + (f1 * x->ss)));
    x->p12 = x->p12 + (((f1 * x->s2) + (f2 * x->s1)) + ((f1 * f2) * x->ss));
    x->p22 = x->p22 + (f2 * ((2.0f * x->s2) + (f2 * x->ss)));
#if CELLWISE_SLOW
    {
        const float f3 = (w->rise3 * p->gain3) * flow;
        x->p13 = x->p13 + (((f1 * x->s3) + (f3 * x->s1)) + ((f1 * f3) * x->ss));
        x->p23 = x->p23 + (((f2 * x->s3) + (f3 * x->s2)) + ((f2 * f3) * x->ss));
        x->p33 = x->p33 + (f3 * ((2.0f * x->s3) + (f3 * x->ss)));
        x->s3 = x->s3 + (f3 * x->ss);
#if CELLWISE_HYSTERESIS
        x->p3h = x->p3h + (f3 * x->sh);
#endif
#if CELLWISE_OFFSET
        x->p3o = x->p3o + (f3 * x->so);
#endif
    }
#endif
#if CELLWISE_HYSTERESIS
    x->p1h = x->p1h + (f1 * x->sh);
    x->p2h = x->p2h + (f2 * x->sh);
#endif
#if CELLWISE_OFFSET
    x->p1o = x->p1o + (f1 * x->so);
    x->p2o = x->p2o + (f2 * x->so);
#endif
    x->s1 = x->s1 + (f1 * x->ss);
    x->s2 = x->s2 + (f2 * x->ss);
}
#endif

/* The branches over one interval of constant current, exactly, and the covariance. A resistance
 * that is off by a share drives its branch like a current that is off by it; 1 - a^2 keeps the
 * stationary spread independent of the time step. */
static void predict(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                    const cellwise_slopes *w, float flow, float missing_A2)
{
    const float share = c->share_variance * (flow * flow);
    const float a1 = 1.0f - p->gain1;
    const float a2 = 1.0f - p->gain2;
    const float r11 = p->r1_ohm * p->r1_ohm;
    const float r22 = p->r2_ohm * p->r2_ohm;
    x->v1_V = x->v1_V + (p->gain1 * ((p->r1_ohm * flow) - x->v1_V));
    x->v2_V = x->v2_V + (p->gain2 * ((p->r2_ohm * flow) - x->v2_V));
    x->s1 = a1 * x->s1;
    x->s2 = a2 * x->s2;
    x->p11 = (((a1 * a1) * GROW) * x->p11) + ((share * r11) * (p->gain1 * (1.0f + a1)));
    x->p12 = (a1 * a2) * x->p12;
    x->p22 = (((a2 * a2) * GROW) * x->p22) + ((share * r22) * (p->gain2 * (1.0f + a2)));
    if (missing_A2 > 0.0f) {
        x->p11 = x->p11 + (missing_A2 * (r11 * (p->gain1 * p->gain1)));
        x->p22 = x->p22 + (missing_A2 * (r22 * (p->gain2 * p->gain2)));
    }
#if CELLWISE_SLOW
    {
        const float a3 = 1.0f - p->gain3;
        const float r33 = p->r3_ohm * p->r3_ohm;
        add(&x->v3_V, &x->v3_carry_V, p->gain3 * ((p->r3_ohm * flow) - x->v3_V));
        x->s3 = a3 * x->s3;
        x->p13 = (a1 * a3) * x->p13;
        x->p23 = (a2 * a3) * x->p23;
        x->p33 = (((a3 * a3) * GROW) * x->p33) + ((share * r33) * (p->gain3 * (1.0f + a3)));
#if CELLWISE_OFFSET
        x->p3o = a3 * x->p3o;
#endif
    }
#endif
#if CELLWISE_HYSTERESIS
    {
        const float ah = decay(c->hysteresis_per_A * magnitude(flow));
        const float towards = (flow < 0.0f) ? (1.0f - ah) : (ah - 1.0f);
        x->h = clip((ah * x->h) + towards, -1.0f, 1.0f);
        x->sh = ah * x->sh;
        x->p1h = (a1 * ah) * x->p1h;
        x->p2h = (a2 * ah) * x->p2h;
        x->phh = (ah * ah) * x->phh;
#if CELLWISE_SLOW
        x->p3h = ((1.0f - p->gain3) * ah) * x->p3h;
#endif
#if CELLWISE_OFFSET
        x->pho = ah * x->pho;
#endif
    }
#endif
#if CELLWISE_OFFSET
    x->p1o = a1 * x->p1o;
    x->p2o = a2 * x->p2o;
#endif
#if CELLWISE_WIDE
    if (w->spread > 0.0f) {
        tilt(x, p, w, flow);
    }
#else
    (void)w;
#endif
    x->ss = (x->ss * GROW) + c->soc_walk;
#if CELLWISE_OFFSET
    spread_offset(c, x, p);
#endif
    if (x->ss > SOC_VARIANCE_MOST) {
        shrink_soc_variance(x);
    }
}

/* ---- correct ---- */

/* P H', with H = [slope, -1, -1, -1, m, r0]. */
typedef struct {
    float s;
    float v1;
    float v2;
#if CELLWISE_SLOW
    float v3;
#endif
#if CELLWISE_HYSTERESIS
    float h;
#endif
#if CELLWISE_OFFSET
    float o;
#endif
} cellwise_column;

/* The column, and the innovation variance that the state explains. */
static float column_of(const cellwise_state *x, const cellwise_point *p, float slope,
                       cellwise_column *d)
{
    float variance;
    d->s = (slope * x->ss) - (x->s1 + x->s2);
    d->v1 = (slope * x->s1) - (x->p11 + x->p12);
    d->v2 = (slope * x->s2) - (x->p12 + x->p22);
#if CELLWISE_SLOW
    d->s = d->s - x->s3;
    d->v1 = d->v1 - x->p13;
    d->v2 = d->v2 - x->p23;
    d->v3 = (slope * x->s3) - ((x->p13 + x->p23) + x->p33);
#endif
#if CELLWISE_HYSTERESIS
    d->s = d->s + (p->m_V * x->sh);
    d->v1 = d->v1 + (p->m_V * x->p1h);
    d->v2 = d->v2 + (p->m_V * x->p2h);
    d->h = (slope * x->sh) - (x->p1h + x->p2h);
    d->h = d->h + (p->m_V * x->phh);
#if CELLWISE_SLOW
    d->v3 = d->v3 + (p->m_V * x->p3h);
    d->h = d->h - x->p3h;
#endif
#endif
#if CELLWISE_OFFSET
    d->s = d->s + (p->r0_ohm * x->so);
    d->v1 = d->v1 + (p->r0_ohm * x->p1o);
    d->v2 = d->v2 + (p->r0_ohm * x->p2o);
    d->o = (slope * x->so) - (x->p1o + x->p2o);
    d->o = d->o + (p->r0_ohm * x->poo);
#if CELLWISE_SLOW
    d->v3 = d->v3 + (p->r0_ohm * x->p3o);
    d->o = d->o - x->p3o;
#endif
#if CELLWISE_HYSTERESIS
    d->h = d->h + (p->r0_ohm * x->pho);
    d->o = d->o + (p->m_V * x->pho);
#endif
#endif
    variance = (slope * d->s) - (d->v1 + d->v2);
#if CELLWISE_SLOW
    variance = variance - d->v3;
#endif
#if CELLWISE_HYSTERESIS
    variance = variance + (p->m_V * d->h);
#endif
#if CELLWISE_OFFSET
    variance = variance + (p->r0_ohm * d->o);
#endif
#if !CELLWISE_HYSTERESIS && !CELLWISE_OFFSET
    (void)p;
#endif
    return (variance > 0.0f) ? variance : 0.0f;
}

/* x + K innovation, P - K d', row by row. */
static void update(const cellwise_model *m, cellwise_state *x, const cellwise_column *d,
                   float inverse, float innovation)
{
    float k = d->s * inverse;
    add(&x->soc, &x->soc_carry, k * innovation);
    x->ss = x->ss - (k * d->s);
    x->s1 = x->s1 - (k * d->v1);
    x->s2 = x->s2 - (k * d->v2);
#if CELLWISE_SLOW
    x->s3 = x->s3 - (k * d->v3);
#endif
#if CELLWISE_HYSTERESIS
    x->sh = x->sh - (k * d->h);
#endif
#if CELLWISE_OFFSET
    x->so = x->so - (k * d->o);
#endif
    if (x->ss < VARIANCE_FLOOR) {
        x->ss = VARIANCE_FLOOR;
    }
    k = d->v1 * inverse;
    x->v1_V = x->v1_V + (k * innovation);
    x->p11 = x->p11 - (k * d->v1);
    x->p12 = x->p12 - (k * d->v2);
#if CELLWISE_SLOW
    x->p13 = x->p13 - (k * d->v3);
#endif
#if CELLWISE_HYSTERESIS
    x->p1h = x->p1h - (k * d->h);
#endif
#if CELLWISE_OFFSET
    x->p1o = x->p1o - (k * d->o);
#endif
    if (x->p11 < 0.0f) {
        x->p11 = 0.0f;
    }
    k = d->v2 * inverse;
    x->v2_V = x->v2_V + (k * innovation);
    x->p22 = x->p22 - (k * d->v2);
#if CELLWISE_SLOW
    x->p23 = x->p23 - (k * d->v3);
#endif
#if CELLWISE_HYSTERESIS
    x->p2h = x->p2h - (k * d->h);
#endif
#if CELLWISE_OFFSET
    x->p2o = x->p2o - (k * d->o);
#endif
    if (x->p22 < 0.0f) {
        x->p22 = 0.0f;
    }
#if CELLWISE_SLOW
    k = d->v3 * inverse;
    add(&x->v3_V, &x->v3_carry_V, k * innovation);
    x->p33 = x->p33 - (k * d->v3);
#if CELLWISE_HYSTERESIS
    x->p3h = x->p3h - (k * d->h);
#endif
#if CELLWISE_OFFSET
    x->p3o = x->p3o - (k * d->o);
#endif
    if (x->p33 < 0.0f) {
        x->p33 = 0.0f;
    }
#endif
#if CELLWISE_HYSTERESIS
    k = d->h * inverse;
    x->h = clip(x->h + (k * innovation), -1.0f, 1.0f);
    x->phh = x->phh - (k * d->h);
#if CELLWISE_OFFSET
    x->pho = x->pho - (k * d->o);
#endif
    if (x->phh < 0.0f) {
        x->phh = 0.0f;
    }
#endif
#if CELLWISE_OFFSET
    k = d->o * inverse;
    x->offset_A = clip(x->offset_A + (k * innovation), -m->constant.current_limit_A,
                       m->constant.current_limit_A);
    x->poo = x->poo - (k * d->o);
    if (x->poo < 0.0f) {
        x->poo = 0.0f;
    }
#else
    (void)m;
#endif
}

#if CELLWISE_WIDE
/* What is added to an entry of P when a gain of one slope is judged by another (Joseph's form). */
static float rejudged(float ki, float kj, float ci, float cj, float e)
{
    return ((ki * kj) * e) - ((ki * cj) + (kj * ci));
}

/* The gain was that of the slope here; what it is worth is said by the slope where it leads, if
 * that is flatter: on a plateau nothing was learnt. */
static APART void rejudge(const cellwise_model *m, const cellwise_place *place, cellwise_state *x,
                    const cellwise_point *p, const cellwise_slopes *w, const cellwise_column *d,
                    float inverse, float innovation, float seen)
{
    const float ks = d->s * inverse;
    const float k1 = d->v1 * inverse;
    const float k2 = d->v2 * inverse;
    const float move = ks * innovation;
    float flat = (p->slope_V < w->slope_V) ? p->slope_V : w->slope_V;
    float less;
    float e;
    if (magnitude(move) > (SMALL_MOVE * w->spread)) {
        cellwise_point landed;
        cellwise_slopes there;
        look_up(m, place, x->soc + move, seen, &landed);
        slopes_of(m, place, x->soc + move, w->spread, seen, &landed, &there);
        flat = (there.slope_V < landed.slope_V) ? there.slope_V : landed.slope_V;
        flat = (flat < w->slope_V) ? flat : w->slope_V;
    }
    less = flat - w->slope_V;
    e = less * ((2.0f * d->s) + (less * x->ss));
    {
        const float cs = less * x->ss;
        const float c1 = less * x->s1;
        const float c2 = less * x->s2;
        x->ss = x->ss + rejudged(ks, ks, cs, cs, e);
        x->s1 = x->s1 + rejudged(ks, k1, cs, c1, e);
        x->s2 = x->s2 + rejudged(ks, k2, cs, c2, e);
        x->p11 = x->p11 + rejudged(k1, k1, c1, c1, e);
        x->p12 = x->p12 + rejudged(k1, k2, c1, c2, e);
        x->p22 = x->p22 + rejudged(k2, k2, c2, c2, e);
#if CELLWISE_SLOW
        {
            const float k3 = d->v3 * inverse;
            const float c3 = less * x->s3;
            x->s3 = x->s3 + rejudged(ks, k3, cs, c3, e);
            x->p13 = x->p13 + rejudged(k1, k3, c1, c3, e);
            x->p23 = x->p23 + rejudged(k2, k3, c2, c3, e);
            x->p33 = x->p33 + rejudged(k3, k3, c3, c3, e);
#if CELLWISE_HYSTERESIS
            x->p3h = x->p3h + rejudged(k3, d->h * inverse, c3, less * x->sh, e);
#endif
#if CELLWISE_OFFSET
            x->p3o = x->p3o + rejudged(k3, d->o * inverse, c3, less * x->so, e);
#endif
        }
#endif
#if CELLWISE_HYSTERESIS
        {
            const float kh = d->h * inverse;
            const float ch = less * x->sh;
            x->sh = x->sh + rejudged(ks, kh, cs, ch, e);
            x->p1h = x->p1h + rejudged(k1, kh, c1, ch, e);
            x->p2h = x->p2h + rejudged(k2, kh, c2, ch, e);
            x->phh = x->phh + rejudged(kh, kh, ch, ch, e);
#if CELLWISE_OFFSET
            x->pho = x->pho + rejudged(kh, d->o * inverse, ch, less * x->so, e);
#endif
        }
#endif
#if CELLWISE_OFFSET
        {
            const float ko = d->o * inverse;
            const float co = less * x->so;
            x->so = x->so + rejudged(ks, ko, cs, co, e);
            x->p1o = x->p1o + rejudged(k1, ko, c1, co, e);
            x->p2o = x->p2o + rejudged(k2, ko, c2, co, e);
            x->poo = x->poo + rejudged(ko, ko, co, co, e);
        }
#endif
    }
}
#endif

/* A voltage that the gate keeps out. Under load the resistances may be what is wrong: what three
 * times the polarisation can explain speaks against the SOC more slowly. Rejections in a row mean
 * that the gate may have locked the truth out: a SOC error as large as what is seen is admitted,
 * and branches that hold anything, so that the next voltage passes. */
static uint32_t reject(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                       float polarisation, float excess, float innovation, float slope)
{
    uint32_t status = CELLWISE_INNOVATION_REJECTED;
    x->rejections += (excess > (4.0f * (polarisation * polarisation))) ? REJECTION : UNDER_LOAD;
    if (x->rejections >= c->recovery_after) {
        const float missed = innovation / ((slope > SLOPE_FLOOR_V) ? slope : SLOPE_FLOOR_V);
        const float square = missed * missed;
        const float held = RECOVERY_RATE * c->capacity_A;
        const float held_A2 = held * held;
        x->rejections = 0u;
        x->mismatch = 1.0f;
        x->evidence = FIRST_VOLTAGE;
        const float widened = x->ss + square;
        const float most = (widened < RECOVERY_VARIANCE) ? widened : RECOVERY_VARIANCE;
        x->ss = (most > x->ss) ? most : x->ss;
        x->p11 = x->p11 + ((x->v1_V * x->v1_V) + (held_A2 * (p->r1_ohm * p->r1_ohm)));
        x->p22 = x->p22 + ((x->v2_V * x->v2_V) + (held_A2 * (p->r2_ohm * p->r2_ohm)));
#if CELLWISE_SLOW
        x->p33 = x->p33 + ((x->v3_V * x->v3_V) + (held_A2 * (p->r3_ohm * p->r3_ohm)));
#endif
        status |= CELLWISE_GATE_RECOVERY;
    }
    return status;
}

/* How many samples share one model error. What the model gets wrong it gets wrong on every time
 * scale, so the memory grows with the time since the first voltage until it is the model's own. */
static float shared_by(const cellwise_constants *c, const cellwise_state *x, float seen)
{
    float shared = 1.0f; /* the first voltage at rest is evidence by itself */
    if (x->evidence >= FIRST_VOLTAGE) {
        const float since = (float)(x->evidence - FIRST_VOLTAGE);
        shared = clip(c->shared_start + (SHARED_GROWTH * since), 1.0f, c->shared);
    } else if (magnitude(seen) >= (REST_RATE * c->capacity_A)) {
        shared = clip(c->shared_start, 1.0f, c->shared);
    } else {
        /* at rest */
    }
    return shared;
}

/* Predicted voltage, innovation, and what follows from it. `news` is 0 where the sample was seen
 * before, 1 where it ends no interval, 2 where time has passed since the last one. */
static uint32_t correct(const cellwise_model *m, const cellwise_place *place, cellwise_state *x,
                        const cellwise_point *p, const cellwise_slopes *w, float seen,
                        float voltage, uint32_t news, cellwise_output *out)
{
    const cellwise_constants *const c = &m->constant;
    uint32_t status = 0u;
    cellwise_column d;
    const float drop = p->r0_ohm * seen;
    float polarisation = (magnitude(drop) + magnitude(x->v1_V)) + magnitude(x->v2_V);
    float one;
    float explained;
    out->voltage_V = p->ocv_V - (drop + (x->v1_V + x->v2_V));
#if CELLWISE_SLOW
    polarisation = polarisation + magnitude(x->v3_V);
    out->voltage_V = out->voltage_V - x->v3_V;
#endif
#if CELLWISE_HYSTERESIS
    out->voltage_V = out->voltage_V + (p->m_V * x->h);
#endif
    one = p->noise_V2 + ((c->share_variance * (polarisation * polarisation)) +
                         (c->current_variance_A2 * (p->r0_ohm * p->r0_ohm)));
    /* An OCV that bends by c at one standard deviation is off its tangent by c z^2. */
    explained = column_of(x, p, w->slope_V, &d) + (3.0f * (w->bend_V * w->bend_V));
    out->innovation_variance_V2 = explained + one;
    out->innovation_V = 0.0f;
    if (!WITHIN(voltage, c->voltage_low_V, c->voltage_high_V)) {
        status = CELLWISE_VOLTAGE_INVALID | out_of_range(voltage);
    } else {
        const float innovation = voltage - out->voltage_V;
        const float square = innovation * innovation;
        const float most = c->gate_square * out->innovation_variance_V2;
        out->innovation_V = innovation;
        if (news == 2u) {
            float ratio = square / out->innovation_variance_V2;
            ratio = (ratio < c->mismatch_cap) ? ratio : c->mismatch_cap;
            x->mismatch = x->mismatch + (c->lately * (ratio - x->mismatch));
        }
        if (news == 0u) {
            /* A repeated sample is no evidence. */
        } else if (square > most) {
            status = reject(c, x, p, polarisation, square - most, innovation, w->slope_V);
        } else {
            /* What the innovations have lately shown beyond their variance makes evidence weigh
             * less. A first sample under load tells of the load more than of the SOC. */
            const float shared = shared_by(c, x, seen);
            float weight = one * shared;
            if (x->mismatch > 1.0f) {
                weight = weight * x->mismatch;
            }
            if ((news == 2u) || (shared <= 1.0f)) {
                const float inverse = 1.0f / (explained + weight);
#if CELLWISE_WIDE
                if (w->spread > 0.0f) {
                    rejudge(m, place, x, p, w, &d, inverse, innovation, seen);
                }
#else
                (void)place;
#endif
                update(m, x, &d, inverse, innovation);
            }
            x->rejections = (x->rejections > FORGIVEN) ? (x->rejections - FORGIVEN) : 0u;
            if (x->evidence < FIRST_VOLTAGE) {
                x->evidence = FIRST_VOLTAGE;
            }
        }
    }
    return status;
}

/* ---- interface ---- */

uint32_t cellwise_init(const cellwise_model *model, cellwise_state *x, float soc,
                       float soc_variance)
{
    uint32_t status = 0u;
    if (WITHIN(soc, 0.0f, 1.0f) && WITHIN(soc_variance, VARIANCE_FLOOR, SOC_VARIANCE_MOST)) {
        start(model, x, soc, soc_variance);
    } else {
        start(model, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE);
        status = CELLWISE_STATE_RESET;
    }
    return status;
}

uint32_t cellwise_step(const cellwise_model *model, cellwise_state *x, const cellwise_input *in,
                       cellwise_output *out)
{
    const cellwise_constants *const c = &model->constant;
    cellwise_place place;
    cellwise_point point;
    cellwise_slopes slopes;
    uint32_t status = 0u;
    uint32_t news = 1u;
    uint32_t missing = 0u;
    float current = in->current_A;
    float seen;
    float flow;
    float bridge = 0.0f;
    float missing_A2 = 0.0f;

    if (is_sound(model, x) == 0u) {
        start(model, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE);
        status |= CELLWISE_STATE_RESET;
    }
    /* The first sample ends no interval; a sequence number that was taken before ends none. */
    if (x->evidence != NOT_BEGUN) {
        const uint32_t elapsed = in->sequence - x->sequence;
        if (elapsed == 0u) {
            news = 0u;
            status |= CELLWISE_DUPLICATE;
        } else {
            news = 2u;
            missing = elapsed - 1u;
        }
    }
    if (!WITHIN(current, -c->current_limit_A, c->current_limit_A)) {
        current = x->current_A;
        missing_A2 = c->missing_variance_A2;
        status |= CELLWISE_CURRENT_INVALID | out_of_range(in->current_A);
    }
    if (news == 0u) {
        current = x->current_A;
    }
#if CELLWISE_NEEDS_TEMPERATURE
    if (!WITHIN(in->temperature_C, TEMPERATURE_LOW_C, TEMPERATURE_HIGH_C)) {
        status |= CELLWISE_TEMPERATURE_INVALID;
    } else if (news != 0u) {
        x->temperature_C = in->temperature_C;
    } else {
        /* as before */
    }
#if CELLWISE_HEATING
    place = place_of(model, x->temperature_C + x->heat_K);
#else
    place = place_of(model, x->temperature_C);
#endif
#else
    place = place_of(model, 0.0f);
#endif
    seen = current;
#if CELLWISE_SKEW
    if (news == 2u) {
        seen = current + (c->skew_share * (x->current_A - current));
    }
#endif
    flow = seen;
#if CELLWISE_OFFSET
    flow = seen - x->offset_A;
#endif

    /* Charge first, then the branches at the new SOC. */
    if (news == 2u) {
        float used = taken(c, flow);
        if (missing != 0u) {
            status |= CELLWISE_SEQUENCE_GAP;
            if (missing <= c->gap_steps) {
                bridge = 0.5f * (current + x->current_A);
                used = used + (taken(c, bridge) * (float)missing);
            } else if (missing > LONGEST_GAP) {
                missing = LONGEST_GAP;
            } else {
                /* nobody knows what flowed */
            }
        }
        add(&x->soc, &x->soc_carry, -used);
    }
    look_up(model, &place, x->soc, seen, &point);
    if (x->evidence == NOT_BEGUN) {
        guess_branches(c, x, &point, seen);
        x->evidence = NO_VOLTAGE_YET;
    }
    if ((missing != 0u) || (missing_A2 > 0.0f)) {
        admit_doubt(c, x, &point, missing, current, bridge, (news == 2u) ? missing_A2 : 0.0f);
    }
    no_slopes(&point, &slopes);
#if CELLWISE_WIDE
    if (x->ss > WIDE_VARIANCE) {
        slopes_of(model, &place, x->soc, root(x->ss), seen, &point, &slopes);
    }
#endif
    if (news == 2u) {
        predict(c, x, &point, &slopes, flow, missing_A2);
    }
#if CELLWISE_HEATING
    if (news == 2u) {
        float fall = (point.r0_ohm * seen) + (x->v1_V + x->v2_V);
#if CELLWISE_SLOW
        fall = fall + x->v3_V;
#endif
        fall = c->heat_gain * ((c->heat_K_per_W * (flow * fall)) - x->heat_K);
        x->heat_K = clip(x->heat_K + fall, -HEAT_MOST_K, HEAT_MOST_K);
    }
#endif
    status |= correct(model, &place, x, &point, &slopes, seen, in->voltage_V, news, out);

    if (!WITHIN(x->soc, 0.0f, 1.0f)) {
        x->soc = clip(x->soc, 0.0f, 1.0f);
        x->soc_carry = 0.0f;
        status |= CELLWISE_CLAMPED;
    }
    if (news != 0u) {
        x->current_A = current;
        x->sequence = in->sequence;
        if ((news == 2u) && (x->evidence >= FIRST_VOLTAGE)) {
            x->evidence += (x->evidence < EVIDENCE_MOST) ? (1u + missing) : 0u;
        }
    }
    out->soc = x->soc;
    out->soc_variance = x->ss;
    out->status = status;
    return status;
}
