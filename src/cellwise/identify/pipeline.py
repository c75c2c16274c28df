"""Laboratory tests or drives in, CellModel out: the line of stations.

    logs -> capacity -> starts -> fit -> effects -> error -> plain model -> OCV, pulses
         -> own logs -> model

Each station takes the record of the one before and gives its own, with what it found wrong and what
it has to say. OCV and pulses come after the model, since they do not lead to it: they are for the
report, the methods of the papers, and a model without ``refine``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version

import numpy as np

from cellwise.arguments import check_kind
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.metrics import error_metrics
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import in_order
from cellwise.errors import InputError
from cellwise.fit.population import SPREAD
from cellwise.identify.assemble import plain_model, table_summary
from cellwise.identify.checked_logs import CheckedLogs, check_logs
from cellwise.identify.effect_selection import fit_with_effects
from cellwise.identify.fit_notices import fit_notices, poor_fit, start_notices
from cellwise.identify.fitted_pulses import MeasuredPulses, measure_pulses
from cellwise.identify.identification import (
    REFERENCE_C,
    CellTests,
    Fitted,
    Identification,
    IdentifySettings,
    TemperatureResult,
)
from cellwise.identify.joint_fit import gather_logs
from cellwise.identify.measured_capacity import MeasuredCapacity, measure_capacity
from cellwise.identify.measured_ocv import measure_ocv, pulse_counts
from cellwise.identify.ocv.curve import OcvCurve, curve_from_points
from cellwise.identify.own_logs import (
    check_possible,
    check_serves,
    identified_validity,
    other_capacities,
    own_log_notices,
    simulate_back,
    updates_for_worse,
)
from cellwise.identify.plain_model_check import check_against_plain
from cellwise.identify.stated_error import leave_out, stated_error
from cellwise.identify.tables import TableKind, pulse_tables
from cellwise.notices import Code, Notice, texts
from cellwise.threads import one_blas_thread
from cellwise.wording import arg

Progress = Callable[[str], None]
UNKNOWN_TEMPERATURE_K = 10.0  # by how much the temperature of one log and another differ


@one_blas_thread
def identify_cell(
    tests: CellTests, settings: IdentifySettings | None = None, progress: Progress | None = None
) -> Identification:
    """Identify a cell from its laboratory tests, or from a prior and what there is.

    Parameters
    ----------
    tests : CellTests          at least one HPPC or drive log; with a prior, one of any kind
    settings : IdentifySettings or None
    progress : callable or None       called with what is being done

    Returns
    -------
    Identification

    Raises
    ------
    InputError        no usable log; a log whose current has the wrong sign or unit; an unknown
                      capacity choice; tests that neither a model nor a prior fits
    """
    began = time.perf_counter()
    check_kind("tests", tests, CellTests, "Write CellTests(hppc=log), or CellTests(drive=log).")
    if settings is not None:
        check_kind("settings", settings, IdentifySettings, "Write IdentifySettings(nominal_Ah=5).")
    settings = IdentifySettings() if settings is None else settings
    say = progress or (lambda _: None)
    checked = check_logs(tests, settings)
    tests = checked.tests
    say("capacity")
    capacity = measure_capacity(checked, settings)
    fitted = _fitted(checked, capacity, settings, say)
    model = replace(fitted.model, name=settings.name)
    wrong = [*checked.contradictions, *capacity.contradictions, *fitted.contradictions]
    check_possible(model, wrong)
    say("validation on its own logs")
    own = simulate_back(model, tests, fitted, settings.prior)
    used = [o for o in own if o.used]
    error = error_metrics(np.concatenate([o.compared_V for o in used]))
    found = [*updates_for_worse(own), *own_log_notices(own)]
    wrong = wrong or poor_fit(own)  # what contradicts what says more
    check_serves(error.rmse_V, wrong)
    first = fitted.plain.notice if fitted.plain is not None else None
    contradictory = (() if first is None else (first,)) + in_order(wrong)
    said = (*capacity.notices, *fitted.notices, *start_notices(own), *checked.notices)
    reasons = [
        Notice(Code.OWN_LOG, f": {o.reason}", log=o.simulation.log.name) for o in used if o.reason
    ]
    seconds = time.perf_counter() - began
    choices = {**capacity.choices_Ah, **fitted.choices_Ah}
    provenance = {
        "cellwise_version": version("cellwise"),
        "capacity": {"choice": capacity.choice, "choices_Ah": choices},
        **fitted.provenance,
        "plain_model": None if fitted.plain is None else fitted.plain.to_dict(),
        "logs": tests.sources(),
        "seconds": round(seconds, 3),
    }
    validity = identified_validity(tests, used, settings.temperature_C)
    return Identification(
        model=replace(model, validity=validity, provenance=provenance),
        capacity_choice=capacity.choice,
        capacities=choices,
        capacity_tests=capacity.tests,
        ocv=fitted.ocv,
        temperatures=fitted.temperatures,
        own_logs=own,
        decided=fitted.decided,
        fit=error,
        notices=tuple(dict.fromkeys((*contradictory, *in_order(found, said), *reasons))),
        seconds=seconds,
        contradictions=contradictory,
        plain=fitted.plain,
    )


def _fitted(
    checked: CheckedLogs, capacity: MeasuredCapacity, settings: IdentifySettings, say: Progress
) -> Fitted:
    """The fit of all logs, its error, and the pulses and OCV that a person wants to see."""
    joint = gather_logs(checked, capacity, settings, say)
    say("fit")
    fit = fit_with_effects(joint)
    say("error")
    posterior = joint.posterior(fit.result, fit.logs, fit.settings)
    left_open = posterior
    folds = leave_out(fit)
    model, comparison = fit.model, None
    if settings.refine:
        say("plain model")
        check = check_against_plain(checked, fit, folds)
        comparison = check.comparison
        if comparison.reason:
            model, folds = check.model, check.folds
            posterior = posterior.as_wide_as_the_prior()
    error = stated_error(fit, model, folds, left_open, _of_unknown_temperature(checked))
    model = replace(model, error=error, posterior=posterior)
    if not settings.refine:  # pulses are of the capacity as it was measured
        model = replace(model, capacity_Ah=capacity.capacity_Ah)
    starts = fit.starts
    say("OCV and pulses")
    begun = {id(s.log): InitialSoc(s.soc0, 0.01, "as the fit has it") for s in starts}
    curve, wrong, said = _curve(checked, model)
    pulses = measure_pulses(checked, curve, model.capacity_Ah, settings, begun)
    if not settings.refine:
        model = _pulses_alone(pulses, curve, model.capacity_Ah, checked, settings.tables)
    results = {t: fit.result.at(t) for t in pulses.sets}
    return Fitted(
        model=_stated_of(model, checked.tests, settings),
        ocv=curve,
        starts=starts,
        temperatures=tuple(TemperatureResult(t, pulses.sets[t], results[t]) for t in results),
        decided=() if comparison and comparison.reason else fit.decided,
        choices_Ah={"fitted": model.capacity_Ah},
        provenance={
            "ocv": {"source": curve.source, "notes": texts(curve.notes)},
            "pulses": {
                "method": settings.method,
                "tables": settings.tables,
                "logs": [s.log.name for several in pulses.sets.values() for s in several],
                "fitted": sum(len(s.windows) for x in pulses.sets.values() for s in x),
            },
            "refinement": [
                {"temperature_C": t, **table_summary(result)} for t, result in results.items()
            ],
        },
        contradictions=(*wrong, *pulses.contradictions, *other_capacities(starts)),
        notices=(*said, *pulses.notices, *joint.notices, *fit_notices(posterior, checked)),
        plain=comparison,
    )


def _of_unknown_temperature(checked: CheckedLogs) -> float:
    """By what share the resistances may be another log's, where nobody measured a temperature.

    Rooms and seasons differ by some kelvin, and resistances follow with their activation.
    """
    tests = checked.tests
    stated = any(warm is not None for _, warm in (*tests.hppc, *tests.drive))
    if stated or any(log.temperature_C is not None for log in tests.logs()):
        return 0.0
    kelvin = REFERENCE_C + ZERO_CELSIUS_K
    return SPREAD.activation_K * UNKNOWN_TEMPERATURE_K / kelvin**2


def _curve(
    checked: CheckedLogs, model: CellModel
) -> tuple[OcvCurve, tuple[Notice, ...], tuple[Notice, ...]]:
    """The OCV as a test measured it; where none did, the model's."""
    try:
        measured = measure_ocv(checked, model.capacity_Ah)
    except InputError:
        at = model.at_temperature(checked.default_C)
        curve = curve_from_points(
            at.soc, at.ocv_V[0], capacity_Ah=model.capacity_Ah, source="the fit"
        )
        return curve, (), ()
    return measured


def _stated_of(model: CellModel, tests: CellTests, settings: IdentifySettings) -> CellModel:
    """With chemistry and voltage window: as stated, else as of the model that was the prior.

    A prior's window is widened to hold every log; without one it is what laboratory tests kept to.
    """
    prior = settings.prior
    kept = [*tests.capacity, *tests.ocv, *(log for log, _ in tests.hppc)]
    low = min((float(np.nanmin(x.voltage_V)) for x in kept), default=None)
    high = max((float(np.nanmax(x.voltage_V)) for x in kept), default=None)
    if prior is not None and prior.voltage_min_V is not None:
        low = min(prior.voltage_min_V, *(float(np.nanmin(x.voltage_V)) for x in tests.logs()))
    if prior is not None and prior.voltage_max_V is not None:
        high = max(prior.voltage_max_V, *(float(np.nanmax(x.voltage_V)) for x in tests.logs()))
    low, high = (None if v is None else round(v, 2) for v in (low, high))
    chemistry = settings.chemistry or ("" if prior is None else prior.chemistry)
    return replace(model, chemistry=chemistry, voltage_min_V=low, voltage_max_V=high)


def _pulses_alone(
    pulses: MeasuredPulses,
    curve: OcvCurve,
    capacity_Ah: float,
    checked: CheckedLogs,
    kind: TableKind,
) -> CellModel:
    """The pulses' tables as they are, as the papers take them: their error is not the fit's.

    Raises
    ------
    InputError        a temperature without a pulse
    """
    fits = {t: [f for s in several for f in s.fits] for t, several in pulses.sets.items()}
    for temperature_C, found in fits.items():
        if not found:
            raise InputError(
                f"{pulse_counts(checked.tests)}, none to fit at {temperature_C:g} "
                "degC, without refinement",
                "healthy pulses after a rest that move less than a third of the charge, or "
                "refinement",
                "Give an HPPC log whose pulses stay within the voltage limits, or leave out "
                + arg("refine", False)
                + ".",
            )
    tables = [pulse_tables(found, kind) for found in fits.values()]
    return plain_model(tables, curve, capacity_Ah, tuple(fits))
