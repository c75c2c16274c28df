"""Every cell of a pack on one model: SOC, capacity, resistance, and what is odd."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import (
    far_off_text,
    in_order,
    outside_notices,
    withheld,
)
from cellwise.logs.packs.pack_log import PackLog
from cellwise.pack.differences import (
    CAPACITY,
    LAG,
    LEAD,
    OFFSET,
    REFERENCE_SOC,
    RESISTANCE,
    SELF_DISCHARGE,
    SIZE,
    SOC,
)
from cellwise.pack.evidence import PackEvidence
from cellwise.pack.pack_state import CellDeltas, PackState, drift_between, spread_between
from cellwise.pack.periods import PackDay, pack_days, period_evidence, periods
from cellwise.pack.suspicion import (
    Suspicion,
    against_others,
    against_past,
    also_drifting,
    drift_of,
    drifting,
    exchanged_cells,
    self_discharging,
    with_exchanged,
)
from cellwise.pack.usable import Usable, usable_charge
from cellwise.threads import one_blas_thread
from cellwise.typing import FloatArray

BALANCED = [SOC, SELF_DISCHARGE]


@dataclass(frozen=True, eq=False)
class CellsEstimate:
    """What is estimated of the cells, shape (cells,) each.

    ``capacity_std_Ah`` and ``soc_std`` hold what the mean cell's are uncertain by too;
    ``resistance_scale`` is against the mean cell, which is the model's; ``offset_V`` and ``skew_s``
    are the sensor's: what it adds, and by how much it lags the other cells' polling.
    """

    soc: FloatArray
    soc_std: FloatArray
    capacity_Ah: FloatArray
    capacity_std_Ah: FloatArray
    resistance_scale: FloatArray
    resistance_std: FloatArray
    offset_V: FloatArray
    offset_std_V: FloatArray
    skew_s: FloatArray
    skew_std_s: FloatArray
    voltage_rmse_V: FloatArray


@dataclass(frozen=True, eq=False)
class PackEstimate:
    """A pack after its logs.

    ``days`` are the logs with their mean cells, ``evidence`` the last period's, ``state`` what a
    later call continues from, ``suspicions`` of all periods with the number of each.
    """

    model: CellModel
    days: tuple[PackDay, ...]
    cells: CellsEstimate
    usable: Usable
    evidence: PackEvidence
    suspicions: tuple[tuple[int, Suspicion], ...]
    exchanged: tuple[str, ...]
    state: PackState
    withheld: str | None = None

    def __repr__(self) -> str:
        odd = ", ".join(f"{c['cell']} {c['name']}" for c in self.causes) or "none is odd"
        low, high = float(np.nanmin(self.cells.soc)), float(np.nanmax(self.cells.soc))
        return (
            f"PackEstimate({len(self.names)} cells, {len(self.days)} log(s): "
            f"SOC {low:.3f} to {high:.3f}; {odd})"
        )

    @property
    def far_off(self) -> str | None:
        """What is said first where most of the rows are of logs that are far off the model."""
        means = [day.mean for day in self.days]
        each = ((m, m.log.voltage_V - m.voltage_V) for m in means)
        texts = [far_off_text(self.model, m.log, error, m.soc) for m, error in each]
        rows = sum(len(m.log) for m, text in zip(means, texts, strict=True) if text)
        off = 2 * rows > sum(len(m.log) for m in means)
        return next((text for text in texts if text), None) if off else None

    def without_health(self) -> PackEstimate:
        """The same where it is far off, without what would be made of it: SOC is left."""
        text = self.far_off
        if text is None:
            return self
        unknown = np.full(len(self.names), np.nan)
        health = ("capacity", "resistance", "offset", "skew")
        fields = {k: unknown for k in vars(self.cells) if k.startswith(health)}
        nothing = Usable(np.nan, np.nan, np.nan, np.nan)
        return replace(
            self,
            cells=replace(self.cells, **fields),
            usable=nothing,
            suspicions=(),
            withheld=withheld(text),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Of the cells."""
        return self.days[0].log.names

    @property
    def own_capacity_std_Ah(self) -> FloatArray:
        """Deviation of each cell's capacity from the mean cell's alone [Ah], shape (cells,)."""
        shared = self.model.capacity_std_Ah
        whole = self.cells.capacity_std_Ah
        return np.asarray(np.sqrt(np.maximum(whole**2 - shared**2, 0.0)))

    @property
    def causes(self) -> list[dict[str, Any]]:
        """Odd cells and sensors as `cellwise diagnose` lists causes, the most certain first."""
        found = [
            cause_of(one, self.names[one.cell], self.model, number, len(self.state.periods))
            for number, one in sorted(self.suspicions, key=lambda s: -s[1].gain)
        ]
        for flag in self.days[-1].log.flags:
            if flag.kind in ("dead", "frozen"):
                found.append(
                    {
                        "name": "sensor_fault", "cell": flag.cell, "probability": 1.0,
                        "parameters": {}, "ci95": {}, "evidence": [flag.text],
                        "confusable_with": [],
                    }
                )  # fmt: skip
        return found

    @property
    def weakest(self) -> dict[str, str]:
        """Names of the cells with the least SOC, the least capacity, the most resistance."""
        cells = self.cells
        least = {
            "by_soc": cells.soc,
            "by_capacity": cells.capacity_Ah,
            "by_resistance": -cells.resistance_scale,
        }
        known = {k: v for k, v in least.items() if np.any(np.isfinite(v))}
        return {k: self.names[int(np.nanargmin(known[k]))] if k in known else "-" for k in least}

    @property
    def weak(self) -> list[str]:
        """Cells that are weak beyond what a pack's cells differ by; sensors are not."""
        return list(
            dict.fromkeys(
                self.names[s.cell] for _, s in self.suspicions if not s.explanation.sensor
            )
        )

    @property
    def notices(self) -> tuple[str, ...]:
        """What a person should know, the most harmful first."""
        last = self.days[-1]
        found = outside_notices(self.model.validity, last.log.mean, last.mean.soc)
        texts = [n for day in self.days for n in day.log.notices]
        if not any(np.any(day.mean.used) for day in self.days):
            texts.insert(0, "no stretch between pauses is long enough to be estimated")
        said = (*self.exchanged, *self._drift, *in_order(found, tuple(dict.fromkeys(texts))))
        text = self.withheld or self.far_off
        return said if text is None else (text, *said)

    @property
    def _drift(self) -> tuple[str, ...]:
        """What one period shows and only several can decide."""
        said = bool(self.state.drifts) and self.evidence.days > 0.0 and self.withheld is None
        drift = self.state.drifts[-1] if said else None
        cell = None if drift is None else drifting(drift)
        if drift is None or cell is None or "self_discharge" in {c["name"] for c in self.causes}:
            return ()
        ampere = 1e3 * self.model.capacity_Ah / 24.0
        low, high = (ampere * (drift.per_day[cell] + k * drift.std[cell]) for k in (-2.0, 2.0))
        return (
            f"{self.names[cell]} lost {low:.2g} to {high:.2g} mA against the other cells in the "
            f"last {self.evidence.days:.0f} days: balancing or self-discharge. Only the second "
            "goes on: logs of further months, with --state or together, decide",
        )

    def to_dict(self) -> dict[str, Any]:
        """Keys as CONTRACT.md has them."""
        cells, names = self.cells, self.names
        keys = (
            "soc", "soc_std", "capacity_Ah", "capacity_std_Ah", "resistance_scale",
            "resistance_std", "voltage_rmse_V", "offset_V", "offset_std_V", "skew_s", "skew_std_s",
        )  # fmt: skip
        return {
            "cells": len(names),
            "soc": {
                "min": float(np.nanmin(cells.soc)),
                "mean": float(np.nanmean(cells.soc)),
                "max": float(np.nanmax(cells.soc)),
            },
            "weakest": self.weakest,
            "weak": self.weak,
            "per_cell": [
                {"name": name, **{key: float(getattr(cells, key)[k]) for key in keys}}
                for k, name in enumerate(names)
            ],
            **self.usable.to_dict(),
            "causes": self.causes,
            "logs": [
                {
                    "log": day.log.name,
                    "day": None if day.day is None else day.day.isoformat(),
                    "samples": len(day.log),
                    "soc0": day.mean.start.to_dict(),
                    "mean_voltage_rmse_V": day.mean.rmse_V,
                }
                for day in self.days
            ],
            "notices": list(self.notices),
        }

    def columns(self) -> dict[str, Any]:
        """One row per cell."""
        return {"name": list(self.names), **vars(self.cells)}


@one_blas_thread
def estimate_pack(
    model: CellModel, logs: Sequence[PackLog], state: PackState | None = None
) -> PackEstimate:
    """Estimate every cell of a pack from logs in order.

    Parameters
    ----------
    model : CellModel             of the mean cell: identified, or from a prior and these drives
    logs : sequence of PackLog    one pack, in the order of time; days in their names separate
                                  periods of thirty days, each compared with what was before
    state : PackState or None     what an earlier call left

    Returns
    -------
    PackEstimate

    Raises
    ------
    InputError        other cells in one log than in another, days that run backwards
    """
    days = pack_days(model, logs, None if state is None else state.names)
    parts = periods(days)
    origin = parts[0][0].ordinal if state is None else state.origin
    deltas = None if state is None else state.deltas
    history = [] if state is None else list(state.periods)
    drifts = [] if state is None else list(state.drifts)
    suspected: list[tuple[int, Suspicion]] = []
    exchanged: list[str] = []
    for part in parts:
        evidence = period_evidence(model, part)
        spread = spread_between(evidence)
        found = against_others(spread, evidence)
        if deltas is None:
            deltas = CellDeltas.unknown(len(days[0].log.names), spread)
        else:
            deltas = deltas.later(max(part[0].ordinal - origin, deltas.days))
            moves = drift_between(deltas, evidence)
            expected = replace(deltas, covariance=deltas.covariance + np.diag(moves))
            changed = against_past(expected, evidence)
            pair = exchanged_cells(expected, evidence, changed)
            if pair is not None:
                i, j = pair
                names = days[0].log.names
                exchanged.append(
                    f"{names[i]} and {names[j]} have exchanged their voltages from "
                    f"'{part[0].log.name}' on: each is now what the other was"
                )
                evidence = with_exchanged(evidence, i, j)
                found = [s for s in against_others(spread, evidence) if s.cell not in pair]
                changed = against_past(expected, evidence)
            # Balancing moves what cells hold; what they are drifts slowly, whatever one month says.
            moved = np.zeros(SIZE)
            moved[BALANCED] = moves[BALANCED]
            deltas = replace(deltas, covariance=deltas.covariance + np.diag(moved))
            seen = {s.cell for s in changed}
            found = changed + [s for s in found if s.cell not in seen]
        deltas = deltas.updated(evidence)
        drift = drift_of(spread, evidence)
        if drift is not None:
            found = also_drifting(found, drift)
            drifts.append(drift)
        suspected += [(len(history), s) for s in found]
        history.append(part[0].log.name)
    if deltas is None:
        deltas = CellDeltas.unknown(len(days[0].log.names))
    for one in self_discharging(drifts):
        # A cell that runs empty is far from the others in all that is linear about them.
        also = {s.explanation.cause for _, s in suspected if s.cell == one.cell}
        suspected = [(number, s) for number, s in suspected if s.cell != one.cell]
        suspected.append((len(history) - 1, replace(one, others=tuple(sorted(also)))))
    last = days[-1]
    at_end = _at_end(model, deltas, evidence, last)
    cells = _cells(model, at_end, last, evidence)
    return PackEstimate(
        model=model,
        days=days,
        cells=cells,
        usable=usable_charge(model, last.log.mean, cells.soc, cells.capacity_Ah, last.log.parallel),
        evidence=evidence,
        suspicions=tuple(suspected),
        exchanged=tuple(exchanged),
        state=PackState(last.log.names, origin, deltas, tuple(history), tuple(drifts)),
    )


def _at_end(
    model: CellModel, deltas: CellDeltas, period: PackEvidence, last: PackDay
) -> CellDeltas:
    """The cells with the SOC differences of the last log, where balancing makes them others.

    The last log is in their differences already. Given what the cells are, x, its own shift of the
    SOC is Gaussian with the mean v (b - a x) and the variance v; nothing else is updated twice.
    """
    if period.balancing_soc == 0.0:  # of that log alone
        return deltas
    own = period_evidence(model, [last])
    column = own.matrix[:, SOC, :]
    v = 1.0 / (column[:, SOC] + period.balancing_soc**-2.0)
    mean = deltas.mean.copy()
    mean[:, SOC] += v * (own.vector[:, SOC] - np.einsum("ci,ci->c", column, deltas.mean))
    shifted = np.tile(np.eye(SIZE), (v.size, 1, 1))
    shifted[:, SOC, :] -= v[:, None] * column
    covariance = shifted @ deltas.covariance @ np.swapaxes(shifted, 1, 2)
    covariance[:, SOC, SOC] += v
    return replace(deltas, mean=mean, covariance=covariance)


def _cells(
    model: CellModel, deltas: CellDeltas, last: PackDay, evidence: PackEvidence
) -> CellsEstimate:
    used = np.flatnonzero(last.mean.used)
    z = float(last.mean.soc[used[-1]]) if used.size else float("nan")
    z_std = float(last.mean.soc_std[used[-1]]) if used.size else float("nan")
    x = deltas.mean - np.mean(deltas.mean, axis=0)  # differences from the mean have no mean
    p = deltas.covariance
    lever = np.zeros(SIZE)
    lever[SOC], lever[CAPACITY] = 1.0, REFERENCE_SOC - z
    both = np.zeros(SIZE)
    both[LAG] = both[LEAD] = 1.0

    def std(row: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.einsum("i,cij,j->c", row, p, row)))

    def one(index: int) -> FloatArray:
        return np.asarray(np.eye(SIZE)[index])

    capacity = model.capacity_Ah * (1.0 + x[:, CAPACITY])
    shared = model.capacity_std_Ah
    there = evidence.rows > 0
    return CellsEstimate(
        soc=np.where(there, np.clip(z + x @ lever, 0.0, 1.0), np.nan),
        soc_std=np.hypot(z_std, std(lever)),
        capacity_Ah=np.where(there, capacity, np.nan),
        capacity_std_Ah=np.hypot(shared, model.capacity_Ah * std(one(CAPACITY))),
        resistance_scale=np.where(there, 1.0 + x[:, RESISTANCE], np.nan),
        resistance_std=std(one(RESISTANCE)),
        offset_V=x[:, OFFSET],
        offset_std_V=std(one(OFFSET)),
        skew_s=x @ both,
        skew_std_s=std(both),
        voltage_rmse_V=evidence.rmse_V,
    )


def cause_of(
    one: Suspicion, name: str, model: CellModel, period: int, periods: int
) -> dict[str, Any]:
    """One entry of ``causes``: name, cell, parameters with 95 % intervals, evidence."""
    value, std, text = _in_units(one, model)
    low, high = sorted((value - 1.96 * std, value + 1.96 * std))
    against = "its own past" if one.changed else "the other cells"
    parameter = one.explanation.parameter
    lines = [f"{name}: {text} against {against}"]
    if periods > 1:
        lines.append(f"found in period {period + 1} of {periods}")
    return {
        "name": one.explanation.cause,
        "cell": name,
        "probability": one.probability,
        "parameters": {parameter: value},
        "ci95": {parameter: [low, high]},
        "of": "sensor" if one.explanation.sensor else "cell",
        "changed": one.changed,
        "period": period + 1,
        "gain": one.gain,
        "evidence": lines,
        "confusable_with": list(one.others),
    }


def _in_units(one: Suspicion, model: CellModel) -> tuple[float, float, str]:
    """Value, deviation and text of the parameter that the cause has in `cellwise diagnose`."""
    capacity = model.capacity_Ah
    # What is added and multiplied for the parameter; for the text: factor, digits, words around.
    start, factor, shown, digits, before, after = {
        "capacity": (capacity, capacity, 100.0, 1, "capacity", "%"),
        "resistance_scale": (1.0, 1.0, 100.0, 1, "resistance", "%"),
        "initial_soc": (0.0, 1.0, 100.0, 2, "SOC", "points"),
        "self_discharge": (0.0, capacity / 24.0, 1e3 * capacity / 24.0, 2, "loses", "mA"),
        "voltage_offset": (0.0, 1.0, 1e3, 1, "its voltage reads", "mV"),
        "time_skew": (0.0, 1.0, 1.0, 2, "polled late by", "s"),
    }[one.explanation.cause]
    size, low, high = (shown * (one.size + k * one.std) for k in (0.0, -1.96, 1.96))
    text = f"{before} {size:+.{digits}f} {after} ({low:+.{digits}f} to {high:+.{digits}f})"
    return start + factor * one.size, factor * one.std, text
