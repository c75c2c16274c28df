"""Plans of loads and time to full on measured cells, beside what then came.

python -m benchmarks.plans [--only power,past,full] [--json]

``power``: from five moments of a log, its own power to come as the plan (what is left is what is
not known of SOC, model and capacity). ``past``: the first half hour of every drive, and the second,
with the others of the same temperature as the past logs. ``full``: from every minute of a charge.

Coverage is that of the SOC at the plan's end, of all moments; a log's moments share its error, so
that the number of logs is what its uncertainty goes by.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.accuracy.cold import PANASONIC, PANASONIC_AH, TAGS, panasonic_tests
from benchmarks.figures import Figure, Progress, missing
from benchmarks.judged_run import judged_run
from benchmarks.measured_data import HOW, data_folder, measured_log
from cellwise import IdentifySettings, TestLogs, identify_cell
from cellwise.cell.model import CAPACITY_STD, CellModel
from cellwise.cell.stock import stock_model
from cellwise.estimate.replay import replay
from cellwise.forecast.charging import forecast_charge
from cellwise.forecast.plan import BAND, Outcome, Plan, forecast_plan, mean_powers, plan_of_log
from cellwise.logs import CellLog, read_log

PARTS = ("power", "past", "full")
MOMENTS = (0.1, 0.3, 0.5, 0.7, 0.9)  # of a log's time
TRIP_S, DRIVE_S = 1800.0, 900.0
LEAST_S = 600.0  # of a trip that is cut off by the log's end
LEAST_W = 2.0  # mean of a cell of the car: it is driven
LOAD_A, REST_S, BREAK_S = 0.15, 60.0, 3600.0
SAMSUNG_AH = 3.0
LEAST, MOST = 93.0, 97.0


class Ended(NamedTuple):
    """A plan's end and what the tester's counter says it was."""

    log: str
    found: Outcome
    soc: float

    @property
    def inside(self) -> bool:
        """Whether the band has it."""
        low, high = self.found.end_soc_band
        return low <= self.soc <= high

    @property
    def deviations(self) -> float:
        """How far off, in the band's own deviations."""
        low, high = self.found.end_soc_band
        return 4.0 * (self.soc - self.found.end_soc) / max(high - low, 1e-9)


class Cell(NamedTuple):
    """A model, and logs from full that it has not seen; ``capacity_Ah`` is what they count by.

    Where that is the model's own, from the same test of the same cell, it is known: no deviation.
    """

    name: str
    model: CellModel
    logs: tuple[CellLog, ...]
    capacity_Ah: float
    capacity_std: float = CAPACITY_STD


def counted(log: CellLog, capacity_Ah: float) -> np.ndarray:
    """The SOC by the tester's counter, from full; where it has none by the sum of its rows."""
    drawn_Ah = log.charge_Ah
    if drawn_Ah is None:
        drawn_Ah = np.cumsum(log.known_current_A() * log.interval_s) / 3600.0
    return np.asarray(1.0 - (drawn_Ah - drawn_Ah[0]) / capacity_Ah)


def driven(log: CellLog) -> CellLog:
    """A minute before its first load, up to a pause that the tester's clock does not show."""
    first = int(np.argmax(log.known_current_A() > LOAD_A))
    begins = int(np.searchsorted(log.time_s, log.time_s[first] - REST_S))
    breaks = np.flatnonzero(log.interval_s > BREAK_S)
    ends = next((int(k) for k in breaks if k > first), len(log))
    return log.part(begins, ends)


def panasonic(data: Path, tag: str, temperature_C: float) -> Cell:
    """The cell of one temperature, and its drives."""
    model = identify_cell(
        panasonic_tests(data, tag, temperature_C), IdentifySettings(nominal_Ah=2.9)
    ).model
    seen = ("cycle_2", "cycle_3") if tag == "p25" else ("cycle_1", "cycle_2")
    names = sorted(f.name[:-7] for f in (data / PANASONIC).glob(f"drive_{tag}_*.csv.gz"))
    logs = tuple(
        driven(measured_log(data, f"{PANASONIC}/{name}"))
        for name in names
        if not name.endswith(seen)
    )
    return Cell(f"Panasonic {temperature_C:.0f} degC", model, logs, PANASONIC_AH, 0.0)


def samsung(data: Path) -> Cell:
    """A fresh cell at 1C to 4C, by the pulses of another."""
    folder = "samsung_30q_ageing"
    pulses = {
        t: measured_log(data, f"{folder}/hppc_dnn01_1c_p{t}_time_rebuilt") for t in (20, 30, 40)
    }
    tests = TestLogs(
        hppc=tuple((log, float(t)) for t, log in pulses.items()),
        ocv=(measured_log(data, f"{folder}/fresh_s001_discharge_c10"),),
    )
    model = identify_cell(tests, IdentifySettings(nominal_Ah=SAMSUNG_AH)).model
    logs = []
    for rate in (1, 2, 3, 4):
        log = measured_log(data, f"{folder}/fresh_s001_discharge_{rate}c")
        loaded = np.flatnonzero(log.known_current_A() > 0.5 * SAMSUNG_AH)
        logs.append(log.part(0, int(loaded[-1]) + 1))
    return Cell("Samsung 30Q, 1C to 4C", model, tuple(logs), model.capacity_Ah)


def at_moments(cell: Cell, log: CellLog) -> Iterator[Ended]:
    """The log's own power to come, from its moments on."""
    replayed, soc = replay(cell.model, log, soc0=1.0), counted(log, cell.capacity_Ah)
    for share in MOMENTS:
        row = int(np.searchsorted(log.time_s, log.time_s[0] + share * log.duration_s))
        if row < len(log) - 10:
            plan = plan_of_log(log.part(row, len(log)))
            found = forecast_plan(
                cell.model, replayed, [plan], row=row, capacity_std=cell.capacity_std
            )
            yield Ended(log.name, found, float(soc[-1]))


def trip(log: CellLog, start_s: float) -> tuple[int, int] | None:
    """Rows of a trip that begins then; None where too little is left."""
    first, last = np.searchsorted(log.time_s - log.time_s[0], (start_s, start_s + TRIP_S))
    last = min(int(last), len(log) - 1)
    return (
        (int(first), last)
        if last > first + 10 and log.time_s[last] - log.time_s[first] > LEAST_S
        else None
    )


def trips(cell: Cell) -> Iterator[Ended]:
    """Every trip with the others of its cell as the past ones, cut to its time."""
    whole = [(log, replay(cell.model, log, soc0=1.0)) for log in cell.logs]
    for start_s in (0.0, TRIP_S):
        for log, replayed in whole:
            rows = trip(log, start_s)
            if rows is None:
                continue
            seconds = float(log.time_s[rows[1]] - log.time_s[rows[0]])
            plans = list(past_of(cell, log, start_s, seconds))
            if len(plans) >= 3:
                found = forecast_plan(
                    cell.model, replayed, plans, row=rows[0], capacity_std=cell.capacity_std
                )
                soc = counted(log, cell.capacity_Ah)
                yield Ended(log.name, found, float(soc[rows[1]]))


def past_of(cell: Cell, of: CellLog, start_s: float, seconds: float) -> Iterator[Plan]:
    """What the cell's other logs drew in the same time, gaps left out."""
    for log in cell.logs:
        rows = trip(log, start_s)
        if log is not of and rows is not None:
            last = int(np.searchsorted(log.time_s, log.time_s[rows[0]] + seconds))
            yield plan_of_log(log.part(rows[0], min(last, len(log) - 1) + 1))


def car_drives(data: Path) -> Iterator[Plan]:
    """The first quarter of an hour of a car's drives in their order, from its mean cell."""
    for path in sorted((data / "leaf_pack").glob("leaf_*.parquet")):
        log = read_log(path)
        edges = [0, *np.flatnonzero(log.gap_rows).tolist(), len(log)]
        for first, last in pairwise(edges):
            if last - first > 10 and log.time_s[last - 1] - log.time_s[first] > LEAST_S:
                part = log.part(first, last)
                ends = np.searchsorted(part.time_s - part.time_s[0], DRIVE_S)
                plan = plan_of_log(part.part(0, int(ends)))
                if plan.mean > LEAST_W:
                    yield plan


def car_figures(data: Path) -> Iterator[Figure]:
    """Whether the next drive's mean power is in the band of the ones before it."""
    drives = list(car_drives(data))
    for before in (3, 6, 12):
        inside = []
        for k in range(before, len(drives)):
            band = mean_powers(drives[k - before : k], np.array(BAND))
            inside.append(band is not None and band[0] <= drives[k].mean <= band[1])
        yield Figure(
            "Nissan Leaf on the road: mean power of the next drive",
            f"in the 95 % band of the {before} before it",
            100.0 * float(np.mean(inside)),
            "%",
            note=f"{len(inside)} drives",
        )


def coverage(group: str, ends: Sequence[Ended]) -> Iterator[Figure]:
    """Share inside, and how wide the band is for what it misses."""
    inside = 100.0 * float(np.mean([e.inside for e in ends]))
    off = np.array([e.deviations for e in ends])
    logs = len({e.log for e in ends})
    note = f"{len(ends)} moments of {logs} logs; asked {LEAST:g} to {MOST:g}"
    yield Figure(group, "SOC at the end in the 95 % band", inside, "%", note=note)
    yield Figure(group, "error over the band's deviation, RMS", float(np.sqrt(np.mean(off**2))), "")
    missed = [100.0 * abs(e.soc - e.found.end_soc) for e in ends]
    yield Figure(group, "error of the SOC at the end, median", float(np.median(missed)), "%")


def plan_figures(data: Path, parts: Sequence[str], say: Progress) -> list[Figure]:
    """Every cell by itself, and the Panasonic's together."""
    figures: list[Figure] = []
    known: list[Ended] = []
    past: list[Ended] = []
    for temperature, tag in TAGS.items():
        say(f"Panasonic {temperature:.0f} degC")
        cell = panasonic(data, tag, temperature)
        if "power" in parts:
            found = [e for log in cell.logs for e in at_moments(cell, log)]
            figures += coverage(f"{cell.name}: true power to come", found)
            known += found
        if "past" in parts:
            found = list(trips(cell))
            figures += coverage(f"{cell.name}: as in the other drives", found)
            past += found
    for name, ends in (("true power to come", known), ("as in the other drives", past)):
        if ends:
            figures += coverage(f"Panasonic, all: {name}", ends)
    if "past" in parts:
        say("Nissan Leaf")
        figures += car_figures(data)
    if "power" in parts:
        say("Samsung")
        cell = samsung(data)
        found = [e for log in cell.logs for e in at_moments(cell, log)]
        figures += coverage(f"{cell.name}: true power to come", found)
    return figures


class Charge(NamedTuple):
    """A charge to its end: stock model, log, the charger's voltage and last current."""

    stock: str
    log: str
    limit_V: float
    taper_A: float


CHARGES = (
    *(Charge("nca-18650", f"{PANASONIC}/{name}", 4.2, 0.05)
      for name in ("charge1_1c_p25_start", "charge2_1c_p25_start", "charge3_1c_p25_start",
                   "charge_1c_p25_after_cycle4", "charge3_1c_p25_end")),
    *(Charge("lipo-pouch", f"lipo_5450/c{rate}_cycle{k}", 4.1, 0.545)
      for rate in (1, 2, 3, 4) for k in ("25", "48")),
    *(Charge("lmo-pouch", f"nissan_leaf/cap_{rate}c_p23", 4.2, 1.65) for rate in (1, 2, 3)),
)  # fmt: skip


def full_figures(data: Path, say: Progress) -> Iterator[Figure]:
    """Error of the time to full over a charge, and the share of its moments in the band."""
    for charge in CHARGES:
        say(charge.log)
        model, log = stock_model(charge.stock), measured_log(data, charge.log)
        found = forecast_charge(
            model, replay(model, log), limit_V=charge.limit_V, taper_A=charge.taper_A
        )
        current = log.known_current_A()
        done = (log.voltage_V > charge.limit_V - 0.02) & (current < 0.0)
        ends = np.flatnonzero(done & (current > -1.02 * charge.taper_A))
        group = f"time to full, {charge.log}, {charge.stock}"
        if found is None or ends.size == 0:
            yield missing(group, "error", "min", "no charge that ends in this log")
            continue
        truth = log.time_s[ends[0]] - found.time_s
        rows = truth > 60.0
        low, high = found.full_s_band[rows].T
        inside = 100.0 * float(np.mean((low <= truth[rows]) & (truth[rows] <= high)))
        off = np.abs(found.full_s - truth)[rows]
        share = 100.0 * float(np.median(off / truth[rows]))
        note = f"median {share:.1f} %; {inside:.0f} % of {rows.sum()} moments in the band"
        yield Figure(group, "mean error", float(np.mean(off)) / 60.0, "min", note=note)


def measure(parts: list[str], say: Progress) -> list[Figure]:
    """Figures of the parts; a row that says so where the data are not there."""
    data = data_folder()
    if data is None:
        return [missing("measured cells", "not measured", "", f"no measured data: {HOW}")]
    figures = plan_figures(data, parts, say) if {"power", "past"} & set(parts) else []
    return [*figures, *(full_figures(data, say) if "full" in parts else ())]


def main(arguments: list[str] | None = None) -> int:
    """Judge the parts asked for and print them."""
    return judged_run("Plans and time to full", __doc__ or "", PARTS, measure, arguments)


if __name__ == "__main__":
    sys.exit(main())
