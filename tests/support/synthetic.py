"""Synthetic HPPC logs with a known truth: cells of RC branches and a virtual tester, plain NumPy.

Independent of the package's own kernels on purpose: the RC branches are summed in closed form
(cumulative exponentials), not stepped, so that this module can serve as an oracle. A cell of any
number of branches goes through the same `Tester`; `rich_cell` has one of four.

    cell = nmc_cell()
    made = hppc_log(cell, HppcPlan(rates_c=(0.5, 1.0), pulse_hz=10.0), rng=default_rng(0))
    made.log, made.pulses, made.soc
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.cell_log import CellLog

Array = NDArray[np.float64]
Table = Callable[[Array], Array]

INTERNAL_STEP_S = 2.0  # SOC moves little in this time, so the parameters are constant within it


class TestedCell(Protocol):
    """What the tester asks of a cell: functions of SOC (0..1), limits in volt."""

    __test__ = False  # not a test class, whatever pytest thinks of its name

    capacity_Ah: float
    ocv_V: Table
    r0_ohm: Table
    lower_V: float
    upper_V: float
    branches: tuple[tuple[Table, Table], ...]  # resistance and time constant of each


@dataclass(frozen=True)
class SyntheticCell:
    """2-RC cell whose parameters are functions of SOC (0..1), limits in volt."""

    capacity_Ah: float
    ocv_V: Table
    r0_ohm: Table
    r1_ohm: Table
    tau1_s: Table
    r2_ohm: Table
    tau2_s: Table
    lower_V: float
    upper_V: float

    @property
    def branches(self) -> tuple[tuple[Table, Table], ...]:
        """Both, as the tester takes them."""
        return (self.r1_ohm, self.tau1_s), (self.r2_ohm, self.tau2_s)


def nmc_cell(capacity_Ah: float = 3.0) -> SyntheticCell:
    """A sloping OCV, 2.5-4.2 V; resistances for the capacity given."""
    k = 3.0 / capacity_Ah
    return SyntheticCell(
        capacity_Ah=capacity_Ah,
        ocv_V=lambda s: (
            3.45
            + 0.62 * s
            + 0.09 * s**6
            - 0.75 * np.exp(-24.0 * s)
            + 0.02 * np.tanh(12.0 * (s - 0.55))
        ),
        r0_ohm=lambda s: k * (0.030 + 0.012 * np.exp(-9.0 * s)),
        r1_ohm=lambda s: k * (0.014 + 0.020 * np.exp(-8.0 * s)),
        tau1_s=lambda s: 3.0 + 2.0 * s,
        r2_ohm=lambda s: k * (0.022 + 0.030 * np.exp(-7.0 * s)),
        tau2_s=lambda s: 45.0 + 30.0 * s,
        lower_V=2.5,
        upper_V=4.2,
    )


def lfp_cell(capacity_Ah: float = 40.0) -> SyntheticCell:
    """A flat OCV, 2.5-3.65 V; resistances for the capacity given."""
    k = 40.0 / capacity_Ah
    return SyntheticCell(
        capacity_Ah=capacity_Ah,
        ocv_V=lambda s: (
            3.27
            + 0.05 * s
            + 0.025 * np.tanh(14.0 * (s - 0.62))
            - 0.45 * np.exp(-28.0 * s)
            + 0.09 * np.exp(-60.0 * (1.0 - s))
        ),
        r0_ohm=lambda s: k * (2.2e-3 + 1.0e-3 * (1.0 - s) ** 2),
        r1_ohm=lambda s: k * (0.7e-3 + 0.4e-3 * (s - 0.5) ** 2),
        tau1_s=lambda s: 4.0 + 2.0 * s,
        r2_ohm=lambda s: k * (1.4e-3 + 2.0e-3 * (s - 0.5) ** 2),
        tau2_s=lambda s: 50.0 + 30.0 * s,
        lower_V=2.5,
        upper_V=3.65,
    )


@dataclass(frozen=True)
class HppcPlan:
    """What the virtual tester does and how it logs.

    levels : SOC levels at which the pulses run, in the order in which they are visited
    rates_c : pulse rates, each as a discharge/charge pair, or alone
    order : which of a pair comes first; ``by-level``: charge first below half, as the LFP paper
    rest_s : between pulses; pair_rest_s : inside a pair; level_rest_s : after a move
    pulse_hz, rest_hz, move_hz : logging rate; after a switch the pulse rate lasts fast_s longer
    jitter : share of the logging interval by which a stamp is off
    aligned : whether a row falls on each switch; else the first row holds an average
    ramp_s : time in which the tester reaches a new level, linearly
    limit : what the tester does at a voltage limit: hold it (``cv``) or end the step (``stop``)
    initial_charge : the cell comes empty and is charged CC-CV at move_rate_c first
    """

    levels: tuple[float, ...] = (0.9, 0.7, 0.5, 0.3, 0.1)
    rates_c: tuple[float, ...] = (0.5, 1.0, 2.0)
    order: Literal["discharge", "charge", "by-level", "discharge-only", "charge-only"] = "discharge"
    pulse_s: float = 10.0
    rest_s: float = 300.0
    pair_rest_s: float | None = None
    level_rest_s: float = 1800.0
    move_rate_c: float = 0.5
    start_rest_s: float = 60.0
    initial_charge: bool = False
    pulse_hz: float = 10.0
    rest_hz: float = 1.0
    move_hz: float = 1.0
    fast_s: float = 5.0
    jitter: float = 0.0
    aligned: bool = True
    ramp_s: float = 0.0
    limit: Literal["cv", "stop", "none"] = "cv"
    noise_V: float = 0.0
    noise_A: float = 0.0
    resolution_V: float = 0.0
    resolution_A: float = 0.0
    counter: bool = True


class TruePulse(NamedTuple):
    """Rows ``start`` to ``stop`` (not included) carry the pulse; ``limited``: a limit ended it."""

    start: int
    stop: int
    current_A: float
    role: Literal["pulse", "move", "charge"]
    limited: bool
    soc: float


@dataclass(frozen=True)
class SyntheticLog:
    """A log and what is true about it: SOC, voltage and current of every row without noise."""

    log: CellLog
    cell: SyntheticCell
    pulses: tuple[TruePulse, ...]
    soc: Array
    voltage_V: Array
    current_A: Array


@dataclass
class Tester:
    """Runs steps on a cell and collects rows; ``hidden`` rows are computed but not logged."""

    __test__ = False  # not a test class, whatever pytest thinks of its name

    cell: TestedCell
    soc: float
    rng: np.random.Generator
    held_V: tuple[float, ...] = ()  # by each branch; empty: none yet
    current_A: float = 0.0
    columns: list[tuple[Array, Array, Array, Array, NDArray[np.bool_]]] = field(
        default_factory=list
    )
    steps: list[tuple[int, int, float, str, bool, float]] = field(default_factory=list)
    rows: int = 0

    def run(
        self,
        current_A: float,
        duration_s: float,
        hz: float,
        *,
        plan: HppcPlan,
        role: str = "rest",
        limited: bool = True,
        fast_hz: float | None = None,
        cutoff_A: float = 0.0,
    ) -> None:
        """One step: constant current, then the limit's voltage where the plan holds it."""
        dt, shown = self._grid(duration_s, hz, fast_hz, plan)
        current = _ramped(self.current_A, current_A, dt, plan.ramp_s)
        soc0, first = self.soc, self.rows
        soc, v, waves = self._advance(current, dt)
        over = np.zeros(dt.size, dtype=np.bool_)
        if limited and plan.limit != "none" and current_A != 0.0:
            over = v < self.cell.lower_V if current_A > 0.0 else v > self.cell.upper_V
        hit = bool(over.any())
        if hit:
            cut = int(np.argmax(over)) + (1 if plan.limit == "stop" else 0)
            shown = shown.copy()
            if plan.limit == "stop":
                shown[cut - 1] = True
            self._keep(dt[:cut], current[:cut], soc[:cut], v[:cut], shown[:cut], waves)
            if plan.limit == "cv":
                self._hold(dt[cut:], shown[cut:], current_A, cutoff_A)
        else:
            self._keep(dt, current, soc, v, shown, waves)
        self.current_A = float(self.columns[-1][1][-1])
        self.steps.append((first, self.rows, current_A, role, hit, soc0))

    def _grid(
        self, duration: float, hz: float, fast_hz: float | None, plan: HppcPlan
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Intervals of the rows [s] and which rows are logged."""
        ends: list[Array] = []
        begin = 0.0
        if fast_hz is not None and fast_hz > hz:
            ends.append(self._stamps(0.0, min(plan.fast_s, duration), fast_hz, plan))
            begin = min(plan.fast_s, duration)
        if duration > begin:
            ends.append(self._stamps(begin, duration, hz, plan))
        end = np.concatenate(ends)
        dt = np.diff(end, prepend=0.0)
        shown = np.ones(dt.size, dtype=np.bool_)
        if not plan.aligned:
            shown[-1] = False  # the switch falls inside the next row's interval
        parts = np.ceil(dt / INTERNAL_STEP_S).astype(np.int64)
        last = np.cumsum(parts) - 1
        fine = np.zeros(int(parts.sum()), dtype=np.bool_)
        fine[last] = shown
        return np.repeat(dt / parts, parts), fine

    def _stamps(self, begin: float, end: float, hz: float, plan: HppcPlan) -> Array:
        h = 1.0 / hz
        offset = 0.0 if plan.aligned else self.rng.uniform(0.2, 0.8) * h
        t = np.arange(begin + h - offset, end - 0.25 * h, h)
        t = t + plan.jitter * h * self.rng.uniform(-0.5, 0.5, t.size)
        return np.append(t, end)

    def _before(self) -> tuple[float, ...]:
        return self.held_V or (0.0,) * len(self.cell.branches)

    def _advance(self, current: Array, dt: Array) -> tuple[Array, Array, list[Array]]:
        """SOC, terminal voltage and branch voltages at the end of each interval."""
        cell = self.cell
        used = current * dt / (3600.0 * cell.capacity_Ah)
        soc = self.soc - np.cumsum(used)
        mid = np.clip(soc + 0.5 * used, -0.05, 1.05)  # a step may be asked to run on past empty
        seen = np.clip(soc, -0.2, 1.2)
        waves = [
            _branch(before, current, r(mid), tau(mid), dt)
            for before, (r, tau) in zip(self._before(), cell.branches, strict=True)
        ]
        return soc, cell.ocv_V(seen) - cell.r0_ohm(seen) * current - sum(waves), waves

    def _keep(
        self,
        dt: Array,
        i: Array,
        soc: Array,
        v: Array,
        shown: NDArray[np.bool_],
        waves: list[Array],
    ) -> None:
        if dt.size == 0:
            return
        self.columns.append((dt, i, soc, v, shown))
        self.rows += dt.size
        self.soc, self.held_V = float(soc[-1]), tuple(float(w[dt.size - 1]) for w in waves)

    def _hold(self, dt: Array, shown: NDArray[np.bool_], asked_A: float, cutoff_A: float) -> None:
        """Hold the limit: the current that puts the voltage there, row by row."""
        cell = self.cell
        target = cell.lower_V if asked_A > 0.0 else cell.upper_V
        out: list[tuple[float, float, float, float, bool]] = []
        soc, held, i = self.soc, self._before(), asked_A
        for h, seen in zip(dt.tolist(), shown.tolist(), strict=True):
            for _ in range(12):
                used = i * h / (3600.0 * cell.capacity_Ah)
                s, mid = np.array([soc - used]), np.array([soc - 0.5 * used])
                left = [float(np.exp(-h / tau(mid))[0]) for _, tau in cell.branches]
                gain = [float(r(mid)[0]) * (1 - a)
                        for (r, _), a in zip(cell.branches, left, strict=True)]  # fmt: skip
                now = tuple(a * v0 + g * i for a, g, v0 in zip(left, gain, held, strict=True))
                v = (cell.ocv_V(s) - cell.r0_ohm(s) * i)[0] - sum(now)
                if abs(v - target) < 1e-9:
                    break
                i += (v - target) / (cell.r0_ohm(s)[0] + sum(gain))
            soc, held = soc - used, now
            out.append((h, i, soc, v, seen))
            if abs(i) < cutoff_A:
                out[-1] = (h, i, soc, v, True)
                break
        if out:
            h_, i_, s_, v_, seen_ = (np.array(c) for c in zip(*out, strict=True))
            self.columns.append((h_, i_, s_, v_, seen_.astype(np.bool_)))
            self.rows += h_.size
            self.soc, self.held_V = float(soc), held


def _ramped(before: float, after: float, dt: Array, ramp_s: float) -> Array:
    """Mean current of each interval when the level changes linearly within ramp_s."""
    if ramp_s <= 0.0:
        return np.full(dt.size, after)
    t = np.concatenate(([0.0], np.cumsum(dt)))
    x = np.minimum(t / ramp_s, 1.0)
    moved = ramp_s * 0.5 * x**2 + np.maximum(t - ramp_s, 0.0)
    return before + (after - before) * np.diff(moved) / dt


def _branch(v0: float, current: Array, r: Array, tau: Array, dt: Array) -> Array:
    """Voltage of an RC branch at the end of each interval, exact for constant current in it."""
    log_a = -dt / tau
    gain = -np.expm1(log_a) * r * current
    out = np.empty_like(dt)
    begin = 0
    while begin < dt.size:
        decay = np.cumsum(log_a[begin:])
        n = max(1, int(np.searchsorted(-decay, 300.0)))
        decay = decay[:n]
        piece = np.exp(decay) * (v0 + np.cumsum(gain[begin : begin + n] * np.exp(-decay)))
        out[begin : begin + n] = piece
        v0 = float(piece[-1])
        begin += n
    return out


def hppc_log(
    cell: SyntheticCell, plan: HppcPlan | None = None, *, rng: np.random.Generator | None = None
) -> SyntheticLog:
    """Run the plan on the cell and log it."""
    plan = plan or HppcPlan()
    rng = rng or np.random.default_rng(0)
    down = plan.levels[0] >= plan.levels[-1]
    tester = Tester(cell, 0.02 if plan.initial_charge or not down else 1.0, rng)
    one_c = cell.capacity_Ah
    if plan.initial_charge:
        # A CC-CV charge as a laboratory does it, whatever the plan does at the limits later.
        charge = HppcPlan(limit="cv", jitter=plan.jitter, aligned=plan.aligned)
        move = -plan.move_rate_c * one_c
        tester.run(move, 7200.0 / plan.move_rate_c, plan.move_hz, plan=charge, role="charge",
                   cutoff_A=0.05 * one_c)  # fmt: skip
        tester.run(0.0, plan.level_rest_s, plan.rest_hz, plan=plan, fast_hz=plan.pulse_hz)
    else:
        tester.run(0.0, plan.start_rest_s, plan.rest_hz, plan=plan)
    for level in plan.levels:
        _move_to(level, tester, plan)
        _pulses_at(level, tester, plan)
    return finish(tester, plan)


def _move_to(level: float, tester: Tester, plan: HppcPlan) -> None:
    one_c = tester.cell.capacity_Ah
    away = tester.soc - level
    if abs(away) > 2e-3:
        current = float(np.sign(away)) * plan.move_rate_c * one_c
        tester.run(current, 3600.0 * abs(away) / plan.move_rate_c, plan.move_hz, plan=plan,
                   role="move", fast_hz=plan.pulse_hz)  # fmt: skip
        tester.run(0.0, plan.level_rest_s, plan.rest_hz, plan=plan, fast_hz=plan.pulse_hz)


def _pulses_at(level: float, tester: Tester, plan: HppcPlan) -> None:
    signs = {
        "discharge": (1.0, -1.0),
        "charge": (-1.0, 1.0),
        "by-level": (1.0, -1.0) if level > 0.5 else (-1.0, 1.0),
        "discharge-only": (1.0,),
        "charge-only": (-1.0,),
    }[plan.order]
    for rate in plan.rates_c:
        for k, sign in enumerate(signs):
            current = sign * rate * tester.cell.capacity_Ah
            tester.run(current, plan.pulse_s, plan.pulse_hz, plan=plan, role="pulse")
            inside = k + 1 < len(signs) and plan.pair_rest_s is not None
            rest = plan.pair_rest_s if inside and plan.pair_rest_s else plan.rest_s
            tester.run(0.0, rest, plan.rest_hz, plan=plan, fast_hz=plan.pulse_hz)


def finish(tester: Tester, plan: HppcPlan) -> SyntheticLog:
    """Drop the hidden rows, average the current over what a row spans, add the sensors."""
    dt, current, soc, v, shown = (np.concatenate(c) for c in zip(*tester.columns, strict=True))
    shown[-1] = True
    time = np.concatenate(([0.0], np.cumsum(dt)))
    charge = np.concatenate(([0.0], np.cumsum(current * dt)))
    rows = np.concatenate(([0], np.flatnonzero(shown) + 1))
    t, q = time[rows], charge[rows] / 3600.0
    mean = np.concatenate(([current[0]], 3600.0 * np.diff(q) / np.diff(t)))
    soc0 = soc[0] + current[0] * dt[0] / (3600.0 * tester.cell.capacity_Ah)
    row_soc = np.concatenate(([soc0], soc))[rows]
    row_v = np.concatenate(([float(tester.cell.ocv_V(np.array([soc0]))[0])], v))[rows]
    rng = tester.rng
    i_seen = _quantised(mean + plan.noise_A * rng.standard_normal(t.size), plan.resolution_A)
    v_seen = _quantised(row_v + plan.noise_V * rng.standard_normal(t.size), plan.resolution_V)
    pulses = tuple(
        TruePulse(
            # Fine row k ends at time[k + 1]; the first logged row that ends after the switch.
            start=int(np.searchsorted(rows, first, side="right")),
            stop=int(np.searchsorted(rows, last, side="right")),
            current_A=amps,
            role=role,  # type: ignore[arg-type]
            limited=hit,
            soc=at,
        )
        for first, last, amps, role, hit, at in tester.steps
        if role != "rest"
    )
    log = CellLog(t, i_seen, v_seen, charge_Ah=q if plan.counter else None, name="synthetic HPPC")
    return SyntheticLog(log, tester.cell, pulses, row_soc, row_v, mean)


def _quantised(x: Array, step: float) -> Array:
    return np.round(x / step) * step if step > 0.0 else x


def driven_log(
    cell: SyntheticCell,
    current_A: Array,
    hz: float,
    *,
    soc: float = 0.8,
    noise_V: float = 0.0,
    noise_A: float = 0.0,
    rng: np.random.Generator | None = None,
) -> CellLog:
    """A log of any current, at a fixed rate, from rest: drives, sines, hand-made steps."""
    rng = rng or np.random.default_rng(0)
    tester = Tester(cell, soc, rng)
    dt = np.full(current_A.size - 1, 1.0 / hz)
    _, v, _ = tester._advance(current_A[1:], dt)
    first = cell.ocv_V(np.array([soc])) - cell.r0_ohm(np.array([soc])) * current_A[0]
    n = current_A.size
    return CellLog(
        np.arange(n) / hz,
        current_A + noise_A * rng.standard_normal(n),
        np.concatenate((first, v)) + noise_V * rng.standard_normal(n),
        name="synthetic",
    )


def drive_current(seconds: float, hz: float, peak_A: float, rng: np.random.Generator) -> Array:
    """A drive: accelerating, cruising, braking, and standing still for 10 to 30 s at times."""
    pieces: list[Array] = [np.zeros(int(60 * hz))]
    total = pieces[0].size
    while total < seconds * hz:
        rows = int(rng.uniform(20.0, 120.0) * hz)
        steps = rng.normal(0.0, 0.25, rows)
        wander = np.empty(rows)
        value = 0.0
        for k in range(rows):  # mean-reverting, so that power stays bounded
            value += -0.15 * value + steps[k]
            wander[k] = value
        moving = peak_A * np.clip(0.25 + wander, -0.5, 1.0)
        idle = np.zeros(int(rng.uniform(10.0, 30.0) * hz))
        pieces += [moving, idle]
        total += rows + idle.size
    return np.concatenate(pieces)
