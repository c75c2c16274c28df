r"""Segment identification: three points of a pulse and closed formulas (NCR18650B paper).

.. math::

    R_0 = |V(t_0) - V(t_1)| / I \quad (6) \qquad R_1 = |V(t_1) - V(t_2)| / I \quad (7)

    \tau_1 = (t_2 - t_1) / 5 \quad (8) \qquad C_1 = \tau_1 / R_1 \quad (9)

R2, tau2 and C2 follow from (7) to (9) on the longer segment from t1 to t3. Quick, and a
start value for anything else; but the time constants are a choice of points, not an estimate, the
OCV that moves during the pulse counts as resistance, and R2 holds what R1 holds already.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.pulse_fit.circuit import Circuit, PulseFit, PulseParameters
from cellwise.identify.pulse_fit.pulse_data import PulseData


class _Segments(NamedTuple):
    """Equation (8), and the choice of the points.

    ``fast_part``: t2 - t1 over t3 - t1, where the fast segment ends. The paper reads it off by eye;
    a tenth puts a decade between tau1 and tau2.
    """

    taus: float = 5.0
    fast_part: float = 0.1


SEGMENTS = _Segments()


def fit_segments(data: PulseData) -> PulseFit:
    """Parameters of one pulse from four of its rows, equations (6) to (9).

    t0 is the last row before the pulse, t1 the first row in it (after `settling_rows`, if the
    tester has any), t3 its last row, t2 the row nearest to ``fast_part`` of the way from t1 to t3.

    Standard errors of the resistances follow from the row-to-row noise of the voltage; the time
    constants have none (NaN).

    Raises
    ------
    InputError        no row before the pulse, or no three settled rows in it
    """
    row0, row3 = data.start - 1, data.stop - 1
    settled = np.flatnonzero(~data.settling_rows[data.start : data.stop])
    row1 = data.start + int(settled[0]) if settled.size else row3
    if row0 < 0 or row3 - row1 < 2:
        raise InputError(
            f"{data.start} rows before pulse '{data.name}', {row3 - row1 + 1} settled rows in it",
            "at least 1 row before and 3 in it",
            "Cut the pulse with some rest before it, or leave it out.",
        )
    time, voltage, current = data.time_s, data.voltage_V, abs(data.pulse_current_A)
    wanted = time[row1] + SEGMENTS.fast_part * (time[row3] - time[row1])
    row2 = int(np.argmin(np.abs(time[row1 + 1 : row3] - wanted))) + row1 + 1
    value = PulseParameters(
        r0_ohm=float(abs(voltage[row0] - voltage[row1]) / current),  # (6)
        r1_ohm=float(abs(voltage[row1] - voltage[row2]) / current),  # (7)
        tau1_s=float(time[row2] - time[row1]) / SEGMENTS.taus,  # (8)
        r2_ohm=float(abs(voltage[row1] - voltage[row3]) / current),  # (7), the longer segment
        tau2_s=float(time[row3] - time[row1]) / SEGMENTS.taus,
        ocv_V=float(voltage[row0]),
    )
    circuit, nan = Circuit(data), float("nan")
    error = float(np.sqrt(2.0)) * data.noise_V / current
    return PulseFit(
        method="segments",
        soc=data.mean_soc,
        current_A=data.pulse_current_A,
        duration_s=data.pulse_duration_s,
        value=value,
        error=PulseParameters(error, error, nan, error, nan, data.noise_V),
        rmse_V=circuit.rmse_V(value._replace(ocv_V=float(circuit.known[row0]))),
        rows=time.size - data.first,
    )
