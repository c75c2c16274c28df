"""Which rules end a command on measured logs: each alone, in pairs of one cell, whole and cut.

    python -m benchmarks.refusals [--pairs 50] [--fits 0] [--seed 1] [--cell NAME ...]

A refusal of something that a careful person could use is a bug. Alone: read, inspect, simulate and
replay with the stock model of the kind. In pairs: what `identify` checks before its fit, in the
logs' own roles and, with a prior, as drives; of the first ``--fits`` pairs the whole fit.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.measured_data import HOW, data_folder
from cellwise import InputError
from cellwise.cell.initial_soc.gaps import simulate
from cellwise.cell.stock import scaled_model, stock_model
from cellwise.estimate.replay import replay
from cellwise.identify import CellTests, IdentifySettings, identify_cell
from cellwise.identify.checked_logs import check_logs
from cellwise.identify.joint_fit import gather_logs
from cellwise.identify.measured_capacity import measure_capacity
from cellwise.logs import CellLog, inspect_log, read_log

TEMPERATURE = re.compile(r"_([np])(\d\d)(?=_|\.|$|rise)")
SHORTEST_ROWS = 40  # of a cut


class Cell(NamedTuple):
    """Logs of one cell: their folder and pattern, the stock model of its kind, its rating."""

    pattern: str
    stock: str
    nominal_Ah: float


CELLS = {
    "Panasonic": Cell("panasonic_18650pf/*.csv.gz", "nca-18650", 2.9),
    "LG": Cell("lg_18650hg2/*.csv.gz", "nmc-18650", 3.0),
    "A123": Cell("plett_a123/*.csv.gz", "lfp-26650", 2.3),
    "Leaf cell": Cell("nissan_leaf/[ch]*.csv.gz", "lmo-pouch", 33.1),
    "Leaf pack": Cell("leaf_pack/leaf_*.parquet", "lmo-pouch", 65.0),
    "Samsung life": Cell("samsung_30q_ageing/d1_*.csv.gz", "nca-18650", 3.0),
    "Samsung fresh": Cell("samsung_30q_ageing/fresh_*.csv.gz", "nca-18650", 3.0),
    "Samsung pulses": Cell("samsung_30q_ageing/hppc_*.csv.gz", "nca-18650", 3.0),
    "LiPo": Cell("lipo_5450/*.csv.gz", "lipo-pouch", 5.45),
}


@dataclass
class Tried:
    """How often something was tried, and what was refused, by its rule."""

    tries: Counter[str] = field(default_factory=Counter)
    refusals: dict[tuple[str, str], list[str]] = field(default_factory=dict)

    def run(self, what: str, names: str, do: Callable[..., object], *given: object) -> bool:
        """Try; whether it was done."""
        self.tries[what] += 1
        try:
            do(*given)
        except InputError as error:
            rule = re.sub(r"'[^']*'|-?\d[\d.e+-]*", "_", error.found)
            self.refusals.setdefault((what, rule), []).append(f"{names}: {error}")
            return False
        return True

    def show(self) -> None:
        """The table, and one example of every rule."""
        for what, count in self.tries.items():
            rules = {r: n for (w, r), n in self.refusals.items() if w == what}
            print(f"{what}: {count} tried, {sum(map(len, rules.values()))} refused")
            for rule, cases in sorted(rules.items(), key=lambda item: -len(item[1])):
                print(f"  {len(cases)} x {rule}\n      {cases[0]}")


@cache
def logs_of(cell: str) -> tuple[Path, ...]:
    """The files of a cell's logs, in order."""
    folder = data_folder()
    if folder is None:
        raise SystemExit(f"no measured cells: {HOW}")
    return tuple(sorted(folder.glob(CELLS[cell].pattern)))


@cache
def log_at(path: Path) -> CellLog:
    """A log as the commands read it, its temperature by its name where it has none."""
    log = read_log(path)
    said = TEMPERATURE.search(path.name)
    if log.temperature_C is None and said:
        warm = float(said[2]) * (-1.0 if said[1] == "n" else 1.0)
        log = replace(log, temperature_C=np.full(len(log), warm))
    return log


def cut(log: CellLog, rng: np.random.Generator) -> CellLog:
    """A part of a log: from anywhere, at least a tenth of its rows."""
    rows = len(log)
    least = min(max(rows // 10, SHORTEST_ROWS), rows)
    length = int(rng.integers(least, rows + 1))
    first = int(rng.integers(0, rows - length + 1))
    return log.part(first, first + length)


def own_role(name: str) -> str:
    """What a test is, by how its file is named."""
    roles = {"hppc": "hppc", "ocv": "ocv", "drive": "drive", "dyn": "drive", "paus": "drive"}
    return next((role for begin, role in roles.items() if name.startswith(begin)), "capacity")


def as_tests(logs: tuple[CellLog, ...], role: str | None = None) -> CellTests:
    """The logs as tests, in their own roles or all in one."""
    given: dict[str, tuple[CellLog, ...]] = {}
    for log in logs:
        name = role or ("drive" if log.name.startswith("leaf_") else own_role(log.name))
        given[name] = (*given.get(name, ()), log)
    return CellTests(**given)  # type: ignore[arg-type]


def checks(tests: CellTests, settings: IdentifySettings) -> None:
    """What `identify` checks before its fit."""
    checked = check_logs(tests, settings)
    gather_logs(checked, measure_capacity(checked, settings), settings, lambda _: None)


def alone(cell: Cell, log: CellLog) -> None:
    """What every command does with one log."""
    inspect_log(log)
    model = scaled_model(stock_model(cell.stock), cell.nominal_Ah)
    simulate(model, log)
    replay(model, log, "ekf")


def pairs_of(cell: str, most: int, rng: np.random.Generator) -> Iterator[tuple[CellLog, CellLog]]:
    """Pairs of a cell's logs, at random where there are many."""
    every = list(combinations(logs_of(cell), 2))
    chosen = rng.permutation(len(every))[:most]
    return ((log_at(every[k][0]), log_at(every[k][1])) for k in chosen)


def try_cell(name: str, chosen: argparse.Namespace, tried: Tried) -> None:
    """All tries of one cell's logs."""
    rng, cell = np.random.default_rng(chosen.seed), CELLS[name]
    plain = IdentifySettings(nominal_Ah=cell.nominal_Ah)
    prior = replace(plain, prior=stock_model(cell.stock))
    every = logs_of(name)
    for path in every[:: max(len(every) // chosen.alone, 1)]:
        if tried.run("read", path.name, log_at, path):
            log = log_at(path)
            tried.run("alone", log.name, alone, cell, log)
            tried.run("alone, cut", log.name, alone, cell, cut(log, rng))
    for k, pair in enumerate(pairs_of(name, chosen.pairs, rng)):
        names = " + ".join(log.name for log in pair)
        for how, logs in (("", pair), (", cut", tuple(cut(log, rng) for log in pair))):
            drives = as_tests(logs, "drive")
            tried.run(f"pair in its roles{how}", names, checks, as_tests(logs), plain)
            tried.run(f"pair as drives{how}", names, checks, drives, prior)
            if k < chosen.fits:
                tried.run(f"pair fitted with a prior{how}", names, identify_cell, drives, prior)


def main(arguments: list[str] | None = None) -> int:
    """Try all, print what was refused; 1 where a whole pair of one cell was."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=50, help="of each cell, whole and cut")
    parser.add_argument("--fits", type=int, default=0, help="pairs of each cell that are fitted")
    parser.add_argument("--alone", type=int, default=1000, help="so many logs of each cell alone")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cell", action="append", choices=CELLS, help="[all]")
    chosen = parser.parse_args(arguments)
    tried = Tried()
    for name in chosen.cell or CELLS:
        print(f"  {name} ...", file=sys.stderr, flush=True)
        try_cell(name, chosen, tried)
    tried.show()
    return int(any(w.startswith("pair") and "cut" not in w for w, _ in tried.refusals))


if __name__ == "__main__":
    sys.exit(main())
