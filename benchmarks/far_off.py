"""Where another cell's model is said to be far off: every measured log by every stock model.

    python -m benchmarks.far_off [--logs 12]

A false alarm: the stock model of the log's own kind is called far off. A miss: a model of another
chemistry (LFP for nickel or manganese, and the other way) is not. Stock models of nickel, manganese
and LiPo cells are neighbours: what is said of one for another is shown and not judged.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, field

from benchmarks.refusals import CELLS, log_at, logs_of
from cellwise.cell.initial_soc.pauses import simulate
from cellwise.cell.plausibility.notice import times_stated
from cellwise.cell.stock import scaled_model, stock_model, stock_names
from cellwise.errors import InputError
from cellwise.estimate.replay import replay

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


def kind_of(own: str, other: str) -> str:
    """What a stock model is to a log whose own kind is another."""
    if own == other:
        return "own"
    return "other chemistry" if LFP in (own, other) else "neighbour"


def main(arguments: list[str] | None = None) -> int:
    """Try all; 1 where one was judged wrongly."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=12, help="of each cell, spread over its tests")
    chosen = parser.parse_args(arguments)
    counted = {"simulate": Counted(), "replay": Counted()}
    for name, cell in CELLS.items():
        every = logs_of(name)
        for path in every[:: -(-len(every) // chosen.logs)]:
            try:
                log = log_at(path)
            except InputError as error:
                print(f"{path.name}: {error}")
                continue
            for stock in stock_names():
                model = scaled_model(stock_model(stock), cell.nominal_Ah)
                simulated, replayed = simulate(model, log), replay(model, log, "ekf")
                times, volt = times_stated(model, log, simulated.error_V, simulated.soc)
                which = f"{log.name} by {stock}: {times:.1f} times, {1e3 * volt:.0f} mV simulated"
                kind = kind_of(cell.stock, stock)
                counted["simulate"].take(kind, simulated.far_off is not None, which)
                counted["replay"].take(kind, replayed.far_off is not None, which)
        print(f"  {name} ...", file=sys.stderr, flush=True)
    for command, found in counted.items():
        for kind, runs in found.runs.items():
            print(f"{command}, {kind}: {runs} runs, {found.said[kind]} called far off")
        print("\n".join(f"    {one}" for one in found.wrong))
    return int(any(found.wrong for found in counted.values()))


if __name__ == "__main__":
    sys.exit(main())
