/* Included before the sources when Frama-C reads them: the same tests on floats in a form that this
 * version of Eva follows. In C a comparison with NaN is false; Eva keeps NaN in a float that has passed
 * one, but not in one that equals itself; and of a float's bits it knows nothing. That the tests on bits
 * are these tests is checked by float_bits.c. */
#define WITHIN(x, low, high) (((x) == (x)) && ((x) >= (low)) && ((x) <= (high)))
#define SIZE_WITHIN(x, limit) WITHIN(x, -(limit), limit)
#define SIZE_BELOW(x, limit) (((x) > -(limit)) && ((x) < (limit)))
#define NOT_NEGATIVE(x, limit) WITHIN(x, 0.0f, limit)
#define POSITIVE_WITHIN(x, low, high) WITHIN(x, low, high)
#define POSITIVE_ABOVE(x, y) ((x) > (y))
#define KNOWN_FRACTION(x) within_one(x)
#define IS_NUMBER(x) WITHIN(x, -0x1.fffffep+127f, 0x1.fffffep+127f)
#define MAGNITUDE(x) (((x) < 0.0f) ? -(x) : (x))
