"""Cells of a pack on one table: the mean cell by the step, every cell by its difference from it.

To first order a cell's voltage minus the mean cell's is

    s (delta + kappa (1/2 - z)) - rho U

with z the mean cell's SOC, s the slope of its OCV and U its polarisation (Plett, Battery Management
Systems II, 2015, ch. 4: bar-delta filtering). delta, kappa and rho are the cell's differences in
SOC at 50 %, in capacity and in resistance, the last two relative. An error of the model or of the
current sensor moves the mean cell and no difference.
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.description import BRANCHES
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Place, look_up, place_now
from cellwise.estimate.fixed.state import is_sound
from cellwise.estimate.power.fixed_power import Way, ending, one_way
from cellwise.estimate.status import (
    GATE_RECOVERY,
    INNOVATION_REJECTED,
    STATE_RESET,
    VOLTAGE_INVALID,
)


class Difference(NamedTuple):
    """Derivatives of a cell's voltage minus the mean's, and its variance about that.

    ``single_V2`` is that of one sample, ``variance_V2`` of one that shares its error with others.
    """

    soc_V: float
    capacity_V: float
    resistance_V: float
    single_V2: float
    variance_V2: float


def cell_is_sound(a: Cell) -> bool:
    """Every number in its range: memory that lost its content, or was never set, is noticed."""
    if not (size_within(a.soc, 1.0) and size_within(a.capacity, CELL_MOST)):
        return False
    if not within(a.resistance, -CELL_MOST, SCALE_MOST):
        return False
    if not (not_negative(a.ss, LARGE) and not_negative(a.qq, LARGE) and not_negative(a.rr, LARGE)):
        return False
    return size_within(a.sq, LARGE) and size_within(a.sr, LARGE) and size_within(a.qr, LARGE)


@noinline
def start_cell(c: Constants, a: Cell) -> None:
    """A cell of which only is known how far cells usually differ."""
    a.soc = 0.0
    a.capacity = 0.0
    a.resistance = 0.0
    a.ss = c.cell_soc2
    a.sq = 0.0
    a.sr = 0.0
    a.qq = c.cell_capacity2
    a.qr = 0.0
    a.rr = c.cell_resistance2
    a.seen_at = U(0)
    a.rejections = U(0)
    a.status = U(0)


def start_cells(m: Model, cells: Cells, count: int) -> None:
    """The cells of a pack before their first sample; after `cellwise_init` of the mean cell."""
    for k in range(count):
        start_cell(m.constant, cells[k])


def mean_voltage(m: Model, cells: Cells, voltage_V: Floats, count: int) -> float:
    """Mean voltage of the cells: what the step of the mean cell is to be given.

    Without readings that no cell gives; without cells whose last voltage was rejected, while these
    are the fewer; -1, which the step takes for a missing voltage, where no cell is left.
    """
    c = m.constant
    first = -1.0
    total = 0.0
    unsure = 0.0
    used = U(0)
    left_out = U(0)
    for k in range(count):
        if within(voltage_V[k], c.voltage_low_V, c.voltage_high_V):
            if first < 0.0:
                first = voltage_V[k]
            if cells[k].rejections == U(0):
                total = total + (voltage_V[k] - first)
                used = U(used + 1)
            else:
                unsure = unsure + (voltage_V[k] - first)
                left_out = U(left_out + 1)
    if left_out >= used:
        total = total + unsure
        used = U(used + left_out)
    if used != U(0):
        first = first + (total / F(used))
    return first


def difference_of(m: Model, place: Place, x: State, mean_V: float) -> Difference:
    """The derivatives at the mean cell's SOC.

    A cell that is polled late reads what the mean voltage moved by meanwhile.
    """
    c = m.constant
    p = look_up(m, place, x.soc, x.current_A)
    moved_V = mean_V - x.mean_V
    single_V2 = c.cell_V2 + (c.cell_lag * (moved_V * moved_V))
    variance_V2 = single_V2 * c.cell_shared
    capacity_V = p.slope_V * (0.5 - x.soc)
    resistance_V = mean_V - p.ocv_V
    return Difference(p.slope_V, capacity_V, resistance_V, single_V2, variance_V2)


@noinline
def look_again(a: Cell) -> None:
    """After many rejections in a row a cell's SOC is unknown."""
    a.ss = RECOVERY_VARIANCE
    a.sq = 0.0
    a.sr = 0.0
    a.rejections = U(0)
    a.status = U(a.status | GATE_RECOVERY)


def use_voltage(c: Constants, a: Cell, d: Difference, above_V: float) -> None:
    """Use a cell's voltage above the mean: three states, one measurement."""
    gain_s = ((a.ss * d.soc_V) + (a.sq * d.capacity_V)) + (a.sr * d.resistance_V)
    gain_q = ((a.sq * d.soc_V) + (a.qq * d.capacity_V)) + (a.qr * d.resistance_V)
    gain_r = ((a.sr * d.soc_V) + (a.qr * d.capacity_V)) + (a.rr * d.resistance_V)
    explained_V2 = (d.soc_V * gain_s) + ((d.capacity_V * gain_q) + (d.resistance_V * gain_r))
    explained_V2 = at_least(explained_V2, 0.0)
    said_V = ((d.soc_V * a.soc) + (d.capacity_V * a.capacity)) + (d.resistance_V * a.resistance)
    off_V = above_V - said_V
    if (off_V * off_V) > (c.gate_square * (explained_V2 + d.single_V2)):
        a.status = U(a.status | INNOVATION_REJECTED)
        if a.rejections < c.cell_recovery:
            a.rejections = U(a.rejections + 1)
        else:
            look_again(a)
    else:
        a.rejections = U(0)
        per = 1.0 / (explained_V2 + d.variance_V2)
        a.soc = clip(a.soc + (gain_s * (off_V * per)), -1.0, 1.0)
        a.capacity = clip(a.capacity + (gain_q * (off_V * per)), -CELL_MOST, CELL_MOST)
        a.resistance = clip(a.resistance + (gain_r * (off_V * per)), -CELL_MOST, SCALE_MOST)
        a.ss = at_least(a.ss - (gain_s * (gain_s * per)), c.cell_least_soc2)
        a.sq = a.sq - (gain_s * (gain_q * per))
        a.sr = a.sr - (gain_s * (gain_r * per))
        a.qq = at_least(a.qq - (gain_q * (gain_q * per)), VARIANCE_FLOOR)
        a.qr = a.qr - (gain_q * (gain_r * per))
        a.rr = at_least(a.rr - (gain_r * (gain_r * per)), VARIANCE_FLOOR)


def step_cell(
    c: Constants, a: Cell, d: Difference, voltage_V: float, mean_V: float, sequence: int
) -> None:
    """One cell in its turn: it has drifted from the mean, then its voltage is used."""
    steps = F(U(sequence - a.seen_at))
    if cell_is_sound(a):
        a.status = U(0)
    else:
        start_cell(c, a)
        a.status = U(STATE_RESET)
    a.ss = clip(a.ss + (steps * c.cell_soc_walk), 0.0, SOC_VARIANCE_MOST)
    a.qq = clip(a.qq + (steps * c.cell_capacity_walk), 0.0, SOC_VARIANCE_MOST)
    a.rr = clip(a.rr + (steps * c.cell_resistance_walk), 0.0, SOC_VARIANCE_MOST)
    a.seen_at = sequence
    if within(voltage_V, c.voltage_low_V, c.voltage_high_V):
        use_voltage(c, a, d, voltage_V - mean_V)
    else:
        a.status = U(a.status | VOLTAGE_INVALID)


def step_cells(
    m: Model, x: State, sample: Sample, cells: Cells, voltage_V: Floats, count: int
) -> None:
    """One sample of a pack, after `cellwise_step` of the mean cell with the same sample.

    The cells whose turn it is are looked at. ``sample.voltage_V`` is the mean that
    `cellwise_mean_voltage` gave; NaN for a cell without a reading, or while it is balanced.
    """
    c = m.constant
    mean_V = sample.voltage_V
    there = within(mean_V, c.voltage_low_V, c.voltage_high_V)
    elapsed = U(sample.sequence - x.cells_at)
    if there and x.evidence > NO_VOLTAGE_YET and elapsed != U(0) and is_sound(c, x):
        place = place_now(m, x)
        if not x.mean_V > 0.0:
            x.mean_V = mean_V
        d = difference_of(m, place, x, mean_V)
        due = x.turn
        for k in range(count):
            if k == due:
                step_cell(c, cells[k], d, voltage_V[k], mean_V, sample.sequence)
                due = U(due + c.cell_turns)
        x.turn = U(x.turn + 1) if U(x.turn + 1) < c.cell_turns else U(0)
        x.mean_V = mean_V
        x.cells_at = sample.sequence


def own_soc(x: State, a: Cell) -> float:
    """SOC of one cell."""
    return clip(x.soc + (a.soc + (a.capacity * (0.5 - x.soc))), 0.0, 1.0)


def own_variance(c: Constants, x: State, a: Cell) -> float:
    """Variance of one cell's SOC: the mean's and its difference's."""
    away = 0.5 - x.soc
    difference2 = a.ss + (away * ((2.0 * a.sq) + (away * a.qq)))
    return F(x.ss + at_least(difference2, c.cell_least_soc2))


def cell_of(m: Model, x: State, a: Cell, out: CellOutput) -> None:
    """What is known of one cell; capacity and resistance beside the mean cell's."""
    c = m.constant
    if is_sound(c, x) and cell_is_sound(a):
        out.soc = own_soc(x, a)
        out.soc_variance = own_variance(c, x, a)
        out.capacity_share = 1.0 + a.capacity
        out.capacity_variance = a.qq
        out.resistance_scale = 1.0 + a.resistance
        out.resistance_variance = a.rr
        out.status = a.status
    else:
        out.soc = KNOW_NOTHING_SOC
        out.soc_variance = KNOW_NOTHING_VARIANCE
        out.capacity_share = 1.0
        out.capacity_variance = c.cell_capacity2
        out.resistance_scale = 1.0
        out.resistance_variance = c.cell_resistance2
        out.status = U(STATE_RESET)


@noinline
def with_cell(at: Place, a: Cell) -> Place:
    """The same place with one cell's resistance."""
    return Place(at.low, at.weight, at.scale * (1.0 + a.resistance), at.lag)


@noinline
def weakest(
    m: Model, place: Place, x: State, cells: Cells, count: int, side: float, current: float
) -> int:
    """The cell that a current over the horizon brings nearest to its limit of voltage."""
    found = U(0)
    least_V = LARGEST_FLOAT
    for k in range(count):
        if cell_is_sound(cells[k]):
            own = with_cell(place, cells[k])
            end = ending(m, own, x, own_soc(x, cells[k]), side * current)
            left_V = side * end.voltage_V
            if left_V < least_V:
                least_V = left_V
                found = k
    return U(found)


@noinline
def nearest_to_end(x: State, cells: Cells, count: int, side: float) -> int:
    """The emptiest cell (``side`` 1), or the fullest (-1)."""
    found = U(0)
    least = LARGEST_FLOAT
    for k in range(count):
        if cell_is_sound(cells[k]):
            room = side * own_soc(x, cells[k])
            if room < least:
                least = room
                found = k
    return U(found)


@noinline
@unrolled_by_option
def way_of(m: Model, place: Place, x: State, a: Cell, side: float) -> Way:
    """What one cell can give (``side`` 1) or take (-1) over the horizon."""
    c = m.constant
    soc = own_soc(x, a)
    ss = own_variance(c, x, a)
    own = with_cell(place, a)
    held_V = x.v1_V + x.v2_V
    for i in BRANCHES[2:]:
        held_V = held_V + x.state[i]
    worse_V = at_least(side * (a.resistance * held_V), 0.0)
    limit_V = c.power_low_V
    most_A = c.power_discharge_A
    room = soc - c.power_soc_low
    if side < 0.0:
        limit_V = c.power_high_V
        most_A = c.power_charge_A
        room = c.power_soc_high - soc
    limit_V = limit_V + (side * worse_V)
    one = one_way(m, own, x, soc, ss, side, limit_V, most_A, room)
    return Way(one.power_W, one.low_W, one.current_A)


@noinline
def pack_way(m: Model, place: Place, x: State, cells: Cells, count: int, side: float) -> Way:
    """Power of the pack one way: the least of what its weakest cells allow.

    These are the cell that is nearest to its end, the one whose voltage is at the largest current,
    and the one whose voltage is at the current that these two allow.
    """
    c = m.constant
    current_A = c.power_discharge_A if side > 0.0 else c.power_charge_A
    low_W = LARGEST_FLOAT
    for turn in range(THREE_CELLS):
        at = nearest_to_end(x, cells, count, side)
        if turn != U(0):
            at = weakest(m, place, x, cells, count, side, current_A)
        one = way_of(m, place, x, cells[at], side)
        if one.current_A < current_A:
            current_A = one.current_A
        if one.low_W < low_W:
            low_W = one.low_W
    end = ending(m, place, x, x.soc, side * current_A)
    many = F(count)
    power_W = at_least(many * (current_A * end.voltage_V), 0.0)
    low_W = many * low_W
    if low_W > power_W:
        low_W = power_W
    return Way(power_W, low_W, current_A)


def pack_power(m: Model, x: State, cells: Cells, count: int, out: Capability) -> None:
    """What the pack can give and take for the horizon, as its weakest cell allows.

    Zero throughout for a state that is not sound, and for no cells.
    """
    out.discharge_W = 0.0
    out.discharge_low_W = 0.0
    out.charge_W = 0.0
    out.charge_low_W = 0.0
    if count != U(0) and is_sound(m.constant, x):
        place = place_now(m, x)
        down = pack_way(m, place, x, cells, count, 1.0)
        up = pack_way(m, place, x, cells, count, -1.0)
        out.discharge_W = down.power_W
        out.discharge_low_W = down.low_W
        out.charge_W = up.power_W
        out.charge_low_W = up.low_W
