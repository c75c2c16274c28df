"""cellwise pack."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import log_options, options, page_options, printing

if TYPE_CHECKING:
    from cellwise.logs.packs.pack_log import PackLog
    from cellwise.pack.pack_estimate import PackEstimate

SHOWN_CELLS = 6


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the command that looks at packs."""
    pack = commands.add_parser("pack", help="logs with cell voltages to every cell's state")
    options.add_model(pack, scalable=True)
    pack.add_argument(
        "logs",
        nargs="+",
        metavar="PACKLOG",
        help="one pack, in the order of time; a folder or a pattern",
    )
    pack.add_argument("-o", "--output", metavar="OUT", help="cells as .csv, .csv.gz or .parquet")
    text = "capacity, resistance and odd cells of logs far off the model, too"
    options.flag(pack, "--anyway", text)
    text = "go on from this file where it exists, and write it"
    pack.add_argument("--state", metavar="FILE", help=text)
    log_options.add_cells_options(pack)
    page_options.add_page_options(pack)
    options.add_json(pack)
    pack.set_defaults(run=run_pack)


def run_pack(arguments: argparse.Namespace) -> None:
    """Estimate every cell of a pack."""
    from cellwise.logs.writing import write_columns
    from cellwise.pack.pack_estimate import estimate_pack
    from cellwise.pack.pack_state import read_state, write_state
    from cellwise.report import pack_page

    options.check_places(arguments.output, arguments.state)
    page_options.check_page_options(arguments)
    model = options.read_model(arguments)
    known = arguments.state is not None and Path(arguments.state).exists()
    state = read_state(arguments.state) if known else None
    logs = read_packs(arguments)
    with printing.working(f"{logs[0].cells} cells in {len(logs)} log(s)"):
        whole = estimate_pack(model, logs, state)
    found = whole if arguments.anyway else whole.without_health()
    if arguments.output:
        write_columns(found.columns(), Path(arguments.output))
    if arguments.state and found.withheld is not None:
        printing.warn(f"cellwise pack: '{arguments.state}' stays as it was: logs far off the model")
    elif arguments.state:
        write_state(found.state, arguments.state)
    page_options.hand_over(arguments, found, pack_page, print_pack)


def read_packs(arguments: argparse.Namespace) -> list[PackLog]:
    """The logs that the arguments name.

    Raises
    ------
    InputError        whatever `read_pack` refuses
    """
    from cellwise.logs.packs.pack_log import read_pack

    stated = log_options.pack_arguments(arguments)
    found = log_options.read_each(
        arguments.logs, lambda one: read_pack(one, sign=arguments.sign, **stated)
    )
    return [log for log, _ in found]


def print_pack(found: PackEstimate) -> None:
    """A pack for people: the whole, the cells at the ends, what is odd."""
    data = found.to_dict()
    first = data["notices"][:1] if found.far_off else []
    printing.say_notices(first)
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
    percent = printing.percent
    printing.record_table(
        f"the {min(SHOWN_CELLS, len(rows))} cells of least capacity",
        rows[:SHOWN_CELLS],
        ("cell", lambda row: row["name"]),
        ("SOC %", lambda row: percent(row["soc"], 1)),
        ("+-", lambda row: percent(2 * row["soc_std"], 1)),
        ("capacity Ah", lambda row: f"{row['capacity_Ah']:.2f}"),
        ("+-", lambda row: f"{2 * row['capacity_std_Ah']:.2f}"),
        ("resistance", lambda row: f"{row['resistance_scale']:.3f}"),
        ("+-", lambda row: f"{2 * row['resistance_std']:.3f}"),
        ("left mV", lambda row: printing.millivolt(row["voltage_rmse_V"])),
    )
    for cause in data["causes"]:
        said = "; ".join(cause["evidence"])
        other = f" (or {', '.join(cause['confusable_with'])})" if cause["confusable_with"] else ""
        printing.say(f"  {cause['name']}: {said}{other}")
    printing.say_notices(n for n in data["notices"] if n not in first)


def _capacity_first(row: dict[str, Any]) -> float:
    value = row["capacity_Ah"]
    return float("inf") if value != value else float(value)
