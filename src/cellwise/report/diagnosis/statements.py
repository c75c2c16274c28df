"""A diagnosis as text: what every cause means with its numbers, the first line of its page."""

from __future__ import annotations

import math

from cellwise.diagnose.log_runs import LogRun
from cellwise.diagnose.result import Diagnosis, FoundCause
from cellwise.report.page.numerals import (
    ampere_hours,
    duration,
    listed,
    millivolt,
    ohm_unit,
    percent,
    points,
    significant,
)

KINDS = {
    "measurement": "A fault of the measurement: the log is corrected, the cell's model is kept.",
    "start": "The initial SOC of the log: neither the cell nor its model is wrong.",
    "cell": "A property of the cell: the model is extended.",
}
UNITS = {"A": 1e3, "V": 1e3}


def cause_name(name: str) -> str:
    """A name of the contract for people."""
    return name.replace("_", " ").replace("ocv", "OCV").replace("soc", "SOC")


def diagnosis_finding(diagnosis: Diagnosis) -> str:
    """The first line: what is wrong and what its correction gains."""
    if diagnosis.causes:
        text = statement(diagnosis.causes[0], diagnosis)
        others = [cause_name(c.name) for c in diagnosis.causes[1:]]
        more = f", with {listed(others)}" if others else ""
        judged = judged_run(diagnosis)
        said = "" if judged is None else f": error on {named_log(judged)} {change(judged)}"
        return f"{text}{more}{said}{_soc_lost(diagnosis)}."
    if diagnosis.verdict == "none":
        judged = judged_run(diagnosis)
        rest = ""
        if judged is not None:
            error = millivolt(judged.before.metrics.rmse_V)
            rest = f" The residual on {named_log(judged)} is {error} RMSE."
        return f"These data show no error beyond the stated one.{rest}"
    if diagnosis.verdict == "unexplained":
        why = f": {diagnosis.reasons[0]}" if diagnosis.reasons else ""
        return f"The model is wrong, and none of the causes tried explains it{why}."
    sets = [w.causes for w in diagnosis.competing if w.causes][:2]
    if len(sets) < 2:
        why = f": {diagnosis.reasons[0].rstrip('.')}" if diagnosis.reasons else ""
        return f"These data do not show what is wrong, if anything is{why}."
    one, other = (" with ".join(cause_name(c) for c in names) for names in sets)
    return f"The model is wrong, but these data do not separate {one} from {other}."


def _soc_lost(diagnosis: Diagnosis) -> str:
    """A warning where the correction makes the SOC worse; empty where it does not."""
    gain = diagnosis.soc_gain or {}
    before, after = gain.get("soc_rmse_before", 0.0), gain.get("soc_rmse_after", 0.0)
    if after <= before:
        return ""
    return f"; but the SOC by the EKF gets worse with it, {percent(before)} to {percent(after)}"


def judged_run(diagnosis: Diagnosis) -> LogRun | None:
    """The log that the first line speaks of: the first that was held out, else the first."""
    held = [r for r in diagnosis.runs if r.used == "holdout"]
    return next(iter((*held, *diagnosis.runs)), None)


def named_log(run: LogRun) -> str:
    """A log's name, and whether the fit has seen it."""
    return f"{run.log.name or 'the log'}{' (held out)' if run.used == 'holdout' else ''}"


def change(run: LogRun) -> str:
    """What `simulate` shows with both models; where the log is corrected, that beside it."""
    before, after = run.before.metrics.rmse_V, run.after.metrics.rmse_V
    if run.corrected is None:
        return fall(before, after)
    corrected = run.corrected.metrics.rmse_V
    if math.isclose(before, after, rel_tol=1e-6):
        return f"{fall(before, corrected)} with the log corrected"
    return f"{fall(before, after)}, is {millivolt(corrected)} with the log corrected, too"


def fall(before_V: float, after_V: float) -> str:
    """``falls from 24 mV to 9 mV (−62 %)``."""
    if not (math.isfinite(before_V) and before_V > 0.0):
        return f"is {millivolt(after_V)}"
    change = after_V / before_V - 1.0
    verb = "falls" if change < 0.0 else "rises"
    return f"{verb} from {millivolt(before_V)} to {millivolt(after_V)} ({percent(change, 0)})"


def statement(cause: FoundCause, diagnosis: Diagnosis) -> str:
    """The cause with its numbers, without a full stop."""
    if cause.kind == "cell":
        return _of_cell(cause, diagnosis)
    p = cause.parameters
    if cause.name == "current_offset":
        return f"The current sensor reads {ampere(abs(p['offset_A']))} too {_much(p['offset_A'])}"
    if cause.name == "current_gain":
        share = p["gain"] - 1.0
        return f"The current sensor reads {percent(abs(share), 1)} too {_much(share)}"
    if cause.name == "voltage_offset":
        return (
            f"The voltage sensor reads {millivolt(abs(p['offset_V']))} too {_much(p['offset_V'])}"
        )
    if cause.name == "time_skew":
        late = "after" if p["skew_s"] > 0 else "before"
        return f"The voltage is logged {duration(abs(p['skew_s']))} {late} the current"
    if cause.name == "initial_soc":
        stated = diagnosis.soc0[0].get("value") if diagnosis.soc0 else None
        instead = f", not at {points(float(stated))}" if stated is not None else ""
        return f"The log starts at {points(p['soc0'])} SOC{instead}"
    return cause.meaning.rstrip(".")


def _of_cell(cause: FoundCause, diagnosis: Diagnosis) -> str:
    p = cause.parameters
    name = cause.name
    if name == "capacity":
        was = diagnosis.model.capacity_Ah
        share = p["capacity_Ah"] / was - 1.0
        more = "more" if share > 0.0 else "less"
        return (
            f"The cell holds {ampere_hours(p['capacity_Ah'])}, {percent(abs(share), 1)} {more} "
            f"than the model's {ampere_hours(was)}"
        )
    if name == "resistance_scale":
        return f"Every resistance is {significant(p['scale'])} times the model's"
    if name == "ocv_shift":
        knot = max(p, key=lambda k: abs(p[k]))
        soc = int(knot.split("_")[1]) / 1000.0
        return f"The OCV curve differs, by {millivolt(p[knot])} at {points(soc)} SOC"
    if name == "slow_diffusion":
        factor, unit = ohm_unit(abs(p["r3_ohm"]) or 1.0)
        size = f"{significant(factor * p['r3_ohm'])} {unit}"
        return f"A slow polarisation is missing, {size} with {duration(p['tau3_s'])}"
    if name == "hysteresis":
        return f"The OCV depends on the direction, by {millivolt(p['m_V'])} to either side"
    if name == "temperature_dependence":
        change = p["activation_K"] * (1 / 288.15 - 1 / 298.15)
        return f"Resistances at 15 °C are {significant(math.exp(change))} times those at 25 °C"
    if name == "charge_transfer":
        return f"The exchange current is {significant(p['exchange_scale'])} times the model's"
    if name == "rate_dependence":
        factor = 1.0 / (1.0 + p["rate_h"])
        return f"Resistances at 1C are {significant(factor)} times those at small currents"
    if name == "charge_asymmetry":
        scale = significant(p["charge_scale"])
        return f"Resistances on charge are {scale} times those on discharge"
    if name == "self_heating":
        rise = significant(p["rth_K_per_W"])
        after = duration(p["thermal_s"])
        return f"The cell is warmer inside than logged, {rise} K per watt after {after}"
    if name == "surface_soc":
        depth = points(p["depth_h"])
        after = duration(p["surface_s"])
        return f"At 1C the surface of the particles is {depth} below the mean SOC after {after}"
    if name == "self_discharge":
        return f"The cell discharges itself by {ampere(p['leak_A'])}"
    return cause.meaning.rstrip(".")


def ampere(current_A: float) -> str:
    """A current as ``98 mA`` or ``1.2 A``."""
    if abs(current_A) < 0.9995:
        return f"{significant(1e3 * current_A)} mA"
    return f"{significant(current_A)} A"


def valued(value: float, unit: str) -> str:
    """A parameter with its unit, in thousandths where that reads better."""
    scale = UNITS.get(unit)
    if scale is not None and abs(value) < 1.0:
        return f"{significant(scale * value)} m{unit}"
    if unit == "ohm":
        factor, name = ohm_unit(abs(value) or 1.0)
        return f"{significant(factor * value)} {name}"
    return significant(value) if unit == "1" else f"{significant(value)} {unit}"


def _much(value: float) -> str:
    return "much" if value > 0.0 else "little"
