"""The SOC of a rested cell through the OCV; the OCV under a rest whose past nobody saw."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.description import BRANCHES
from cellwise.cell.effects import Hysteresis
from cellwise.cell.model import CellModel, branch_table
from cellwise.typing import FloatArray

REST_RATE = 0.01  # below C/100 a cell counts as resting
# Deviation of what no branch of a model knows of an unknown past [V]; what fades within ...
SHORT_REST_V, RELAXED_S = 0.010, 1800.0
EVERY_SOC = np.linspace(0.0, 1.0, 2001)


def rest_ocv(
    model: CellModel,
    time_s: FloatArray,
    voltage_V: FloatArray,
    temperature_C: float,
    load: tuple[FloatArray, FloatArray],
) -> Rested:
    """The OCV under a rest whose past nobody saw, by the branches of the model.

    Parameters
    ----------
    time_s, voltage_V : (n,) float      of the rest, from its first row
    load : (interval_s, current_A)      rows of a use of the cell, (m,) each; there may be none
    """
    cell = model.at_temperature(temperature_C)
    r, tau = (
        np.array([np.median(branch_table(cell, kind, s)) for s in BRANCHES])
        for kind in ("r", "tau")
    )
    usual = usual_load(*load, tau, model.capacity_Ah)
    return rested_ocv(time_s, voltage_V, model.error.white_V, Branches(r, tau), usual)


def soc_of_ocv(
    model: CellModel, voltage_V: float, std_V: float, temperature_C: float
) -> tuple[float, float]:
    """SOC at which the OCV is a given voltage, and its standard deviation.

    On a flat OCV every SOC within ``std_V`` is as good: the mean and the spread of all of them.
    """
    soc = EVERY_SOC
    likely = ln_likelihood_of_ocv(model, soc, voltage_V, std_V, temperature_C)
    weight = np.exp(likely - likely.max())
    weight /= weight.sum()
    mean = float((soc * weight).sum())
    std = math.sqrt(float(((soc - mean) ** 2 * weight).sum()))
    ocv = np.interp(soc, model.soc, model.ocv_at(temperature_C))
    best = float(soc[int(np.argmin(np.abs(ocv - voltage_V)))])
    return (best, std) if abs(best - mean) < std else (mean, std)


def ln_likelihood_of_ocv(
    model: CellModel, soc: FloatArray, voltage_V: float, std_V: float, temperature_C: float
) -> FloatArray:
    """Ln likelihood of every SOC, given the voltage of a rested cell.

    Parameters
    ----------
    soc : (n,) float
    std_V : float       of what remains of the past; the model's own error is added [V]
    """
    table = model.ocv_at(temperature_C)
    gap = np.broadcast_to(np.abs(model.effect_at(Hysteresis, temperature_C).m_V), (1, table.size))
    ocv = np.interp(soc, model.soc, table)
    known = np.hypot(std_V, model.slow_error_V(soc, temperature_C))
    spread = np.hypot(known, np.interp(soc, model.soc, gap[0]))
    # Beyond the table's ends the nearest end is the answer, not an unlikely one.
    target = min(max(voltage_V, float(table[0])), float(table[-1]))
    # A density: where the model claims little, a voltage says little for the SOC, too.
    return np.asarray(-0.5 * ((ocv - target) / spread) ** 2 - np.log(spread))


class Reckoned(NamedTuple):
    """What a past that nobody saw may have been.

    Parameters
    ----------
    cut : float         chance that a rest was cut out of a use like the log's own, or follows it at
                        once; else the cell has rested for hours. Nobody knows: even
    least_rate : float  the load is at least of so much of the capacity [1/h]: a day's use
    usual_rate : float  where a log shows no load at all, its past was a use of hours [1/h]
    shape_V, shape : float      relaxations are no sums of three exponentials: of every reading [V],
                        and of what it still had to go
    apart : float       of the slow load: what each branch has seen differs by so much
    bins : int          readings of a rest, each twice as long after its first row as the one before
    """

    cut: float = 0.5
    least_rate: float = 0.1
    usual_rate: float = 0.33
    shape_V: float = 0.001
    shape: float = 0.2
    apart: float = 1.0
    bins: int = 24


RECKONED = Reckoned()


class Branches(NamedTuple):
    """Resistances [ohm] and time constants [s] of the RC branches, shape (branches,) each."""

    r_ohm: FloatArray
    tau_s: FloatArray


class PastLoad(NamedTuple):
    """A use of the cell: its mean current, and the RMS that each branch sees of it, (branches,)."""

    mean_A: float
    rms_A: FloatArray


class Rested(NamedTuple):
    """The OCV under a rest and its standard deviation; what the rest has still to move [V]."""

    ocv_V: float
    std_V: float
    moves_V: float


def usual_load(
    interval_s: FloatArray, current_A: FloatArray, tau_s: FloatArray, capacity_Ah: float
) -> PastLoad:
    """The load of some rows as branches of these time constants see it; without any a usual one."""
    time = np.cumsum(interval_s)
    charge = np.cumsum(current_A * interval_s)
    whole_s = float(time[-1] - time[0]) if time.size else 0.0
    least = RECKONED.least_rate * capacity_Ah
    if whole_s <= 0.0:
        return PastLoad(0.0, np.full(tau_s.size, RECKONED.usual_rate * capacity_Ah))
    mean = float(charge[-1] - charge[0]) / whole_s
    rms = []
    for tau in tau_s:
        count = int(min(max(whole_s / (2.0 * tau), 1.0), time.size))
        at = np.interp(np.linspace(time[0], time[-1], count + 1), time, charge)
        rms.append(math.sqrt(float(np.mean((np.diff(at) / (whole_s / count)) ** 2))))
    return PastLoad(mean, np.maximum(rms, least))


def rested_ocv(
    time_s: FloatArray, voltage_V: FloatArray, white_V: float, branches: Branches, load: PastLoad
) -> Rested:
    r"""The OCV under a rest, whatever its past was.

    .. math:: v(t) = U - \sum_j V_j e^{-t/\tau_j} + n, \qquad V_j \sim R_j (A + f_j)

    with :math:`A` the past load, around half of the log's own with a deviation of all of it, and
    :math:`f_j` what each branch has seen beside; or, as likely beforehand, a cell that has rested.
    Both are weighed by how likely the readings are under them.

    Parameters
    ----------
    time_s, voltage_V : (n,) float      of the rest, from its first row
    white_V : float                     noise of a reading
    """
    t, v, noise_V = _readings(time_s - time_s[0], voltage_V, white_V)
    noise_V = np.hypot(noise_V, RECKONED.shape * (v - v[-1]))
    tau = np.append(branches.tau_s, RELAXED_S)
    shape = np.exp(-t[:, None] / tau)
    slow_A = float(np.max(load.rms_A[-1:], initial=abs(load.mean_A)))
    r = branches.r_ohm
    held = np.zeros((r.size + 1, r.size + 1))
    held[-1, -1] = SHORT_REST_V**2
    cut = held.copy()
    own = np.maximum(load.rms_A**2 - slow_A**2, (RECKONED.apart * slow_A) ** 2)
    cut[:-1, :-1] = slow_A**2 * np.outer(r, r) + np.diag(own * r * r)
    mean = np.append(0.5 * load.mean_A * r, 0.0)
    found = [
        _level(v, noise_V, shape, np.zeros(r.size + 1), held),
        _level(v, noise_V, shape, mean, cut),
    ]
    ln = np.array([f[2] for f in found]) + np.log([1.0 - RECKONED.cut, RECKONED.cut])
    weight = np.exp(ln - ln.max())
    weight /= weight.sum()
    level = np.array([f[0] for f in found])
    ocv = float(weight @ level)
    std = math.sqrt(float(weight @ (np.array([f[1] for f in found]) + (level - ocv) ** 2)))
    return Rested(ocv, std, ocv - float(v[-1]))


def _readings(
    t: FloatArray, v: FloatArray, white_V: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means of the rest's rows in bins that grow with time; their noise [V]."""
    if t[-1] <= 0.0:
        return t[-1:], v[-1:], np.full(1, math.hypot(white_V, RECKONED.shape_V))
    step = float(np.median(np.diff(t)))
    edges = t[-1] * 0.5 ** np.arange(RECKONED.bins)[::-1]
    place = np.searchsorted(edges[edges > step], t)
    count = np.bincount(place)
    some = count > 0

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(place, values)[some] / count[some])

    return means(t), means(v), np.hypot(white_V / np.sqrt(count[some]), RECKONED.shape_V)


def _level(
    v: FloatArray, noise_V: FloatArray, shape: FloatArray, mean: FloatArray, held: FloatArray
) -> tuple[float, float, float]:
    """Level, its variance, and ln of the readings' likelihood whatever the level."""
    spread = np.diag(noise_V**2) + shape @ held @ shape.T
    inverse = np.linalg.inv(spread)
    away = v + shape @ mean
    weight = inverse.sum(axis=0)
    variance = 1.0 / float(weight.sum())
    level = variance * float(weight @ away)
    left = away - level
    _, ln_det = np.linalg.slogdet(spread)
    return level, variance, -0.5 * (float(left @ inverse @ left) + ln_det - math.log(variance))
