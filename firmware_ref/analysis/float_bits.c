/* The tests on a float's bits are the tests on its value: for every so-manyth of the 2^32 floats (argument;
 * 1: every one) and for all within 4096 of a limit. -0 is refused by NOT_NEGATIVE and POSITIVE_WITHIN: no
 * state and no voltage limit holds it. And what is left of a SOC above its point is within 0..1. */
#include <stdio.h>
#include <stdlib.h>

#include "cellwise_ekf.c"

#define SAME(bits, value) wrong += ((bits) != (value)) ? 1u : 0u

static uint32_t wrong_at(uint32_t pattern)
{
    const float low = 0x1p-10f;
    const uint32_t zero = (pattern == 0x80000000u) ? 1u : 0u;
    uint32_t wrong = 0u;
    cellwise_word word;
    float x;
    word.bits = pattern;
    x = word.value;
    SAME(IS_NUMBER(x), (x >= -0x1.fffffep+127f) && (x <= 0x1.fffffep+127f));
    SAME(SIZE_WITHIN(x, LARGE), (x >= -LARGE) && (x <= LARGE));
    SAME(NOT_NEGATIVE(x, LARGE), (x >= 0.0f) && (x <= LARGE) && (zero == 0u));
    SAME(SIZE_WITHIN(x, CARRY_MOST), (x >= -0x1p-10f) && (x <= 0x1p-10f));
    SAME(NOT_NEGATIVE(x, 1.0f), (x >= 0.0f) && (x <= 1.0f) && (zero == 0u));
    SAME(SIZE_WITHIN(x, 3.25f), (x >= -3.25f) && (x <= 3.25f));
    SAME(SIZE_BELOW(x, 3.25f), (x > -3.25f) && (x < 3.25f));
    SAME(POSITIVE_WITHIN(x, low, 5.5f), (x >= low) && (x <= 5.5f));
    if (bits_of(x) <= 0x7F800000u) {
        SAME(POSITIVE_ABOVE(x, 3.25f), x > 3.25f);
    }
    if (NOT_NEGATIVE(x, 1.0f)) {
        const float scaled = x * (float)(CELLWISE_POINTS - 1u);
        const float f = scaled - (float)index_of(scaled, CELLWISE_POINTS);
        SAME((f >= 0.0f) && (f <= 1.0f), 1);
    }
    return wrong;
}

int main(int count, char **arguments)
{
    const float limits[] = {0.0f, 0x1p-10f, 1.0f, 3.25f, 5.5f, LARGE, 0x1.fffffep+127f};
    const uint32_t stride = (count > 1) ? (uint32_t)strtoul(arguments[1], NULL, 10) : 1u;
    uint32_t wrong = 0u;
    uint64_t pattern;
    for (pattern = 0u; pattern <= 0xFFFFFFFFu; pattern += stride) {
        wrong += wrong_at((uint32_t)pattern);
    }
    for (size_t k = 0u; k < (sizeof limits / sizeof limits[0]); k++) {
        for (uint32_t near = 0u; near < 8192u; near++) {
            const uint32_t bits = (bits_of(limits[k]) + near) - 4096u;
            wrong += wrong_at(bits) + wrong_at(bits ^ 0x80000000u);
        }
    }
    printf("%u\n", (unsigned)wrong);
    return (wrong == 0u) ? 0 : 1;
}
