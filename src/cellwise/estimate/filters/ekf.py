"""Extended Kalman filter for SOC: one step for online use, one compiled loop for whole logs."""

from __future__ import annotations

from cellwise.estimate.filters.kalman import KalmanFilter
from cellwise.estimate.filters.kalman import measured_temperature_C as measured_temperature_C


class Ekf(KalmanFilter):
    """EKF over SOC, branch voltages and hysteresis.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None     None: from the model's own validation error

    Examples
    --------
    >>> ekf = Ekf(model)                                            # doctest: +SKIP
    >>> state = ekf.init(soc0=0.5, soc0_std=0.2)                    # doctest: +SKIP
    >>> state, info = ekf.step(state, 1.2, 3.71, 25.0, dt_s=0.1)    # doctest: +SKIP
    """

    name = "ekf"
