"""What these logs could show at all, and the shortest test that would show what they leave open.

Limits come from sensitivities and noise, before any cause is fitted. To second order a cause of
size d changes ln p of the rows, against the tolerances alone, by

    d^2 / 2 (1 / (s^2 + t^2) - 1 / (s^2 + w^2)) - ln((s^2 + w^2) / (s^2 + t^2)) / 2

with s what the rows leave uncertain of it once everything else may move within its tolerance, t its
tolerance and w the width of a fault. A test is chosen from simulating what competes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cellwise.cell.equations import empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate_rows, start_hysteresis
from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.coordinate_fit import Fit, shear
from cellwise.diagnose.fit.priors import GOOD, start_readings
from cellwise.diagnose.fit.rows import ScoredRows
from cellwise.diagnose.sets import Explanation, SearchOutcome
from cellwise.typing import FloatArray

# When logs show an effect.
NEUTRAL_STD = 1e-6  # of a coordinate that the tolerances do not have, in its unit
ROUNDING = 1e-12  # of an information, or of a fault's: less is what differences leave of none
TIMES = 2.0  # their limit: effects of this size are compared
APART = math.log(9.0)  # nats that separate them, as 0.9 against 0.1 does


@dataclass(frozen=True)
class DetectionLimits:
    """``sizes``: cause to parameter to the smallest change that these logs could show.

    ``inseparable``: groups of causes that they do not separate at twice their limits.
    """

    sizes: dict[str, dict[str, float]]
    inseparable: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the rows say of coordinates: their information (P, P), beside tolerances (P,)."""

    names: list[str]
    normal: FloatArray
    tolerance: FloatArray

    def left(self, change: FloatArray, free: Sequence[int]) -> float:
        """Information in a change (P,) once all it does not touch may move.

        Within their tolerances; those in ``free`` by any amount, whether it touches them or not.
        """
        precision = self.tolerance**-2.0
        precision[list(free)] = 0.0
        seen = np.diag(self.normal) > 0.0
        other = [k for k, s in enumerate(seen) if s and (change[k] == 0.0 or k in free)]
        pull = self.normal @ change
        inner = self.normal[np.ix_(other, other)] + np.diag(precision[other])
        return float(change @ pull) - float(pull[other] @ np.linalg.solve(inner, pull[other]))


def limits(
    fits: CauseFits, causes: Sequence[Cause], base: Fit, scale: float, least: float
) -> DetectionLimits:
    """Limits of every cause; ``least`` is the evidence that is asked for [nats]."""
    names = list(dict.fromkeys([*fits.prior.names, *(n for c in causes for n in _keys(fits, c))]))
    jacobian = fits.evidence.jacobian(base.coordinates, base.z, names)
    _, normal = fits.stated.times(scale).normal(base.voltage_V, jacobian)
    # A start that was read from a rest is read elsewhere where the OCV or the sensor is off.
    turned = shear(names, start_readings(names, fits.coordinates, fits.evidence))
    tolerance = np.array([fits.prior.std.get(n, NEUTRAL_STD) for n in names])
    seen = _Seen(names, turned.T @ normal @ turned, tolerance)
    sizes: dict[str, dict[str, float]] = {}
    at_limit: dict[str, FloatArray] = {}
    places: dict[str, list[int]] = {}
    for cause in causes:
        wide = fits.widened_for((cause,), fits.coordinates).std
        places[cause.name] = [names.index(n) for n in _keys(fits, cause) if n in wide]
        found, change = _sizes(
            fits, cause, seen, {k: wide[names[k]] for k in places[cause.name]}, least
        )
        if found:
            sizes[cause.name] = found
        if np.any(change):
            at_limit[cause.name] = change
    pairs = [
        {one, two}
        for one, two in combinations(at_limit, 2)
        if _alike(at_limit[one], places[two], seen) and _alike(at_limit[two], places[one], seen)
    ]
    return DetectionLimits(sizes, _groups(pairs, list(at_limit)))


def _keys(fits: CauseFits, cause: Cause) -> list[str]:
    """Coordinates of a cause that mean something where it is neutral."""
    if cause.kind == "start":
        return fits.evidence.starts()
    switches = cause.parameters[:1] if cause.shape is not None else cause.parameters
    return [p.coordinate for p in switches]


def _sizes(
    fits: CauseFits, cause: Cause, seen: _Seen, wide: dict[int, float], least: float
) -> tuple[dict[str, float], FloatArray]:
    """The limit of each parameter as people see it, and all of them as a point.

    ``wide``: places of its coordinates to the widths of a fault in them.
    """
    found: dict[str, float] = {}
    change = np.zeros(len(seen.names))
    start = fits.evidence.logs[0].start.soc
    for p in cause.parameters:
        place = seen.names.index(p.key) if p.key in seen.names else -1
        if place not in wide:
            continue
        unit = np.eye(len(seen.names))[place]
        known = seen.left(unit, ())
        if known <= ROUNDING * max(float(seen.normal[place, place]), wide[place] ** -2):
            continue  # these logs say nothing of it
        t2, w2 = 1.0 / known + seen.tolerance[place] ** 2, 1.0 / known + wide[place] ** 2
        if w2 <= t2:
            continue
        size = math.sqrt(2.0 * (least + 0.5 * math.log(w2 / t2)) / (1.0 / t2 - 1.0 / w2))
        change[place] = size
        if size > GOOD.ends * wide[place]:
            continue  # no fault is as large: the logs show none of it
        ends = [p.value(x, fits.coordinates, start) for x in (0.0, size, -size)]
        # A change that no cell can have is none that they show.
        sizes = [abs(e - ends[0]) for e in ends[1:] if p.bounds[0] <= e <= p.bounds[1]]
        if sizes:
            found[p.name] = sizes[0]
    return found, change


def _alike(change: FloatArray, other: Sequence[int], seen: _Seen) -> bool:
    """Whether another cause's coordinates can explain a change at twice its limit as well.

    Of several parameters the one that shows best stands for the cause. What the rows say, not how
    likely such a fault is.
    """
    place = int(np.argmax(np.abs(change) * np.sqrt(np.diag(seen.normal))))
    shown = np.where(np.arange(change.size) == place, TIMES * change, 0.0)
    return 0.5 * seen.left(shown, other) < APART


def _groups(pairs: Sequence[set[str]], order: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Pairs that share a cause are one group."""
    groups: list[set[str]] = []
    for pair in pairs:
        joined = [g for g in groups if g & pair]
        groups = [g for g in groups if g not in joined] + [pair.union(*joined)]
    return tuple(tuple(n for n in order if n in g) for g in groups)


LONGER_LOG = (
    "A drive of this cell of at least an hour, from a rest at a known SOC, with rests inside"
)
CLEAR_V = 3e-3  # a separation that a cell's own scatter cannot hide


class Experiment(NamedTuple):
    """A test on the bench: its steps (current in units of 1C, seconds), so many times over."""

    name: str
    soc0: float
    steps: tuple[tuple[float, float], ...]
    times: int = 1
    temperature_C: float = 25.0

    @property
    def current_C(self) -> FloatArray:
        """A row each second."""
        rates, seconds = np.array(self.steps * self.times).T
        return np.repeat(rates, seconds.astype(np.int64))


PULSES = (*((c, 10.0) for c in (2.0, 0.0, -2.0, 0.0, 0.5, 0.0)), (0.0, 72.0))
# Tests that every laboratory can run, short ones first.
EXPERIMENTS = (
    Experiment("Pulses of 10 s at 2C and C/2, both directions, at half charge", 0.5, PULSES, 6),
    Experiment("The same pulses at 45 degC", 0.5, PULSES, 6, 45.0),
    Experiment("The same pulses at 0 degC", 0.5, PULSES, 6, 0.0),
    Experiment(
        "A quarter of an hour of C/2 out and in again, then a rest",
        0.5,
        ((0.5, 900.0), (-0.5, 900.0), (0.0, 1800.0)),
    ),
    Experiment("1C from full for 50 minutes, then a rest", 1.0, ((1.0, 3000.0), (0.0, 3600.0))),
    Experiment("C/5 from full for 4.5 hours", 1.0, ((0.2, 4.5 * 3600.0),)),
    Experiment("C/20 from full for 19 hours", 1.0, ((0.05, 19.0 * 3600.0),)),
    Experiment("A rest of 24 hours at half charge, connected", 0.5, ((0.0, 86_400.0),)),
)


def next_test(outcome: SearchOutcome, model: CellModel, evidence: ScoredRows) -> str:
    """What to measure next; for any verdict but none.

    The experiment that would separate what competes; where one cause is left, the one in which it
    differs most from the model as it was; where nothing explains the error, the laboratory's tests
    where the error is.
    """
    close = list(outcome.open_between)
    if outcome.accepted:
        named = outcome.accepted[0].cause.name
        first = [e for e in outcome.first if named in e.names]
        close = first + [e for e in outcome.first if e not in first][:1]
    if close:
        return _separating(close)
    # As a log begins: that is what the chamber was set to, before the cell warmed itself.
    begun_C = float(np.median([g.temperature_C[0] for g in evidence.logs]))
    return (
        f"HPPC at {begun_C:.0f} degC and C/20 from full at 25 degC with this cell as it is now: "
        f"they show apart whether resistances, OCV or capacity differ from the model's "
        f"({model.capacity_Ah:.4g} Ah)"
    )


def _separating(close: Sequence[Explanation]) -> str:
    """The shortest experiment with a clear separation; else the one with the largest.

    A single explanation is separated from the model as it was.
    """
    plain = close[0].fit.coordinates
    found: list[tuple[float, Experiment]] = []
    for e in EXPERIMENTS:
        one = _voltage(close[0], e)
        two = _voltage(close[1], e) if len(close) > 1 else _simulated(plain, {}, e)
        found.append((float(np.sqrt(np.mean((one - two) ** 2))), e))
        if found[-1][0] >= CLEAR_V:
            break
    separation_V, best = max(found, key=lambda f: f[0])
    names = [" with ".join(e.names) for e in close[:2]]
    names = [n.replace("_", " ").replace("soc", "SOC") for n in names]
    other = names[1] if len(names) > 1 else "the model as it was"
    verdict = "separates" if separation_V >= CLEAR_V else "barely separates"
    return (
        f"{best.name} ({best.current_C.size / 3600.0:.2g} h): predicted to differ by "
        f"{1e3 * separation_V:.1f} mV RMS between {names[0]} and {other}, which {verdict} them"
    )


def _voltage(candidate: Explanation, experiment: Experiment) -> FloatArray:
    """Voltage that would be logged if the candidate were right."""
    keep = kept_coordinates(candidate.causes)
    # A known start: a cause that was the log's start predicts nothing new.
    z = {n: v for n, v in candidate.fit.z.items() if n in keep and not n.startswith("soc0:")}
    z = {n.partition(":")[0]: v for n, v in z.items()}
    return _simulated(candidate.fit.coordinates, z, experiment)


def _simulated(
    coordinates: Coordinates, z: Mapping[str, float], experiment: Experiment
) -> FloatArray:
    """Voltage that would be logged at a point in the coordinates."""
    inputs = coordinates.inputs(z)
    current = experiment.current_C * coordinates.model.capacity_Ah
    flow = (current - inputs.offset_A) / inputs.gain
    voltage, soc = np.empty(flow.size), np.empty(flow.size)
    start = empty_state(experiment.soc0, start_hysteresis(experiment.soc0))
    dt, temperature_C = np.ones(flow.size), np.full(flow.size, experiment.temperature_C)
    simulate_rows(inputs.tables, start, dt, flow, temperature_C, voltage, soc)
    return voltage + inputs.added_V
