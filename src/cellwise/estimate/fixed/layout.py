"""Memory layout of the fixed-step estimator: one table of fields for NumPy and for C.

One buffer can be stepped by numba and by C. ``firmware_ref/cellwise_ekf.h`` is printed from these
tables; a test compares offsets and sizes with the compiler's.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.description import BRANCHES, CARRIED, SOC, V1, State, carry, entry, triangle
from cellwise.cell.description import CELL as STATES
from cellwise.cell.unrolled import CALLED
from cellwise.estimate.fixed.options import Options, flags_of


class Field(NamedTuple):
    """A field of a record.

    ``option`` are the options that compile it in, ``size`` what an array has as many elements of,
    ``fewer`` by how many less.
    """

    name: str
    meaning: str = ""
    option: str = ""
    type: str = "f4"
    size: str = ""
    fewer: int = 0


class Model(NamedTuple):
    """What a step reads of a cell: a record of CONSTANTS, and the table of rows.

    ``row`` has the shape (temperatures, points, fields of a row).
    """

    constant: Any
    row: Any


LAG = "1 / (1 - exp(-dt/tau)): all but linear in tau, so it is interpolated as tau is"


ROW = (
    Field("ocv_V"),
    Field("error_V", "slow error of the model's voltage"),
    Field("r0_ohm"),
    *(Field(f"r{s.letter}_ohm", "", s.option.upper()) for s in BRANCHES),
    *(Field(f"lag{s.letter}", LAG, s.option.upper()) for s in BRANCHES),
    Field("m_V", "", "HYSTERESIS"),
)

CONSTANTS = (
    Field("soc_per_A", "SOC that 1 A takes in one step"),
    Field("soc_walk", "variance that SOC gains in one step"),
    Field("capacity_walk", "and per ampere, by a capacity that may be off"),
    Field("current_variance_A2", "of the current sensor"),
    Field("fixed_V2", "of the voltage sensor"),
    Field("ocv_soc2", "of the OCV along the SOC axis"),
    Field("lost_A2", "variance of a current that nobody measured"),
    Field("share_variance", "of the resistances on discharge, relative,"),
    Field("charge_variance", "and on charge"),
    Field("gate_square", "innovations beyond this many variances are rejected"),
    Field("shared", "samples that share one model error after long;"),
    Field("shared_early", "just after the first shared_early / shared_half of them,"),
    Field("shared_half", "and half way between the two after so many steps"),
    Field("lately", "weight of one sample in the running mismatch"),
    Field("mismatch_cap"),
    Field("gap_variance", "of SOC over a long gap"),
    Field("current_limit_A"),
    Field("voltage_low_V"),
    Field("voltage_high_V"),
    Field("branch_variance_V2", "of a branch voltage at the start, at rest"),
    Field("rest_A", "below it a cell counts as resting"),
    Field("start_rest_A", "what may have flowed before a start at rest,"),
    Field("start_load_A", "and, at least, before one under load"),
    Field("recovery_after", "steps rejected in a row, then the SOC is unknown", "", "u4"),
    Field("gap_steps", "missing samples that are bridged", "", "u4"),
    Field("hold_steps", "samples for which a missing current is held", "WIDE", "u4"),
    Field("lost_soc", "deviation that SOC gains in one step after that", "WIDE"),
    Field("frozen_V", "how far a voltage must have moved to be called frozen", "WIDE"),
    Field("lost_walk", "variance that SOC gains in one step without a current", "not WIDE"),
    Field("recovery_A", "what branches may hold after a lock-out", "WIDE"),
    Field("bank_A", "what may have flowed for hours before a start under load,", "BANK"),
    Field("past_A", "and beside a load like it", "BANK"),
    Field("least_use_A", "a use takes no longer from full to empty", "BANK"),
    Field("fades", "of samples that share one model error, those whose error fades,", "BANK"),
    Field("stays", "and the share of the error that does not", "BANK"),
    Field("block_steps", "of a block of samples, whose mean is one piece of evidence", "BANK"),
    Field("look_steps", "until the past of a start under load is looked at", "BANK"),
    Field("charge_efficiency", "", "EFFICIENCY"),
    Field("leak_soc", "SOC that self-discharge takes in one step", "LEAK"),
    Field("skew_share", "of the previous current in what the voltage has seen", "SKEW"),
    Field("rate_per_A", "fall of the resistances with the current", "RATE"),
    Field("charge_scale", "factor on the resistances while charging", "ASYMMETRY"),
    Field("asinh_per_V", "of the charge transfer of the fast branch", "TRANSFER"),
    Field("surface_per_A", "SOC that the particles' surface is below", "SURFACE and not DEPTH"),
    Field("surface_gain", "1 - exp(-dt / time constant of the current it follows)", "SURFACE"),
    Field("surface_rate", "dt / that time constant", "SURFACE"),
    Field("hysteresis_per_A", "e-folds of h in one step at 1 A", "HYSTERESIS"),
    Field("persistent", "share of the slow error that comes back at the same SOC", "WIDE"),
    Field("drift_soc", "that a current which is off moves in one step", "WIDE"),
    Field("offset_A", "deviation of an offset of the current beforehand", "OFFSET"),
    Field("rate_A", "1C", "OFFSET"),
    Field("rest_steps", "of a current that stands still, until it shows an offset", "OFFSET"),
    Field("contradicted_share", "dt / 600 s", "WIDE"),
    Field("sketch_rows", "steps from row to row of the sketch", "SKETCH", "u4"),
    Field("sketch_steps", "the same", "SKETCH"),
    Field("sketch_share", "one over that", "SKETCH"),
    Field("sketch_soc", "SOC that 1 A takes in a row", "SKETCH"),
    Field("sketch_most", "rows of a simulation", "SKETCH", "u4"),
    Field("sketch_per_s", "one over a time step", "SKETCH"),
    Field("sketch_fade", "of the sums, in a row", "SKETCH"),
    Field("sketch_keep", "of the model's slow error, from row to row", "SKETCH"),
    Field("sketch_branch", "and of a current that a slow branch has followed", "SKETCH"),
    Field("sketch_path", "e-folds of a hysteresis in a row at 1 A", "SKETCH"),
    Field("sketch_V2", "of a row's voltage, by what is not slow", "SKETCH"),
    Field("sketch_fast", "of the stated error's square, what is not slow,", "SKETCH"),
    Field("sketch_slow", "and what is", "SKETCH"),
    Field("sketch_fast_share", "of a drop's square, what is off and not slow", "SKETCH"),
    Field("sketch_slow_share", "share of a drop that is off, and slow", "SKETCH"),
    Field("sketch_low", "SOC below which nothing is summed", "SKETCH"),
    Field("sketch_soc2", "variance of SOC with which a simulation may begin", "SKETCH"),
    Field("heat_K_per_W", "", "HEATING"),
    Field("heat_gain", "1 - exp(-dt / thermal time constant)", "HEATING"),
    Field("heat_rate", "dt / thermal time constant", "HEATING"),
    Field("temperature_C", "until the first valid one", "WARM"),
    Field("valid_soc_low", "the model's data, tolerance included", "VALIDITY"),
    Field("valid_soc_high", "", "VALIDITY"),
    Field("valid_charge_A", "", "VALIDITY"),
    Field("valid_discharge_A", "", "VALIDITY"),
    Field("share_per_A", "of the polarisation, error beyond their current", "VALIDITY"),
    Field("valid_cold_C", "", "THERMAL"),
    Field("valid_warm_C", "", "THERMAL"),
    Field("share_per_K", "of the polarisation, error beyond their temperature", "THERMAL"),
    Field("voltage_per_K", "of the OCV", "THERMAL"),
    Field("power_steps", "time steps of the horizon of the power", "POWER"),
    Field("power_low_V", "limits that a power keeps", "POWER"),
    Field("power_high_V", "", "POWER"),
    Field("power_discharge_A", "", "POWER"),
    Field("power_charge_A", "without sign", "POWER"),
    Field("power_soc_low", "", "POWER"),
    Field("power_soc_high", "", "POWER"),
    Field("remaining_low_V", "voltage at which a load gives up", "REMAINING"),
    Field("remaining_least_A", "a load below it counts as it", "REMAINING"),
    Field("remaining_share", "two deviations of the capacity, relative", "REMAINING"),
    Field("step_s", "the time step", "REMAINING"),
    Field("cell_soc2", "variance of the cells' differences at the start: of SOC,", "CELLS"),
    Field("cell_capacity2", "capacity, relative,", "CELLS"),
    Field("cell_resistance2", "resistance, relative,", "CELLS"),
    Field("cell_soc_walk", "and gained in one step", "CELLS"),
    Field("cell_capacity_walk", "", "CELLS"),
    Field("cell_resistance_walk", "", "CELLS"),
    Field("cell_V2", "of a cell's sensor beside the others'", "CELLS"),
    Field("cell_shared", "samples that share one error of a cell's voltage", "CELLS"),
    Field("cell_lag", "square of the delay of a cell's polling, in steps", "CELLS"),
    Field("cell_least_soc2", "what a sensor's offset leaves unknown of a cell's SOC", "CELLS"),
    Field("cell_turns", "samples in which every cell has its turn once", "CELLS", "u4"),
    Field("cell_recovery", "rejections in a row, then a cell's SOC is unknown", "CELLS", "u4"),
    Field("soh_rest_A", "below it a cell rests, to millivolts,", "SOH"),
    Field("soh_steps", "and after so many steps its voltage is the OCV", "SOH", "u4"),
    Field("soh_capacity", "by what share of the model's a cell's may differ when new", "SOH"),
    Field("soh_load_A", "of a load that shows the resistance, at least,", "SOH"),
    Field("soh_load_steps", "within so many steps after a rest", "SOH", "u4"),
    Field("soh_drift", "SOC that an offset of one deviation takes in one step", "SOH"),
    Field("grid_C", "temperatures of the tables", "TEMPERATURES", "f4", "temperatures"),
    Field("per_K", "1 / distance of neighbours", "TEMPERATURES", "f4", "temperatures", 1),
    Field("arrhenius_low_C", "", "ARRHENIUS"),
    Field("arrhenius_per_K", "points per kelvin", "ARRHENIUS"),
    Field("arrhenius", "factor on every resistance", "ARRHENIUS", "f4", "arrhenius"),
    Field("depth_low_C", "", "DEPTH"),
    Field("depth_per_K", "points per kelvin", "DEPTH"),
    Field("depth", "SOC that the surface is below at 1 A", "DEPTH", "f4", "depth"),
)


def _option(*states: State) -> str:
    return " and ".join(dict.fromkeys(s.option.upper() for s in states if s.option))


def _state() -> tuple[Field, ...]:
    """The state x, the upper triangle of P row by row, what was seen last."""
    found = []
    for state in STATES:
        found.append(Field(state.name, state.meaning, _option(state)))
        if state in CARRIED:
            meaning = f"what rounding has kept from {state.name}, to be subtracted"
            found.append(Field(carry(state), meaning, _option(state)))
    for a, b in triangle(STATES):
        found.append(Field(entry(a, b), "", _option(a, b)))
        if b is SOC:
            found.append(Field("ss_carry", "what rounding has kept from ss", "WIDE"))
    return (
        *found,
        Field("current_A", "last valid one"),
        Field("mismatch", "running mean of squared innovation over variance"),
        Field("heat_K", "own warming", "HEATING"),
        Field("slow_A", "current behind the lag of the particles' surface", "SURFACE"),
        Field("temperature_C", "last valid one", "WARM"),
        Field("contradicted", "SOC that the voltages say is missing", "WIDE"),
        Field("persistent", "SOC error by a persistent error of the model", "WIDE"),
        Field("voltage_V", "last valid one,", "WIDE"),
        Field("frozen_A", "the current when it came,", "WIDE"),
        Field("repeats", "and how often it has come since; 4: frozen", "WIDE"),
        Field("swings", "of the voltage while the current repeats itself; last one's sign", "WIDE"),
        Field("no_current", "steps without a valid one", "WIDE", "u4"),
        Field("no_voltage", "steps without one that could be used", "WIDE", "u4"),
        Field("reach", "SOC that an offset of one deviation has put it too low,", "OFFSET"),
        Field("score", "what is known of the offset: mean over variance,", "OFFSET"),
        Field("information", "one over the variance,", "OFFSET"),
        Field("believed", "mean and variance with the chance of none,", "OFFSET"),
        Field("unsure", "", "OFFSET"),
        *(Field(CALLED["d"](s), "", "OFFSET and SLOW" if s.option else "OFFSET") for s in BRANCHES),
        Field("rest", "steps that the current has stood still near zero, -1: used,", "OFFSET"),
        Field("rest_A", "and at what", "OFFSET"),
        Field("cost", "minus the logarithm of its likelihood, beside the likeliest", "BANK"),
        Field("weight", "share of the bank", "BANK"),
        Field("error_V2", "variance of the next innovation, while a bank is open", "BANK"),
        Field("in_bank", "0: alone, 1: a component, 2: contradicted, 3: not counted", "BANK", "u4"),
        Field("per_capacity", "inverse of the share of the capacity that is left", "HEALTH"),
        Field("resistance_scale", "of the resistances since", "HEALTH"),
        Field("mean_V", "of the cells at their last sample,", "CELLS"),
        Field("cells_at", "its sequence,", "CELLS", "u4"),
        Field("turn", "and the first cell whose turn is next", "CELLS", "u4"),
        Field("sequence", "of the last sample", "", "u4"),
        Field("rejections", "steps rejected in a row", "", "u4"),
        Field("evidence", "0: no sample yet, 1: no voltage yet, then 2 + steps since", "", "u4"),
    )


def _sketch() -> tuple[Field, ...]:
    """Header, sums, then what is carried from block to block."""
    return (
        Field("magic", "set with the CRC by `cellwise_seal_sketch`", "", "u4"),
        Field("model_crc", "of the tables", "", "u4"),
        Field("unit", "number of the target", "", "u4"),
        Field("degrees", "sum of temperatures, over rows"),
        Field("segments", "simulations that were summed,"),
        Field("rows", "and their rows, faded as the sums are"),
        Field("sum", "of products, by pairs", "", "f4", "sketch_sums"),
        Field("part", "those of this simulation", "SKETCH_LARGE", "f4", "sketch_sums"),
        Field("past", "slow part of residual and derivatives,", "", "f4", "sketch"),
        Field("past_share", "and what is a share of the drop", "SKETCH_LARGE", "f4", "sketch"),
        Field("now", "their news in the last row", "", "f4", "sketch"),
        Field("slow", "variance of the slow part, of its own; below 0: no row yet"),
        Field("share", "that of the share,", "SKETCH_LARGE"),
        Field("both", "and their covariance", "SKETCH_LARGE"),
        Field("soc", "of the simulation"),
        Field("start_soc", "", "SKETCH_LARGE"),
        *(Field(CALLED["state"](s), "", s.option.upper()) for s in BRANCHES),
        Field("fast_ohm", "of the first branch, since the last row,"),
        Field("fast_gain", "and what it follows in a step"),
        Field("h", "", "HYSTERESIS"),
        Field("slow_A", "current that a slow branch has followed"),
        Field("path", "hysteresis that the model may lack"),
        Field("sum_A", "since the last row"),
        Field("last_A", "current of the last sample"),
        Field("count", "samples since the last row; all bits set: no simulation", "", "u4"),
        Field("blocks", "rows since the simulation began", "", "u4"),
        Field("sequence", "of the last sample", "", "u4"),
        Field("crc", "of all before it", "", "u4"),
    )


# By the name of its kind in the functions of the step.
RECORDS = {
    "Constants": CONSTANTS,
    "State": _state(),
    "Bank": (
        Field("mean_A", "of the load since a start under load,"),
        Field("looked_A", "and what it was at the last look"),
        Field("mismatch", "running mean of squared innovation over variance"),
        Field("spread", "1: the components are stepped, 0: the estimate alone", "", "u4"),
        Field("likeliest", "which component, from 1 on", "", "u4"),
        Field("since", "steps since the start"),
        Field("looks", "how often the past has been looked at", "", "u4"),
        Field("next_look", "when it is next"),
        *(
            Field(s.name, "of the estimate where a block began" if s is SOC else "", _option(s))
            for s in STATES
        ),
        Field("ss"),
        Field("steps", "of the block,"),
        Field("samples", "its samples,"),
        Field("readings", "and those with a voltage;"),
        Field("off_V", "the mean of their innovations,"),
        Field("block_A", "of their current,"),
        Field("unknown_A2", "and of a current that nobody measured"),
        Field("first_V2", "its first innovation's variance"),
        Field("known", "1: a voltage has been used before it", "", "u4"),
        Field("turn", "the component that follows the last block next; 0: none", "", "u4"),
        Field("look", "at the past, that goes with it", "", "u4"),
        Field("moved", "what it has done: to the SOC,"),
        Field("grown", "to its variance,"),
        *(
            Field(f"gain{s.letter}", "to the branches, each" if s is V1 else "", _option(s))
            for s in BRANCHES
        ),
        *(
            Field(f"current{s.letter}", "by a current," if s is V1 else "", _option(s))
            for s in BRANCHES
        ),
        Field("square_A2", "of which so much is not known,"),
        Field("keep_h", "and to h", "HYSTERESIS"),
        Field("rise_h", "", "HYSTERESIS"),
        Field("said_V", "its voltage,"),
        Field("said_A", "under this current,"),
        Field("error_V2", "its variance,"),
        Field("weight_V2", "and what it weighs with,"),
        Field("below", "over this;"),
        Field("share", "how much of it is new"),
        Field("lately", "its weight in the running mismatch"),
        Field("mean_off_V", "off what components have expected, their mean,"),
        Field("square_V2", "mean square,"),
        Field("own_V2", "and variance;"),
        Field("left_V", "the same after it, their mean,"),
        Field("left_V2", "mean square"),
        Field("sequence", "of the last sample", "", "u4"),
    ),
    "Sample": (
        Field("current_A", "mean over the interval that ends now, positive on discharge"),
        Field("voltage_V", "now"),
        Field("temperature_C", "now; read only where CELLWISE_NEEDS_TEMPERATURE"),
        Field("sequence", "counts time steps, wraps", "", "u4"),
    ),
    "Output": (
        Field("soc"),
        Field("soc_variance"),
        Field("voltage_V", "predicted, before the measured one was used"),
        Field("innovation_V", "measured minus predicted; 0 where the voltage is invalid"),
        Field("innovation_variance_V2", "of a single sample"),
        Field("status", "what happened: bits", "", "u4"),
    ),
    "Capability": (
        Field("discharge_W", "what the cell can give,"),
        Field("discharge_low_W", "and sustains with 95 %"),
        Field("charge_W", "what it can take, without sign,"),
        Field("charge_low_W", "and sustains with 95 %"),
    ),
    "Outlook": (
        Field("time_s", "until the load reaches the cutoff, or the cell is empty"),
        Field("time_low_s", "two deviations less"),
        Field("time_high_s", "two deviations more"),
        Field("energy_J", "out until then"),
        Field("energy_low_J"),
        Field("energy_high_J"),
    ),
    "Phase": (
        Field("seconds", "that it lasts"),
        Field("load", "current [A], or power [W], positive on discharge"),
    ),
    "PlanResult": (
        Field("soc", "at the plan's end"),
        Field("soc_low", "two deviations less"),
        Field("soc_high", "two deviations more"),
        Field("least_V", "lowest voltage of the way"),
        Field("least_low_V", "two deviations less"),
        Field("energy_J", "given"),
        Field(
            "failed_s", "when the voltage is at the cutoff, or the cell empty; 1e9: not in the plan"
        ),
        Field("chance", "to end at the SOC asked for or more, above the cutoff all the way"),
    ),
    "Cell": (
        Field("soc", "more than the mean cell's, where that is 50 %"),
        Field("capacity", "more than the mean cell's, relative"),
        Field("resistance", "more than the mean cell's, relative"),
        Field("ss", "their covariance"),
        Field("sq"),
        Field("sr"),
        Field("qq"),
        Field("qr"),
        Field("rr"),
        Field("seen_at", "sequence of its last turn", "", "u4"),
        Field("rejections", "in a row", "", "u4"),
        Field("status", "of the last sample: bits", "", "u4"),
    ),
    "CellOutput": (
        Field("soc"),
        Field("soc_variance"),
        Field("capacity_share", "of the mean cell's"),
        Field("capacity_variance"),
        Field("resistance_scale", "beside the mean cell's"),
        Field("resistance_variance"),
        Field("status", "of the last sample: bits", "", "u4"),
    ),
    "Soh": (
        Field("share", "of the tables' capacity that is left,"),
        Field("share_variance", "and its variance"),
        Field("off", "offset of the current, in its deviations beforehand"),
        Field("qq", "covariance of the two that weighs,"),
        Field("qo"),
        Field("oo"),
        Field("own_qq", "and that beside an error of the OCV's table"),
        Field("own_qo"),
        Field("own_oo"),
        Field("share_error", "what an error of the OCV's table has moved in them"),
        Field("off_error"),
        Field("soc", "of the rest that is counted from,"),
        Field("variance", "its variance; 0: there is none"),
        Field("counted", "SOC that has left since"),
        Field("counted_carry", "what rounding has kept from it"),
        Field("moved", "SOC that flowed since, either way"),
        Field("unsure", "variance of what flowed in gaps since"),
        Field("current_A", "of the last sample"),
        Field("voltage_V", "last one of a long rest"),
        Field("held_V", "by the branches then"),
        Field("counted_from", "sequence of the sample that ended it", "", "u4"),
        Field("loaded", "sequence of the last sample with a load", "", "u4"),
        Field("silent", "steps without a current; not with CELLWISE_WIDE", "", "u4"),
        Field("resistance", "scale of the tables' resistances,"),
        Field("resistance_variance", "and its variance"),
        Field("rr", "that which weighs, beside the model's own error"),
        Field("watched", "1: a long rest, 2: the first load after it", "", "u4"),
        Field("rest_end", "sequence of its last sample", "", "u4"),
        Field("loads", "after a rest that were used", "", "u4"),
        Field("pairs", "of rests that were used", "", "u4"),
        Field("refused", "pairs in a row that were not", "", "u4"),
        Field("sequence", "of the last sample", "", "u4"),
        Field("begun", "0: no sample yet", "", "u4"),
    ),
    "SohOutput": (
        Field("share", "of the tables' capacity that is left,"),
        Field("share_variance", "and its variance"),
        Field("resistance", "scale of the tables' resistances,"),
        Field("resistance_variance", "and its variance"),
    ),
    "Sketch": _sketch(),
}
IN_C = {"Sample": "input", "Cell": "pack_cell"}  # where its name in C is another


def c_name(kind: str) -> str:
    """Name of a record in C."""
    return "cellwise_" + IN_C.get(kind, re.sub(r"(?<!^)([A-Z])", r"_\1", kind).lower())


def fields_of(table: tuple[Field, ...], options: Options) -> list[Field]:
    """The fields that are compiled in, in order."""
    flags = flags_of(options)

    def there(term: str) -> bool:
        return not flags[term[4:]] if term.startswith("not ") else bool(flags[term])

    return [f for f in table if not f.option or all(map(there, f.option.split(" and ")))]


def _record_type(table: tuple[Field, ...], options: Options) -> np.dtype[Any]:
    return np.dtype(
        [
            (f.name, f.type, (getattr(options, f.size) - f.fewer,) if f.size else ())
            for f in fields_of(table, options)
        ],
        align=True,
    )


INPUT, OUTPUT, CAPABILITY, OUTLOOK, PHASE, PLAN_RESULT, CELL, CELL_OUTPUT, SOH, SOH_OUTPUT = (
    _record_type(fields, Options(points=3)) for fields in [*RECORDS.values()][3:-1]
)


def row_names(options: Options) -> list[str]:
    """Columns of the table, in order."""
    return [f.name for f in fields_of(ROW, options)]


def state_type(options: Options) -> np.dtype[Any]:
    """Record type of the state."""
    return _record_type(RECORDS["State"], options)


def bank_type(options: Options) -> np.dtype[Any]:
    """Record type of a bank."""
    return _record_type(RECORDS["Bank"], options)


def constant_type(options: Options) -> np.dtype[Any]:
    """Record type of the constants."""
    return _record_type(CONSTANTS, options)


def sketch_type(options: Options) -> np.dtype[Any]:
    """Record type of a sketch."""
    return _record_type(RECORDS["Sketch"], options)


def row_type(options: Options) -> np.dtype[Any]:
    """Record type of a table row: float32 only, so that a table is also an array."""
    return _record_type(ROW, options)


def hex_float(value: float) -> str:
    """A float32 as a C literal that every compiler reads to the same bits."""
    mantissa, exponent = float(np.float32(value)).hex().split("p")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{mantissa}p{exponent}f"
