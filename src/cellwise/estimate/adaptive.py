"""Adaptive estimator: SOC with current-sensor offset, resistances and capacity (or gain)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.compiled import announce
from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate import status as bits
from cellwise.estimate.filters import filter_state as layout
from cellwise.estimate.filters import kalman
from cellwise.estimate.filters import kalman_kernels as kernels
from cellwise.estimate.filters.bank_kernels import COMPONENTS, empty_bank
from cellwise.estimate.filters.capacity_kernels import FreeRules, ResistanceRules
from cellwise.estimate.filters.filter_state import TraceArrays
from cellwise.estimate.filters.kalman_kernels import AdaptiveState, adaptive_rows
from cellwise.estimate.noise import Noise
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray, IntArray

ESTIMABLE = ("current_offset", "resistance", "capacity", "current_gain")


class WhyHeld(IntFlag):
    """Why a parameter was held in a step; 0: it was estimated."""

    NOT_CHOSEN = 1
    SOC_UNSURE = 2  # the SOC is not yet known well enough to look for anything else
    NO_EXCITATION = 4  # the load hardly moves: a resistance and an OCV look alike
    MODEL_MISFIT = 8  # beyond the model's data, or at an end of its SOC
    NO_VOLTAGE = 16
    NO_CURRENT = 32


REASONS = dict(zip(WhyHeld, (
    "not among the parameters to estimate", "SOC not known well enough", "the load hardly moves",
    "the model does not explain the voltage", "no voltage", "no current",
), strict=True))  # fmt: skip


def reason(held: int) -> str | None:
    """The reasons in words; None where the parameter is estimated."""
    return "; ".join(text for bit, text in REASONS.items() if held & bit) or None


@dataclass(frozen=True)
class AdaptiveSettings:
    """Parameters to estimate, what is believed of them before, and when they are held.

    Currents are shares of 1C (the model's capacity over an hour), standard deviations all.

    Parameters
    ----------
    learn : tuple of str         of ``current_offset``, ``resistance``, ``capacity``,
                                 ``current_gain``; capacity and gain move the counted charge alike,
                                 so only one of the two can be chosen
    offset_C : float             sensor offset before any data
    resistance : float           factor on the resistances, about 1
    charge : float               capacity or gain, as a share
    offset_C_per_sqrt_h, resistance_per_sqrt_h, charge_per_sqrt_h : float    how they wander
    fault_probability, charge_probability : float
                                 chance, before any data, that there is an offset, that capacity or
                                 gain is not the model's
    settled_soc : float          beyond this deviation of SOC only an offset is estimated
    swing_V : float              below this RMS of the moving drop resistances are held
    fast_s : float               what moves within it shows R0 and R1
    """

    learn: tuple[str, ...] = ("current_offset", "resistance", "capacity")
    offset_C: float = 0.03
    resistance: float = 0.08
    charge: float = 0.08
    offset_C_per_sqrt_h: float = 0.002
    resistance_per_sqrt_h: float = 0.1
    charge_per_sqrt_h: float = 0.002
    fault_probability: float = 0.2
    charge_probability: float = 0.02
    settled_soc: float = 0.02
    swing_V: float = 0.003
    fast_s: float = 20.0

    def __post_init__(self) -> None:
        unknown = [name for name in self.learn if name not in ESTIMABLE]
        if unknown:
            raise InputError(
                f"a parameter '{unknown[0]}' to estimate",
                f"some of {', '.join(ESTIMABLE)}",
                "Correct its name.",
            )
        if "capacity" in self.learn and "current_gain" in self.learn:
            raise InputError(
                "capacity and current_gain both to be estimated",
                "one of the two",
                "They move the counted charge alike, no data can separate them: drop one.",
            )
        for name, value in vars(self).items():
            if isinstance(value, float) and not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name} = {value}", "a number of at least 0", "Correct it.")
        for name in ("fault_probability", "charge_probability"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(
                    f"{name} = {getattr(self, name)}",
                    "a probability between 0 and 1",
                    "Leave the parameter out of `learn` where it cannot be wrong.",
                )
        if self.fast_s <= 0.0:
            raise InputError(f"fast_s = {self.fast_s}", "seconds above 0", "Correct it.")

    @property
    def estimates_gain(self) -> bool:
        """Whether a wrong charge is laid to the sensor's gain and not to the capacity."""
        return "current_gain" in self.learn

    @property
    def offset_share(self) -> float:
        """Deviation of the offset before any data, of 1C; 0 where it is not estimated."""
        return self.offset_C if "current_offset" in self.learn else 0.0

    def rules(self) -> FreeRules:
        """What the kernels take."""
        resistance = self.resistance if "resistance" in self.learn else 0.0
        charge = self.charge if "capacity" in self.learn or self.estimates_gain else 0.0
        hour = 3600.0

        def odds(probability: float, prior: float) -> float:
            return probability / (1.0 - probability) if prior > 0.0 else 0.0

        def wander(per_sqrt_h: float, prior: float) -> float:
            """As a share of what is believed before, in squares."""
            return (per_sqrt_h / prior) ** 2 / hour if prior > 0.0 else 0.0

        return FreeRules(
            capacity=charge,
            capacity_odds=odds(self.charge_probability, charge),
            offset_odds=odds(self.fault_probability, self.offset_share),
            capacity_wander=wander(self.charge_per_sqrt_h, charge),
            offset_wander=wander(self.offset_C_per_sqrt_h, self.offset_share),
            settled_variance=self.settled_soc**2,
            resistances=ResistanceRules(
                variance=resistance**2,
                wander=self.resistance_per_sqrt_h**2 / hour if resistance > 0.0 else 0.0,
                swing_V2=self.swing_V**2,
                fast_s=self.fast_s,
            ),
        )


CHARGE_LOW, CHARGE_HIGH = 0.5, 2.5
MOSTLY = 0.5  # of the rows: a parameter held in more is said to be, at the end
SHOWN = 0.5


def mostly(bits_of_rows: IntArray) -> str | None:
    """Words for the reasons of most rows, if most rows were held."""
    if bits_of_rows.size == 0 or np.mean(bits_of_rows != 0) <= MOSTLY:
        return None
    common = sum(bit for bit in WhyHeld if np.mean(bits_of_rows & bit != 0) > MOSTLY)
    return reason(common or int(np.bitwise_or.reduce(bits_of_rows)))


class Estimated(NamedTuple):
    """One parameter: value, standard deviation, and what is to be said of it.

    ``probability`` is the chance that it differs from the model's value (None: not asked);
    ``held`` says why it was held over most of the log, None where it was estimated.
    """

    value: float
    std: float
    probability: float | None
    held: str | None

    @property
    def shown(self) -> bool:
        """Whether the data speak for a value other than the model's."""
        return self.held is None and (self.probability is None or self.probability > SHOWN)

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {**self._asdict(), "shown": self.shown}


class Parameters(NamedTuple):
    """What is wrong with sensor and cell, at one time.

    ``offset_A`` is what the sensor adds to the true current, ``gain`` the factor by which it
    multiplies it; ``resistance_scale`` is the factor on R0 and R1. Capacity and gain stand for the
    same change of charge: the one that was not chosen has the model's value.
    """

    offset_A: Estimated
    gain: Estimated
    resistance_scale: Estimated
    capacity_Ah: Estimated
    soh_capacity: float
    soh_resistance: float

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            name: value.to_dict() if isinstance(value, Estimated) else value
            for name, value in self._asdict().items()
        }


@dataclass(frozen=True, eq=False, repr=False)
class AdaptiveTrace(Trace):
    """A trace with the parameters, every array of shape (rows,); ``held`` is (3, rows).

    ``held`` are the bits of :class:`Held` for offset,
    resistance and capacity or gain.
    """

    offset_A: FloatArray
    offset_std_A: FloatArray
    offset_probability: FloatArray
    gain: FloatArray
    gain_std: FloatArray
    capacity_Ah: FloatArray
    capacity_std_Ah: FloatArray
    charge_probability: FloatArray
    resistance_scale: FloatArray
    resistance_std: FloatArray
    held: IntArray
    model_capacity_Ah: float
    estimates_gain: bool

    def parameters(self, row: int = -1) -> Parameters:
        """Values at one row, the last by default; reasons are those of most rows up to there."""
        stop = len(self) if row == -1 else row + 1
        offset, resistance, charge = (mostly(why[:stop]) for why in self.held)
        laid = charge, float(self.charge_probability[row])
        other = "the charge is laid to the other", None
        of_gain, of_capacity = (laid, other) if self.estimates_gain else (other, laid)

        def at(
            value: FloatArray, std: FloatArray, held: str | None, probability: float | None = None
        ) -> Estimated:
            return Estimated(float(value[row]), float(std[row]), probability, held)

        capacity = at(self.capacity_Ah, self.capacity_std_Ah, *of_capacity)
        scale = at(self.resistance_scale, self.resistance_std, resistance)
        chance = float(self.offset_probability[row])
        return Parameters(
            offset_A=at(self.offset_A, self.offset_std_A, offset, chance),
            gain=at(self.gain, self.gain_std, *of_gain),
            resistance_scale=scale,
            capacity_Ah=capacity,
            soh_capacity=capacity.value / self.model_capacity_Ah,
            soh_resistance=scale.value,
        )


class AdaptiveInfo(NamedTuple):
    """What may be looked at after a step; voltage to status as in ``EkfInfo``.

    ``capacity_Ah`` and ``gain`` stand for one change of charge: the one that was not chosen is the
    model's. ``*_probability`` is the chance that the model's value does not hold. ``held_*`` are
    the bits of :class:`Held`, 0 where it is estimated.
    """

    soc: float
    soc_std: float
    voltage_V: float
    innovation_V: float
    innovation_variance_V2: float
    test_ratio: float
    status: int
    offset_A: float
    offset_std_A: float
    offset_probability: float
    capacity_Ah: float
    capacity_std_Ah: float
    gain: float
    gain_std: float
    charge_probability: float
    resistance_scale: float
    held_offset: int
    held_resistance: int
    held_charge: int


class Adaptive(kalman.FilterOfModel):
    """The EKF with more that is free: beside the sensor's offset the capacity, and resistances.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None                 None: from the model's own validation error
    settings : AdaptiveSettings or None   which parameters, and what is believed of them
    """

    name = "adaptive"

    def __init__(
        self,
        model: CellModel | None = None,
        noise: Noise | None = None,
        settings: AdaptiveSettings | None = None,
    ) -> None:
        super().__init__(model, noise)
        self.settings = AdaptiveSettings() if settings is None else settings
        offset = replace(self.noise, offset_share=self.settings.offset_share)
        self._noise = offset.scalars(self.model)
        self._rules = self.settings.rules()
        self._unknown = self.start(0.5, 0.3)  # for a state that is no longer finite: know nothing

    def init(self, soc0: float, soc0_std: float = 0.15, current_A: float = 0.0) -> AdaptiveState:
        """State at ``soc0`` that is known to ``soc0_std``; as :meth:`KalmanFilter.init`."""
        return kernels.adaptive_start(self.start(soc0, soc0_std), self._rules, float(current_A))

    def step(
        self,
        state: AdaptiveState,
        current_A: float,
        voltage_V: float,
        temperature_C: float | None = None,
        *,
        dt_s: float,
        gap: bool = False,
    ) -> tuple[AdaptiveState, AdaptiveInfo]:
        """Take the sample that ends an interval of ``dt_s`` seconds.

        Raises
        ------
        InputError        dt_s negative or not finite; a state or a reading of another type
        """
        kalman.check_state(state, AdaptiveState, self.name)
        reading = kalman.reading_from(current_A, voltage_V, temperature_C, dt_s, gap)
        announce(kernels.adaptive_step, f"the {self.name} step")
        out = self._room(1)
        bank = kalman.bank_of(state.filter, COMPONENTS)
        # fmt: off
        free = kernels.adaptive_step(
            self._tables, self._noise, self._rules, self._unknown, bank, state.free, reading, out
        )
        # fmt: on
        after = AdaptiveState(kalman.state_of(bank), free)
        known = self._parameters(out)
        numbers = [known[name][0].item() for name in AdaptiveInfo._fields if name in known]
        info = (*out.values[: layout.OUTPUTS, 0].tolist(), int(out.status[0]))
        return after, AdaptiveInfo(*info, *numbers, *known["held"][:, 0].tolist())

    @staticmethod
    def _room(rows: int) -> TraceArrays:
        values = np.empty((layout.ADAPTIVE_OUTPUTS, rows))
        return TraceArrays(values, np.empty(rows, dtype=np.int32))

    def run(self, log: CellLog, soc0: float | None = None, soc0_std: float = 0.15) -> AdaptiveTrace:
        """Replay a whole log from `known_start`; the same steps in one compiled loop."""
        start = self.start(kalman.known_start(log, soc0), soc0_std)
        rows = kalman.log_arrays(log)
        out = self._room(len(log))
        announce(adaptive_rows, f"the estimator '{self.name}'")
        # fmt: off
        adaptive_rows(
            self._tables, self._noise, self._rules, start, self._unknown, empty_bank(), rows, out
        )
        # fmt: on
        return AdaptiveTrace(
            **kalman.trace_fields(log, out),
            **self._parameters(out),
            model_capacity_Ah=self.model.capacity_Ah,
            estimates_gain=self.settings.estimates_gain,
        )

    def _parameters(self, out: TraceArrays) -> dict[str, Any]:
        """Offset, capacity or gain and resistances of some rows, and why they were held."""
        v = out.values
        q = np.clip(1.0 + v[layout.OUT_CHARGE], CHARGE_LOW, CHARGE_HIGH)
        inverse, spread = 1.0 / q, v[layout.OUT_CHARGE_STD] / (q * q)
        one, none = np.ones_like(q), np.zeros_like(q)
        capacity, of_gain = self.model.capacity_Ah, self.settings.estimates_gain
        return {
            "offset_A": v[layout.OUT_OFFSET],
            "offset_std_A": v[layout.OUT_OFFSET_STD],
            "offset_probability": v[layout.OUT_OFFSET_FREE],
            "gain": inverse if of_gain else one,
            "gain_std": spread if of_gain else none,
            "capacity_Ah": capacity * (one if of_gain else inverse),
            "capacity_std_Ah": none if of_gain else capacity * spread,
            "charge_probability": v[layout.OUT_CHARGE_FREE],
            "resistance_scale": v[layout.OUT_RESISTANCE],
            "resistance_std": v[layout.OUT_RESISTANCE_STD],
            "held": self._held(out),
        }

    def _held(self, out: TraceArrays) -> IntArray:
        """Why offset, resistance and capacity or gain were held in some rows, shape (3, rows).

        An offset is asked for from the first voltage on, the others once the SOC is settled.
        """
        v, status, rules = out.values, out.status, self._rules
        seen = np.where(
            status & (bits.VOLTAGE_INVALID | bits.VOLTAGE_FROZEN), WhyHeld.NO_VOLTAGE, 0
        )
        seen |= np.where(status & bits.CURRENT_INVALID, WhyHeld.NO_CURRENT, 0)
        unsure = v[layout.OUT_SOC_VARIANCE] > rules.settled_variance
        settled = seen | np.where(unsure, WhyHeld.SOC_UNSURE, 0)
        outside = np.where(status & (bits.CLAMPED | bits.OUTSIDE), WhyHeld.MODEL_MISFIT, 0)
        still = np.where(v[layout.OUT_MOVES] > 0.0, 0, WhyHeld.NO_EXCITATION)
        held = np.stack([seen, settled | still, settled | outside])
        sizes = self.settings.offset_share, rules.resistances.variance, rules.capacity
        held |= np.where(np.array(sizes) > 0.0, 0, WhyHeld.NOT_CHOSEN)[:, None]
        return held.astype(np.int32)
