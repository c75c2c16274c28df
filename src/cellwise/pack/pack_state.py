"""Differences of cells from the mean cell (bar-delta filtering), from log to log, in a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from cellwise.errors import InputError
from cellwise.estimate.saved_state import read_saved
from cellwise.files import write_atomically
from cellwise.pack.differences import CELLS, MONTH, SELF_DISCHARGE, SIZE
from cellwise.pack.evidence import LEAST_SHARE, PASSES, WEIGHT, PackEvidence, robust_std
from cellwise.typing import FloatArray

KIND = "cellwise-pack-state"
VERSION = 1


@dataclass(frozen=True, eq=False)
class CellDeltas:
    """Differences of every cell from the mean cell.

    ``mean`` (cells, SIZE), ``covariance`` (cells, SIZE, SIZE), ``days`` from the first log to the
    last, ``spread`` (SIZE,) standard deviation between cells, ``updates`` how many periods.
    """

    mean: FloatArray
    covariance: FloatArray
    spread: FloatArray
    days: float = 0.0
    updates: int = 0

    @classmethod
    def unknown(cls, cells: int, spread: FloatArray | None = None) -> CellDeltas:
        """Cells of which only their usual spread is known."""
        usual = CELLS if spread is None else spread
        wide = np.broadcast_to(np.diag(usual**2), (cells, SIZE, SIZE))
        return cls(np.zeros((cells, SIZE)), np.array(wide), usual)

    def later(self, days: float) -> CellDeltas:
        """The same ``days`` after the first log: cells drift apart."""
        passed = max(days - self.days, 0.0)
        drift = np.diag(MONTH**2) * passed / 30.0
        mean, covariance = self.mean.copy(), self.covariance + drift
        # What a cell lost during one period balancing may return in the next.
        mean[:, SELF_DISCHARGE] = 0.0
        covariance[:, SELF_DISCHARGE, :] = covariance[:, :, SELF_DISCHARGE] = 0.0
        covariance[:, SELF_DISCHARGE, SELF_DISCHARGE] = self.spread[SELF_DISCHARGE] ** 2
        return replace(self, mean=mean, covariance=covariance, days=max(days, self.days))

    def updated(self, evidence: PackEvidence) -> CellDeltas:
        """The same after a log."""
        mean, covariance = posterior(self.mean, self.covariance, evidence)
        return replace(self, mean=mean, covariance=covariance, updates=self.updates + 1)


def posterior(
    mean: FloatArray, covariance: FloatArray, evidence: PackEvidence
) -> tuple[FloatArray, FloatArray]:
    """Means and covariances after an evidence, in the form that bears no information at all."""
    a, b = evidence.matrix, evidence.vector
    eye = np.eye(SIZE)
    half = 0.5 * np.linalg.solve(eye + covariance @ a, covariance)
    after: FloatArray = np.asarray(half + np.swapaxes(half, 1, 2), dtype=np.float64)
    surprise = b - np.einsum("cij,cj->ci", a, mean)
    return np.asarray(mean + np.einsum("cij,cj->ci", after, surprise)), after


def spread_between(evidence: PackEvidence) -> FloatArray:
    """Standard deviation between the cells of each difference, shape (SIZE,).

    Few cells leave the usual spread as it is.
    """
    usual = CELLS
    same = CellDeltas.unknown(evidence.rows.size, np.zeros(SIZE))
    return np.sqrt(_moved(same, evidence, usual**2, (LEAST_SHARE * usual) ** 2))


def drift_between(past: CellDeltas, evidence: PackEvidence) -> FloatArray:
    """Variance of the cells' changes since then, beyond what was expected, (SIZE,).

    In a pack that was balanced meanwhile all cells' SOC have moved, and no one of them is odd for
    it.
    """
    return _moved(past, evidence, MONTH**2, np.zeros(SIZE))


def _moved(
    past: CellDeltas, evidence: PackEvidence, usual: FloatArray, least: FloatArray
) -> FloatArray:
    """Variance over the cells of what moved them from where they were, (SIZE,).

    Expectation-maximisation with robust moments, so that one odd cell does not widen what is
    normal, about the ``usual`` variance.
    """
    there = evidence.rows > 0
    cells = float(np.count_nonzero(there))
    found = usual.copy()
    for _ in range(PASSES):
        own = np.diag(found)
        before = past.covariance + own
        mean, after = posterior(past.mean, before, evidence)
        share = np.swapaxes(np.linalg.solve(before, np.broadcast_to(own, before.shape)), 1, 2)
        change = np.einsum("cij,cj->ci", share, mean - past.mean)[there]
        left = own - share @ own + share @ after @ np.swapaxes(share, 1, 2)
        unseen = np.median(np.diagonal(left[there], axis1=1, axis2=2), axis=0)
        variance = robust_std(change - np.median(change, axis=0)) ** 2 + unseen
        found = (cells * variance + WEIGHT * usual) / (cells + WEIGHT)
        found = np.maximum(found, least)
    return found


class Drift(NamedTuple):
    """By what every cell's SOC falls against the others' in one period [1/day], (cells,) each.

    ``std`` holds both what is not known of a cell and by what the cells of the period scatter:
    balancing moves them.
    """

    per_day: FloatArray
    std: FloatArray


@dataclass(frozen=True, eq=False)
class PackState:
    """Names of the cells, day of the first log, differences, first log of every period, drifts."""

    names: tuple[str, ...]
    origin: float
    deltas: CellDeltas
    periods: tuple[str, ...]
    drifts: tuple[Drift, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        deltas = self.deltas
        upper = np.triu_indices(SIZE)
        return {
            "kind": KIND,
            "version": VERSION,
            "names": list(self.names),
            "origin": self.origin,
            "days": deltas.days,
            "updates": deltas.updates,
            "spread": deltas.spread.tolist(),
            "mean": deltas.mean.tolist(),
            "covariance": deltas.covariance[:, upper[0], upper[1]].tolist(),
            "periods": list(self.periods),
            "drifts": [[part.tolist() for part in drift] for drift in self.drifts],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], where: str) -> Self:
        """From JSON values.

        Raises
        ------
        InputError        no state of a pack, of another version, or damaged
        """
        if data.get("kind") != KIND or data.get("version") != VERSION:
            raise InputError(
                f"'{data.get('kind')}' of version {data.get('version')} in {where}",
                f"'{KIND}' of version {VERSION}",
                "Give the state that an earlier run wrote, or start without it.",
            )
        try:
            names = tuple(str(name) for name in data["names"])
            mean = np.array(data["mean"], dtype=np.float64).reshape(len(names), SIZE)
            covariance = np.zeros((len(names), SIZE, SIZE))
            i, j = np.triu_indices(SIZE)
            half = np.array(data["covariance"], dtype=np.float64).reshape(len(names), i.size)
            covariance[:, i, j] = covariance[:, j, i] = half
            spread = np.array(data["spread"], dtype=np.float64).reshape(SIZE)
            deltas = CellDeltas(mean, covariance, spread, float(data["days"]), int(data["updates"]))
            # States before this had no drifts.
            seen = np.array(data.get("drifts", []), dtype=np.float64).reshape(-1, 2, len(names))
            if not all(np.isfinite(part).all() for part in (mean, covariance, seen)):
                raise ValueError("values that are not finite")
            drifts = tuple(Drift(*one) for one in seen)
            return cls(names, float(data["origin"]), deltas, tuple(data["periods"]), drifts)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"a damaged state in {where} ({error})",
                "a state as it was written",
                "Start without it.",
            ) from None


def write_state(state: PackState, path: str | Path) -> Path:
    """Write a state, whole or not at all."""
    return write_atomically(path, json.dumps(state.to_dict()))


def read_state(path: str | Path) -> PackState:
    """Read a state.

    Raises
    ------
    InputError        no such file, or none that :func:`write_state` wrote
    """
    return PackState.from_dict(read_saved(path), f"'{path}'")
