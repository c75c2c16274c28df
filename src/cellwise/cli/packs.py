"""cellwise pack."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import log_options, model_options, page_options, printing

if TYPE_CHECKING:
    from cellwise.logs.packs.pack_log import PackLog
    from cellwise.pack.pack_estimate import PackEstimate

SHOWN_CELLS = 6


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command that looks at packs."""
    pack = commands.add_parser("pack", help="logs with cell voltages to every cell's state")
    model_options.add_model(pack, scalable=True)
    pack.add_argument("logs", nargs="+", metavar="PACKLOG", help="one pack, in the order of time")
    pack.add_argument("-o", "--output", metavar="OUT", help="cells as .csv, .csv.gz or .parquet")
    pack.add_argument(
        "--state", metavar="FILE", help="go on from this file where it exists, and write it"
    )
    log_options.add_cells_options(pack)
    page_options.add_page_options(pack)
    printing.add_json(pack)
    pack.set_defaults(run=run_pack)


def run_pack(arguments: argparse.Namespace) -> None:
    """Estimate every cell of a pack."""
    from cellwise.logs.writing import write_columns
    from cellwise.pack.pack_estimate import estimate_pack
    from cellwise.pack.pack_state import read_state, write_state
    from cellwise.report import pack_page

    printing.check_places(arguments.output, arguments.state)
    page_options.check_page_options(arguments)
    model = model_options.read(arguments)
    known = arguments.state is not None and Path(arguments.state).exists()
    state = read_state(arguments.state) if known else None
    logs = read_packs(arguments)
    with printing.bar() as progress:
        progress.add_task(f"{logs[0].cells} cells in {len(logs)} log(s)", total=None)
        found = estimate_pack(model, logs, state)
    if arguments.output:
        write_columns(found.columns(), Path(arguments.output))
    if arguments.state:
        write_state(found.state, arguments.state)
    page_options.hand_over(arguments, found, pack_page, print_pack)


def read_packs(arguments: argparse.Namespace) -> list[PackLog]:
    """The logs that the arguments name.

    Raises
    ------
    InputError        whatever `read_pack` refuses
    """
    from cellwise.logs.packs.pack_reading import read_pack

    options = log_options.pack_arguments(arguments)
    with printing.bar() as progress:
        task = progress.add_task("reading", total=len(arguments.logs))
        logs = []
        for path in arguments.logs:
            logs.append(read_pack(path, sign=arguments.sign, **options))
            progress.advance(task)
    return logs


def print_pack(found: PackEstimate) -> None:
    """A pack for people: the whole, the cells at the ends, what is odd."""
    data = found.to_dict()
    soc = data["soc"]
    weakest = data["weakest"]
    printing.table(
        f"{data['cells']} cells, {len(found.days)} log(s)",
        ("what", "found"),
        [
            ("SOC, lowest / mean / highest", " / ".join(
                f"{printing.percent(soc[k], 1)} %" for k in ("min", "mean", "max"))),
            ("usable as the cells are", f"{data['usable_Ah']:.2f} Ah, {data['usable_Wh']:.0f} Wh"),
            ("left until the first cell is empty", f"{data['left_Ah']:.2f} Ah"),
            ("balancing would bring", f"{data['balancing_gain_Ah']:.2f} Ah"),
            ("least SOC", weakest["by_soc"]),
            ("least capacity", weakest["by_capacity"]),
            ("most resistance", weakest["by_resistance"]),
            ("weak beyond what cells differ by", ", ".join(data["weak"]) or "none"),
        ],
    )  # fmt: skip
    rows = sorted(data["per_cell"], key=_capacity_first)
    printing.table(
        f"the {min(SHOWN_CELLS, len(rows))} cells of least capacity",
        ("cell", "SOC %", "+-", "capacity Ah", "+-", "resistance", "+-", "left mV"),
        [_cell_row(row) for row in rows[:SHOWN_CELLS]],
    )
    for cause in data["causes"]:
        said = "; ".join(cause["evidence"])
        other = f" (or {', '.join(cause['confusable_with'])})" if cause["confusable_with"] else ""
        printing.say(f"  {cause['name']}: {said}{other}")
    for notice in data["notices"]:
        printing.say(f"  ! {notice}")


def _capacity_first(row: dict[str, Any]) -> float:
    value = row["capacity_Ah"]
    return float("inf") if value != value else float(value)


def _cell_row(row: dict[str, Any]) -> tuple[str, ...]:
    return (
        row["name"],
        printing.percent(row["soc"], 1),
        printing.percent(row["soc_std"], 1),
        f"{row['capacity_Ah']:.2f}",
        f"{row['capacity_std_Ah']:.2f}",
        f"{row['resistance_scale']:.3f}",
        f"{row['resistance_std']:.3f}",
        printing.millivolt(row["voltage_rmse_V"]),
    )
