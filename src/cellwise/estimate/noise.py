"""What a filter assumes about the errors of sensors and model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.arguments import check_kind, number
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.cell.plausibility.validity_kernels import (
    EVERYWHERE,
    ValidityScalars,
    validity_scalars,
)
from cellwise.errors import InputError
from cellwise.estimate.equations.constants import IMPOSSIBLE_RATE

# Beyond these a voltage is the sensor's fault.
IMPOSSIBLE_SHARE = 0.5
IMPOSSIBLE_RISE_V = 0.75
WANDERS = 1.0 / 3.0  # of the drift of the counted charge, what no constant offset explains
AFTER_S = 300.0  # when the memory is that of the sum of processes, beside its first and last


class NoiseScalars(NamedTuple):
    """Noise as the kernels see it."""

    current_A: float
    soc_per_sqrt_s: float
    capacity_soc: float  # variance of the counted charge per SOC that flows
    wander_per_sqrt_s: float  # what of it is no offset, where an offset is a hypothesis
    branch_share: float
    charge_share: float
    voltage_V: float
    error_scale: float
    slow_s: float
    early_s: float  # the memory begins at early_s / half_s of itself
    half_s: float
    ocv_soc: float
    mismatch_cap: float
    gate: float
    recovery_after: float
    gap_soc: float
    hold_s: float
    frozen_V: float
    persistent: float
    current_limit_A: float
    voltage_low_V: float
    voltage_high_V: float
    per_slow_s: float  # divided once, not in every step
    per_gate2: float
    offset_soc_per_s: float
    valid: ValidityScalars  # beyond it the model's error grows


AT_LEAST_ZERO = "a number of at least 0"


@dataclass(frozen=True)
class Noise:
    """Standard deviations and the innovation gate.

    Parameters
    ----------
    current_A : float         current sensor, per sample
    soc_per_sqrt_h : float    drift of the counted charge, in SOC per square root of an hour
    branch_share : float      error of the resistances on discharge, as a share
    charge_factor : float     what multiplies that share on charge
    voltage_V : float         voltage sensor, per sample
    error_scale : float       factor on the model's own table of its voltage error over SOC
    slow_s : float            how long that error is remembered: samples within that time are not
                              counted as independent evidence (slow_s = 0: every sample is)
    slow_first_s : float      how long it is remembered at first, while quick parts average out
    slow_half_s : float       when it is half way between the two
    ocv_soc : float           error of the OCV along the SOC axis
    mismatch_cap : float      a model of another temperature or age is wrong all the time: its error
                              variance grows with what the innovations have shown over slow_s, a
                              single one counting at most this often; 0 keeps the variance
    gate : float              innovations beyond this many standard deviations are rejected
    recovery_after : int      rejections in a row after which the variance is widened
    gap_soc : float           SOC that may have flowed unseen over a long gap
    hold_s : float            a current missing for longer is lost, not held any more
    frozen_V : float          a voltage that repeats itself is frozen when R0 times the change of
                              current exceeds this
    lasting_share : float     share of the slow error's variance that comes back at the same SOC for
                              good: it widens the SOC's stated deviation, never the gain
    offset_share : float      how far off the current may be for hours, as a share of 1C: EKF
                              and UKF weigh whether it is, and what voltages say against the
                              count is within the stated deviation; 0: the count is right
    capacity_share : float    by what share the model's capacity may be off: over a full discharge
                              the counted charge is off by as much
    current_limit_A, voltage_low_V, voltage_high_V : float
                              readings beyond are the sensor's fault and count as missing
    """

    current_A: float = 0.01
    soc_per_sqrt_h: float = 0.003
    branch_share: float = 0.05
    voltage_V: float = 0.002
    error_scale: float = 1.0
    slow_s: float = 300.0
    slow_first_s: float = 10.0
    slow_half_s: float = 150.0
    ocv_soc: float = 0.003
    mismatch_cap: float = 100.0
    gate: float = 5.0
    recovery_after: int = 20
    gap_soc: float = 0.05
    hold_s: float = 10.0
    frozen_V: float = 0.02
    lasting_share: float = 1.0
    offset_share: float = 0.03
    current_limit_A: float = 1e6
    voltage_low_V: float = -1e6
    voltage_high_V: float = 1e6
    charge_factor: float = 1.0
    capacity_share: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            size = number(f"noise {name}", value, AT_LEAST_ZERO)
            if not np.isfinite(size) or (size < 0 and name != "voltage_low_V"):
                raise InputError(f"noise {name} = {value}", AT_LEAST_ZERO, "Correct it.")
        if self.lasting_share > 1:
            raise InputError(
                f"noise lasting_share = {self.lasting_share}", "a share of at most 1", "Correct it."
            )
        if self.voltage_V <= 0 or self.gate <= 0:
            raise InputError(
                f"voltage_V = {self.voltage_V}, gate = {self.gate}",
                "both above zero",
                "A perfect voltage sensor does not exist; give its noise.",
            )

    @classmethod
    def of_model(cls, model: CellModel) -> Noise:
        """Noise taken from the model's own validation error and the cell's size."""
        check_is_model(model)
        low = np.inf if model.voltage_min_V is None else model.voltage_min_V
        high = -np.inf if model.voltage_max_V is None else model.voltage_max_V
        memory = memory_of(model.error)
        return cls(
            current_A=0.002 * model.capacity_Ah,
            voltage_V=max(model.error.white_V, 1e-4),
            slow_s=memory.last_s,
            slow_first_s=memory.first_s,
            slow_half_s=memory.half_s,
            lasting_share=model.error.lasting_share,
            branch_share=model.error.whole_share(),
            capacity_share=0.0 if model.posterior is None else model.posterior.capacity_std,
            charge_factor=model.error.whole_share(-1.0) / max(model.error.whole_share(), 1e-12),
            current_limit_A=impossible_current_A(model),
            voltage_low_V=IMPOSSIBLE_SHARE * min(low, float(model.ocv_V.min())),
            voltage_high_V=max(high, float(model.ocv_V.max())) + IMPOSSIBLE_RISE_V,
        )

    def scalars(self, model: CellModel | None = None) -> NoiseScalars:
        """What the kernels take; with a ``model``, widened beyond its validity."""
        half_s = max(self.slow_half_s, 1e-9)
        shared = {n: float(v) for n, v in vars(self).items() if n in NoiseScalars._fields}
        per_sqrt_s = float(self.soc_per_sqrt_h) / 60.0
        return NoiseScalars(
            **shared,
            soc_per_sqrt_s=per_sqrt_s,
            capacity_soc=float(self.capacity_share**2),
            wander_per_sqrt_s=per_sqrt_s * (WANDERS if self.offset_share > 0.0 else 1.0),
            charge_share=float(self.branch_share * self.charge_factor),
            early_s=float(half_s * min(self.slow_first_s / max(self.slow_s, 1e-9), 1.0)),
            half_s=float(half_s),
            persistent=float(np.sqrt(self.lasting_share)),
            per_slow_s=1.0 / self.slow_s if self.slow_s > 0.0 else 0.0,
            per_gate2=1.0 / (self.gate * self.gate),
            offset_soc_per_s=float(self.offset_share) / 3600.0,
            valid=EVERYWHERE if model is None else validity_scalars(model),
        )


def impossible_current_A(model: CellModel) -> float:
    """No cell gives it [A]: twice the OCV over the least resistance, at most 200 times a rate.

    A short circuit gives the OCV over the whole resistance.
    """
    least_ohm = float(np.min(model.r0_ohm))
    shorted_A = np.inf if least_ohm <= 0.0 else 2.0 * float(np.max(model.ocv_V)) / least_ohm
    return float(min(IMPOSSIBLE_RATE * model.capacity_Ah, shorted_A))


class ErrorMemory(NamedTuple):
    """For how long an error is remembered: at first, when half way, in the end [s]."""

    first_s: float
    half_s: float
    last_s: float


def memory_of(error: ModelError) -> ErrorMemory:
    r"""The memory of a sum of first-order processes: at first, half way, in the end.

    A mean over t of processes with memories tau_k and weights w_k in the variance keeps about
    v(t) = sum w_k 2 tau_k / (t + 2 tau_k) of it, as if all had the memory v^2 / (-2 dv/dt):
    1 / sum(w / tau) at first, sum(w tau) in the end.
    """
    tau = np.maximum(np.array(error.scales_s), 1e-3)
    weight = np.array(error.weights)

    def memory_s(t: float) -> float:
        near = weight * 2.0 * tau / (t + 2.0 * tau)
        return float(np.sum(near) ** 2 / (2.0 * np.sum(near / (t + 2.0 * tau))))

    last, first, mid = float(weight @ tau), memory_s(0.0), memory_s(AFTER_S)
    rise = mid / last - first / last
    half = AFTER_S * (1.0 - mid / last) / rise if rise > 0.0 else AFTER_S
    return ErrorMemory(first, max(half, 1.0), last)


def noise_for(model: CellModel, noise: Noise | None) -> Noise:
    """The noise that was given, else the model's own.

    Raises
    ------
    InputError        something else than a Noise
    """
    if noise is None:
        return Noise.of_model(model)
    check_kind("noise", noise, Noise, "Leave it out, or give Noise(voltage_V=0.002), say.")
    return noise
