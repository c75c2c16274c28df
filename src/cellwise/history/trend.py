"""A share of capacity over a life: a smooth curve with its band, and where it bends."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from cellwise.typing import FloatArray


class Fade(NamedTuple):
    """What is known of a fade before any log.

    ``std`` over the logs: cells are used to four fifths. Half of its variance goes with time, half
    with its root, as films grow (10.1149/1.1393224). ``bends``: how much it may bend (of an
    integrated Wiener process); ``scatters`` from log to log beyond the stated deviations
    (interrupted charges, temperature, rest before). ``windows_alike``: share of the variance of
    windows of one kind that is alike for ``alike_over`` of the life, since what they cannot see
    ages in its own way. ``start_std``: of a
    share that is counted (sensors, the last rows, what temperature does).
    """

    std: float = 0.2
    bends: tuple[float, ...] = (0.0, 0.01, 0.03, 0.1, 0.3)
    scatters: tuple[float, ...] = (0.0, 0.003, 0.006, 0.012)
    windows_alike: float = 0.95
    alike_over: float = 0.5
    start_std: float = 0.002


class Knee(NamedTuple):
    """A bend is said with very strong evidence (Kass and Raftery 1995), and of so many logs."""

    bic: float = 10.0
    fewest_logs: int = 8


FADE, KNEE = Fade(), Knee()


class Deviations(NamedTuple):
    """Deviations of the shares, shape (n,) each.

    ``own`` is a log's own; ``alike`` what windows are wrong by alike, over half of the life: what a
    wide one does not see, a narrower one does not see either, and that much two have in common;
    ``level`` what a reference is wrong by for all that are compared with it.
    """

    own: FloatArray
    alike: FloatArray
    level: FloatArray

    @property
    def whole(self) -> FloatArray:
        """All three together."""
        return np.asarray(np.sqrt(self.own**2 + self.alike**2 + self.level**2))


@dataclass(frozen=True, eq=False)
class Trend:
    """Share of the new cell's capacity, shape (n,), its deviation, and the knee (None: no bend).

    ``std`` holds the scatter from log to log, too: what the next test would show.
    """

    share: FloatArray
    std: FloatArray
    knee: int | None


def trend_of(
    way: FloatArray,
    share: FloatArray,
    std: Deviations,
    start_std: float = FADE.start_std,
) -> Trend:
    """The trend of measured shares.

    Parameters
    ----------
    way : (n,) float          age, never decreasing: days, throughput or number
    share : (n,) float        measured shares of the new cell's capacity
    std : Deviations
    start_std : float         how far from one the life may have begun

    Notes
    -----
    A Gaussian process that begins near one: a line, a root and an integrated Wiener process. The
    bend's size and the scatter from log to log are averaged over by their marginal likelihood; the
    deviations as stated.
    """
    u = _part_of_life(way)
    stated = _stated(u, std)
    eye = np.eye(u.size)
    likely, means, variances = [], [], []
    for bend, scatter in product(FADE.bends, FADE.scatters):
        kernel, noise = start_std**2 + _kernel(u, bend), stated + scatter**2 * eye
        likely.append(_likelihood(kernel + noise, share - 1.0))
        gain = np.linalg.solve(kernel + noise, kernel).T
        means.append(1.0 + gain @ (share - 1.0))
        left = np.diag(kernel) - np.einsum("ij,ji->i", gain, kernel)
        variances.append(np.maximum(left, 0.0) + scatter**2)
    weight = np.exp(np.array(likely) - max(likely))
    weight /= weight.sum()
    mean = np.asarray(weight @ np.array(means))
    off = np.array(means) - mean
    deviation = np.sqrt(weight @ (np.array(variances) + off**2))
    return Trend(mean, deviation, _knee(u, share, std.whole))


class Change(NamedTuple):
    """How much a share changes from the first log to the last by the logs alone, and its deviation.

    ``level``, ``level_std``: of the share, if it did not change.
    """

    share: float
    std: float
    level: float
    level_std: float

    @property
    def shown(self) -> bool:
        """Whether the change is beyond two deviations: less is no evidence of one."""
        return abs(self.share) > 2.0 * self.std


def change_of(way: FloatArray, share: FloatArray, std: Deviations, start_std: float) -> Change:
    """What logs say of a change when nothing is taken for granted about the fade between them.

    A line by generalised least squares, its deviation widened where the logs scatter by more than
    they state; the level of a cell that may have faded before its first log, with what a change
    that the logs cannot show would move it by until the last.

    Parameters
    ----------
    As of `trend_of`.
    """
    u = _part_of_life(way)
    line = np.stack([np.ones_like(u), u], axis=1)
    change, change_std = 0.0, FADE.std
    if u[-1] > 0.0:
        fit = np.linalg.inv(line.T @ np.linalg.solve(covariance := _stated(u, std), line))
        x = fit @ line.T @ np.linalg.solve(covariance, share)
        left = share - line @ x
        size = float(left @ np.linalg.solve(covariance, left)) / max(u.size - 2, 1)
        change, change_std = float(x[1]), float(np.sqrt(max(size, 1.0) * fit[1, 1]))
    alike = np.linalg.inv(_stated(np.zeros_like(u), std)).sum(axis=1)
    before = 1.0 / (start_std**2 + FADE.std**2)
    known = before + float(alike.sum())
    level = (before + float(alike @ share)) / known
    unseen = 0.5 / np.hypot(1.0 / change_std, 1.0 / FADE.std)
    return Change(change, change_std, level, float(np.hypot(known**-0.5, unseen)))


def _part_of_life(way: FloatArray) -> FloatArray:
    u = way - way[0]
    return np.asarray(u / max(float(u[-1]), 1e-12))


def _stated(u: FloatArray, std: Deviations) -> FloatArray:
    """Covariance of the shares as their logs state it, (n, n)."""
    near = np.exp(-np.abs(u[:, None] - u[None, :]) / FADE.alike_over)
    common = np.minimum(std.alike[:, None], std.alike[None, :]) ** 2
    own = np.diag(std.own**2 + 1e-8)
    return np.asarray(own + common * near + np.outer(std.level, std.level))


def _kernel(u: FloatArray, bend: float) -> FloatArray:
    low, high = np.minimum(u[:, None], u[None, :]), np.maximum(u[:, None], u[None, :])
    wiener = low**2 * (3.0 * high - low) / 6.0
    root = np.sqrt(u)
    fade = 0.5 * FADE.std**2 * (np.outer(u, u) + np.outer(root, root))
    return np.asarray(fade + 3.0 * bend**2 * wiener)


def _likelihood(covariance: FloatArray, left: FloatArray) -> float:
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, left)
    return float(-0.5 * white @ white - np.log(np.diag(root)).sum())


def _knee(u: FloatArray, share: FloatArray, std: FloatArray) -> int | None:
    """Number of the log from which the fade is faster; None where one line is as good."""
    if u.size < KNEE.fewest_logs:
        return None
    line = _line_cost(u, share, std, None)[0]
    best, knee = np.inf, None
    for k in range(3, u.size - 3):
        cost, slopes = _line_cost(u, share, std, float(u[k]))
        if cost < best and slopes[1] < 0.0 and slopes[0] > slopes[0] + slopes[1]:
            best, knee = cost, k
    size = max(best / max(u.size - 4, 1), 1.0)  # scatter beyond the stated deviations
    gain = (line - best) / size - 2.0 * np.log(u.size)
    return knee if gain > KNEE.bic else None


def _line_cost(
    u: FloatArray, share: FloatArray, std: FloatArray, bend: float | None
) -> tuple[float, FloatArray]:
    """Weighted squares of one line, or of a line that bends, and its slopes."""
    columns = [np.ones_like(u), u]
    if bend is not None:
        columns.append(np.maximum(u - bend, 0.0))
    matrix = np.stack(columns, axis=1) / std[:, None]
    x = np.asarray(np.linalg.lstsq(matrix, share / std, rcond=None)[0], dtype=np.float64)
    return float(np.sum((share / std - matrix @ x) ** 2)), x[1:]
