/* Tables of one cell, as `cellwise export` writes them. Printed from src/cellwise/estimate by `python -m
 * cellwise.printing`; do not edit. */
/* Constant, in flash. cell_table.h says what is compiled in. */
#ifndef CELLWISE_MODEL_H
#define CELLWISE_MODEL_H

#include <stdbool.h>
#include <stdint.h>

#include "cell_table.h"

/* CW-017: what changes the arithmetic does not compile. */
#if defined(__FAST_MATH__) || defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || \
    (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ != 0))
#error "cellwise_ekf: build without -ffast-math, -Ofast and the options that these stand for"
#endif
#if defined(__FLT_EVAL_METHOD__) && (__FLT_EVAL_METHOD__ != 0)
#error "cellwise_ekf: float expressions must be evaluated as float (on 32-bit x86: -mfpmath=sse)"
#endif

#define CELLWISE_NEEDS_TEMPERATURE \
    ((CELLWISE_TEMPERATURES > 1) || (CELLWISE_ARRHENIUS > 0) || (CELLWISE_DEPTH > 0) || \
     (CELLWISE_VALIDITY > 1))

/* One point of the SOC grid. A branch's lag is in time steps. */
typedef struct {
    float ocv_V;
    float error_V; /* slow error of the model's voltage */
    float r0_ohm;
    float r1_ohm;
    float r2_ohm;
    float r3_ohm;
    float lag1; /* 1 / (1 - exp(-dt/tau)): all but linear in tau, so it is interpolated as tau is */
    float lag2; /* 1 / (1 - exp(-dt/tau)): all but linear in tau, so it is interpolated as tau is */
    float lag3; /* 1 / (1 - exp(-dt/tau)): all but linear in tau, so it is interpolated as tau is */
    float m_V;
} cellwise_row;

/* What depends on cell, time step and noise but not on SOC. */
typedef struct {
    float soc_per_A; /* SOC that 1 A takes in one step */
    float soc_walk; /* variance that SOC gains in one step */
    float capacity_walk; /* and per ampere, by a capacity that may be off */
    float current_variance_A2; /* of the current sensor */
    float fixed_V2; /* of the voltage sensor */
    float ocv_soc2; /* of the OCV along the SOC axis */
    float lost_A2; /* variance of a current that nobody measured */
    float share_variance; /* of the resistances on discharge, relative, */
    float charge_variance; /* and on charge */
    float gate_square; /* innovations beyond this many variances are rejected */
    float shared; /* samples that share one model error after long; */
    float shared_early; /* just after the first shared_early / shared_half of them, */
    float shared_half; /* and half way between the two after so many steps */
    float lately; /* weight of one sample in the running mismatch */
    float mismatch_cap;
    float gap_variance; /* of SOC over a long gap */
    float current_limit_A;
    float voltage_low_V;
    float voltage_high_V;
    float branch_variance_V2; /* of a branch voltage at the start, at rest */
    float rest_A; /* below it a cell counts as resting */
    float start_rest_A; /* what may have flowed before a start at rest, */
    float start_load_A; /* and, at least, before one under load */
    uint32_t recovery_after; /* steps rejected in a row, then the SOC is unknown */
    uint32_t gap_steps; /* missing samples that are bridged */
    uint32_t hold_steps; /* samples for which a missing current is held */
    float lost_soc; /* deviation that SOC gains in one step after that */
    float frozen_V; /* how far a voltage must have moved to be called frozen */
    float recovery_A; /* what branches may hold after a lock-out */
    float bank_A; /* what may have flowed for hours before a start under load, */
    float past_A; /* and beside a load like it */
    float least_use_A; /* a use takes no longer from full to empty */
    float fades; /* of samples that share one model error, those whose error fades, */
    float stays; /* and the share of the error that does not */
    float block_steps; /* of a block of samples, whose mean is one piece of evidence */
    float look_steps; /* until the past of a start under load is looked at */
    float charge_efficiency;
    float leak_soc; /* SOC that self-discharge takes in one step */
    float skew_share; /* of the previous current in what the voltage has seen */
    float rate_per_A; /* fall of the resistances with the current */
    float charge_scale; /* factor on the resistances while charging */
    float asinh_per_V; /* of the charge transfer of the fast branch */
    float surface_gain; /* 1 - exp(-dt / time constant of the current it follows) */
    float surface_rate; /* dt / that time constant */
    float hysteresis_per_A; /* e-folds of h in one step at 1 A */
    float persistent; /* share of the slow error that comes back at the same SOC */
    float drift_soc; /* that a current which is off moves in one step */
    float offset_A; /* deviation of an offset of the current beforehand */
    float rate_A; /* 1C */
    float rest_steps; /* of a current that stands still, until it shows an offset */
    float contradicted_share; /* dt / 600 s */
    uint32_t sketch_rows; /* steps from row to row of the sketch */
    float sketch_steps; /* the same */
    float sketch_share; /* one over that */
    float sketch_soc; /* SOC that 1 A takes in a row */
    uint32_t sketch_most; /* rows of a simulation */
    float sketch_per_s; /* one over a time step */
    float sketch_fade; /* of the sums, in a row */
    float sketch_keep; /* of the model's slow error, from row to row */
    float sketch_branch; /* and of a current that a slow branch has followed */
    float sketch_path; /* e-folds of a hysteresis in a row at 1 A */
    float sketch_V2; /* of a row's voltage, by what is not slow */
    float sketch_fast; /* of the stated error's square, what is not slow, */
    float sketch_slow; /* and what is */
    float sketch_fast_share; /* of a drop's square, what is off and not slow */
    float sketch_slow_share; /* share of a drop that is off, and slow */
    float sketch_low; /* SOC below which nothing is summed */
    float sketch_soc2; /* variance of SOC with which a simulation may begin */
    float heat_K_per_W;
    float heat_gain; /* 1 - exp(-dt / thermal time constant) */
    float heat_rate; /* dt / thermal time constant */
    float temperature_C; /* until the first valid one */
    float valid_soc_low; /* the model's data, tolerance included */
    float valid_soc_high;
    float valid_charge_A;
    float valid_discharge_A;
    float share_per_A; /* of the polarisation, error beyond their current */
    float valid_cold_C;
    float valid_warm_C;
    float share_per_K; /* of the polarisation, error beyond their temperature */
    float voltage_per_K; /* of the OCV */
    float power_steps; /* time steps of the horizon of the power */
    float power_low_V; /* limits that a power keeps */
    float power_high_V;
    float power_discharge_A;
    float power_charge_A; /* without sign */
    float power_soc_low;
    float power_soc_high;
    float remaining_low_V; /* voltage at which a load gives up */
    float remaining_least_A; /* a load below it counts as it */
    float remaining_share; /* two deviations of the capacity, relative */
    float step_s; /* the time step */
    float cell_soc2; /* variance of the cells' differences at the start: of SOC, */
    float cell_capacity2; /* capacity, relative, */
    float cell_resistance2; /* resistance, relative, */
    float cell_soc_walk; /* and gained in one step */
    float cell_capacity_walk;
    float cell_resistance_walk;
    float cell_V2; /* of a cell's sensor beside the others' */
    float cell_shared; /* samples that share one error of a cell's voltage */
    float cell_lag; /* square of the delay of a cell's polling, in steps */
    float cell_least_soc2; /* what a sensor's offset leaves unknown of a cell's SOC */
    uint32_t cell_turns; /* samples in which every cell has its turn once */
    uint32_t cell_recovery; /* rejections in a row, then a cell's SOC is unknown */
    float soh_rest_A; /* below it a cell rests, to millivolts, */
    uint32_t soh_steps; /* and after so many steps its voltage is the OCV */
    float soh_capacity; /* by what share of the model's a cell's may differ when new */
    float soh_load_A; /* of a load that shows the resistance, at least, */
    uint32_t soh_load_steps; /* within so many steps after a rest */
    float soh_drift; /* SOC that an offset of one deviation takes in one step */
    float grid_C[CELLWISE_TEMPERATURES]; /* temperatures of the tables */
    float per_K[CELLWISE_TEMPERATURES - 1u]; /* 1 / distance of neighbours */
    float arrhenius_low_C;
    float arrhenius_per_K; /* points per kelvin */
    float arrhenius[CELLWISE_ARRHENIUS]; /* factor on every resistance */
    float depth_low_C;
    float depth_per_K; /* points per kelvin */
    float depth[CELLWISE_DEPTH]; /* SOC that the surface is below at 1 A */
} cellwise_constants;

typedef struct {
    cellwise_constants constant;
    cellwise_row row[CELLWISE_TEMPERATURES][CELLWISE_POINTS];
} cellwise_model;

#endif
