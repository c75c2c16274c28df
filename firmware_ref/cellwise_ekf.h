/* State of charge of one battery cell: a Kalman filter at a fixed time step. Printed from src/cellwise/estimate by
 * `python -m cellwise.printing`; do not edit. */
/* The caller owns every object. No heap, no static data, no libm, no double; the same bits as the Python. Current is
 * positive on discharge. No output is ever NaN or infinite. */
#ifndef CELLWISE_EKF_H
#define CELLWISE_EKF_H

#include "cellwise_bank_record.h"
#include "cellwise_model.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Status bits, the values of cellwise.Status in Python. */
#define CELLWISE_CURRENT_INVALID 1u /* missing or not finite: the last valid current was held */
#define CELLWISE_VOLTAGE_INVALID 2u /* missing or not finite: prediction only */
#define CELLWISE_SEQUENCE_GAP 4u /* the log has a gap here: charge unknown, variance widened */
#define CELLWISE_DUPLICATE 8u /* repeated time stamp: nothing flowed */
#define CELLWISE_INNOVATION_REJECTED 16u /* the innovation gate kept the voltage out */
#define CELLWISE_CLAMPED 32u /* SOC was held at a bound */
#define CELLWISE_STATE_RESET 64u /* the state was not finite and was re-initialised */
#define CELLWISE_GATE_RECOVERY 128u /* too many rejections in a row: variance widened, voltage let in */
#define CELLWISE_TEMPERATURE_INVALID 256u /* not finite or out of range: the last valid temperature was held */
#define CELLWISE_OUT_OF_RANGE 512u /* a reading that no cell of this kind gives: treated as missing */
#define CELLWISE_VOLTAGE_FROZEN 1024u /* the voltage repeats itself while the current changes: not used */
#define CELLWISE_CURRENT_LOST 2048u /* current missing for longer than is held: on voltage alone, variance grows */
#define CELLWISE_VOLTAGE_LOST 4096u /* voltage missing or frozen for as long: counting charge */
#define CELLWISE_OUTSIDE 8192u /* SOC, temperature or current beyond the model's data: variance widened */

/* What is carried from step to step: x, the upper triangle of P, and what was seen last. */
typedef struct {
    float soc; /* state of charge */
    float soc_carry; /* what rounding has kept from soc, to be subtracted */
    float v1_V; /* voltage of the fast branch */
    float v2_V; /* voltage of the second branch */
    float v3_V; /* voltage of the slow branch */
    float v3_carry_V; /* what rounding has kept from v3_V, to be subtracted */
    float h; /* hysteresis, -1 to 1 */
    float ss;
    float ss_carry; /* what rounding has kept from ss */
    float s1;
    float s2;
    float s3;
    float sh;
    float p11;
    float p12;
    float p13;
    float p1h;
    float p22;
    float p23;
    float p2h;
    float p33;
    float p3h;
    float phh;
    float current_A; /* last valid one */
    float mismatch; /* running mean of squared innovation over variance */
    float heat_K; /* own warming */
    float slow_A; /* current behind the lag of the particles' surface */
    float temperature_C; /* last valid one */
    float contradicted; /* SOC that the voltages say is missing */
    float persistent; /* SOC error by a persistent error of the model */
    float voltage_V; /* last valid one, */
    float frozen_A; /* the current when it came, */
    float repeats; /* and how often it has come since; 4: frozen */
    float swings; /* of the voltage while the current repeats itself; last one's sign */
    uint32_t no_current; /* steps without a valid one */
    uint32_t no_voltage; /* steps without one that could be used */
    float reach; /* SOC that an offset of one deviation has put it too low, */
    float score; /* what is known of the offset: mean over variance, */
    float information; /* one over the variance, */
    float believed; /* mean and variance with the chance of none, */
    float unsure;
    float d1_V;
    float d2_V;
    float d3_V;
    float rest; /* steps that the current has stood still near zero, -1: used, */
    float rest_A; /* and at what */
    float cost; /* minus the logarithm of its likelihood, beside the likeliest */
    float weight; /* share of the bank */
    float error_V2; /* variance of the next innovation, while a bank is open */
    uint32_t in_bank; /* 0: alone, 1: a component, 2: contradicted, 3: not counted */
    float per_capacity; /* inverse of the share of the capacity that is left */
    float resistance_scale; /* of the resistances since */
    float mean_V; /* of the cells at their last sample, */
    uint32_t cells_at; /* its sequence, */
    uint32_t turn; /* and the first cell whose turn is next */
    uint32_t sequence; /* of the last sample */
    uint32_t rejections; /* steps rejected in a row */
    uint32_t evidence; /* 0: no sample yet, 1: no voltage yet, then 2 + steps since */
} cellwise_state;

typedef struct {
    float current_A; /* mean over the interval that ends now, positive on discharge */
    float voltage_V; /* now */
    float temperature_C; /* now; read only where CELLWISE_NEEDS_TEMPERATURE */
    uint32_t sequence; /* counts time steps, wraps */
} cellwise_input;
typedef struct {
    float soc;
    float soc_variance;
    float voltage_V; /* predicted, before the measured one was used */
    float innovation_V; /* measured minus predicted; 0 where the voltage is invalid */
    float innovation_variance_V2; /* of a single sample */
    uint32_t status; /* what happened: bits */
} cellwise_output;

/* A cell at rest at `soc`, known with `soc_variance`. Arguments that are no such numbers give a state that knows
 * nothing. Returns 0 or CELLWISE_STATE_RESET. */
uint32_t cellwise_init(const cellwise_model *m, cellwise_state *x, float soc, float soc_variance);

/* One time step: predict over the interval that ends now, then use the voltage read now. Returns the status bits,
 * which are in `out` too. */
uint32_t cellwise_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *sample, cellwise_output *out);

/* A start that is not known: an array of states, the estimate and its components behind it. */

/* A cell at rest at `soc`, known with `soc_variance`; `of` has count + 1 states. Arguments that are no such numbers
 * give a state that knows nothing. Returns 0 or CELLWISE_STATE_RESET. */
uint32_t cellwise_bank_init(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count, float soc,
                            float soc_variance);

/* One time step of a bank of `count` components; the estimate is in `of[0]`. Returns the status bits, which are in
 * `out` too. */
uint32_t cellwise_bank_step(const cellwise_model *m, cellwise_bank *b, cellwise_state *of, uint32_t count,
                            const cellwise_input *sample, cellwise_output *out);

/* State of power, where it is compiled in. */
typedef struct {
    float discharge_W; /* what the cell can give, */
    float discharge_low_W; /* and sustains with 95 % */
    float charge_W; /* what it can take, without sign, */
    float charge_low_W; /* and sustains with 95 % */
} cellwise_capability;
/* What the cell can give and take for the horizon that the tables hold; nothing is changed. The largest constant
 * currents that keep voltage, current and SOC within their limits to the end of the horizon, times the voltage then.
 * Zero throughout for a state that is not sound. */
void cellwise_power(const cellwise_model *m, const cellwise_state *x, cellwise_capability *out);

/* Remaining time and energy, where they are compiled in. */
typedef struct {
    float time_s; /* until the load reaches the cutoff, or the cell is empty */
    float time_low_s; /* two deviations less */
    float time_high_s; /* two deviations more */
    float energy_J; /* out until then */
    float energy_low_J;
    float energy_high_J;
} cellwise_outlook;
/* Time and energy until a load reaches the cutoff, or the cell is empty; nothing is changed. `load_A` is held, or
 * with `holds_power` what it gives now. One below C/50 counts as that. The SOC down to empty is gone through in
 * equal parts; temperature stays. The band of two deviations holds the SOC's, the voltage's along the way, and those
 * of the capacity. Zero throughout for a load that no cell carries and for a state that is not sound. */
void cellwise_remaining(const cellwise_model *m, const cellwise_state *x, float load_A, bool holds_power,
                        cellwise_outlook *out);

/* A plan of loads: a constant array of phases, and where it ends. */
typedef struct {
    float seconds; /* that it lasts */
    float load; /* current [A], or power [W], positive on discharge */
} cellwise_phase;
typedef struct {
    float soc; /* at the plan's end */
    float soc_low; /* two deviations less */
    float soc_high; /* two deviations more */
    float least_V; /* lowest voltage of the way */
    float least_low_V; /* two deviations less */
    float energy_J; /* given */
    float failed_s; /* when the voltage is at the cutoff, or the cell empty; 1e9: not in the plan */
    float chance; /* to end at the SOC asked for or more, above the cutoff all the way */
} cellwise_plan_result;
/* Where a plan of loads ends, and the chance to end at `above` or more; nothing is changed. The phases follow each
 * other; a load is a current [A], or with `holds_power` a power [W], of one cell, positive on discharge. Temperature
 * stays. The bands of two deviations hold those of the SOC, of the voltage along the way and of the capacity, by
 * their effects at two deviations; the chance is the product of those to end at `above` and to stay above the
 * cutoff: at most as large as the two together. Zero throughout for a phase that is none and a state that is not
 * sound. */
void cellwise_plan(const cellwise_model *m, const cellwise_state *x, const cellwise_phase *phases, uint32_t count,
                   bool holds_power, float above, cellwise_plan_result *out);

/* What a history says of the cell beside the model: its capacity, and all its resistances. Kept in the state.
 * Returns 0, or CELLWISE_OUT_OF_RANGE where nothing is taken: a share outside 0.1..2, a scale outside 0.1..20, a
 * state that is not sound. */
uint32_t cellwise_set_health(const cellwise_model *m, cellwise_state *x, float capacity_share, float resistance_scale);

/* A pack, where it is compiled in: one cellwise_state for the mean cell, one cellwise_pack_cell for the difference of
 * every cell. At each sample: cellwise_mean_voltage, cellwise_step with that voltage, cellwise_cells_step. */
typedef struct {
    float soc; /* more than the mean cell's, where that is 50 % */
    float capacity; /* more than the mean cell's, relative */
    float resistance; /* more than the mean cell's, relative */
    float ss; /* their covariance */
    float sq;
    float sr;
    float qq;
    float qr;
    float rr;
    uint32_t seen_at; /* sequence of its last turn */
    uint32_t rejections; /* in a row */
    uint32_t status; /* of the last sample: bits */
} cellwise_pack_cell;
typedef struct {
    float soc;
    float soc_variance;
    float capacity_share; /* of the mean cell's */
    float capacity_variance;
    float resistance_scale; /* beside the mean cell's */
    float resistance_variance;
    uint32_t status; /* of the last sample: bits */
} cellwise_cell_output;

/* The cells of a pack before their first sample; after `cellwise_init` of the mean cell. */
void cellwise_cells_init(const cellwise_model *m, cellwise_pack_cell *cells, uint32_t count);

/* Mean voltage of the cells: what the step of the mean cell is to be given. Without readings that no cell gives;
 * without cells whose last voltage was rejected, while these are the fewer; -1, which the step takes for a missing
 * voltage, where no cell is left. */
float cellwise_mean_voltage(const cellwise_model *m, const cellwise_pack_cell *cells, const float *voltage_V,
                            uint32_t count);

/* One sample of a pack, after `cellwise_step` of the mean cell with the same sample. The cells whose turn it is are
 * looked at. `sample.voltage_V` is the mean that `cellwise_mean_voltage` gave; NaN for a cell without a reading, or
 * while it is balanced. */
void cellwise_cells_step(const cellwise_model *m, cellwise_state *x, const cellwise_input *sample,
                         cellwise_pack_cell *cells, const float *voltage_V, uint32_t count);

/* What is known of one cell; capacity and resistance beside the mean cell's. */
void cellwise_cell_of(const cellwise_model *m, const cellwise_state *x, const cellwise_pack_cell *a,
                      cellwise_cell_output *out);

/* What the pack can give and take for the horizon, as its weakest cell allows. Zero throughout for a state that is
 * not sound, and for no cells. */
void cellwise_pack_power(const cellwise_model *m, const cellwise_state *x, const cellwise_pack_cell *cells,
                         uint32_t count, cellwise_capability *out);

#ifdef __cplusplus
}
#endif

#endif
