"""A cell gone on with from its state now: a load to empty, a charger to full, a plan."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, part, rows
from cellwise.cell.equations import BEYOND, CellState, CellTables, advance, voltage_of, with_soc
from cellwise.cell.packed import changed
from cellwise.cell.plausibility.validity_kernels import (
    ValidityScalars,
    extrapolation_V,
    soc_extrapolation_V,
)
from cellwise.forecast.warming_kernels import Thermal, Warmth, warmed_to
from cellwise.typing import FloatArray

# Of a model that does not say how far along the SOC its error stays: those of measured cells that
# do say 0.07 to 0.37.
USUAL_MEMORY_SOC = 0.2
# Twice as far as a charge at constant voltage lasts from what a model says, as a factor: nobody
# identifies a model there, and slow diffusion makes it longer (1 to 3 times on four cells).
TAIL_FACTOR = 3.0
# Why a forecast ended.
BY_CHARGE, BY_VOLTAGE, NEVER, BY_CURRENT = 0.0, 1.0, 2.0, 3.0
STEPS = 400  # from full to empty
LONGEST = 8  # times that at the present current
TRIED = 0.9  # of a charger's current, to see what the voltage makes of it
POWER_TURNS = 20  # of a given power to the current that it takes now
PLAN_TURNS = 3  # of a plan's: an error of a per cent of the voltage is below 1e-6 then


class Uncertain(NamedTuple):
    """How far a model's voltage may come to lie off what it is off by now.

    ``share`` of the polarisation and the point's own slow error, both another one once the SOC has
    moved on by ``memory_soc``; outside ``valid`` an OCV that nobody measured. The cell's capacity
    is the model's to ``capacity_std``, as a share.
    """

    share: float
    memory_soc: float
    valid: ValidityScalars
    capacity_std: float


class LoadScenario(NamedTuple):
    """What goes on, from one moment.

    Parameters
    ----------
    load_A : float          current now; below zero: a charger's
    hold_power : bool       keep load times voltage, not the current (a rotor, a drive)
    power_W : float         which power; NaN: what the current makes of the voltage now
    offset_V : float        measured minus modelled voltage that stays whatever the load does
    of_polarisation : float  and what of it is a share of the polarisation, as a share
    cutoff_V : float        terminal voltage at which the load gives up, or that a charger holds
    temperature_C : float   now
    lump : Thermal          how it will change
    taper_A : float         current at which a charger ends, above zero
    """

    load_A: float
    hold_power: bool
    power_W: float
    offset_V: float
    of_polarisation: float
    cutoff_V: float
    temperature_C: float
    lump: Thermal
    taper_A: float = 0.0


class SigmaOffset(NamedTuple):
    """By how many deviations a forecast goes away from the usual one in SOC, voltage, warmth."""

    soc: float
    voltage: float
    warmth: float


USUAL = SigmaOffset(0.0, 0.0, 0.0)


class Remaining(NamedTuple):
    """Time, energy, voltage and SOC at the end of a forecast, and why it ended.

    The energy is what a load takes out or a charger gives; ``tail_s`` is the part of the time in
    which a charger holds its voltage.
    """

    time_s: float
    energy_J: float
    voltage_V: float
    soc: float
    reason: float
    tail_s: float


class Ends(NamedTuple):
    """Two deviations less, and more."""

    low: float
    high: float


class ForecastOutcome(NamedTuple):
    """A forecast, its ends at two deviations of time, energy and end voltage, the load it began."""

    usual: Remaining
    time_s: Ends
    energy_J: Ends
    voltage_V: Ends
    load_A: float


class PlanResult(NamedTuple):
    """Where a plan ends: SOC, lowest voltage of the way, energy given."""

    soc: float
    least_V: float
    energy_J: float


class ForecastState(NamedTuple):
    """A cell on its way after an interval: state, current, terminal voltage, temperature.

    ``ocv_V``, ``error_V`` and ``held_V`` are the OCV, the model's slow error there and the
    polarisation; ``known_V`` is the error outside the model's data at the beginning, ``shift_V`` by
    what the voltage of a forecast away from the usual one is off in the next interval.
    """

    cell: CellState
    current_A: float
    voltage_V: float
    ocv_V: float
    error_V: float
    held_V: float
    warmth: Warmth
    here_C: float
    known_V: float
    shift_V: float


@part
def gone(
    tables: CellTables, was: ForecastState, current_A: float, dt_s: float, go: LoadScenario
) -> ForecastState:
    """An interval of constant current; temperature and what is not known of the voltage stay."""
    cell, point = advance(tables, was.cell, current_A, dt_s, was.here_C)
    model_V = voltage_of(point, cell, current_A)
    held_V = point.ocv_V - model_V
    voltage_V = model_V + go.offset_V + go.of_polarisation * held_V + was.shift_V
    return ForecastState(
        cell, current_A, voltage_V, point.ocv_V, point.error_V, held_V,
        was.warmth, was.here_C, was.known_V, was.shift_V,
    )  # fmt: skip


@part
def settled(
    now: ForecastState,
    dt_s: float,
    begun_soc: float,
    go: LoadScenario,
    uncertain: Uncertain,
    away: SigmaOffset,
) -> ForecastState:
    """The temperature at an interval's end, and what the voltage may have come to be off by.

    What the model is off by outside its validity is in its present error already; what nobody has
    seen yet is its error further outside than the present one, and what it will be at another SOC:
    of an error of deviation sigma that is e here and correlated by rho with that over there,
    (1 - rho) e is expected to go, and sigma sqrt(1 - rho^2) is new.
    """
    valid = uncertain.valid
    warmth, here_C, shift_V = now.warmth, now.here_C, 0.0
    if go.lump.heats:
        lost_W = now.current_A * (now.ocv_V - now.voltage_V)
        warmth, here_C = warmed_to(go.lump, warmth, lost_W, dt_s, away.warmth)
    beyond_V = extrapolation_V(valid, here_C, now.current_A, abs(now.held_V))
    known_V = now.known_V if now.known_V == now.known_V else beyond_V
    if away.voltage != 0.0:
        wrong_V = uncertain.share * now.held_V
        moved_soc = abs(begun_soc - now.cell.soc)
        kept = math.exp(-moved_soc / uncertain.memory_soc)
        gone_V = (1.0 - kept) * (go.offset_V + go.of_polarisation * now.held_V)
        new_V = max(beyond_V - known_V, 0.0)
        square = (now.error_V * now.error_V + wrong_V * wrong_V) * (1.0 - kept * kept)
        square += gone_V * gone_V
        off_V = math.sqrt(square + new_V * new_V)
        if now.cell.soc < valid.soc_low:
            known_soc_V = soc_extrapolation_V(valid, begun_soc)
            off_V += max(soc_extrapolation_V(valid, now.cell.soc) - known_soc_V, 0.0)
        shift_V = away.voltage * off_V
    return ForecastState(
        now.cell, now.current_A, now.voltage_V, now.ocv_V, now.error_V, now.held_V,
        warmth, here_C, known_V, shift_V,
    )  # fmt: skip


@part
def begun(
    tables: CellTables, state: CellState, soc_std: float, go: LoadScenario, away: SigmaOffset
) -> ForecastState:
    """The first moment under the load, from deviations beside the state."""
    at = with_soc(state, min(max(state.soc + away.soc * soc_std, 0.0), 1.0))
    warmth = Warmth(go.temperature_C - go.lump.origin_C, 0.0, 0.0, 0.0)
    here = ForecastState(at, go.load_A, 0.0, 0.0, 0.0, 0.0, warmth, go.temperature_C, math.nan, 0.0)
    return gone(tables, here, go.load_A, 0.0, go)


@part
def as_seen(
    tables: CellTables,
    state: CellState,
    soc_std: float,
    go: LoadScenario,
    uncertain: Uncertain,
    away: SigmaOffset,
) -> LoadScenario:
    """The same from another SOC: what the voltage was, it was; the model is off by something else.

    By at most two deviations of its error: what a filter has not made of a voltage yet, no error
    of the model explains.
    """
    if away.soc == 0.0:
        return go
    usual = begun(tables, state, soc_std, go, USUAL)
    off_V = usual.voltage_V - begun(tables, state, soc_std, go, away).voltage_V
    most_V = 2.0 * math.hypot(usual.error_V, uncertain.share * usual.held_V)
    return changed(go, "offset_V", go.offset_V + min(max(off_V, -most_V), most_V))


@part
def at_limit(
    tables: CellTables, was: ForecastState, over: ForecastState, dt_s: float, go: LoadScenario
) -> ForecastState:
    """An interval at the charger's voltage: the voltage is nearly linear in the current."""
    less = gone(tables, was, TRIED * over.current_A, dt_s, go)
    slope = (over.voltage_V - less.voltage_V) / (less.current_A - over.current_A)
    current = min(over.current_A + (over.voltage_V - go.cutoff_V) / max(slope, 1e-12), 0.0)
    return changed(gone(tables, was, current, dt_s, go), "voltage_V", go.cutoff_V)


@part
def until_end(
    tables: CellTables,
    first: ForecastState,
    go: LoadScenario,
    uncertain: Uncertain,
    away: SigmaOffset,
) -> Remaining:
    """Go on with a load until its cutoff or the charge's end, with a charger until it ends.

    Notes
    -----
    A charger's current is held until the terminal voltage is the charger's; from there the current
    is the one that keeps it. Where the OCV of a model ends below that voltage the charge ends 5 %
    above its full one. What the model is off by stays, and may become another error ahead.

    Steps of 1/400 of the capacity at the present current; the last one is cut where the voltage, or
    a charger's current, taken as linear within it, crosses its end, or where the charge ends.
    """
    charging = go.load_A < 0.0
    dt_s = tables.cell.charge_As / (STEPS * abs(go.load_A))
    asked_W = go.load_A * max(first.voltage_V, go.cutoff_V)
    power_W = go.power_W if go.power_W == go.power_W else asked_W
    now = first
    time_s = energy_J = tail_s = 0.0
    for _ in range(LONGEST * STEPS):
        current = now.current_A
        if go.hold_power and not charging:
            current = power_W / max(now.voltage_V, go.cutoff_V)
        then = gone(tables, now, current, dt_s, go)
        held_s = 0.0
        if charging and then.voltage_V > go.cutoff_V:
            then = at_limit(tables, now, then, dt_s, go)
            held_s = dt_s
        then = settled(then, dt_s, first.cell.soc, go, uncertain, away)
        share, reason = 1.0, NEVER
        if charging:
            if -then.current_A <= go.taper_A:
                share = (now.current_A + go.taper_A) / min(now.current_A - then.current_A, -1e-12)
                share = min(max(share, 0.0), 1.0)
                reason = BY_CURRENT
            elif then.cell.soc >= 1.0 + BEYOND:
                reason = BY_CHARGE
        else:
            if then.cell.soc <= 0.0:
                share = max(now.cell.soc, 0.0) / max(now.cell.soc - then.cell.soc, 1e-12)
                reason = BY_CHARGE
            if then.voltage_V <= go.cutoff_V:
                fall_V = max(now.voltage_V - then.voltage_V, 1e-12)
                crossing = max((now.voltage_V - go.cutoff_V) / fall_V, 0.0)
                if reason == NEVER or crossing < share:
                    share, reason = crossing, BY_VOLTAGE
        end_V = now.voltage_V + share * (then.voltage_V - now.voltage_V)
        mean_A = 0.5 * (now.current_A + then.current_A) if charging else then.current_A
        time_s += share * dt_s
        tail_s += share * held_s
        energy_J += share * dt_s * abs(mean_A) * 0.5 * (now.voltage_V + end_V)
        if reason != NEVER:
            soc = now.cell.soc + share * (then.cell.soc - now.cell.soc)
            return Remaining(time_s, energy_J, end_V, soc, reason, tail_s)
        now = then
    return Remaining(time_s, energy_J, now.voltage_V, now.cell.soc, NEVER, tail_s)


@inline
def ends(usual: float, sides: tuple[Ends, Ends, Ends], share: float) -> Ends:
    """Two deviations either way by four causes that know nothing of each other.

    SOC, voltage and warmth give what remains at both of their ends, the capacity is a ``share`` of
    what remains, one deviation.
    """
    below = above = (2.0 * share * usual) ** 2
    for one, other in sides:
        below += max(usual - min(one, other), 0.0) ** 2
        above += max(max(one, other) - usual, 0.0) ** 2
    return Ends(max(usual - math.sqrt(below), 0.0), usual + math.sqrt(above))


@part
def with_current(tables: CellTables, state: CellState, go: LoadScenario) -> LoadScenario:
    """The same with the current at which the load has its power now.

    A power beyond what the cell can give has none: the voltage is then below any cutoff.
    """
    current = go.load_A
    for _ in range(POWER_TURNS):
        now = begun(tables, state, 0.0, changed(go, "load_A", current), USUAL)
        if now.voltage_V <= 0.0:
            break
        current = go.power_W / now.voltage_V
    return changed(go, "load_A", current)


@part
def remaining_at(
    tables: CellTables,
    state: CellState,
    soc_std: float,
    go: LoadScenario,
    uncertain: Uncertain,
    away: SigmaOffset,
) -> Remaining:
    """A forecast from deviations beside the state."""
    seen = as_seen(tables, state, soc_std, go, uncertain, away)
    return until_end(tables, begun(tables, state, soc_std, seen, away), seen, uncertain, away)


@rows
def with_ends(
    tables: CellTables, state: CellState, soc_std: float, asked: LoadScenario, uncertain: Uncertain
) -> ForecastOutcome:
    """A forecast from a state, and its ends: by what is not known of SOC, voltage and capacity."""
    go = with_current(tables, state, asked) if asked.power_W == asked.power_W else asked
    usual = remaining_at(tables, state, soc_std, go, uncertain, USUAL)
    low = remaining_at(tables, state, soc_std, go, uncertain, SigmaOffset(-2.0, 0.0, 0.0))
    high = remaining_at(tables, state, soc_std, go, uncertain, SigmaOffset(2.0, 0.0, 0.0))
    lower = remaining_at(tables, state, soc_std, go, uncertain, SigmaOffset(0.0, -2.0, 0.0))
    higher = remaining_at(tables, state, soc_std, go, uncertain, SigmaOffset(0.0, 2.0, 0.0))
    cold = warm = usual
    if go.lump.heats:
        cold = remaining_at(tables, state, soc_std, go, uncertain, SigmaOffset(0.0, 0.0, -2.0))
        warm = remaining_at(tables, state, soc_std, go, uncertain, SigmaOffset(0.0, 0.0, 2.0))
    by_time = (
        Ends(low.time_s, high.time_s), Ends(lower.time_s, higher.time_s),
        Ends(cold.time_s, warm.time_s),
    )  # fmt: skip
    by_energy = (
        Ends(low.energy_J, high.energy_J), Ends(lower.energy_J, higher.energy_J),
        Ends(cold.energy_J, warm.energy_J),
    )  # fmt: skip
    time_s = ends(usual.time_s, by_time, uncertain.capacity_std)
    energy_J = ends(usual.energy_J, by_energy, uncertain.capacity_std)
    if go.load_A < 0.0:
        # A voltage that is higher ends the constant current earlier and the constant voltage later:
        # the longest charge lies between the ends.
        for share in (0.5, 1.0, 1.5):
            between = remaining_at(
                tables, state, soc_std, go, uncertain, SigmaOffset(0.0, share, 0.0)
            )
            time_s = Ends(min(time_s.low, between.time_s), max(time_s.high, between.time_s))
    if usual.tail_s > 0.0:
        less, more = usual.tail_s * (1.0 - 1.0 / TAIL_FACTOR), usual.tail_s * (TAIL_FACTOR - 1.0)
        low_s = usual.time_s - math.hypot(usual.time_s - time_s.low, less)
        high_s = usual.time_s + math.hypot(time_s.high - usual.time_s, more)
        time_s = Ends(max(low_s, 0.0), high_s)
    if usual.reason != NEVER and (high.reason == NEVER or higher.reason == NEVER):
        time_s, energy_J = Ends(time_s.low, math.inf), Ends(energy_J.low, math.inf)
    at_end = Ends(min(low.voltage_V, high.voltage_V), max(low.voltage_V, high.voltage_V))
    return ForecastOutcome(usual, time_s, energy_J, at_end, go.load_A)


@rows
def through(
    tables: CellTables,
    state: CellState,
    soc_std: float,
    plan: tuple[FloatArray, FloatArray],
    planned: LoadScenario,
    uncertain: Uncertain,
    away: SigmaOffset,
) -> PlanResult:
    """Carry a cell through a plan; deviations away from the usual as in a forecast at one load.

    Below the cutoff a power is limited to its current at the cutoff.

    Parameters
    ----------
    plan : (n,), (n,)     length of each step [s], its power [W], or its current [A] where
                          ``planned`` holds no power; positive on discharge
    planned : LoadScenario    with no load yet
    """
    dt_s, load = plan
    go = as_seen(tables, state, soc_std, planned, uncertain, away)
    now = begun(tables, state, soc_std, go, away)
    begun_soc, least_V, energy_J = now.cell.soc, now.voltage_V, 0.0
    for k in range(dt_s.size):
        then, current = now, load[k]
        for _ in range(PLAN_TURNS if go.hold_power else 1):
            if go.hold_power:
                current = load[k] / max(then.voltage_V, go.cutoff_V)
            then = gone(tables, now, current, dt_s[k], go)
        now = settled(then, dt_s[k], begun_soc, go, uncertain, away)
        energy_J += dt_s[k] * now.current_A * now.voltage_V
        least_V = min(least_V, now.voltage_V)
    return PlanResult(now.cell.soc, least_V, energy_J)
