"""Posterior: what a fit left open of a model's tables and capacity, in a few directions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.typing import FloatArray

POINTS = 21  # over an even SOC grid
CAPACITY = "capacity_Ah"  # name of its direction


class CellDraw(NamedTuple):
    """By how much one cell differs from the model.

    ln of its capacity; OCV [V] and ln of every resistance, both over an even SOC grid, (21,).
    """

    ln_capacity: float
    ocv_V: FloatArray
    ln_r: FloatArray


@dataclass(frozen=True, eq=False)
class Posterior:
    """A normal distribution over directions in which the model may be another one.

    One deviation of the prior along direction k moves ln of the capacity by ``ln_capacity[k]``, the
    OCV by ``ocv_V[k]`` and ln of every resistance by ``ln_r[k]``; ``factor`` is the lower triangle
    of the covariance of the coordinates, in these units: 1 where the logs said nothing.

    Parameters
    ----------
    directions : (k,) str         ``capacity_Ah``, ``ocv_mode_1`` ..., ``resistance_mode_1`` ...
    factor : (k, k) float         lower triangle
    ln_capacity : (k,) float
    ocv_V, ln_r : (k, 21) float   over an even SOC grid
    prior : str                   which population or model, which lineage was left out
    """

    directions: tuple[str, ...]
    factor: FloatArray
    ln_capacity: FloatArray
    ocv_V: FloatArray
    ln_r: FloatArray
    prior: str = ""

    @property
    def std(self) -> FloatArray:
        """Deviation of each coordinate, in units of the prior's, shape (k,)."""
        return np.asarray(np.sqrt(np.sum(self.factor**2, axis=1)))

    @property
    def capacity_std(self) -> float:
        """Deviation of ln of the capacity."""
        return float(np.linalg.norm(self.ln_capacity @ self.factor))

    @property
    def ocv_std_V(self) -> FloatArray:
        """Deviation of the OCV over an even SOC grid, shape (21,) [V]."""
        return np.asarray(np.linalg.norm(self.ocv_V.T @ self.factor, axis=1))

    @property
    def ln_r_std(self) -> FloatArray:
        """Deviation of ln of the resistances over an even SOC grid, shape (21,)."""
        return np.asarray(np.linalg.norm(self.ln_r.T @ self.factor, axis=1))

    def draw(self, rng: np.random.Generator) -> CellDraw:
        """One of the cells that the logs may have been of."""
        moved = self.factor @ rng.standard_normal(len(self.directions))
        return CellDraw(float(moved @ self.ln_capacity), moved @ self.ocv_V, moved @ self.ln_r)

    def with_capacity_std(self, std: float) -> Posterior:
        """The same where others say what the capacity is, to so much of its ln; 0: exactly."""
        kept = np.flatnonzero(self.ln_capacity == 0.0)
        covariance = (self.factor @ self.factor.T)[np.ix_(kept, kept)]
        names = tuple(self.directions[k] for k in kept)
        root = np.linalg.cholesky(covariance + 1e-12 * np.eye(kept.size))
        factor = np.asarray(root, dtype=np.float64)
        rest = replace(
            self, directions=names, factor=factor, ln_capacity=np.zeros(kept.size),
            ocv_V=self.ocv_V[kept], ln_r=self.ln_r[kept],
        )  # fmt: skip
        if std == 0.0:
            return rest
        whole = np.eye(kept.size + 1)
        whole[1:, 1:] = factor
        none = np.zeros((1, self.ocv_V.shape[1]))
        return replace(
            rest, directions=(CAPACITY, *names), factor=whole,
            ln_capacity=np.concatenate(([std], np.zeros(kept.size))),
            ocv_V=np.concatenate((none, rest.ocv_V)), ln_r=np.concatenate((none, rest.ln_r)),
        )  # fmt: skip

    def as_wide_as_the_prior(self) -> Posterior:
        """The same directions where the logs said nothing of them."""
        return replace(self, factor=np.eye(len(self.directions)))

    @classmethod
    def of_dict(cls, data: Any) -> Posterior:
        """Back from JSON values.

        Raises
        ------
        InputError        shapes that do not fit together, numbers that are not finite
        """
        names = tuple(str(n) for n in data["directions"])
        n = len(names)
        factor = np.zeros((n, n))
        for k, row in enumerate(data["factor"]):
            factor[k, : len(row)] = row
        found = cls(
            names, factor, np.array(data["ln_capacity"], dtype=np.float64),
            np.array(data["ocv_V"], dtype=np.float64).reshape(n, -1),
            np.array(data["ln_r"], dtype=np.float64).reshape(n, -1), str(data.get("prior", "")),
        )  # fmt: skip
        every = np.concatenate(
            [np.ravel(x) for x in (factor, found.ln_capacity, found.ocv_V, found.ln_r)]
        )
        if (
            len(data["factor"]) != n
            or found.ln_capacity.shape != (n,)
            or not np.isfinite(every).all()
        ):
            raise InputError(
                f"a posterior of {n} directions whose tables do not fit",
                "a row of the factor, of ln_capacity, ocv_V and ln_r for each, all finite",
                "Write the model again.",
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "directions": list(self.directions),
            "std": _rounded(self.std),
            "factor": [_rounded(row[: k + 1]) for k, row in enumerate(self.factor)],
            "prior": self.prior,
            "ln_capacity": _rounded(self.ln_capacity),
            "soc": _rounded(np.linspace(0.0, 1.0, POINTS)),
            "ocv_V": [_rounded(row) for row in self.ocv_V],
            "ln_r": [_rounded(row) for row in self.ln_r],
        }


VOLTS = ("ocv_V", "m_V")  # their standard errors are volts, those of the other tables shares
NearBy = tuple[FloatArray, FloatArray]  # SOC, and a standard error there


def table_std(
    name: str,
    table: FloatArray,
    temperature_C: FloatArray,
    provenance: Mapping[str, Any],
    posterior: Posterior | None,
) -> FloatArray:
    """Standard error of a table of a model, in its own unit and shape; NaN where nobody knows it.

    As its fit says, at the nearest temperature that was tested; else its posterior (of the OCV and
    of all resistances together); else what cells of a stock model's kind differ by. To first order:
    of a resistance and of a time constant, the error of the logarithm times the value.
    """
    soc = np.linspace(0.0, 1.0, table.shape[1])
    rows = []
    for warm_C in temperature_C.tolist():
        known = (
            fitted_std(name, warm_C, provenance)
            or _posterior_std(name, posterior)
            or _spread_std(name, provenance)
        )
        rows.append(np.full(soc.size, np.nan) if known is None else np.interp(soc, *known))
    return np.array(rows) * (1.0 if name in VOLTS else table)


def fitted_std(name: str, temperature_C: float, provenance: Mapping[str, Any]) -> NearBy | None:
    """As a provenance's fit says; None: not of this table, or another model was handed out."""
    judged = provenance.get("plain_model") or {}
    errors = [x for x in provenance.get("refinement", ()) if name in x.get("standard_errors", {})]
    if judged.get("handed_out") != "fit" or not errors:
        return None
    nearest = min(errors, key=lambda x: abs(float(x["temperature_C"]) - temperature_C))
    found = nearest["standard_errors"][name]
    return np.array(found["soc"]), np.array(found["std"])


def _posterior_std(name: str, posterior: Posterior | None) -> NearBy | None:
    if posterior is None or not (name == "ocv_V" or name.endswith("_ohm")):
        return None
    std = posterior.ocv_std_V if name == "ocv_V" else posterior.ln_r_std
    return np.linspace(0.0, 1.0, std.size), std


def _spread_std(name: str, provenance: Mapping[str, Any]) -> NearBy | None:
    spread = (provenance.get("stock") or {}).get("spread", {})
    key = "ocv_V" if name == "ocv_V" else "ln_resistance" if name.endswith("_ohm") else ""
    return (np.zeros(1), np.full(1, spread[key])) if key in spread else None


def _rounded(values: FloatArray) -> list[float]:
    return [float(f"{v:.5g}") for v in values]
