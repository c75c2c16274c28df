/* State of charge of one battery cell: float32 extended Kalman filter at a fixed time step.
 * Printed from src/cellwise/estimate/fixed by `python -m cellwise.printing`; do not edit. */
#include "cellwise_ekf.h"
#include "cellwise_float.h"

/* Constants of the algorithm. */
#define COLDEST_C (-60.0f)
#define HOTTEST_C 120.0f
#define FROZEN_READINGS 3u /* repeats of a voltage, before which nobody calls it frozen */
#define DITHER_V 0x1.47ae14p-9f /* 0.0025: a reading that moves by less repeats itself: the last digits of a converter */
#define DEAD_SWINGS 8.0f /* of the voltage, up and down, under a current that repeats itself bit by bit */
#define SWINGS_MOST 100.0f /* counting on says nothing more */
#define REST_LIMIT_V 0x1.eb851ep-6f /* 0.03: a rested branch holds no more, whatever its resistance */
#define START_LOAD_SHARE 0.5f
#define NO_LIMIT_V 1000.0f /* no cell's branch holds that */
#define VARIANCE_FLOOR 0x1.197998p-40f /* 1e-12: of the SOC: rounding takes no more away */
#define WIDE_VARIANCE 0x1.a36e2ep-12f /* 0.0004: beyond 2 points of SOC the tangent is no guide */
#define SHORTEST_CHORD 0x1.0c6f7ap-20f /* 1e-06: of the SOC: both ends are beyond the same end of the tables */
#define RECOVERY_VARIANCE 0x1.70a3d8p-4f /* 0.09: after voltages that contradicted it for long: anywhere */
#define LOAD_LIMIT_V 0x1.333334p-2f /* 0.3: and the most */
#define SQUARE_MOST 4.0f /* [V^2] of an error: no cell's voltage is off by more */
#define SPREAD_VARIANCE 0x1.a36e2ep-10f /* 0.0016: beyond it a SOC is no longer known well enough for one filter */
#define COMPONENT_WIDTH 0x1.333334p-1f /* 0.6: deviation of a component over the distance to the next */
#define DENSE 3.0f /* deviations of a start within which the components lie close */
#define LEAST_WIDTH 0x1.0624dep-10f /* 0.001: of a component in SOC */
#define TAIL 4.0f /* degrees of freedom of a stated start: how sure it is, is itself not sure */
#define COST_MOST 20.0f /* a component less likely than exp(-20) is given up */
#define LEAST_PASSED 0x1.a36e2ep-14f /* 0.0001: of an innovation that the gate lets pass */
#define LOOK_FACTOR 4u /* and each time so much longer */
#define LOOKS 3u /* times */
#define PAST_PART 0.03125f /* of the SOC: the way of a load before the start goes in such parts */
#define PAST_SPREAD 0.5f /* of what a load has left before the start may be otherwise */
#define LEAST_PAST_V2 0x1.0c6f7ap-20f /* 1e-06: a millivolt of what it has left is always open */
#define SIXTH 0x1.555556p-3f /* 0.166667 */
#define TWENTY_FOURTH 0x1.555556p-5f /* 0.0416667 */
#define THIRD 0x1.555556p-2f /* 0.333333 */
#define FIFTH 0x1.99999ap-3f /* 0.2 */
#define SEVENTH 0x1.24924ap-3f /* 0.142857 */
#define LARGEST_FLOAT 0x1.fffffep+127f /* 3.40282e+38 */
#define KNOW_NOTHING_SOC 0.5f
#define KNOW_NOTHING_VARIANCE 0x1.70a3d8p-4f /* 0.09 */
#define SOC_VARIANCE_MOST 1.0f /* SOC lies in 0..1: more says nothing */
#define BEYOND 0x1.99999ap-5f /* 0.05: how far the OCV goes on outside 0..1 */
#define HEAT_MOST_K 200.0f
#define LARGE 0x1p+20f /* no sound state goes beyond it, in V, A or their squares */
#define CARRY_MOST 0x1p-10f
#define LEAST_FALL 0x1.99999ap-4f /* 0.1: with the current a resistance rises by ten at most */
#define LONGEST_GAP 0x100000u /* samples */
#define NOT_BEGUN 0u /* evidence before the first sample */
#define NO_VOLTAGE_YET 1u
#define FIRST_VOLTAGE 2u
#define EVIDENCE_MOST 0x200000u
#define REPEATED 0u /* a sample that was seen before, */
#define NO_INTERVAL 1u /* the first one, which ends no interval, */
#define INTERVAL 2u /* and one that ends an interval */
#define ALONE 0u /* a state that stands for itself, */
#define COMPONENT 1u /* one of a bank, */
#define CONTRADICTED 2u /* one whose voltages have contradicted it for long, */
#define UNCOUNTED 3u /* and one of whose charge a part is not known */
#define NEVER_LOOKED 0xFFFFFFFFu
#define LN_2 0x1.62e43p-1f /* 0.693147 */
#define FURTHEST 2000.0f /* beyond it exp(-z) is nothing */
#define POWER_TRIALS 8u
#define LONGEST 0x1.dcd65p+29f /* 1e+09: remaining seconds, and joules: no cell lasts for more */
#define REMAINING_PARTS 64.0f /* of the SOC down to empty */
#define PHASE_PARTS_PER_S 0x1.111112p-5f /* 0.0333333: of a plan's phase, beside those by its SOC */
#define PHASE_PARTS_MOST 4096.0f
#define PHASE_TURNS 3u /* of a power to its current: off by less than 1e-6 then */
#define DEVIATIONS_MOST 8.0f /* nothing is beyond */
#define NORMAL_1 0x1.988368p-5f /* 0.0498673 */
#define NORMAL_2 0x1.5a5fcep-6f /* 0.021141 */
#define NORMAL_3 0x1.ad9ae4p-9f /* 0.00327763 */
#define NORMAL_4 0x1.3ecc1cp-15f /* 3.80036e-05 */
#define NORMAL_5 0x1.9a1fc4p-15f /* 4.88906e-05 */
#define NORMAL_6 0x1.693f3cp-18f /* 5.383e-06 */
#define LEAST_SPAN_V 0x1.12e0bep-30f /* 1e-09: between the ends of a bracket: it is divided by */
#define THREE_CELLS 3u /* that may limit a pack's power */
#define CELL_MOST 0x1.ccccccp-1f /* 0.9: of a cell's capacity or resistance may be missing, */
#define SCALE_MOST 19.0f /* and as many times its resistance be added */
#define LEAST_SHARE 0x1.99999ap-4f /* 0.1: of the capacity that a history gives */
#define MOST_SHARE 2.0f /* of the capacity that a history gives */
#define LEAST_SCALE 0x1.99999ap-4f /* 0.1: of the resistances */
#define MOST_SCALE 20.0f /* of the resistances */
#define SUSTAINED 0x1.a5182ap+0f /* 1.6449: one-sided 95 % of a normal distribution */
#define FROZEN 0xFFFFFFFFu /* repeats of a voltage that was found frozen */
#define COUNT_MOST 2000000000u

/* ---- arithmetic.py: The fixed step in float32: its constants and its small helpers. */

/* Whether two numbers are the same. */
static bool is_same(float a, float b)
{
    return (a >= b) && (a <= b);
}

/* From a at f = 0 to b at f = 1. */
static float between(float a, float b, float f)
{
    return a + (f * (b - a));
}

/* Bit for a number that no cell of this kind gives; asked of readings that were refused. */
static NOINLINE uint32_t out_of_range(float x)
{
    return IS_NUMBER(x) ? CELLWISE_OUT_OF_RANGE : 0u;
}

/* 1 - exp(-z) for z >= 0, with exp(z) by its first five terms: exact at 0, rises to 1. */
static NOINLINE float risen(float z)
{
    const float fourth = SIXTH + (z * TWENTY_FOURTH);
    const float grown = z * (1.0f + (z * (0.5f + (z * fourth))));
    return grown / (1.0f + grown);
}

/* exp(-z) for z >= 0, to 1e-4 of itself. */
static float vanishing(float z)
{
    float left = 1.0f - risen(((z < FURTHEST) ? z : FURTHEST) * 0.015625f);
    for (uint32_t k = 0u; k < 6u; k++) {
        left = left * left;
    }
    return left;
}

/* Square root of a number up to 4 by five Newton steps from 1. One below 1/4 is multiplied by 4
 * until it is not. */
static NOINLINE float root(float square)
{
    float scaled = square;
    float unit = 1.0f;
    float r = 1.0f;
    for (uint32_t k = 0u; k < 24u; k++) {
        if (scaled >= 0.25f) {
            break;
        }
        scaled = 4.0f * scaled;
        unit = 0.5f * unit;
    }
    for (uint32_t k = 0u; k < 5u; k++) {
        r = 0.5f * (r + (scaled / r));
    }
    return r * unit;
}

/* ln(1 + z) for z >= 0, to 1e-5: halved until it is below 2, then the series of atanh. */
static NOINLINE float log_of_more(float z)
{
    float y = 1.0f + ((z < LARGE) ? z : LARGE);
    float whole = 0.0f;
    for (uint32_t k = 0u; k < 21u; k++) {
        if (y <= 2.0f) {
            break;
        }
        y = 0.5f * y;
        whole = whole + LN_2;
    }
    const float t = (y - 1.0f) / (y + 1.0f);
    const float square = t * t;
    const float series = 1.0f + (square * (THIRD + (square * (FIFTH + (square * SEVENTH)))));
    return whole + ((2.0f * t) * series);
}

/* ---- scalar.py: Equations of single numbers, compiled in float64 and in float32, and printed
 * as C. */

/* Held above low. */
static float at_least(float x, float low)
{
    return (x < low) ? low : x;
}

/* Held below high. */
static float at_most(float x, float high)
{
    return (x < high) ? x : high;
}

/* Held within low..high. */
static float clip(float x, float low, float high)
{
    return (x < low) ? low : ((x > high) ? high : x);
}

/* How far a number is outside of low..high, 0 within. */
static float distance_beyond(float x, float low, float high)
{
    return at_least(at_least(low - x, x - high), 0.0f);
}

/* What an exponential adds to 1, to its third order: an embedded target has no other. */
static float exponential_rise(float x)
{
    return x * (1.0f + (x * (0.5f + (x * (1.0f / 6.0f)))));
}

/* Factor on a resistance whose voltage follows asinh, asinh(y) / y, 1 at small currents. y is
 * its resistance times the current over that voltage. As a fraction that is within 0.05 % of it
 * up to y = 60, because an embedded target has no logarithm whose bits are the same everywhere. */
static float charge_transfer(float overvoltage)
{
    const float y = magnitude(overvoltage);
    const float above = 1.0f + (y * (0x1.52cbf6p-1f + (y * (0x1.af8c1ap-2f + (y * 0.01126451f)))));
    const float below = 0x1.52cbf6p-1f +
        (y * (0x1.2f92eap-1f + (y * (0x1.e9c80ep-4f + (y * 0.00170013f)))));
    return above / (1.0f + (y * below));
}

/* ---- evidence.py: How much a voltage weighs: its variance, the memory of the model's error,
 * what stays of it. */

/* The voltage over SOC as a straight line between two points, and how far it is off between. */
typedef struct {
    float slope_V;
    float bend_V;
} cellwise_chord;

/* From the OCV and R0 at two SOCs `1 / per` apart, seen from `away` above the lower one. A
 * far-off start must not be corrected with the slope of the spot where it happens to stand, nor
 * be thought of as right afterwards when the OCV is no straight line: the bend is the distance
 * from the OCV there to the chord. A SOC that is far off brings the resistances of another SOC
 * with it, so R0's slope joins the OCV's. */
static void chord_of(float low_V, float low_ohm, float high_V, float high_ohm, float per,
                     float current_A, float away, float ocv_V, cellwise_chord *chord)
{
    const float rise_V = (high_V - low_V) * per;
    chord->slope_V = rise_V - (((high_ohm - low_ohm) * per) * current_A);
    chord->bend_V = (low_V - ocv_V) + (rise_V * away);
}

/* What two branches have in common because a SOC that is off drives both. Each by the slope of
 * its resistance; `with1` and `with2` are their covariances with the SOC. */
static float covariance_by_soc(float drive1, float drive2, float with1, float with2, float variance)
{
    return ((drive1 * with2) + (drive2 * with1)) + ((drive1 * drive2) * variance);
}

/* Of a voltage that bends by c at one deviation of SOC: off its tangent by c z^2, 3 c^2. */
static float bent_variance(float variance_V2, float bend_V)
{
    return variance_V2 + (3.0f * (bend_V * bend_V));
}

/* Mean square of a current that is not known, as a branch sees it [A^2]. A resistance that is
 * off by a share drives its branch like a current that is off by it, and so does a current that
 * nobody measured. */
static float unknown_square(float share_variance, float current_A, float lost_A2)
{
    return (share_variance * (current_A * current_A)) + lost_A2;
}

/* Of one voltage, by the sensor and the model's error at this SOC [V^2]. A SOC scale that is off
 * matters where the OCV is steep. */
static float error_variance(float fixed_V2, float error_V, float ocv_soc2, float slope_V)
{
    return (fixed_V2 + (error_V * error_V)) + (ocv_soc2 * (slope_V * slope_V));
}

/* Of one measured voltage about a perfect state [V^2]. Beside sensor and model, resistances that
 * are off by a share (of what the ohmic drop and the branches hold, `held_V` in absolute values)
 * and a current that is not known. */
static float voltage_variance(float error_V2, float share_variance, float held_V, float current_A2,
                              float r0_ohm)
{
    return error_V2 + ((share_variance * (held_V * held_V)) + (current_A2 * (r0_ohm * r0_ohm)));
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

/* Running mean of the squared innovation, in units of its variance or of `most` of them. A model
 * of another temperature, age or cell is wrong all the time: evidence weighs less by what the
 * innovations have lately shown beyond their variance. One counts for `most`. */
static float lately_shown(float mean, float square, float most, float lately)
{
    return mean + (lately * (at_most(square, most) - mean));
}

/* How many samples share one model error: `above / below`, never divided. */
typedef struct {
    float above;
    float below;
} cellwise_shared;

/* How many samples share one model error, `since` the first one: at least 1. An error of memory
 * tau counts once in 2 tau (its spectral density at rest), so many `samples`. It is a sum of
 * processes with memories of a second to half an hour: the quick ones average out first, so the
 * rest of a mean has an ever longer memory. Just after the first it is `early / half`, and half
 * way between after `half`. Evidence that stands `alone` (the first voltage at rest) shares
 * nothing. A repeated sample has no `period`: over zero. */
static void shared_evidence(float samples, float early, float half, float since, float period,
                            bool alone, cellwise_shared *shared)
{
    shared->below = (since + half) * period;
    shared->above = shared->below;
    if (!alone) {
        shared->above = (samples * since) + early;
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

/* SOC error brought in by a persistent model error, after an update with a gain of the SOC. No
 * further voltage averages such an error out: with every voltage the SOC goes where the error
 * leads, error over slope in the end. Beside P, which takes each memory of the error for new, it
 * makes up the stated variance (consider covariance; Schmidt 1966, p. 293). Where the SOC hangs
 * on a branch its gain can be negative, and what the branch takes of the error holds the two
 * back; it is not followed here, so nothing is amplified. */
static float persistent_step(float gain, float slope_V, float persistent, float error_V)
{
    const float kept = clip(1.0f - (gain * slope_V), 0.0f, 1.0f);
    return (kept * persistent) + (gain * error_V);
}

/* Running mean of the SOC that the voltages say is missing, as far as the count may be off. A
 * known start and a small P leave a voltage little weight, and rightly so while the current is
 * right: what innovations show is the model's error then. They show the same where the counted
 * charge drifts. Were the current off, the count would by now be off by `drift`, and of an
 * innovation drift^2 slope^2 of drift^2 slope^2 + `error_V2` would be the count's. No SOC is off
 * by more than 1. */
static float contradicted_step(float contradicted, float innovation_V, float slope_V,
                               float error_V2, float drift, float lately)
{
    const float off = at_most(drift, 1.0f);
    const float swing_V = (off * off) * slope_V;
    const float missing = (swing_V * innovation_V) / ((swing_V * slope_V) + error_V2);
    return contradicted + (lately * (clip(missing, -1.0f, 1.0f) - contradicted));
}

/* Variance of the SOC: P's, a persistent error's, and what voltages contradict. P trusted the
 * errors as stated. Where innovations show `mismatch` times as much, so much more may be wrong
 * with the SOC (Birge 1932, doi:10.1103/PhysRev.40.207). */
static float stated_variance(float known, float mismatch, float persistent, float contradicted)
{
    const float beside = (persistent * persistent) + (contradicted * contradicted);
    return as_shown(known, mismatch) + beside;
}

/* ---- sensors.py: Which readings a sensor cannot have meant, and how far a SOC is off that
 * nobody counted. */

/* How often the voltage has gone up and down under a current that repeats itself. A constant
 * current moves a voltage one way. Where it goes both ways by as much as would call a voltage
 * frozen, nobody measures the current. The sign is that of the last move. */
static float swings_after(float swings, float moved_V, float frozen_V)
{
    const float count = at_most(magnitude(swings) + 1.0f, SWINGS_MOST);
    float after = swings;
    if ((magnitude(moved_V) > frozen_V) && !((swings * moved_V) > 0.0f)) {
        after = (moved_V > 0.0f) ? count : -count;
    }
    return after;
}

/* Whether a current that repeats itself is not measured at all. */
static bool is_dead(float swings)
{
    return magnitude(swings) >= DEAD_SWINGS;
}

/* Whether a voltage that repeats itself, but for its last digits, must have moved. R0 times the
 * change of current says so, and the prediction is off by half of that: a held voltage (the end
 * of a charge) repeats itself, too, but the model expects it there. */
static bool is_frozen(float change_A, float r0_ohm, float innovation_V, float frozen_V)
{
    const float moved_V = magnitude(r0_ohm * change_A);
    return (moved_V > frozen_V) && (magnitude(innovation_V) > (0.5f * moved_V));
}

/* SOC's variance of what may have flowed unseen over a gap. The currents on either side, or half
 * a rate, for as long as it lasts (`per_A` is the SOC that one ampere moves in it), and no more
 * than `gap_variance`. */
static float unseen_variance(float gap_variance, float gap_A2, float lost_A2, float per_A)
{
    return at_most((per_A * per_A) * at_least(gap_A2, lost_A2), gap_variance);
}

/* SOC's variance after an interval of which nobody knows the current. It may keep one sign for
 * as long as it is away: the deviation grows, not the variance. */
static float drifted_variance(float variance, float moved)
{
    const float deviation = root(variance) + moved;
    return deviation * deviation;
}

/* ---- start.py: What the branches of a cell may hold that nobody has seen before. */

/* What may have flowed before a start: its mean, how far it may be off, the most it leaves. */
typedef struct {
    float flow_A;
    float spread_A;
    float limit_V;
} cellwise_before;

/* Nearly nothing at rest, half of the load under load. */
static void flow_before(float current_A, float rest_A, float start_rest_A, float start_load_A,
                        cellwise_before *before)
{
    before->flow_A = 0.0f;
    before->spread_A = start_rest_A;
    before->limit_V = REST_LIMIT_V;
    if (!(magnitude(current_A) < rest_A)) {
        before->flow_A = START_LOAD_SHARE * current_A;
        before->spread_A = at_least(magnitude(before->flow_A), start_load_A);
        before->limit_V = NO_LIMIT_V;
    }
}

/* Variance of a branch that holds anything up to what a current leaves there; 0 without it. */
static float held_variance(float rested_V2, float r_ohm, float most_A, float limit_V)
{
    float variance_V2 = 0.0f;
    if (r_ohm > 0.0f) {
        const float held_V = at_most(most_A * r_ohm, limit_V);
        variance_V2 = rested_V2 + (held_V * held_V);
    }
    return variance_V2;
}

/* ---- components.py: Components over the SOC: where they lie, what speaks against them, what
 * was before them. */

/* SOC between two components: `t` from -1 to 1 goes from 0 to 1, densely about the start. */
static float edge(float t, float soc, float std)
{
    float room = soc;
    if (t > 0.0f) {
        room = 1.0f - soc;
    }
    const float near = at_most(DENSE * std, room);
    const float size = magnitude(t);
    const float away = size * (near + ((room - near) * (size * size)));
    float at = soc - away;
    if (t > 0.0f) {
        at = soc + away;
    }
    return at;
}

/* What speaks against a component `away` from a stated start, and of a `width` in SOC. How sure
 * a stated start is, is itself not sure: Student's t of TAIL degrees of freedom. */
static float start_cost(float away, float variance, float width)
{
    const float off = (away * away) / (TAIL * variance);
    return ((0.5f * (TAIL + 1.0f)) * log_of_more(off)) + log_of_more((1.0f / width) - 1.0f);
}

/* How much of a voltage's evidence is new, where a part p of the model's error stays for good.
 * Of a mean over t the variance is ((1 - p) 2 tau / t + p) times an error's: what it says never
 * exceeds one error over p, however long it is taken. `shared` is 2 tau, `fades` (1 - p) of
 * that, `stays` is p. */
static float evidence_share(float fades, float stays, float shared, float since)
{
    const float left = fades + (stays * since);
    return at_most((fades * shared) / (left * left), 1.0f);
}

/* What the gate lets pass of an innovation, and how the rest `grows` what it says. */
typedef struct {
    float off_V;
    float grows;
} cellwise_passed;

/* An innovation as a component takes it: as far as the gate. Beyond that it speaks against a
 * component in proportion to how far it is off (Huber): below empty the lowest of them is the
 * nearest. */
static void let_pass(float innovation_V, float variance_V2, float gate_square,
                     cellwise_passed *passed)
{
    const float most = gate_square * variance_V2;
    const float square = innovation_V * innovation_V;
    passed->off_V = innovation_V;
    passed->grows = 1.0f;
    if (square > most) {
        const float share = at_least(root(most / square), LEAST_PASSED);
        passed->off_V = innovation_V * share;
        passed->grows = (2.0f / share) - 1.0f;
    }
}

/* What a voltage says against a component: minus the logarithm of its likelihood. It counts as
 * often as it moves the state: samples that share one error of the model are one. */
static float cost_of_voltage(float share, float off_V, float grows, float inverse,
                             float explained_V2, float weight_V2)
{
    const float against = (grows * ((off_V * off_V) * inverse)) +
        log_of_more(explained_V2 / weight_V2);
    return share * (0.5f * against);
}

/* What the slow branch holds of a load before the start: mean, and variance of it. */
typedef struct {
    float held_V;
    float variance_V2;
} cellwise_past;

/* When of `before_V` the share `gone` has gone, under a load of `mean_A` since. Half of what it
 * has left, and what `past_A` would have, may be otherwise. */
static void past_of(float r_ohm, float gone, float mean_A, float before_V, float past_A,
                    cellwise_past *past)
{
    const float left = 1.0f - gone;
    past->held_V = (gone * (r_ohm * mean_A)) + (left * before_V);
    const float spread_V = left * ((PAST_SPREAD * magnitude(before_V)) + (r_ohm * past_A));
    past->variance_V2 = (spread_V * spread_V) + LEAST_PAST_V2;
}

/* What the slow branch's past says against a component. */
static float cost_of_past(float off_V, float variance_V2)
{
    const float against = ((off_V * off_V) / variance_V2) +
        log_of_more(variance_V2 / LEAST_PAST_V2);
    return 0.5f * against;
}

/* ---- lookup.py: Tables of the fixed step at one SOC, temperature and current. */

/* Where a temperature lies between two tables, and what it does to every resistance. `lag` is
 * the SOC that the particles' surface is below the mean. */
typedef struct {
    uint32_t low;
    float weight;
    float scale;
    float lag;
} cellwise_place;

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

/* Slopes over SOC, while it is badly known: of the voltage, the OCV's bend, of the branches.
 * `spread` is the standard deviation of SOC, 0 while it is well known. */
typedef struct {
    float slope_V;
    float bend_V;
    float spread;
    float rise1;
    float rise2;
    float rise3;
} cellwise_slopes;

/* Neighbouring tables of a temperature, and the Arrhenius factor. */
static void place_of(const cellwise_model *m, float temperature_C, cellwise_place *place)
{
    place->low = 0u;
    place->weight = 0.0f;
    place->scale = 1.0f;
    while ((place->low < (CELLWISE_TEMPERATURES - 2u)) &&
           (temperature_C > m->constant.grid_C[place->low + 1u])) {
        place->low = place->low + 1u;
    }
    place->weight = (temperature_C - m->constant.grid_C[place->low]) *
        m->constant.per_K[place->low];
    place->weight = clip(place->weight, 0.0f, 1.0f);
    const float most = (float)(CELLWISE_ARRHENIUS - 1u);
    float y = (temperature_C - m->constant.arrhenius_low_C) * m->constant.arrhenius_per_K;
    y = clip(y, 0.0f, most);
    uint32_t k = (uint32_t)y;
    if (k > (CELLWISE_ARRHENIUS - 3u)) {
        k = CELLWISE_ARRHENIUS - 3u;
    }
    /* The parabola through three neighbouring points: an exponential bends too much for a line. */
    const float f = y - (float)k;
    const float start = m->constant.arrhenius[k];
    const float first = m->constant.arrhenius[k + 1u] - start;
    const float second = m->constant.arrhenius[k + 2u] - m->constant.arrhenius[k + 1u];
    place->scale = start + (f * (first + ((0.5f * (f - 1.0f)) * (second - first))));
    place->lag = 0.0f;
}

/* The nearer end of 0..1 for a SOC beyond it. */
static float within_one(float soc)
{
    return NOT_NEGATIVE(soc, 1.0f) ? soc : ((soc < 0.5f) ? 0.0f : 1.0f);
}

/* SOC that the particles' surface is below the mean at 1 A and one temperature. */
static float depth_at(const cellwise_constants *c, float temperature_C)
{
    const float most = (float)(CELLWISE_DEPTH - 1u);
    float y = (temperature_C - c->depth_low_C) * c->depth_per_K;
    y = clip(y, 0.0f, most);
    uint32_t k = (uint32_t)y;
    if (k > (CELLWISE_DEPTH - 2u)) {
        k = CELLWISE_DEPTH - 2u;
    }
    const float f = KNOWN_FRACTION(y - (float)k);
    return between(c->depth[k], c->depth[k + 1u], f);
}

/* The same place with the lag of the particles' surface. */
static void under_surface(const cellwise_constants *c, const cellwise_state *x,
                          const cellwise_place *at, float temperature_C, cellwise_place *place)
{
    const float depth = depth_at(c, temperature_C);
    place->lag = clip(depth * x->slow_A, -1.0f, 1.0f);
    place->low = at->low;
    place->weight = at->weight;
    place->scale = at->scale;
}

/* The same place with the resistances that a history gives. */
static void aged(const cellwise_state *x, const cellwise_place *at, cellwise_place *place)
{
    place->low = at->low;
    place->weight = at->weight;
    place->scale = at->scale * x->resistance_scale;
    place->lag = at->lag;
}

/* Temperature of the cell: what was measured last, and its own warming. */
static float warmth_of(const cellwise_state *x)
{
    float warm_C = x->temperature_C;
    warm_C = warm_C + x->heat_K;
    return warm_C;
}

/* Where the cell's temperature lies between the tables. */
static void place_now(const cellwise_model *m, const cellwise_state *x, cellwise_place *place)
{
    const float warm_C = warmth_of(x);
    cellwise_place here;
    place_of(m, warm_C, &here);
    under_surface(&m->constant, x, &here, warm_C, &here);
    aged(x, &here, &here);
    place->low = here.low;
    place->weight = here.weight;
    place->scale = here.scale;
    place->lag = here.lag;
}

/* Lower point of the SOC interval that holds x, a SOC in units of the grid. */
static uint32_t index_of(float x, uint32_t points)
{
    const float held = (x > 0.0f) ? x : 0.0f;
    const uint32_t k = (held < (float)(points - 2u)) ? (uint32_t)held : (points - 2u);
    return k;
}

/* Outside 0..1 the OCV goes on along its last segment, every other table stays at its end.
 * Without CELLWISE_WIDE the OCV stays, too. With CELLWISE_SURFACE resistances and gains are
 * those of the particles' surface. */
static void look_up(const cellwise_model *m, const cellwise_place *place, float soc, float current,
                    cellwise_point *point)
{
    const cellwise_row *const low = m->row[place->low];
    const cellwise_row *const high = m->row[place->low + 1u];
    const uint32_t points = CELLWISE_POINTS;
    const float x = soc * (float)(points - 1u);
    const uint32_t k = index_of(x, points);
    float f = x - (float)k;
    f = clip(f, -(BEYOND * (float)(points - 1u)), 1.0f + (BEYOND * (float)(points - 1u)));
    const float g = clip(f, 0.0f, 1.0f);
    point->ocv_V = READ(k, ocv_V, f);
    point->slope_V = RISE(k, ocv_V) * (float)(points - 1u);
    const float error_V = READ(k, error_V, g);
    point->noise_V2 =
        error_variance(m->constant.fixed_V2, error_V, m->constant.ocv_soc2, point->slope_V);
    uint32_t at = k;
    float share = g;
    const float below = within_one(soc - place->lag) * (float)(points - 1u);
    at = index_of(below, points);
    share = KNOWN_FRACTION(below - (float)at);
    point->r0_ohm = READ(at, r0_ohm, share);
    point->r1_ohm = READ(at, r1_ohm, share);
    point->gain1 = 1.0f / READ(at, lag1, share);
    point->r2_ohm = READ(at, r2_ohm, share);
    point->gain2 = 1.0f / READ(at, lag2, share);
    point->r3_ohm = READ(at, r3_ohm, share);
    point->gain3 = 1.0f / READ(at, lag3, share);
    point->m_V = READ(k, m_V, g);
    float scale = place->scale;
    if (current < 0.0f) {
        scale = scale * m->constant.charge_scale;
    }
    point->r3_ohm = point->r3_ohm * scale;
    const float fall = 1.0f + (m->constant.rate_per_A * magnitude(current));
    scale = scale / clip(fall, LEAST_FALL, LARGE);
    point->r0_ohm = point->r0_ohm * scale;
    point->r1_ohm = point->r1_ohm * scale;
    point->r2_ohm = point->r2_ohm * scale;
    const float overvoltage = (m->constant.asinh_per_V * point->r1_ohm) * magnitude(current);
    point->r1_ohm = point->r1_ohm * KNOWN_FRACTION(charge_transfer(at_most(overvoltage, LARGE)));
}

/* SOC is well known: the OCV's tangent, and nothing else. */
static void no_slopes(const cellwise_point *p, cellwise_slopes *slopes)
{
    slopes->slope_V = p->slope_V;
    slopes->bend_V = 0.0f;
    slopes->spread = 0.0f;
    slopes->rise1 = 0.0f;
    slopes->rise2 = 0.0f;
    slopes->rise3 = 0.0f;
}

/* While SOC is badly known slopes are chords over one standard deviation to either side. */
static NOINLINE void slopes_of(const cellwise_model *m, const cellwise_place *place, float soc,
                               float spread, float current, const cellwise_point *p,
    cellwise_slopes *slopes)
{
    const float low = clip(soc - spread, 0.0f, 1.0f);
    const float high = clip(soc + spread, 0.0f, 1.0f);
    slopes->slope_V = p->slope_V;
    slopes->bend_V = 0.0f;
    slopes->rise1 = 0.0f;
    slopes->rise2 = 0.0f;
    slopes->rise3 = 0.0f;
    if ((high - low) >= SHORTEST_CHORD) {
        const float per = 1.0f / (high - low);
        cellwise_point end;
        look_up(m, place, low, current, &end);
        const float ocv = end.ocv_V;
        const float ohmic = end.r0_ohm;
        slopes->rise1 = end.r1_ohm;
        slopes->rise2 = end.r2_ohm;
        slopes->rise3 = end.r3_ohm;
        look_up(m, place, high, current, &end);
        slopes->rise1 = (end.r1_ohm - slopes->rise1) * per;
        slopes->rise2 = (end.r2_ohm - slopes->rise2) * per;
        slopes->rise3 = (end.r3_ohm - slopes->rise3) * per;
        cellwise_chord chord;
        chord_of(ocv, ohmic, end.ocv_V, end.r0_ohm, per, current, soc - low, p->ocv_V, &chord);
        slopes->slope_V = chord.slope_V;
        slopes->bend_V = chord.bend_V;
    }
    slopes->spread = spread;
}

/* ---- covariance.py: Covariance of the fixed step: what a step does to P and to the state
 * through it. */

/* P H', with H = [slope, -1, -1, -1, m], and the innovation variance it explains. */
typedef struct {
    float variance;
    float s;
    float v1;
    float v2;
    float v3;
    float h;
} cellwise_column;

/* A variance of SOC that is large changes by less than rounding keeps of it. */
static void add_variance(cellwise_state *x, float value)
{
    add(&x->ss, &x->ss_carry, value);
}

/* Every entry in its range. A variance of SOC is never 0: that is memory that was cleared. */
static bool covariance_is_sound(const cellwise_state *x)
{
    if (!POSITIVE_WITHIN(x->ss, VARIANCE_FLOOR, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->s1, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->s2, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->s3, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->sh, LARGE)) {
        return false;
    }
    if (!NOT_NEGATIVE(x->p11, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->p12, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->p13, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->p1h, LARGE)) {
        return false;
    }
    if (!NOT_NEGATIVE(x->p22, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->p23, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->p2h, LARGE)) {
        return false;
    }
    if (!NOT_NEGATIVE(x->p33, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->p3h, LARGE)) {
        return false;
    }
    if (!NOT_NEGATIVE(x->phh, LARGE)) {
        return false;
    }
    return true;
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

/* The branches over one interval of constant current, exactly, and their covariance. A current
 * that is not known to `square_A2` drives them too; 1 - a^2 keeps the stationary spread
 * independent of the time step. What decays slowly is stated by how much it loses: 1 - 1e-5 as a
 * float is off by 0.3 % of that. */
static void relax(cellwise_state *x, const cellwise_point *p, float gain1, float gain2,
                  float gain3, float flow, float square_A2)
{
    const float a1 = 1.0f - gain1;
    x->v1_V = x->v1_V + (gain1 * ((p->r1_ohm * flow) - x->v1_V));
    x->s1 = x->s1 - (gain1 * x->s1);
    x->p1h = x->p1h - (gain1 * x->p1h);
    x->p11 = x->p11 + ((gain1 * (1.0f + a1)) * ((square_A2 * (p->r1_ohm * p->r1_ohm)) - x->p11));
    const float a2 = 1.0f - gain2;
    x->v2_V = x->v2_V + (gain2 * ((p->r2_ohm * flow) - x->v2_V));
    x->s2 = x->s2 - (gain2 * x->s2);
    x->p2h = x->p2h - (gain2 * x->p2h);
    x->p22 = x->p22 + ((gain2 * (1.0f + a2)) * ((square_A2 * (p->r2_ohm * p->r2_ohm)) - x->p22));
    const float a3 = 1.0f - gain3;
    add(&x->v3_V, &x->v3_carry_V, gain3 * ((p->r3_ohm * flow) - x->v3_V));
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

/* Nothing is known of h. */
static void forget_hysteresis(cellwise_state *x)
{
    x->sh = 0.0f;
    x->p1h = 0.0f;
    x->p2h = 0.0f;
    x->p3h = 0.0f;
    x->phh = 1.0f;
}

/* A SOC that is off drives the branches by the resistances' slopes. */
static void tilt(cellwise_state *x, const cellwise_point *p, const cellwise_slopes *w, float flow)
{
    const float f1 = (w->rise1 * p->gain1) * flow;
    const float f2 = (w->rise2 * p->gain2) * flow;
    const float f3 = (w->rise3 * p->gain3) * flow;
    x->p11 = x->p11 + covariance_by_soc(f1, f1, x->s1, x->s1, x->ss);
    x->p12 = x->p12 + covariance_by_soc(f1, f2, x->s1, x->s2, x->ss);
    x->p13 = x->p13 + covariance_by_soc(f1, f3, x->s1, x->s3, x->ss);
    x->p22 = x->p22 + covariance_by_soc(f2, f2, x->s2, x->s2, x->ss);
    x->p23 = x->p23 + covariance_by_soc(f2, f3, x->s2, x->s3, x->ss);
    x->p33 = x->p33 + covariance_by_soc(f3, f3, x->s3, x->s3, x->ss);
    x->p1h = x->p1h + (f1 * x->sh);
    x->s1 = x->s1 + (f1 * x->ss);
    x->p2h = x->p2h + (f2 * x->sh);
    x->s2 = x->s2 + (f2 * x->ss);
    x->p3h = x->p3h + (f3 * x->sh);
    x->s3 = x->s3 + (f3 * x->ss);
}

/* The column, and the innovation variance that the state explains. */
static void column_of(const cellwise_state *x, const cellwise_point *p, float slope,
                      cellwise_column *column)
{
    column->s = slope * x->ss;
    column->s = column->s - x->s1;
    column->s = column->s - x->s2;
    column->s = column->s - x->s3;
    column->s = column->s + (p->m_V * x->sh);
    column->v1 = slope * x->s1;
    column->v1 = column->v1 - x->p11;
    column->v1 = column->v1 - x->p12;
    column->v1 = column->v1 - x->p13;
    column->v1 = column->v1 + (p->m_V * x->p1h);
    column->v2 = slope * x->s2;
    column->v2 = column->v2 - x->p12;
    column->v2 = column->v2 - x->p22;
    column->v2 = column->v2 - x->p23;
    column->v2 = column->v2 + (p->m_V * x->p2h);
    column->v3 = slope * x->s3;
    column->v3 = column->v3 - x->p13;
    column->v3 = column->v3 - x->p23;
    column->v3 = column->v3 - x->p33;
    column->v3 = column->v3 + (p->m_V * x->p3h);
    column->h = slope * x->sh;
    column->h = column->h - x->p1h;
    column->h = column->h - x->p2h;
    column->h = column->h - x->p3h;
    column->h = column->h + (p->m_V * x->phh);
    column->variance = slope * column->s;
    column->variance = column->variance - column->v1;
    column->variance = column->variance - column->v2;
    column->variance = column->variance - column->v3;
    column->variance = column->variance + (p->m_V * column->h);
    column->variance = (column->variance > 0.0f) ? column->variance : 0.0f;
}

/* The same where the slow branch itself is measured. */
static void column_of_slow_branch(const cellwise_state *x, cellwise_column *column)
{
    column->variance = 0.0f;
    column->s = x->s3;
    column->v1 = x->p13;
    column->v2 = x->p23;
    column->v3 = x->p33;
    column->h = x->p3h;
    column->variance = x->p33;
}

/* State + K innovation. */
static void move(cellwise_state *x, const cellwise_column *d, float inverse, float innovation)
{
    add(&x->soc, &x->soc_carry, (d->s * inverse) * innovation);
    x->v1_V = x->v1_V + ((d->v1 * inverse) * innovation);
    x->v2_V = x->v2_V + ((d->v2 * inverse) * innovation);
    add(&x->v3_V, &x->v3_carry_V, (d->v3 * inverse) * innovation);
    x->h = x->h + ((d->h * inverse) * innovation);
    x->h = clip(x->h, -1.0f, 1.0f);
}

/* P - K d', row by row. */
static void narrow(cellwise_state *x, const cellwise_column *d, float inverse)
{
    float k = d->s * inverse;
    add_variance(x, -(k * d->s));
    x->ss = clip(x->ss, VARIANCE_FLOOR, LARGE);
    x->s1 = x->s1 - (k * d->v1);
    x->s2 = x->s2 - (k * d->v2);
    x->s3 = x->s3 - (k * d->v3);
    x->sh = x->sh - (k * d->h);
    k = d->v1 * inverse;
    x->p11 = at_least(x->p11 - (k * d->v1), 0.0f);
    x->p12 = x->p12 - (k * d->v2);
    x->p13 = x->p13 - (k * d->v3);
    x->p1h = x->p1h - (k * d->h);
    k = d->v2 * inverse;
    x->p22 = at_least(x->p22 - (k * d->v2), 0.0f);
    x->p23 = x->p23 - (k * d->v3);
    x->p2h = x->p2h - (k * d->h);
    k = d->v3 * inverse;
    x->p33 = at_least(x->p33 - (k * d->v3), 0.0f);
    x->p3h = x->p3h - (k * d->h);
    k = d->h * inverse;
    x->phh = at_least(x->phh - (k * d->h), 0.0f);
}

/* ---- state.py: State of the fixed step: whether it is sound, where it starts, what an interval
 * does to it. */

/* Every number in its range: memory that lost its content, or was never set, is noticed. */
static bool is_sound(const cellwise_constants *c, const cellwise_state *x)
{
    (void)c;
    if (!NOT_NEGATIVE(x->soc, 1.0f)) {
        return false;
    }
    if (!SIZE_WITHIN(x->ss_carry, CARRY_MOST)) {
        return false;
    }
    if (!SIZE_WITHIN(x->soc_carry, CARRY_MOST)) {
        return false;
    }
    if (!SIZE_WITHIN(x->v3_carry_V, CARRY_MOST)) {
        return false;
    }
    if (!SIZE_WITHIN(x->v1_V, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->v2_V, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->v3_V, LARGE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->h, 1.0f)) {
        return false;
    }
    if (!(SIZE_WITHIN(x->current_A, LARGE) && NOT_NEGATIVE(x->mismatch, LARGE))) {
        return false;
    }
    if (!WITHIN(x->heat_K, -HEAT_MOST_K, HEAT_MOST_K)) {
        return false;
    }
    if (!SIZE_WITHIN(x->slow_A, LARGE)) {
        return false;
    }
    if (!WITHIN(x->temperature_C, COLDEST_C, HOTTEST_C)) {
        return false;
    }
    if (!(SIZE_WITHIN(x->contradicted, 1.0f) && SIZE_WITHIN(x->persistent, LARGE))) {
        return false;
    }
    if (!(SIZE_WITHIN(x->voltage_V, LARGE) && SIZE_WITHIN(x->frozen_A, LARGE))) {
        return false;
    }
    if (!SIZE_WITHIN(x->swings, SWINGS_MOST)) {
        return false;
    }
    if (!POSITIVE_WITHIN(x->per_capacity, 1.0f / MOST_SHARE, 1.0f / LEAST_SHARE)) {
        return false;
    }
    if (!POSITIVE_WITHIN(x->resistance_scale, LEAST_SCALE, MOST_SCALE)) {
        return false;
    }
    if (!SIZE_WITHIN(x->mean_V, LARGE)) {
        return false;
    }
    if (!(NOT_NEGATIVE(x->error_V2, LARGE) && (x->in_bank <= UNCOUNTED))) {
        return false;
    }
    return covariance_is_sound(x);
}

/* What a history says of the cell beside the model: its capacity, and all its resistances. Kept
 * in the state. Returns 0, or CELLWISE_OUT_OF_RANGE where nothing is taken: a share outside
 * 0.1..2, a scale outside 0.1..20, a state that is not sound. */
uint32_t cellwise_set_health(const cellwise_model *m, cellwise_state *x, float capacity_share,
                             float resistance_scale)
{
    uint32_t status = CELLWISE_OUT_OF_RANGE;
    const bool share = POSITIVE_WITHIN(capacity_share, LEAST_SHARE, MOST_SHARE);
    const bool scale = POSITIVE_WITHIN(resistance_scale, LEAST_SCALE, MOST_SCALE);
    if (share && scale && is_sound(&m->constant, x)) {
        x->per_capacity = 1.0f / capacity_share;
        x->resistance_scale = resistance_scale;
        status = 0u;
    }
    return status;
}

/* A cell at rest; its branches are guessed at the first sample. */
static NOINLINE void start(const cellwise_constants *c, cellwise_state *x, float soc,
                           float soc_variance)
{
    x->soc = soc;
    x->v1_V = 0.0f;
    x->v2_V = 0.0f;
    x->v3_V = 0.0f;
    x->soc_carry = 0.0f;
    x->v3_carry_V = 0.0f;
    x->h = (soc > 0.5f) ? 1.0f : -1.0f;
    start_covariance(x, soc_variance);
    x->current_A = 0.0f;
    x->mismatch = 1.0f;
    x->heat_K = 0.0f;
    x->slow_A = 0.0f;
    x->temperature_C = c->temperature_C;
    x->ss_carry = 0.0f;
    x->contradicted = 0.0f;
    x->persistent = 0.0f;
    x->voltage_V = 0.0f;
    x->frozen_A = 0.0f;
    x->repeats = 0u;
    x->swings = 0.0f;
    x->no_current = 0u;
    x->no_voltage = 0u;
    x->per_capacity = 1.0f;
    x->resistance_scale = 1.0f;
    x->cost = 0.0f;
    x->weight = 1.0f;
    x->error_V2 = 0.0f;
    x->in_bank = ALONE;
    x->mean_V = 0.0f;
    x->cells_at = 0u;
    x->turn = 0u;
    x->sequence = 0u;
    x->rejections = 0u;
    x->evidence = NOT_BEGUN;
}

/* What the branches hold when nobody knows what was before. */
static NOINLINE void guess_branches(const cellwise_constants *c, cellwise_state *x,
                                    const cellwise_point *p, float current)
{
    const float rested_V2 = c->branch_variance_V2;
    forget_correlations(x);
    cellwise_before before;
    flow_before(current, c->rest_A, c->start_rest_A, c->start_load_A, &before);
    x->v1_V = p->r1_ohm * before.flow_A;
    x->p11 = held_variance(rested_V2, p->r1_ohm, before.spread_A, before.limit_V);
    x->v2_V = p->r2_ohm * before.flow_A;
    x->p22 = held_variance(rested_V2, p->r2_ohm, before.spread_A, before.limit_V);
    x->v3_V = p->r3_ohm * before.flow_A;
    x->v3_carry_V = 0.0f;
    x->p33 = held_variance(rested_V2, p->r3_ohm, before.spread_A, before.limit_V);
    if ((x->in_bank == COMPONENT) && !SIZE_BELOW(current, c->rest_A)) {
        /* What flowed for hours no first sample shows; it is looked at once more is known. */
        const float wide_V = c->bank_A * p->r3_ohm;
        x->p33 = x->p33 + (wide_V * wide_V);
    }
}

/* After voltages that contradicted it for long the SOC is open, branches may hold anything.
 * Without CELLWISE_WIDE they are what they would be at a start. */
static void open_up(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                    float seen)
{
    (void)seen;
    x->ss = at_least(x->ss, RECOVERY_VARIANCE);
    forget_correlations(x);
    float kept = x->v1_V * x->v1_V;
    float held = held_variance(c->branch_variance_V2, p->r1_ohm, c->recovery_A, LOAD_LIMIT_V);
    x->p11 = held + kept;
    kept = x->v2_V * x->v2_V;
    held = held_variance(c->branch_variance_V2, p->r2_ohm, c->recovery_A, LOAD_LIMIT_V);
    x->p22 = held + kept;
    kept = x->v3_V * x->v3_V;
    held = held_variance(c->branch_variance_V2, p->r3_ohm, c->recovery_A, LOAD_LIMIT_V);
    x->p33 = held + kept;
}

/* Charge that leaves the cell in one step, in SOC. */
static float taken(const cellwise_constants *c, const cellwise_state *x, float current)
{
    float used = current;
    if (used < 0.0f) {
        used = used * c->charge_efficiency;
    }
    used = c->soc_per_A * used;
    used = used + c->leak_soc;
    used = used * x->per_capacity;
    return used;
}

/* Samples are missing: the branches may hold what the currents on both sides can have left. With
 * CELLWISE_WIDE they relax towards the mean of these currents, too. */
static void cross_gap(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                      uint32_t missing, float current, float bridge)
{
    const float unknown_A2 = (current * current) + (x->current_A * x->current_A);
    const float steps = (float)missing;
    float spread = c->gap_variance;
    const float moved = c->soc_per_A * steps;
    if (missing <= c->gap_steps) {
        spread = (moved * moved) * unknown_A2;
    } else {
        spread = unseen_variance(c->gap_variance, unknown_A2, c->lost_A2, moved);
    }
    x->ss = x->ss + spread;
    const float gain1 = risen(steps * p->gain1);
    const float gain2 = risen(steps * p->gain2);
    const float gain3 = risen(steps * p->gain3);
    relax(x, p, gain1, gain2, gain3, bridge, unknown_A2);
    forget_hysteresis(x);
    x->heat_K = x->heat_K * vanishing(steps * c->heat_rate);
}

/* One interval of constant current. */
static void predict(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                    const cellwise_slopes *w, float flow, float unmeasured_A2)
{
    const float share = (flow >= 0.0f) ? c->share_variance : c->charge_variance;
    const float square_A2 = unknown_square(share, flow, unmeasured_A2);
    relax(x, p, p->gain1, p->gain2, p->gain3, flow, square_A2);
    const float rise = risen(c->hysteresis_per_A * magnitude(flow));
    const float keep = 1.0f - rise;
    x->h = clip((keep * x->h) + ((flow < 0.0f) ? rise : -rise), -1.0f, 1.0f);
    fade_hysteresis(x, keep);
    if (w->spread > 0.0f) {
        tilt(x, p, w, flow);
    }
    if (POSITIVE_ABOVE(SOC_VARIANCE_MOST, x->ss)) {
        add_variance(x, c->soc_walk + (c->capacity_walk * magnitude(flow)));
    }
}

/* The cell's own warming over one interval. */
static void heat(const cellwise_constants *c, cellwise_state *x, float r0_ohm, float seen,
                 float flow)
{
    float fall = r0_ohm * seen;
    fall = fall + x->v1_V;
    fall = fall + x->v2_V;
    fall = fall + x->v3_V;
    const float change_K = c->heat_gain * ((c->heat_K_per_W * (flow * fall)) - x->heat_K);
    x->heat_K = clip(x->heat_K + change_K, -HEAT_MOST_K, HEAT_MOST_K);
}

/* ---- sensing.py: What a sample means to the fixed step: numbers missing, a current that is
 * held; the charge. */

/* A sample as the filter takes it. `news` says whether it ends an interval, `missing` how many
 * were left out, `silent` for how many steps there was no current that could be used. `current`
 * is the one that is held, `seen` what the voltage has seen of it, `flow` what flows without the
 * sensor's offset. */
typedef struct {
    uint32_t status;
    uint32_t news;
    uint32_t missing;
    uint32_t silent;
    float current;
    float seen;
    float flow;
    float unmeasured_A2;
    float temperature_C;
} cellwise_reading;

/* What an interval took: samples missing, and the current that bridges them. */
typedef struct {
    uint32_t status;
    uint32_t missing;
    float bridge;
} cellwise_charge;

/* Sequence number, current and temperature of a sample; the status `before` with theirs. */
static void see(const cellwise_constants *c, cellwise_state *x, const cellwise_input *sample,
                uint32_t before, cellwise_reading *reading)
{
    reading->status = before;
    reading->news = NO_INTERVAL;
    reading->missing = 0u;
    reading->silent = 0u;
    reading->current = sample->current_A;
    reading->unmeasured_A2 = 0.0f;
    /* The first sample ends no interval; a sequence number that was taken before ends none
     * either. */
    if (x->evidence != NOT_BEGUN) {
        const uint32_t elapsed = sample->sequence - x->sequence;
        if (elapsed == 0u) {
            reading->news = REPEATED;
            reading->status = reading->status | CELLWISE_DUPLICATE;
        } else {
            reading->news = INTERVAL;
            reading->missing = elapsed - 1u;
        }
    }
    if (!SIZE_WITHIN(reading->current, c->current_limit_A)) {
        reading->status = (reading->status | CELLWISE_CURRENT_INVALID) |
            out_of_range(reading->current);
        reading->silent = 1u;
    }
    if ((reading->silent != 0u) || (reading->news == REPEATED)) {
        reading->current = x->current_A;
    }
    if (!is_same(reading->current, x->current_A)) {
        x->swings = 0.0f;
    } else if (is_dead(x->swings)) {
        reading->status = reading->status | CELLWISE_CURRENT_INVALID;
        reading->silent = 1u;
    } else {
        /* as before */
    }
    reading->temperature_C = 0.0f;
    if (!WITHIN(sample->temperature_C, COLDEST_C, HOTTEST_C)) {
        reading->status = reading->status | CELLWISE_TEMPERATURE_INVALID;
    } else if (reading->news != REPEATED) {
        x->temperature_C = sample->temperature_C;
    } else {
        /* as before */
    }
    reading->temperature_C = x->temperature_C;
    reading->temperature_C = reading->temperature_C + x->heat_K;
    reading->seen = reading->current;
    if (reading->news == INTERVAL) {
        reading->seen = reading->current + (c->skew_share * (x->current_A - reading->current));
    }
    reading->flow = reading->seen;
    /* Held for a while; then whatever was held is no guide any more: nothing is counted, and as
     * much as half a rate may flow either way. */
    if ((reading->silent != 0u) || (reading->news == REPEATED)) {
        reading->silent = x->no_current;
        if ((reading->news == INTERVAL) && (reading->silent < COUNT_MOST)) {
            reading->silent = reading->silent + 1u;
        }
    }
    if (reading->silent > c->hold_steps) {
        reading->status = reading->status | CELLWISE_CURRENT_LOST;
        reading->seen = 0.0f;
        reading->flow = 0.0f;
        reading->unmeasured_A2 = c->lost_A2;
    }
}

/* SOC over the interval that ends now: charge comes first, then the branches at the new SOC. */
static void count_charge(const cellwise_constants *c, cellwise_state *x, const cellwise_reading *s,
                         cellwise_charge *charge)
{
    charge->status = s->status;
    charge->missing = s->missing;
    charge->bridge = 0.0f;
    if (s->news == INTERVAL) {
        float used = taken(c, x, s->flow);
        if (charge->missing != 0u) {
            charge->status = charge->status | CELLWISE_SEQUENCE_GAP;
            if (charge->missing <= c->gap_steps) {
                charge->bridge = 0.5f * (s->current + x->current_A);
                if (s->silent > c->hold_steps) {
                    charge->bridge = 0.0f;
                }
                used = used + (taken(c, x, charge->bridge) * (float)charge->missing);
            } else { /* nobody knows what flowed; self-discharge goes on */
                charge->missing = (charge->missing < LONGEST_GAP) ? charge->missing : LONGEST_GAP;
                if (x->in_bank == ALONE) {
                    x->in_bank = UNCOUNTED;
                }
                float lost = c->leak_soc * (float)charge->missing;
                lost = lost * x->per_capacity;
                used = used + lost;
            }
        }
        add(&x->soc, &x->soc_carry, -used);
        if (s->unmeasured_A2 > 0.0f) {
            x->ss = drifted_variance(x->ss, c->lost_soc);
            if (x->in_bank == ALONE) {
                x->in_bank = UNCOUNTED;
            }
        }
    }
}

/* Current that the particles' surface follows: over missing samples what bridges them. */
static void follow(const cellwise_constants *c, cellwise_state *x, const cellwise_reading *s,
                   const cellwise_charge *charge)
{
    if (charge->missing != 0u) {
        const float left = vanishing((float)charge->missing * c->surface_rate);
        x->slow_A = charge->bridge + (left * (x->slow_A - charge->bridge));
    }
    if (s->news == INTERVAL) {
        x->slow_A = x->slow_A + (c->surface_gain * (s->flow - x->slow_A));
    }
}

/* What is stated of the SOC beside P's variance `known`; LARGE where it is no number. */
static float variance_of(const cellwise_state *x, float known)
{
    const float stated = stated_variance(known, x->mismatch, x->persistent, x->contradicted);
    return NOT_NEGATIVE(stated, LARGE) ? stated : LARGE;
}

/* Hold SOC within its bounds, remember the sample: the status of the clamp. A variance that
 * memory which lost a bit has driven below zero is none: this step knows nothing, and the next
 * one re-initialises the state. */
static uint32_t finish(cellwise_state *x, const cellwise_reading *s, uint32_t missing,
                       uint32_t sequence, cellwise_output *out)
{
    uint32_t status = 0u;
    if (!NOT_NEGATIVE(x->soc, 1.0f)) {
        x->soc = within_one(x->soc);
        x->soc_carry = 0.0f;
        status = CELLWISE_CLAMPED;
    }
    if (s->news != REPEATED) {
        x->current_A = s->current;
        x->sequence = sequence;
        x->no_current = s->silent;
        if ((s->news == INTERVAL) && ((x->evidence - FIRST_VOLTAGE) < EVIDENCE_MOST)) {
            x->evidence = (x->evidence + 1u) + missing;
        }
    }
    out->soc = x->soc;
    out->soc_variance = NOT_NEGATIVE(x->ss, LARGE) ? x->ss : KNOW_NOTHING_VARIANCE;
    out->soc_variance = variance_of(x, out->soc_variance);
    return status;
}

/* ---- innovation.py: What a measured voltage means to the fixed step: prediction, weight, a SOC
 * searched for it. */

/* The voltage that the state gives at a point of the tables. */
static float voltage_of(const cellwise_state *x, const cellwise_point *p, float drop)
{
    float voltage = p->ocv_V - drop;
    voltage = voltage - x->v1_V;
    voltage = voltage - x->v2_V;
    voltage = voltage - x->v3_V;
    voltage = voltage + (p->m_V * x->h);
    return voltage;
}

/* What the state says of the next voltage, before it is looked at. `variance_V2` is that of a
 * single innovation, `explained_V2` what the state and `one_V2` what the voltage brings to it;
 * `polarisation_V` how much of the voltage is current's doing. */
typedef struct {
    float voltage_V;
    float variance_V2;
    float explained_V2;
    float one_V2;
    float polarisation_V;
    cellwise_column column;
} cellwise_innovation;

/* How often the voltage has gone up and down under a current that repeats itself. */
static void watch_current(const cellwise_constants *c, cellwise_state *x, float voltage)
{
    if (x->evidence >= FIRST_VOLTAGE) {
        x->swings = swings_after(x->swings, voltage - x->voltage_V, c->frozen_V);
    }
}

/* Whether the voltage is frozen. It stays so until it changes. */
static uint32_t watch_voltage(const cellwise_constants *c, cellwise_state *x, float voltage,
                              float seen, float r0_ohm, float innovation)
{
    uint32_t status = 0u;
    if (!SIZE_WITHIN(voltage - x->voltage_V, DITHER_V)) {
        x->voltage_V = voltage;
        x->frozen_A = seen;
        x->repeats = 0u;
    } else if (x->repeats == FROZEN) {
        status = CELLWISE_VOLTAGE_FROZEN;
    } else {
        const bool frozen = is_frozen(seen - x->frozen_A, r0_ohm, innovation, c->frozen_V);
        if (x->repeats < COUNT_MOST) {
            x->repeats = x->repeats + 1u;
        }
        if ((x->repeats >= FROZEN_READINGS) && frozen) {
            x->repeats = FROZEN;
            status = CELLWISE_VOLTAGE_FROZEN;
        }
    }
    return status;
}

/* Steps since the first voltage, or since a recovery. */
static float steps_of_evidence(const cellwise_state *x)
{
    uint32_t since = 0u;
    if (x->evidence >= FIRST_VOLTAGE) {
        since = x->evidence - FIRST_VOLTAGE;
        since = (since < EVIDENCE_MOST) ? since : EVIDENCE_MOST;
    }
    return (float)since;
}

/* How many samples share one model error; the first voltage at rest stands alone. */
static void shared_by(const cellwise_constants *c, const cellwise_state *x, float seen,
                      cellwise_shared *shared)
{
    const float since = steps_of_evidence(x);
    const bool alone = (x->evidence < FIRST_VOLTAGE) && SIZE_BELOW(seen, c->rest_A);
    shared_evidence(c->shared, c->shared_early, c->shared_half, since, 1.0f, alone, shared);
}

/* Whether SOC, current or temperature is beyond the model's data: CELLWISE_OUTSIDE, or 0. */
static uint32_t outside(const cellwise_constants *c, const cellwise_state *x,
                        const cellwise_reading *s)
{
    uint32_t status = 0u;
    if (!WITHIN(x->soc, c->valid_soc_low, c->valid_soc_high)) {
        status = CELLWISE_OUTSIDE;
    }
    if (!WITHIN(s->seen, c->valid_charge_A, c->valid_discharge_A)) {
        status = CELLWISE_OUTSIDE;
    }
    if (!WITHIN(x->temperature_C, c->valid_cold_C, c->valid_warm_C)) {
        status = CELLWISE_OUTSIDE;
    }
    return status;
}

/* What the model can be off by beyond its data's current and temperature, one deviation. The law
 * of the float64 filters: a share of the polarisation, as of an exponential to its third order;
 * what lies beyond in SOC is in the table of the error. */
static float extrapolated(const cellwise_constants *c, const cellwise_state *x, float seen,
                          float polarisation_V)
{
    float share = c->share_per_A * distance_beyond(seen, c->valid_charge_A, c->valid_discharge_A);
    float moved_V = 0.0f;
    const float far_K = distance_beyond(x->temperature_C, c->valid_cold_C, c->valid_warm_C);
    share = share + exponential_rise(c->share_per_K * far_K);
    moved_V = c->voltage_per_K * far_K;
    return (share * polarisation_V) + moved_V;
}

/* Predicted voltage, and the variances of what is measured about it. */
static void innovate(const cellwise_constants *c, const cellwise_state *x, const cellwise_point *p,
                     const cellwise_slopes *w, const cellwise_reading *s,
    cellwise_innovation *innovation)
{
    const float drop = p->r0_ohm * s->seen;
    innovation->polarisation_V = magnitude(drop);
    innovation->polarisation_V = innovation->polarisation_V + magnitude(x->v1_V);
    innovation->polarisation_V = innovation->polarisation_V + magnitude(x->v2_V);
    innovation->polarisation_V = innovation->polarisation_V + magnitude(x->v3_V);
    innovation->voltage_V = voltage_of(x, p, drop);
    const float share = (s->seen >= 0.0f) ? c->share_variance : c->charge_variance;
    const float current_A2 = c->current_variance_A2 + s->unmeasured_A2;
    innovation->one_V2 =
        voltage_variance(p->noise_V2, share, innovation->polarisation_V, current_A2, p->r0_ohm);
    const float beyond_V = extrapolated(c, x, s->seen, innovation->polarisation_V);
    innovation->one_V2 = innovation->one_V2 + (beyond_V * beyond_V);
    column_of(x, p, w->slope_V, &innovation->column);
    innovation->explained_V2 = bent_variance(innovation->column.variance, w->bend_V);
    innovation->variance_V2 = innovation->explained_V2 + innovation->one_V2;
}

/* ---- step.py: One fixed step: predict over the interval that ends now, then use the voltage
 * read now. */

/* A voltage beyond the gate, and what follows too long a time of them in a row. With
 * CELLWISE_BANK the state asks for a bank, which begins again over all of the SOC. */
static uint32_t reject(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                       float seen)
{
    uint32_t status = CELLWISE_INNOVATION_REJECTED;
    x->rejections = x->rejections + 1u;
    if (x->rejections >= c->recovery_after) {
        status = status | CELLWISE_GATE_RECOVERY;
        x->rejections = 0u;
        x->mismatch = 1.0f;
        x->contradicted = 0.0f;
        x->persistent = 0.0f;
        x->in_bank = CONTRADICTED;
        x->evidence = FIRST_VOLTAGE;
        open_up(c, x, p, seen);
    }
    return status;
}

/* What the voltages say against the count. Beyond the model's data they confirm nothing. */
static void contradict(const cellwise_constants *c, cellwise_state *x, const cellwise_slopes *w,
                       const cellwise_reading *s, float one_V2, float innovation)
{
    const float drift = c->drift_soc * (float)(x->evidence - FIRST_VOLTAGE);
    const float now =
        contradicted_step(x->contradicted, innovation, w->slope_V, one_V2, drift,
                          c->contradicted_share);
    if (SIZE_WITHIN(now, 1.0f)) { /* a number */
        uint32_t beyond = 0u;
        if (magnitude(now) < magnitude(x->contradicted)) {
            beyond = outside(c, x, s);
        }
        if (beyond == 0u) {
            x->contradicted = now;
        }
    }
}

/* SOC error by a persistent error of the model, after a voltage with a gain. */
static void persist(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                    float slope_V, float gain)
{
    const float error_V = persistent_V(c->persistent, p->noise_V2 - c->fixed_V2, x->mismatch);
    float now = persistent_step(gain, slope_V, x->persistent, error_V);
    if (!SIZE_WITHIN(now, 1.0f)) {
        now = 1.0f;
    }
    x->persistent = now;
}

/* State and covariance after a voltage within the gate. What the innovations have lately shown
 * beyond their variance makes evidence weigh less. A first sample under load says more of the
 * load than of the SOC. */
static void fuse(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                 const cellwise_slopes *w, const cellwise_reading *s, const cellwise_innovation *i,
    float innovation)
{
    cellwise_shared shared;
    shared_by(c, x, s->seen, &shared);
    const float weight = as_shown(i->one_V2 * shared.above, x->mismatch);
    if ((s->news == INTERVAL) || (shared.above <= shared.below)) {
        const float inverse = inverse_weight(i->explained_V2, weight, shared.below);
        move(x, &i->column, inverse, innovation);
        narrow(x, &i->column, inverse);
        persist(c, x, p, w->slope_V, i->column.s * inverse);
        if ((s->news == INTERVAL) && (x->evidence >= FIRST_VOLTAGE)) {
            contradict(c, x, w, s, i->one_V2, innovation);
        }
    }
    x->rejections = 0u;
    if (x->evidence < FIRST_VOLTAGE) {
        x->evidence = FIRST_VOLTAGE;
    }
}

/* A voltage to a component of a bank: none is rejected, each moves by what the gate lets pass.
 * The variance of a voltage is that of the likeliest component, for all: one whose tables state
 * a larger error must not explain everything. */
static void use_in_bank(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                        const cellwise_slopes *w, const cellwise_reading *s,
    const cellwise_innovation *i, float innovation)
{
    if (!(x->error_V2 > 0.0f)) {
        x->error_V2 = i->one_V2;
    }
    cellwise_shared shared;
    shared_by(c, x, s->seen, &shared);
    const float weight = as_shown(x->error_V2 * shared.above, x->mismatch);
    if ((s->news == INTERVAL) || (shared.above <= shared.below)) {
        cellwise_passed passed;
        let_pass(innovation, i->variance_V2, c->gate_square, &passed);
        const float inverse = inverse_weight(i->explained_V2, weight, shared.below);
        const float share = evidence_share(c->fades, c->stays, c->shared, steps_of_evidence(x));
        const float explained = i->explained_V2 * shared.below;
        const float cost =
            cost_of_voltage(share, passed.off_V, passed.grows, inverse, explained, weight);
        x->cost = x->cost + cost;
        move(x, &i->column, inverse, passed.off_V);
        narrow(x, &i->column, inverse);
        persist(c, x, p, w->slope_V, i->column.s * inverse);
    }
    if (x->evidence < FIRST_VOLTAGE) {
        x->evidence = FIRST_VOLTAGE;
    }
}

/* A voltage that is looked at: rejected, or used. */
static uint32_t weigh(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                      const cellwise_slopes *w, const cellwise_reading *s,
    const cellwise_innovation *i, float innovation)
{
    const float square = innovation * innovation;
    const float most = c->gate_square * i->variance_V2;
    uint32_t status = 0u;
    if (x->in_bank == COMPONENT) {
        use_in_bank(c, x, p, w, s, i, innovation);
    } else {
        if (s->news == INTERVAL) {
            const float ratio = square / i->variance_V2;
            x->mismatch = lately_shown(x->mismatch, ratio, c->mismatch_cap, c->lately);
        }
        if (POSITIVE_ABOVE(square, most)) {
            status = reject(c, x, p, s->seen);
        } else {
            fuse(c, x, p, w, s, i, innovation);
        }
    }
    return status;
}

/* Predicted voltage, innovation, and what follows from it. */
static uint32_t correct(const cellwise_constants *c, cellwise_state *x, const cellwise_point *p,
                        const cellwise_slopes *w, const cellwise_reading *s, float voltage,
    cellwise_output *out)
{
    uint32_t status = 0u;
    uint32_t away = x->no_voltage;
    if ((s->news == INTERVAL) && (away < COUNT_MOST)) {
        away = away + 1u;
    }
    cellwise_innovation i;
    innovate(c, x, p, w, s, &i);
    out->voltage_V = i.voltage_V;
    out->innovation_variance_V2 = i.variance_V2;
    out->innovation_V = 0.0f;
    if (!POSITIVE_WITHIN(voltage, c->voltage_low_V, c->voltage_high_V)) {
        status = CELLWISE_VOLTAGE_INVALID | out_of_range(voltage);
    } else {
        const float innovation = voltage - i.voltage_V;
        out->innovation_V = innovation;
        if (s->news != REPEATED) { /* a repeated sample is no evidence */
            watch_current(c, x, voltage);
            status = watch_voltage(c, x, voltage, s->seen, p->r0_ohm, innovation);
            if (status == 0u) {
                away = 0u;
            }
            if (status == 0u) {
                status = weigh(c, x, p, w, s, &i, innovation);
            }
        }
    }
    if (s->news != REPEATED) {
        x->no_voltage = away;
    }
    if (away > c->hold_steps) {
        status = status | CELLWISE_VOLTAGE_LOST;
    }
    return status;
}

/* As :func:`init`, for the estimate of a bank, too. */
static uint32_t begin_at(const cellwise_model *m, cellwise_state *x, float soc, float soc_variance)
{
    const float positive = soc + 0.0f; /* never -0 */
    uint32_t status = 0u;
    const bool known = POSITIVE_WITHIN(soc_variance, VARIANCE_FLOOR, SOC_VARIANCE_MOST);
    if (NOT_NEGATIVE(positive, 1.0f) && known) {
        start(&m->constant, x, positive, soc_variance);
    } else {
        start(&m->constant, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE);
        status = CELLWISE_STATE_RESET;
    }
    return status;
}

/* A cell at rest at `soc`, known with `soc_variance`. Arguments that are no such numbers give a
 * state that knows nothing. Returns 0 or CELLWISE_STATE_RESET. */
uint32_t cellwise_init(const cellwise_model *m, cellwise_state *x, float soc, float soc_variance)
{
    return begin_at(m, x, soc, soc_variance);
}

/* One time step: predict over the interval that ends now, then use the voltage read now. Returns
 * the status bits, which are in `out` too. */
uint32_t cellwise_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *sample,
                       cellwise_output *out)
{
    const cellwise_constants *const c = &m->constant;
    uint32_t status = 0u;
    if (!is_sound(c, x)) {
        start(c, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE);
        status = CELLWISE_STATE_RESET;
        x->in_bank = CONTRADICTED;
    }
    cellwise_reading s;
    see(c, x, sample, status, &s);
    cellwise_place place;
    place_of(m, s.temperature_C, &place);
    cellwise_charge charge;
    count_charge(c, x, &s, &charge);
    follow(c, x, &s, &charge);
    under_surface(c, x, &place, s.temperature_C, &place);
    aged(x, &place, &place);
    cellwise_point p;
    look_up(m, &place, x->soc, s.seen, &p);
    if (x->evidence == NOT_BEGUN) {
        guess_branches(c, x, &p, s.seen);
        x->evidence = NO_VOLTAGE_YET;
    }
    if (charge.missing != 0u) {
        cross_gap(c, x, &p, charge.missing, s.current, charge.bridge);
    }
    cellwise_slopes w;
    no_slopes(&p, &w);
    if (x->ss > WIDE_VARIANCE) {
        slopes_of(m, &place, x->soc, root(x->ss), s.seen, &p, &w);
    }
    if (s.news == INTERVAL) {
        predict(c, x, &p, &w, s.flow, s.unmeasured_A2);
        heat(c, x, p.r0_ohm, s.seen, s.flow);
    }
    const uint32_t beyond = outside(c, x, &s);
    status = charge.status | correct(c, x, &p, &w, &s, sample->voltage_V, out);
    status = status | finish(x, &s, charge.missing, sample->sequence, out);
    status = status | beyond;
    out->status = status;
    return status;
}

/* ---- bank.py: A start that nobody knows: filters side by side over the SOC, weighed by what
 * they predict. */

/* A component between two edges, else as the estimate `first` is. */
static void component_start(cellwise_state *a, cellwise_state *first, float low, float high)
{
    const float width = at_least(high - low, LEAST_WIDTH);
    const float soc = 0.5f * (low + high);
    const float away = soc - first->soc;
    a->cost = start_cost(away, first->ss, width);
    a->soc = soc;
    a->soc_carry = 0.0f;
    a->ss = (COMPONENT_WIDTH * width) * (COMPONENT_WIDTH * width);
    a->ss_carry = 0.0f;
    forget_correlations(a);
    if (a->evidence == NOT_BEGUN) {
        a->h = (soc > 0.5f) ? 1.0f : -1.0f;
    }
    a->in_bank = COMPONENT;
}

/* Weights that add up to one; the likeliest component costs nothing. */
static void weigh_components(cellwise_state *of, uint32_t count, float least)
{
    float total = 0.0f;
    for (uint32_t k = 0u; k < count; k++) {
        of[k + 1u].cost = of[k + 1u].cost - least;
        of[k + 1u].weight = vanishing(of[k + 1u].cost);
        if (of[k + 1u].cost > COST_MOST) {
            of[k + 1u].cost = LARGE;
            of[k + 1u].weight = 0.0f;
        }
        total = total + of[k + 1u].weight;
    }
    for (uint32_t k = 0u; k < count; k++) {
        of[k + 1u].weight = of[k + 1u].weight / total;
    }
}

/* Components over all of the SOC, densely about the estimate. */
static void spread_out(cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    const float std = root(of[0u].ss);
    const float apart = 2.0f / (float)count;
    float least = LARGE;
    for (uint32_t k = 0u; k < count; k++) {
        of[k + 1u] = of[0u];
        const float low = edge((apart * (float)k) - 1.0f, of[0u].soc, std);
        const float high = edge((apart * (float)(k + 1u)) - 1.0f, of[0u].soc, std);
        component_start(&of[k + 1u], &of[0u], low, high);
        if (of[k + 1u].cost < least) {
            least = of[k + 1u].cost;
            b->likeliest = k + 1u;
        }
    }
    of[0u].in_bank = ALONE;
    b->spread = 1u;
    b->mismatch = of[0u].mismatch;
    weigh_components(of, count, least);
}

/* SOC held within 0..1. */
static void hold_within(cellwise_state *a)
{
    if (!NOT_NEGATIVE(a->soc, 1.0f)) {
        a->soc = within_one(a->soc);
        a->soc_carry = 0.0f;
    }
}

/* The components' mean state, as a column. */
static void mean_of(const cellwise_state *of, uint32_t count, cellwise_column *column)
{
    column->s = 0.0f;
    column->v1 = 0.0f;
    column->v2 = 0.0f;
    column->v3 = 0.0f;
    column->h = 0.0f;
    for (uint32_t k = 0u; k < count; k++) {
        column->s = column->s + (of[k + 1u].weight * of[k + 1u].soc);
        column->v1 = column->v1 + (of[k + 1u].weight * of[k + 1u].v1_V);
        column->v2 = column->v2 + (of[k + 1u].weight * of[k + 1u].v2_V);
        column->v3 = column->v3 + (of[k + 1u].weight * of[k + 1u].v3_V);
        column->h = column->h + (of[k + 1u].weight * of[k + 1u].h);
    }
    column->variance = 0.0f;
}

/* A state at the mean, with no covariance yet. */
static void take_mean(cellwise_state *x, const cellwise_column *mean)
{
    x->soc = mean->s;
    x->v1_V = mean->v1;
    x->v2_V = mean->v2;
    x->v3_V = mean->v3;
    x->h = mean->h;
    x->soc_carry = 0.0f;
    x->v3_carry_V = 0.0f;
    x->ss = 0.0f;
    x->s1 = 0.0f;
    x->s2 = 0.0f;
    x->s3 = 0.0f;
    x->sh = 0.0f;
    x->p11 = 0.0f;
    x->p12 = 0.0f;
    x->p13 = 0.0f;
    x->p1h = 0.0f;
    x->p22 = 0.0f;
    x->p23 = 0.0f;
    x->p2h = 0.0f;
    x->p33 = 0.0f;
    x->p3h = 0.0f;
    x->phh = 0.0f;
    x->ss_carry = 0.0f;
    x->persistent = 0.0f;
    x->in_bank = ALONE;
}

/* What a component adds to the covariance of the state `x` at the mean. */
static void collect(cellwise_state *x, cellwise_state *a)
{
    const float aways = a->soc - x->soc;
    const float away1 = a->v1_V - x->v1_V;
    const float away2 = a->v2_V - x->v2_V;
    const float away3 = a->v3_V - x->v3_V;
    const float awayh = a->h - x->h;
    x->ss = x->ss + (a->weight * (a->ss + (aways * aways)));
    x->s1 = x->s1 + (a->weight * (a->s1 + (aways * away1)));
    x->s2 = x->s2 + (a->weight * (a->s2 + (aways * away2)));
    x->s3 = x->s3 + (a->weight * (a->s3 + (aways * away3)));
    x->sh = x->sh + (a->weight * (a->sh + (aways * awayh)));
    x->p11 = x->p11 + (a->weight * (a->p11 + (away1 * away1)));
    x->p12 = x->p12 + (a->weight * (a->p12 + (away1 * away2)));
    x->p13 = x->p13 + (a->weight * (a->p13 + (away1 * away3)));
    x->p1h = x->p1h + (a->weight * (a->p1h + (away1 * awayh)));
    x->p22 = x->p22 + (a->weight * (a->p22 + (away2 * away2)));
    x->p23 = x->p23 + (a->weight * (a->p23 + (away2 * away3)));
    x->p2h = x->p2h + (a->weight * (a->p2h + (away2 * awayh)));
    x->p33 = x->p33 + (a->weight * (a->p33 + (away3 * away3)));
    x->p3h = x->p3h + (a->weight * (a->p3h + (away3 * awayh)));
    x->phh = x->phh + (a->weight * (a->phh + (awayh * awayh)));
    x->persistent = x->persistent + (a->weight * a->persistent);
}

/* The estimate: mean and covariance of the whole bank; the rest is the likeliest one's. */
static void gather(cellwise_bank *b, cellwise_state *of, uint32_t count)
{
    cellwise_column mean;
    mean_of(of, count, &mean);
    of[0u] = of[b->likeliest];
    take_mean(&of[0u], &mean);
    hold_within(&of[0u]);
    for (uint32_t k = 0u; k < count; k++) {
        collect(&of[0u], &of[k + 1u]);
    }
    of[0u].mismatch = b->mismatch;
    if ((of[0u].ss <= WIDE_VARIANCE) && (b->looks == LOOKS)) {
        b->spread = 0u;
    }
}

/* What a load from full, or a charge from empty, has left in the slow branch at a SOC [V]. */
static NOINLINE float left_by_load(const cellwise_model *m, const cellwise_place *place,
                                   float mean_A, float soc)
{
    float before = 0.0f;
    const float size = at_least(magnitude(mean_A), m->constant.least_use_A);
    const float steps = PAST_PART / (m->constant.soc_per_A * size);
    float way = soc;
    if (mean_A >= 0.0f) {
        way = 1.0f - soc;
    }
    const uint32_t points = (uint32_t)((way / PAST_PART) + 0.5f);
    for (uint32_t k = 0u; k < points; k++) {
        const float moved = (float)(k + 1u) * PAST_PART;
        float at = moved;
        if (mean_A >= 0.0f) {
            at = 1.0f - moved;
        }
        cellwise_point p;
        look_up(m, place, at, mean_A, &p);
        const float end = p.r3_ohm * ((mean_A >= 0.0f) ? size : -size);
        before = before + (risen(steps * p.gain3) * (end - before));
    }
    return before;
}

/* A load under which a log begins was there before: what it has left in the slow branch. Half of
 * that, and a twentieth of a rate, may be otherwise. It is knowledge of the start that comes
 * late: the slow branch has been followed from nothing known. */
static NOINLINE void know_past(const cellwise_model *m, cellwise_state *a, float since,
                               float mean_A)
{
    cellwise_place place;
    place_now(m, a, &place);
    cellwise_point p;
    look_up(m, &place, a->soc, mean_A, &p);
    const float before = left_by_load(m, &place, mean_A, a->soc);
    const float gone = risen(since * p.gain3);
    cellwise_past past;
    past_of(p.r3_ohm, gone, mean_A, before, m->constant.past_A, &past);
    cellwise_column d;
    column_of_slow_branch(a, &d);
    const float variance = d.variance + past.variance_V2;
    const float off = past.held_V - a->v3_V;
    const float inverse = 1.0f / variance;
    a->cost = a->cost + cost_of_past(off, variance);
    move(a, &d, inverse, off);
    narrow(a, &d, inverse);
    hold_within(a);
}

/* A longer mean of the load says more of the past: what that moves in the slow branch. What has
 * been taken for the branch's and was not is the SOC's, as far as they go together. */
static NOINLINE void know_past_better(const cellwise_model *m, cellwise_state *a, float since,
                                      float mean_A, float before_A)
{
    cellwise_place place;
    place_now(m, a, &place);
    cellwise_point p;
    look_up(m, &place, a->soc, mean_A, &p);
    const float taken = left_by_load(m, &place, before_A, a->soc);
    const float more = left_by_load(m, &place, mean_A, a->soc) - taken;
    const float gone = risen(since * p.gain3);
    cellwise_past past;
    past_of(p.r3_ohm, gone, 0.0f, taken, m->constant.past_A, &past);
    cellwise_column d;
    column_of_slow_branch(a, &d);
    move(a, &d, 1.0f / at_least(d.variance, past.variance_V2), (1.0f - gone) * more);
}

/* The mean of the load since a start under load, and what it says of the past, three times. */
static void look_back(const cellwise_model *m, cellwise_bank *b, cellwise_state *of,
                      uint32_t count, const cellwise_input *sample)
{
    const cellwise_constants *const c = &m->constant;
    const uint32_t elapsed = sample->sequence - b->sequence;
    b->sequence = sample->sequence;
    if ((b->looks < LOOKS) && (elapsed == 1u)) {
        b->since = b->since + 1u;
        b->mean_A = b->mean_A + ((of[b->likeliest].current_A - b->mean_A) / (float)b->since);
        if (b->since >= b->next_look) {
            for (uint32_t k = 0u; k < count; k++) {
                if (of[k + 1u].cost < LARGE) {
                    if (b->looks == 0u) {
                        know_past(m, &of[k + 1u], (float)b->since, b->mean_A);
                    } else {
                        know_past_better(m, &of[k + 1u], (float)b->since, b->mean_A, b->looked_A);
                    }
                }
            }
            b->looked_A = b->mean_A;
            b->looks = b->looks + 1u;
            b->next_look = b->next_look * LOOK_FACTOR;
        }
    } else if (elapsed > 1u) { /* nobody knows what flowed */
        b->looks = LOOKS;
    } else {
        /* as before */
    }
    if (b->looks == NEVER_LOOKED) {
        b->looks = 0u;
        b->next_look = c->look_steps;
        if (SIZE_BELOW(of[b->likeliest].current_A, c->rest_A)) {
            b->looks = LOOKS;
        }
    }
}

/* Every component by its own step, the likeliest first: all share what it says of the noise. */
static uint32_t step_components(const cellwise_model *m, cellwise_bank *b, cellwise_state *of,
                                uint32_t count, const cellwise_input *sample, cellwise_output *out)
{
    const cellwise_constants *const c = &m->constant;
    float error_V2 = 0.0f;
    uint32_t status = 0u;
    float first_V = 0.0f;
    float mean_V = 0.0f;
    float square_V2 = 0.0f;
    float variance_V2 = 0.0f;
    for (uint32_t turn = 0u; turn < count; turn++) {
        uint32_t k = b->likeliest;
        if (turn > 0u) {
            k = (turn <= (b->likeliest - 1u)) ? turn : (turn + 1u);
        }
        if (of[k].cost < LARGE) {
            of[k].error_V2 = error_V2;
            of[k].mismatch = b->mismatch;
            const uint32_t said = cellwise_step(m, &of[k], sample, out);
            if (turn == 0u) {
                error_V2 = of[k].error_V2;
                status = said;
                first_V = out->voltage_V;
            }
            const float away_V = out->voltage_V - first_V;
            mean_V = mean_V + (of[k].weight * away_V);
            square_V2 = square_V2 + (of[k].weight * (away_V * away_V));
            variance_V2 = variance_V2 + (of[k].weight * out->innovation_variance_V2);
        }
    }
    out->voltage_V = first_V + mean_V;
    out->innovation_variance_V2 = variance_V2 + at_least(square_V2 - (mean_V * mean_V), 0.0f);
    out->innovation_V = 0.0f;
    if (POSITIVE_WITHIN(sample->voltage_V, c->voltage_low_V, c->voltage_high_V)) {
        out->innovation_V = sample->voltage_V - out->voltage_V;
        const float ratio = (out->innovation_V * out->innovation_V) / out->innovation_variance_V2;
        if (ratio > c->gate_square) {
            status = status | CELLWISE_INNOVATION_REJECTED;
        }
        b->mismatch = lately_shown(b->mismatch, ratio, c->mismatch_cap, c->lately);
    }
    return status;
}

/* The cost of the likeliest component. */
static float likeliest_of(cellwise_bank *b, const cellwise_state *of, uint32_t count)
{
    float least = of[b->likeliest].cost;
    for (uint32_t k = 0u; k < count; k++) {
        if (of[k + 1u].cost < least) {
            least = of[k + 1u].cost;
            b->likeliest = k + 1u;
        }
    }
    return least;
}

/* Whether nobody knows what flowed, one filter is not enough, and a voltage is there. */
static bool is_lost(const cellwise_state *x)
{
    bool lost = false;
    if ((x->in_bank == UNCOUNTED) && (x->evidence >= FIRST_VOLTAGE) && (x->no_voltage == 0u)) {
        lost = x->ss > SPREAD_VARIANCE;
    }
    return lost;
}

/* Every number of a bank in its range: memory that lost its content is noticed. */
static bool bank_is_sound(cellwise_bank *b, const cellwise_state *of, uint32_t count)
{
    bool good = WITHIN(b->mean_A, -LARGE, LARGE) && WITHIN(b->looked_A, -LARGE, LARGE);
    if (!NOT_NEGATIVE(b->mismatch, LARGE)) {
        good = false;
    }
    if ((b->likeliest < 1u) || (b->likeliest > count)) {
        good = false;
    }
    for (uint32_t k = 0u; k < count; k++) {
        if (!NOT_NEGATIVE(of[k + 1u].cost, LARGE) || !NOT_NEGATIVE(of[k + 1u].weight, 2.0f)) {
            good = false;
        }
        if ((of[k + 1u].cost < LARGE) && (of[k + 1u].in_bank != COMPONENT)) {
            good = false;
        }
    }
    return good;
}

/* A bank whose memory is damaged begins over all of the SOC. */
static uint32_t know_nothing(const cellwise_model *m, cellwise_bank *b, cellwise_state *of,
                             uint32_t count)
{
    start(&m->constant, &of[0u], KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE);
    b->likeliest = 1u;
    b->looks = LOOKS;
    b->mean_A = 0.0f;
    b->looked_A = 0.0f;
    if (count > 0u) {
        spread_out(b, of, count);
    } else {
        b->spread = 0u;
    }
    return CELLWISE_STATE_RESET;
}

/* A cell at rest at `soc`, known with `soc_variance`; `of` has count + 1 states. Arguments that
 * are no such numbers give a state that knows nothing. Returns 0 or CELLWISE_STATE_RESET. */
uint32_t cellwise_bank_init(const cellwise_model *m, cellwise_bank *b, cellwise_state *of,
                            uint32_t count, float soc, float soc_variance)
{
    const uint32_t status = begin_at(m, &of[0u], soc, soc_variance);
    b->spread = 0u;
    b->likeliest = 1u;
    b->looks = NEVER_LOOKED;
    b->since = 0u;
    b->next_look = 0u;
    b->sequence = 0u;
    b->mean_A = 0.0f;
    b->looked_A = 0.0f;
    b->mismatch = 1.0f;
    if ((count > 0u) && (of[0u].ss > WIDE_VARIANCE)) {
        spread_out(b, of, count);
    }
    return status;
}

/* One time step of a bank of `count` components; the estimate is in `of[0]`. Returns the status
 * bits, which are in `out` too. */
uint32_t cellwise_bank_step(const cellwise_model *m, cellwise_bank *b, cellwise_state *of,
                            uint32_t count, const cellwise_input *sample, cellwise_output *out)
{
    uint32_t status = 0u;
    uint32_t lost = 0u;
    if ((b->spread != 0u) && !bank_is_sound(b, of, count)) {
        lost = know_nothing(m, b, of, count);
    }
    if (b->spread == 0u) {
        of[0u].in_bank = ALONE;
        status = cellwise_step(m, &of[0u], sample, out);
        b->looks = LOOKS;
        if (((count > 0u) && (of[0u].in_bank == CONTRADICTED)) ||
            ((count > 0u) && is_lost(&of[0u]))) {
            spread_out(b, of, count);
        }
    } else {
        status = step_components(m, b, of, count, sample, out);
        look_back(m, b, of, count, sample);
        if (!bank_is_sound(b, of, count)) {
            lost = know_nothing(m, b, of, count);
        }
        if (of[b->likeliest].evidence < FIRST_VOLTAGE) { /* no voltage yet: as it was stated */
            status = cellwise_step(m, &of[0u], sample, out);
        } else {
            weigh_components(of, count, likeliest_of(b, of, count));
            gather(b, of, count);
        }
    }
    status = status | lost;
    out->soc = of[0u].soc;
    out->soc_variance = variance_of(&of[0u], of[0u].ss);
    out->status = status;
    return status;
}

/* ---- fixed_power.py: What a constant current makes of the cell; state of power: the largest
 * one over a horizon. */

/* A cell after a constant current: branches, voltage, variances of it. `variance_V2` is the
 * model's, `kept_V2` what remains of the branches' and of hysteresis. */
typedef struct {
    float voltage_V;
    float variance_V2;
    float kept_V2;
    float h;
    float slow_A;
    float v1;
    float v2;
    float v3;
} cellwise_along;

/* Power one way: the value, what is sustained with 95 %, the current of the value. */
typedef struct {
    float power_W;
    float low_W;
    float current_A;
} cellwise_way;

/* The cell's state, under no load yet. */
static void as_it_is(const cellwise_state *x, cellwise_along *along)
{
    along->v1 = x->v1_V;
    along->v2 = x->v2_V;
    along->v3 = x->v3_V;
    along->h = x->h;
    along->slow_A = x->slow_A;
    along->voltage_V = 0.0f;
    along->variance_V2 = 0.0f;
    along->kept_V2 = 0.0f;
}

/* The same place with another lag of the particles' surface. */
static void behind(const cellwise_place *at, float lag, cellwise_place *place)
{
    place->low = at->low;
    place->weight = at->weight;
    place->scale = at->scale;
    place->lag = lag;
}

/* A state of first order of which that share of its way to its end is left. */
static float toward(float old, float end, float left)
{
    return clip(end + (left * (old - end)), -LARGE, LARGE);
}

/* So many time steps of a constant current later, at a SOC, in one interval. The exponent of a
 * branch comes from its gain g over one time step, as g / (1 - g / 2). What the states share is
 * left out of the variance: it mostly takes away from it. */
static NOINLINE void go_on(const cellwise_model *m, const cellwise_place *place,
                           const cellwise_state *x, const cellwise_along *was, float soc,
    float current, float steps, cellwise_along *along)
{
    const cellwise_constants *const c = &m->constant;
    along->slow_A = was->slow_A;
    float lag = 0.0f;
    along->slow_A = toward(along->slow_A, current, 1.0f - risen(steps * c->surface_rate));
    const float depth = depth_at(c, warmth_of(x));
    lag = clip(depth * along->slow_A, -1.0f, 1.0f);
    cellwise_place here;
    behind(place, lag, &here);
    cellwise_point p;
    look_up(m, &here, soc, current, &p);
    const float drop = p.r0_ohm * current;
    float held_V = magnitude(drop);
    along->voltage_V = p.ocv_V - drop;
    along->kept_V2 = 0.0f;
    const float left1 = vanishing(steps * (p.gain1 / (1.0f - (0.5f * p.gain1))));
    along->v1 = toward(was->v1, p.r1_ohm * current, left1);
    held_V = held_V + magnitude(along->v1);
    along->voltage_V = along->voltage_V - along->v1;
    along->kept_V2 = along->kept_V2 + ((left1 * left1) * x->p11);
    const float left2 = vanishing(steps * (p.gain2 / (1.0f - (0.5f * p.gain2))));
    along->v2 = toward(was->v2, p.r2_ohm * current, left2);
    held_V = held_V + magnitude(along->v2);
    along->voltage_V = along->voltage_V - along->v2;
    along->kept_V2 = along->kept_V2 + ((left2 * left2) * x->p22);
    const float left3 = vanishing(steps * (p.gain3 / (1.0f - (0.5f * p.gain3))));
    along->v3 = toward(was->v3, p.r3_ohm * current, left3);
    held_V = held_V + magnitude(along->v3);
    along->voltage_V = along->voltage_V - along->v3;
    along->kept_V2 = along->kept_V2 + ((left3 * left3) * x->p33);
    along->h = was->h;
    const float keep = vanishing((c->hysteresis_per_A * magnitude(current)) * steps);
    along->h = toward(along->h, (current < 0.0f) ? 1.0f : -1.0f, keep);
    along->voltage_V = along->voltage_V + (p.m_V * along->h);
    const float spread_V = p.m_V * keep;
    along->kept_V2 = along->kept_V2 + ((spread_V * spread_V) * x->phh);
    const float share = (current >= 0.0f) ? c->share_variance : c->charge_variance;
    along->variance_V2 =
        voltage_variance(p.noise_V2, share, held_V, c->current_variance_A2, p.r0_ohm);
    const float beyond_V = extrapolated(c, x, current, held_V);
    along->variance_V2 = along->variance_V2 + (beyond_V * beyond_V);
    if (POSITIVE_ABOVE(x->mismatch, 1.0f)) {
        along->variance_V2 = along->variance_V2 * x->mismatch;
    }
    along->voltage_V = clip(along->voltage_V, -LARGE, LARGE);
}

/* A constant current over the horizon of the power, from `soc`. */
static NOINLINE void ending(const cellwise_model *m, const cellwise_place *place,
                            const cellwise_state *x, float soc, float current,
    cellwise_along *along)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_along now;
    as_it_is(x, &now);
    const float end = soc - (c->power_steps * taken(c, x, current));
    go_on(m, place, x, &now, end, current, c->power_steps, along);
}

/* Largest size of a current, discharged (`side` 1) or charged (-1), up to `most_A`. By false
 * position (Illinois) between none and `most_A`; 0 where no current keeps the limit. */
static NOINLINE float able(const cellwise_model *m, const cellwise_place *place,
                           const cellwise_state *x, float soc, float side, float limit_V,
    float most_A)
{
    float found = 0.0f;
    cellwise_along none;
    ending(m, place, x, soc, 0.0f, &none);
    float room = side * (none.voltage_V - limit_V);
    if ((room > 0.0f) && (most_A > 0.0f)) {
        float near = 0.0f;
        float far = most_A;
        cellwise_along full;
        ending(m, place, x, soc, side * most_A, &full);
        float lack = side * (limit_V - full.voltage_V);
        bool near_again = false;
        bool far_again = false;
        if (lack > 0.0f) {
            for (uint32_t k = 0u; k < POWER_TRIALS; k++) {
                const float share = clip(room / at_least(room + lack, LEAST_SPAN_V), 0.0f, 1.0f);
                const float middle = near + ((far - near) * share);
                cellwise_along there;
                ending(m, place, x, soc, side * middle, &there);
                const float left = side * (there.voltage_V - limit_V);
                if (left >= 0.0f) {
                    near = middle;
                    room = left;
                    if (near_again) {
                        lack = 0.5f * lack;
                    }
                    near_again = true;
                    far_again = false;
                } else {
                    far = middle;
                    lack = -left;
                    if (far_again) {
                        room = 0.5f * room;
                    }
                    far_again = true;
                    near_again = false;
                }
            }
        } else {
            near = most_A;
        }
        found = near;
    }
    return found;
}

/* Value and lower bound of one way: the bound keeps 1.645 deviations from the limits. `soc`, of
 * variance `ss`, is the cell's own. The slope over SOC is the chord to the SOC that is as many
 * deviations worse. */
static NOINLINE void one_way(const cellwise_model *m, const cellwise_place *place,
                             const cellwise_state *x, float soc, float ss, float side,
    float limit_V, float most_A, float room_soc, cellwise_way *way)
{
    const cellwise_constants *const c = &m->constant;
    float per_soc_A = 1.0f / (c->soc_per_A * c->power_steps);
    per_soc_A = per_soc_A / x->per_capacity;
    const float by_soc_A = at_least(room_soc * per_soc_A, 0.0f);
    way->current_A = able(m, place, x, soc, side, limit_V, (most_A < by_soc_A) ? most_A : by_soc_A);
    cellwise_along end;
    ending(m, place, x, soc, side * way->current_A, &end);
    const float shift = SUSTAINED * root(ss);
    cellwise_along worse;
    ending(m, place, x, soc - (side * shift), side * way->current_A, &worse);
    const float by_soc_V = end.voltage_V - worse.voltage_V;
    const float variance_V2 = end.variance_V2 + end.kept_V2;
    const float square = (by_soc_V * by_soc_V) + ((SUSTAINED * SUSTAINED) * variance_V2);
    const float off_V = root(at_most(square, SQUARE_MOST));
    const float low_soc_A = at_least((room_soc - shift) * per_soc_A, 0.0f);
    const float low_V = limit_V + (side * off_V);
    const float sure =
        able(m, place, x, soc, side, low_V, (most_A < low_soc_A) ? most_A : low_soc_A);
    cellwise_along last;
    ending(m, place, x, soc, side * sure, &last);
    way->power_W = at_least(way->current_A * end.voltage_V, 0.0f);
    way->low_W = at_least(sure * (last.voltage_V - off_V), 0.0f);
    if (way->low_W > way->power_W) {
        way->low_W = way->power_W;
    }
}

/* What the cell can give and take for the horizon that the tables hold; nothing is changed. The
 * largest constant currents that keep voltage, current and SOC within their limits to the end of
 * the horizon, times the voltage then. Zero throughout for a state that is not sound. */
void cellwise_power(const cellwise_model *m, const cellwise_state *x, cellwise_capability *out)
{
    const cellwise_constants *const c = &m->constant;
    out->discharge_W = 0.0f;
    out->discharge_low_W = 0.0f;
    out->charge_W = 0.0f;
    out->charge_low_W = 0.0f;
    if (is_sound(c, x)) {
        cellwise_place place;
        place_now(m, x, &place);
        float most_A = c->power_discharge_A;
        float room_soc = x->soc - c->power_soc_low;
        cellwise_way down;
        one_way(m, &place, x, x->soc, x->ss, 1.0f, c->power_low_V, most_A, room_soc, &down);
        most_A = c->power_charge_A;
        room_soc = c->power_soc_high - x->soc;
        cellwise_way up;
        one_way(m, &place, x, x->soc, x->ss, -1.0f, c->power_high_V, most_A, room_soc, &up);
        out->discharge_W = down.power_W;
        out->discharge_low_W = down.low_W;
        out->charge_W = up.power_W;
        out->charge_low_W = up.low_W;
    }
}

/* ---- fixed_remaining.py: A load carried on: time and energy to its cutoff or to empty, and
 * where a plan of loads ends. */

/* Where a plan ends; `failed_s` is when its voltage was at the cutoff or its charge gone. */
typedef struct {
    float soc;
    float least_V;
    float energy_J;
    float failed_s;
} cellwise_end;

/* Two deviations of the voltage by what the model is off by. */
static float off_by(const cellwise_along *at)
{
    return 2.0f * root(at_most(at->variance_V2, SQUARE_MOST));
}

/* Time until a voltage, taken as linear within a part, is at a cutoff; it ends there for good.
 * `least_V` is its lowest value so far. */
static NOINLINE float lasted(float so_far_s, float least_V, float after_V, float low_V,
                             float part_s)
{
    float share = 0.0f;
    if (least_V > low_V) {
        share = 1.0f;
        if (after_V <= low_V) {
            const float fall_V = at_least(least_V - after_V, LEAST_SPAN_V);
            share = clip((least_V - low_V) / fall_V, 0.0f, 1.0f);
        }
    }
    return clip(so_far_s + (share * part_s), 0.0f, LONGEST);
}

/* Root of the sum of three squares, each at least 0: by the largest of them. */
static NOINLINE float apart_by(float a, float b, float d)
{
    const float most = at_least(at_least(a, b), d);
    float found = 0.0f;
    if (most > 0.0f) {
        a = KNOWN_FRACTION(a / most);
        b = KNOWN_FRACTION(b / most);
        d = KNOWN_FRACTION(d / most);
        found = most * root(((a * a) + (b * b)) + (d * d));
    }
    return found;
}

/* Time and energy until a load reaches the cutoff, or the cell is empty; nothing is changed.
 * `load_A` is held, or with `holds_power` what it gives now. One below C/50 counts as that. The
 * SOC down to empty is gone through in equal parts; temperature stays. The band of two
 * deviations holds the SOC's, the voltage's along the way, and those of the capacity. Zero
 * throughout for a load that no cell carries and for a state that is not sound. */
void cellwise_remaining(const cellwise_model *m, const cellwise_state *x, float load_A,
                        bool holds_power, cellwise_outlook *out)
{
    const cellwise_constants *const c = &m->constant;
    out->time_s = 0.0f;
    out->time_low_s = 0.0f;
    out->time_high_s = 0.0f;
    out->energy_J = 0.0f;
    out->energy_low_J = 0.0f;
    out->energy_high_J = 0.0f;
    if (is_sound(c, x) && SIZE_WITHIN(load_A, c->current_limit_A)) {
        cellwise_place place;
        place_now(m, x, &place);
        float current = at_least(load_A, c->remaining_least_A);
        const float low_V = c->remaining_low_V;
        cellwise_along then;
        as_it_is(x, &then);
        cellwise_along now;
        go_on(m, &place, x, &then, x->soc, current, 0.0f, &now);
        const float power_W = current * at_least(now.voltage_V, low_V);
        float per_A = c->soc_per_A;
        per_A = per_A * x->per_capacity;
        const float part = x->soc / REMAINING_PARTS;
        float off_V = off_by(&now);
        float usual_V = now.voltage_V;
        float worse_V = usual_V - off_V;
        float better_V = usual_V + off_V;
        float usual_s = 0.0f;
        float usual_J = 0.0f;
        float worse_s = 0.0f;
        float better_s = 0.0f;
        float ahead = REMAINING_PARTS;
        while (ahead > 0.0f) {
            ahead = ahead - 1.0f;
            if (holds_power) {
                const float asked_A = power_W / at_least(now.voltage_V, low_V);
                current = clip(asked_A, c->remaining_least_A, c->current_limit_A);
            }
            const float steps = part / (per_A * current);
            go_on(m, &place, x, &now, part * ahead, current, steps, &then);
            const float part_s = steps * c->step_s;
            off_V = off_by(&then);
            const float before_s = usual_s;
            usual_s = lasted(usual_s, usual_V, then.voltage_V, low_V, part_s);
            worse_s = lasted(worse_s, worse_V, then.voltage_V - off_V, low_V, part_s);
            better_s = lasted(better_s, better_V, then.voltage_V + off_V, low_V, part_s);
            const float middle_V = at_least(0.5f * (now.voltage_V + then.voltage_V), low_V);
            usual_J = usual_J + ((current * middle_V) * (usual_s - before_s));
            usual_J = clip(usual_J, 0.0f, LONGEST);
            usual_V = clip(then.voltage_V, -LARGE, usual_V);
            worse_V = clip(then.voltage_V - off_V, -LARGE, worse_V);
            better_V = clip(then.voltage_V + off_V, -LARGE, better_V);
            now = then;
        }
        const float load_W = current * at_least(now.voltage_V, low_V);
        const float by_soc_s = ((2.0f * root(x->ss)) / (per_A * current)) * c->step_s;
        const float by_capacity_s = c->remaining_share * usual_s;
        const float below_s = apart_by(by_soc_s, by_capacity_s, at_least(usual_s - worse_s, 0.0f));
        const float above_s = apart_by(by_soc_s, by_capacity_s, at_least(better_s - usual_s, 0.0f));
        out->time_s = usual_s;
        out->time_low_s = at_least(usual_s - below_s, 0.0f);
        out->time_high_s = usual_s + above_s;
        out->energy_J = usual_J;
        out->energy_low_J = at_least(usual_J - (below_s * load_W), 0.0f);
        out->energy_high_J = usual_J + (above_s * load_W);
    }
}

/* Every phase a time and a load that are numbers, of a size that cells have. */
static bool is_plan_sound(const cellwise_phase *phases, uint32_t count)
{
    bool sound = true;
    for (uint32_t k = 0u; k < count; k++) {
        if (!(NOT_NEGATIVE(phases[k].seconds, LARGE) && SIZE_WITHIN(phases[k].load, LARGE))) {
            sound = false;
        }
    }
    return sound;
}

/* Through the plan from a SOC, with a capacity, as many times two deviations lower in voltage. A
 * phase is gone through in equal parts; a power finds its current by the voltage that it leaves. */
static NOINLINE void flown(const cellwise_model *m, const cellwise_place *place,
                           const cellwise_state *x, const cellwise_phase *phases, uint32_t count,
    bool holds_power, float begun, float per_capacity, float lower, cellwise_end *end)
{
    const cellwise_constants *const c = &m->constant;
    const float low_V = c->remaining_low_V;
    end->soc = begun;
    cellwise_along now;
    as_it_is(x, &now);
    cellwise_along then;
    go_on(m, place, x, &now, end->soc, 0.0f, 0.0f, &then);
    float voltage_V = then.voltage_V;
    end->least_V = voltage_V;
    end->energy_J = 0.0f;
    end->failed_s = LONGEST;
    float time_s = 0.0f;
    const uint32_t turns = holds_power ? PHASE_TURNS : 1u;
    for (uint32_t phase = 0u; phase < count; phase++) {
        const float load = phases[phase].load;
        float current = holds_power ? (load / at_least(voltage_V, low_V)) : load;
        current = clip(current, -c->current_limit_A, c->current_limit_A);
        uint32_t parts = 1u;
        if (magnitude(load) > 0.0f) {
            const float per_s = magnitude(taken(c, x, current)) / c->step_s;
            float asked = PHASE_PARTS_PER_S + (REMAINING_PARTS * per_s);
            asked = 1.0f + (phases[phase].seconds * asked);
            parts = (uint32_t)clip(asked, 1.0f, PHASE_PARTS_MOST);
        }
        const float part_s = phases[phase].seconds / (float)parts;
        const float steps = part_s / c->step_s;
        for (uint32_t k = 0u; k < parts; k++) {
            float after = end->soc;
            for (uint32_t kturn = 0u; kturn < turns; kturn++) {
                if (holds_power) {
                    current = load / at_least(voltage_V, low_V);
                    current = clip(current, -c->current_limit_A, c->current_limit_A);
                }
                after = end->soc - ((per_capacity * taken(c, x, current)) * steps);
                after = clip(after, -1.0f, 2.0f);
                go_on(m, place, x, &now, after, current, steps, &then);
                voltage_V = then.voltage_V - (lower * off_by(&then));
            }
            end->soc = after;
            now = then;
            time_s = clip(time_s + part_s, 0.0f, LONGEST);
            end->energy_J =
                clip(end->energy_J + ((current * voltage_V) * part_s), -LONGEST, LONGEST);
            end->least_V = clip(voltage_V, -LARGE, end->least_V);
            if (((voltage_V <= low_V) || (end->soc <= 0.0f)) && (end->failed_s >= LONGEST)) {
                end->failed_s = time_s;
            }
        }
    }
}

/* Probability that a normal number is below so many deviations, to 1e-6. Abramowitz and Stegun
 * (1964), 26.2.19: a polynomial to the power of -16. */
static NOINLINE float normal(float deviations)
{
    const float z = clip(magnitude(deviations), 0.0f, DEVIATIONS_MOST);
    const float far = NORMAL_4 + (z * (NORMAL_5 + (z * NORMAL_6)));
    float grown = 1.0f + (z * (NORMAL_1 + (z * (NORMAL_2 + (z * (NORMAL_3 + (z * far)))))));
    for (uint32_t k = 0u; k < 4u; k++) {
        grown = grown * grown;
    }
    const float tail = 0.5f / grown;
    return (deviations < 0.0f) ? tail : (1.0f - tail);
}

/* Where a plan of loads ends, and the chance to end at `above` or more; nothing is changed. The
 * phases follow each other; a load is a current [A], or with `holds_power` a power [W], of one
 * cell, positive on discharge. Temperature stays. The bands of two deviations hold those of the
 * SOC, of the voltage along the way and of the capacity, by their effects at two deviations; the
 * chance is the product of those to end at `above` and to stay above the cutoff: at most as
 * large as the two together. Zero throughout for a phase that is none and a state that is not
 * sound. */
void cellwise_plan(const cellwise_model *m, const cellwise_state *x, const cellwise_phase *phases,
                   uint32_t count, bool holds_power, float above, cellwise_landing *out)
{
    const cellwise_constants *const c = &m->constant;
    out->soc = 0.0f;
    out->soc_low = 0.0f;
    out->soc_high = 0.0f;
    out->least_V = 0.0f;
    out->least_low_V = 0.0f;
    out->energy_J = 0.0f;
    out->failed_s = 0.0f;
    out->chance = 0.0f;
    if (is_sound(c, x) && is_plan_sound(phases, count) && NOT_NEGATIVE(above, 1.0f)) {
        cellwise_place place;
        place_now(m, x, &place);
        const float away = 2.0f * root(x->ss);
        /* Away from the nearer end of the SOC, where it would be cut off. */
        const float other_soc = clip(x->soc + ((x->soc < 0.5f) ? away : -away), 0.0f, 1.0f);
        const float less = 1.0f + c->remaining_share;
        cellwise_end usual;
        flown(m, &place, x, phases, count, holds_power, x->soc, 1.0f, 0.0f, &usual);
        cellwise_end other;
        flown(m, &place, x, phases, count, holds_power, other_soc, 1.0f, 0.0f, &other);
        const float soc_by_soc = magnitude(usual.soc - other.soc);
        const float low_by_soc_V = magnitude(usual.least_V - other.least_V);
        flown(m, &place, x, phases, count, holds_power, x->soc, less, 0.0f, &other);
        const float soc_by_capacity = magnitude(usual.soc - other.soc);
        const float low_by_capacity_V = magnitude(usual.least_V - other.least_V);
        flown(m, &place, x, phases, count, holds_power, x->soc, 1.0f, 1.0f, &other);
        const float soc_by_voltage = magnitude(usual.soc - other.soc);
        const float low_by_voltage_V = magnitude(usual.least_V - other.least_V);
        const float off_soc =
            at_least(apart_by(soc_by_soc, soc_by_capacity, soc_by_voltage), LEAST_SPAN_V);
        float off_V = apart_by(low_by_soc_V, low_by_capacity_V, low_by_voltage_V);
        off_V = at_least(off_V, LEAST_SPAN_V);
        out->soc = clip(usual.soc, 0.0f, 1.0f);
        out->soc_low = clip(usual.soc - off_soc, 0.0f, 1.0f);
        out->soc_high = clip(usual.soc + off_soc, 0.0f, 1.0f);
        out->least_V = usual.least_V;
        out->least_low_V = usual.least_V - off_V;
        out->energy_J = usual.energy_J;
        out->failed_s = usual.failed_s;
        const float by_soc = normal((2.0f * (usual.soc - above)) / off_soc);
        const float by_voltage = normal((2.0f * (usual.least_V - c->remaining_low_V)) / off_V);
        out->chance = by_soc * by_voltage;
    }
}

/* ---- fixed_cells.py: Cells of a pack on one table: the mean cell by the step, every cell by
 * its difference from it. */

/* Derivatives of a cell's voltage minus the mean's, and its variance about that. `single_V2` is
 * that of one sample, `variance_V2` of one that shares its error with others. */
typedef struct {
    float soc_V;
    float capacity_V;
    float resistance_V;
    float single_V2;
    float variance_V2;
} cellwise_difference;

/* Every number in its range: memory that lost its content, or was never set, is noticed. */
static bool cell_is_sound(const cellwise_pack_cell *a)
{
    if (!(SIZE_WITHIN(a->soc, 1.0f) && SIZE_WITHIN(a->capacity, CELL_MOST))) {
        return false;
    }
    if (!WITHIN(a->resistance, -CELL_MOST, SCALE_MOST)) {
        return false;
    }
    if (!(NOT_NEGATIVE(a->ss, LARGE) && NOT_NEGATIVE(a->qq, LARGE) && NOT_NEGATIVE(a->rr, LARGE))) {
        return false;
    }
    return SIZE_WITHIN(a->sq, LARGE) && SIZE_WITHIN(a->sr, LARGE) && SIZE_WITHIN(a->qr, LARGE);
}

/* A cell of which only is known how far cells usually differ. */
static NOINLINE void start_cell(const cellwise_constants *c, cellwise_pack_cell *a)
{
    a->soc = 0.0f;
    a->capacity = 0.0f;
    a->resistance = 0.0f;
    a->ss = c->cell_soc2;
    a->sq = 0.0f;
    a->sr = 0.0f;
    a->qq = c->cell_capacity2;
    a->qr = 0.0f;
    a->rr = c->cell_resistance2;
    a->seen_at = 0u;
    a->rejections = 0u;
    a->status = 0u;
}

/* The cells of a pack before their first sample; after `cellwise_init` of the mean cell. */
void cellwise_cells_init(const cellwise_model *m, cellwise_pack_cell *cells, uint32_t count)
{
    for (uint32_t k = 0u; k < count; k++) {
        start_cell(&m->constant, &cells[k]);
    }
}

/* Mean voltage of the cells: what the step of the mean cell is to be given. Without readings
 * that no cell gives; without cells whose last voltage was rejected, while these are the fewer;
 * -1, which the step takes for a missing voltage, where no cell is left. */
float cellwise_mean_voltage(const cellwise_model *m, const cellwise_pack_cell *cells,
                            const float *voltage_V, uint32_t count)
{
    const cellwise_constants *const c = &m->constant;
    float first = -1.0f;
    float total = 0.0f;
    float unsure = 0.0f;
    uint32_t used = 0u;
    uint32_t left_out = 0u;
    for (uint32_t k = 0u; k < count; k++) {
        if (WITHIN(voltage_V[k], c->voltage_low_V, c->voltage_high_V)) {
            if (first < 0.0f) {
                first = voltage_V[k];
            }
            if (cells[k].rejections == 0u) {
                total = total + (voltage_V[k] - first);
                used = used + 1u;
            } else {
                unsure = unsure + (voltage_V[k] - first);
                left_out = left_out + 1u;
            }
        }
    }
    if (left_out >= used) {
        total = total + unsure;
        used = used + left_out;
    }
    if (used != 0u) {
        first = first + (total / (float)used);
    }
    return first;
}

/* The derivatives at the mean cell's SOC. A cell that is polled late reads what the mean voltage
 * moved by meanwhile. */
static void difference_of(const cellwise_model *m, const cellwise_place *place,
                          const cellwise_state *x, float mean_V, cellwise_difference *difference)
{
    const cellwise_constants *const c = &m->constant;
    cellwise_point p;
    look_up(m, place, x->soc, x->current_A, &p);
    const float moved_V = mean_V - x->mean_V;
    difference->single_V2 = c->cell_V2 + (c->cell_lag * (moved_V * moved_V));
    difference->variance_V2 = difference->single_V2 * c->cell_shared;
    difference->capacity_V = p.slope_V * (0.5f - x->soc);
    difference->resistance_V = mean_V - p.ocv_V;
    difference->soc_V = p.slope_V;
}

/* After many rejections in a row a cell's SOC is unknown. */
static NOINLINE void look_again(cellwise_pack_cell *a)
{
    a->ss = RECOVERY_VARIANCE;
    a->sq = 0.0f;
    a->sr = 0.0f;
    a->rejections = 0u;
    a->status = a->status | CELLWISE_GATE_RECOVERY;
}

/* Use a cell's voltage above the mean: three states, one measurement. */
static void use_voltage(const cellwise_constants *c, cellwise_pack_cell *a,
                        const cellwise_difference *d, float above_V)
{
    const float gain_s = ((a->ss * d->soc_V) + (a->sq * d->capacity_V)) + (a->sr * d->resistance_V);
    const float gain_q = ((a->sq * d->soc_V) + (a->qq * d->capacity_V)) + (a->qr * d->resistance_V);
    const float gain_r = ((a->sr * d->soc_V) + (a->qr * d->capacity_V)) + (a->rr * d->resistance_V);
    float explained_V2 = (d->soc_V * gain_s) +
        ((d->capacity_V * gain_q) + (d->resistance_V * gain_r));
    explained_V2 = at_least(explained_V2, 0.0f);
    const float said_V = ((d->soc_V * a->soc) + (d->capacity_V * a->capacity)) +
        (d->resistance_V * a->resistance);
    const float off_V = above_V - said_V;
    if ((off_V * off_V) > (c->gate_square * (explained_V2 + d->single_V2))) {
        a->status = a->status | CELLWISE_INNOVATION_REJECTED;
        if (a->rejections < c->cell_recovery) {
            a->rejections = a->rejections + 1u;
        } else {
            look_again(a);
        }
    } else {
        a->rejections = 0u;
        const float per = 1.0f / (explained_V2 + d->variance_V2);
        a->soc = clip(a->soc + (gain_s * (off_V * per)), -1.0f, 1.0f);
        a->capacity = clip(a->capacity + (gain_q * (off_V * per)), -CELL_MOST, CELL_MOST);
        a->resistance = clip(a->resistance + (gain_r * (off_V * per)), -CELL_MOST, SCALE_MOST);
        a->ss = at_least(a->ss - (gain_s * (gain_s * per)), c->cell_least_soc2);
        a->sq = a->sq - (gain_s * (gain_q * per));
        a->sr = a->sr - (gain_s * (gain_r * per));
        a->qq = at_least(a->qq - (gain_q * (gain_q * per)), VARIANCE_FLOOR);
        a->qr = a->qr - (gain_q * (gain_r * per));
        a->rr = at_least(a->rr - (gain_r * (gain_r * per)), VARIANCE_FLOOR);
    }
}

/* One cell in its turn: it has drifted from the mean, then its voltage is used. */
static void step_cell(const cellwise_constants *c, cellwise_pack_cell *a,
                      const cellwise_difference *d, float voltage_V, float mean_V,
    uint32_t sequence)
{
    const float steps = (float)(sequence - a->seen_at);
    if (cell_is_sound(a)) {
        a->status = 0u;
    } else {
        start_cell(c, a);
        a->status = CELLWISE_STATE_RESET;
    }
    a->ss = clip(a->ss + (steps * c->cell_soc_walk), 0.0f, SOC_VARIANCE_MOST);
    a->qq = clip(a->qq + (steps * c->cell_capacity_walk), 0.0f, SOC_VARIANCE_MOST);
    a->rr = clip(a->rr + (steps * c->cell_resistance_walk), 0.0f, SOC_VARIANCE_MOST);
    a->seen_at = sequence;
    if (WITHIN(voltage_V, c->voltage_low_V, c->voltage_high_V)) {
        use_voltage(c, a, d, voltage_V - mean_V);
    } else {
        a->status = a->status | CELLWISE_VOLTAGE_INVALID;
    }
}

/* One sample of a pack, after `cellwise_step` of the mean cell with the same sample. The cells
 * whose turn it is are looked at. `sample.voltage_V` is the mean that `cellwise_mean_voltage`
 * gave; NaN for a cell without a reading, or while it is balanced. */
void cellwise_cells_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *sample,
                         cellwise_pack_cell *cells, const float *voltage_V, uint32_t count)
{
    const cellwise_constants *const c = &m->constant;
    const float mean_V = sample->voltage_V;
    const bool there = WITHIN(mean_V, c->voltage_low_V, c->voltage_high_V);
    const uint32_t elapsed = sample->sequence - x->cells_at;
    if (there && (x->evidence > NO_VOLTAGE_YET) && (elapsed != 0u) && is_sound(c, x)) {
        cellwise_place place;
        place_now(m, x, &place);
        if (!(x->mean_V > 0.0f)) {
            x->mean_V = mean_V;
        }
        cellwise_difference d;
        difference_of(m, &place, x, mean_V, &d);
        uint32_t due = x->turn;
        for (uint32_t k = 0u; k < count; k++) {
            if (k == due) {
                step_cell(c, &cells[k], &d, voltage_V[k], mean_V, sample->sequence);
                due = due + c->cell_turns;
            }
        }
        x->turn = ((x->turn + 1u) < c->cell_turns) ? (x->turn + 1u) : 0u;
        x->mean_V = mean_V;
        x->cells_at = sample->sequence;
    }
}

/* SOC of one cell. */
static float own_soc(const cellwise_state *x, const cellwise_pack_cell *a)
{
    return clip(x->soc + (a->soc + (a->capacity * (0.5f - x->soc))), 0.0f, 1.0f);
}

/* Variance of one cell's SOC: the mean's and its difference's. */
static float own_variance(const cellwise_constants *c, const cellwise_state *x,
                          const cellwise_pack_cell *a)
{
    const float away = 0.5f - x->soc;
    const float difference2 = a->ss + (away * ((2.0f * a->sq) + (away * a->qq)));
    return x->ss + at_least(difference2, c->cell_least_soc2);
}

/* What is known of one cell; capacity and resistance beside the mean cell's. */
void cellwise_cell_of(const cellwise_model *m, const cellwise_state *x,
                      const cellwise_pack_cell *a, cellwise_cell_output *out)
{
    const cellwise_constants *const c = &m->constant;
    if (is_sound(c, x) && cell_is_sound(a)) {
        out->soc = own_soc(x, a);
        out->soc_variance = own_variance(c, x, a);
        out->capacity_share = 1.0f + a->capacity;
        out->capacity_variance = a->qq;
        out->resistance_scale = 1.0f + a->resistance;
        out->resistance_variance = a->rr;
        out->status = a->status;
    } else {
        out->soc = KNOW_NOTHING_SOC;
        out->soc_variance = KNOW_NOTHING_VARIANCE;
        out->capacity_share = 1.0f;
        out->capacity_variance = c->cell_capacity2;
        out->resistance_scale = 1.0f;
        out->resistance_variance = c->cell_resistance2;
        out->status = CELLWISE_STATE_RESET;
    }
}

/* The same place with one cell's resistance. */
static NOINLINE void with_cell(const cellwise_place *at, const cellwise_pack_cell *a,
                               cellwise_place *place)
{
    place->low = at->low;
    place->weight = at->weight;
    place->scale = at->scale * (1.0f + a->resistance);
    place->lag = at->lag;
}

/* The cell that a current over the horizon brings nearest to its limit of voltage. */
static NOINLINE uint32_t weakest(const cellwise_model *m, const cellwise_place *place,
                                 const cellwise_state *x, const cellwise_pack_cell *cells,
    uint32_t count, float side, float current)
{
    uint32_t found = 0u;
    float least_V = LARGEST_FLOAT;
    for (uint32_t k = 0u; k < count; k++) {
        if (cell_is_sound(&cells[k])) {
            cellwise_place own;
            with_cell(place, &cells[k], &own);
            cellwise_along end;
            ending(m, &own, x, own_soc(x, &cells[k]), side * current, &end);
            const float left_V = side * end.voltage_V;
            if (left_V < least_V) {
                least_V = left_V;
                found = k;
            }
        }
    }
    return found;
}

/* The emptiest cell (`side` 1), or the fullest (-1). */
static NOINLINE uint32_t nearest_to_end(const cellwise_state *x, const cellwise_pack_cell *cells,
                                        uint32_t count, float side)
{
    uint32_t found = 0u;
    float least = LARGEST_FLOAT;
    for (uint32_t k = 0u; k < count; k++) {
        if (cell_is_sound(&cells[k])) {
            const float room = side * own_soc(x, &cells[k]);
            if (room < least) {
                least = room;
                found = k;
            }
        }
    }
    return found;
}

/* What one cell can give (`side` 1) or take (-1) over the horizon. */
static NOINLINE void way_of(const cellwise_model *m, const cellwise_place *place,
                            const cellwise_state *x, const cellwise_pack_cell *a, float side,
    cellwise_way *way)
{
    const cellwise_constants *const c = &m->constant;
    const float soc = own_soc(x, a);
    const float ss = own_variance(c, x, a);
    cellwise_place own;
    with_cell(place, a, &own);
    float held_V = x->v1_V + x->v2_V;
    held_V = held_V + x->v3_V;
    const float worse_V = at_least(side * (a->resistance * held_V), 0.0f);
    float limit_V = c->power_low_V;
    float most_A = c->power_discharge_A;
    float room = soc - c->power_soc_low;
    if (side < 0.0f) {
        limit_V = c->power_high_V;
        most_A = c->power_charge_A;
        room = c->power_soc_high - soc;
    }
    limit_V = limit_V + (side * worse_V);
    cellwise_way one;
    one_way(m, &own, x, soc, ss, side, limit_V, most_A, room, &one);
    way->power_W = one.power_W;
    way->low_W = one.low_W;
    way->current_A = one.current_A;
}

/* Power of the pack one way: the least of what its weakest cells allow. These are the cell that
 * is nearest to its end, the one whose voltage is at the largest current, and the one whose
 * voltage is at the current that these two allow. */
static NOINLINE void pack_way(const cellwise_model *m, const cellwise_place *place,
                              const cellwise_state *x, const cellwise_pack_cell *cells,
    uint32_t count, float side, cellwise_way *way)
{
    const cellwise_constants *const c = &m->constant;
    way->current_A = (side > 0.0f) ? c->power_discharge_A : c->power_charge_A;
    way->low_W = LARGEST_FLOAT;
    for (uint32_t turn = 0u; turn < THREE_CELLS; turn++) {
        uint32_t at = nearest_to_end(x, cells, count, side);
        if (turn != 0u) {
            at = weakest(m, place, x, cells, count, side, way->current_A);
        }
        cellwise_way one;
        way_of(m, place, x, &cells[at], side, &one);
        if (one.current_A < way->current_A) {
            way->current_A = one.current_A;
        }
        if (one.low_W < way->low_W) {
            way->low_W = one.low_W;
        }
    }
    cellwise_along end;
    ending(m, place, x, x->soc, side * way->current_A, &end);
    const float many = (float)count;
    way->power_W = at_least(many * (way->current_A * end.voltage_V), 0.0f);
    way->low_W = many * way->low_W;
    if (way->low_W > way->power_W) {
        way->low_W = way->power_W;
    }
}

/* What the pack can give and take for the horizon, as its weakest cell allows. Zero throughout
 * for a state that is not sound, and for no cells. */
void cellwise_pack_power(const cellwise_model *m, const cellwise_state *x,
                         const cellwise_pack_cell *cells, uint32_t count, cellwise_capability *out)
{
    out->discharge_W = 0.0f;
    out->discharge_low_W = 0.0f;
    out->charge_W = 0.0f;
    out->charge_low_W = 0.0f;
    if ((count != 0u) && is_sound(&m->constant, x)) {
        cellwise_place place;
        place_now(m, x, &place);
        cellwise_way down;
        pack_way(m, &place, x, cells, count, 1.0f, &down);
        cellwise_way up;
        pack_way(m, &place, x, cells, count, -1.0f, &up);
        out->discharge_W = down.power_W;
        out->discharge_low_W = down.low_W;
        out->charge_W = up.power_W;
        out->charge_low_W = up.low_W;
    }
}
