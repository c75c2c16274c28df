"""Unscented Kalman filter for SOC, with the interface of the EKF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import KalmanFilter
from cellwise.estimate.filters.sigma_kernels import SigmaScalars
from cellwise.estimate.noise import Noise

STATES = 5


@dataclass(frozen=True)
class SigmaPoints:
    """Scaled sigma points of a state of five: spread alpha, prior beta, secondary kappa.

    The defaults put the outer points at sqrt(3) standard deviations with the weights of a
    three-point Gauss-Hermite rule, whatever the number of states. While the SOC's standard
    deviation is below ``resistances_from`` every point has the resistances of the mean, as in the
    EKF: a resistance that is off must not vouch for the SOC. 0: each has those of its own SOC.

    Source: E. Wan, R. van der Merwe, The unscented Kalman filter for nonlinear estimation, 2000,
    10.1109/ASSPCC.2000.882463.
    """

    alpha: float = 1.0
    beta: float = 0.0
    kappa: float = 3.0 - STATES
    resistances_from: float = 0.02

    def __post_init__(self) -> None:
        if not (
            np.all(np.isfinite([*vars(self).values()]))
            and self.alpha > 0.0
            and self.kappa > -STATES
            and self.resistances_from >= 0.0
        ):
            raise InputError(
                f"sigma points with {vars(self)}",
                f"alpha above 0, kappa above -{STATES}, resistances_from at least 0, all finite",
                "Leave them out, or give e.g. alpha = 1, beta = 0, kappa = -2.",
            )

    def scalars(self) -> SigmaScalars:
        """What the kernels take."""
        square = self.alpha**2 * (STATES + self.kappa)
        side = 0.5 / square
        centre = (square - STATES) / square + 1.0 - self.alpha**2 + self.beta
        centre += 2.0 * (STATES - 1) * side  # every point of that SOC
        curve = 2.0 * side * (0.5 - side) ** 2 + centre * side * side
        wide = float(self.resistances_from) ** 2
        return SigmaScalars(float(np.sqrt(square)), float(side), float(curve), wide)


class Ukf(KalmanFilter):
    """UKF over SOC, branch voltages and hysteresis.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None     None: from the model's own validation error
    points : SigmaPoints      how far out the sigma points lie and how they weigh
    """

    name = "ukf"

    def __init__(
        self, model: CellModel, noise: Noise | None = None, points: SigmaPoints | None = None
    ) -> None:
        super().__init__(model, noise)
        self.points = SigmaPoints() if points is None else points
        self.sigma = self.points.scalars()
