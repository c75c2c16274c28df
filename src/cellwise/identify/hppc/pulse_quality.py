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
from typing import Literal, NamedTuple

import numpy as np

from cellwise.identify.hppc.passive_misfit import (
    Load,
    Misfit,
    channels_of,
    noise_of,
    passive_misfit,
)
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

PulseQuality = Literal["healthy", "trimmed", "distorted", "spurious"]


class _Limits(NamedTuple):
    """What separates healthy pulses from others; shares without a unit."""

    same_duration: float = 0.05  # durations this near to each other were planned alike
    same_rate: float = 0.03
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


LIMITS = _Limits()


class Verdict(NamedTuple):
    """Quality of a pulse, and the reason."""

    quality: PulseQuality
    reason: str


def judge_loads(log: CellLog, loads: Sequence[Load]) -> tuple[Verdict, ...]:
    """Judge every load of a log against its siblings and against a passive circuit.

    Parameters
    ----------
    log : CellLog
    loads : sequence of Load     all of the log's, because durations and limits come from the set
    """
    v = log.voltage_V
    durations = np.array([_seconds(log, x.start, x.stop) for x in loads])
    held = np.array([x.cc_stop < x.stop for x in loads], dtype=np.bool_)
    expected = _expected(v, loads, durations)
    limits = {way: _limit(v, loads, durations, expected, held, way) for way in (True, False)}
    gaps = log.gap_rows
    found: list[Verdict | None] = []
    for x, t, e in zip(loads, durations.tolist(), expected.tolist(), strict=True):
        limit = limits[x.current_A > 0.0]
        found.append(_spurious(log, x, t, e, gaps, limit) or _trimmed(log, x, t, e, limit))
    channels = channels_of(log)
    misfits = [
        None if verdict else passive_misfit(channels, x)
        for x, verdict in zip(loads, found, strict=True)
    ]
    border = {role: _border(misfits, loads, role) for role in ("pulse", "move")}
    return tuple(
        verdict or _shape(misfit, border[x.role])
        for x, verdict, misfit in zip(loads, found, misfits, strict=True)
    )


def _border(misfits: Sequence[Misfit | None], loads: Sequence[Load], role: str) -> float:
    """Share of the response that may be unexplained: of one role, as its better pulses show."""
    shares = [m.relative for m, x in zip(misfits, loads, strict=True) if m and x.role == role]
    usual = float(np.quantile(shares, 0.25)) if len(shares) >= LIMITS.siblings else 0.0
    return float(np.clip(2.0 * usual, LIMITS.distorted, LIMITS.worst))


def _end(v: FloatArray, start: int, stop: int) -> float:
    """Last voltage that was measured in rows start to stop, NaN where there is none."""
    known = np.flatnonzero(np.isfinite(v[start:stop]))
    return float(v[start + known[-1]]) if known.size else float("nan")


def _seconds(log: CellLog, start: int, stop: int) -> float:
    return float(log.time_s[stop - 1] - log.time_s[max(start - 1, 0)])


def _expected(v: FloatArray, loads: Sequence[Load], durations: FloatArray) -> FloatArray:
    """Planned duration of each load [s]: the commonest one of its role and direction.

    A rate has a plan of its own where its loads last equally long and yet end at different
    voltages: a limit would have made the voltages equal and the durations different.
    """
    kind = np.array([f"{x.role} {x.current_A > 0.0}" for x in loads])
    current = np.array([x.current_A for x in loads])
    ends = np.array([_end(v, x.start, x.stop) for x in loads])
    out = np.array([_commonest(durations[kind == k]) for k in kind])
    for k, x in enumerate(loads):
        alike = (kind == kind[k]) & (np.abs(current / x.current_A - 1.0) <= LIMITS.same_rate)
        alike &= np.abs(durations - durations[k]) <= LIMITS.same_duration * durations[k]
        spread = float(np.ptp(ends[alike]))
        if np.count_nonzero(alike) > 2 and spread > LIMITS.at_limit * abs(ends[k]):
            out[k] = durations[k]
    return out


def _commonest(durations: FloatArray) -> float:
    """Duration that most loads share within a few per cent; the longer of two as common."""
    if durations.size == 0:
        return 0.0
    near = (
        np.abs(durations[:, None] - durations[None, :]) <= LIMITS.same_duration * durations[:, None]
    )
    count = near.sum(axis=1)
    return float(np.max(durations[count == count.max()]))


def _limit(
    v: FloatArray,
    loads: Sequence[Load],
    durations: FloatArray,
    expected: FloatArray,
    held: BoolArray,
    discharge: bool,
) -> float | None:
    """Voltage limit that loads of this sign ran into [V]: as held, else where short ones end.

    No load that lasted goes beyond a limit, so a short one that ended at a voltage that others
    passed unharmed did not end for it.
    """
    side = np.array([(x.current_A > 0.0) == discharge for x in loads], dtype=np.bool_)
    short = side & ~held & (durations < LIMITS.short * expected)
    lasted = [v[x.start : x.stop] for x, s in zip(loads, side & ~short, strict=True) if s]
    passed = np.concatenate([*lasted, np.array([np.inf if discharge else -np.inf])])
    extreme = float(np.nanmin(passed) if discharge else np.nanmax(passed))
    levels = [
        float(np.nanmedian(v[x.cc_stop : x.stop]))
        for x, s in zip(loads, side & held, strict=True)
        if s
    ]
    levels = [e for e in levels if abs(e - extreme) <= LIMITS.at_limit * abs(extreme)]
    if levels:
        return float(np.median(levels))
    ends = [_end(v, x.start, x.stop) for x, s in zip(loads, short, strict=True) if s]
    margin = 0.2 * LIMITS.at_limit * abs(extreme)
    if discharge:
        return max((e for e in ends if e <= extreme + margin), default=None)
    return min((e for e in ends if e >= extreme - margin), default=None)


def _at_limit(voltage: float, limit: float | None, discharge: bool) -> bool:
    if limit is None:
        return False
    margin = LIMITS.at_limit * abs(limit)
    return voltage <= limit + margin if discharge else voltage >= limit - margin


def _spurious(
    log: CellLog, x: Load, duration: float, expected: float, gaps: BoolArray, limit: float | None
) -> Verdict | None:
    v = log.voltage_V
    inside = v[x.start : x.stop]
    if np.any(gaps[x.start : x.stop]):
        return Verdict("spurious", "a gap in the log lies inside the pulse")
    if duration <= 0.0:
        return Verdict("spurious", "no time passes in the pulse")
    missing = int(np.count_nonzero(np.isnan(inside)))
    if missing > LIMITS.missing * inside.size or np.isnan(v[x.rest_start : x.start]).all():
        return Verdict("spurious", f"{missing} voltage samples are missing in the pulse")
    moved = _end(v, x.start, x.stop) - _end(v, x.rest_start, x.start)
    noise = noise_of(v[x.rest_start : x.start])
    if moved * x.current_A >= 0.0 or abs(moved) < LIMITS.sigmas * noise:
        return Verdict(
            "spurious",
            f"the voltage does not answer: {1e3 * moved:+.1f} mV for {x.current_A:+.3g} A "
            f"(noise {1e3 * noise:.1f} mV)",
        )
    ended = _at_limit(_end(v, x.start, x.stop), limit, x.current_A > 0.0)
    if x.cc_stop < x.stop and not ended:
        return Verdict(
            "spurious",
            f"the current falls at {_end(v, x.start, x.stop):.3f} V, which is no limit here",
        )
    if not ended and x.role == "pulse" and duration < LIMITS.far_short * expected:
        return Verdict(
            "spurious",
            f"{duration:.3g} s long where its siblings last {expected:.3g} s, and no limit is near "
            f"({_end(v, x.start, x.stop):.3f} V)",
        )
    if not ended and x.stop - x.start < 2:
        return Verdict("spurious", "a single row long")
    return None


def _trimmed(
    log: CellLog, x: Load, duration: float, expected: float, limit: float | None
) -> Verdict | None:
    v, i = log.voltage_V, log.interval_current_A
    constant = _seconds(log, x.start, x.cc_stop) if x.cc_stop > x.start else 0.0
    planned = max(expected, duration)
    if x.cc_stop < x.stop:
        return Verdict(
            "trimmed",
            f"{np.nanmedian(v[x.cc_stop : x.stop]):.3f} V was reached after {constant:.3g} s of "
            f"{planned:.3g} s and held while the current fell from {abs(x.current_A):.4g} A to "
            f"{abs(i[x.stop - 1]):.4g} A",
        )
    end = _end(v, x.start, x.stop)
    if duration < LIMITS.short * expected and _at_limit(end, limit, x.current_A > 0.0):
        return Verdict(
            "trimmed",
            f"ended after {duration:.3g} s of {expected:.3g} s at {end:.3f} V, the limit of "
            f"{limit:.3f} V",
        )
    return None


def _shape(misfit: Misfit | None, border: float) -> Verdict:
    """Healthy or distorted, by what a passive circuit leaves unexplained."""
    if misfit is None:
        return Verdict("healthy", "too few rows to test the shape of the response")
    share = misfit.relative
    figure = f"{1e3 * misfit.rms_V:.2g} mV rms of {1e3 * misfit.response_V:.3g} mV"
    if share <= border or misfit.rms_V <= LIMITS.misfit_sigmas * misfit.noise_V:
        return Verdict("healthy", f"a passive circuit explains all but {figure}")
    why = "the relaxation does not mirror the pulse"
    if misfit.growth > 1.0:
        why = (
            f"the response bends against a passive circuit (end of the pulse {misfit.growth:.2g} "
            "times as fast as its middle)"
        )
    return Verdict("distorted", f"{why}: {figure} unexplained, {100 * border:.2g} % allowed")
