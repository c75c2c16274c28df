"""Laboratory tests or drives in, CellModel out: the line of stations.

    logs -> capacity -> OCV -> pulses -> joint fit -> effects -> error -> own logs -> model

Each station takes the record of the one before and gives its own, with what it found wrong and what
it has to say. Where the logs see too little of a cell, the stations from OCV to error give way to
one: the update of a prior.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import version

import numpy as np

from cellwise.cell.metrics import error_metrics
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import RANGE_V, Notice, in_order
from cellwise.errors import InputError
from cellwise.identify.assemble import moved_ocv_notice, plain_model, table_summary
from cellwise.identify.checked_logs import CheckedLogs, check_logs
from cellwise.identify.fitted_pulses import Group, fit_all_pulses
from cellwise.identify.identification import (
    Decided,
    Fitted,
    Identification,
    IdentifySettings,
    Start,
    TemperatureResult,
    TestLogs,
)
from cellwise.identify.measured_capacity import MeasuredCapacity, measure_capacity
from cellwise.identify.measured_ocv import measure_ocv
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.own_logs import (
    check_possible,
    check_serves,
    identified_validity,
    other_capacities,
    own_log_notices,
    simulate_back,
    start_notices,
)
from cellwise.identify.prior.from_prior import fit_prior, needs_prior
from cellwise.identify.refinement.effects import fit_with_effects
from cellwise.identify.refinement.joint_fit import gather_logs
from cellwise.identify.refinement.refine import RefineResult
from cellwise.identify.refinement.stated_error import stated_error
from cellwise.identify.soc_anchor import anchor_soc
from cellwise.threads import one_blas_thread

Progress = Callable[[str], None]


@one_blas_thread
def identify_cell(
    tests: TestLogs, settings: IdentifySettings | None = None, progress: Progress | None = None
) -> Identification:
    """Identify a cell from its laboratory tests, or from a prior and what there is.

    Parameters
    ----------
    tests : TestLogs          at least one HPPC or drive log; with a prior, one of any kind
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
    settings = IdentifySettings() if settings is None else settings
    say = progress or (lambda _: None)
    checked = check_logs(tests, settings)
    tests = checked.tests
    say("capacity")
    capacity = measure_capacity(checked, settings)
    if settings.prior is not None or needs_prior(tests, settings):
        fitted = fit_prior(checked, capacity, settings, say)
    else:
        try:
            fitted = _of_tests(checked, capacity, settings, say)
        except InputError as short:
            if not settings.refine:
                raise
            fitted = _of_what_there_is(checked, capacity, settings, say, short)
    model = replace(
        fitted.model, name=settings.name, chemistry=settings.chemistry or fitted.model.chemistry
    )
    wrong = [*checked.contradictions, *capacity.contradictions, *fitted.contradictions]
    check_possible(model, wrong)
    say("validation on its own logs")
    own = simulate_back(model, tests, fitted)
    used = [o for o in own if o.used]
    error = error_metrics(np.concatenate([o.compared_V for o in used]))
    found = own_log_notices(own)
    check_serves(error.rmse_V, wrong)
    contradictory = in_order(wrong)
    said = (*capacity.notices, *fitted.notices, *checked.notices)
    if "prior" in fitted.provenance:
        said = (*said, *start_notices(own))
    reasons = [f"'{o.simulation.log.name}': {o.reason}" for o in used if o.reason]
    seconds = time.perf_counter() - began
    choices = {**capacity.choices_Ah, **fitted.choices_Ah}
    provenance = {
        "cellwise_version": version("cellwise"),
        "capacity": {"choice": capacity.choice, "choices_Ah": choices},
        **fitted.provenance,
        "logs": tests.sources(),
        "seconds": round(seconds, 3),
    }
    validity = identified_validity(tests, used, fitted.measured_soc, settings.temperature_C)
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
    )


def _of_tests(
    checked: CheckedLogs, capacity: MeasuredCapacity, settings: IdentifySettings, say: Progress
) -> Fitted:
    """OCV, pulses and fit of tests that show all that a model needs."""
    say("OCV")
    ocv = measure_ocv(checked, capacity.capacity_Ah)
    say("pulses")
    pulses = fit_all_pulses(checked, ocv.curve, capacity.capacity_Ah, settings)
    wrong, said = (*ocv.contradictions, *pulses.contradictions), (*ocv.notices, *pulses.notices)
    results: dict[float, RefineResult] = {}
    decided: tuple[Decided, ...] = ()
    if settings.refine:
        say("refinement")
        joint = gather_logs(pulses.groups, ocv.curve, capacity.capacity_Ah, settings)
        fit = fit_with_effects(joint)
        model, starts, decided = (
            replace(fit.model, error=stated_error(fit)),
            fit.starts,
            fit.decided,
        )
        results = {g.temperature_C: fit.result.at(g.temperature_C) for g in pulses.groups}
        wrong = (*wrong, *other_capacities(starts))
        said = (*said, *fit.joint.notices, *moved_ocv_notice(fit.of_loads()))
    else:
        model, starts = _pulses_alone(checked, pulses.groups, ocv.curve, capacity.capacity_Ah)
    sets = [s for g in pulses.groups for s in g.pulse_sets]
    # The voltage window that the laboratory tests kept to.
    tests = checked.tests
    levels = [x.voltage_V for x in (*tests.capacity, *tests.ocv, *(log for log, _ in tests.hppc))]
    low, high = (round(float(end(np.concatenate(levels))), 2) if levels else None
                 for end in (np.nanmin, np.nanmax))  # fmt: skip
    return Fitted(
        model=replace(model, voltage_min_V=low, voltage_max_V=high),
        ocv=ocv.curve,
        starts=starts,
        temperatures=tuple(
            TemperatureResult(g.temperature_C, g.pulse_sets, results.get(g.temperature_C))
            for g in pulses.groups
        ),
        measured_soc=ocv.curve.points_soc,
        decided=decided,
        provenance={
            "ocv": {"source": ocv.curve.source, "notes": list(ocv.curve.notes)},
            "pulses": {
                "method": settings.method,
                "tables": settings.tables,
                "logs": [s.log.name for s in sets],
                "fitted": sum(len(s.fits) for s in sets),
            },
            "refinement": [
                {"temperature_C": t, **table_summary(result)} for t, result in results.items()
            ],
        },
        contradictions=wrong,
        notices=said,
    )


def _pulses_alone(
    checked: CheckedLogs, groups: Sequence[Group], curve: OcvCurve, capacity_Ah: float
) -> tuple[CellModel, tuple[Start, ...]]:
    """The pulses' tables as they are, as the papers take them; where each log begins.

    Raises
    ------
    InputError        a temperature without a pulse
    """
    tables = [g.tables for g in groups if g.tables is not None]
    if len(tables) < len(groups):
        bare = next(g.temperature_C for g in groups if g.tables is None)
        raise InputError(
            f"no pulse at {bare:g} degC without refinement",
            "an HPPC log with pulses, or refinement",
            "Leave out `refine=False`.",
        )
    model = plain_model(tables, curve, capacity_Ah, [g.temperature_C for g in groups])
    resistance = float(np.median(model.r0_ohm + model.r1_ohm))
    anchors = {id(s.log): s.anchor for g in groups for s in g.pulse_sets}
    starts = []
    for log in checked.tests.logs():
        fitted = id(log) in anchors
        anchor = anchors[id(log)] if fitted else anchor_soc(log, curve, capacity_Ah, resistance)
        starts.append(Start(log, anchor.soc, None, "" if fitted else "not part of the fit"))
    return model, tuple(starts)


def _of_what_there_is(
    checked: CheckedLogs,
    capacity: MeasuredCapacity,
    settings: IdentifySettings,
    say: Progress,
    short: InputError,
) -> Fitted:
    """A prior updated on tests that show too little, with what they do not show said first.

    It counts as a contradiction: a model that is far from such tests is refused.

    Raises
    ------
    InputError        what the tests lack, where no prior fits them either
    """
    try:
        fitted = fit_prior(checked, capacity, settings, say)
    except InputError:
        hint = f"{short.action} Or start from a model of such a cell: `prior=NAME`."
        raise InputError(short.found, short.expected, hint) from None
    said = f"the tests alone give no model ({short.found}): it is a prior, updated on them"
    return replace(fitted, contradictions=(*fitted.contradictions, Notice(RANGE_V, said)))
