"""ModelError: by how much a model's voltage may be off, on every time scale."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.typing import FloatArray

# Memories of the processes that make up an error [s]: running means over 1, 10, 100 and 1000 s
# part them, so a process holds most of the band that begins with its own memory.
SCALES_S = (0.1, 1.0, 10.0, 100.0, 1000.0)
WHITE_BELOW_S = 0.5  # what is forgotten this soon is white at the rates at which cells are logged
TYPICAL_DROP_V = 0.1  # a polarisation at which shares are weighed against what has none

Table = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ModelError:
    """Voltage error of a model as a sum of first-order processes, one for each time scale.

    Parameters
    ----------
    scales_s : (scales,) float         memory of each process, ascending [s]
    std_V : (scales, temperatures, points) float
                                       standard deviation, points over an even SOC grid [V]
    temperature_C : (temperatures,) float      ascending; empty with a single row for all
    share : (scales,) float            beside it, in squares: a share of the polarisation, on
                                       discharge
    charge_share : (scales,) float or None     the same on charge (None: as on discharge)
    persistent_share : float           of the slowest processes' variance, what comes back at the
                                       same SOC in the next log
    correlation_soc : float or None    moving on by as much SOC makes the slow part another one
    unseen_share, unseen_charge_share : float
                                       share of the polarisation of loads, and of charges, that
                                       last, which no test could show (None: as on discharge)
    activation_std_K : float or None   by how much the activation of the resistances may be off
                                       beyond the data's temperatures

    Raises
    ------
    InputError        sizes that are not finite or negative, tables that do not fit together
    """

    scales_s: tuple[float, ...] = (0.1, 300.0)
    std_V: tuple[Table, ...] = (((0.002,),), ((0.010,),))
    temperature_C: tuple[float, ...] = ()
    share: tuple[float, ...] = (0.0, 0.05)
    charge_share: tuple[float, ...] | None = None
    persistent_share: float = 1.0
    correlation_soc: float | None = None
    unseen_share: float = 0.0
    unseen_charge_share: float | None = None
    activation_std_K: float | None = None

    def __post_init__(self) -> None:
        _check(self)

    @classmethod
    def of_white_and_slow(
        cls,
        white_V: float = 0.002,
        slow_V: tuple[float, ...] | float = 0.010,
        correlation_s: float = 300.0,
        resistance_share: float = 0.05,
        *,
        persistent_share: float = 1.0,
        unseen_share: float = 0.0,
        unseen_charge_share: float | None = None,
    ) -> ModelError:
        """White noise and one slow process over SOC, with the share of the polarisation in it."""
        slow = (float(slow_V),) if isinstance(slow_V, int | float) else tuple(slow_V)
        return cls(
            scales_s=(min(WHITE_BELOW_S / 5.0, 0.5 * correlation_s), correlation_s),
            std_V=(((white_V,) * len(slow),), (slow,)),
            share=(0.0, resistance_share),
            persistent_share=persistent_share,
            unseen_share=unseen_share,
            unseen_charge_share=unseen_charge_share,
        )

    def variance_V2(
        self, scale: int, soc: FloatArray | float, temperature_C: float | None = None
    ) -> FloatArray:
        """Variance of one process at the given SOC [V^2], linear in its deviation between points.

        Without a temperature, the mean of squares over all.
        """
        rows = np.asarray(self.std_V[scale])
        grid = np.linspace(0.0, 1.0, rows.shape[1])
        if not self.temperature_C:
            return np.asarray(np.interp(soc, grid, rows[0]) ** 2)
        if temperature_C is None:
            return np.asarray(np.mean([np.interp(soc, grid, row) ** 2 for row in rows], axis=0))
        at = [float(np.interp(temperature_C, self.temperature_C, column)) for column in rows.T]
        return np.asarray(np.interp(soc, grid, at) ** 2)

    def at(self, soc: FloatArray | float, temperature_C: float | None = None) -> FloatArray:
        """Deviation of all that is slower than a row at the given SOC [V]."""
        parts = [self.variance_V2(k, soc, temperature_C) for k in self._slow]
        return np.asarray(np.sqrt(np.sum(parts, axis=0)))

    def shown_share(self, polarisation_V: float = 1.0) -> float:
        """Share of a polarisation that the tests showed to be wrong: discharge, or charge."""
        return math.hypot(*self.shares(polarisation_V))

    def hidden_share(self, polarisation_V: float = 1.0) -> float:
        """The share that no test could show: of loads, or charges, that last."""
        if polarisation_V >= 0.0 or self.unseen_charge_share is None:
            return self.unseen_share
        return self.unseen_charge_share

    def whole_share(self, polarisation_V: float = 1.0) -> float:
        """Both together."""
        return math.hypot(self.shown_share(polarisation_V), self.hidden_share(polarisation_V))

    def shares(self, polarisation_V: float = 1.0) -> tuple[float, ...]:
        """The shown share by time scale, on discharge or charge."""
        return (
            self.share if polarisation_V >= 0.0 or self.charge_share is None else self.charge_share
        )

    @property
    def white_V(self) -> float:
        """Deviation of what changes from row to row, mean over SOC and temperature [V]."""
        white = [k for k in range(len(self.scales_s)) if k not in self._slow]
        return math.sqrt(sum(self._mean_V2(k) for k in white))

    @property
    def weights(self) -> tuple[float, ...]:
        """Share of each process in the variance of all of them, under a usual load.

        Mean of the shares over SOC and temperature: near empty an error is many times as large,
        and would say of every other SOC how long it lasts.
        """
        drop2 = (np.array(self.share) * TYPICAL_DROP_V) ** 2
        parts = np.array(self.std_V) ** 2 + drop2[:, None, None]
        whole = parts.sum(axis=0)
        shares = np.where(whole > 0.0, parts / np.where(whole > 0.0, whole, 1.0), 1.0 / len(parts))
        return tuple(float(v) for v in shares.mean(axis=(1, 2)))

    @property
    def correlation_s(self) -> float:
        """Integral time scale of all processes together [s]."""
        return sum(w * s for w, s in zip(self.weights, self.scales_s, strict=True))

    @property
    def lasting_share(self) -> float:
        """Of the variance of all that is slower than a row, what comes back at the same SOC."""
        slow = sum(self.weights[k] for k in self._slow)
        return self.persistent_share * (self.weights[-1] / slow if slow > 0.0 else 1.0)

    def with_slow(self, std_V: FloatArray, share: float) -> ModelError:
        """With as much more in the slowest process: over an even SOC grid [V], and a share.

        It comes back at the same SOC in every log.
        """
        points = max(len(std_V), len(self.std_V[-1][0]))
        grid = np.linspace(0.0, 1.0, points)

        def wide(row: tuple[float, ...]) -> FloatArray:
            return np.interp(grid, np.linspace(0.0, 1.0, len(row)), row)

        tables = np.array([[wide(row) for row in table] for table in self.std_V])
        before, more = float(np.mean(tables[-1] ** 2)), float(np.mean(wide(tuple(std_V)) ** 2))
        tables[-1] = np.hypot(tables[-1], wide(tuple(std_V)))
        comes_back = self.persistent_share * before + more
        persistent = comes_back / (before + more) if more > 0.0 else self.persistent_share
        own, charge = self.shares(), self.shares(-1.0)
        return replace(
            self,
            std_V=_tuples(tables.tolist()),
            share=(*own[:-1], math.hypot(own[-1], share)),
            charge_share=(*charge[:-1], math.hypot(charge[-1], share)),
            persistent_share=persistent,
        )

    def moved(self, after_s: float, seen_s: float) -> ModelError:
        """What is new of the error ``after_s`` a mean over ``seen_s`` of it is taken off.

        What no test could show, of loads that last, is as slow as the slowest process.
        """
        part = moved_part(np.array(self.scales_s), after_s, seen_s)
        charge = self.unseen_charge_share
        return replace(
            self,
            std_V=_tuples((part[:, None, None] * np.array(self.std_V)).tolist()),
            share=tuple((part * self.shares()).tolist()),
            charge_share=tuple((part * self.shares(-1.0)).tolist()),
            unseen_share=float(part[-1] * self.unseen_share),
            unseen_charge_share=None if charge is None else float(part[-1] * charge),
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON values: the fields, and the SOC grid that ``std_V`` is over."""
        soc = np.linspace(0.0, 1.0, len(self.std_V[0][0]))
        return {**asdict(self), "soc": [round(float(s), 6) for s in soc]}

    @property
    def _slow(self) -> tuple[int, ...]:
        slow = [k for k, s in enumerate(self.scales_s) if s >= WHITE_BELOW_S]
        return tuple(slow) or (len(self.scales_s) - 1,)

    def _mean_V2(self, scale: int) -> float:
        return float(np.mean(np.square(self.std_V[scale])))


def moved_part(memory_s: FloatArray, after_s: float, seen_s: float) -> FloatArray:
    r"""How much of the deviation of first-order processes stays once a mean is taken off.

    The mean is over ``seen_s``, the process ``after_s`` later; of its variance that leaves

    .. math:: 1 + \frac{2}{b^2} \left(b - 1 + e^{-b}\right)
       - \frac{2}{b}\, e^{-h / \tau} \left(1 - e^{-b}\right), \qquad b = s / \tau

    with h and s for the two times: little of a slow one, more than all of a quick one.
    """
    tau = np.maximum(memory_s, 1e-3)
    b = seen_s / tau
    fallen = -np.expm1(-b)
    left = 1.0 + 2.0 * (b - fallen) / b**2 - 2.0 * np.exp(-after_s / tau) * fallen / b
    return np.asarray(np.sqrt(np.maximum(left, 0.0)))


def with_temperature(error: ModelError, temperature_C: float, times: float) -> ModelError:
    """The error with a row at one more temperature: so many times what it stated there."""
    known = error.temperature_C
    rows = []
    for table in error.std_V:
        columns = np.asarray(table).T
        here = [np.interp(temperature_C, known, c) if known else c[0] for c in columns]
        rows.append(tuple(times * float(v) for v in here))
    at = [k for k, t in enumerate(known) if t != temperature_C]
    order = sorted([*((known[k], k) for k in at), (temperature_C, -1)])
    return replace(
        error,
        temperature_C=tuple(t for t, _ in order),
        std_V=tuple(
            tuple(row if k < 0 else table[k] for _, k in order)
            for table, row in zip(error.std_V, rows, strict=True)
        ),
    )


def in_bands(
    time_s: FloatArray, values: FloatArray, scales_s: tuple[float, ...] = SCALES_S
) -> FloatArray:
    """Values parted by time scale, shape (scales, n): their sum over the scales is ``values``.

    What running means over the scales but the first leave, each a mean over time.
    """
    integral = np.concatenate(
        ([0.0], np.cumsum(0.5 * np.diff(time_s) * (values[1:] + values[:-1])))
    )
    before, bands = values, []
    for width in scales_s[1:]:
        low = np.maximum(time_s - 0.5 * width, time_s[0])
        high = np.minimum(time_s + 0.5 * width, time_s[-1])
        moved = np.interp(high, time_s, integral) - np.interp(low, time_s, integral)
        mean = np.where(high > low, moved / np.maximum(high - low, 1e-12), values)
        bands.append(before - mean)
        before = mean
    return np.array([*bands, before])


def _tuples(values: Any) -> Any:
    return tuple(_tuples(v) for v in values) if isinstance(values, list) else values


def _check(error: ModelError) -> None:
    shapes = {(len(table), len(row)) for table in error.std_V for row in table}
    scales = len(error.scales_s)
    if (
        scales == 0
        or len(error.std_V) != scales
        or len(error.share) != scales
        or len(shapes) != 1
        or 0 in next(iter(shapes))
        or len(error.std_V[0]) != max(len(error.temperature_C), 1)
        or (error.charge_share is not None and len(error.charge_share) != scales)
    ):
        raise InputError(
            f"a model error with {scales} scales and tables of shape {sorted(shapes)} over "
            f"temperatures {error.temperature_C}",
            "a table and a share for each scale, a row for each temperature, SOC points alike",
            "Check the validation that gave it.",
        )
    sizes = np.concatenate(
        [
            np.ravel(error.std_V),
            error.shares(),
            error.shares(-1.0),
            [error.hidden_share(), error.hidden_share(-1.0), error.persistent_share],
            [error.correlation_soc or 0.0, error.activation_std_K or 0.0],
        ]
    )
    if not np.all(np.isfinite(sizes)) or np.any(sizes < 0) or error.persistent_share > 1:
        raise InputError(
            f"a model error of {error}",
            "finite values of at least 0",
            "Check the validation that gave it.",
        )
    for name in ("scales_s", "temperature_C"):
        grid = np.array(getattr(error, name))
        if not np.all(np.isfinite(grid)) or np.any(np.diff(grid) <= 0):
            raise InputError(
                f"a model error over {name} {grid.tolist()}",
                "finite values that rise",
                "Sort them.",
            )
    if error.scales_s[0] < 0:
        raise InputError(
            f"a model error over scales of {error.scales_s} s", "no negative time", "Correct it."
        )
