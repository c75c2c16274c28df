"""How a cell may differ from its prior: corrections of the tables, and how large they usually are.

Everything is a linear map of independent standard normal variables, so that the distance of a cell
from its prior is the length of one vector.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import Effect, SlowDiffusion, TemperatureDependence, TimeSkew
from cellwise.cell.model import CellModel
from cellwise.cell.stock import scaled_model
from cellwise.identify.assemble import monotone
from cellwise.identify.identification import REFERENCE_C
from cellwise.identify.refinement.refine_data import inverse_K
from cellwise.identify.refinement.splines import (
    greville,
    spline_count,
    spline_rows,
    spline_values,
)
from cellwise.typing import FloatArray

OCV_KNOTS = np.linspace(0.0, 1.0, 21)
TABLE_KNOTS = np.linspace(0.0, 1.0, 6)


class UsualDifference(NamedTuple):
    """How two cells of a kind differ, beside what the prior's own error says.

    Parameters
    ----------
    ocv_length : float      differences of the OCV, over their usual size at each SOC, are alike by
                            exp(-distance / length): of three measured cells with layered oxides
                            and a physics model 0.97 at 0.05 SOC, 0.91 at 0.1, 0.87 at 0.2, 0.68 at
                            0.4
    table_length : float    of resistances, squared exponential [SOC]
    least_ocv_V, least_ln_r : float     two samples of one kind
    largest_ln : float      a factor of twenty: beyond it is not such a cell
    activation_K : float    standard deviation of an activation energy
    ln_capacity : float     what the fit does not know of the capacity: where a load's end lies on
                            the SOC of another cell. Four measured cells updated from a stock model
                            of another kind were 4, 4, 8 and 14 % off, from one of themselves 1 to 4
    """

    ocv_length: float = 1.0
    table_length: float = 0.3
    least_ocv_V: float = 0.003
    least_ln_r: float = 0.1
    largest_ln: float = 3.0
    activation_K: float = 1000.0
    ln_capacity: float = 0.05


USUAL = UsualDifference()
NUMERICAL = 1e-6


class Corrections:
    """Corrections of a prior: OCV, R0, fast and slow branch, activation, capacity.

    Parameters
    ----------
    prior : CellModel         its ``error`` says how far another cell may be from it
    capacity_Ah : float       most probable capacity of the cell; the prior is scaled to it
    capacity_std : float      its standard deviation, of the logarithm
    window_V : (2,) float     an OCV never leaves this

    ``ocv_map`` [V] and ``ln_r_maps`` (R0, R1, slow branches), of shape (points, size), are what the
    variables move over the prior's grid.
    """

    def __init__(
        self, prior: CellModel, capacity_Ah: float, capacity_std: float, window_V: FloatArray
    ) -> None:
        kept = tuple(e for e in prior.effects if not isinstance(e, TimeSkew))
        self.prior = scaled_model(replace(prior, effects=kept), capacity_Ah)
        self.capacity_std = capacity_std
        self.window_V = window_V
        apart = _distances(OCV_KNOTS)
        size = np.maximum(self.prior.error.at(greville(OCV_KNOTS)), USUAL.least_ocv_V)
        alike = _root(np.exp(-apart / USUAL.ocv_length))
        self.ocv_map = self._map(0, OCV_KNOTS, size[:, None] * alike)
        share = max(self.prior.error.shown_share(), USUAL.least_ln_r)
        table = share * _root(np.exp(-0.5 * (_distances(TABLE_KNOTS) / USUAL.table_length) ** 2))
        first, width = spline_count(OCV_KNOTS), spline_count(TABLE_KNOTS)
        self.ln_r_maps = [self._map(first + k * width, TABLE_KNOTS, table) for k in range(3)]
        self.inverse_K = inverse_K(self.prior.temperature_C, REFERENCE_C)

    @property
    def size(self) -> int:
        """Number of variables."""
        return spline_count(OCV_KNOTS) + 3 * spline_count(TABLE_KNOTS) + 2

    def _map(self, first: int, knots: FloatArray, root: FloatArray) -> FloatArray:
        """From the variables to a correction over the prior's grid, shape (points, size)."""
        found = np.zeros((self.prior.soc.size, self.size))
        rows = spline_rows(self.prior.soc, knots)
        found[:, first : first + root.shape[1]] = spline_values(rows, root)
        return found

    def capacity_Ah(self, z: FloatArray) -> float:
        """The corrected capacity."""
        return self.prior.capacity_Ah * float(np.exp(self.capacity_std * z[-1]))

    def model(self, z: FloatArray) -> CellModel:
        """The corrected model, shape of ``z`` (size,)."""
        prior = self.prior
        r0, r1, slow = (
            np.exp(np.clip(each @ z, -USUAL.largest_ln, USUAL.largest_ln))
            for each in self.ln_r_maps
        )
        activation = USUAL.activation_K * float(z[-2])
        warm = np.exp(activation * self.inverse_K)[:, None] if self.inverse_K.size > 1 else 1.0
        ocv = np.clip(prior.ocv_V + self.ocv_map @ z, *self.window_V)
        return replace(
            prior,
            capacity_Ah=self.capacity_Ah(z),
            ocv_V=np.array([monotone(row) for row in ocv]),
            r0_ohm=warm * r0 * prior.r0_ohm,
            r1_ohm=warm * r1 * prior.r1_ohm,
            r2_ohm=warm * slow * prior.r2_ohm,
            effects=tuple(self._effect(e, warm * slow, activation) for e in prior.effects),
        )

    def _effect(self, effect: Effect, factor: FloatArray, activation_K: float) -> Effect:
        if isinstance(effect, SlowDiffusion):
            r3 = np.clip(factor * np.asarray(effect.r3_ohm), *SlowDiffusion.bounds["r3_ohm"])
            return SlowDiffusion(r3, effect.tau3_s)
        if isinstance(effect, TemperatureDependence) and self.inverse_K.size == 1:
            bounds = TemperatureDependence.bounds["activation_K"]
            total = float(np.clip(effect.activation_K + activation_K, *bounds))
            return replace(effect, activation_K=total)
        return effect


def _distances(knots: FloatArray) -> FloatArray:
    """Between the SOC of any two coefficients."""
    at = greville(knots)
    return np.abs(np.subtract.outer(at, at))


def _root(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.cholesky(covariance + NUMERICAL * np.eye(covariance.shape[0])))
