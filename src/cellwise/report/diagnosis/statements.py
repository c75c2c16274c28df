"""A diagnosis as text: what every cause means with its numbers, the first line of its page."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.odds import Weighed
from cellwise.diagnose.result import Diagnosis, FoundCause, LogRun
from cellwise.report.page.numerals import (
    ampere_hours,
    duration,
    listed,
    millivolt,
    ohm_unit,
    percent,
    points,
    significant,
    spoken_name,
)

KINDS = {
    "measurement": "A fault of the measurement: the log is corrected, the cell's model is kept.",
    "start": "The initial SOC of the log: neither the cell nor its model is wrong.",
    "cell": "A property of the cell: the model is extended.",
}
UNITS = {"A": 1e3, "V": 1e3}
Values = Mapping[str, float]
CERTAIN = 0.9994  # a probability that is no longer written out
CORRECTED = " with the log corrected"


NAMED = re.compile("|".join(sorted((n for n in CAUSES if "_" in n), key=len, reverse=True)))


def in_words(text: str) -> str:
    """A line of the diagnosis with its causes named for people."""
    return NAMED.sub(lambda m: spoken_name(m[0]), text)


def diagnosis_finding(diagnosis: Diagnosis) -> str:
    """The first line: what to do with the model, why, and what that gains or loses."""
    judged = judged_run(diagnosis)
    if diagnosis.causes:
        said = [within(statement(diagnosis.causes[0], diagnosis))]
        if judged is not None:  # that the log is corrected stands before it
            size = change(judged).removesuffix(CORRECTED)
            still = ", still far off" if judged.explained.model_mismatch else ""
            said.append(f"{named_log(judged)} {size}{still}")
        lost = losses(diagnosis)
        but = f", but {listed(lost)}" if lost else ""
        return f"{advice(diagnosis)}: {'; '.join(said)}{but}."
    error = ""
    if judged is not None:
        error = f"{millivolt(judged.before.rmse_V)} RMSE on {named_log(judged)}"
    if diagnosis.verdict == "none":
        return f"Keep the model: no error beyond the stated one{'; ' * bool(error)}{error}."
    if diagnosis.verdict == "unexplained":
        return f"Do not rely on the model here: no cause that was tried explains {error or 'it'}."
    why = f": {in_words(diagnosis.reasons[0].rstrip('.'))}" if diagnosis.reasons else ""
    sets = [explanation(w) for w in diagnosis.competing if w.causes][:2]
    if len(sets) < 2:
        return f"Measure more: nothing was found, and nothing excluded{why}."
    return (
        f"Measure more before the model is changed: {error or 'its error'} may be {sets[0]}, "
        f"{sets[1]} or none of the causes tried."
    )


def advice(diagnosis: Diagnosis) -> str:
    """What to do with the extended model."""
    if diagnosis.adopt is None:
        kinds = [c.kind for c in diagnosis.causes]
        return "Keep the model, correct the log" if "measurement" in kinds else "Keep the model"
    if not diagnosis.adopt:
        return "Do not adopt the extended model"
    judged = diagnosis.soc_gain is not None
    return "Adopt the extended model" + ("" if judged else " for its voltage (SOC not judged)")


def losses(diagnosis: Diagnosis) -> list[str]:
    """What is worse on logs that were held out with the causes known, SOC first."""
    found = []
    gain = diagnosis.soc_gain
    if gain is not None and diagnosis.soc_worse:
        ends = (percent(gain[f"soc_rmse_{k}"]) for k in ("before", "after"))
        found.append(f"SOC gets worse, {' → '.join(ends)} RMSE")
    shown = judged_run(diagnosis)
    found += [f"{named_log(r)} {change(r)}" for r in diagnosis.worse if r is not shown]
    return found


def unsure_lines(diagnosis: Diagnosis) -> list[str]:
    """What the logs leave open: how probable a cause is, what is not separated, what not judged."""
    lines = [
        f"The gain by {spoken_name(c.name)} is not sure: {percent(c.gain, 0)} less error on "
        f"held-out data, {' to '.join(percent(v, 0) for v in c.gain_ci95)} in 95 of 100 cases."
        for c in diagnosis.causes
        if c.gain_ci95[0] < 0.0
    ]
    sure = [
        f"{spoken_name(c.name)} {probability(c.probability)}"
        for c in diagnosis.causes
        if c.probability <= CERTAIN
    ]
    lines += [f"Probability of {listed(sure)}."] if sure else []
    if not diagnosis.causes and len(diagnosis.competing) > 1:
        parts = (f"{explanation(w)} {probability(w.probability)}" for w in diagnosis.competing[:3])
        lines.append(f"Possible are {listed(list(parts))}.")
    named = {c.name for c in diagnosis.causes}
    for group in diagnosis.inseparable:
        if named & set(group):
            names = listed([spoken_name(c) for c in group])
            lines.append(f"Small effects of {names} look alike in these logs.")
    if diagnosis.no_soc_gain:
        lines.append(f"No gain in SOC is claimed: {diagnosis.no_soc_gain}.")
    return lines


def explanation(one: Weighed) -> str:
    """A set of causes for people."""
    return " with ".join(spoken_name(c) for c in one.causes) or "none of the causes tried"


def probability(share: float) -> str:
    """A probability the same way everywhere: never 100 % where it is less."""
    if share > CERTAIN:
        return "more than 99.9\N{NO-BREAK SPACE}%"
    return f"{100.0 * share:.1f}\N{NO-BREAK SPACE}%"


def weights(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Explanations and their probabilities, the others, every named cause over all of them."""
    rows = [(explanation(w), probability(w.probability)) for w in diagnosis.competing]
    rest = 1.0 - sum(w.probability for w in diagnosis.competing)
    if rest > 5e-4:
        rows.append(("all others together", probability(rest)))
    rows += [
        (f"{spoken_name(c.name)}, whatever is beside it", probability(c.probability))
        for c in diagnosis.causes
        if c.probability < 1.0
    ]
    return rows


def within(text: str) -> str:
    """A statement inside another: without its capital, unless it is an abbreviation."""
    first = text.split(" ", 1)[0]
    return text if len(first) > 1 and first.isupper() else f"{text[:1].lower()}{text[1:]}"


def shown_parameters(cause: FoundCause) -> list[tuple[str, float]]:
    """The parameters that the logs say something of; all of them where they say nothing of any."""
    known = [(k, v) for k, v in cause.parameters.items() if k not in cause.prior_only]
    return known or list(cause.parameters.items())


def judged_run(diagnosis: Diagnosis) -> LogRun | None:
    """The log that the first line speaks of: the first that was held out, else the first."""
    return next(iter(diagnosis.judged), None)


def named_log(run: LogRun) -> str:
    """A log's name, and whether the fit has seen it."""
    return f"{run.log.name or 'the log'}{' (held out)' if run.used == 'holdout' else ''}"


def change(run: LogRun) -> str:
    """What `simulate` shows with both models; where the log is corrected, that beside it."""
    before, after = run.before.rmse_V, run.after.rmse_V
    corrected = corrected_mV(run)
    if not corrected:
        return change_of(before, after)
    if math.isclose(before, after, rel_tol=1e-6):
        return f"{change_of(before, run.explained.rmse_V)}{CORRECTED}"
    return f"{change_of(before, after)}, {corrected}{CORRECTED}, too"


def corrected_mV(run: LogRun) -> str:
    """The RMSE of the corrected log; empty where it shows no other figure than the log itself."""
    if run.corrected is None:
        return ""
    shown = millivolt(run.corrected.rmse_V)
    return "" if shown == millivolt(run.after.rmse_V) else shown


def change_of(before_V: float, after_V: float) -> str:
    """``24 mV → 9 mV``."""
    if not (math.isfinite(before_V) and before_V > 0.0):
        return millivolt(after_V)
    return f"{millivolt(before_V)} → {millivolt(after_V)}"


def statement(cause: FoundCause, diagnosis: Diagnosis) -> str:
    """The cause with its numbers, without a full stop."""
    say = SAID.get(cause.name)
    said = cause.meaning.rstrip(".") if say is None else say(cause.parameters, diagnosis)
    return said if cause.log is None else f"{said} in {cause.log or 'one log'}"


def _reads(channel: str, size: str, value: float) -> str:
    much = "much" if value > 0.0 else "little"
    return f"The {channel} sensor reads {size} too {much}"


def _start(p: Values, d: Diagnosis) -> str:
    stated = d.soc0[0].get("value") if d.soc0 else None
    instead = f", not at {points(float(stated))}" if stated is not None else ""
    return f"The log starts at {points(p['soc0'])} SOC{instead}"


def _capacity(p: Values, d: Diagnosis) -> str:
    was = d.model.capacity_Ah
    share = p["capacity_Ah"] / was - 1.0
    more = "more" if share > 0.0 else "less"
    return (
        f"The cell holds {ampere_hours(p['capacity_Ah'])}, {percent(abs(share), 1)} {more} "
        f"than the model's {ampere_hours(was)}"
    )


def _ocv(p: Values, _: Diagnosis) -> str:
    knot = max(p, key=lambda k: abs(p[k]))
    soc = int(knot.split("_")[1]) / 1000.0
    return f"The OCV curve differs, by {millivolt(p[knot])} at {points(soc)} SOC"


def _resistances(where: str, factor: float, than: str) -> str:
    return f"Resistances {where} are {significant(factor)} times those {than}"


# What every cause is with its numbers; of the others their meaning is said.
SAID: dict[str, Callable[[Values, Diagnosis], str]] = {
    "current_offset": lambda p, _: _reads(
        "current", valued(abs(p["offset_A"]), "A"), p["offset_A"]
    ),
    "current_gain": lambda p, _: _reads(
        "current", percent(abs(p["gain"] - 1.0), 1), p["gain"] - 1.0
    ),
    "voltage_offset": lambda p, _: _reads("voltage", millivolt(abs(p["offset_V"])), p["offset_V"]),
    "time_skew": lambda p, _: (
        f"The voltage is logged {duration(abs(p['skew_s']))} "
        f"{'after' if p['skew_s'] > 0 else 'before'} the current"
    ),
    "initial_soc": _start,
    "capacity": _capacity,
    "ocv_shift": _ocv,
    "resistance_scale": lambda p, _: (
        f"Every resistance is {significant(p['scale'])} times the model's"
    ),
    "charge_transfer": lambda p, _: (
        f"The exchange current is {significant(p['exchange_scale'])} times the model's"
    ),
    "slow_diffusion": lambda p, _: (
        f"A slow polarisation is missing, {valued(p['r3_ohm'], 'ohm')} with {duration(p['tau3_s'])}"
    ),
    "hysteresis": lambda p, _: (
        f"The OCV depends on the direction, by {millivolt(p['m_V'])} to either side"
    ),
    "temperature_dependence": lambda p, _: _resistances(
        "at 15 °C", math.exp(p["activation_K"] * (1 / 288.15 - 1 / 298.15)), "at 25 °C"
    ),
    "rate_dependence": lambda p, _: _resistances(
        "at 1C", 1.0 / (1.0 + p["rate_h"]), "at small currents"
    ),
    "charge_asymmetry": lambda p, _: _resistances("on charge", p["charge_scale"], "on discharge"),
    "self_heating": lambda p, _: (
        f"The cell is warmer inside than logged, {significant(p['rth_K_per_W'])} K per watt "
        f"after {duration(p['thermal_s'])}"
    ),
    "self_discharge": lambda p, _: f"The cell discharges itself by {valued(p['leak_A'], 'A')}",
}


def valued(value: float, unit: str) -> str:
    """A parameter with its unit, in thousandths where that reads better."""
    scale = UNITS.get(unit)
    if scale is not None and abs(value) < 1.0:
        return f"{significant(scale * value)} m{unit}"
    if unit == "ohm":
        factor, name = ohm_unit(abs(value) or 1.0)
        return f"{significant(factor * value)} {name}"
    return significant(value) if unit == "1" else f"{significant(value)} {unit}"
