"""What of a pulse's response no passive linear circuit can explain, whatever its order."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import nnls

from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

PulseRole = Literal["pulse", "move"]


class _Window(NamedTuple):
    """What of a pulse and its relaxation is looked at."""

    edge: float = 0.03  # a row is part of an edge whose current is off by this share of the pulse
    settling_rows: int = 2  # after an edge: voltage and current of a row are not of one instant
    bins: int = 40  # of the pulse, and of the relaxation
    rest_bins: int = 8
    rest: float = 0.4  # of the rest before, at its end
    fewest: int = 6  # bins in the pulse, without which there is no shape
    relaxation: float = 10.0  # longest relaxation over the pulse's duration
    per_decade: int = 3  # time constants


WINDOW = _Window()


class Load(NamedTuple):
    """Rows and plain facts of a current pulse, before anybody judged it.

    Rows ``start`` to ``cc_stop`` hold the current, ``cc_stop`` to ``stop`` the voltage (none if
    equal); ``rest_start`` to ``start`` is the rest before, ``stop`` to ``relax_stop`` that after.
    """

    rest_start: int
    start: int
    cc_stop: int
    stop: int
    relax_stop: int
    current_A: float
    role: PulseRole


class Channels(NamedTuple):
    """Time [s], finite current of each interval [A] and voltage [V] of a log's rows."""

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray


def channels_of(log: CellLog) -> Channels:
    """Time, current of each interval and voltage of a log."""
    return Channels(log.time_s, log.known_current_A(), log.voltage_V)


class Misfit(NamedTuple):
    """What no passive circuit explains of a response.

    rms_V, noise_V : the residual, and what the noise alone would leave [V]
    response_V : size of the voltage response [V]
    growth : |dV/dt| in the last third of the pulse over that in the middle third
    """

    rms_V: float
    noise_V: float
    response_V: float
    growth: float

    @property
    def relative(self) -> float:
        """Misfit beyond the noise, as a share of the response."""
        beyond = np.sqrt(max(self.rms_V**2 - self.noise_V**2, 0.0))
        return float(beyond / max(self.response_V, 1e-9))


def passive_misfit(channels: Channels, load: Load) -> Misfit | None:
    """What the best passive circuit leaves of a pulse and its relaxation.

    Fitted, with amplitudes that may not be negative, to the mean voltage in bins that widen with
    the time after each edge: a constant, R0, an RC branch for each time constant of a grid, the
    slope of the OCV; and, with either sign, what is still relaxing from before.

    Parameters
    ----------
    channels : Channels      of the log
    load : Load              rows of the pulse

    Returns
    -------
    Misfit, or None where the pulse has too few rows
    """
    t, v, n, t_on, t_off = _binned_window(channels, load)
    inside = (t > t_on) & (t <= t_off)
    rested = t <= t_on
    if not rested.any() or np.count_nonzero(inside) < WINDOW.fewest:
        return None
    sign = 1.0 if load.current_A > 0.0 else -1.0
    fall = sign * (float(v[rested][-1]) - v)
    response = float(np.max(fall[inside]))
    if response <= 0.0:
        return None
    # Bins of many rows know more, but no model is better than some 0.1 % of the response.
    noise = noise_of(channels.voltage_V[load.rest_start : load.relax_stop])
    sigma = np.sqrt(noise**2 / n + (1e-3 * response) ** 2)[:, None]
    columns = _passive_columns(t, t_on, t_off)
    fitted, _ = nnls(columns / sigma, fall / sigma[:, 0], maxiter=50 * columns.shape[1])
    left = columns @ fitted - fall
    freedom = max(0.0, 1.0 - np.count_nonzero(fitted) / t.size)
    return Misfit(
        rms_V=float(np.sqrt(np.mean(left**2))),
        noise_V=float(np.sqrt(np.mean(noise**2 / n) * freedom)),
        response_V=response,
        growth=_growth(t[inside] - t_on, fall[inside], t_off - t_on),
    )


def _passive_columns(t: FloatArray, t_on: float, t_off: float) -> FloatArray:
    """Responses to the pulse of everything that may add up, one per column."""
    duration = t_off - t_on
    since = np.clip(t - t_on, 0.0, duration)
    after = np.maximum(t - t_off, 0.0)
    shortest = max(0.5 * float(np.min(np.diff(t))), 1e-3)
    longest = 3.0 * duration + float(after[-1])
    count = max(3, int(np.ceil(WINDOW.per_decade * np.log10(longest / shortest))))
    tau = np.geomspace(shortest, longest, count)
    branches = -np.expm1(-since[:, None] / tau) * np.exp(-after[:, None] / tau)
    rest = max(t_on - float(t[0]), 1e-3)
    before = np.exp(-(t - t[0])[:, None] / (rest * np.array([1.0, 3.0, 10.0, 30.0])))
    free = np.column_stack((np.ones(t.size), before))
    ohmic = ((t > t_on) & (t <= t_off)).astype(np.float64)
    return np.column_stack((ohmic, branches, since / duration, free, -free))


def _growth(t: FloatArray, fall: FloatArray, duration: float) -> float:
    """|dV/dt| in the last third of the pulse over that in the middle third."""
    at = np.interp(np.array([1.0, 2.0, 3.0]) * duration / 3.0, t, fall)
    middle, end = at[1] - at[0], at[2] - at[1]
    return float(end / middle) if middle > 0.0 else float("inf") if end > 0.0 else 1.0


def _binned_window(c: Channels, x: Load) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
    """Time, voltage and rows of bins over rest, pulse and relaxation; current on and off [s]."""
    share = c.current_A[x.start : x.relax_stop] / x.current_A
    dt = np.diff(c.time_s[x.start - 1 : x.relax_stop])
    t_off = float(c.time_s[x.stop - 1])
    duration = t_off - float(c.time_s[x.start - 1])
    # A rise that takes rows is a switch at the instant that keeps the charge.
    held = np.abs(share[: x.stop - x.start] - 1.0) <= WINDOW.edge
    on = int(np.argmax(held)) if held.any() else 0
    t_on = float(c.time_s[x.start - 1 + on]) - min(duration, float(np.sum(share[:on] * dt[:on])))
    off = x.stop - x.start
    if off < share.size and abs(share[off]) > WINDOW.edge:
        t_off += float(share[off] * dt[off])
        off += 1
    if x.stop - x.start - on > 10 * WINDOW.settling_rows:
        on, off = on + WINDOW.settling_rows, off + WINDOW.settling_rows
    # Towards the end of a rest what relaxes from before has become slow.
    shown = min(2.0 * duration, WINDOW.rest * (t_on - float(c.time_s[x.rest_start])))
    begin = max(x.rest_start, int(np.searchsorted(c.time_s, t_on - shown)))
    end = int(np.searchsorted(c.time_s, t_off + WINDOW.relaxation * duration, side="right"))
    pieces = (
        _binned(c, min(begin, x.start - 1), x.start, None),
        _binned(c, x.start + on, x.stop, t_on),
        _binned(c, x.start + off, min(end, x.relax_stop), t_off),
    )
    t, v, n = (np.concatenate(p) for p in zip(*pieces, strict=True))
    return t, v, n, t_on, t_off


def _binned(
    c: Channels, start: int, stop: int, origin_s: float | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean time, mean voltage and number of rows of each bin; bins widen from the origin on."""
    t, v = c.time_s[start:stop], c.voltage_V[start:stop]
    good = np.isfinite(v)
    t, v = t[good], v[good]
    bins = WINDOW.bins if origin_s is not None else WINDOW.rest_bins
    if t.size > bins:
        if origin_s is None:
            edges = np.linspace(0.0, t.size, bins + 1)
        else:
            since = np.maximum(t - origin_s, 1e-9)
            spaced = np.geomspace(since[0], since[-1] * (1.0 + 1e-9), bins + 1)
            edges = np.searchsorted(since, spaced).astype(np.float64)
        cuts = np.unique(edges.astype(np.int64)[:-1])
    else:
        cuts = np.arange(t.size)
    if cuts.size == 0:
        empty = np.zeros(0)
        return empty, empty, empty
    n = np.diff(np.append(cuts, t.size)).astype(np.float64)
    return np.add.reduceat(t, cuts) / n, np.add.reduceat(v, cuts) / n, n


def noise_of(voltage_V: FloatArray) -> float:
    """Standard deviation of a voltage sample [V]: scatter of second differences, or resolution."""
    v = voltage_V[np.isfinite(voltage_V)]
    if v.size < 5:
        return 0.0
    scatter = float(np.median(np.abs(np.diff(v, 2))) / (0.6745 * np.sqrt(6.0)))
    steps = np.abs(np.diff(v))
    steps = steps[steps > 1e-9]
    resolution = 0.3 * float(steps.min()) if steps.size else 0.0
    return max(scatter, resolution)
