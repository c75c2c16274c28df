"""Start, state and info of the Kalman filters, as the kernels carry them."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from cellwise.estimate.sensing_kernels import Watch, first_watch


class EkfStart(NamedTuple):
    """Where a state begins, and begins anew when it is no longer finite."""

    soc: float
    variance: float
    hysteresis_variance: float
    temperature_C: float  # where nobody measured


class EkfState(NamedTuple):
    """What must be carried: x, the upper triangle of P, how the model has done, the sensors' past.

    ``rejections`` counts voltages rejected in a row, those under load less; ``mismatch`` is the
    running mean of the squared innovations over the variance that the model alone explains;
    ``lasting`` what an error of the model that stays may have brought into the SOC, one standard
    deviation.
    """

    soc: float
    v1_V: float
    v2_V: float
    v3_V: float
    h: float
    ss: float
    s1: float
    s2: float
    s3: float
    sh: float
    p11: float
    p12: float
    p13: float
    p1h: float
    p22: float
    p23: float
    p2h: float
    p33: float
    p3h: float
    phh: float
    heat_K: float
    rejections: float
    mismatch: float
    lasting: float
    watch: Watch

    @property
    def current_A(self) -> float:
        """The last valid current [A]."""
        return self.watch.current_A

    @property
    def soc_std(self) -> float:
        """Standard deviation of the state of charge."""
        return math.sqrt(self.ss + self.lasting * self.lasting)


class EkfInfo(NamedTuple):
    """What may be looked at after a step.

    ``voltage_V`` is predicted before the sample's own voltage is used; ``test_ratio`` above 1
    means that the gate rejected it; ``status`` are the bits of
    :class:`cellwise.estimate.status.Status`.
    """

    soc: float
    soc_std: float
    voltage_V: float
    innovation_V: float
    innovation_variance_V2: float
    test_ratio: float
    status: int


@njit(cache=True, error_model="numpy")
def ekf_start(start: EkfStart, current_A: float) -> EkfState:
    """A cell known as ``start`` says; its branches are guessed at the first sample."""
    h = 1.0 if start.soc > 0.5 else -1.0
    # fmt: off
    return EkfState(
        start.soc, 0.0, 0.0, 0.0, h,
        start.variance, 0.0, 0.0, 0.0, 0.0,
        0.0, 0.0, 0.0, 0.0,
        0.0, 0.0, 0.0,
        0.0, 0.0,
        start.hysteresis_variance,
        0.0, 0.0, 1.0, 0.0, first_watch(current_A),
    )
    # fmt: on
