"""How much a voltage weighs: its variance, the memory of the model's error, what stays of it."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline
from cellwise.cell.equations.double import positive_above, root
from cellwise.cell.equations.scalar import at_most, clip
from cellwise.estimate.equations.constants import SQUARE_MOST

Constants: TypeAlias = Any  # of one time step


class Chord(NamedTuple):
    """The voltage over SOC as a straight line between two points, and how far it is off between."""

    slope_V: float
    bend_V: float


@inline
def chord_of(
    low_V: float,
    low_ohm: float,
    high_V: float,
    high_ohm: float,
    per: float,
    current_A: float,
    away: float,
    ocv_V: float,
) -> Chord:
    """From the OCV and R0 at two SOCs ``1 / per`` apart, seen from ``away`` above the lower one.

    A far-off start must not be corrected with the slope of the spot where it happens to stand, nor
    be thought of as right afterwards when the OCV is no straight line: the bend is the distance
    from the OCV there to the chord. A SOC that is far off brings the resistances of another SOC
    with it, so R0's slope joins the OCV's.
    """
    rise_V = (high_V - low_V) * per
    slope_V = rise_V - (((high_ohm - low_ohm) * per) * current_A)
    bend_V = (low_V - ocv_V) + (rise_V * away)
    return Chord(slope_V, bend_V)


@inline
def covariance_by_soc(drive1: float, drive2: float, with1: float, after2: float) -> float:
    """What two branches have in common because a SOC that is off drives both.

    Each by the slope of its resistance; ``with1`` is the covariance of the first with the SOC,
    ``after2`` that of the second once it is driven.
    """
    return (drive1 * after2) + (drive2 * with1)


@inline
def bent_variance(variance_V2: float, bend_V: float) -> float:
    """Of a voltage that bends by c at one deviation of SOC: off its tangent by c z^2, 3 c^2."""
    return variance_V2 + (3.0 * (bend_V * bend_V))


@inline
def unknown_square(share_variance: float, current_A: float, lost_A2: float) -> float:
    """Mean square of a current that is not known, as a branch sees it [A^2].

    A resistance that is off by a share drives its branch like a current that is off by it, and so
    does a current that nobody measured.
    """
    return (share_variance * (current_A * current_A)) + lost_A2


@inline
def error_variance(fixed_V2: float, error_V: float, ocv_soc2: float, slope_V: float) -> float:
    """Of one voltage, by the sensor and the model's error at this SOC [V^2].

    A SOC scale that is off matters where the OCV is steep.
    """
    return (fixed_V2 + (error_V * error_V)) + (ocv_soc2 * (slope_V * slope_V))


@inline
def voltage_variance(
    error_V2: float, share_variance: float, held_V: float, current_A2: float, r0_ohm: float
) -> float:
    """Of one measured voltage about a perfect state [V^2].

    Beside sensor and model, resistances that are off by a share (of what the ohmic drop and the
    branches hold, ``held_V`` in absolute values) and a current that is not known.
    """
    return error_V2 + ((share_variance * (held_V * held_V)) + (current_A2 * (r0_ohm * r0_ohm)))


@inline
def share_of(c: Constants, current_A: float) -> float:
    """By what share the resistances may be wrong under a current, squared."""
    return c.share_variance if current_A >= 0.0 else c.charge_variance  # type: ignore[no-any-return]


@inline
def single_variance(
    c: Constants, error_V2: float, current_A: float, held_V: float, lost_A2: float, r0_ohm: float
) -> float:
    """Of one measured voltage about a perfect state, under a current [V^2]."""
    current_A2 = c.current_variance_A2 + lost_A2
    return voltage_variance(error_V2, share_of(c, current_A), held_V, current_A2, r0_ohm)


@inline
def as_shown(variance: float, mismatch: float) -> float:
    """A variance as many times as innovations have lately shown beyond it."""
    shown = variance
    if positive_above(mismatch, 1.0):
        shown = mismatch * variance
    return shown


@inline
def lately_shown(mean: float, square: float, lately: float) -> float:
    """Running mean of the squared innovation, in units of its variance.

    A model of another temperature, age or cell is wrong all the time: evidence weighs less by what
    the innovations have lately shown beyond their variance.
    """
    return mean + (lately * (square - mean))


class Shared(NamedTuple):
    """How many samples share one model error: ``above / below``, never divided."""

    above: float
    below: float


@inline
def shared_evidence(c: Constants, since: float, period: float, alone: bool) -> Shared:
    """How many samples share one model error, ``since`` the first one: at least 1.

    An error of memory tau counts once in 2 tau (its spectral density at rest): ``c.shared``. It is
    a sum of processes with memories of a second to half an hour: the quick ones average out first,
    so the rest of a mean has an ever longer memory. Just after the first it is ``shared_early /
    shared_half``, half way between after ``shared_half``. Evidence that stands ``alone`` (the first
    voltage at rest) shares nothing. A repeated sample has no ``period``: over zero.
    """
    below = (since + c.shared_half) * period
    above = below
    if not alone:
        above = (c.shared * since) + c.shared_early
    return Shared(above, below)


@inline
def inverse_weight(explained_V2: float, weight_V2: float, below: float) -> float:
    """One over the variance that weighs a voltage; ``weight_V2`` is to be taken over ``below``."""
    return below / ((explained_V2 * below) + weight_V2)


@inline
def persistent_V(share: float, error_V2: float, mismatch: float) -> float:
    """Persistent model error, one deviation [V]: at this SOC, and along its axis."""
    return share * root(at_most(as_shown(error_V2, mismatch), SQUARE_MOST))


@inline
def persistent_step(gain: float, slope_V: float, persistent: float, error_V: float) -> float:
    """SOC error brought in by a persistent model error, after an update with a gain of the SOC.

    No further voltage averages such an error out: with every voltage the SOC goes where the
    error leads, error over slope in the end. Beside P, which takes each memory of the error for
    new, it makes up the stated variance (consider covariance; Schmidt 1966, p. 293).

    Where the SOC hangs on a branch its gain can be negative, and what the branch takes of the error
    holds the two back; it is not followed here, so nothing is amplified.
    """
    kept = clip(1.0 - (gain * slope_V), 0.0, 1.0)
    return (kept * persistent) + (gain * error_V)


@inline
def contradicted_step(
    contradicted: float,
    innovation_V: float,
    slope_V: float,
    error_V2: float,
    drift: float,
    lately: float,
) -> float:
    """Running mean of the SOC that the voltages say is missing, as far as the count may be off.

    A known start and a small P leave a voltage little weight, and rightly so while the current is
    right: what innovations show is the model's error then. They show the same where the counted
    charge drifts. Were the current off, the count would by now be off by ``drift``, and of an
    innovation drift^2 slope^2 of drift^2 slope^2 + ``error_V2`` would be the count's. No SOC is off
    by more than 1.
    """
    off = at_most(drift, 1.0)
    swing_V = (off * off) * slope_V
    missing = (swing_V * innovation_V) / ((swing_V * slope_V) + error_V2)
    return contradicted + (lately * (clip(missing, -1.0, 1.0) - contradicted))


@inline
def stated_variance(known: float, mismatch: float, persistent: float, contradicted: float) -> float:
    """Variance of the SOC: P's, a persistent error's, and what voltages contradict.

    P trusted the errors as stated. Where innovations show ``mismatch`` times as much, so much more
    may be wrong with the SOC (Birge 1932, doi:10.1103/PhysRev.40.207).
    """
    beside = (persistent * persistent) + (contradicted * contradicted)
    return as_shown(known, mismatch) + beside
