"""Every log that was given, simulated back with the finished model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation, simulate
from cellwise.errors import InputError
from cellwise.identify.capacity.half_cycles import find_half_cycles, join_logs
from cellwise.identify.identification import OwnLog, Role, TestLogs
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.refinement.refine_stage import LARGEST_SOC_ERROR, Start
from cellwise.identify.soc_anchor import anchor_soc
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray

CLEAR_GAP_V = 0.02
FEWEST_ROWS = 5
BROUGHT_BACK = 0.95  # of what a discharge took: less is not one cycle


def simulate_back(
    model: CellModel, tests: TestLogs, ocv: OcvCurve, starts: Sequence[Start]
) -> tuple[OwnLog, ...]:
    """Every log, in the order in which it was given.

    Parameters
    ----------
    starts : logs that took part in a fit, and from where; of the others it is looked for
    """
    known = {id(s.log): s for s in starts}
    roles: list[tuple[Role, CellLog]] = []
    roles += [("hppc", log) for log, _ in tests.hppc]
    roles += [("ocv", log) for log in tests.ocv]
    roles += [("capacity", log) for log in tests.capacity]
    roles += [("drive", log) for log, _ in tests.drive]
    return tuple(_one(model, role, log, ocv, known.get(id(log))) for role, log in roles)


def _one(model: CellModel, role: Role, log: CellLog, ocv: OcvCurve, start: Start | None) -> OwnLog:
    if start is not None:
        simulation = simulate(model, log, min(max(start.soc0, 0.0), 1.0))
        tested = role in ("ocv", "capacity")
        reason = _gaps(simulation) if tested else ""
        sides = _sides(simulation) if tested else {}
        return OwnLog(role, True, simulation, start.rows, sides, reason)
    resistance = float(np.median(model.r0_ohm + model.r1_ohm))
    anchor = anchor_soc(log, ocv, model.capacity_Ah, resistance)
    simulation = simulate(model, log, min(max(anchor.soc, 0.0), 1.0))
    reason = "not part of the fit"
    if anchor.std > LARGEST_SOC_ERROR:
        reason = f"its SOC at the start is known to +-{100 * anchor.std:.0f} % only"
    return OwnLog(role, False, simulation, None, {}, reason)


def directions(log: CellLog) -> dict[str, BoolArray]:
    """Rows of the log's discharges and charges that move much; shape (n,) each."""
    try:
        halves = find_half_cycles(join_logs(log))
    except InputError:
        return {}
    most = max((abs(h.charge_Ah) for h in halves), default=0.0)
    found = {}
    for name, sign in (("discharge", 1.0), ("charge", -1.0)):
        rows = np.zeros(len(log), dtype=np.bool_)
        for half in halves:
            if sign * half.charge_Ah >= 0.5 * most:
                rows[half.steady_start : half.steady_stop] = True
        if np.count_nonzero(rows) >= FEWEST_ROWS:
            found[name] = rows
    return found


def _sides(simulation: Simulation) -> dict[str, float]:
    """RMSE of the discharge and of the charge of a test [V]."""
    found = {}
    for name, rows in directions(simulation.log).items():
        error = simulation.error_V[rows]
        error = error[np.isfinite(error)]
        if error.size:
            found[name] = float(np.sqrt(np.mean(error**2)))
    return found


def _gaps(simulation: Simulation) -> str:
    """The residual of a low-rate or capacity test that has a side the model does not follow."""
    parts = directions(simulation.log)
    said = []
    for name, rows in parts.items():
        error = simulation.error_V[rows]
        error = error[np.isfinite(error)]
        if error.size < FEWEST_ROWS or abs(float(np.median(error))) < CLEAR_GAP_V:
            continue
        low, high = 1e3 * np.quantile(error, (0.1, 0.9))
        said.append(f"its {name} lies {low:+.0f} to {high:+.0f} mV from the model")
    if not said:
        return ""
    charge = simulation.log.counted_charge_Ah()
    moved = {name: abs(float(np.ptp(charge[rows]))) for name, rows in parts.items()}
    if set(moved) == {"discharge", "charge"}:
        out, back = moved["discharge"], moved["charge"]
        said.append(f"{back:.3f} Ah came back of {out:.3f} Ah")
        said.append(
            "a current sensor that is off, or a charge that was not whole: the two sides do not "
            "share one SOC"
            if back < BROUGHT_BACK * out
            else "hysteresis and resistance on charge are not in the model"
        )
    return "; ".join(said)
