"""Which causes are worth a fit at all: what each could explain to second order (a score test)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, forms_of
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit, Frozen, Prior, normal_of
from cellwise.diagnose.fit.noise import Noise
from cellwise.diagnose.fit.priors import starts_to_try, widened_for
from cellwise.diagnose.fit.rows import IGNORED
from cellwise.typing import FloatArray

Key = tuple[int, str]
# Of several points to start from so many are followed by a step.
BEST_BEGINNINGS = 2


def could_explain(
    fits: CauseFits, causes: Sequence[Cause], base: Fit, prior: Prior, frozen: Frozen
) -> dict[str, float]:
    """Nats that every cause would gain at most by one Gauss-Newton step from a fit.

    Rao's score test: gradient and information at the null hypothesis, where nothing of the cause
    is fitted yet; what it takes off the squares counts by the scale that both leave. Causes with a
    memory are tried at each of those from which their search starts, and a cause whose effect is
    far from straight (``beginnings``) at each of these.
    """
    evidence, objective = fits.evidence, fits.objective(Noise())
    tried = [
        (form, shaped, widened_for(prior, form, shaped, evidence))
        for cause in causes
        for form in forms_of(cause, base.coordinates)
        for shaped in _shapes(fits, form, base)
    ]
    columns, place = _columns(fits, tried, base.z, frozen)
    residual = np.nan_to_num(evidence.voltage_V - base.voltage_V)
    white = objective.scaled(np.column_stack((residual, columns)))
    used = evidence.known & (evidence.role != IGNORED)
    normal, gradient = normal_of(white, used, objective.clip)
    names = list(frozen.names)
    none = _gain(normal, gradient, [place[0, n] for n in names], prior, names, base.z)
    left, errors = fits.squares(base)
    found: dict[str, float] = {}
    for k, (cause, _, wide) in enumerate(tried, 1):
        known = [place.get((k, n), place.get((0, n), -1)) for n in wide.names]
        more = _gain(normal, gradient, known, wide, wide.names, base.z)
        nats = fits.known.gained(left, 2.0 * max(more - none, 0.0), errors)
        found[cause.name] = max(found.get(cause.name, 0.0), nats)
    for cause in causes:
        if cause.beginnings:
            most = _from_beginnings(fits, cause, base, prior, frozen)
            nats = fits.known.gained(left, max(most - 2.0 * none, 0.0), errors)
            found[cause.name] = max(found[cause.name], nats)
    return found


def _from_beginnings(
    fits: CauseFits, cause: Cause, base: Fit, prior: Prior, frozen: Frozen
) -> float:
    """What one step from the best beginning of a cause takes off the squares of a fit."""
    evidence, objective = fits.evidence, fits.objective(Noise())
    used = evidence.known & (evidence.role != IGNORED)
    wide = widened_for(prior, cause, base.coordinates, evidence)
    names = list(frozen.names)
    place = [names.index(n) for n in wide.names]
    tried: list[tuple[float, dict[str, float], FloatArray]] = []
    for beginning in cause.beginnings:
        z = {**base.z, **beginning}
        voltage, _ = evidence.simulate(base.coordinates, z)
        residual = np.nan_to_num(evidence.voltage_V - voltage)
        tried.append((float(np.sum(objective.squares(residual)[used])), z, residual))
    before = fits.squares(base)[0]
    most = 0.0
    for squares, z, residual in sorted(tried, key=lambda t: t[0])[:BEST_BEGINNINGS]:
        moved = [n for n in cause.beginnings[0] if n in names]
        jacobian = frozen.jacobian.copy()
        jacobian[:, [names.index(n) for n in moved]] = evidence.jacobian(base.coordinates, z, moved)
        white = objective.scaled(np.column_stack((residual, jacobian)))
        normal, gradient = normal_of(white, used, objective.clip)
        step = _gain(normal, gradient, place, wide, wide.names, z)
        most = max(most, before - squares + 2.0 * step)
    return most


def _shapes(fits: CauseFits, cause: Cause, base: Fit) -> list[Coordinates]:
    """Coordinates at every memory from which the search for a cause starts, each once."""
    shapes = [s for s, _ in starts_to_try(cause, base.coordinates, fits.evidence)]
    return list({id(s): s for s in shapes}.values())


def _columns(
    fits: CauseFits,
    tried: Sequence[tuple[Cause, Coordinates, Prior]],
    z: Mapping[str, float],
    frozen: Frozen,
) -> tuple[FloatArray, dict[Key, int]]:
    """Derivatives of the stage, those of every cause beside them, and where each stands."""
    parts = [frozen.jacobian]
    place = {(0, n): k for k, n in enumerate(frozen.names)}
    many = len(frozen.names)
    together: dict[int, list[tuple[int, str]]] = {}  # one pass for all causes of one shape
    shapes = {id(shaped): shaped for _, shaped, _ in tried}
    for k, (_, shaped, wide) in enumerate(tried, 1):
        new = [(k, n) for n in wide.names if n not in frozen.names]
        together.setdefault(id(shaped), []).extend(new)
    for shape, keys in together.items():
        if keys:
            parts.append(fits.evidence.jacobian(shapes[shape], z, [n for _, n in keys]))
            place |= {key: many + j for j, key in enumerate(keys)}
            many += len(keys)
    return np.column_stack(parts), place


def _gain(
    normal: FloatArray,
    gradient: FloatArray,
    place: Sequence[int],
    prior: Prior,
    names: Sequence[str],
    z: Mapping[str, float],
) -> float:
    """Nats that the best step of some coordinates gains, under their prior."""
    weight = prior.precision()
    away = np.array([z.get(n, 0.0) - prior.mean.get(n, 0.0) for n in names])
    pull = gradient[list(place)] - weight @ away
    # What the prior costs at the start is not gained by a cause that widens it.
    start = 0.5 * float(away @ weight @ away)
    return 0.5 * float(pull @ np.linalg.solve(normal[np.ix_(place, place)] + weight, pull)) - start
