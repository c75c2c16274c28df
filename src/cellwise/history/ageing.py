"""A cell's life from its logs in order: capacity and resistance of each, the trend, what to use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from cellwise.arguments import several
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import outside_notices, withheld
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.errors import InputError
from cellwise.history.log_health import PER_KELVIN, LogHealth, changed_model, log_health
from cellwise.history.segments import (
    ComparedSegments,
    CurrentSegment,
    compare,
    cut_at_cycles,
    longest_stretch,
)
from cellwise.history.trend import FADE, Change, Deviations, Trend, change_of, trend_of
from cellwise.logs.cell_log import CellLog
from cellwise.logs.stated import check_order, day_of_name
from cellwise.notices import Code, Notice, texts
from cellwise.plotting import Line, Panel, Plottable, Tabular
from cellwise.typing import FloatArray


class _CapacityTests(NamedTuple):
    """Of the capacity: a stretch that moves ``complete`` of it counts as a test of it.

    From a standard deviation of ``unsure`` on a reference test is asked for.
    """

    complete: float = 0.85
    unsure: float = 0.015


TESTED = _CapacityTests()


@dataclass(frozen=True, eq=False)
class AgeingRecord:
    """One log: what it says of the cell, at its own load and temperature.

    ``share`` is its capacity over the new cell's, from the first one at the same load on. Its
    deviations: ``spread`` of the log itself, ``level`` of what it was compared with, ``new`` of the
    new cell's capacity; ``how`` says by what.
    """

    log: CellLog
    capacity_Ah: float
    capacity_std_Ah: float
    share: float
    spread: float
    level: float
    new: float
    resistance_scale: float
    resistance_std: float
    soc_start: float
    soc_end: float
    counted: bool
    how: str

    @property
    def share_std(self) -> float:
        """Of the share, everything together."""
        return float(np.linalg.norm((self.spread, self.level, self.new)))

    @property
    def deviations(self) -> tuple[float, float, float]:
        """As `Deviations` names them: its own, what windows have alike, its level."""
        alike = 0.0 if self.counted else FADE.windows_alike
        own = float(np.sqrt(1.0 - alike)) * self.spread
        return own, float(np.sqrt(alike)) * self.spread, self.level

    @property
    def day(self) -> date | None:
        """By the log's name."""
        return day_of_name(self.log.name)

    @property
    def throughput_Ah(self) -> float:
        """Charge moved either way."""
        return float(np.sum(np.abs(self.log.known_current_A()) * self.log.interval_s)) / 3600.0

    def to_dict(self) -> dict[str, Any]:
        """Keys as CONTRACT.md has them."""
        return {
            "log": self.log.name,
            "start": None if self.day is None else self.day.isoformat(),
            "capacity_Ah": self.capacity_Ah,
            "capacity_std_Ah": self.capacity_std_Ah,
            "resistance_scale": self.resistance_scale,
            "resistance_std": self.resistance_std,
            "soc_start": self.soc_start,
            "soc_end": self.soc_end,
            "throughput_Ah": self.throughput_Ah,
            "capacity_share": self.share,
            "capacity_share_std": self.share_std,
            "how": self.how,
            "notices": texts(self.log.notices),
        }


@dataclass(frozen=True, eq=False)
class AgeingHistory(Plottable, Tabular):
    """A life: its logs, the trend of the capacity over ``way`` (named by ``over``).

    ``model`` is that of the new cell. ``mismatches`` names the logs that were left out for it.
    ``withheld``: all are, and capacity and resistance are NaN.
    """

    model: CellModel
    logs: tuple[AgeingRecord, ...]
    over: str
    way: FloatArray
    trend: Trend
    mismatches: tuple[Notice, ...] = ()
    withheld: bool = False

    def __repr__(self) -> str:
        if self.withheld:
            return f"AgeingHistory({len(self.logs)} logs, FAR OFF this model)"
        scale, std = self.resistance_scale, self.resistance_std
        share, share_std = self.share
        return (
            f"AgeingHistory({len(self.logs)} logs: {100 * share:.1f} +- {200 * share_std:.1f} % of "
            f"the capacity, {'' if self.change.shown else 'no change shown, '}"
            f"resistance {scale:.2f} +- {2 * std:.2f} of the model's)"
        )

    @cached_property
    def change(self) -> Change:
        """How much of the new cell's capacity was lost over these logs, by them alone."""
        deviations = Deviations(*np.array([one.deviations for one in self.logs]).T)
        share = np.array([one.share for one in self.logs])
        return change_of(self.way, share, deviations, _start_std(self.model, self.logs))

    @property
    def share(self) -> tuple[float, float]:
        """Of the new cell's capacity at the last log, and its deviation.

        The trend's where the logs show a change; else what all of them say together.
        """
        if self.change.shown:
            return float(self.trend.share[-1]), float(self.trend.std[-1])
        return self.change.level, self.change.level_std

    @property
    def capacity_std_Ah(self) -> float:
        """How well the capacity is known after the last log, the new cell's among it [Ah]."""
        share, std = self.share
        new_Ah = self.model.capacity_std_Ah if self.logs[0].counted else 0.0  # else in the trend
        return float(np.hypot(std * self.model.capacity_Ah, share * new_Ah))

    @property
    def capacity_Ah(self) -> float:
        """Capacity after the last log [Ah]."""
        return self.model.capacity_Ah * self.share[0]

    @property
    def aged_model(self) -> CellModel:
        """The model as the cell is now: for `replay`, `live`, `export` without anything else.

        Raises
        ------
        InputError        the logs are far off the model
        """
        if self.withheld:
            raise InputError(
                f"no log that is not far off: {self.mismatches[0]}",
                "logs of the model's cell, aged or not",
                "Check the model and how the logs are read.",
            )
        scale = self.resistance_scale
        capacity = float(np.log(self.capacity_Ah / self.model.capacity_Ah))
        aged = changed_model(self.model, capacity, float(np.log(scale)))
        about = {
            "capacity_share": self.share[0],
            "capacity_std_Ah": self.capacity_std_Ah,
            "resistance_scale": scale,
            "resistance_std": self.resistance_std,
            "logs": [one.log.name for one in self.logs],
        }
        fitted, std = self.model.posterior, self.capacity_std_Ah / self.capacity_Ah
        return replace(
            aged,
            posterior=None if fitted is None else fitted.with_capacity_std(std),
            provenance={**self.model.provenance, "history": about},
        )

    @property
    def resistance_scale(self) -> float:
        """Resistance now over the model's: the mean of the last fifth of the logs."""
        return self._resistance[0]

    @property
    def resistance_std(self) -> float:
        """Its deviation; where these logs scatter by more than each states, as much larger."""
        return self._resistance[1]

    @cached_property
    def _resistance(self) -> tuple[float, float]:
        last = self.logs[-max(len(self.logs) // 5, 1) :]
        weight = np.array([one.resistance_std**-2.0 for one in last])
        values = np.array([one.resistance_scale for one in last])
        mean = float((weight * values).sum() / weight.sum())
        scatter = float((weight * (values - mean) ** 2).sum()) / max(values.size - 1, 1)
        return max(mean, 0.05), float(np.sqrt(max(scatter, 1.0) / weight.sum()))

    @property
    def next_reference(self) -> str:
        """The test that would make the trend known, where it is not."""
        if self.withheld:
            return "none before the model and how the logs are read have been checked"
        std = self.share[1]
        if std <= TESTED.unsure and any(one.counted for one in self.logs):
            return f"none: the share of the new cell's capacity is known to +- {200 * std:.1f} %"
        load = next((one for one in self.logs if one.counted), None)
        as_before = f", as '{load.log.name}'" if load is not None else ""
        return (
            f"a full charge and a complete discharge at one current{as_before}: the capacity is "
            f"known to +- {200 * std:.1f} % only"
        )

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What a person should know of the whole life."""
        temperatures = [
            float(np.nanmean(one.log.temperature_C))
            for one in self.logs
            if one.log.temperature_C is not None and np.any(np.isfinite(one.log.temperature_C))
        ]
        found = [*self.mismatches]
        # Of many logs the one of the largest current: a cell of another size is seen by it.
        largest = max(self.logs, key=lambda one: float(np.nanmax(np.abs(one.log.current_A))))
        soc = largest.soc_start - largest.log.counted_charge_Ah() / self.model.capacity_Ah
        found += outside_notices(self.model.validity, largest.log, np.clip(soc, 0.0, 1.0))
        begins = self.logs[0]
        if not self.withheld and abs(begins.share - 1.0) > 2.0 * begins.share_std:
            text = (
                f" shows {begins.capacity_Ah:.3g} Ah of the model's "
                f"{self.model.capacity_Ah:.3g} Ah (+- {200 * begins.share_std:.2g} % of these): "
                "shares are of a cell that was aged before, or the capacity is another cell's"
            )
            found.append(Notice(Code.NOT_NEW, text, log=begins.log.name))
        first = next((one for one in self.logs if one.counted), None)
        if first is not None and not self.withheld:
            text = (
                f" counts {first.capacity_Ah:.4g} Ah at its load, by which the others are "
                "compared; the capacity to use is of the whole SOC range: the model's "
                f"{self.model.capacity_Ah:.4g} +- {2 * self.model.capacity_std_Ah:.2g} Ah "
                "of the new cell, times the share that remains"
            )
            found.append(Notice(Code.CAPACITY_AT_LOAD, text, log=first.log.name))
        if temperatures and max(temperatures) - min(temperatures) > 10.0:
            text = (
                f"the logs are at {min(temperatures):.0f} to {max(temperatures):.0f} degC: those "
                "at other temperatures are compared through the model, with a wider band"
            )
            found.append(Notice(Code.TEMPERATURES_DIFFER, text))
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """Keys as CONTRACT.md has them."""
        return {
            "logs": [one.to_dict() for one in self.logs],
            "trend": {
                "over": self.over,
                "at": self.way.tolist(),
                "capacity_share": self.trend.share.tolist(),
                "capacity_share_std": self.trend.std.tolist(),
                "knee": None if self.trend.knee is None else self.logs[self.trend.knee].log.name,
                "next_reference": self.next_reference,
                "change_shown": self.change.shown,
                "use": {
                    "capacity_Ah": self.capacity_Ah,
                    "capacity_std_Ah": self.capacity_std_Ah,
                    "resistance_scale": self.resistance_scale,
                    "resistance_std": self.resistance_std,
                },
            },
            "notices": texts(self.notices),
        }

    def without_health(self, mismatches: Sequence[Notice]) -> AgeingHistory:
        """The same of logs that are all far off, without what would be made of them."""
        health = ("capacity", "share", "spread", "level", "new", "resistance")
        unknown: dict[str, Any] = {
            k: np.nan for k in AgeingRecord.__dataclass_fields__ if k.startswith(health)
        }
        nothing = np.full(len(self.logs), np.nan)
        return replace(
            self,
            logs=tuple(replace(one, **unknown) for one in self.logs),
            trend=Trend(nothing, nothing, None),
            mismatches=tuple(map(withheld, mismatches)),
            withheld=True,
        )

    def columns(self) -> dict[str, Any]:
        """One row per log."""
        rows = self.to_dict()["logs"]
        keys = [key for key in rows[0] if key != "notices"]
        found = {key: [row[key] for row in rows] for key in keys}
        return {
            **found,
            "trend_share": self.trend.share,
            "trend_std": self.trend.std,
        }

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Share of the new cell's capacity, and resistance, over the life."""
        way, logs = np.asarray(self.way, dtype=np.float64), self.logs
        share, ohm = (np.array([getattr(one, name) for one in logs])
                      for name in ("share", "resistance_scale"))  # fmt: skip
        ohm_std = np.array([one.resistance_std for one in logs])
        lines = Line("logs", way, share), Line("trend", way, self.trend.share, 2 * self.trend.std)
        return ("time [days]" if self.over == "days" else "charge moved [Ah]"), (
            Panel("capacity over the new cell's", lines),
            Panel("resistance over the model's", (Line("logs", way, ohm, 2.0 * ohm_std),)),
        )


def ageing_history(
    model: CellModel, logs: Sequence[CellLog], *, anyway: bool = False
) -> AgeingHistory:
    """A life from logs in order.

    Stretches of constant current are compared with the first of the same current and temperature:
    counted where both are complete, else curve against curve. Other logs are compared with the
    model.

    Parameters
    ----------
    model : CellModel          of the cell when it was new
    logs : CellLog or sequence of CellLog      in the order of time
    anyway : bool              logs that are far off the model take part, too; else they are left
                               out, and nothing is said of health where all of them are

    Raises
    ------
    InputError        no log; none that says anything; days that run backwards
    """
    check_is_model(model)
    logs = several("logs", logs, CellLog, "Write ageing_history(model, [read_log('a.csv')]).")
    if not logs:
        raise InputError("no log", "logs of one cell in order", "Name them.")
    found: list[AgeingRecord] = []
    references: list[tuple[CurrentSegment, AgeingRecord | None]] = []
    mismatches: list[Notice] = []
    for log in (one for whole in logs for one in cut_at_cycles(whole, model.capacity_Ah)):
        one = _by_stretch(model, log, references, found)
        fit = log_health(model, log) if one is None or not found else None
        if fit is not None and fit.model_mismatch and not anyway:
            mismatches.append(fit.model_mismatch)
            references.clear()
            continue
        if one is None and fit is not None:
            one = _by_fit(model, log, fit)
        if one is not None:
            found.append(one)
    if not found and mismatches:
        return ageing_history(model, logs, anyway=True).without_health(mismatches)
    if not found:
        raise InputError(
            f"{len(logs)} log(s), none of which moves enough charge or has enough voltages",
            "drives, discharges or charges over some part of the SOC range",
            "Give longer logs.",
        )
    days = [one.day for one in found]
    check_order([(one.log.name, day) for one, day in zip(found, days, strict=True)])
    over, way = "throughput_Ah", np.cumsum([one.throughput_Ah for one in found])
    if None not in days and days[-1] != days[0]:
        over, way = "days", np.array([float(day.toordinal()) for day in days if day is not None])
    way = np.asarray(way - way[0], dtype=np.float64)
    trend = trend_of(
        way,
        np.array([one.share for one in found]),
        Deviations(*np.array([one.deviations for one in found]).T),
        _start_std(model, found),
    )
    return AgeingHistory(model, tuple(found), over, way, trend, tuple(mismatches))


def _start_std(model: CellModel, logs: Sequence[AgeingRecord]) -> float:
    """How far from one the share of a life may have begun."""
    return FADE.start_std if logs[0].counted else model.capacity_std_Ah / model.capacity_Ah


def _by_stretch(
    model: CellModel,
    log: CellLog,
    references: list[tuple[CurrentSegment, AgeingRecord | None]],
    before: Sequence[AgeingRecord],
) -> AgeingRecord | None:
    """By its stretch of constant current; None: it has none, or none to be compared with.

    A reference is the first stretch at a load and the log before it, which says how far the cell
    had aged by then.
    """
    one = longest_stretch(log, model.capacity_Ah)
    if one is None:
        return None
    known = next((r for r in references if one.alike(r[0])), None)
    if known is None:
        known = one, before[-1] if before else None
        share = 1.0 if known[1] is None else known[1].share
        if one.moved_Ah <= TESTED.complete * share * model.capacity_Ah:
            return None
        references.append(known)
        result = ComparedSegments(1.0, 0.001, 0.0, 1e-5, True)
    else:
        result = compare(one, known[0])
    reference, aged = known
    share = 1.0 if aged is None else aged.share
    start, end = _soc_of(one, reference, result)
    warm, dc = one.temperature_C, _dc_resistance(model, one.temperature_C)
    known_C = reference.temperature_C
    away_K = 0.0 if warm is None or known_C is None else abs(warm - known_C)
    added_std = PER_KELVIN.resistance * away_K + 0.005
    return AgeingRecord(
        log=log,
        capacity_Ah=reference.moved_Ah * result.capacity,
        capacity_std_Ah=reference.moved_Ah * result.capacity_std,
        share=share * result.capacity,
        spread=share * result.capacity_std,
        level=0.0 if aged is None else float(np.linalg.norm(aged.deviations)),
        new=0.0 if aged is None else aged.new,
        resistance_scale=1.0 + result.added_ohm / dc,
        resistance_std=float(np.hypot(result.added_std_ohm / dc, added_std)),
        soc_start=start,
        soc_end=end,
        counted=result.counted,
        how="counted over a complete half cycle" if result.counted else "curve against curve",
    )


def _by_fit(model: CellModel, log: CellLog, fit: LogHealth) -> AgeingRecord:
    return AgeingRecord(
        log=log,
        capacity_Ah=fit.capacity_Ah,
        capacity_std_Ah=fit.capacity_std_Ah,
        share=fit.capacity_Ah / model.capacity_Ah,
        spread=fit.capacity_std_Ah / model.capacity_Ah,
        level=0.0,
        new=model.capacity_std_Ah / model.capacity_Ah,
        resistance_scale=fit.resistance_scale,
        resistance_std=fit.resistance_std,
        soc_start=fit.soc_start,
        soc_end=fit.soc_end,
        counted=False,
        how=f"fit of the model, {100 * fit.covered:.0f} % of the SOC range",
    )


def _soc_of(
    one: CurrentSegment, reference: CurrentSegment, result: ComparedSegments
) -> tuple[float, float]:
    """SOC at the beginning and end of a stretch: its voltages on the reference's curve."""
    begin = float(np.interp(
        -np.sign(one.current_A) * (one.voltage_V[0] + result.added_ohm * one.current_A),
        -np.sign(one.current_A) * reference.voltage_V, reference.charge_Ah))  # fmt: skip
    if result.counted:
        begin = 0.0
    share = begin / reference.moved_Ah
    end = share + one.moved_Ah / (result.capacity * reference.moved_Ah)
    low, high = float(np.clip(share, 0.0, 1.0)), float(np.clip(end, 0.0, 1.0))
    return (1.0 - low, 1.0 - high) if one.current_A > 0 else (low, high)


def _dc_resistance(model: CellModel, temperature_C: float | None) -> float:
    """Resistance to a long constant current, at half charge [ohm]."""
    warm = model.usual_temperature_C if temperature_C is None else temperature_C
    at = model.at_temperature(warm)
    middle = at.points // 2
    return float(at.r0_ohm[0, middle] + at.r1_ohm[0, middle] + at.r2_ohm[0, middle])
