r"""How a cell warms under its own losses: estimated from the log so far, carried into a forecast.

One lump, whose losses heat it and whose surroundings cool it:

.. math:: \dot\theta = a P - k \theta + c, \qquad P = I (OCV - V), \qquad c = k \theta_{env}

with the temperature :math:`\theta` from the log's first one. It is linear in a (one over the heat
capacity), k (one over the time constant) and c, so that sums over the log hold all it says of them:
:math:`\Delta\theta = a \int P - k \int \theta + c \Delta t` over every five minutes. The reversible
heat is left out. Bernardi, Pawlikowski and Newman (1985), doi:10.1149/1.2113792.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel

# What lithium-ion cells are before a log says more, and how a log is taken apart.
HEAT_J_PER_K_AH = 20.0  # 15 (3 Ah 18650 of 47 g) to 33 (LFP 26650)
SHARE_OF_HEAT = 0.4  # one deviation of it
# A quarter of an hour alone in air to hours inside a pack; its deviation, too.
COOLING_PER_S = 1.0 / 1000.0
LEAST_COOLING_PER_S = 1.0 / 50_000.0
SURROUNDINGS_K = 10.0  # how far they may be from the log's first temperature
SEGMENT_S = 300.0
SEGMENT_K = 0.5  # what one lump and its sensor are off by over a segment
MEMORY_S = 3600.0  # surroundings so long ago are others
GAP_S = 60.0  # what flowed over a longer gap is not known
HOTTEST_C = 80.0  # no cell is used above


class Sums(NamedTuple):
    """Squares and products of what was seen: of a, k and c in their deviations, and with the rise.

    The deviations are those before the log; the rise is that beyond what was expected then.
    """

    aa: float
    ak: float
    ac: float
    kk: float
    kc: float
    cc: float
    a: float
    k: float
    c: float


class Warming(NamedTuple):
    """What a log has shown so far of how its cell warms.

    ``origin_C`` is the log's first temperature, NaN before; ``moved`` whether another one followed:
    one that never moves was stated, not measured. The rest but ``sums`` is that of the segment
    that has not ended: the rise at its start and now, its losses, the time integral of the rise.
    """

    origin_C: float
    moved: bool
    start_K: float
    now_K: float
    lost_J: float
    kelvin_s: float
    time_s: float
    sums: Sums


class Thermal(NamedTuple):
    """The lump: a, k and c with their covariance, and where its temperature counts from.

    ``heats`` is false where the temperature is taken to stay.
    """

    heats: bool
    origin_C: float
    per_J: float
    per_s: float
    drift_K_per_s: float
    covariance: tuple[float, float, float, float, float, float]


class Warmth(NamedTuple):
    """A lump on its way: its rise, and what one more of a, of k and of c would have made of it."""

    rise_K: float
    by_a: float
    by_k: float
    by_c: float


NOTHING_SEEN = Warming(
    math.nan, False, 0.0, 0.0, 0.0, 0.0, 0.0, Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
)
UNCERTAIN_OF_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
STEADY = Thermal(False, 0.0, 0.0, LEAST_COOLING_PER_S, 0.0, UNCERTAIN_OF_NOTHING)


@inline
def usual_per_J(charge_As: float) -> float:
    """One over the heat capacity of a cell of that capacity [K/J]."""
    return 3600.0 / (HEAT_J_PER_K_AH * charge_As)


@inline
def with_segment(seen: Warming, charge_As: float) -> Sums:
    """The sums with the segment that has not ended."""
    old = seen.sums
    usual = usual_per_J(charge_As)
    # A short segment is as wrong as a whole one: what is wrong of it is the sensor and the lump.
    rise = (seen.now_K - seen.start_K) - (usual * seen.lost_J - COOLING_PER_S * seen.kelvin_s)
    y = rise / SEGMENT_K
    a = SHARE_OF_HEAT * usual * seen.lost_J / SEGMENT_K
    k = -COOLING_PER_S * seen.kelvin_s / SEGMENT_K
    c = COOLING_PER_S * SURROUNDINGS_K * seen.time_s / SEGMENT_K
    # fmt: off
    return Sums(
        old.aa + a * a, old.ak + a * k, old.ac + a * c, old.kk + k * k, old.kc + k * c,
        old.cc + c * c, old.a + a * y, old.k + k * y, old.c + c * y,
    )
    # fmt: on


@inline
def faded(sums: Sums) -> Sums:
    """Sums after another segment: what they show was true of older surroundings."""
    f = math.exp(-SEGMENT_S / MEMORY_S)
    # fmt: off
    return Sums(
        f * sums.aa, f * sums.ak, f * sums.ac, f * sums.kk, f * sums.kc, f * sums.cc,
        f * sums.a, f * sums.k, f * sums.c,
    )
    # fmt: on


@kernel
def observed(
    seen: Warming, charge_As: float, lost_W: float, temperature_C: float, dt_s: float
) -> Warming:
    """One more sample, whose losses lasted for the interval that ends with it.

    Parameters
    ----------
    lost_W : float           current times what the voltage is below the OCV [W]
    temperature_C : float    measured; NaN where none was, and nothing is estimated
    """
    if temperature_C != temperature_C or lost_W != lost_W:
        return seen
    if seen.origin_C != seen.origin_C:
        return Warming(temperature_C, False, 0.0, 0.0, 0.0, 0.0, 0.0, seen.sums)
    rise = temperature_C - seen.origin_C
    moved = seen.moved or rise != 0.0
    if dt_s > GAP_S:
        return Warming(seen.origin_C, moved, rise, rise, 0.0, 0.0, 0.0, seen.sums)
    kelvin_s = seen.kelvin_s + 0.5 * (rise + seen.now_K) * dt_s
    lost_J = seen.lost_J + lost_W * dt_s
    time_s = seen.time_s + dt_s
    now = Warming(seen.origin_C, moved, seen.start_K, rise, lost_J, kelvin_s, time_s, seen.sums)
    if time_s < SEGMENT_S:
        return now
    sums = faded(with_segment(now, charge_As))
    return Warming(seen.origin_C, moved, rise, rise, 0.0, 0.0, 0.0, sums)


@kernel
def thermal_of(seen: Warming, charge_As: float, temperature_C: float, unseen: bool) -> Thermal:
    """The lump as prior and log have it.

    Where no temperature was measured by the prior alone, if ``unseen`` warming is to count, else
    one that stays.
    """
    s = NOTHING_SEEN.sums
    origin = temperature_C
    if seen.moved:
        s = with_segment(seen, charge_As)
        origin = seen.origin_C
    elif not unseen:
        return STEADY
    aa, kk, cc = s.aa + 1.0, s.kk + 1.0, s.cc + 1.0
    # The inverse by cofactors; with the prior's 1 on the diagonal it exists.
    m_aa = kk * cc - s.kc * s.kc
    m_ak = s.kc * s.ac - s.ak * cc
    m_ac = s.ak * s.kc - kk * s.ac
    m_kk = aa * cc - s.ac * s.ac
    m_kc = s.ak * s.ac - aa * s.kc
    m_cc = aa * kk - s.ak * s.ak
    scale = 1.0 / (aa * m_aa + s.ak * m_ak + s.ac * m_ac)
    usual = usual_per_J(charge_As)
    d_a = SHARE_OF_HEAT * usual
    d_k = COOLING_PER_S
    d_c = COOLING_PER_S * SURROUNDINGS_K
    per_J = usual + d_a * scale * (m_aa * s.a + m_ak * s.k + m_ac * s.c)
    per_s = COOLING_PER_S + d_k * scale * (m_ak * s.a + m_kk * s.k + m_kc * s.c)
    drift = d_c * scale * (m_ac * s.a + m_kc * s.k + m_cc * s.c)
    # fmt: off
    covariance = (
        d_a * d_a * scale * m_aa, d_a * d_k * scale * m_ak, d_a * d_c * scale * m_ac,
        d_k * d_k * scale * m_kk, d_k * d_c * scale * m_kc, d_c * d_c * scale * m_cc,
    )
    # fmt: on
    return Thermal(
        True, origin, max(per_J, 0.0), max(per_s, LEAST_COOLING_PER_S), drift, covariance
    )


@inline
def warmed(lump: Thermal, at: Warmth, lost_W: float, dt_s: float) -> Warmth:
    """The lump after an interval of constant losses, exactly."""
    b = math.exp(-lump.per_s * dt_s)
    reach_s = (1.0 - b) / lump.per_s
    rise = b * at.rise_K + reach_s * (lump.per_J * lost_W + lump.drift_K_per_s)
    middle = 0.5 * (at.rise_K + rise)
    return Warmth(
        min(rise, HOTTEST_C - lump.origin_C),
        b * at.by_a + reach_s * lost_W,
        b * at.by_k - reach_s * middle,
        b * at.by_c + reach_s,
    )


@inline
def rise_std_K(lump: Thermal, at: Warmth) -> float:
    """Deviation of the rise since the forecast began [K]."""
    aa, ak, ac, kk, kc, cc = lump.covariance
    variance = at.by_a * (aa * at.by_a + 2.0 * (ak * at.by_k + ac * at.by_c))
    variance += at.by_k * (kk * at.by_k + 2.0 * kc * at.by_c) + at.by_c * (cc * at.by_c)
    return math.sqrt(max(variance, 0.0))


@inline
def warmed_to(
    lump: Thermal, was: Warmth, lost_W: float, dt_s: float, deviations: float
) -> tuple[Warmth, float]:
    """A lump after an interval, and its temperature so many deviations off [degC]."""
    now = warmed(lump, was, max(lost_W, 0.0), dt_s)
    return now, (lump.origin_C + now.rise_K) + deviations * rise_std_K(lump, now)
