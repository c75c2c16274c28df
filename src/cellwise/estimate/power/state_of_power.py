"""State of power: what a cell can give and take from its present state, within its limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from cellwise.arguments import numbers, shown
from cellwise.cell.compiled import announce
from cellwise.cell.equations import CellState, CellTables
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import moved_part
from cellwise.cell.packed import row_of
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.errors import InputError
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.filters.kalman_kernels import AdaptiveState
from cellwise.estimate.noise import Noise, noise_for
from cellwise.estimate.power.limit_kernels import StatedModel, power_rows
from cellwise.estimate.power.limits import KnownLimits, OperatingLimits, operating_limits
from cellwise.estimate.power.load_kernels import AS_MODEL, BIAS_S, Correction, OperatingPoint
from cellwise.typing import FloatArray

Hold = Literal["power", "current"]
HORIZONS_S = (2.0, 10.0, 30.0)
LONGEST_S = 3600.0
REASONS = ("voltage", "current", "soc", "supply")


class PowerLimit(NamedTuple):
    """Power at one horizon, one way; all without sign.

    ``power_W`` is the value, ``power_low_W`` the bound that is sustained with 95 %; ``current_A``
    and ``voltage_V`` are the value's at the end of the horizon, ``by`` what limits it: ``voltage``,
    ``current``, ``soc``, or ``supply`` where no current gives more power.
    """

    power_W: float
    power_low_W: float
    current_A: float
    voltage_V: float
    by: str


class StateOfPower(NamedTuple):
    """What a cell can give and take for ``horizon_s``."""

    horizon_s: float
    discharge: PowerLimit
    charge: PowerLimit

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        found: dict[str, Any] = {"horizon_s": self.horizon_s}
        for way in ("discharge", "charge"):
            limit: PowerLimit = getattr(self, way)
            for name, value in limit._asdict().items():
                found[f"{way}_{name}"] = value
        return found


class PowerSettings(NamedTuple):
    """What the power of a model is asked for: horizons, limits, what is held, the kernels' view.

    ``seen`` is for each horizon the same model, and what its error may still do by then where the
    voltages of `BIAS_S` are known.
    """

    horizons_s: tuple[float, ...]
    hold: Hold
    known: KnownLimits
    tables: CellTables
    noise: Noise
    model: CellModel
    seen: tuple[StatedModel, ...]

    def rows(self, present: FloatArray) -> FloatArray:
        """Numbers of a `PowerLimit` of every row, horizon and way: (rows, horizons, 2, 5).

        ``present`` are operating points in rows, shape (rows, numbers of an OperatingPoint).
        """
        announce(power_rows, "the state of power")
        out = np.empty((len(self.horizons_s), len(present), 2, len(PowerLimit._fields)))
        unseen = StatedModel(self.tables, self.noise.scalars(self.model))
        limits, power = self.known.scalars(), self.hold == "power"
        for horizon_s, seen, found in zip(self.horizons_s, self.seen, out, strict=True):
            power_rows(unseen, seen, limits, power, horizon_s, present, found)
        return np.ascontiguousarray(out.swapaxes(0, 1))

    def states(self, row: FloatArray) -> tuple[StateOfPower, ...]:
        """One row of these by name, at every horizon."""

        def limit(numbers: FloatArray) -> PowerLimit:
            power_W, low_W, current_A, voltage_V, reason = numbers.tolist()
            return PowerLimit(power_W, low_W, current_A, voltage_V, REASONS[int(reason)])

        pairs = zip(self.horizons_s, row, strict=True)
        return tuple(StateOfPower(horizon_s, *map(limit, ways)) for horizon_s, ways in pairs)

    def of(self, now: OperatingPoint) -> tuple[StateOfPower, ...]:
        """State of power of one moment, at every horizon."""
        return self.states(self.rows(row_of(now)[None])[0])


def power_settings(
    model: CellModel,
    *,
    horizons_s: Sequence[float] = HORIZONS_S,
    limits: OperatingLimits | None = None,
    hold: Hold = "power",
    noise: Noise | None = None,
) -> PowerSettings:
    """Check what a power is asked for, once.

    Raises
    ------
    InputError        as :func:`power_limits`
    """
    check_is_model(model)
    horizons = tuple(numbers("horizons_s", horizons_s).ravel().tolist())
    if not horizons or not all(np.isfinite(h) and 0.0 < h <= LONGEST_S for h in horizons):
        raise InputError(
            f"horizons of {', '.join(f'{h:g}' for h in horizons) or 'nothing'} s for the power",
            f"times above zero, at most {LONGEST_S:g} s",
            "Give 2 10 30, say.",
        )
    if len(set(horizons)) != len(horizons):
        raise InputError(
            f"horizons of {', '.join(f'{h:g}' for h in horizons)} s", "each once", "Leave one out."
        )
    if hold not in get_args(Hold):
        raise InputError(f"hold '{hold}'", f"one of {', '.join(get_args(Hold))}", "Choose one.")
    known = operating_limits(model, limits)
    seen = tuple(_seen(model, noise, h) for h in horizons)
    return PowerSettings(
        horizons, hold, known, model.parameters(), noise_for(model, noise), model, seen
    )


def _seen(model: CellModel, noise: Noise | None, horizon_s: float) -> StatedModel:
    """A model after `BIAS_S` of voltages: what its error may do in a horizon, not what it was.

    An error along the SOC axis is as slow as the slowest; a ``noise`` that was given stays.
    """
    slowest_s = np.array(model.error.scales_s[-1:])
    model = replace(model, error=model.error.moved(horizon_s, BIAS_S))
    known = noise_for(model, noise)
    if noise is None:
        (part,) = moved_part(slowest_s, horizon_s, BIAS_S).tolist()
        known = replace(known, ocv_soc=part * known.ocv_soc)
    return StatedModel(model.parameters(), known.scalars(model))


def power_limits(
    model: CellModel,
    state: EkfState | AdaptiveState | CellState,
    *,
    horizons_s: Sequence[float] = HORIZONS_S,
    limits: OperatingLimits | None = None,
    temperature_C: float | None = None,
    hold: Hold = "power",
    noise: Noise | None = None,
) -> tuple[StateOfPower, ...]:
    """Power that a cell can give and take for some seconds within its limits.

    The largest power (``hold`` ``"power"``) or current (``"current"``) which, held from now to the
    end of the horizon, keeps the terminal voltage, the current and the SOC within their limits;
    what is said is the power at the end of the horizon. The lower bound keeps the limits with
    95 %: they are narrowed by 1.645 deviations of the predicted voltage and of the SOC.

    Source: G. Plett, High-performance battery-pack power estimation using a dynamic cell model,
    IEEE Trans. Veh. Technol. 53 (2004) 1586, 10.1109/TVT.2004.832408, section IV.

    Parameters
    ----------
    state : a filter's state          of `Ekf.step`, `Ukf.step`, `Adaptive.step`; a `CellState` is
                                      known exactly: the bound is then that of the model's error
    horizons_s : sequence of float    [s]
    limits : OperatingLimits or None  what is not given: the model's, its chemistry's window, the
                                      largest currents of its data
    temperature_C : float or None     of the surface now [degC]; None: the model's own
    noise : Noise or None             None: from the model's own validation error

    Returns
    -------
    tuple of StateOfPower             one for each horizon

    Raises
    ------
    InputError        no horizon above zero; limits that are inverted, or not known
    """
    settings = power_settings(model, horizons_s=horizons_s, limits=limits, hold=hold, noise=noise)
    if not isinstance(state, (EkfState, AdaptiveState, CellState)):
        raise InputError(
            f"state = {shown(state)}",
            "a filter's state, or a CellState",
            "Pass what `step` returns.",
        )
    warm = model.usual_temperature_C if temperature_C is None else float(temperature_C)
    return settings.of(present_of(state, warm))


def present_of(
    state: EkfState | AdaptiveState | CellState, temperature_C: float, seen: Correction = AS_MODEL
) -> OperatingPoint:
    """A filter's state, or a cell's that is known exactly, as the kernels take it."""
    if isinstance(state, CellState):
        return OperatingPoint(state, 0.0, temperature_C, seen)
    return OperatingPoint(state.cell, state.soc_std**2, temperature_C, seen)
