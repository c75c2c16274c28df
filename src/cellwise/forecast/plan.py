"""A plan of loads ahead: where it ends, and the chance to end above a SOC.

A plan is a table of phases (``time_s`` with ``power_W`` or ``current_A``), or a past log, whose
power is flown or driven once more; several are taken to be as probable as each other. The next trip
is none of few past ones: its mean power is drawn from what these say of it, as few as they are.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.equations import CellState
from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.replay import Replay
from cellwise.forecast.forecast_kernels import LoadScenario, SigmaOffset, Uncertain, through
from cellwise.forecast.log_kernels import FilteredRows, LoadAhead, moment
from cellwise.forecast.remaining import (
    cutoff_of,
    filtered_rows,
    start_state,
    uncertain_of,
    warms_unseen,
)
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

DRAWS = 500
STEP_S = 1.0  # a past log is averaged over so long: its power, not its peaks within a second
LONGEST_STEP_S = 10.0  # a long phase is cut into such
MOST_STEPS = 50_000
LONGEST_HEADER = 10_000
RATIOS = (0.0, 0.5, 1.0, 1.5, 2.0, 4.0)
BAND = (0.025, 0.975)


class Plan(NamedTuple):
    """Steps of a load of one cell, positive on discharge, shape (n,): seconds, watts or amperes.

    ``is_past``: what a log drew, one of several that show how much such loads differ.
    """

    name: str
    dt_s: FloatArray
    load: FloatArray
    is_power: bool
    is_past: bool = False

    @property
    def mean(self) -> float:
        """Of the load, over its time."""
        return float(np.sum(self.dt_s * self.load) / np.sum(self.dt_s))


@dataclass(frozen=True, eq=False)
class PlanOutcome:
    """Where plans end from one moment of a log.

    ``chance`` is that of ending at ``above`` or more without the voltage at ``cutoff_V`` before;
    ``chance_cutoff`` that of reaching it. Bands hold 95 %.
    """

    time_s: float
    soc: float
    soc_std: float
    seconds: float
    above: float
    cutoff_V: float
    chance: float
    chance_cutoff: float
    end_soc: float
    end_soc_band: tuple[float, float]
    least_V: float
    least_V_band: tuple[float, float]
    energy_Wh: float
    plans: int

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return dict(self.__dict__)


def is_plan(path: str | Path) -> bool:
    """A table of phases, by its header: a log has a voltage."""
    try:
        with Path(path).open(encoding="utf-8-sig") as file:
            names = {name.strip() for name in file.readline(LONGEST_HEADER).split(",")}
    except (OSError, UnicodeDecodeError):
        return False
    return "power_W" in names or names == {"time_s", "current_A"}


def read_plan(path: str | Path, series: int = 1, parallel: int = 1) -> Plan:
    """A table of phases: ``time_s`` at which each ends, ``power_W`` or ``current_A`` in it.

    Parameters
    ----------
    path : str or Path        CSV; the phases of a pack
    series, parallel : int    cells of that pack

    Raises
    ------
    InputError                no such table, a time that goes back, a value that is no number
    """
    try:
        with warnings.catch_warnings(action="ignore"):  # an empty file, which has no columns
            table = np.genfromtxt(path, delimiter=",", names=True, encoding="utf-8-sig", ndmin=1)
    except IndexError:
        table = np.empty(0)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no plan '{path}' ({error})", "a CSV with time_s and power_W", "Check the path."
        ) from None
    names = set(table.dtype.names or ())
    loads = names & {"power_W", "current_A"}
    if "time_s" not in names or len(loads) != 1:
        raise InputError(
            f"columns {', '.join(sorted(names)) or 'none'} in the plan '{path}'",
            "time_s, and power_W or current_A",
            "Name what each phase draws; it ends at time_s.",
        )
    name = loads.pop()
    ends, load = table["time_s"].astype(np.float64), table[name].astype(np.float64)
    dt_s = np.diff(ends, prepend=0.0)
    if not (np.isfinite(ends).all() and np.isfinite(load).all() and (dt_s >= 0.0).all()):
        raise InputError(
            f"a time in the plan '{path}' that goes back, or a value that is no finite number",
            "a number in every row, times from 0 that go on",
            "Put the phases in order; each ends at its time_s.",
        )
    cells = parallel if name == "current_A" else series * parallel
    parts = np.maximum(np.ceil(dt_s / LONGEST_STEP_S), 1.0).astype(np.int64)
    long = np.repeat(dt_s / parts, parts)
    return _checked(
        Plan(Path(path).stem, long, np.repeat(load / cells, parts), name == "power_W"), str(path)
    )


def plan_of_log(log: CellLog) -> Plan:
    """What a past log drew, as a plan of power: means over `STEP_S`, or its own longer rows."""
    known = np.isfinite(log.voltage_V)
    held_V = np.interp(log.time_s, log.time_s[known], log.voltage_V[known])
    power = log.known_current_A() * held_V
    step_s = max(STEP_S, log.duration_s / MOST_STEPS)
    places = np.unique(np.searchsorted(log.time_s, np.arange(0.0, log.time_s[-1], step_s)))
    places = np.union1d(places, [len(log) - 1])
    energy = np.cumsum(power * log.interval_s)
    dt_s = np.diff(log.time_s[places])
    keep = dt_s > 0.0
    parts = np.maximum(np.ceil(dt_s[keep] / LONGEST_STEP_S), 1.0).astype(np.int64)
    load = np.diff(energy[places])[keep] / dt_s[keep]
    plan = Plan(log.name, np.repeat(dt_s[keep] / parts, parts), np.repeat(load, parts), True, True)
    return _checked(plan, f"log '{log.name}'")


def _checked(plan: Plan, where: str) -> Plan:
    if plan.dt_s.size == 0 or plan.dt_s.size > 4 * MOST_STEPS or float(plan.dt_s.sum()) <= 0.0:
        raise InputError(
            f"{plan.dt_s.size} steps over {plan.dt_s.sum():g} s in {where}",
            f"a plan of some seconds and at most {4 * MOST_STEPS} steps",
            "Correct its times.",
        )
    return plan


def forecast_plan(
    model: CellModel,
    replay: Replay,
    plans: Sequence[Plan],
    *,
    above: float = 0.0,
    cutoff_V: float | None = None,
    row: int | None = None,
    capacity_std: float | None = None,
) -> PlanOutcome:
    """Where plans end from a moment of a replay, and the chance to end above a SOC.

    Each plan is followed at two deviations either way of what is not known: SOC, the model's
    voltage ahead, warming, capacity (as in `cellwise.forecast.forecast`). Of what they make of the
    end 500 cases are drawn, of one plan each, by a fixed sequence that fills the space evenly.

    Parameters
    ----------
    plans : sequence of Plan    as probable as each other
    above : float               SOC to end at or above, 0..1
    cutoff_V : float or None    as :func:`cellwise.forecast.remaining.cutoff_of`
    row : int or None           of the log, from which the plans begin; None: its last
    capacity_std : float or None      of the cell's capacity about the model's, as a share; None:
                                as the model states

    Raises
    ------
    InputError                  no plan, ``above`` outside 0..1, a cutoff that no cell has
    """
    if not plans:
        raise InputError("no plan", "at least one", "Give a table of phases or a past log.")
    if not 0.0 <= above <= 1.0:
        raise InputError(f"a SOC of {above:g} to land above", "a fraction, 0 to 1", "Correct it.")
    cutoff = cutoff_of(model, cutoff_V)
    at = len(replay.log) - 1 if row is None else row
    state, go, soc_std = state_at(model, replay, at, cutoff)
    uncertain = uncertain_of(model)
    if capacity_std is not None:
        uncertain = uncertain._replace(capacity_std=capacity_std)
    begins = state, soc_std, uncertain
    draws = _draws()
    scale = mean_powers(plans, draws[:, 5])
    which = np.minimum((draws[:, 4] * len(plans)).astype(np.int64), len(plans) - 1)
    found = np.empty((DRAWS, 3))
    for number, plan in enumerate(plans):
        held = go._replace(hold_power=plan.is_power)
        mine = which == number
        ratio = scale[mine] / plan.mean if scale is not None else None
        found[mine] = _responses(model, begins, plan, held, draws[mine, :4], ratio)
    failed = found[:, 1] <= cutoff
    end = np.maximum(found[:, 0], 0.0)

    def band(values: FloatArray) -> tuple[float, float]:
        low, high = np.quantile(values, BAND)
        return float(low), float(high)

    return PlanOutcome(
        time_s=float(replay.log.time_s[at]),
        soc=float(replay.trace.soc[at]),
        soc_std=soc_std,
        seconds=float(np.mean([plan.dt_s.sum() for plan in plans])),
        above=above,
        cutoff_V=cutoff,
        chance=float(np.mean((end >= above) & ~failed)),
        chance_cutoff=float(np.mean(failed)),
        end_soc=float(np.median(end)),
        end_soc_band=band(end),
        least_V=float(np.median(found[:, 1])),
        least_V_band=band(found[:, 1]),
        energy_Wh=float(np.median(found[:, 2])) / 3600.0,
        plans=len(plans),
    )


def state_at(
    model: CellModel, replay: Replay, row: int, cutoff_V: float
) -> tuple[CellState, LoadScenario, float]:
    """The cell's state at a row of a replay, what it goes on with, and its SOC's deviation."""
    rows = FilteredRows(*(x[: row + 1] for x in filtered_rows(model, replay)))
    load = LoadAhead(rows.current_A, np.nan, rows.soc < 0.0, True, cutoff_V, warms_unseen(model))
    state, go = moment(model.parameters(), start_state(rows), rows, load, uncertain_of(model))
    return CellState(*state), LoadScenario(*go), float(rows.soc_std[-1])


def mean_powers(plans: Sequence[Plan], share: FloatArray) -> FloatArray | None:
    """Mean powers as probable for one more log as the past ones say; None without several.

    Their logarithms are normal with a mean and a deviation that n logs show: the next one is then
    Student's t with n - 1 degrees of freedom, scale s sqrt(1 + 1/n).
    """
    from scipy.special import stdtrit

    means = np.array([plan.mean for plan in plans])
    if len(plans) < 2 or not all(plan.is_past for plan in plans) or np.any(means <= 0.0):
        return None
    logs = np.log(means)
    spread = float(np.std(logs, ddof=1)) * math.sqrt(1.0 + 1.0 / len(plans))
    return np.asarray(np.exp(np.mean(logs) + spread * stdtrit(len(plans) - 1, share)))


def _responses(
    model: CellModel,
    begins: tuple[CellState, float, Uncertain],
    plan: Plan,
    go: LoadScenario,
    draws: FloatArray,
    ratio: FloatArray | None,
) -> FloatArray:
    """End SOC, lowest voltage and energy for deviations of SOC, voltage, warmth and capacity.

    A parabola for each, through what the plan makes of two deviations either way; with ``ratio``
    times its load beside them, linear between `RATIOS`.
    """
    tables, (state, soc_std, uncertain) = model.parameters(), begins

    def run(deviations: FloatArray, times: float = 1.0) -> FloatArray:
        soc, voltage, warmth, capacity = deviations.tolist()
        charge_As = tables.cell.charge_As * math.exp(uncertain.capacity_std * capacity)
        cell = tables._replace(cell=tables.cell._replace(charge_As=charge_As))
        away = SigmaOffset(soc, voltage, warmth)
        end = through(cell, state, soc_std, (plan.dt_s, times * plan.load), go, uncertain, away)
        return np.array(end, dtype=np.float64)

    usual = run(np.zeros(4))
    found = np.tile(usual, (len(draws), 1))
    for k, axis in enumerate(np.eye(4)):
        if k == 2 and not go.lump.heats:
            continue
        low, high = run(-2.0 * axis), run(2.0 * axis)
        z = draws[:, k : k + 1]
        found += 0.25 * (high - low) * z + 0.125 * (high - 2.0 * usual + low) * z * z
    if ratio is not None:
        ends = np.array([run(np.zeros(4), times) for times in RATIOS])
        for column in range(found.shape[1]):
            found[:, column] += np.interp(ratio, RATIOS, ends[:, column]) - usual[column]
    return found


def _draws() -> FloatArray:
    """Four standard normal numbers and two from 0 to 1 in every row, shape (DRAWS, 6)."""
    from scipy.special import ndtri

    # Additive recurrence with the powers of the root of x^7 = x + 1: as even as a lattice (Roberts
    # 2018), and the same everywhere.
    root = 1.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / 7.0)
    steps = root ** -np.arange(1.0, 7.0)
    even = (0.5 + np.outer(np.arange(1, DRAWS + 1), steps)) % 1.0
    return np.column_stack((ndtri(even[:, :4]), even[:, 4:]))
