"""How good a current pulse is for identification, and why: judged from the log itself.

Four verdicts, named as in the LFP paper. *Spurious*: an edge without a pulse. *Trimmed*: a voltage
limit ended the constant current. *Distorted*: the response is none of a linear circuit, which
happens at the ends of the SOC range where the OCV bends. *Healthy*: the rest.

The test for distortion needs no model order. With constant current, any circuit of positive
resistances and capacitances answers with a sum of saturating exponentials, and afterwards with
the same ones decaying; the OCV adds a term linear in charge as long as it is straight. So the
measured response is fitted by *all* of them at once, with amplitudes that may not be negative
(non-negative least squares over a grid of time constants). The residual beyond the noise
no 2-RC model can explain either, whatever its parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import nnls

from cellwise.identify.hppc.plateaus import DRIFT
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

PulseRole = Literal["pulse", "move"]
PulseQuality = Literal["healthy", "trimmed", "distorted", "spurious"]


class _QualityLimits(NamedTuple):
    """What separates healthy pulses from others; shares without a unit."""

    same_duration: float = 0.05  # durations this near to each other were planned alike
    short: float = 0.93  # of the planned duration: less was cut
    far_short: float = 0.5  # of it: without a voltage limit near, this was never planned
    at_limit: float = 0.015  # of the voltage
    missing: float = 0.1  # of a pulse's voltages
    sigmas: float = 5.0  # of the noise: a smaller answer is none
    misfit_sigmas: float = 3.0  # of it: a smaller misfit is none
    # A misfit of 1 % of the response shifts tau1 of a 60 s pulse by about half (synthetic cells
    # with a bending OCV). What every pulse of a test shows, as
    # nonlinear kinetics in the cold, is not the distortion of some: the border rises to twice that
    # of the better pulses, if so many are there, up to the worst (Panasonic at -20 degC: 23 pulses
    # healthy with it, 2 without).
    distorted: float = 0.01
    worst: float = 0.03
    siblings: int = 6


class _ShapeWindow(NamedTuple):
    """What of a pulse and its relaxation is looked at for its shape."""

    settling_rows: int = 2  # after an edge: voltage and current of a row are not of one instant
    bins: int = 40  # of the pulse, and of the relaxation
    rest_bins: int = 8
    rest: float = 0.4  # of the rest before, at its end
    fewest: int = 6  # bins in the pulse, without which there is no shape
    relaxation: float = 10.0  # longest relaxation over the pulse's duration
    per_decade: int = 3  # time constants


LIMITS, WINDOW = _QualityLimits(), _ShapeWindow()


@dataclass(frozen=True)
class Pulse:
    """A constant current after a rest.

    Rows ``start`` to ``stop`` (not included) are those whose intervals carry the current;
    ``rest_before_start`` to ``start`` is the rest before, ``stop`` to ``relax_stop`` the one after
    (none where the next current follows at once). Of a trimmed pulse, rows from ``cc_stop`` on
    hold the voltage instead of the current.

    current_A : level, positive on discharge [A]
    duration_s, charge_Ah : of rows start to stop; charge from the current [s, Ah]
    role : ``pulse``, or ``move``: a long one that takes the cell to another SOC
    quality, reason : verdict, and its reason; both of `judge`
    """

    start: int
    stop: int
    cc_stop: int
    rest_before_start: int
    relax_stop: int
    current_A: float
    duration_s: float
    charge_Ah: float
    role: PulseRole
    quality: PulseQuality = "healthy"
    reason: str = ""

    @property
    def sign(self) -> float:
        """1 on discharge, -1 on charge: times a voltage, what a load lowers."""
        return 1.0 if self.current_A > 0.0 else -1.0


Verdict = tuple[PulseQuality, str]


def judge(log: CellLog, pulses: Sequence[Pulse]) -> tuple[Pulse, ...]:
    """Judge every pulse of a log against its siblings and against a passive circuit.

    Parameters
    ----------
    log : CellLog
    pulses : sequence of Pulse     all of the log's, because durations and limits come from the set
    """
    v, current = log.voltage_V, log.known_current_A()
    planned_s = _planned_s(v, pulses)
    limits = {sign: _limit_V(v, pulses, planned_s, sign) for sign in (1.0, -1.0)}
    found: list[Verdict | None] = []
    misfits: list[Misfit | None] = []
    for p, planned in zip(pulses, planned_s.tolist(), strict=True):
        at = _At(p, planned, _last_V(v[p.start : p.stop]), limits[p.sign])
        found.append(_spurious(log, at) or _trimmed(log, at))
        misfits.append(None if found[-1] else passive_misfit(log, current, p))
    border = {role: _border(misfits, pulses, role) for role in ("pulse", "move")}
    verdicts = (
        f or _shape(m, border[p.role]) for p, f, m in zip(pulses, found, misfits, strict=True)
    )
    return tuple(
        replace(p, quality=quality, reason=reason)
        for p, (quality, reason) in zip(pulses, verdicts, strict=True)
    )


class _At(NamedTuple):
    """A pulse, how long it was planned to last, the voltage at its end and the limit there [V]."""

    pulse: Pulse
    planned_s: float
    end_V: float
    limit_V: float | None

    @property
    def met_limit(self) -> bool:
        """Whether it ended at the voltage limit."""
        limit = self.limit_V
        away = float("inf") if limit is None else self.pulse.sign * (self.end_V - limit)
        return limit is not None and away <= LIMITS.at_limit * abs(limit)


def _last_V(v: FloatArray) -> float:
    """Last voltage that was measured, NaN where there is none."""
    known = v[np.isfinite(v)]
    return float(known[-1]) if known.size else float("nan")


def _planned_s(v: FloatArray, pulses: Sequence[Pulse]) -> FloatArray:
    """Planned duration of each pulse [s]: the commonest one of its role and direction.

    A rate has a plan of its own where its pulses last equally long and yet end at different
    voltages: a limit would have made the voltages equal and the durations different.
    """
    duration, current = (np.array([getattr(p, n) for p in pulses])
                         for n in ("duration_s", "current_A"))  # fmt: skip
    kind = np.array([2.0 * (p.role == "move") + p.sign for p in pulses])
    ends = np.array([_last_V(v[p.start : p.stop]) for p in pulses])
    out = np.array([_commonest(duration[kind == k]) for k in kind])
    for k, p in enumerate(pulses):
        alike = (kind == kind[k]) & (np.abs(current / p.current_A - 1.0) <= DRIFT)
        alike &= np.abs(duration - p.duration_s) <= LIMITS.same_duration * p.duration_s
        spread = float(np.ptp(ends[alike]))
        if np.count_nonzero(alike) > 2 and spread > LIMITS.at_limit * abs(ends[k]):
            out[k] = p.duration_s
    return out


def _commonest(duration: FloatArray) -> float:
    """Duration that most pulses share within a few per cent; the longer of two as common."""
    near = np.abs(duration[:, None] - duration) <= LIMITS.same_duration * duration[:, None]
    count = near.sum(axis=1)
    return float(np.max(duration[count == count.max()]))


def _limit_V(
    v: FloatArray, pulses: Sequence[Pulse], planned_s: FloatArray, sign: float
) -> float | None:
    """Voltage limit that pulses of this sign ran into [V]: as held, else where short ones end.

    No pulse that lasted goes beyond a limit, so a short one that ended at a voltage that others
    passed unharmed did not end for it.
    """
    held, ends, furthest = [], [], np.inf
    for p, planned in zip(pulses, planned_s, strict=True):
        if p.sign != sign:
            continue
        down = sign * v[p.start : p.stop]
        if p.cc_stop < p.stop:
            held.append(float(np.nanmedian(down[p.cc_stop - p.start :])))
        elif p.duration_s < LIMITS.short * planned:
            ends.append(_last_V(down))
            continue
        furthest = min(furthest, float(np.nanmin(down, initial=np.inf)))
    margin = LIMITS.at_limit * abs(furthest)
    held = [e for e in held if abs(e - furthest) <= margin]
    if held:
        return sign * float(np.median(held))
    met = [e for e in ends if e <= furthest + 0.2 * margin]
    return sign * max(met) if met else None


def _spurious(log: CellLog, at: _At) -> Verdict | None:
    p, v = at.pulse, log.voltage_V
    inside, before = v[p.start : p.stop], v[p.rest_before_start : p.start]
    missing = int(np.count_nonzero(np.isnan(inside)))
    moved, noise = at.end_V - _last_V(before), noise_of(before)
    why = ""
    if np.any(log.gap_rows[p.start : p.stop]):
        why = "a gap in the log lies inside the pulse"
    elif p.duration_s <= 0.0:
        why = "no time passes in the pulse"
    elif missing > LIMITS.missing * inside.size or np.isnan(before).all():
        why = f"{missing} voltage samples are missing in the pulse"
    elif moved * p.current_A >= 0.0 or abs(moved) < LIMITS.sigmas * noise:
        why = (
            f"the voltage does not answer: {1e3 * moved:+.1f} mV for {p.current_A:+.3g} A "
            f"(noise {1e3 * noise:.1f} mV)"
        )
    elif at.met_limit:
        return None
    elif p.cc_stop < p.stop:
        why = f"the current falls at {at.end_V:.3f} V, which is no limit here"
    elif p.role == "pulse" and p.duration_s < LIMITS.far_short * at.planned_s:
        why = (
            f"{p.duration_s:.3g} s long where its siblings last {at.planned_s:.3g} s, and no "
            f"limit is near ({at.end_V:.3f} V)"
        )
    elif p.stop - p.start < 2:
        why = "a single row long"
    return ("spurious", why) if why else None


def _trimmed(log: CellLog, at: _At) -> Verdict | None:
    p, v, i = at.pulse, log.voltage_V, log.interval_current_A
    if p.cc_stop < p.stop:
        constant_s = log.time_s[max(p.cc_stop, p.start) - 1] - log.time_s[p.start - 1]
        return (
            "trimmed",
            f"{np.nanmedian(v[p.cc_stop : p.stop]):.3f} V was reached after {constant_s:.3g} s of "
            f"{max(at.planned_s, p.duration_s):.3g} s and held while the current fell from "
            f"{abs(p.current_A):.4g} A to {abs(i[p.stop - 1]):.4g} A",
        )
    if p.duration_s < LIMITS.short * at.planned_s and at.met_limit:
        return (
            "trimmed",
            f"ended after {p.duration_s:.3g} s of {at.planned_s:.3g} s at {at.end_V:.3f} V, the "
            f"limit of {at.limit_V:.3f} V",
        )
    return None


class Misfit(NamedTuple):
    """What no passive circuit explains of a response.

    rms_V, noise_V : the residual, and what the noise alone would leave [V]
    response_V : size of the voltage response [V]
    """

    rms_V: float
    noise_V: float
    response_V: float

    @property
    def relative(self) -> float:
        """Misfit beyond the noise, as a share of the response."""
        beyond = np.sqrt(max(self.rms_V**2 - self.noise_V**2, 0.0))
        return float(beyond / max(self.response_V, 1e-9))


def _border(misfits: Sequence[Misfit | None], pulses: Sequence[Pulse], role: str) -> float:
    """Share of the response that may be unexplained: of one role, as its better pulses show."""
    shares = [m.relative for m, p in zip(misfits, pulses, strict=True) if m and p.role == role]
    usual = float(np.quantile(shares, 0.25)) if len(shares) >= LIMITS.siblings else 0.0
    return float(np.clip(2.0 * usual, LIMITS.distorted, LIMITS.worst))


def _shape(misfit: Misfit | None, border: float) -> Verdict:
    """Healthy or distorted, by what a passive circuit leaves unexplained."""
    if misfit is None:
        return "healthy", "too few rows to test the shape of the response"
    figure = f"{1e3 * misfit.rms_V:.2g} mV rms of {1e3 * misfit.response_V:.3g} mV"
    if misfit.relative <= border or misfit.rms_V <= LIMITS.misfit_sigmas * misfit.noise_V:
        return "healthy", f"a passive circuit explains all but {figure}"
    said = f"no passive circuit answers so, in the pulse and after it: {figure} unexplained"
    return "distorted", f"{said}, {100 * border:.2g} % allowed"


def passive_misfit(log: CellLog, current_A: FloatArray, pulse: Pulse) -> Misfit | None:
    """What the best passive circuit leaves of a pulse and its relaxation.

    Fitted, with amplitudes that may not be negative, to the mean voltage in bins that widen with
    the time after each edge: a constant, R0, an RC branch for each time constant of a grid, the
    slope of the OCV; and, with either sign, what is still relaxing from before.

    Parameters
    ----------
    current_A : (n,) float      of every interval of the log, finite [A]

    Returns
    -------
    Misfit, or None where the pulse has too few rows
    """
    t, v, n, t_on, t_off = _binned_window(log, current_A, pulse)
    inside, rested = (t > t_on) & (t <= t_off), t <= t_on
    if not rested.any() or np.count_nonzero(inside) < WINDOW.fewest:
        return None
    fall = pulse.sign * (float(v[rested][-1]) - v)
    response = float(np.max(fall[inside]))
    if response <= 0.0:
        return None
    # Bins of many rows know more, but no model is better than some 0.1 % of the response.
    noise = noise_of(log.voltage_V[pulse.rest_before_start : pulse.relax_stop])
    sigma = np.sqrt(noise**2 / n + (1e-3 * response) ** 2)[:, None]
    columns = _passive_columns(t, t_on, t_off)
    fitted, _ = nnls(columns / sigma, fall / sigma[:, 0], maxiter=50 * columns.shape[1])
    freedom = max(0.0, 1.0 - np.count_nonzero(fitted) / t.size)
    rms_V = float(np.sqrt(np.mean((columns @ fitted - fall) ** 2)))
    return Misfit(rms_V, float(np.sqrt(np.mean(noise**2 / n) * freedom)), response)


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


def _binned_window(
    log: CellLog, current_A: FloatArray, p: Pulse
) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
    """Time, voltage and rows of bins over rest, pulse and relaxation; current on and off [s]."""
    time, rows = log.time_s, p.stop - p.start
    share = current_A[p.start : p.relax_stop] / p.current_A
    moved_s = share * np.diff(time[p.start - 1 : p.relax_stop])
    # A rise that takes rows is a switch at the instant that keeps the charge.
    on, off = int(np.argmax(np.abs(share[:rows] - 1.0) <= DRIFT)), rows
    t_on = float(time[p.start - 1 + on] - min(p.duration_s, np.sum(moved_s[:on])))
    t_off = float(time[p.stop - 1])
    if off < share.size and abs(share[off]) > DRIFT:
        t_off += float(moved_s[off])
        off += 1
    if rows - on > 10 * WINDOW.settling_rows:
        on, off = on + WINDOW.settling_rows, off + WINDOW.settling_rows
    # Towards the end of a rest what relaxes from before has become slow.
    shown = min(2.0 * p.duration_s, WINDOW.rest * (t_on - float(time[p.rest_before_start])))
    begin = max(p.rest_before_start, int(np.searchsorted(time, t_on - shown)))
    end = int(np.searchsorted(time, t_off + WINDOW.relaxation * p.duration_s, side="right"))
    pieces = (
        _binned(log, slice(min(begin, p.start - 1), p.start), WINDOW.rest_bins, None),
        _binned(log, slice(p.start + on, p.stop), WINDOW.bins, t_on),
        _binned(log, slice(p.start + off, min(end, p.relax_stop)), WINDOW.bins, t_off),
    )
    t, v, n = np.concatenate(pieces, axis=1)
    return t, v, n, t_on, t_off


def _binned(log: CellLog, rows: slice, bins: int, origin_s: float | None) -> FloatArray:
    """Mean time, mean voltage and number of rows of each bin; bins widen from the origin on."""
    good = np.isfinite(log.voltage_V[rows])
    t, v = log.time_s[rows][good], log.voltage_V[rows][good]
    if t.size == 0:
        return np.zeros((3, 0))
    place = np.arange(t.size)
    if t.size > bins:
        share = place / t.size
        if origin_s is not None:
            since = np.maximum(t - origin_s, 1e-9)
            share = np.log(since / since[0]) / np.log(since[-1] * (1.0 + 1e-9) / since[0])
        place = np.unique(np.floor(bins * share), return_index=True)[1]
    n = np.diff(np.append(place, t.size)).astype(np.float64)
    return np.stack((np.add.reduceat(t, place) / n, np.add.reduceat(v, place) / n, n))


def noise_of(voltage_V: FloatArray) -> float:
    """Standard deviation of a voltage sample [V]: scatter of second differences, or resolution."""
    v = voltage_V[np.isfinite(voltage_V)]
    if v.size < 5:
        return 0.0
    scatter = float(np.median(np.abs(np.diff(v, 2))) / (0.6745 * np.sqrt(6.0)))
    steps = np.abs(np.diff(v))
    resolution = 0.3 * float(np.min(steps, where=steps > 1e-9, initial=np.inf))
    return max(scatter, resolution if np.isfinite(resolution) else 0.0)
