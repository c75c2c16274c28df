#include "cellwise_ekf.h"

/* Constants of the algorithm, the same in estimate/fixed/arithmetic.py. Hex literals are exact. */
#define KNOW_NOTHING_SOC 0.5f
#define KNOW_NOTHING_VARIANCE 0x1.70a3d8p-4f /* 0.09 */
#define SOC_VARIANCE_MOST 1.0f
#define VARIANCE_FLOOR 0x1.197998p-40f /* 1e-12 */
#define GROW 0x1.000004p+0f            /* above rounding, so that P stays positive */
#define BEYOND 0x1.99999ap-5f          /* 0.05: how far the OCV goes on outside 0..1 */
#define WIDE_VARIANCE 0x1.a36e2ep-12f  /* 4e-4: beyond it the tangent is no guide */
#define SMALL_MOVE 0x1.99999ap-5f /* 0.05 of a deviation: the slope is that of the spot left */
#define SHORTEST_CHORD 0x1.0c6f7ap-20f /* 1e-6 */
#define RECOVERY_VARIANCE 0x1.70a3d8p-4f
#define TEMPERATURE_LOW_C (-60.0f)
#define TEMPERATURE_HIGH_C 120.0f
#define HEAT_MOST_K 200.0f
#define LARGE 0x1p+20f /* no sound state goes beyond it, in V, A or their squares */
#define LARGE_BITS 0x49800000u /* of LARGE */
#define CARRY_BITS 0x3A800000u /* 2^-10 */
#define ONE_BITS 0x3F800000u
#define LEAST_FALL 0x1.99999ap-4f /* 0.1: with the current a resistance rises by ten at most */
#define LONGEST_GAP 0x100000u
#define NOT_BEGUN 0u /* evidence before the first sample */
#define NO_VOLTAGE_YET 1u
#define FIRST_VOLTAGE 2u
#define EVIDENCE_MOST 0x200000u
#define SHARED_GROWTH 4.0f /* twice the growth of the memory, in steps a step */
#define START_LOAD_SHARE 0.5f
#define REJECTION 20000u /* in the count of rejections in a row */
#define FORGIVEN 2000u
#define INFINITY_BITS 0x7F800000u
#define LOAD_LIMIT_V 0x1.333334p-2f   /* 0.3 */
#define REST_LIMIT_V 0x1.eb851ep-6f   /* 0.03: a rested branch holds no more */
#define RESTART_POINTS 201u
#define RESTART_STEP 0x1.47ae14p-8f         /* 1/200 */
#define RESTART_ROUNDING 0x1.179ecap-19f    /* of a SOC between two points: 1/200^2/12 */
#define FURTHEST 2000.0f                    /* beyond it exp(-z) is nothing */
#define FROZEN_READINGS 3u
#define FROZEN 0xFFFFFFFFu /* repeats of a voltage that was found frozen */
#define COUNT_MOST 2000000000u

/* False for NaN too. Macros, so that what is tested is known of the object itself afterwards, to
 * people and to analysers. */
#ifndef WITHIN /* analysis/eva_within.h says the same to Frama-C */
#define WITHIN(x, low, high) (((x) >= (low)) && ((x) <= (high)))
#endif
/* The bits of a float order its size: one integer comparison refuses what is too large, what is not
 * a number and, of a variance, what is negative. */
#ifndef NO_LARGER
#define NO_LARGER(x, limit) ((bits_of(x) << 1) <= ((limit) << 1))
#define NOT_NEGATIVE(x, limit) (bits_of(x) <= (limit))
#define SIZE_WITHIN(x, limit) ((bits_of(x) << 1) <= (bits_of(limit) << 1))
#define SIZE_BELOW(x, limit) ((bits_of(x) << 1) < (bits_of(limit) << 1))
#define POSITIVE_WITHIN(x, low, high) \
    ((bits_of(x) >= bits_of(low)) && (bits_of(x) <= bits_of(high)))
#define POSITIVE_ABOVE(x, y) (bits_of(x) > bits_of(y))
#define IS_NUMBER(x) ((bits_of(x) << 1) < (INFINITY_BITS << 1))
#endif
#ifndef WITHIN_ONE /* what is within 0..1 already: said for analysers */
#define WITHIN_ONE(x) (x)
#endif
#define IS_SMALL(x) NO_LARGER(x, LARGE_BITS)
#define IS_VARIANCE(x) NOT_NEGATIVE(x, LARGE_BITS)

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
    float gain1; /* 1 - exp(-dt/tau) */
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

/* The branches of a point as arguments, which stay in registers. */
#if CELLWISE_SLOW
#define BRANCHES float r1_ohm, float gain1, float r2_ohm, float gain2, float r3_ohm, float gain3
#define BRANCHES_OF(p) (p).r1_ohm, (p).gain1, (p).r2_ohm, (p).gain2, (p).r3_ohm, (p).gain3
#define RESISTANCES float r1_ohm, float r2_ohm, float r3_ohm
#define RESISTANCES_OF(p) (p).r1_ohm, (p).r2_ohm, (p).r3_ohm
#else
#define BRANCHES float r1_ohm, float gain1, float r2_ohm, float gain2
#define BRANCHES_OF(p) (p).r1_ohm, (p).gain1, (p).r2_ohm, (p).gain2
#define RESISTANCES float r1_ohm, float r2_ohm
#define RESISTANCES_OF(p) (p).r1_ohm, (p).r2_ohm
#endif

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

static float at_least(float x, float low)
{
    return (x < low) ? low : x;
}

#ifndef MAGNITUDE
typedef union {
    float value;
    uint32_t bits;
} cellwise_word;

static uint32_t bits_of(float x)
{
    cellwise_word word;
    word.value = x;
    return word.bits;
}

/* The builtin is one instruction, or two, and never a call. */
static float magnitude(float x)
{
#if defined(__GNUC__)
    return __builtin_fabsf(x);
#else
    cellwise_word word;
    word.value = x;
    word.bits = word.bits & 0x7FFFFFFFu;
    return word.value;
#endif
}
#else
static float magnitude(float x)
{
    return MAGNITUDE(x);
}
#endif

/* A number, but one that no cell of this kind gives; asked only of readings that were refused. */
static APART uint32_t out_of_range(float x)
{
    return IS_NUMBER(x) ? CELLWISE_OUT_OF_RANGE : 0u;
}

/* Compensated sum: what rounding keeps from `sum` stays in `carry`. */
static void add(float *sum, float *carry, float value)
{
    const float missed = value - *carry;
    const float total = *sum + missed;
    *carry = (total - *sum) - missed;
    *sum = total;
}

/* A variance of SOC that is large changes by less than rounding keeps of it. */
static void add_variance(cellwise_state *x, float value)
{
#if CELLWISE_WIDE
    add(&x->ss, &x->ss_carry, value);
#else
    x->ss = x->ss + value;
#endif
}

#if CELLWISE_WIDE || CELLWISE_HYSTERESIS
/* 1 - exp(-z) for z >= 0, with exp(z) by its first five terms: exact at 0, rises to 1. */
static APART float risen(float z)
{
    const float fourth = 0x1.555556p-3f + (z * 0x1.555556p-5f); /* 1/6, 1/24 */
    const float grown = z * (1.0f + (z * (0.5f + (z * fourth))));
    return grown / (1.0f + grown);
}
#endif

#if CELLWISE_WIDE || CELLWISE_WATCH
/* Square root of a number up to 4 by five Newton steps from 1; one below 1/4 is multiplied by 4 until
 * it is not. */
static APART float root(float square)
{
    float scaled = square;
    float unit = 1.0f;
    float r = 1.0f;
    for (uint32_t k = 0u; k < 24u; k++) {
        if (scaled < 0.25f) {
            scaled = 4.0f * scaled;
            unit = 0.5f * unit;
        }
    }
    for (uint32_t k = 0u; k < 5u; k++) {
        r = 0.5f * (r + (scaled / r));
    }
    return r * unit;
}
#endif

/* ---- tables ---- */

#if CELLWISE_ARRHENIUS > 0
/* The parabola through three neighbouring points: an exponential bends too much for a line. */
static float through_three(const float *table, float f)
{
    const float first = table[1] - table[0];
    const float second = table[2] - table[1];
    return table[0] + (f * (first + ((0.5f * (f - 1.0f)) * (second - first))));
}
#endif

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
        if (k > (CELLWISE_ARRHENIUS - 3u)) {
            k = CELLWISE_ARRHENIUS - 3u;
        }
        place.scale = through_three(&m->constant.arrhenius[k], y - (float)k);
    }
#endif
#if !CELLWISE_NEEDS_TEMPERATURE
    (void)m;
    (void)temperature_C;
#endif
    return place;
}

/* The nearer end of 0..1 for a SOC beyond it. */
static float within_one(float soc)
{
    return NOT_NEGATIVE(soc, ONE_BITS) ? soc : ((soc < 0.5f) ? 0.0f : 1.0f);
}

/* Lower point of the SOC interval that holds x, a SOC in units of the grid. */
static uint32_t index_of(float x)
{
#if CELLWISE_WIDE
    const float held = (x > 0.0f) ? x : 0.0f;
    return (held < (float)(CELLWISE_POINTS - 2u)) ? (uint32_t)held : (CELLWISE_POINTS - 2u);
#else
    const uint32_t k = (uint32_t)x; /* x is within 0..POINTS - 1 */
    return (k < (CELLWISE_POINTS - 2u)) ? k : (CELLWISE_POINTS - 2u);
#endif
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

/* Outside 0..1 the OCV goes on along its last segment, every other table stays at its end; without
 * CELLWISE_WIDE the OCV stays, too. */
static void look_up(const cellwise_model *m, const cellwise_place *place, float soc,
                    float current, cellwise_point *p)
{
#if CELLWISE_WIDE
    const float x = soc * POINTS_SCALE;
    const uint32_t k = index_of(x);
    const float f = clip(x - (float)k, -(BEYOND * POINTS_SCALE), 1.0f + (BEYOND * POINTS_SCALE));
    const float g = clip(f, 0.0f, 1.0f);
#else
    const float x = within_one(soc) * POINTS_SCALE;
    const uint32_t k = index_of(x);
    const float f = WITHIN_ONE(x - (float)k);
    const float g = f;
#endif
    const cellwise_row *const low = m->row[place->low];
#if CELLWISE_TEMPERATURES > 1
    const cellwise_row *const high = m->row[place->low + 1u];
#endif
    p->ocv_V = READ(ocv_V, f);
    p->slope_V = RISE(ocv_V) * POINTS_SCALE;
#if CELLWISE_WIDE
    p->noise_V2 = READ(error_V, g);
    p->noise_V2 = (m->constant.fixed_V2 + (p->noise_V2 * p->noise_V2)) +
                  (m->constant.ocv_soc2 * (p->slope_V * p->slope_V));
#else
    p->noise_V2 = READ(noise_V2, g);
#endif
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
    if (!NOT_NEGATIVE(x->soc, ONE_BITS) || !NO_LARGER(x->soc_carry, CARRY_BITS)) {
        return 0u;
    }
#if CELLWISE_WIDE
    if (!NO_LARGER(x->ss_carry, CARRY_BITS)) {
        return 0u;
    }
#endif
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
    if (!IS_SMALL(x->current_A) || !IS_VARIANCE(x->mismatch)) {
        return 0u;
    }
#if CELLWISE_SLOW
    if (!IS_SMALL(x->v3_V) || !NO_LARGER(x->v3_carry_V, CARRY_BITS)) {
        return 0u;
    }
    if (!IS_SMALL(x->s3) || !IS_SMALL(x->p13) || !IS_SMALL(x->p23) ||
        !IS_VARIANCE(x->p33)) {
        return 0u;
    }
#endif
#if CELLWISE_HYSTERESIS
    if (!NO_LARGER(x->h, ONE_BITS)) {
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
    if (!SIZE_WITHIN(x->offset_A, m->constant.current_limit_A)) {
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
#if CELLWISE_WATCH
    if (!IS_SMALL(x->voltage_V) || !IS_SMALL(x->frozen_A)) {
        return 0u;
    }
#endif
#if !CELLWISE_OFFSET
    (void)m;
#endif
    return 1u;
}

static void forget_correlations(cellwise_state *x)
{
    x->s1 = 0.0f;
    x->s2 = 0.0f;
    x->p12 = 0.0f;
#if CELLWISE_SLOW
    x->s3 = 0.0f;
    x->p13 = 0.0f;
    x->p23 = 0.0f;
#endif
#if CELLWISE_HYSTERESIS
    x->sh = 0.0f;
    x->p1h = 0.0f;
    x->p2h = 0.0f;
#if CELLWISE_SLOW
    x->p3h = 0.0f;
#endif
#endif
#if CELLWISE_OFFSET
    x->so = 0.0f;
    x->p1o = 0.0f;
    x->p2o = 0.0f;
#if CELLWISE_SLOW
    x->p3o = 0.0f;
#endif
#if CELLWISE_HYSTERESIS
    x->pho = 0.0f;
#endif
#endif
}

static APART void start(const cellwise_model *m, cellwise_state *x, float soc, float soc_variance)
{
    x->soc = soc;
    x->soc_carry = 0.0f;
    x->v1_V = 0.0f;
    x->v2_V = 0.0f;
    x->ss = soc_variance;
#if CELLWISE_WIDE
    x->ss_carry = 0.0f;
#endif
    x->p11 = 0.0f; /* guessed at the first sample */
    x->p22 = 0.0f;
    forget_correlations(x);
#if CELLWISE_SLOW
    x->v3_V = 0.0f;
    x->v3_carry_V = 0.0f;
    x->p33 = 0.0f;
#endif
#if CELLWISE_HYSTERESIS
    x->h = (soc > 0.5f) ? 1.0f : -1.0f;
    x->phh = 1.0f;
#endif
#if CELLWISE_OFFSET
    x->offset_A = 0.0f;
    x->poo = m->constant.offset_variance_A2;
#endif
    x->current_A = 0.0f;
    x->mismatch = 1.0f;
#if CELLWISE_HEATING
    x->heat_K = 0.0f;
#endif
#if CELLWISE_NEEDS_TEMPERATURE
    x->temperature_C = m->constant.temperature_C;
#endif
#if CELLWISE_WATCH
    x->voltage_V = 0.0f;
    x->frozen_A = 0.0f;
    x->repeats = 0u;
    x->no_current = 0u;
    x->no_voltage = 0u;
#endif
    x->sequence = 0u;
    x->rejections = 0u;
    x->evidence = NOT_BEGUN;
#if !CELLWISE_OFFSET && !CELLWISE_NEEDS_TEMPERATURE
    (void)m;
#endif
}

/* ---- predict ---- */

/* The branches over one interval of constant current, exactly, and their covariance. A current that
 * is not known to `square_A2` drives them too; 1 - a^2 keeps the stationary spread independent of
 * the time step. What decays slowly is told by how much it loses: 1 - 1e-5 as a float is off by
 * 0.3 % of that. */
static void relax(cellwise_state *x, BRANCHES, float flow, float square_A2)
{
    const float a1 = 1.0f - gain1;
    const float a2 = 1.0f - gain2;
    x->v1_V = x->v1_V + (gain1 * ((r1_ohm * flow) - x->v1_V));
    x->v2_V = x->v2_V + (gain2 * ((r2_ohm * flow) - x->v2_V));
    x->s1 = x->s1 - (gain1 * x->s1);
    x->s2 = x->s2 - (gain2 * x->s2);
    x->p11 = x->p11 + ((gain1 * (1.0f + a1)) * ((square_A2 * (r1_ohm * r1_ohm)) - x->p11));
    x->p12 = (a1 * a2) * x->p12;
    x->p22 = x->p22 + ((gain2 * (1.0f + a2)) * ((square_A2 * (r2_ohm * r2_ohm)) - x->p22));
#if CELLWISE_SLOW
    {
        const float a3 = 1.0f - gain3;
        add(&x->v3_V, &x->v3_carry_V, gain3 * ((r3_ohm * flow) - x->v3_V));
        x->s3 = x->s3 - (gain3 * x->s3);
        x->p13 = (a1 * a3) * x->p13;
        x->p23 = x->p23 - ((gain2 + (gain3 * a2)) * x->p23);
        x->p33 = x->p33 + ((gain3 * (1.0f + a3)) * ((square_A2 * (r3_ohm * r3_ohm)) - x->p33));
#if CELLWISE_HYSTERESIS
        x->p3h = x->p3h - (gain3 * x->p3h);
#endif
#if CELLWISE_OFFSET
        x->p3o = x->p3o - (gain3 * x->p3o);
#endif
    }
#endif
#if CELLWISE_HYSTERESIS
    x->p1h = x->p1h - (gain1 * x->p1h);
    x->p2h = x->p2h - (gain2 * x->p2h);
#endif
#if CELLWISE_OFFSET
    x->p1o = x->p1o - (gain1 * x->p1o);
    x->p2o = x->p2o - (gain2 * x->p2o);
#endif
}

/* Variance of a branch that holds anything up to what a current leaves there. */
static float admitted(float rested_V2, float held_V, float limit_V)
{
#if CELLWISE_WIDE
    const float most = (held_V < limit_V) ? held_V : limit_V;
    return rested_V2 + (most * most);
#else
    (void)limit_V;
    return rested_V2 + (held_V * held_V);
#endif
}

/* What the branches hold when nobody knows what was before: nearly nothing at rest, half of the
 * load's steady voltage under load. */
static APART void guess_branches(const cellwise_constants *c, cellwise_state *x, RESISTANCES,
                                 float current)
{
#if CELLWISE_WIDE
    float flow = 0.0f;
    float spread = c->start_rest_A;
    float limit_V = REST_LIMIT_V;
    if (!SIZE_BELOW(current, c->rest_A)) {
        flow = START_LOAD_SHARE * current;
        spread = at_least(magnitude(flow), c->start_load_A);
        limit_V = LARGE;
    }
#else
    const float flow = START_LOAD_SHARE * current;
    const float spread = magnitude(flow) + c->start_rest_A;
    const float limit_V = LARGE;
#endif
    forget_correlations(x);
    x->v1_V = r1_ohm * flow;
    x->v2_V = r2_ohm * flow;
    x->p11 = admitted(c->branch_variance_V2, spread * r1_ohm, limit_V);
    x->p22 = admitted(c->branch_variance_V2, spread * r2_ohm, limit_V);
#if CELLWISE_SLOW
    x->v3_V = r3_ohm * flow;
    x->v3_carry_V = 0.0f;
    x->p33 = admitted(c->branch_variance_V2, spread * r3_ohm, limit_V);
#endif
}

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

/* Samples are missing. The branches may hold what the currents on both sides can have left in them;
 * with CELLWISE_WIDE they relax towards the mean of these currents, too. */
static void cross_gap(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                      uint32_t missing, float current, float bridge)
{
    const float unknown_A2 = (current * current) + (x->current_A * x->current_A);
    const float steps = (float)missing;
    float spread = c->gap_variance;
    if (missing <= c->gap_steps) {
        const float moved = c->soc_per_A * steps;
        spread = (moved * moved) * unknown_A2;
    }
    x->ss = x->ss + spread;
#if !CELLWISE_WIDE
    x->p11 = x->p11 + (unknown_A2 * (p->r1_ohm * p->r1_ohm));
    x->p22 = x->p22 + (unknown_A2 * (p->r2_ohm * p->r2_ohm));
#if CELLWISE_SLOW
    x->p33 = x->p33 + (unknown_A2 * (p->r3_ohm * p->r3_ohm));
#endif
    (void)bridge;
#elif CELLWISE_SLOW
    relax(x, p->r1_ohm, risen(steps * p->gain1), p->r2_ohm, risen(steps * p->gain2), p->r3_ohm,
          risen(steps * p->gain3), bridge, unknown_A2);
#else
    relax(x, p->r1_ohm, risen(steps * p->gain1), p->r2_ohm, risen(steps * p->gain2), bridge,
          unknown_A2);
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

/* One interval of constant current. A resistance that is off by a share drives its branch like a
 * current that is off by it, and so does a current that nobody measured. */
static void predict(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                    const cellwise_slopes *w, float flow, float unmeasured_A2)
{
    relax(x, BRANCHES_OF(*p), flow, (c->share_variance * (flow * flow)) + unmeasured_A2);
#if CELLWISE_HYSTERESIS
    {
        const float rise = risen(c->hysteresis_per_A * magnitude(flow));
        const float ah = 1.0f - rise;
        x->h = clip((ah * x->h) + ((flow < 0.0f) ? rise : -rise), -1.0f, 1.0f);
        x->sh = ah * x->sh;
        x->p1h = ah * x->p1h;
        x->p2h = ah * x->p2h;
        x->phh = (ah * ah) * x->phh;
#if CELLWISE_SLOW
        x->p3h = ah * x->p3h;
#endif
#if CELLWISE_OFFSET
        x->pho = ah * x->pho;
#endif
    }
#endif
#if CELLWISE_WIDE
    if (w->spread > 0.0f) {
        tilt(x, p, w, flow);
    }
#else
    (void)w;
#endif
    if (POSITIVE_ABOVE(SOC_VARIANCE_MOST, x->ss)) { /* SOC lies in 0..1: more says nothing */
        add_variance(x, c->soc_walk);
    }
#if CELLWISE_OFFSET
    spread_offset(c, x, p);
#endif
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

/* x + K innovation. */
static void move(const cellwise_constants *c, cellwise_state *x, const cellwise_column *d,
                 float inverse, float innovation)
{
    add(&x->soc, &x->soc_carry, (d->s * inverse) * innovation);
    x->v1_V = x->v1_V + ((d->v1 * inverse) * innovation);
    x->v2_V = x->v2_V + ((d->v2 * inverse) * innovation);
#if CELLWISE_SLOW
    add(&x->v3_V, &x->v3_carry_V, (d->v3 * inverse) * innovation);
#endif
#if CELLWISE_HYSTERESIS
    x->h = clip(x->h + ((d->h * inverse) * innovation), -1.0f, 1.0f);
#endif
#if CELLWISE_OFFSET
    x->offset_A = clip(x->offset_A + ((d->o * inverse) * innovation), -c->current_limit_A,
                       c->current_limit_A);
#else
    (void)c;
#endif
}

/* P - K d', row by row. */
static void narrow(cellwise_state *x, const cellwise_column *d, float inverse)
{
    float k = d->s * inverse;
    add_variance(x, -(k * d->s));
#if CELLWISE_WIDE
    x->ss = clip(x->ss, VARIANCE_FLOOR, LARGE);
#else
    x->ss = at_least(x->ss, VARIANCE_FLOOR);
#endif
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
    k = d->v1 * inverse;
    x->p11 = at_least(x->p11 - (k * d->v1), 0.0f);
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
    k = d->v2 * inverse;
    x->p22 = at_least(x->p22 - (k * d->v2), 0.0f);
#if CELLWISE_SLOW
    x->p23 = x->p23 - (k * d->v3);
#endif
#if CELLWISE_HYSTERESIS
    x->p2h = x->p2h - (k * d->h);
#endif
#if CELLWISE_OFFSET
    x->p2o = x->p2o - (k * d->o);
#endif
#if CELLWISE_SLOW
    k = d->v3 * inverse;
    x->p33 = at_least(x->p33 - (k * d->v3), 0.0f);
#if CELLWISE_HYSTERESIS
    x->p3h = x->p3h - (k * d->h);
#endif
#if CELLWISE_OFFSET
    x->p3o = x->p3o - (k * d->o);
#endif
#endif
#if CELLWISE_HYSTERESIS
    k = d->h * inverse;
    x->phh = at_least(x->phh - (k * d->h), 0.0f);
#if CELLWISE_OFFSET
    x->pho = x->pho - (k * d->o);
#endif
#endif
#if CELLWISE_OFFSET
    k = d->o * inverse;
    x->poo = at_least(x->poo - (k * d->o), 0.0f);
#endif
}

#if CELLWISE_WIDE
/* What is added to an entry of P when a gain of one slope is judged by another (Joseph's form). */
static float rejudged(float ki, float kj, float ci, float cj, float e)
{
    return ((ki * kj) * e) - ((ki * cj) + (kj * ci));
}

/* The gain was that of the slope here; what it is worth is said by the slope where it leads, if
 * that is flatter: on a plateau nothing was learnt, and the covariance stays as it is: 0. */
static APART uint32_t rejudge(const cellwise_model *m, const cellwise_place *place,
                              cellwise_state *x, const cellwise_point *p, const cellwise_slopes *w,
                              const cellwise_column *d, float inverse, float innovation, float seen)
{
    const float ks = d->s * inverse;
    const float k1 = d->v1 * inverse;
    const float k2 = d->v2 * inverse;
    const float move = ks * innovation;
    float flat = (p->slope_V < w->slope_V) ? p->slope_V : w->slope_V;
    float less;
    float e;
    float wider;
    uint32_t learnt = 0u;
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
    wider = rejudged(ks, ks, less * x->ss, less * x->ss, e);
    if (SIZE_WITHIN(wider, LARGE) && (wider < (ks * d->s))) {
        const float cs = less * x->ss;
        const float c1 = less * x->s1;
        const float c2 = less * x->s2;
        learnt = 1u;
        x->ss = x->ss + wider;
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
    return learnt;
}
#endif

/* The voltage that the state gives at a point of the tables. */
static float voltage_of(const cellwise_state *x, const cellwise_point *p, float drop)
{
    float voltage = p->ocv_V - (drop + (x->v1_V + x->v2_V));
#if CELLWISE_SLOW
    voltage = voltage - x->v3_V;
#endif
#if CELLWISE_HYSTERESIS
    voltage = voltage + (p->m_V * x->h);
#endif
    return voltage;
}

#if CELLWISE_WIDE
/* exp(-z) for z >= 0, to 1e-4 of itself. */
static float vanishing(float z)
{
    float left = 1.0f - risen(((z < FURTHEST) ? z : FURTHEST) * 0.015625f);
    for (uint32_t k = 0u; k < 6u; k++) {
        left = left * left;
    }
    return left;
}

/* SOC and its variance over the whole of 0..1, when a voltage contradicts the estimate: every SOC
 * weighs as the estimate, widened, and the voltage, known to `variance`, say together. Branches may
 * hold what `held_A` would leave there. Beyond either end of the OCV that end is meant. */
static APART void search(const cellwise_model *m, const cellwise_place *place, cellwise_state *x,
                         float seen, float measured, float variance, float held_A, float limit_V)
{
    const float before = 1.0f / at_least(x->ss, RECOVERY_VARIANCE);
    const float most_V2 = limit_V * limit_V;
    float least = LARGE;
    float total = 0.0f;
    float first = 0.0f;
    float second = 0.0f;
    float low;
    float high;
    float voltage;
    cellwise_point p;
    look_up(m, place, 0.0f, seen, &p);
    low = voltage_of(x, &p, p.r0_ohm * seen);
    look_up(m, place, 1.0f, seen, &p);
    high = voltage_of(x, &p, p.r0_ohm * seen);
    voltage = (low < high) ? clip(measured, low, high) : clip(measured, high, low);
    for (uint32_t k = 0u; k < RESTART_POINTS; k++) {
        const float away = ((float)k * RESTART_STEP) - x->soc;
        float held;
        float about;
        float off;
        float cost;
        float weight;
        look_up(m, place, (float)k * RESTART_STEP, seen, &p);
        held = (p.r1_ohm * p.r1_ohm) + (p.r2_ohm * p.r2_ohm);
#if CELLWISE_SLOW
        held = held + (p.r3_ohm * p.r3_ohm);
#endif
        held = (held_A * held_A) * held;
        about = (variance + p.noise_V2) + ((held < most_V2) ? held : most_V2);
#if CELLWISE_HYSTERESIS
        about = about + ((p.m_V * p.m_V) * x->phh);
#endif
        off = voltage - voltage_of(x, &p, p.r0_ohm * seen);
        cost = 0.5f * (((away * away) * before) + ((off * off) / about));
        weight = 1.0f / root(about);
        if (cost < least) {
            const float faded = vanishing(least - cost);
            total = faded * total;
            first = faded * first;
            second = faded * second;
            least = cost;
        } else {
            weight = vanishing(cost - least) * weight;
        }
        total = total + weight;
        first = first + (weight * away);
        second = second + (weight * (away * away));
    }
    x->ss = at_least(x->ss, RECOVERY_VARIANCE);
    if (total > 0.0f) {
        const float mean = first / total;
        const float square = (second / total) - (mean * mean);
        if (WITHIN(mean, -1.0f, 1.0f) && WITHIN(square, -1.0f, 1.0f)) {
            x->soc = clip(x->soc + mean, 0.0f, 1.0f);
            x->soc_carry = 0.0f;
            x->ss = at_least(square, 0.0f) + RESTART_ROUNDING;
        }
    }
}

/* The gate may have locked the truth out, or a first voltage of a cell at rest says more than can be
 * weighed: SOC is looked for anew. Branches that have been followed may hold anything; under load the
 * resistances may be what is wrong, by as much as they are. */
static APART void look_anew(const cellwise_model *m, const cellwise_place *place,
                            cellwise_state *x, float seen, float voltage, float one,
                            float polarisation)
{
    const cellwise_constants *const c = &m->constant;
    float held_A = c->start_rest_A;
    float limit_V = REST_LIMIT_V;
    float variance = one + c->branch_variance_V2;
    float kept1 = 0.0f;
    float kept2 = 0.0f;
#if CELLWISE_SLOW
    float kept3 = 0.0f;
#endif
    cellwise_point p;
    if (x->evidence >= FIRST_VOLTAGE) {
        held_A = c->recovery_A;
        limit_V = LOAD_LIMIT_V;
        kept1 = x->v1_V * x->v1_V;
        kept2 = x->v2_V * x->v2_V;
        variance = (one + (polarisation * polarisation)) + ((kept1 + x->p11) + (kept2 + x->p22));
#if CELLWISE_SLOW
        kept3 = x->v3_V * x->v3_V;
        variance = variance + (kept3 + x->p33);
#endif
    }
    search(m, place, x, seen, voltage, variance, held_A, limit_V);
    look_up(m, place, x->soc, seen, &p);
    forget_correlations(x);
    x->p11 = admitted(c->branch_variance_V2, held_A * p.r1_ohm, limit_V) + kept1;
    x->p22 = admitted(c->branch_variance_V2, held_A * p.r2_ohm, limit_V) + kept2;
#if CELLWISE_SLOW
    x->p33 = admitted(c->branch_variance_V2, held_A * p.r3_ohm, limit_V) + kept3;
#endif
    x->evidence = FIRST_VOLTAGE;
}
#else
/* The gate may have locked the truth out: anything is admitted, so that the next voltage passes. */
static void widen(const cellwise_constants *c, cellwise_state *x, RESISTANCES, float seen)
{
    x->ss = RECOVERY_VARIANCE;
    x->evidence = FIRST_VOLTAGE;
#if CELLWISE_SLOW
    guess_branches(c, x, r1_ohm, r2_ohm, r3_ohm, seen);
#else
    guess_branches(c, x, r1_ohm, r2_ohm, seen);
#endif
}
#endif

#if CELLWISE_WATCH
/* A reading that repeats itself is frozen once R0 times the change of current says that it must have
 * moved, and the prediction is off by half of that: a held voltage repeats itself, too, but the model
 * expects it there. It stays frozen until it changes. */
static uint32_t watch_voltage(const cellwise_constants *c, cellwise_state *x, float voltage,
                              float seen, float r0_ohm, float innovation)
{
    uint32_t status = 0u;
    if ((voltage < x->voltage_V) || (voltage > x->voltage_V)) {
        x->voltage_V = voltage;
        x->frozen_A = seen;
        x->repeats = 0u;
    } else if (x->repeats == FROZEN) {
        status = CELLWISE_VOLTAGE_FROZEN;
    } else {
        const float moved = magnitude(r0_ohm * (seen - x->frozen_A));
        x->repeats += (x->repeats < COUNT_MOST) ? 1u : 0u;
        if ((x->repeats >= FROZEN_READINGS) && (moved > c->frozen_V) &&
            (magnitude(innovation) > (0.5f * moved))) {
            x->repeats = FROZEN;
            status = CELLWISE_VOLTAGE_FROZEN;
        }
    }
    return status;
}
#endif

/* How many samples share one model error. What the model gets wrong it gets wrong on every time
 * scale, so the memory grows with the time since the first voltage until it is the model's own. */
static float shared_by(const cellwise_constants *c, const cellwise_state *x, float seen)
{
    float shared = 1.0f; /* the first voltage at rest is evidence by itself */
    if (x->evidence >= FIRST_VOLTAGE) {
        const float since = (float)(x->evidence - FIRST_VOLTAGE);
        shared = clip(c->shared_start + (SHARED_GROWTH * since), 1.0f, c->shared);
    } else if (!SIZE_BELOW(seen, c->rest_A)) {
        shared = clip(c->shared_start, 1.0f, c->shared);
    } else {
        /* at rest */
    }
    return shared;
}

/* An innovation that is looked at: gate, recovery, weight. Under load the resistances may be what is
 * wrong: what three times the polarisation can explain speaks against the SOC more slowly. What the
 * innovations have lately shown beyond their variance makes evidence weigh less. A first sample under
 * load tells of the load more than of the SOC. */
static uint32_t weigh(const cellwise_model *m, const cellwise_place *place, cellwise_state *x,
                      const cellwise_point *p, const cellwise_slopes *w, const cellwise_column *d,
                      float seen, float voltage, uint32_t news, float explained, float one,
                      float polarisation, const cellwise_output *out)
{
    const cellwise_constants *const c = &m->constant;
    const float innovation = out->innovation_V;
    const float square = innovation * innovation;
    const float most = c->gate_square * out->innovation_variance_V2;
    uint32_t status = 0u;
#if CELLWISE_WIDE
    /* A start that is unsure of itself believes the first voltage at rest at once, and looks for it
     * where the OCV bends too much for a slope. */
    uint32_t unsure = 0u;
    uint32_t bent = 0u;
#else
    (void)voltage;
    (void)w;
    (void)place;
#endif
#if CELLWISE_WIDE
    if ((w->spread > 0.0f) && (x->evidence < FIRST_VOLTAGE) && SIZE_BELOW(seen, c->rest_A)) {
        unsure = 1u;
        if (((3.0f * (w->bend_V * w->bend_V)) > one) || (w->slope_V < c->flat_slope_V)) {
            bent = 1u;
        }
    }
#endif
    if (news == 2u) {
        float ratio = square / out->innovation_variance_V2;
        ratio = (ratio < c->mismatch_cap) ? ratio : c->mismatch_cap;
        x->mismatch = x->mismatch + (c->lately * (ratio - x->mismatch));
    }
    if (POSITIVE_ABOVE(square, most)) {
        status = CELLWISE_INNOVATION_REJECTED;
        x->rejections +=
            ((square - most) > (4.0f * (polarisation * polarisation))) ? REJECTION : c->under_load;
#if CELLWISE_WIDE
        if (unsure != 0u) {
            x->rejections = c->recovery_after;
        }
#endif
        if (x->rejections >= c->recovery_after) {
            status |= CELLWISE_GATE_RECOVERY;
            x->rejections = 0u;
            x->mismatch = 1.0f;
#if CELLWISE_WIDE
            look_anew(m, place, x, seen, voltage, one, polarisation);
#else
            widen(c, x, RESISTANCES_OF(*p), seen);
#endif
        }
    }
#if CELLWISE_WIDE
    else if (bent != 0u) {
        look_anew(m, place, x, seen, voltage, one, polarisation);
    }
#endif
    else {
        const float shared = shared_by(c, x, seen);
        float weight = one * shared;
        if (POSITIVE_ABOVE(x->mismatch, 1.0f)) {
            weight = weight * x->mismatch;
        }
        if ((news == 2u) || (shared <= 1.0f)) {
            const float inverse = 1.0f / (explained + weight);
            uint32_t learnt = 1u;
#if CELLWISE_WIDE
            if (w->spread > 0.0f) {
                learnt = rejudge(m, place, x, p, w, d, inverse, innovation, seen);
            }
#endif
            move(c, x, d, inverse, innovation);
            if (learnt != 0u) {
                narrow(x, d, inverse);
            }
        }
        x->rejections = (x->rejections > FORGIVEN) ? (x->rejections - FORGIVEN) : 0u;
        if (x->evidence < FIRST_VOLTAGE) {
            x->evidence = FIRST_VOLTAGE;
        }
    }
    return status;
}

/* Predicted voltage, innovation, and what follows from it. `news` is 0 where the sample was seen
 * before, 1 where it ends no interval, 2 where time has passed since the last one. */
static uint32_t correct(const cellwise_model *m, const cellwise_place *place, cellwise_state *x,
                        const cellwise_point *p, const cellwise_slopes *w, float seen,
                        float unmeasured_A2, float voltage, uint32_t news, cellwise_output *out)
{
    const cellwise_constants *const c = &m->constant;
    uint32_t status = 0u;
    cellwise_column d;
    const float drop = p->r0_ohm * seen;
    float polarisation = (magnitude(drop) + magnitude(x->v1_V)) + magnitude(x->v2_V);
    float one;
    float explained;
#if CELLWISE_WATCH
    uint32_t away = x->no_voltage;
    if ((news == 2u) && (away < COUNT_MOST)) {
        away = away + 1u;
    }
#endif
#if CELLWISE_SLOW
    polarisation = polarisation + magnitude(x->v3_V);
#endif
    out->voltage_V = voltage_of(x, p, drop);
    one = p->noise_V2 + ((c->share_variance * (polarisation * polarisation)) +
                         ((c->current_variance_A2 + unmeasured_A2) * (p->r0_ohm * p->r0_ohm)));
    /* An OCV that bends by c at one standard deviation is off its tangent by c z^2. */
    explained = column_of(x, p, w->slope_V, &d) + (3.0f * (w->bend_V * w->bend_V));
    out->innovation_variance_V2 = explained + one;
    out->innovation_V = 0.0f;
    if (!POSITIVE_WITHIN(voltage, c->voltage_low_V, c->voltage_high_V)) {
        status = CELLWISE_VOLTAGE_INVALID | out_of_range(voltage);
    } else {
        out->innovation_V = voltage - out->voltage_V;
        if (news != 0u) { /* a repeated sample is no evidence */
#if CELLWISE_WATCH
            status = watch_voltage(c, x, voltage, seen, p->r0_ohm, out->innovation_V);
            if (status == 0u) {
                away = 0u;
            }
#endif
            if (status == 0u) {
                status = weigh(m, place, x, p, w, &d, seen, voltage, news, explained, one,
                               polarisation, out);
            }
        }
    }
#if CELLWISE_WATCH
    if (news != 0u) {
        x->no_voltage = away;
    }
    if (away > c->hold_steps) {
        status |= CELLWISE_VOLTAGE_LOST;
    }
#endif
    return status;
}

/* ---- interface ---- */

uint32_t cellwise_init(const cellwise_model *model, cellwise_state *x, float soc,
                       float soc_variance)
{
    const float positive = soc + 0.0f; /* never -0 */
    uint32_t status = 0u;
    if (NOT_NEGATIVE(positive, ONE_BITS) &&
        POSITIVE_WITHIN(soc_variance, VARIANCE_FLOOR, SOC_VARIANCE_MOST)) {
        start(model, x, positive, soc_variance);
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
    uint32_t silent = 0u; /* no current that could be used */
    float current = in->current_A;
    float seen;
    float flow;
    float bridge = 0.0f;
    float unmeasured_A2 = 0.0f;

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
    if (!SIZE_WITHIN(current, c->current_limit_A)) {
        status |= CELLWISE_CURRENT_INVALID | out_of_range(in->current_A);
        silent = 1u;
    }
    if ((silent != 0u) || (news == 0u)) {
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
#if CELLWISE_WATCH
    /* Held for a while; then whatever was held is no guide any more: nothing is counted, and as much
     * as half a rate may flow either way. */
    if ((silent != 0u) || (news == 0u)) {
        silent = x->no_current;
        if ((news == 2u) && (silent < COUNT_MOST)) {
            silent = silent + 1u;
        }
    }
    if (silent > c->hold_steps) {
        status |= CELLWISE_CURRENT_LOST;
        seen = 0.0f;
        flow = 0.0f;
        unmeasured_A2 = c->lost_A2;
    }
#else
    if (silent != 0u) {
        unmeasured_A2 = c->lost_A2;
    }
#endif

    /* Charge first, then the branches at the new SOC. */
    if (news == 2u) {
        float used = taken(c, flow);
        if (missing != 0u) {
            status |= CELLWISE_SEQUENCE_GAP;
            if (missing <= c->gap_steps) {
#if CELLWISE_WATCH
                bridge = (silent > c->hold_steps) ? 0.0f : (0.5f * (current + x->current_A));
#else
                bridge = 0.5f * (current + x->current_A);
#endif
                used = used + (taken(c, bridge) * (float)missing);
            } else { /* nobody knows what flowed */
                missing = (missing < LONGEST_GAP) ? missing : LONGEST_GAP;
            }
        }
        add(&x->soc, &x->soc_carry, -used);
        if (unmeasured_A2 > 0.0f) {
#if CELLWISE_WATCH
            /* It may keep one sign for as long as it is away: the deviation grows, not the
             * variance. */
            const float drift = root(x->ss) + c->lost_soc;
            x->ss = drift * drift;
#else
            x->ss = x->ss + c->lost_walk;
#endif
        }
    }
    look_up(model, &place, x->soc, seen, &point);
    if (x->evidence == NOT_BEGUN) {
        guess_branches(c, x, RESISTANCES_OF(point), seen);
        x->evidence = NO_VOLTAGE_YET;
    }
    if (missing != 0u) {
        cross_gap(c, x, &point, missing, current, bridge);
    }
    no_slopes(&point, &slopes);
#if CELLWISE_WIDE
    if (x->ss > WIDE_VARIANCE) {
        slopes_of(model, &place, x->soc, root(x->ss), seen, &point, &slopes);
    }
#endif
    if (news == 2u) {
        predict(c, x, &point, &slopes, flow, unmeasured_A2);
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
    status |= correct(model, &place, x, &point, &slopes, seen, unmeasured_A2, in->voltage_V, news,
                      out);

    if (!NOT_NEGATIVE(x->soc, ONE_BITS)) {
        x->soc = within_one(x->soc);
        x->soc_carry = 0.0f;
        status |= CELLWISE_CLAMPED;
    }
    if (news != 0u) {
        x->current_A = current;
        x->sequence = in->sequence;
#if CELLWISE_WATCH
        x->no_current = silent;
#endif
        if ((news == 2u) && ((x->evidence - FIRST_VOLTAGE) < EVIDENCE_MOST)) {
            x->evidence += 1u + missing;
        }
    }
    out->soc = x->soc;
    out->soc_variance = x->ss;
    out->status = status;
    return status;
}
