"""What goes into a diagnosis, checked; whether one is possible; whether a model's claim holds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import fdtri

from cellwise.arguments import number, shown
from cellwise.cell.model import CellModel
from cellwise.diagnose.causes.catalogue import CAUSES, ON_REQUEST, Cause
from cellwise.diagnose.fit.coordinate_fit import Fit
from cellwise.diagnose.fit.noise import STATED, share_claimed
from cellwise.diagnose.fit.rows import ScoredRows
from cellwise.diagnose.result import LogRun
from cellwise.errors import InputError
from cellwise.fit.model_error import charged_for_minutes, polarisation_of
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.units import check_is_log
from cellwise.wording import arg

Logs = CellLog | Sequence[CellLog]
Start = float | None  # None: not known
START = "a fraction from 0 to 1 or None, or one of them for every log"
CORRECT_START = "Give " + arg("soc0", 0.9) + ", say; left out it is found from the log."


def logs_of(logs: Logs) -> tuple[CellLog, ...]:
    """One log or several as several.

    Raises
    ------
    InputError        what is no log
    """
    if isinstance(logs, str) or not isinstance(logs, Iterable):
        check_is_log(logs)
        return (logs,)
    found = tuple(logs)
    for log in found:
        check_is_log(log)
    return found


def causes_of(names: str | Sequence[str] | None) -> list[Cause]:
    """Causes by their names; without any, all that need no request.

    Raises
    ------
    InputError        an unknown cause
    """
    if names is None:
        return [c for c in CAUSES.values() if c.name not in ON_REQUEST]
    several = names if isinstance(names, Iterable) and not isinstance(names, str) else [names]
    found = []
    for name in several:
        if name not in CAUSES:
            raise InputError(
                f"cause {shown(name)}", f"one of {', '.join(CAUSES)}", "Correct its name."
            )
        found.append(CAUSES[name])
    return found


def stated_starts(
    groups: Sequence[Sequence[CellLog]], soc0: Start | Sequence[Start]
) -> list[Start]:
    """What is said of every log's start; a log's own goes before one for all.

    Raises
    ------
    InputError        what is neither a number nor None, or more of them than logs
    """
    logs = [g for group in groups for g in group]
    if isinstance(soc0, str) or not isinstance(soc0, Iterable):
        one = _start(soc0)
        return [one if g.soc0 is None else g.soc0 for g in logs]
    stated = [_start(s) for s in soc0]
    if len(stated) > len(logs):
        raise InputError(
            f"soc0 for {len(stated)} logs", f"at most one for each of {len(logs)}", CORRECT_START
        )
    return stated + [None] * (len(logs) - len(stated))


def _start(value: object) -> Start:
    return None if value is None else number("soc0", value, START, CORRECT_START)


# Less says nothing.
LEAST_DURATION_S = 300.0
FEWEST_ROWS = 60  # with a voltage
LEAST_CURRENT_C = 0.02  # in units of 1C

# Beyond these the log is of another kind of cell, whatever its age.
OTHER_CELL = "this looks like another cell"
OTHER_CELL_V = 0.12
OTHER_CELL_SOC = 0.25  # beyond 0 to 1
OUTSIDE_K = 8.0  # of the model's temperatures: it was not measured at the log's

RARE_ERROR = 1e-3  # an error that the claim would give in so many of all logs is beyond it
# Row-to-row noise of another sensor than the data's is no error of the model up to this.
OTHER_SENSOR_V = 0.005


def too_little(model: CellModel, logs: Sequence[CellLog]) -> str:
    """What is missing for any verdict; empty if nothing is."""
    duration = sum(g.duration_s for g in logs)
    rows = sum(int(np.isfinite(g.voltage_V).sum()) for g in logs)
    if rows < FEWEST_ROWS or duration < LEAST_DURATION_S:
        return (
            f"too short: {rows} rows with a voltage over {duration:.0f} s; at least {FEWEST_ROWS} "
            f"rows over {LEAST_DURATION_S:.0f} s are needed"
        )
    current = np.concatenate([g.current_A[np.isfinite(g.current_A)] for g in logs])
    if current.size == 0:
        return "no current in the log"
    swing = float(np.quantile(np.abs(current), 0.99))
    if swing < LEAST_CURRENT_C * model.capacity_Ah:
        return (
            f"too quiet: the current stays below {swing:.3g} A "
            f"({swing / model.capacity_Ah:.3f} C); a load of C/20 or more is needed"
        )
    return ""


def another_cell(model: CellModel, evidence: ScoredRows, base: Fit) -> str:
    """Why the log cannot be of the model's kind of cell, or from its start; empty if it can.

    ``base`` is the best the model can do within its tolerances. A voltage far outside the model's
    window, a charge beyond any capacity, or an error no fault explains is another cell.
    """
    used, voltage = evidence.known, evidence.voltage_V[evidence.known]
    low, high = float(np.min(model.ocv_V)), float(np.max(model.ocv_V))
    middle = float(np.median(voltage))
    if middle > high + OTHER_CELL_V or middle < low - OTHER_CELL_V:
        return (
            f"{OTHER_CELL}: the log's median voltage {middle:.2f} V lies outside the model's OCV "
            f"({low:.2f} to {high:.2f} V)"
        )
    lowest, highest = float(np.min(base.soc[used])), float(np.max(base.soc[used]))
    if lowest < -OTHER_CELL_SOC or highest > 1.0 + OTHER_CELL_SOC:
        moved = (highest - lowest) * model.capacity_Ah
        through = f"the log moves {moved:.3g} Ah through a model of {model.capacity_Ah:.3g} Ah"
        if highest - lowest <= 1.0 + OTHER_CELL_SOC:  # it holds as much, from another start
            return (
                f"{through}, and from its start the SOC would run from {lowest:.2f} to "
                f"{highest:.2f}: the start is wrong"
            )
        return f"{OTHER_CELL}: {through}"
    error = float(np.median(np.abs(voltage - base.voltage_V[used])))
    if error > OTHER_CELL_V:
        off = f"the model is {1e3 * error:.0f} mV off in the median"
        return f"{OTHER_CELL}: {off}, more than any fault explains"
    return ""


def unseen_temperature_C(model: CellModel, evidence: ScoredRows) -> float | None:
    """The logs' temperature where the model was not measured at it; None where it was."""
    middle = float(np.median(np.concatenate([g.temperature_C for g in evidence.logs])))
    seen = [*model.temperature_C, *(model.validity.temperature_C or ())]
    inside = float(min(seen)) - OUTSIDE_K <= middle <= float(max(seen)) + OUTSIDE_K
    return None if inside else middle


class ClaimCheck(NamedTuple):
    """A log's error over what the model claims there, and how much of that chance would give."""

    log: str
    rmse_V: float
    times: float
    most: float

    @property
    def beyond(self) -> bool:
        """Whether the error is larger than the claim allows."""
        return self.times > self.most

    def text(self) -> str:
        """For people."""
        return (
            f"the error on {self.log or 'the log'} is {1e3 * self.rmse_V:.1f} mV RMSE, "
            f"{self.times:.1f} times what the model claims of itself there"
        )


def claim_checks(
    model: CellModel, runs: Sequence[LogRun], evidence: ScoredRows
) -> tuple[ClaimCheck, ...]:
    """Every log as `simulate` shows it before any correction.

    The claim at a row is the model's slow error at its SOC, its share of the polarisation,
    its noise, and what the initial SOC leaves uncertain through the slope of the OCV. The slow part
    stays for ``correlation_s``, so that a log holds few independent errors, and the claim itself
    comes from few (``STATED.errors``): the mean square over the claim's is compared with the F
    distribution of as many degrees of freedom.
    """
    found = []
    for run, rows in zip(runs, evidence.logs, strict=True):
        error, soc = run.before.residual_V, np.clip(run.before.soc, 0.0, 1.0)
        known = np.isfinite(error)
        if not known.any():
            continue
        temperature_C = float(np.median(rows.temperature_C))
        drop = polarisation_of(model, soc, np.full(soc.size, temperature_C), run.before.voltage_V)
        share = share_claimed(model.error, drop, charged_for_minutes(run.log))
        slope = np.gradient(model.ocv_at(temperature_C), model.soc)
        start = rows.start.std * np.interp(soc, model.soc, slope)
        steps = np.abs(np.diff(error))
        steps = steps[np.isfinite(steps)]
        noise = 1.4826 * float(np.median(steps)) / math.sqrt(2.0) if steps.size else 0.0
        white = max(model.error.white_V, min(noise, OTHER_SENSOR_V))
        claim2 = np.asarray(model.slow_error_V(soc, temperature_C)) ** 2
        claim2 = claim2 + (share * drop) ** 2 + white**2 + start**2
        times2 = float(np.mean(error[known] ** 2 / claim2[known]))
        freedom = 1.0 + run.log.duration_s / (2.0 * max(model.error.correlation_s, 1.0))
        most2 = float(fdtri(freedom, STATED.errors, 1.0 - RARE_ERROR))
        rmse_V = run.before.rmse_V
        found.append(ClaimCheck(run.log.name, rmse_V, math.sqrt(times2), math.sqrt(most2)))
    return tuple(found)
