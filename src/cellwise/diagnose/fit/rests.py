"""What rests say: of the SOC, a referee for claims on charge, and of a current sensor's offset.

After a discharge the voltage of a resting cell rises towards the OCV and never beyond it, after a
charge it falls. A relaxation is a sum of decaying exponentials, so its logarithm is convex: what is
left at the end is at least what a single exponential through three equidistant points leaves
(Aitken). It is taken to be no more than what the rest has already moved, beside that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cellwise.cell.initial_soc.rest import REST_RATE
from cellwise.cell.plausibility.validity_kernels import ENTROPY_V_PER_K
from cellwise.cell.point_kernels import OCV, M
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.logs.cell_log import CellLog
from cellwise.logs.gaps import run_edges
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from cellwise.diagnose.fit.rows import LogRows


class OcvKnown(NamedTuple):
    """How well a model knows its OCV: a share of its own slow error, at least so much [V]."""

    share: float = 0.5
    least_V: float = 0.0015


class RestRules(NamedTuple):
    """How rests are read.

    ``shortest_s``: of a rest; ``reading``: share of it over which a reading is the mean;
    ``same_soc``: rests at SOCs closer than this read the same error of the OCV and count as one.
    Of the current, in units of 1C: at rest it is smaller than ``small_C``, scatters less than
    ``quiet_C`` and shows a sensor's offset to ``std_C``; within ``zero_stds`` of these it reads
    nothing. A load that never switches off may look like a rest, so that a reading other than zero
    never outweighs the voltage by more than ``most_nats``.
    """

    shortest_s: float = 120.0
    reading: float = 0.05
    same_soc: float = 0.05
    small_C: float = 0.06
    quiet_C: float = 0.02
    std_C: float = 0.001
    zero_stds: float = 3.0
    most_nats: float = 12.0


OCV_KNOWN, RULES = OcvKnown(), RestRules()


@dataclass(frozen=True)
class RestReading:
    """Mean reading at rest [A] and its standard deviation; None if the log never rests."""

    mean_A: float | None
    std_A: float

    @property
    def zero(self) -> bool:
        """Whether the sensor reads nothing where nothing flows: then it has no offset."""
        return self.mean_A is not None and abs(self.mean_A) < RULES.zero_stds * self.std_A

    def ln_likelihood(self, z: Mapping[str, float]) -> float:
        """Ln likelihood of a sensor offset; never below that where the reading may be a load."""
        if self.mean_A is None:
            return 0.0
        away = (z.get("offset_A", 0.0) - self.mean_A) / self.std_A
        square = 0.5 * away * away
        return -(square if self.zero else min(square, RULES.most_nats))


NO_READING = RestReading(None, 1.0)


def rest_reading(logs: Sequence[CellLog], capacity_Ah: float) -> RestReading:
    """Mean reading over all rests of the logs that agree with each other, or that read nothing."""
    means = []
    for log in logs:
        current = log.current_A
        small = np.isfinite(current) & (np.abs(current) < RULES.small_C * capacity_Ah)
        for first, last in zip(*run_edges(small), strict=True):
            if log.time_s[last] - log.time_s[first] >= RULES.shortest_s:
                part = current[first : last + 1]
                if float(np.std(part)) < RULES.quiet_C * capacity_Ah:
                    means.append(float(np.median(part)))
    std = RULES.std_C * capacity_Ah
    nothing = [m for m in means if abs(m) < RULES.zero_stds * std]
    if nothing:
        # Small loads read what they are; a sensor with an offset reads nothing nowhere.
        return RestReading(float(np.median(nothing)), std)
    if not means or float(np.std(means)) > 4.0 * std:
        return RestReading(None, std)
    return RestReading(float(np.median(means)), std)


@dataclass(frozen=True)
class FittedRest:
    """The end of one rest: charge and time since the log's start, and where the OCV must be.

    ``direction`` is 1 after a discharge (OCV at or above ``voltage_V``) and -1 after a charge;
    ``left_V`` is by how much it may be further that way.
    """

    log: int
    charge_Ah: float
    hours: float
    temperature_C: float
    voltage_V: float
    left_V: float
    direction: int

    def soc(self, start: float, z: Mapping[str, float], capacity_Ah: float) -> float:
        """SOC that a point in the coordinates claims here.

        ``start`` is the log's stated one, ``capacity_Ah`` what the cell holds at that point.
        """
        gain = math.exp(z.get("ln_gain", 0.0))
        used = (self.charge_Ah - z.get("offset_A", 0.0) * self.hours) / gain
        used += z.get("leak_A", 0.0) * self.hours
        return start + z.get(f"soc0:{self.log}", 0.0) - used / capacity_Ah


@dataclass(frozen=True, eq=False)
class RestVoltages:
    """All rests of a diagnosis."""

    rests: tuple[FittedRest, ...]
    starts: tuple[float, ...]

    def ln_likelihood(self, coordinates: Coordinates, z: Mapping[str, float]) -> float:
        """Ln likelihood of a point; rests at the same SOC count as one.

        Up to a constant: what widens the OCV (a hysteresis) makes every reading less likely.
        """
        if not self.rests:
            return 0.0
        soc, ocv, std = self._claimed(coordinates, z)
        _, _, least = self._claimed(coordinates, {}, soc)
        terms = 0.5 * self._away(z, ocv, std) ** 2 + np.log(std / least)
        bins = np.round(soc / RULES.same_soc)
        return -float(np.sum(terms / np.sum(bins[:, None] == bins, axis=1)))

    def contradiction(self, coordinates: Coordinates, z: Mapping[str, float]) -> str:
        """The rest that speaks loudest against a point, for people."""
        if not self.rests:
            return ""
        soc, ocv, std = self._claimed(coordinates, z)
        k = int(np.argmax(np.abs(self._away(z, ocv, std))))
        rest = self.rests[k]
        side = "at least" if rest.direction > 0 else "at most"
        return (
            f"a rest {rest.hours:.2g} h into log {rest.log + 1} puts the OCV at {side} "
            f"{rest.voltage_V:.3f} V; at the {100 * soc[k]:.1f} % SOC of this claim it is "
            f"{ocv[k]:.3f} V"
        )

    def _away(self, z: Mapping[str, float], ocv_V: FloatArray, std_V: FloatArray) -> FloatArray:
        """Standard deviations between the OCV of each and where the rest puts it."""
        offset = np.array([z.get(f"offset_V:{r.log}", 0.0) for r in self.rests])
        offset += z.get("offset_V", 0.0)
        read, left, side = np.array([(r.voltage_V, r.left_V, r.direction) for r in self.rests]).T
        beyond = side * (ocv_V + offset - read)
        return np.asarray(beyond / np.where(beyond > 0.0, np.hypot(std_V, left), std_V))

    def _claimed(
        self, coordinates: Coordinates, z: Mapping[str, float], soc: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """SOC at each rest that a point claims, OCV there [V] and its standard deviation [V]."""
        if soc is None:
            capacity = coordinates.capacity_Ah(z)
            soc = np.array([r.soc(self.starts[r.log], z, capacity) for r in self.rests])
        model, inputs = coordinates.model, coordinates.inputs(z)
        points = np.linspace(0.0, 1.0, inputs.table.shape[1])
        warm = np.array([r.temperature_C for r in self.rests])
        at = np.clip(soc, 0.0, 1.0)

        def of_tables(rows: Iterable[FloatArray]) -> FloatArray:
            each = np.array([np.interp(at, points, row) for row in rows])
            between = zip(warm, each.T, strict=True)
            return np.array([np.interp(t, coordinates.grid_C, v) for t, v in between])

        ocv = of_tables(inputs.table[..., OCV])
        # Beyond empty and full the OCV goes on along its slope there.
        slope = of_tables(np.gradient(row, points) for row in inputs.table[..., OCV])
        gap = of_tables(np.abs(inputs.table[..., M]))
        outside = np.min(np.abs(model.temperature_C[:, None] - warm), axis=0)
        own = np.maximum(OCV_KNOWN.least_V, OCV_KNOWN.share * np.asarray(model.slow_error_V(at)))
        std = np.sqrt(own**2 + (ENTROPY_V_PER_K * outside) ** 2 + gap**2)
        return soc, ocv + (soc - at) * slope, std


def rest_voltages(logs: Sequence[LogRows], capacity_Ah: float, efficiency: float) -> RestVoltages:
    """All rests of at least two minutes that follow a load."""
    rests = [r for k, log in enumerate(logs) for r in _of_log(k, log, capacity_Ah, efficiency)]
    return RestVoltages(tuple(rests), tuple(g.start.soc for g in logs))


def _of_log(k: int, rows: LogRows, capacity_Ah: float, efficiency: float) -> list[FittedRest]:
    log, current = rows.log, rows.current_A
    used = np.where(current > 0.0, current, current * efficiency)
    charge = np.cumsum(used * np.nan_to_num(rows.dt_s)) / 3600.0
    small = np.abs(current) < REST_RATE * capacity_Ah
    # Nobody knows what a cell did over a gap, or where nothing was measured.
    small &= np.isfinite(log.current_A)
    small[np.nan_to_num(rows.dt_s) > RULES.shortest_s] = False
    found = []
    for first, last in zip(*run_edges(small), strict=True):
        if first == 0 or log.time_s[last] - log.time_s[first] < RULES.shortest_s:
            continue
        rest = _rest(k, rows, charge, slice(int(first), int(last) + 1))
        if rest is not None:
            found.append(rest)
    return found


def _rest(k: int, rows: LogRows, charge_Ah: FloatArray, part: slice) -> FittedRest | None:
    time_s, voltage = rows.log.time_s[part], rows.log.voltage_V[part]
    length = float(time_s[-1] - time_s[0])

    def reading(share: float) -> float:
        end = time_s[0] + share * length
        near = voltage[(time_s <= end) & (time_s >= end - RULES.reading * length)]
        near = near[np.isfinite(near)]
        return float(np.mean(near)) if near.size else float("nan")

    one, two, three = reading(1 / 3), reading(2 / 3), reading(1.0)
    if not (math.isfinite(one) and math.isfinite(two) and math.isfinite(three)):
        return None
    first, last = two - one, three - two
    direction = 1 if first + last >= 0.0 else -1
    before, after = direction * first, direction * last
    left = 0.0
    if before > after > 0.0:
        left = min(after * after / (before - after), before + after)
    elif after >= before > 0.0:
        left = before + after
    moved = abs(three - float(voltage[np.isfinite(voltage)][0]))
    return FittedRest(
        k,
        float(charge_Ah[part.stop - 1]),
        float(time_s[-1] - rows.log.time_s[0]) / 3600.0,
        float(rows.temperature_C[part.stop - 1]),
        three + direction * left,
        moved,
        direction,
    )
