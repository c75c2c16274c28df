"""Time to full of a cell on a charger, through its constant current and its constant voltage."""

from __future__ import annotations

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.power.limits import LEAST_LOAD_C
from cellwise.estimate.replay import Replay
from cellwise.forecast.log_kernels import WINDOW_S, LoadAhead
from cellwise.forecast.remaining import (
    ForecastTrace,
    at_most,
    flight_of,
    present_load,
    warms_unseen,
)
from cellwise.typing import FloatArray

CHARGER_S = 30.0  # a charge that lasts; regenerative braking does not
HELD_V = 0.015  # this near its voltage a charger holds it
TAIL_SHARE = 0.5  # of the time at that voltage whose decay of the current is taken
LEAST_TAIL_S = 120.0
SEEN_EVERY_S = 5.0  # of a charge that is followed sample by sample
LEAST_FALL = 0.05  # of the current, to take a decay from
# Of the decay against the model, for the logarithm of the time: time constants of parts of one
# charge differ by 1.5, one deviation, and a model's by `TAIL_FACTOR` at two.
DECAY_SHARE = 0.65
BOTH_FACTOR = 2.2  # two deviations of what both say: both miss that a decay slows down
TAPER_C = 0.05  # where a charger ends that nobody asked about: 1/20 of the capacity per hour


def limit_of(model: CellModel, given: float | None) -> float:
    """The voltage that a charger holds: as given, the model's upper limit, its OCV at SOC 1.

    Raises
    ------
    InputError        not a voltage of one cell that charges it to more than half
    """
    limit = model.voltage_max_V if given is None else given
    full = float(np.max(model.ocv_V))
    half = float(np.median(model.ocv_V))
    limit = full if limit is None else float(limit)
    if not half < limit < 1.2 * full:
        raise InputError(
            f"a charger of {limit:g} V for a cell of {half:.2f} V half full and {full:.2f} V full",
            "the voltage that it holds at one cell",
            "Give that of a cell, not of the pack.",
        )
    return limit


def taper_of(model: CellModel, given: float | None) -> float:
    """The current at which a charger ends [A]: as given, else a twentieth of the capacity.

    Raises
    ------
    InputError        not above zero
    """
    taper = TAPER_C * model.capacity_Ah if given is None else given
    if not 0.0 < taper < np.inf:
        raise InputError(
            f"a charge that ends at {taper:g} A", "a current above zero", "Give 0.1, say."
        )
    return float(taper)


def tail(time_s: FloatArray, charge_A: FloatArray, taper_A: float) -> float | None:
    """Time at constant voltage until the current has decayed to its end [s].

    The decay is exponential, with the time constant of the later half of the rows given, which are
    at that voltage; None where they are too few to show one.
    """
    if time_s.size < 3:
        return None
    later = time_s >= time_s[-1] - TAIL_SHARE * (time_s[-1] - time_s[0])
    time_s, charge_A = time_s[later], charge_A[later]
    span_s = time_s[-1] - time_s[0]
    if time_s.size < 3 or span_s < LEAST_TAIL_S or np.any(charge_A <= 0.0):
        return None
    slope, level = np.polyfit(time_s - time_s[-1], np.log(charge_A), 1)
    if -slope * span_s < LEAST_FALL:
        return None
    return max(float(level - np.log(taper_A)) / -float(slope), 0.0)


def with_decay(
    model_s: float, time_s: FloatArray, charge_A: FloatArray, taper_A: float
) -> float | None:
    """Time to full at constant voltage, by a model and by the current's own decay [s]."""
    decay_s = tail(time_s, charge_A, taper_A)
    if decay_s is None:
        return None
    model_s = max(model_s, 1.0)
    return float(model_s * (max(decay_s, 1.0) / model_s) ** DECAY_SHARE)


class ChargerSeen:
    """What a charger has done so far, sample by sample: its mean current, and its decay.

    Parameters
    ----------
    limit_V, taper_A : float    voltage that it holds, current at which it ends, of one cell
    least_A : float             more than this into the cell is charging
    """

    def __init__(self, limit_V: float, taper_A: float, least_A: float) -> None:
        self.limit_V, self.taper_A = limit_V, taper_A
        self._least_A = max(least_A, taper_A)
        self._at_s = self._seen_s = self._mean_A = 0.0
        self._held: list[tuple[float, float]] = []

    def take(self, current_A: float, voltage_V: float, dt_s: float) -> None:
        """Follow one sample."""
        self._at_s += dt_s
        if current_A > -self._least_A:
            self._seen_s = self._mean_A = 0.0
            self._held.clear()
            return
        self._seen_s += dt_s
        share = min(dt_s / max(min(self._seen_s, WINDOW_S), 1e-9), 1.0) if self._seen_s else 1.0
        self._mean_A += share * (-current_A - self._mean_A)
        if voltage_V <= self.limit_V - HELD_V:
            self._held.clear()
        elif not self._held or self._at_s - self._held[-1][0] >= SEEN_EVERY_S:
            self._held.append((self._at_s, -current_A))

    @property
    def charge_A(self) -> float | None:
        """Mean current of the last minute [A]; None where the cell is not being charged."""
        steady = self._seen_s >= CHARGER_S and self._mean_A > self._least_A
        return self._mean_A if steady else None

    def with_decay(self, model_s: float) -> float | None:
        """As the function of that name; None before the charger holds its voltage."""
        if not self._held:
            return None
        time_s, charge_A = np.array(self._held).T
        return with_decay(model_s, time_s, charge_A, self.taper_A)


def forecast_charge(
    model: CellModel,
    replay: Replay,
    *,
    limit_V: float | None = None,
    taper_A: float | None = None,
) -> ForecastTrace | None:
    """Time and energy to full along a replay, wherever the cell is being charged.

    The charger is taken to hold the mean current of the last minute until the voltage is its own,
    and then that voltage until the current has fallen to its end. The energy is what it gives.

    Parameters
    ----------
    model : CellModel         the one of the replay
    replay : Replay
    limit_V : float or None   as :func:`limit_of`
    taper_A : float or None   as :func:`taper_of`; of one cell

    Returns
    -------
    ForecastTrace or None     of negative loads; None where the log holds no charging of C/50 or
                              more

    Raises
    ------
    InputError                as :func:`limit_of`, :func:`taper_of`
    """
    limit, taper = limit_of(model, limit_V), taper_of(model, taper_A)
    log = replay.log
    current = np.ascontiguousarray(log.known_current_A())
    least_A = LEAST_LOAD_C * model.capacity_Ah
    charging = current < -least_A
    # A charger holds its current from the first row on: what was before is no part of it.
    since_s = np.maximum.accumulate(np.where(charging, log.time_s[0], log.time_s))
    mean_A, mean_W = present_load(log, current, since_s)
    mean_A = np.where(np.isfinite(mean_A), mean_A, current)
    steady = log.time_s - since_s >= CHARGER_S
    wanted = at_most(charging & steady & (mean_A < -max(least_A, taper)))
    if not wanted.any():
        return None
    load = LoadAhead(mean_A, np.nan, wanted, False, limit, warms_unseen(model), taper)
    found = flight_of(model, replay, load, mean_W)
    held = charging & (log.voltage_V > limit - HELD_V)
    before_s = np.maximum.accumulate(np.where(held, -np.inf, log.time_s))
    for place, k in enumerate(np.flatnonzero(wanted)):
        first = int(np.searchsorted(log.time_s, before_s[k], "right"))
        rows = slice(min(first, k), k + 1)
        model_s = found.remaining_s[place]
        both_s = with_decay(model_s, log.time_s[rows], -current[rows], taper)
        if held[k] and both_s is not None:
            times = both_s / max(model_s, 1.0)
            found.remaining_Wh[place] *= times
            found.remaining_Wh_band[place] *= times
            found.remaining_s[place] = both_s
            found.remaining_s_band[place] = both_s / BOTH_FACTOR, both_s * BOTH_FACTOR
    return found
