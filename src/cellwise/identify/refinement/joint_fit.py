"""Fifth station: which logs take part in the joint fit, where each begins, the fit itself.

It starts at the tables of the pulses, or at one rough resistance shared out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import Effect
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import start_hysteresis
from cellwise.errors import InputError
from cellwise.identify.assemble import refined_model
from cellwise.identify.capacity.half_cycles import discharge_rows
from cellwise.identify.fitted_pulses import Group
from cellwise.identify.identification import REFERENCE_C, IdentifySettings, Start
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.refinement.layout import RefineSettings, StartTables
from cellwise.identify.refinement.problem import Problem
from cellwise.identify.refinement.refine import RefineResult, refine
from cellwise.identify.refinement.refine_data import PreparedLog, RefineLog, inverse_K
from cellwise.identify.refinement.splines import TABLE_KNOTS, greville
from cellwise.identify.soc_anchor import anchor_soc, full_before, likely_full, mean_current_A
from cellwise.typing import FloatArray


class TakesPart(NamedTuple):
    """What a log must show to take part in the fit.

    Parameters
    ----------
    soc_std : float     of its start: known less well, it is fitted with the tables
    deep : float        of the capacity, what a drive must move to show every SOC under load and at
                        rest
    discharge : float   of the capacity; scripts that finish a charge or discharge with small steps
                        show no OCV, and begin where a per cent of SOC is many millivolts
    inside : float      of a test's discharge, else it began elsewhere
    warmer_K : float    above the pulses. What a discharge says of slow resistances grows when it is
                        carried to colder tables, and activations of cells differ by 2,000 K and
                        more: a quarter over 10 K
    slow_s : float      a log must be this long to show the slow branch
    low_rate : float    weight of a low-rate test: hundreds of rows against the few rests of pulses,
                        and its SOC suffers most from a current sensor that is off
    """

    soc_std: float = 0.01
    deep: float = 0.3
    discharge: float = 0.1
    inside: float = 0.5
    warmer_K: float = 10.0
    slow_s: float = 1800.0
    low_rate: float = 0.8


LIMITS = TakesPart()
QUICK_ROWS, QUICK_ITERATIONS = 800, 12  # compared rows of a log, where fits are compared
BALANCE = 1.5  # over several temperatures: a log that is fitted worse counts less
SMOOTH_OF_SEVERAL = 0.003  # their logs are fitted worse, and what holds scales with that
HYSTERESIS_FROM_V = 0.004  # half gap between the low-rate branches, polarisation taken out
ROUGH_S = 10.0  # within which R0 and R1 have answered
USUAL_ACTIVATION_K = 3000.0  # of the resistances of lithium-ion cells, 2000 to 5000


@dataclass(frozen=True, eq=False)
class JointLogs:
    """What the joint fit is made of: logs, from where, with which settings.

    ``starts`` holds every log that was given, ``logs`` those that take part, in the same order;
    ``axis_std`` is by how much SOC the tables may be off with the starts that nobody stated.
    """

    logs: tuple[RefineLog, ...]
    starts: tuple[Start, ...]
    start: StartTables
    settings: RefineSettings
    capacity_Ah: float
    reference_C: float
    grid_C: FloatArray
    notices: tuple[str, ...]
    axis_std: float = 0.0

    def fit(
        self,
        logs: Sequence[RefineLog],
        settings: RefineSettings,
        theta: FloatArray | None = None,
        *,
        quick: int = 0,
        with_errors: bool = False,
    ) -> RefineResult:
        """Fit the tables to some logs; where fits are compared, in ``quick`` steps, fewer rows."""
        if quick:
            settings = replace(settings, iterations=quick)
        return refine(
            logs, self.start, settings=settings, capacity_Ah=self.capacity_Ah,
            reference_C=self.reference_C, grid_C=self.grid_C, theta=theta,
            most_rows=QUICK_ROWS if quick else None, with_errors=with_errors or quick == 0,
        )  # fmt: skip

    def residuals(
        self, result: RefineResult, logs: Sequence[RefineLog], settings: RefineSettings
    ) -> list[tuple[PreparedLog, FloatArray]]:
        """What a fit leaves of logs that it has not seen [V]."""
        problem = Problem(
            logs, self.start, settings, self.capacity_Ah, self.grid_C, self.reference_C, QUICK_ROWS
        )
        return list(zip(problem.logs, problem.residuals(result.theta), strict=True))

    def model_of(self, result: RefineResult, effects: Sequence[Effect] = ()) -> CellModel:
        """The model of a fit, and effects that lie beside its tables."""
        hot = any(item.log.temperature_C is not None for item in self.logs)
        model = refined_model(result, self.start, self.capacity_Ah, self.settings.skew, hot)
        for effect in effects:
            model = model.with_effect(effect)
        return model

    def with_starts_found(self) -> JointLogs:
        """Every log from where a first fit of tables and starts has it begin.

        Full where that is as likely as anything: it is how tests begin.
        """
        if all(item.start_std == 0.0 for item in self.logs):
            return self
        first = self.fit(self.logs, self.settings, quick=QUICK_ITERATIONS, with_errors=True)
        fitted = iter(zip(*first.moved_starts, strict=True))
        logs, soc0, notices, unsure = [], {}, [], []
        for item, start in zip(self.logs, self.used, strict=True):
            if item.start_std > 0.0:
                away, std = next(fitted)
                began = start.soc0 + away
                full = likely_full(began, std)
                began = 1.0 if full else began
                unsure += [] if full else [std]
                soc0[id(item.log)] = began
                soc = item.soc + (began - start.soc0)
                item = replace(item, soc=soc, start_std=0.0, h0=start_hysteresis(began))
                notices.append(
                    f"'{item.log.name}' begins at SOC {began:.3f} (fitted with the tables"
                    f"{': full' if full else f', +- {2.0 * std:.3f}'})"
                )
            logs.append(item)
        starts = tuple(s._replace(soc0=soc0.get(id(s.log), s.soc0)) for s in self.starts)
        axis_std = sum(unsure) / sum(item.compare is None for item in logs)
        said = (*self.notices, *notices)
        return replace(self, logs=tuple(logs), starts=starts, notices=said, axis_std=axis_std)

    @property
    def used(self) -> tuple[Start, ...]:
        """Where the logs that take part begin."""
        return tuple(s for s in self.starts if not s.left_out)


def gather_logs(
    groups: Sequence[Group], ocv: OcvCurve, capacity_Ah: float, settings: IdentifySettings
) -> JointLogs:
    """Find where every log begins; take those whose SOC is known.

    Low-rate and capacity tests take part with their discharge: it is what the SOC scale and the OCV
    near empty are known from.

    Raises
    ------
    InputError        no log whose SOC is known well enough
    """
    grid = np.array([g.temperature_C for g in groups])
    resistance = rough_resistance(groups)
    anchors = {id(s.log): s.anchor for g in groups for s in g.pulse_sets}
    driven = any(
        float(np.ptp(log.counted_charge_Ah())) >= LIMITS.deep * capacity_Ah
        for g in groups
        for log, _ in g.tests.drive
    )
    own_capacity = keep_own_capacity(groups, driven)
    logs: list[RefineLog] = []
    starts: list[Start] = []
    notices: list[str] = []
    samples = 0
    for item, why_not in (c for g in groups for c in _candidates(g, driven, capacity_Ah, grid)):
        log, part = item.log, item.compare
        anchor = anchors.get(id(log)) or anchor_soc(log, ocv, capacity_Ah, resistance)
        if part is not None and log.soc0 is None and part.any():
            anchor = full_before(log, part & discharge_rows(log), capacity_Ah, anchor)
        soc = anchor.soc - log.counted_charge_Ah() / capacity_Ah
        inside = (soc >= 0.0) & np.isfinite(log.voltage_V)
        if not why_not and part is not None and np.mean(inside[part]) < LIMITS.inside:
            why_not = f"its discharge would begin at SOC {float(soc[np.argmax(part)]):.2f}"
        starts.append(Start(log, anchor.soc, part, why_not))
        if why_not:
            notices.append(f"'{log.name}' left out of the refinement: {why_not}")
            continue
        known = anchor.std <= LIMITS.soc_std
        if known:
            notices.append(f"'{log.name}' begins at SOC {anchor.soc:.3f} ({anchor.how})")
        sample = samples if own_capacity and part is not None and not item.low_rate else None
        samples += sample is not None
        item = replace(item, soc=soc, h0=start_hysteresis(anchor.soc), sample=sample,
                       start_std=0.0 if known else anchor.std,
                       past_V=resistance * mean_current_A(log))  # fmt: skip
        logs.append(item)
    if all(item.compare is not None for item in logs):
        raise InputError(
            "no log whose SOC at the start is known",
            "a log with a rest where the OCV is steep, or one that begins full",
            "Let the cell rest before the test, or log the charge before it.",
        )
    start, hysteresis = start_tables(groups, ocv, resistance, capacity_Ah, settings.hysteresis)
    several = len(groups) > 1
    long = any(item.log.duration_s >= LIMITS.slow_s for item in logs)
    fit = RefineSettings(
        branches=settings.branches if long else 2,
        hysteresis=hysteresis,
        skew=any(item.skewed for item in logs),
        samples=samples,
        balance=BALANCE if several else 0.0,
        smooth=SMOOTH_OF_SEVERAL if several else RefineSettings.smooth,
    )
    reference = float(grid[int(np.argmin(np.abs(grid - REFERENCE_C)))])
    return JointLogs(tuple(logs), tuple(starts), start, fit, capacity_Ah, reference, grid,
                     tuple(notices))  # fmt: skip


def keep_own_capacity(groups: Sequence[Group], driven: bool) -> bool:
    """Whether capacity tests keep their own: a low-rate test holds the scale, drives what is new.

    A cell loses some per cent from one test to the next. On the scale of the others that bends the
    tables near empty, where a per cent is a tenth of a volt.
    """
    return driven and any(g.tests.ocv for g in groups)


def _candidates(
    group: Group, driven: bool, capacity_Ah: float, grid_C: FloatArray
) -> Iterator[tuple[RefineLog, str]]:
    """Logs of a temperature, their SOC yet unknown, and why one is left out; else empty.

    Where no drive goes deep, the charges and rests of capacity tests are the only ones there are.
    Beside pulses a capacity test much warmer than the tables is left out.
    """
    unknown = partial(RefineLog, soc=np.empty(0), temperature_C=group.temperature_C)
    for log, _ in group.tests.hppc:
        yield unknown(log), ""
    for log, _ in group.tests.drive:
        yield unknown(log, skewed=True), ""
    for log in group.tests.ocv:
        part = discharge_rows(log)
        out_Ah = np.diff(log.counted_charge_Ah(), prepend=0.0)[part]
        share = float(np.sum(np.maximum(out_Ah, 0.0))) / capacity_Ah
        little = f"its discharge moves {100 * share:.1f} % of the capacity"
        item = unknown(log, compare=part, low_rate=True, weight=LIMITS.low_rate)
        yield item, little if share < LIMITS.discharge else ""
    for log in group.tests.capacity:
        part = discharge_rows(log) if driven else np.ones(len(log), dtype=np.bool_)
        # When it began: its own load warms a cell.
        measured = log.temperature_C
        known = np.empty(0) if measured is None else measured[np.isfinite(measured)]
        warmest_C, warm = float(np.max(grid_C)), ""
        if group.tests.hppc and known.size and known[0] > warmest_C + LIMITS.warmer_K:
            warm = (
                f"it began at {known[0]:.0f} degC, the warmest pulses are of {warmest_C:.0f} degC"
            )
        yield unknown(log, compare=part), warm


def rough_resistance(groups: Sequence[Group]) -> float:
    """R0 + R1 of the pulses, else the answer of voltage to current within ROUGH_S of a load [ohm].

    From one mean to the next: row by row a voltage that lags answers with a fraction of it.
    """
    tables = next((g.tables for g in groups if g.tables is not None), None)
    if tables is not None:
        return float(np.median(tables.values["r0_ohm"] + tables.values["r1_ohm"]))
    slopes = []
    loads = [log for g in groups for log, _ in g.tests.drive]
    for log in loads or [log for g in groups for log in g.tests.capacity]:
        seen = np.isfinite(log.voltage_V)
        _, place = np.unique(log.time_s[seen] // ROUGH_S, return_inverse=True)
        means = (np.bincount(place, x[seen]) for x in (log.known_current_A(), log.voltage_V))
        di, dv = (np.diff(total / np.bincount(place)) for total in means)
        if di.any():
            slopes.append(-float(np.sum(dv * di) / np.sum(di**2)))
    return max(float(np.median(slopes)), 1e-5) if slopes else 1e-3


def start_tables(
    groups: Sequence[Group],
    ocv: OcvCurve,
    resistance_ohm: float,
    capacity_Ah: float,
    hysteresis: bool | None,
) -> tuple[StartTables, bool]:
    """Tables at the knots of every temperature, and whether hysteresis is fitted.

    A temperature without pulses takes those of the nearest one that has some, carried over with a
    usual activation energy.
    """
    at = greville(TABLE_KNOTS)
    known = [g for g in groups if g.tables is not None]

    def on_knots(name: str, otherwise: float) -> FloatArray:
        rows = []
        for g in groups:
            source = min(known, key=lambda k: abs(k.temperature_C - g.temperature_C), default=None)
            if source is None or source.tables is None:
                home, row = REFERENCE_C, np.full(at.size, otherwise)
            else:
                table = np.log(source.tables.values[name])
                home, row = source.temperature_C, np.exp(np.interp(at, source.tables.soc, table))
            usual = 0.0 if name.startswith("tau") else USUAL_ACTIVATION_K
            if source is None and len(groups) == 1:
                usual = 0.0  # the resistance is that of this temperature
            rows.append(row * np.exp(usual * inverse_K(g.temperature_C, home)))
        return np.array(rows)

    r = resistance_ohm
    r0, r2 = on_knots("r0_ohm", r), on_knots("r2_ohm", 0.5 * r)
    tau2 = np.clip(on_knots("tau2_s", 60.0), 5.0, 600.0)
    tau1 = np.minimum(on_knots("tau1_s", 3.0), 0.4 * tau2)
    half = half_gap(ocv, r, capacity_Ah)
    if hysteresis is None:
        hysteresis = half is not None and float(np.median(half)) > HYSTERESIS_FROM_V
    m = np.full(at.size, 0.005) if half is None else np.interp(at, ocv.soc, half)
    start = StartTables(
        ocv=ocv.function.evaluate,
        r0_ohm=r0,
        r_ohm=(on_knots("r1_ohm", 0.4 * r), r2, 0.5 * r * r0 / np.median(r0)),
        tau_s=(tau1, tau2, np.maximum(1200.0, 4.0 * tau2)),
        m_V=m if hysteresis else None,
    )
    return start, hysteresis


def half_gap(ocv: OcvCurve, resistance_ohm: float, capacity_Ah: float) -> FloatArray | None:
    """Half the gap between the low-rate branches with polarisation taken out [V], shape of soc.

    None without two whole branches. The current of a low-rate test is taken as C/20 at most, its
    resistance as three times the short-time one.
    """
    gap = ocv.gap_V
    middle = (ocv.soc > 0.05) & (ocv.soc < 0.95)
    if gap is None or not np.all(np.isfinite(gap[middle])):
        return None  # an incomplete charge branch says nothing of hysteresis
    known = np.isfinite(gap)
    filled = np.interp(ocv.soc, ocv.soc[known], gap[known])
    polarisation = 3.0 * resistance_ohm * capacity_Ah / 20.0
    return np.clip(0.5 * filled - polarisation, 0.0, 0.2)
