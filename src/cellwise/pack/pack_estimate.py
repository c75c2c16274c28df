"""Every cell of a pack on one model: SOC, capacity, resistance, what is odd and usable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellwise.arguments import several
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import find_mismatch, in_order, outside_notices, withheld
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.logs.packs.pack_log import PackLog
from cellwise.notices import Code, Notice, texts
from cellwise.pack import differences as by
from cellwise.pack.differences import SIZE, OcvSlope, PackDay, pack_days, periods
from cellwise.pack.evidence import PackEvidence, period_evidence
from cellwise.pack.outlier_cells import (
    LEAK,
    Suspicion,
    also_drifting,
    drift_of,
    drifting,
    exchanged_cells,
    self_discharging,
    suspicions,
    with_exchanged,
)
from cellwise.pack.pack_state import CellDeltas, PackState, drift_between, spread_between
from cellwise.plotting import Line, Panel, Plottable, Tabular
from cellwise.threads import one_blas_thread
from cellwise.typing import FloatArray
from cellwise.wording import Option

BALANCED = [by.SOC, by.SELF_DISCHARGE]
POINTS = 101  # of the mean of the OCV between full and empty


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


@dataclass(frozen=True)
class UsableCharge:
    """Charge and energy of a pack between its first full and its first empty cell.

    ``usable_Ah`` as the cells are; ``balanced_Ah`` when all are full together, so that the smallest
    cell alone decides; ``left_Ah`` until the first cell is empty; ``usable_Wh`` of ``usable_Ah``
    at open circuit.
    """

    usable_Ah: float
    balanced_Ah: float
    left_Ah: float
    usable_Wh: float

    def to_dict(self) -> dict[str, float]:
        """JSON values, with what balancing would bring; rounding is none."""
        return {**vars(self), "balancing_gain_Ah": round(self.balanced_Ah - self.usable_Ah, 9)}


UNKNOWN = UsableCharge(np.nan, np.nan, np.nan, np.nan)


@dataclass(frozen=True, eq=False)
class PackEstimate(Plottable, Tabular):
    """A pack after its logs.

    ``days`` are the logs with their mean cells, ``evidence`` the last period's, ``state`` what a
    later call continues from, ``suspicions`` those of all periods, ``exchanged`` cells that have
    changed places; ``usable`` is charge and energy between the first full and the first empty
    cell on ``model``, ``withheld`` what is not said since the logs are far off it.
    """

    model: CellModel
    days: tuple[PackDay, ...]
    cells: CellsEstimate
    usable: UsableCharge
    evidence: PackEvidence
    suspicions: tuple[Suspicion, ...]
    exchanged: tuple[Notice, ...]
    state: PackState
    withheld: Notice | None = None

    def __repr__(self) -> str:
        odd = ", ".join(f"{c['cell']} {c['name']}" for c in self.causes) or "none is odd"
        low, high = float(np.nanmin(self.cells.soc)), float(np.nanmax(self.cells.soc))
        return (
            f"PackEstimate({len(self.names)} cells, {len(self.days)} log(s): "
            f"SOC {low:.3f} to {high:.3f}; {odd})"
        )

    @property
    def model_mismatch(self) -> Notice | None:
        """What is said first where most rows are of logs that are wrong or far off the model."""
        means = [day.mean for day in self.days]
        graves = (next((n for n in m.log.notices if n.is_critical), None) for m in means)
        said = [
            g or find_mismatch(self.model, m.log, m.log.voltage_V - m.voltage_V, m.soc)
            for g, m in zip(graves, means, strict=True)
        ]
        rows = sum(len(m.log) for m, one in zip(means, said, strict=True) if one)
        off = 2 * rows > sum(len(m.log) for m in means)
        return next(filter(None, said), None) if off else None

    def without_health(self) -> PackEstimate:
        """The same where it is far off, without what would be made of it: SOC is left."""
        far = self.model_mismatch
        if far is None:
            return self
        unknown = np.full(len(self.names), np.nan)
        health = ("capacity", "resistance", "offset", "skew")
        fields = {k: unknown for k in vars(self.cells) if k.startswith(health)}
        cells = replace(self.cells, **fields)
        return replace(self, cells=cells, usable=UNKNOWN, suspicions=(), withheld=withheld(far))

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
            one.to_dict(self.names[one.cell], self.model, len(self.state.periods))
            for one in sorted(self.suspicions, key=lambda s: -s.gain)
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
        return {
            k: self.names[int(np.nanargmin(v))] if np.isfinite(v).any() else "-"
            for k, v in least.items()
        }

    @property
    def weak(self) -> list[str]:
        """Cells that are weak beyond what a pack's cells differ by; sensors are not."""
        found = (self.names[s.cell] for s in self.suspicions if not s.cause.sensor)
        return list(dict.fromkeys(found))

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What a person should know, the most harmful first."""
        last = self.days[-1]
        found = outside_notices(self.model.validity, last.log.mean, last.mean.soc)
        of_reading = [n for day in self.days for n in day.log.notices]
        if not any(np.any(day.mean.used) for day in self.days):
            text = "no stretch between pauses is long enough to be estimated"
            of_reading.insert(0, Notice(Code.NO_STRETCH, text))
        said = (*self.exchanged, *self._drift, *in_order(found, tuple(dict.fromkeys(of_reading))))
        far = self.model_mismatch
        if far is None:
            return said
        return (self.withheld or far, *(one for one in said if one != far))

    @property
    def _drift(self) -> tuple[Notice, ...]:
        """What one period shows and only several can decide."""
        if self.evidence.days <= 0.0 or not self.state.drifts or self.withheld is not None:
            return ()
        drift = self.state.drifts[-1]
        cell = drifting(drift)
        if cell is None or LEAK.name in {c["name"] for c in self.causes}:
            return ()
        ampere = 1e3 * self.model.capacity_Ah / 24.0
        low, high = (ampere * (drift.per_day[cell] + k * drift.std[cell]) for k in (-2.0, 2.0))
        text = (
            f"{self.names[cell]} lost {low:.2g} to {high:.2g} mA against the other cells in the "
            f"last {self.evidence.days:.0f} days: balancing or self-discharge. Only the second "
            "goes on: logs of further months, with "
        )
        said = (text, Option("state", letter="..."), " or together, decide")
        return (Notice(Code.CELL_DRIFTS, said),)

    def to_dict(self) -> dict[str, Any]:
        """Keys as CONTRACT.md has them."""
        columns, soc = self.columns(), self.cells.soc
        return {
            "cells": len(self.names),
            "soc": {
                "min": float(np.nanmin(soc)),
                "mean": float(np.nanmean(soc)),
                "max": float(np.nanmax(soc)),
            },
            "weakest": self.weakest,
            "weak": self.weak,
            "per_cell": [
                {"name": name, **{k: float(v[cell]) for k, v in vars(self.cells).items()}}
                for cell, name in enumerate(columns["name"])
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
            "notices": texts(self.notices),
        }

    def columns(self) -> dict[str, Any]:
        """One row per cell."""
        return {"name": list(self.names), **vars(self.cells)}

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """SOC, capacity and resistance of every cell with two standard deviations."""
        cells, at = self.cells, np.arange(1.0, len(self.names) + 1.0)
        shown = (
            ("SOC", cells.soc, cells.soc_std),
            ("capacity [Ah]", cells.capacity_Ah, cells.capacity_std_Ah),
            ("resistance over the mean cell's", cells.resistance_scale, cells.resistance_std),
        )
        return "cell", tuple(
            Panel(label, (Line(label, at, value, 2.0 * std),)) for label, value, std in shown
        )


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
    check_is_model(model)
    logs = several("logs", logs, PackLog, "Write estimate_pack(model, [read_pack('a.csv')]).")
    days = pack_days(model, logs, None if state is None else state.names)
    names, parts = days[0].log.names, periods(days)
    known = state is not None
    if state is None:
        state = PackState(names, parts[0][0].ordinal, CellDeltas.unknown(len(names)), ())
    deltas, history, drifts = state.deltas, list(state.periods), list(state.drifts)
    suspected: list[Suspicion] = []
    exchanged: list[Notice] = []
    for part in parts:
        evidence = period_evidence(model, part)
        spread = spread_between(evidence)
        others = CellDeltas.unknown(len(names), spread)
        found: list[Suspicion] = []
        if not known:
            deltas, known = others, True
        else:
            deltas = deltas.later(max(part[0].ordinal - state.origin, deltas.days))
            moves = drift_between(deltas, evidence)
            past = replace(deltas, covariance=deltas.covariance + np.diag(moves))
            found = suspicions(past, evidence, changed=True)
            if pair := exchanged_cells(past, evidence, found):
                first, second = (names[k] for k in pair)
                text = (
                    f"{first} and {second} have exchanged their voltages from "
                    f"'{part[0].log.name}' on: each is now what the other was"
                )
                exchanged.append(Notice(Code.CELLS_EXCHANGED, text))
                evidence = with_exchanged(evidence, pair)
                found = suspicions(past, evidence, changed=True)
            # Balancing moves what cells hold; what they are drifts slowly, whatever one month says.
            moved = np.zeros(SIZE)
            moved[BALANCED] = moves[BALANCED]
            deltas = replace(deltas, covariance=deltas.covariance + np.diag(moved))
        seen = {s.cell for s in found}
        found += [s for s in suspicions(others, evidence, changed=False) if s.cell not in seen]
        deltas = deltas.updated(evidence)
        drift = drift_of(spread, evidence)
        if drift is not None:
            found = also_drifting(found, drift)
            drifts.append(drift)
        suspected += [replace(s, period=len(history)) for s in found]
        history.append(part[0].log.name)
    for one in self_discharging(drifts):
        # A cell that runs empty is far from the others in all that is linear about them.
        also = tuple(sorted({s.cause.name for s in suspected if s.cell == one.cell}))
        suspected = [s for s in suspected if s.cell != one.cell]
        suspected.append(replace(one, others=also, period=len(history) - 1))
    last = days[-1]
    cells = _cells(model, _at_end(model, deltas, evidence, last), last, evidence)
    return PackEstimate(
        model=model,
        days=days,
        cells=cells,
        usable=usable_charge(model, last.log, cells.soc, cells.capacity_Ah),
        evidence=evidence,
        suspicions=tuple(suspected),
        exchanged=tuple(exchanged),
        state=PackState(names, state.origin, deltas, tuple(history), tuple(drifts)),
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
    column = own.matrix[:, by.SOC, :]
    v = 1.0 / (column[:, by.SOC] + period.balancing_soc**-2.0)
    mean = deltas.mean.copy()
    mean[:, by.SOC] += v * (own.vector[:, by.SOC] - np.einsum("ci,ci->c", column, deltas.mean))
    shifted = np.tile(np.eye(SIZE), (v.size, 1, 1))
    shifted[:, by.SOC, :] -= v[:, None] * column
    covariance = shifted @ deltas.covariance @ np.swapaxes(shifted, 1, 2)
    covariance[:, by.SOC, by.SOC] += v
    return replace(deltas, mean=mean, covariance=covariance)


def _cells(
    model: CellModel, deltas: CellDeltas, last: PackDay, evidence: PackEvidence
) -> CellsEstimate:
    used = np.flatnonzero(last.mean.used)
    at = used[-1] if used.size else 0
    z, z_std = float(last.mean.soc[at]), float(last.mean.soc_std[at])
    x = deltas.mean - np.mean(deltas.mean, axis=0)  # differences from the mean have no mean
    there = evidence.rows > 0

    def seen(*parts: tuple[int, float]) -> tuple[FloatArray, FloatArray]:
        """A sum of differences, and its deviation."""
        row = np.zeros(SIZE)
        for k, factor in parts:
            row[k] = factor
        return x @ row, np.sqrt(np.einsum("i,cij,j->c", row, deltas.covariance, row))

    soc, soc_std = seen((by.SOC, 1.0), (by.CAPACITY, by.REFERENCE_SOC - z))
    capacity, capacity_std = seen((by.CAPACITY, model.capacity_Ah))
    resistance, resistance_std = seen((by.RESISTANCE, 1.0))
    return CellsEstimate(
        np.where(there, np.clip(z + soc, 0.0, 1.0), np.nan),
        np.hypot(z_std, soc_std),
        np.where(there, model.capacity_Ah + capacity, np.nan),
        np.hypot(model.capacity_std_Ah, capacity_std),
        np.where(there, 1.0 + resistance, np.nan),
        resistance_std,
        *seen((by.OFFSET, 1.0)),
        *seen((by.LAG, 1.0), (by.LEAD, 1.0)),
        evidence.rmse_V,
    )


def usable_charge(
    model: CellModel, log: PackLog, soc: FloatArray, capacity_Ah: FloatArray
) -> UsableCharge:
    """What cells in series give, from SOC and capacity of each, shape (cells,); NaN: unknown.

    All of the log's parallel strings give so many times as much.
    """
    known = np.isfinite(soc) & np.isfinite(capacity_Ah)
    if not known.any():
        return UNKNOWN
    z, q = soc[known], log.parallel * capacity_Ah[known]
    left = float(np.min(z * q))
    room = float(np.min((1.0 - z) * q))
    moved = np.linspace(room, -left, POINTS)  # charge put in, from the pack's full to its empty
    at = np.clip(z + moved[:, None] / q, 0.0, 1.0)
    volts = OcvSlope(model, log.mean).ocv_V(at).sum(axis=1)
    volts *= soc.size / z.size  # cells without a sensor are there all the same
    usable = left + room
    return UsableCharge(usable, float(np.min(q)), left, usable * float(np.mean(volts)))
