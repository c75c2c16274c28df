/* Included before the sources when Frama-C reads them. In C a comparison with NaN is false; this
 * version of Eva keeps NaN in a float that has passed one, but not in one that equals itself. */
#define WITHIN(x, low, high) (((x) == (x)) && ((x) >= (low)) && ((x) <= (high)))
