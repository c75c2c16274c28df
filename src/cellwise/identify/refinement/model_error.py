"""How wrong a fitted model is, from its residuals: size, memory, share of the polarisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.cell.model import CellModel, ModelError
from cellwise.typing import BoolArray, FloatArray

# A fit sees its own residuals smaller than a new log will.
OPTIMISM = 1.2
LONGEST_LAG_S = 3600.0
STEP_S = 5.0
PROFILE_POINTS = 51
WINDOW_SOC = 0.02
LEAST_V = 5e-4
LARGEST_SHARE = 0.5
SHARE_BINS = 25  # over SOC, within which rows of more and less polarisation are compared
# A direction with less than this of the rows says nothing of its own.
LEAST_ROWS = 200
SOC_STEP = 0.002
DEEP = 0.3  # a log that moves less of the SOC does not show how its error changes along it
SAME_TEMPERATURE_K = 4.0  # logs this near to each other report one temperature
# What is taken out as the polarisation's may be its square at most up to this share of the whole.
LEAST_REST = 0.1


@dataclass(frozen=True, eq=False)
class ResidualLog:
    """Residual of one log, arrays of shape (n,): measured minus model [V].

    ``drop_V`` is the model's polarisation, positive on discharge; ``temperature_C`` the log's.
    """

    time_s: FloatArray
    soc: FloatArray
    drop_V: FloatArray
    residual_V: FloatArray
    temperature_C: float = 25.0


def polarisation_V(
    model: CellModel, soc: FloatArray, temperature_C: FloatArray, voltage_V: FloatArray
) -> FloatArray:
    """What a simulated voltage lies below the model's OCV, shape (n,) [V]."""
    rows = [np.interp(soc, model.soc, row) for row in model.ocv_V]
    if len(rows) == 1:
        return np.asarray(rows[0] - voltage_V)
    grid = model.temperature_C
    low = np.clip(np.searchsorted(grid, temperature_C) - 1, 0, grid.size - 2)
    way = np.clip((temperature_C - grid[low]) / (grid[low + 1] - grid[low]), 0.0, 1.0)
    each, at = np.array(rows), np.arange(soc.size)
    return np.asarray((1.0 - way) * each[low, at] + way * each[low + 1, at] - voltage_V)


def estimate_model_error(
    logs: Sequence[ResidualLog],
    elsewhere: Sequence[ResidualLog] = (),
    unseen: tuple[float, float] = (0.0, 0.0),
) -> ModelError:
    r"""Voltage error of a model from residuals over whole logs.

    The squared residual is taken as that of two errors that know nothing of each other: one of the
    OCV and of what the model leaves out, by SOC and temperature, and one of the resistances, a
    share of the polarisation, for discharge and charge:

    .. math:: r^2 = \left(f(T)\, e(s)\right)^2 + \left(\kappa_\pm\, v_p\right)^2

    Parameters
    ----------
    logs : sequence of ResidualLog
    elsewhere : sequence of ResidualLog    tests of another kind, which count at a SOC where none
                                           of ``logs`` has been
    unseen : (discharge, charge)           shares of the polarisation, what no log can show

    Returns
    -------
    ModelError        ``slow_V`` over SOC, without what follows the polarisation
    """
    usable = [log for log in logs if log.residual_V.size >= 20]
    if not usable:
        return ModelError()
    weights = np.array([float(log.time_s[-1] - log.time_s[0]) + 1.0 for log in usable])
    white = [_step_noise(log.residual_V) for log in usable]
    discharge = _share(usable, 1.0)
    charge = _share(usable, -1.0)
    if discharge is None:
        discharge = 0.0 if charge is None else charge
    charge = discharge if charge is None else max(charge, discharge)
    rest = [_without_share(log, discharge, charge) for log in usable]
    others = [log for log in elsewhere if log.residual_V.size >= 20]
    slow = _profile(usable, rest, others)
    grid, factor = _over_temperature(usable, rest, slow)
    memory = [correlation_time(log.time_s, _clip(log.residual_V)) for log in usable]
    return ModelError(
        white_V=max(float(np.average(white, weights=weights)), 1e-4),
        slow_V=tuple(float(v) for v in slow),
        correlation_s=float(np.clip(np.average(memory, weights=weights), 10.0, LONGEST_LAG_S)),
        resistance_share=discharge,
        charge_share=charge,
        temperature_C=grid,
        temperature_factor=factor,
        correlation_soc=_correlation_soc(usable, slow),
        unseen_share=unseen[0],
        unseen_charge_share=unseen[1],
    )


def _without_share(log: ResidualLog, discharge: float, charge: float) -> FloatArray:
    """Squared residual without the share of the polarisation; negative where that was less."""
    share = np.where(log.drop_V >= 0.0, discharge, charge)
    return np.asarray(_clip(log.residual_V) ** 2 - (share * log.drop_V) ** 2)


def _profile(
    logs: Sequence[ResidualLog], rest: Sequence[FloatArray], others: Sequence[ResidualLog] = ()
) -> FloatArray:
    """Root mean square residual over SOC, what follows the current taken out, Gaussian window.

    Where no log has been, the error of the nearest SOC that one has, twice as large at the far
    end of the gap; or what ``others`` show there, if that is more.
    """
    grid = np.linspace(0.0, 1.0, PROFILE_POINTS)
    square = np.zeros(grid.size)
    whole = np.zeros(grid.size)
    count = np.zeros(grid.size)
    for log, left in zip(logs, rest, strict=True):
        window = np.exp(-0.5 * ((grid[:, None] - log.soc[None, :]) / WINDOW_SOC) ** 2)
        share = 1.0 / log.residual_V.size
        square += share * (window @ left)
        whole += share * (window @ _clip(log.residual_V) ** 2)
        count += share * window.sum(axis=1)
    seen = count > 1e-3 * count.max()
    level = np.sqrt(np.maximum(square, LEAST_REST * whole)[seen] / count[seen])
    away = np.abs(grid[:, None] - grid[seen][None, :]).min(axis=1)
    profile = OPTIMISM * np.interp(grid, grid[seen], level) * (1.0 + away)
    if others and not seen.all():
        apart = _profile(others, [_clip(log.residual_V) ** 2 for log in others])
        profile = np.where(seen, profile, np.maximum(profile, apart))
    return np.asarray(np.maximum(profile, LEAST_V))


def _over_temperature(
    logs: Sequence[ResidualLog], rest: Sequence[FloatArray], slow_V: FloatArray
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Temperatures, and what the profile has to be multiplied by there.

    Every log counts alike, and each temperature begins with one log that has the profile's own
    error: a single log does not make an error vanish.
    """
    groups = _by_temperature(logs)
    if len(groups) < 2:
        return (), ()
    left = dict(zip(map(id, logs), rest, strict=True))
    grid = np.linspace(0.0, 1.0, slow_V.size)
    found = []
    for group in groups:
        own = [OPTIMISM**2 * float(np.mean(left[id(log)])) for log in group]
        usual = [float(np.mean(np.interp(log.soc, grid, slow_V) ** 2)) for log in group]
        one = sum(usual) / len(usual)
        ratio = (sum(own) + one) / (sum(usual) + one)
        found.append(math.sqrt(max(ratio, LEAST_REST)))
    return tuple(float(np.mean([log.temperature_C for log in g])) for g in groups), tuple(found)


def _by_temperature(logs: Sequence[ResidualLog]) -> list[list[ResidualLog]]:
    """Logs of one temperature together, coldest first."""
    groups: list[list[ResidualLog]] = []
    for log in sorted(logs, key=lambda one: one.temperature_C):
        if groups and log.temperature_C - groups[-1][0].temperature_C < SAME_TEMPERATURE_K:
            groups[-1].append(log)
        else:
            groups.append([log])
    return groups


def _correlation_soc(logs: Sequence[ResidualLog], slow_V: FloatArray) -> float | None:
    """How far along the SOC the error remembers itself; None where fewer than two logs show it.

    Half the area under the two-sided autocorrelation over SOC up to its first zero, mean left in,
    residuals over the profile's own error. The fit has taken out what its logs have in common at
    each temperature: of n logs a residual keeps 1 - 1/n of a variance that a new log has 1 + 1/n
    of, and it is the long part that goes.
    """
    grid = np.linspace(0.0, 1.0, slow_V.size)
    found = []
    for log in logs:
        if float(np.ptp(log.soc)) < DEEP:
            continue
        relative = _clip(log.residual_V) / np.interp(log.soc, grid, slow_V)
        place = ((log.soc - log.soc.min()) / SOC_STEP).astype(int)
        count = np.bincount(place)
        mean = np.bincount(place, relative)[count > 0] / count[count > 0]
        found.append(SOC_STEP * _memory(mean))
    if len(found) < 2:
        return None
    each = max(len(found) / len(_by_temperature(logs)), 2.0)
    whole = (each + 1.0) / (each - 1.0)
    return float(min(whole * float(np.mean(found)), 1.0))


def _step_noise(residual_V: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(np.diff(residual_V)))) / float(np.sqrt(2.0))


def correlation_time(time_s: FloatArray, residual_V: FloatArray) -> float:
    """Time over which a residual remembers itself [s].

    Half the area under the two-sided autocorrelation up to its first zero, after the residual was
    put on an even grid.
    """
    span = float(time_s[-1] - time_s[0])
    step = max(STEP_S, span / 20_000.0)
    if span < 10 * step:
        return STEP_S
    grid = np.arange(time_s[0], time_s[-1], step)
    # Without its mean a residual would seem to forget what it keeps all along: the mean stays in.
    r = np.interp(grid, time_s, residual_V)
    return float(step * _memory(r, int(LONGEST_LAG_S / step)))


def _memory(r: FloatArray, longest: int = 1 << 30) -> float:
    """Half the area under the autocorrelation up to its first zero, in steps of an even grid."""
    n = r.size
    power = float(r @ r)
    if power == 0.0:
        return 1.0
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(r, size)
    correlation = np.fft.irfft(spectrum * np.conj(spectrum), size)[:n] / power
    correlation = correlation[: max(2, min(n // 2, longest))]
    below = np.flatnonzero(correlation <= 0.0)
    end = int(below[0]) if below.size else correlation.size
    return float(0.5 + np.sum(correlation[1:end]))


def _share(logs: Sequence[ResidualLog], sign: float) -> float | None:
    """Growth of the residual with the polarisation of one sign, as a share; None: no such rows.

    Rows are compared with rows of the same log and SOC: towards empty the polarisation grows, and
    so does what a SOC scale that is off does to a steep OCV. A squared residual scatters as its
    mean, so each log and SOC weighs by one over its square.
    """
    above, below = 0.0, 0.0
    for log in logs:
        loaded = sign * log.drop_V > 0.0
        if loaded.sum() < min(LEAST_ROWS, 0.1 * loaded.size):
            continue
        rows: BoolArray = np.asarray(sign * log.drop_V >= 0.0)  # with those at rest
        square = _clip(log.residual_V)[rows] ** 2
        drop = log.drop_V[rows] ** 2
        place = np.clip((log.soc[rows] * SHARE_BINS).astype(int), 0, SHARE_BINS - 1)
        count = np.maximum(np.bincount(place, minlength=SHARE_BINS), 1)
        usual = np.bincount(place, square, SHARE_BINS) / count
        moved = drop - (np.bincount(place, drop, SHARE_BINS) / count)[place]
        weight = 1.0 / (usual + LEAST_V**2)[place] ** 2 / log.residual_V.size
        above += float(np.sum(weight * moved * square))
        below += float(np.sum(weight * moved * moved))
    if below <= 0.0:
        return None
    return float(np.clip(np.sqrt(max(above / below, 0.0)), 0.0, LARGEST_SHARE))


def _clip(residual_V: FloatArray) -> FloatArray:
    """Residual with its few wildest values held: they are the gate's business, not the noise's."""
    limit = 6.0 * 1.4826 * float(np.median(np.abs(residual_V))) + 1e-9
    return np.clip(residual_V, -limit, limit)
