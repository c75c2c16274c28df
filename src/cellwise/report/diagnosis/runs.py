"""Logs of a diagnosis simulated before and after: as they were, and with the causes known."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellwise.cell.effects import TimeSkew
from cellwise.cell.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation, simulate
from cellwise.diagnose.anatomy import anatomy
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.extension import correct_log
from cellwise.diagnose.result import Diagnosis
from cellwise.logs.cell_log import CellLog

# This part of a held-out log determines its initial SOC, as in the model comparison.
START_PART = 0.15
REACH = 0.3


@dataclass(frozen=True, eq=False)
class BeforeAfter:
    """One log with the model as it was, and the corrected log with the extended model."""

    log: CellLog
    held_out: bool
    before: Simulation
    after: Simulation

    @property
    def gain(self) -> float:
        """1 - after / before of the RMSE."""
        rmse = self.before.metrics.rmse_V
        return 1.0 - self.after.metrics.rmse_V / rmse if rmse > 0.0 else 0.0


def before_after(diagnosis: Diagnosis) -> tuple[BeforeAfter, ...]:
    """Held-out logs first, then the others; without causes nothing changes."""
    extended = _model_after(diagnosis)
    fixed = {**dict(enumerate(diagnosis.corrected))}
    count = len(diagnosis.logs)
    result = []
    for k, log in enumerate((*diagnosis.logs, *diagnosis.holdout)):
        initial = _initial(diagnosis, k, log)
        before = simulate(diagnosis.model, log, _start(diagnosis.model, log, initial, k >= count))
        if extended is None:
            after = before
        else:
            corrected = fixed[k] if k in fixed else _corrected(diagnosis, log)
            estimated = any(c.name == "initial_soc" for c in diagnosis.causes)
            initial = {**initial, "how": "open"} if estimated else initial
            after = simulate(extended, corrected, _start(extended, corrected, initial, k >= count))
        result.append(BeforeAfter(log, k >= count, before, after))
    return tuple(sorted(result, key=lambda r: not r.held_out))


def with_anatomy(diagnosis: Diagnosis) -> Diagnosis:
    """The diagnosis with the anatomy of its first log's residual, if it has none."""
    if diagnosis.anatomy:
        return diagnosis
    log = diagnosis.logs[0]
    start = min(max(float(_initial(diagnosis, 0, log)["value"]), 0.0), 1.0)
    return replace(diagnosis, anatomy=anatomy(diagnosis.model, log, start))


def _initial(diagnosis: Diagnosis, k: int, log: CellLog) -> dict[str, Any]:
    """Where a log starts; found again where the search ended before that."""
    if k < len(diagnosis.soc0):
        return diagnosis.soc0[k]
    return {**initial_soc(diagnosis.model, log).to_dict()}


def _model_after(diagnosis: Diagnosis) -> CellModel | None:
    """The extended model for corrected logs, whose sampling delay is removed already."""
    model = diagnosis.extended_model
    if model is None:
        return None
    usual = tuple(e for e in model.effects if not isinstance(e, TimeSkew))
    own = tuple(e for e in diagnosis.model.effects if isinstance(e, TimeSkew))
    return replace(model, effects=(*usual, *own))


def _corrected(diagnosis: Diagnosis, log: CellLog) -> CellLog:
    """A log with the instrument's causes taken out."""
    z: dict[str, float] = {}
    for cause in diagnosis.causes:
        if cause.kind == "measurement":
            z.update(cause.parameters)
    if "gain" in z:
        z["ln_gain"] = math.log(z.pop("gain"))
    return correct_log(log, Coordinates(diagnosis.model), z)


def _start(model: CellModel, log: CellLog, initial: dict[str, Any], held_out: bool) -> float:
    """SOC at the first row: as given, else where the log's first part fits best."""
    value = min(max(float(initial["value"]), 0.0), 1.0)
    if initial.get("how") == "given":
        return value
    span = log.time_s[-1] - log.time_s[0]
    part = START_PART if held_out else 1.0
    stop = int(np.searchsorted(log.time_s, log.time_s[0] + part * span, side="right"))
    head = log.part(0, min(max(stop, 2), len(log)))
    low, high = max(value - REACH, 0.0), min(value + REACH, 1.0)
    for _ in range(4):  # a grid, then finer ones about its best point
        grid = np.linspace(low, high, 9)
        errors = [float(np.nanmean(simulate(model, head, float(s)).error_V ** 2)) for s in grid]
        value = float(grid[int(np.argmin(errors))])
        step = float(grid[1] - grid[0])
        low, high = max(value - step, 0.0), min(value + step, 1.0)
    return value
