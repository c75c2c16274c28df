"""Where another cell's model is said to be far off: every measured log by every stock model.

    python -m benchmarks.far_off [--logs 12] [--cell NAME ...]

A false alarm: the stock model of the log's own kind is called far off. A miss: a model of another
chemistry (LFP for nickel or manganese, and the other way) is not. Stock models of nickel, manganese
and LiPo cells are neighbours: what is said of one for another is shown and not judged. A log that
is refused (a voltage that no cell of the model's kind has) counts as said.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from benchmarks.refusals import CELLS, log_at, logs_of
from cellwise.cell.initial_soc.pauses import simulate
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import times_stated
from cellwise.cell.stock import scaled_model, stock_model, stock_names
from cellwise.errors import InputError
from cellwise.estimate.replay import replay
from cellwise.logs import CellLog

LFP = "lfp-26650"


@dataclass
class Counted:
    """Runs of a command, and which of them were judged wrongly."""

    runs: Counter[str] = field(default_factory=Counter)
    said: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def take(self, kind: str, said: bool, which: str) -> None:
        """One run."""
        self.runs[kind] += 1
        self.said[kind] += said
        if kind != "neighbour" and said == (kind == "own"):
            self.wrong.append(f"{kind}: {which}")
            print(f"{'false alarm' if said else 'miss'}: {which}", flush=True)


def kind_of(own: str, other: str) -> str:
    """What a stock model is to a log whose own kind is another."""
    if own == other:
        return "own"
    return "other chemistry" if LFP in (own, other) else "neighbour"


def far_off(command: str, model: CellModel, log: CellLog) -> tuple[bool, str]:
    """Whether a command says it, and how far off the log is."""
    try:
        if command == "replay":
            replayed = replay(model, log, "ekf")
            error_V, soc = replayed.trace.innovation_V, replayed.trace.soc
            said = replayed.far_off is not None
        else:
            simulated = simulate(model, log)
            error_V, soc = simulated.error_V, simulated.soc
            said = simulated.far_off is not None
    except InputError as error:
        return True, f"refused, {error.found}"
    times, volt = times_stated(model, log, np.asarray(error_V), soc)
    return said, f"{times:.1f} times, {1e3 * volt:.0f} mV"


def main(arguments: list[str] | None = None) -> int:
    """Try all; 1 where one was judged wrongly."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=12, help="of each cell, spread over its tests")
    parser.add_argument("--cell", action="append", choices=CELLS, help="[all]")
    chosen = parser.parse_args(arguments)
    counted = {"simulate": Counted(), "replay": Counted()}
    for name in chosen.cell or CELLS:
        cell, every = CELLS[name], logs_of(name)
        for path in every[:: -(-len(every) // chosen.logs)]:
            log = log_at(path)
            for stock in stock_names():
                model = scaled_model(stock_model(stock), cell.nominal_Ah)
                for command, found in counted.items():
                    said, size = far_off(command, model, log)
                    which = f"{command}, {log.name} by {stock}: {size}"
                    found.take(kind_of(cell.stock, stock), said, which)
        print(f"{name}: {len(every[:: -(-len(every) // chosen.logs)])} logs", flush=True)
    for command, found in counted.items():
        for kind, runs in found.runs.items():
            print(f"{command}, {kind}: {runs} runs, {found.said[kind]} called far off")
    return int(any(found.wrong for found in counted.values()))


if __name__ == "__main__":
    sys.exit(main())
