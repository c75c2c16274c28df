"""The one fit with the coordinates of :mod:`cellwise.diagnose.causes.coordinates` as its unknowns.

Every coordinate is always in the fit, held near zero by what a good laboratory leaves uncertain
(its *tolerance*); a cause is a coordinate with a wide prior. So a small error of identification
does not pass for a fault, and two explanations compete by how much they explain for what they
cost: the marginal likelihood (Laplace).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cellwise.diagnose.causes.coordinates import Coordinates, KernelInputs, step_of
from cellwise.diagnose.fit.noise import Objective, normal_of
from cellwise.diagnose.fit.rows import FITTED, START, ScoredRows
from cellwise.fit.solver import UNDAMPED, Prior, SolverSettings, minimise
from cellwise.typing import FloatArray

Values = Mapping[str, float]
Simulated = tuple[FloatArray, FloatArray]  # voltage [V] and SOC
SEARCH = SolverSettings(
    iterations=7, least_gain=0.02, damping=UNDAMPED
)  # less than it separates no causes


@dataclass(frozen=True)
class Tolerances:
    """Mean and standard deviation of every coordinate in a fit, with bounds.

    ``cross`` (m, m) are covariances between the coordinates ``linked``, zero on its diagonal: what
    was calibrated together on a baseline log stays correlated. ``read``: start to coordinate to
    what a unit of it moves the start's mean by (:mod:`cellwise.diagnose.fit.priors`).
    """

    std: Values
    mean: Values
    low: Values
    high: Values
    linked: tuple[str, ...] = ()
    cross: FloatArray | None = None
    read: Mapping[str, Values] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """The coordinates, in order."""
        return list(self.std)

    def widened(
        self,
        std: Values,
        mean: Values,
        low: Values,
        high: Values,
        read: Mapping[str, Values] | None = None,
    ) -> Tolerances:
        """The prior with some coordinates widened, and what those make of the starts' readings."""
        more = read or {}
        return replace(
            self,
            std={**self.std, **std},
            mean={**self.mean, **mean},
            low={**self.low, **low},
            high={**self.high, **high},
            read={s: {**self.read.get(s, {}), **more.get(s, {})} for s in {**self.read, **more}},
        )

    def precision(self) -> FloatArray:
        """Inverse covariance of the coordinates, in the order of ``names``."""
        names = self.names
        covariance = np.diag([self.std[n] ** 2 for n in names])
        if self.cross is None:
            precision = np.asarray(np.diag(1.0 / np.diag(covariance)))
        else:
            place = [names.index(n) for n in self.linked]
            covariance[np.ix_(place, place)] += self.cross
            precision = np.asarray(np.linalg.inv(covariance))
        if not self.read:
            return precision
        own = 2.0 * np.eye(len(names)) - shear(names, self.read)
        return np.asarray(own.T @ precision @ own)

    def prior(self) -> Prior:
        """As the fit takes it, in the order of ``names``."""
        names = self.names
        return Prior(
            np.array([self.mean.get(n, 0.0) for n in names]),
            self.precision(),
            np.ones(len(names), dtype=np.bool_),
            np.array([self.low.get(n, -np.inf) for n in names]),
            np.array([self.high.get(n, np.inf) for n in names]),
        )

    def point(self, z: Values) -> FloatArray:
        """A point in the order of ``names``; 0 where it says nothing."""
        return np.array([z.get(n, 0.0) for n in self.names])


def shear(names: Sequence[str], read: Mapping[str, Values]) -> FloatArray:
    """From what starts were read as, and all else, to the coordinates ``names``."""
    found = np.eye(len(names))
    for start, moved in read.items():
        for name, by in moved.items():
            if start in names and name in names:
                found[names.index(start), names.index(name)] = by
    return found


@dataclass(frozen=True, eq=False)
class Fit:
    """A point, its covariance, and how well it explains what was fitted and what was held out.

    ``log_evidence`` is ln p(fitted rows). Logs that are only held out are NaN in ``voltage_V`` and
    ``soc`` until the fit is completed (:func:`complete`).
    """

    z: dict[str, float]
    names: tuple[str, ...]
    covariance: FloatArray
    log_evidence: float
    voltage_V: FloatArray
    soc: FloatArray
    coordinates: Coordinates

    def std(self, name: str) -> float:
        """Standard deviation of one coordinate."""
        k = self.names.index(name)
        return float(math.sqrt(max(self.covariance[k, k], 0.0)))


@dataclass(frozen=True, eq=False)
class Frozen:
    """Derivatives of all rows that fits may take as they were at another point nearby."""

    names: tuple[str, ...]
    jacobian: FloatArray

    def jacobian_near(self, found: Fit, evidence: ScoredRows, moving: Sequence[str]) -> FloatArray:
        """Derivatives at a fit nearby, fresh by the coordinates in ``moving`` and by new ones."""
        fresh = [n for n in found.names if n in moving or n not in self.names]
        columns = np.empty((evidence.rows, len(found.names)))
        columns[:, [found.names.index(n) for n in fresh]] = evidence.jacobian(
            found.coordinates, found.z, fresh
        )
        kept = [n for n in found.names if n not in fresh]
        columns[:, [found.names.index(n) for n in kept]] = self.columns(kept, evidence.rows)
        return columns

    def columns(self, names: Sequence[str], rows: int) -> FloatArray:
        """Those by some of the coordinates, of the first rows."""
        if not names:
            return np.empty((rows, 0))
        return np.take(self.jacobian[:rows], [self.names.index(n) for n in names], axis=1)


NOTHING_KNOWN = Frozen((), np.empty((0, 0)))


def fit(
    objective: Objective,
    coordinates: Coordinates,
    tolerances: Tolerances,
    start: Values,
    iterations: int = SEARCH.iterations,
    frozen: Frozen = NOTHING_KNOWN,
    moving: Sequence[str] = (),
) -> Fit:
    """Most likely point under the tolerances.

    Only the logs that have rows to fit are simulated; :func:`complete` adds the others. With
    ``frozen`` only the derivatives by ``moving`` and by the starts are computed at every point.
    """
    train, names, prior = objective.fitted, tolerances.names, tolerances.prior()
    evidence = train.evidence
    kept = [k for k, n in enumerate(names) if n in frozen.names and n not in moving]
    fresh = [k for k in range(len(names)) if k not in kept]
    rows = (evidence.role == FITTED) & evidence.known
    white = np.empty((evidence.rows, 1 + len(names)))
    still = frozen.columns([names[k] for k in kept], evidence.rows)
    white[:, [1 + k for k in kept]] = train.scaled(still)

    def point(at: FloatArray) -> dict[str, float]:
        return dict(zip(names, map(float, at), strict=True))

    def cost_of(at: FloatArray) -> tuple[float, Simulated]:
        seen = evidence.simulate(coordinates, point(at))
        return -float(np.sum(train.terms(evidence.voltage_V - seen[0])[rows])), seen

    def normal(at: FloatArray, seen: Simulated) -> tuple[FloatArray, FloatArray]:
        jacobian = evidence.jacobian(coordinates, point(at), [names[k] for k in fresh])
        columns = np.column_stack((np.nan_to_num(evidence.voltage_V - seen[0]), jacobian))
        white[:, [0, *(1 + k for k in fresh)]] = train.scaled(columns)
        return normal_of(white, rows, train.clip)

    x = prior.inside(np.array([start.get(n, prior.mean[k]) for k, n in enumerate(names)]))
    found = minimise(prior, cost_of, normal, x, SEARCH._replace(iterations=iterations))
    missing = np.full(objective.evidence.rows - evidence.rows, np.nan)
    voltage, soc = (np.concatenate((values, missing)) for values in found.seen)
    matrix = found.normal.matrix
    covariance, ln_evidence = prior.covariance(matrix), prior.ln_kept(matrix) - found.cost
    z = point(found.theta)
    return Fit(z, tuple(names), covariance, ln_evidence, voltage, soc, coordinates)


def complete(objective: Objective, found: Fit, tolerances: Tolerances) -> Fit:
    """The fit with the held-out logs simulated, each from where its first part says it starts."""
    evidence = objective.evidence
    z, inputs = dict(found.z), found.coordinates.inputs(found.z)
    voltage, soc = found.voltage_V.copy(), found.soc.copy()
    for k, (log, rows) in enumerate(evidence.each()):
        if first := int(np.sum(log.role == START)):
            part = slice(rows.start, rows.start + first)
            z[f"soc0:{k}"] = _start(objective, tolerances, k, part, inputs, z)
            voltage[rows], soc[rows] = evidence.of_log(k, inputs, z)
    return replace(found, z=z, voltage_V=voltage, soc=soc)


def _start(
    objective: Objective,
    tolerances: Tolerances,
    k: int,
    part: slice,
    inputs: KernelInputs,
    z: Values,
) -> float:
    """What a part of a log's rows, its first ones, says of its start; all else as it is."""
    evidence, name, step = objective.evidence, f"soc0:{k}", step_of("soc0")
    mean = tolerances.mean.get(name, 0.0)
    mean += sum(by * z.get(n, 0.0) for n, by in tolerances.read.get(name, {}).items())
    bounds = tolerances.low, tolerances.high
    prior = Tolerances({name: tolerances.std[name]}, {name: mean}, *bounds).prior()
    rows = np.zeros(evidence.rows, dtype=np.bool_)
    rows[part] = True

    def simulated(soc0: float) -> FloatArray:
        voltage = np.zeros(evidence.rows)
        voltage[part], _ = evidence.of_log(k, inputs, {**z, name: soc0}, part.stop - part.start)
        return voltage

    def cost_of(at: FloatArray) -> tuple[float, FloatArray]:
        here = simulated(float(at[0]))
        return -float(np.sum(objective.terms(evidence.voltage_V - here)[part])), here

    def normal(at: FloatArray, here: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = (simulated(float(at[0]) + step) - here) / step
        return objective.normal(here, slope[:, None], rows)

    first = prior.inside(np.array([z[name]]))
    return float(minimise(prior, cost_of, normal, first, SEARCH).theta[0])
