"""What is carried from one call to the next: what is known of the cells, in a file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from cellwise.errors import InputError
from cellwise.files import write_atomically
from cellwise.pack.deltas import CellDeltas
from cellwise.pack.differences import SIZE

KIND = "cellwise-pack-state"
VERSION = 1


@dataclass(frozen=True, eq=False)
class PackState:
    """Names of the cells, day of the first log, differences, first log of every period."""

    names: tuple[str, ...]
    origin: float
    deltas: CellDeltas
    periods: tuple[str, ...]

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
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any], where: str) -> Self:
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
            finite = np.isfinite(mean).all() and np.isfinite(covariance).all()
            if not finite:
                raise ValueError("values that are not finite")
            return cls(names, float(data["origin"]), deltas, tuple(data["periods"]))
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
    where = f"'{path}'"
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"no file {where}", "a pack's state", "Check the path.") from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"{where}, which cannot be read as JSON ({error})", "a pack's state", "Start without."
        ) from None
    if not isinstance(data, dict):
        raise InputError(f"no object in {where}", "a pack's state", "Start without it.")
    return PackState.from_dict(data, where)
