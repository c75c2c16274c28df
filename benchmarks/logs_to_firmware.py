"""From logs to firmware without a laboratory: how well discharges end by the number of logs.

    python -m benchmarks.logs_to_firmware [-o FILE.json] [--only CELL]

A stock model of another cell of its kind is updated on N drives or discharges alone
(`cellwise identify --prior`), exported, and its C is run over measured discharges that took no
part, from their true start and from 15 points below it. Counted is how many end within three
points of the tester's counter over a capacity that a low-rate test measured: the measure by which
makers of gauges say 95.5 % without characterisation.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.measured_data import HOW, data_folder
from cellwise.benchmark.certify import read_export
from cellwise.benchmark.certify.exported import Exported
from cellwise.benchmark.certify.lives import counted_soc
from cellwise.benchmark.certify.run import NEAR, ends_of_discharges
from cellwise.cell.model_file import write_model
from cellwise.cell.stock import named_model
from cellwise.cli import main as cellwise
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.replay import reference_soc
from cellwise.files import embedded_folder
from cellwise.logs import CellLog, read_log
from cellwise.logs.stated import Stated

COUNTS = (0, 1, 3, 10, 30)
OFF = (0.0, -0.15)  # of the start that the filter is given; each discharge begins full
VENDORS = 0.955  # of discharges within three points, said of a gauge without characterisation


@dataclass(frozen=True)
class Cell:
    """A measured cell: its prior, its low-rate capacity, logs to fit and logs to judge.

    An ``embedded`` one is a physics model of another kind of model, and its capacity is the truth.
    ``other_Ah`` is a second reference, where what else was measured contradicts the low-rate test.
    """

    folder: str
    prior: str
    nominal_Ah: float
    reference_Ah: float
    fitted: tuple[str, ...]
    judge: tuple[str, ...]
    note: str = ""
    embedded: bool = False
    other_Ah: float | None = None

    def paths(self, data: Path, names: tuple[str, ...]) -> list[str]:
        """Files of names, with what is stated of them."""
        found = []
        for name in names:
            test, at, stated = name.partition("@")
            path = data / self.folder / f"{test}.csv.gz"
            if self.embedded:
                path = embedded_folder() / self.folder / f"{test}.parquet"
            found.append(f"{path}{at}{stated}")
        return found


def _all(pattern: str, *names: str | int) -> tuple[str, ...]:
    return tuple(pattern.format(name) for name in names)


CELLS = (
    Cell(
        "panasonic_18650pf", "nmc-18650", 2.9, 2.997,
        (*_all("drive_p25_{}", "cycle_2", "nn"), *_all("drive_p10_{}", "cycle_1", "hwfet"),
         *_all("drive_p00_{}", "cycle_1", "la92"), *_all("drive_p25_{}", "cycle_3", "hwftb"),
         *_all("drive_p10_{}", "cycle_3", "cycle_4"), *_all("drive_p00_{}", "cycle_3", "hwfet"),
         *_all("drive_n10_{}", "cycle_1", "us06", "nn", "la92")),
        (*_all("drive_p25_{}", "us06", "hwfta", "cycle_4"), *_all("drive_p10_{}", "us06", "nn"),
         *_all("drive_p00_{}", "us06", "nn", "udds", "cycle_4")),
        # Its C/20 counts 4.5 % more between two voltages than its pulse test with its rests.
        other_Ah=2.868,
    ),
    Cell(
        "lg_18650hg2", "nca-18650", 3.0, 2.778,
        ("cap_1c_p25_551", "cap_0p5c_p10_575", "drive_mixed4_p40_562", "cap_1c_p00_589",
         "cap_2c_p25_549", "cap_1c_n10_596", "drive_mixed5_p40_562", "cap_2c_p10_575",
         "cap_0p5c_p25_549", "cap_0p5c_n10_593", "drive_mixed6_p40_562", "cap_0p5c_p40_555"),
        ("drive_us06_n10_601", "drive_us06_n20_610", "cap_1c_p25_552", "cap_1c_p10_576",
         "cap_1c_n10_602", "cap_1c_p40_557", "cap_1c_p10_571"),
    ),
    Cell(
        "samsung_30q_ageing", "nca-18650", 3.0, 2.97,
        _all("d1_cellA_cycle{:03d}", *(k for k in range(1, 302, 10) if k != 281)),
        _all("fresh_s001_discharge_{}", "1c", "2c", "3c"),
        "updated on another sample, from new to 300 cycles",
    ),
    Cell(
        "plett_a123", "lfp-26650", 2.3, 2.0725,
        ("dyn_p25_s1@25", "dyn_p05_s1@5", "dyn_p45_s1@45"),
        ("dyn_p35_s1@35", "dyn_n15_s1@-15", "dyn_n25_s1@-25"),
        "its stock model comes from low-rate tests of this cell",
    ),
    Cell(
        "nissan_leaf", "nmc-18650", 33.1, 30.46,
        ("cap_1c_p23@23",),
        ("cap_2c_p23@23", "cap_3c_p23@23"),
    ),
    Cell(
        "nmc", "nca-18650", 5.0, 5.1532, ("drive_a", "flight", "drive_b"),
        ("drive_c", "drive_p00", "cap_c3"), embedded=True,
    ),
    Cell(
        "lfp", "lfp-26650", 2.3, 2.30345, ("cdc",), ("cap_0p5c", "cap_1c", "cap_2c", "cap_3c"),
        embedded=True,
    ),
)  # fmt: skip


def firmware(cell: Cell, data: Path, count: int, place: Path) -> Exported:
    """The C of the stock model after so many logs."""
    model = place / "model.json"
    logs = [part for path in cell.paths(data, cell.fitted[:count]) for part in ("--drive", path)]
    if logs:
        _run("identify", "--prior", cell.prior, "--nominal-ah", cell.nominal_Ah, *logs, "-o", model)
    else:
        write_model(named_model(cell.prior, cell.nominal_Ah), model)
    with patch("cellwise.export.cross.cores_here", list):  # its cost on targets is not asked here
        _run("export", "--model", model, "--dt", 1, "-o", place / "firmware")
    return read_export(place / "firmware")


def _run(*arguments: object) -> None:
    with (
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()) as said,
    ):
        try:
            code = cellwise([str(one) for one in arguments])
        except SystemExit as stop:
            code = int(stop.code or 0)
    if code:
        raise RuntimeError(f"cellwise {arguments[0]}: {said.getvalue().strip()}")


def errors_at_ends(c: Exported, log: CellLog, reference_Ah: float, off: float) -> list[float]:
    """SOC error at the end of each discharge, the filter started so far off the truth."""
    truth = reference_soc(log, 1.0, reference_Ah)
    if truth is None:  # no counter: the logged current is the best there is
        truth = counted_soc(log, 1.0, replace(c.model, capacity_Ah=reference_Ah))
    samples = samples_of(c.model, log, c.dt_s)
    started = min(max(1.0 + off, 0.0), 1.0)
    soc = c.run(samples.records, started, max(abs(off), 0.02))["soc"][samples.row_sample]
    ends = ends_of_discharges(log)
    return [float(one) for one in (soc - truth)[ends] if np.isfinite(one)]


def study(cell: Cell, data: Path) -> list[dict[str, Any]]:
    """Shares of discharges that end within three points, a row for each number of logs."""
    judged = [
        Stated.parse(path).applied(read_log(Stated.parse(path).path))
        for path in cell.paths(data, cell.judge)
    ]
    rows = []
    counts = [n for n in COUNTS if n < len(cell.fitted)] + [len(cell.fitted)]
    for count in sorted(set(counts)):
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as name:
            c = firmware(cell, data, count, Path(name))
        row: dict[str, Any] = {"cell": cell.folder, "prior": cell.prior, "logs": count}
        row |= {"note": cell.note, "seconds": time.perf_counter() - began}
        row["capacity_off"] = c.model.capacity_Ah / cell.reference_Ah - 1.0
        for reference, by in ((cell.reference_Ah, ""), (cell.other_Ah, "other_")):
            for off in OFF if reference else ():
                found = [e for log in judged for e in errors_at_ends(c, log, reference, off)]
                row[f"{by}ends_from_{1.0 + off:g}"] = len(found)
                row[f"{by}near_from_{1.0 + off:g}"] = float(np.mean(np.abs(found) <= NEAR))
                row[f"{by}median_from_{1.0 + off:g}"] = float(np.median(np.abs(found)))
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def main() -> None:
    """All cells, or the one of a name."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", metavar="FILE.json")
    parser.add_argument("--only", metavar="CELL")
    arguments = parser.parse_args()
    data = data_folder()
    if data is None:
        raise SystemExit(f"no measured cells: {HOW}")
    wanted = [c for c in CELLS if arguments.only in (None, c.folder)]
    rows = [row for cell in wanted for row in study(cell, data)]
    if arguments.output:
        Path(arguments.output).write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
