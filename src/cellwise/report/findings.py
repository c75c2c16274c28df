"""The first line of every page: what was found, with the numbers of the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.estimate.replay import CONVERGED_SOC, Replay
from cellwise.identify.identification import Identification
from cellwise.report.page.numerals import (
    SPACE,
    ampere_hours,
    capitalised,
    duration,
    listed,
    millivolt,
    percent,
    plural,
    points,
    significant,
)

EFFECTS = {
    "slow_diffusion": "a slow third branch",
    "hysteresis": "hysteresis",
    "temperature_dependence": "an Arrhenius factor",
    "time_skew": "the sampling delay of the logger",
}
TWO, TENTH = percent(CONVERGED_SOC, 0), percent(0.1, 0)
ESTIMATORS = {
    "ekf": "the EKF",
    "filterpy-ekf": "filterpy's EKF",
    "coulomb": "coulomb counting",
}


def identify_finding(identification: Identification) -> str:
    """What an identification found: the capacity, and the error on what it saw and did not see."""
    model = identification.model
    error = millivolt(identification.fit.rmse_V)
    prior = model.provenance.get("prior")
    text = ampere_hours(model.capacity_Ah)
    if isinstance(prior, Mapping):  # a model of another cell, as far as these logs corrected it
        band = significant(2.0 * float(prior["capacity_std_Ah"]), 2)
        size = significant(model.capacity_Ah)
        text = f"{prior['name']}, updated: {size} ± {band}{SPACE}Ah"
    text += f": {error} RMSE on its own {_own(identification)}"
    if unseen := unseen_drives(identification):
        worst = float(np.max([s.metrics.rmse_V for s in unseen]))
        one = len(unseen) == 1
        where = unseen[0].log.name or "a log" if one else plural(len(unseen), "log")
        text += f", {'' if one else 'at most '}{millivolt(worst)} on {where} outside the fit"
    return f"{text}."


def unseen_drives(identification: Identification) -> list[Simulation]:
    """The drives that were given and took no part in the fit."""
    return [o.simulation for o in identification.own_logs if not o.used and o.role == "drive"]


def model_kind(identification: Identification) -> str:
    """``2-RC model with a slow third branch and hysteresis``."""
    extra = [EFFECTS.get(e.name, e.name.replace("_", " ")) for e in identification.model.effects]
    return "2-RC model" + (f" with {listed(extra)}" if extra else "")


def replay_finding(replay: Replay) -> str:
    """What a replay found: its initial error, its convergence, its settled error."""
    who = ESTIMATORS.get(replay.estimator, replay.estimator)
    settled = replay.settled
    if replay.reference_soc is None or settled is None:
        return capitalised(
            f"{who} ends at {points(float(replay.trace.soc[-1]))} ± "
            f"{percent(2.0 * float(replay.trace.soc_std[-1]), 1)} SOC; there is no reference."
        )
    off = abs(float(replay.start.soc - replay.reference_soc[0]))
    begin = "From the right initial SOC" if off < 0.005 else f"From {100.0 * off:.0f} points off"
    if replay.convergence_s is None:
        return (
            f"{begin} {who} never comes within {TWO} for ten minutes: {percent(settled.rmse)} RMSE "
            "over the second half."
        )
    held = f"{percent(settled.rmse)} SOC RMSE, {percent(settled.max)} at most."
    if replay.convergence_s > 0.0:
        reached = f"is within {TWO} after {duration(replay.convergence_s)} "
    else:
        reached = "" if off < 0.005 else f"is within {TWO} from the first row on "
    # It has come within two points and stayed for ten minutes; later it may leave them again.
    then = "but drifts off later: " if settled.max > 1.5 * CONVERGED_SOC else "and then holds "
    return f"{begin} {who} {reached}{then if reached else 'holds '}{held}"


def simulation_finding(simulations: Sequence[Simulation]) -> str:
    """How well the model predicts the logs it is simulated on."""
    each = [s.rmse_above_10pct_V for s in simulations]
    known = [e for e in each if np.isfinite(e)]
    if not known:
        return f"{plural(len(simulations), 'log')} simulated."
    if len(known) == 1:
        name = simulations[0].log.name or "a log"
        return (
            f"The voltage of {name} is simulated with {millivolt(known[0])} RMSE above {TENTH} SOC."
        )
    mean = float(np.mean(known))
    return (
        f"The voltage of {plural(len(known), 'log')} is simulated with {millivolt(mean)} RMSE "
        f"above {TENTH} SOC in the mean, {millivolt(max(known))} at worst."
    )


def demo_finding(identification: Identification, simulations: Sequence[Simulation]) -> str:
    """The main result in short."""
    model = identification.model
    own = f"{millivolt(identification.fit.rmse_V)} RMSE on its own {_own(identification)}"
    text = f"{model.name or 'The cell'}, {ampere_hours(model.capacity_Ah)}: {own}"
    known = [s.rmse_above_10pct_V for s in simulations if np.isfinite(s.rmse_above_10pct_V)]
    if known:
        text += f", {millivolt(float(np.mean(known)))} on {plural(len(known), 'drive')} not seen"
    return f"{text}."


def replay_name(replay: Replay) -> str:
    """``ekf on drive_b from 70 %``."""
    return f"{replay.estimator} on {replay.log.name or 'log'} from {points(replay.start.soc)}"


def _own(identification: Identification) -> str:
    logs = sum(own.used for own in identification.own_logs)
    return "log" if logs == 1 else plural(logs, "log")
