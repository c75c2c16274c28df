"""Station "own logs": every one that was given, simulated back; what those of the fit covered."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import (
    NO_MODEL_V,
    RANGE_V,
    error_notices,
    in_order,
    soc_notices,
)
from cellwise.cell.plausibility.sizes import check_physical
from cellwise.cell.plausibility.validity import UNKNOWN, Validity, covered
from cellwise.cell.simulate import Simulation, simulate
from cellwise.errors import InputError
from cellwise.fit.model_error import LEAST_LOG
from cellwise.identify.assemble import own_model
from cellwise.identify.capacity.half_cycles import LIMITS as HALF_CYCLES
from cellwise.identify.capacity.half_cycles import find_half_cycles, join_logs
from cellwise.identify.identification import CellTests, Fitted, OwnLog, Role, Start
from cellwise.identify.ocv.curve import LIMITS
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice, texts
from cellwise.typing import BoolArray, FloatArray
from cellwise.wording import joined_texts

CLEAR_GAP_V = 0.02  # between a side of a test and the model: hysteresis and resistance of others
CLEARLY_WORSE = 1.1  # a likelihood weighs rows otherwise than an RMSE does: a tenth is no loss
WORSE = 2.0  # times the error with the fit's start: then the found one is no start of this log
# Left out at each end: a pulse of a few rows in hours of rest counts, a sensor's spike does not.
TRIMMED_ROWS, TRIMMED_SHARE = 2, 2e-5


def simulate_back(
    model: CellModel, tests: CellTests, fitted: Fitted, prior: CellModel | None = None
) -> tuple[OwnLog, ...]:
    """Every log from where it begins by the finished model, in the order in which it was given.

    The start is what every other command finds with this model; the fit's own, which knows what a
    test begins with, where the found one errs twice as much on the rows compared. Beside it what
    ``prior``, the model that was updated, leaves of the same rows from the start that it finds.
    """
    starts = {id(s.log): s for s in fitted.starts}
    roles: list[tuple[Role, CellLog]] = [
        *(("hppc", log) for log, _ in tests.hppc),
        *(("ocv", log) for log in tests.ocv),
        *(("capacity", log) for log in tests.capacity),
        *(("drive", log) for log, _ in tests.drive),
    ]
    own = (_simulated_back(model, role, log, starts[id(log)]) for role, log in roles)
    return tuple(one if prior is None else _beside_prior(one, prior) for one in own)


def _beside_prior(own: OwnLog, prior: CellModel) -> OwnLog:
    """With the error of the model that was updated, where the log took part in the update."""
    if not own.used:
        return own
    log = own.simulation.log
    before = simulate(prior, log, initial_soc(prior, log, whole_log=True).soc)
    return replace(own, prior_rmse_V=_rmse_V(before, own.compared))


def _simulated_back(model: CellModel, role: Role, log: CellLog, start: Start) -> OwnLog:
    of_log = own_model(model, start.capacity_scale)
    begins = initial_soc(of_log, log, whole_log=True)
    simulation = simulate(of_log, log, begins.soc)
    if start.left_out:
        return OwnLog(role, False, simulation, begins, None, {}, start.left_out)
    fits = simulate(of_log, log, start.soc0)
    if _rmse_V(simulation, start.rows) > WORSE * _rmse_V(fits, start.rows):
        begins, simulation = InitialSoc(start.soc0, begins.std, "as the fit has it"), fits
    sides = directions(log) if role in ("ocv", "capacity") else {}
    rmse = {n: _rmse_V(simulation, x) for n, x in sides.items() if _known(simulation, x).size}
    away = start.capacity_scale - 1.0
    said = _gaps(simulation, sides)
    if abs(away) > LIMITS.other_capacity:
        said.insert(
            0, f"simulated with a capacity of its own, {100.0 * away:+.1f} % of the model's"
        )
    return OwnLog(role, True, simulation, begins, start.rows, rmse, "; ".join(said))


def check_possible(model: CellModel, found: Sequence[Notice]) -> None:
    """Refuse a model that no cell can be, with what is wrong with its tests.

    Raises
    ------
    InputError        see :func:`cellwise.cell.plausibility.sizes.check_physical`
    """
    try:
        check_physical(model, "the model")
    except InputError as error:
        raise InputError(
            "tests that give " + joined_texts((error.found, *texts(in_order(found)[:1]))),
            error.expected,
            "Check that the logs are of one cell and in one scale, and their temperatures.",
        ) from None


def check_serves(rmse_V: float, found: Sequence[Notice]) -> None:
    """Refuse a model of tests that contradict each other if it is far from what made it.

    Raises
    ------
    InputError        an error of hundreds of millivolts on its own logs, and a contradiction
    """
    if found and rmse_V >= NO_MODEL_V:
        first = in_order(found)[0]
        raise InputError(
            f"tests that give a model {1e3 * rmse_V:.0f} mV off its own logs; " + first.text,
            "logs of one cell, in one scale",
            "Leave out the log that does not belong, or check the unit of its current (mA for A?).",
        )


def own_log_notices(own: Sequence[OwnLog]) -> list[Notice]:
    """Where the finished model is far from the logs that made it."""
    found = []
    for s in (o.simulation for o in own if o.used):
        found += soc_notices(s.log, s.soc) + error_notices(s.model, s.log, s.residual_V, s.soc)
    return found


def updates_for_worse(own: Sequence[OwnLog]) -> list[Notice]:
    """Logs of an update that the model followed better before it."""
    found = []
    for one in own:
        before_V, after_V = one.prior_rmse_V, _rmse_V(one.simulation, one.compared)
        if before_V is not None and after_V > CLEARLY_WORSE * before_V:
            text = (
                f": the updated model is WORSE on it than the one that was updated, "
                f"{1e3 * after_V:.1f} mV instead of {1e3 * before_V:.1f} mV. Keep the old one for "
                "such loads, or update it with a log that begins at a rest"
            )
            name = one.simulation.log.name
            found.append(Notice(Code.UPDATE_WORSE, text, log=name, size_V=after_V - before_V))
    return found


def other_capacities(starts: Sequence[Start]) -> list[Notice]:
    """Logs of a cell that held clearly more or less than that of the others."""
    found = []
    for start in starts:
        away = start.capacity_scale - 1.0
        if abs(away) > LIMITS.other_capacity:
            text = (
                f" is of a cell that held {100.0 * away:+.1f} % of the others' charge: another "
                "sample, another age, or a current sensor that is off. It keeps a capacity of its "
                "own in the fit, and the model that of the others"
            )
            name, size_V = start.log.name, RANGE_V * abs(away)
            found.append(Notice(Code.OTHER_CAPACITY, text, log=name, size_V=size_V))
    return found


def log_validity(
    log: CellLog,
    soc: FloatArray | None,
    stated_C: float | None = None,
    rows: BoolArray | None = None,
) -> Validity:
    """What one log covered.

    Parameters
    ----------
    soc : (n,) float or None      of every row; None: not known
    stated_C : float or None      temperature where none was measured; None: not known [degC]
    rows : (n,) bool or None      those that took part; None: all
    """
    part = np.ones(len(log), dtype=np.bool_) if rows is None else rows
    trim = max(TRIMMED_ROWS, round(TRIMMED_SHARE * np.count_nonzero(part)))
    warm = None if log.temperature_C is None else covered(log.temperature_C[part], trim)
    if warm is None and stated_C is not None:
        warm = float(stated_C), float(stated_C)
    seen = None if soc is None else covered(np.clip(soc[part], 0.0, 1.0), trim)
    return Validity(seen, warm, covered(log.interval_current_A[part], trim))


def identified_validity(
    tests: CellTests,
    used: Sequence[OwnLog],
    temperature_C: float | None = None,
) -> Validity:
    """What the logs that took part in an identification covered together.

    Parameters
    ----------
    tests : CellTests                        with the temperatures that were stated
    used : sequence of OwnLog               the logs that the model was fitted on
    temperature_C : float or None           of tests that measured none, as stated [degC]
    """
    stated = {id(log): warm for log, warm in (*tests.hppc, *tests.drive) if warm is not None}
    loads: list[Validity] = []
    slow: list[Validity] = []
    fitted = set()
    for own in used:
        s = own.simulation
        fitted.add(id(s.log))
        warm = stated.get(id(s.log), temperature_C)
        part = log_validity(s.log, s.soc, warm, own.compared)
        (slow if own.role == "ocv" else loads).append(part)
    slow += [log_validity(x, None, temperature_C) for x in tests.ocv if id(x) not in fitted]
    # A low-rate test shows no resistance: where loads were measured, their temperatures count.
    if joined(loads).temperature_C is not None:
        slow = [replace(p, temperature_C=None) for p in slow]
    return joined([*loads, *slow])


def joined(parts: Iterable[Validity]) -> Validity:
    """What all of them covered together."""
    return reduce(Validity.joined, parts, UNKNOWN)


def directions(log: CellLog) -> dict[str, BoolArray]:
    """Rows of the log's discharges and charges that move much; shape (n,) each."""
    halves = find_half_cycles(join_logs(log))
    most = max((abs(h.charge_Ah) for h in halves), default=0.0)
    found = {}
    for name, sign in (("discharge", 1.0), ("charge", -1.0)):
        rows = np.zeros(len(log), dtype=np.bool_)
        for half in (h for h in halves if sign * h.charge_Ah >= HALF_CYCLES.whole * most):
            rows[half.steady_start : half.steady_stop] = True
        if np.count_nonzero(rows) >= LEAST_LOG:
            found[name] = rows
    return found


def _known(simulation: Simulation, rows: BoolArray | None) -> FloatArray:
    """Errors of the rows that were measured [V]."""
    error = simulation.residual_V if rows is None else simulation.residual_V[rows]
    return np.asarray(error[np.isfinite(error)])


def _rmse_V(simulation: Simulation, rows: BoolArray | None) -> float:
    error = _known(simulation, rows)
    return float(np.sqrt(np.mean(error**2))) if error.size else 0.0


def _gaps(simulation: Simulation, sides: dict[str, BoolArray]) -> list[str]:
    """The residual of a low-rate or capacity test that has a side the model does not follow."""
    said = []
    for name, rows in sides.items():
        error = _known(simulation, rows)
        if error.size >= LEAST_LOG and abs(float(np.median(error))) >= CLEAR_GAP_V:
            low, high = 1e3 * np.quantile(error, (0.1, 0.9))
            said.append(f"its {name} lies {low:+.0f} to {high:+.0f} mV from the model")
    if said and len(sides) == 2:
        charge = simulation.log.counted_charge_Ah()
        out, back = (float(np.ptp(charge[sides[name]])) for name in ("discharge", "charge"))
        said.append(
            f"{back:.3f} Ah came back of {out:.3f} Ah: hysteresis and resistance on charge, a "
            "charge that was not whole, or a current sensor that is off"
        )
    return said
