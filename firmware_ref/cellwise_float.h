/* Arithmetic of cellwise_ekf.c that is written by hand: float32 by its bits, compensated sums, reads of
 * a table. The same operations on values, by the same names, stand in
 * src/cellwise/estimate/fixed/arithmetic.py and lookup.py. */
#ifndef CELLWISE_FLOAT_H
#define CELLWISE_FLOAT_H

#include <stdbool.h>
#include <stdint.h>

/* What few steps need is kept out of the others' registers and stack; what every step needs is no call. */
#if defined(__GNUC__) && !defined(__FRAMAC__)
#define NOINLINE __attribute__((noinline))
#define INLINED inline __attribute__((always_inline))
#else
#define NOINLINE
#define INLINED
#endif

/* False for NaN too. Macros, so that what is tested is known of the object itself afterwards, to
 * people and to analysers. */
#ifndef WITHIN /* analysis/eva_within.h says the same to Frama-C */
#define WITHIN(x, low, high) (((x) >= (low)) && ((x) <= (high)))
#endif
/* The bits of a float order its size: one integer comparison refuses what is too large, what is not
 * a number and, of a variance, what is negative. */
#ifndef SIZE_WITHIN
#define SIZE_WITHIN(x, limit) ((bits_of(x) << 1) <= (bits_of(limit) << 1))
#define SIZE_BELOW(x, limit) ((bits_of(x) << 1) < (bits_of(limit) << 1))
#define NOT_NEGATIVE(x, limit) (bits_of(x) <= bits_of(limit))
#define POSITIVE_WITHIN(x, low, high) \
    ((bits_of(x) >= bits_of(low)) && (bits_of(x) <= bits_of(high)))
#define POSITIVE_ABOVE(x, y) (bits_of(x) > bits_of(y))
#define IS_NUMBER(x) ((bits_of(x) << 1) < 0xFF000000u)
#endif
#ifndef KNOWN_FRACTION /* what is within 0..1 already: said for analysers */
#define KNOWN_FRACTION(x) (x)
#endif

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

/* Compensated sum: what rounding keeps from the total stays in the carry. */
static void add(float *total, float *carry, float value)
{
    const float missed = value - *carry;
    const float sum = *total + missed;
    *carry = (sum - *total) - missed;
    *total = sum;
}

/* One table at a fraction of an interval, and how far it rises over the interval, between the rows
 * `low` and `high` of two temperatures where there are several. */
#if CELLWISE_TEMPERATURES > 1
#define READ(k, field, f)                                     \
    between(between(low[k].field, low[(k) + 1u].field, (f)),  \
            between(high[k].field, high[(k) + 1u].field, (f)), place->weight)
#define RISE(k, field)                                        \
    between(low[(k) + 1u].field - low[k].field, high[(k) + 1u].field - high[k].field, place->weight)
#else
#define READ(k, field, f) between(low[k].field, low[(k) + 1u].field, (f))
#define RISE(k, field) (low[(k) + 1u].field - low[k].field)
#endif

#endif
