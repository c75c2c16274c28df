"""What a step costs on four cores, as docs/firmware.md and README.md show it, of one commit.

python -m benchmarks.firmware.table [--from FILE]

The results go to benchmarks/results/firmware.json with commit and date; the table of the page and
the line of README.md are printed from that file. --from prints them from a file that is there.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.example_cell import START_SOC, load_log, two_branches
from benchmarks.figures import between_marks
from benchmarks.firmware.cost import (
    BANK_EVERY,
    BANK_STEPS,
    DT_S,
    EVERY,
    POINTS,
    START_STD,
    STEPS,
)
from benchmarks.measured_data import REPOSITORY
from benchmarks.publish import commit_here
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import bank_type
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.cross import COMPONENTS, cores_here, run_on_target
from cellwise.files import write_atomically

RESULTS = REPOSITORY / "benchmarks" / "results" / "firmware.json"
PAGE = REPOSITORY / "docs" / "firmware.md"
README = REPOSITORY / "README.md"
MARKS = "<!-- cost: printed by benchmarks/firmware/table.py -->", "<!-- end of cost -->"
WRONG_START, WRONG_STD = 0.3, 0.15
CALLED = {
    "cortex-m4f": "Cortex-M4F",
    "cortex-m0plus": "Cortex-M0+",
    "rv32imafc": "RV32IMAFC",
    "rv32imac": "RV32IMAC",
}

Costs = dict[str, dict[str, Any]]


def measured() -> dict[str, Any]:
    """Steps of three states by core: lean, with all care, with an offset, a bank's."""
    model = two_branches()
    tables = {
        "lean": fixed_step_tables(model, DT_S, points=POINTS, wide=False),
        "wide": fixed_step_tables(model, DT_S, points=POINTS),
        "offset": fixed_step_tables(model, DT_S, points=POINTS, offset=True),
    }
    records = samples_of(model, load_log(STEPS), DT_S).records
    costs: dict[str, Costs] = {}
    for core in cores_here():
        print(f"  {core} ...", file=sys.stderr, flush=True)
        own = {
            name: run_on_target(
                made, core, records, START_SOC, START_STD**2, measure_every=EVERY
            ).cost
            for name, made in tables.items()
        }
        own["bank"] = run_on_target(
            tables["wide"], core, records[:BANK_STEPS], START_SOC - WRONG_START, WRONG_STD**2,
            measure_every=BANK_EVERY, of="bank",
        ).cost  # fmt: skip
        costs[core] = {name: asdict(cost) for name, cost in own.items()}
    bank_bytes = bank_type(tables["wide"].options).itemsize
    today = datetime.now(UTC).date().isoformat()
    return {
        "commit": commit_here(), "date": today, "bank_bytes": bank_bytes, "costs": costs,
    }  # fmt: skip


def cost_table(results: dict[str, Any]) -> str:
    """The table of docs/firmware.md."""
    costs: dict[str, Costs] = results["costs"]
    cores = [core for core in CALLED if core in costs]

    def row(head: str, cell: Callable[[Costs], str]) -> str:
        return f"| {head} | {' | '.join(cell(costs[core]) for core in cores)} |"

    def instructions(kind: str) -> Callable[[Costs], str]:
        return lambda c: (
            f"{c[kind]['instructions_mean']:,.0f} / {c[kind]['instructions_most']:,.0f}"
        )

    def stack(c: Costs) -> str:
        return " / ".join(str(c[kind]["stack_bytes"]) for kind in ("lean", "wide", "bank")) + " B"

    lean, wide = (costs[cores[0]][kind] for kind in ("lean", "wide"))
    bank_bytes = (1 + COMPONENTS) * wide["state_bytes"] + results["bank_bytes"]
    lines = [
        f"Commit `{results['commit']}`, {results['date']}.\n",
        f"| three states, instructions | {' | '.join(CALLED[core] for core in cores)} |",
        f"|---|{'---|' * len(cores)}",
        row("a step with `--lean`, mean / most on the drive", instructions("lean")),
        row("a step without, mean / most on the drive", instructions("wide")),
        row("a step with `--offset`, mean / most on the drive", instructions("offset")),
        row(f"a step of a bank of {COMPONENTS} components, mean / most", instructions("bank")),
        row("flash for code with `--lean` / without",
            lambda c: f"{c['lean']['text_bytes']:,} / {c['wide']['text_bytes']:,} B"),
        row("stack with `--lean` / without / bank", stack),
        f"\nRAM: a state of {lean['state_bytes']} bytes with `--lean`, {wide['state_bytes']} "
        f"without, {lean['ram_bytes']} bytes static,\n{bank_bytes} bytes with a bank. Flash for "
        f"tables of {POINTS} points: {lean['model_bytes']:,} and {wide['model_bytes']:,} bytes.",
    ]  # fmt: skip
    return "\n".join(lines)


def readme_line(results: dict[str, Any]) -> str:
    """What README.md says of the cost of a lean step."""
    lean = {core: cost["lean"] for core, cost in results["costs"].items()}
    count = {core: f"{cost['instructions_mean']:,.0f}" for core, cost in lean.items()}
    code = sorted(cost["text_bytes"] / 1000 for cost in lean.values())
    any_of = next(iter(lean.values()))
    return (
        f"A step of three states with `--lean` takes {count['cortex-m4f']} instructions on a "
        f"Cortex-M4F, {count['cortex-m0plus']} on an M0+,\n{count['rv32imafc']} on a RISC-V with "
        f"floats and {count['rv32imac']} on one without, {code[0]:.1f} to {code[-1]:.1f} kB of "
        f"flash beside {any_of['model_bytes'] / 1000:.1f} kB of tables,\n"
        f"{any_of['state_bytes']} bytes of RAM (commit `{results['commit']}`, {results['date']}; "
        "[all of it](docs/firmware.md#what-a-step-costs))."
    )


def main(arguments: list[str] | None = None) -> int:
    """Measure, or read, and print page and README."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--from", dest="source", type=Path, help="results that are there")
    chosen = parser.parse_args(arguments)
    if chosen.source:
        results = json.loads(chosen.source.read_text(encoding="utf-8"))
    elif not set(CALLED) <= set(cores_here()):
        parser.error("no cross tools of every core: make firmware installs them")
    else:
        results = measured()
        write_atomically(RESULTS, json.dumps(results, indent=1) + "\n")
    for page, text in ((PAGE, cost_table(results)), (README, readme_line(results))):
        write_atomically(page, between_marks(page.read_text(encoding="utf-8"), MARKS, text))
    return 0


if __name__ == "__main__":
    sys.exit(main())
