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
from cellwise.diagnose.decision.explanations import Explanation
from cellwise.diagnose.decision.outcome import Outcome
from cellwise.diagnose.extension import value_of
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit, normal_of, shear
from cellwise.diagnose.fit.noise import Noise
from cellwise.diagnose.fit.priors import GOOD, start_readings
from cellwise.diagnose.fit.rows import IGNORED, Evidence
from cellwise.typing import FloatArray


class Shown(NamedTuple):
    """When logs or a test show an effect.

    ``neutral_std``: a coordinate that the tolerances do not have is known to be neutral [its unit];
    less than ``rounding`` of an information, or of a fault's, is what differences leave of none.
    Effects of ``times`` their limit must be separated by ``apart`` nats, as much as 0.9 against 0.1
    is. ``clear_V``: a separation that a cell's own scatter cannot hide, in a test of rows every
    ``step_s``.
    """

    neutral_std: float = 1e-6
    rounding: float = 1e-12
    times: float = 2.0
    apart: float = math.log(9.0)
    clear_V: float = 3e-3
    step_s: float = 1.0


SHOWN = Shown()


@dataclass(frozen=True)
class Limits:
    """``sizes``: cause to parameter to the smallest change that these logs could show.

    ``inseparable``: groups of causes that they do not separate at twice their limits.
    """

    sizes: dict[str, dict[str, float]]
    inseparable: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the rows say of coordinates: their information (P, P), beside tolerances (P,).

    ``wide``: cause to places of its coordinates to the widths of a fault in them.
    """

    names: list[str]
    normal: FloatArray
    tolerance: FloatArray
    wide: dict[str, dict[int, float]]

    def left(self, place: int) -> float:
        """Information of one coordinate once all others may move within their tolerances."""
        own = float(self.normal[place, place])
        others = np.arange(self.tolerance.size) != place
        pull = self.normal[others, place]
        inner = self.normal[np.ix_(others, others)] + np.diag(self.tolerance[others] ** -2.0)
        left = own - float(pull @ np.linalg.solve(inner, pull))
        return left if left > SHOWN.rounding * own else 0.0


def limits(
    fits: CauseFits, causes: Sequence[Cause], base: Fit, noise: Noise, least: float
) -> Limits:
    """Limits of every cause; ``least`` is the evidence that is asked for [nats]."""
    names = list(fits.prior.names)
    for cause in causes:
        wanted = _coordinates(fits, cause)
        names += [n for n in wanted if n not in names]
    normal = _information(fits, base, noise, names)
    # A start that was read from a rest is read elsewhere where the OCV or the sensor is off.
    turned = shear(names, start_readings(names, fits.coordinates, fits.evidence))
    tolerance = np.array([fits.prior.std.get(n, SHOWN.neutral_std) for n in names])
    wide = {c.name: _wide(fits, c, names) for c in causes}
    seen = _Seen(names, turned.T @ normal @ turned, tolerance, wide)
    sizes: dict[str, dict[str, float]] = {}
    at_limit: dict[str, FloatArray] = {}
    for cause in causes:
        found, change = _sizes(fits, cause, seen, least)
        if found:
            sizes[cause.name] = found
        if np.any(change):
            at_limit[cause.name] = change
    pairs = [
        (one, two)
        for one, two in combinations(at_limit, 2)
        if _alike(one, two, seen, at_limit) and _alike(two, one, seen, at_limit)
    ]
    return Limits(sizes, _groups(pairs))


def _information(fits: CauseFits, base: Fit, noise: Noise, names: list[str]) -> FloatArray:
    """Fisher information of all used rows at the base fit."""
    evidence, objective = fits.evidence, fits.objective(noise)
    residual = np.nan_to_num(evidence.voltage_V - base.voltage_V)
    jacobian = evidence.jacobian(base.coordinates, base.z, names)
    white = objective.scaled(np.column_stack((residual, jacobian)))
    used = evidence.known & (evidence.role != IGNORED)
    return normal_of(white, used, objective.clip)[0]


def _coordinates(fits: CauseFits, cause: Cause) -> list[str]:
    """Coordinates of a cause that mean something where it is neutral."""
    switches = cause.parameters[:1] if cause.shape is not None else cause.parameters
    if cause.kind == "start":
        return fits.evidence.starts()
    return [p.coordinate for p in switches]


def _wide(fits: CauseFits, cause: Cause, names: list[str]) -> dict[int, float]:
    """Places of a cause's coordinates and the widths of a fault in them."""
    prior = fits.widened_for((cause,), fits.coordinates)
    wanted = _coordinates(fits, cause)
    return {k: prior.std[n] for k, n in enumerate(names) if n in wanted and n in prior.std}


def _sizes(
    fits: CauseFits, cause: Cause, seen: _Seen, least: float
) -> tuple[dict[str, float], FloatArray]:
    """The limit of each parameter as people see it, and all of them as a point."""
    wide = seen.wide[cause.name]
    found: dict[str, float] = {}
    change = np.zeros(len(seen.names))
    start = fits.evidence.logs[0].start.soc
    for p in cause.parameters:
        key = "soc0:0" if p.coordinate == "soc0" else p.coordinate
        place = seen.names.index(key) if key in seen.names else -1
        if place not in wide:
            continue
        known = seen.left(place)
        if known * wide[place] ** 2 <= SHOWN.rounding:
            continue  # these logs say nothing of it
        s2 = 1.0 / known
        t2, w2 = s2 + seen.tolerance[place] ** 2, s2 + wide[place] ** 2
        if w2 <= t2:
            continue
        size = math.sqrt(2.0 * (least + 0.5 * math.log(w2 / t2)) / (1.0 / t2 - 1.0 / w2))
        change[place] = size
        if size > GOOD.ends * wide[place]:
            continue  # no fault is as large: the logs show none of it
        ends = [value_of(p.coordinate, x, fits.coordinates, start) for x in (0.0, size, -size)]
        # A change that no cell can have is none that they show.
        sizes = [abs(e - ends[0]) for e in ends[1:] if p.bounds[0] <= e <= p.bounds[1]]
        if sizes:
            found[p.name] = sizes[0]
    return found, change


def _alike(one: str, two: str, seen: _Seen, at_limit: dict[str, FloatArray]) -> bool:
    """Whether the second can explain the first at twice its limit as well as the first itself."""
    own, wide = seen.wide[one], seen.wide[two]
    information = np.diag(seen.normal)
    change = SHOWN.times * at_limit[one]
    if len(own) > 1:
        # Of several parameters the one that shows best stands for the cause.
        place = int(np.argmax(np.abs(change) * np.sqrt(information)))
        change = np.where(np.arange(change.size) == place, change, 0.0)
    # What the rows say, not how likely such a fault is: the other's coordinates are free.
    precision = seen.tolerance**-2.0
    precision[list(wide)] = 0.0
    # What the other's coordinates and all tolerances leave of it.
    other = [k for k, i in enumerate(information) if i > 0.0 and (k not in own or k in wide)]
    pull = seen.normal @ change
    inner = seen.normal[np.ix_(other, other)] + np.diag(precision[other])
    left = float(change @ pull) - float(pull[other] @ np.linalg.solve(inner, pull[other]))
    return 0.5 * left < SHOWN.apart


def _groups(pairs: Sequence[tuple[str, str]]) -> tuple[tuple[str, ...], ...]:
    """Pairs that share a cause are one group."""
    groups: list[list[str]] = []
    for one, two in pairs:
        joined = [g for g in groups if one in g or two in g]
        merged = list(dict.fromkeys([*(n for g in joined for n in g), one, two]))
        groups = [g for g in groups if g not in joined] + [merged]
    return tuple(tuple(g) for g in groups)


LONGER_LOG = (
    "A drive of this cell of at least an hour, from a rest at a known SOC, with rests inside"
)


@dataclass(frozen=True, eq=False)
class Experiment:
    """A test on the bench: current over time, from a known SOC."""

    name: str
    soc0: float
    current_C: FloatArray
    temperature_C: float = 25.0

    @property
    def hours(self) -> float:
        """Length [h]."""
        return self.current_C.size * SHOWN.step_s / 3600.0


@dataclass(frozen=True)
class Proposal:
    """An experiment and by how much it separates the alternatives [V RMS]."""

    name: str
    hours: float
    separation_V: float

    def text(self, alternatives: Sequence[str]) -> str:
        """What to do, for people."""
        names = " and ".join(r.replace("_", " ").replace("soc", "SOC") for r in alternatives[:2])
        verdict = "separates" if self.separation_V >= SHOWN.clear_V else "barely separates"
        return (
            f"{self.name} ({self.hours:.2g} h): predicted to differ by "
            f"{1e3 * self.separation_V:.1f} mV RMS between {names}, which {verdict} them"
        )


def _steady(c_rate: float, hours: float) -> FloatArray:
    return np.full(int(hours * 3600 / SHOWN.step_s), c_rate)


def experiments() -> tuple[Experiment, ...]:
    """Tests that every laboratory can run, short ones first."""
    rest = _steady(0.0, 1.0)
    pulse = np.concatenate([_steady(c, 10 / 3600) for c in (2.0, 0.0, -2.0, 0.0, 0.5, 0.0)])
    pulses = np.concatenate([np.concatenate([pulse, _steady(0.0, 0.02)]) for _ in range(6)])
    cycle = np.concatenate([_steady(0.5, 0.25), _steady(-0.5, 0.25), _steady(0.0, 0.5)])
    return (
        Experiment("Pulses of 10 s at 2C and C/2, both directions, at half charge", 0.5, pulses),
        Experiment("The same pulses at 45 degC", 0.5, pulses, 45.0),
        Experiment("The same pulses at 0 degC", 0.5, pulses, 0.0),
        Experiment("A quarter of an hour of C/2 out and in again, then a rest", 0.5, cycle),
        Experiment(
            "1C from full for 50 minutes, then a rest",
            1.0,
            np.concatenate([_steady(1.0, 5 / 6), rest]),
        ),
        Experiment("C/5 from full for 4.5 hours", 1.0, _steady(0.2, 4.5)),
        Experiment("A rest of 24 hours at half charge, connected", 0.5, _steady(0.0, 24.0)),
        Experiment("C/20 from full for 19 hours", 1.0, _steady(0.05, 19.0)),
    )


def next_test(outcome: Outcome, model: CellModel, evidence: Evidence) -> str:
    """What to measure next; for any verdict but none.

    The experiment that would separate what competes; where one cause is left, the one in which it
    differs most from the model as it was; where nothing explains the error, the laboratory's tests
    where the error is.
    """
    if outcome.open_between:
        close = list(outcome.open_between)
    elif outcome.accepted:
        named = outcome.accepted[0].cause.name
        first = [e for e in outcome.first if named in e.names]
        close = first + [e for e in outcome.first if e not in first][:1]
    else:
        return _laboratory(model, evidence)
    proposal = propose(close)
    if proposal is None:
        return _laboratory(model, evidence)
    names = [" with ".join(e.names) for e in close[:2]]
    return proposal.text(names if len(names) > 1 else [*names, "the model as it was"])


def _laboratory(model: CellModel, evidence: Evidence) -> str:
    """Identification again, at the temperature of the logs."""
    middle = float(np.median(np.concatenate([g.temperature_C for g in evidence.logs])))
    return (
        f"HPPC at {middle:.0f} degC and C/20 from full at 25 degC with this cell as it is now: "
        f"they show apart whether resistances, OCV or capacity differ from the model's "
        f"({model.capacity_Ah:.4g} Ah)"
    )


def propose(alternatives: Sequence[Explanation]) -> Proposal | None:
    """The shortest experiment with a clear separation; else the one with the largest.

    A single alternative is separated from the model as it was.
    """
    if not alternatives:
        return None
    plain = alternatives[0].fit.coordinates
    best: Proposal | None = None
    for e in sorted(experiments(), key=lambda e: e.hours):
        one = _voltage(alternatives[0], e)
        two = _voltage(alternatives[1], e) if len(alternatives) > 1 else _simulated(plain, {}, e)
        # Where a start or a constant would do, only the shape counts for a known start: keep all.
        separation = float(np.sqrt(np.mean((one - two) ** 2)))
        found = Proposal(e.name, e.hours, separation)
        if separation >= SHOWN.clear_V:
            return found
        if best is None or separation > best.separation_V:
            best = found
    return best


def _voltage(candidate: Explanation, experiment: Experiment) -> FloatArray:
    """Voltage that would be logged if the candidate were right."""
    coordinates = candidate.fit.coordinates
    keep = kept_coordinates(candidate.causes)
    # A known start: a cause that was the log's start predicts nothing new.
    z = {n: v for n, v in candidate.fit.z.items() if n in keep and ":" not in n}
    return _simulated(coordinates, z, experiment)


def _simulated(
    coordinates: Coordinates, z: Mapping[str, float], experiment: Experiment
) -> FloatArray:
    """Voltage that would be logged at a point in the coordinates."""
    inputs = coordinates.inputs(z)
    current = experiment.current_C * coordinates.model.capacity_Ah
    flow = (current - inputs.offset_A) / inputs.gain
    n = current.size
    voltage, soc = np.empty(n), np.empty(n)
    start = empty_state(experiment.soc0, start_hysteresis(experiment.soc0))
    dt, warm = np.full(n, SHOWN.step_s), np.full(n, experiment.temperature_C)
    simulate_rows(inputs.tables, start, dt, flow, warm, voltage, soc)
    return voltage + inputs.added_V
