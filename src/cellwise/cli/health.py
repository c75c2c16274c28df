"""How every cell of a pack is, and how one cell has aged.

cellwise pack: logs with cell voltages to every cell's state
    requires a model of the cell and logs with a voltage of every cell
    $ pack --model cell.json day1.csv day2.csv --report pack.html
    $ pack --model lmo-pouch --capacity-ah 65 day.parquet -o cells.csv
<scaled model>
    PACKLOG+  one pack, in the order of time; a folder or a pattern
    --anyway  capacity, resistance and odd cells of logs far off the model, too
    --state FILE  go on from this file where it exists, and write it
    -o, --output OUT  cells as .csv, .csv.gz or .parquet
<cells options>
<page>

cellwise history: a cell's logs in order to its ageing
    requires a model and a cell's logs in the order of their age
    $ history --model cell.json 2023.csv 2024.csv 2025.csv --report life.html
    $ history --model cell.json year*.csv --save-model aged.json
<scaled model>
    LOG+  of one cell, in the order of time; a folder or a pattern
    --save-model MODEL  write the model as the cell is now, for every command
    --anyway  capacity and resistance by logs far off the model, too
    -o, --output OUT  logs as .csv, .csv.gz or .parquet
<page>
<log options>
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from cellwise.cell.model_file import write_model
from cellwise.cli.common import log_options, options, page_options, printing
from cellwise.history.ageing import AgeingHistory, ageing_history
from cellwise.logs.reading import read_pack
from cellwise.logs.writing import write_columns
from cellwise.pack.pack_estimate import PackEstimate, estimate_pack
from cellwise.pack.pack_state import read_state, write_state
from cellwise.report.history_page import LOG_COLUMNS, history_page, log_rows
from cellwise.report.pack_page import CELL_COLUMNS, pack_facts, pack_page
from cellwise.report.page.markup import MOST


def run_pack(arguments: argparse.Namespace) -> None:
    """Estimate every cell of a pack."""
    options.check_places(arguments.output, arguments.state)
    page_options.check_page_options(arguments)
    model = options.read_model(arguments)
    known = arguments.state is not None and Path(arguments.state).exists()
    state = read_state(arguments.state) if known else None
    stated = {"sign": arguments.sign, **log_options.pack_arguments(arguments)}
    each = log_options.read_each(arguments.packlogs, lambda one: read_pack(one, **stated))
    logs = [log for log, _ in each]
    with printing.working(f"{logs[0].cells} cells in {len(logs)} log(s)"):
        whole = estimate_pack(model, logs, state)
    found = whole if arguments.anyway else whole.without_health()
    if arguments.output:
        write_columns(found.columns(), Path(arguments.output))
    if arguments.state and found.withheld is not None:
        printing.warn(f"cellwise pack: '{arguments.state}' stays as it was: logs far off the model")
    elif arguments.state:
        write_state(found.state, arguments.state)
    data = {**found.to_dict(), "notices": printing.rendered(found.notices)}
    page_options.hand_over(arguments, found, pack_page, print_pack, data)


def print_pack(found: PackEstimate) -> None:
    """A pack for people: the whole, the cells at the ends, what is odd."""
    data = found.to_dict()
    first = found.notices[:1] if found.model_mismatch else ()
    printing.say_notices(first)
    printing.table(
        f"{data['cells']} cells, {len(found.days)} log(s)",
        ("what", "found"),
        pack_facts(found),
    )
    # What is not known comes last.
    rows = sorted(
        data["per_cell"], key=lambda row: (math.isnan(row["capacity_Ah"]), row["capacity_Ah"])
    )
    rows = rows[: MOST.listed]
    printing.record_table(f"the {len(rows)} cells of least capacity", rows, *CELL_COLUMNS)
    for cause in data["causes"]:
        said = "; ".join(cause["evidence"])
        other = f" (or {', '.join(cause['confusable_with'])})" if cause["confusable_with"] else ""
        printing.say(f"  {cause['name']}: {said}{other}")
    printing.say_notices(n for n in found.notices if n not in first)


def run_history(arguments: argparse.Namespace) -> None:
    """Follow a cell over its life."""
    options.check_places(arguments.output, arguments.save_model)
    page_options.check_page_options(arguments)
    model = options.read_model(arguments)
    logs = log_options.read_cut(arguments.logs, arguments)
    with printing.working("comparing"):
        found = ageing_history(model, logs, anyway=arguments.anyway)
    if arguments.output:
        write_columns(found.columns(), Path(arguments.output))
    if arguments.save_model and found.withheld:
        printing.warn("cellwise history: no model was written: all logs are far off the one given")
    elif arguments.save_model:
        write_model(found.aged_model, arguments.save_model)
    page_options.hand_over(arguments, found, history_page, print_life, data_of_life(found))


def data_of_life(found: AgeingHistory) -> dict[str, Any]:
    """A life as JSON, with notices in a command's words."""
    data = found.to_dict()
    for row, one in zip(data["logs"], found.logs, strict=True):
        row["notices"] = printing.rendered(one.log.notices)
    return {**data, "notices": printing.rendered(found.notices)}


def said_of_change(found: AgeingHistory) -> str:
    """Whether the logs show that the capacity changed."""
    change = found.change
    if len(found.logs) < 2:
        return "one log shows no change: it takes a second one"
    size = f"{100.0 * change.share:+.1f} +- {200.0 * change.std:.1f} % of the new cell's capacity"
    if change.shown:
        return f"changed since the first log: {size}"
    return f"no change of the capacity shown ({size}): what to use is of all logs together"


def said_of_logs(found: AgeingHistory) -> str:
    """How many they are, and over what."""
    if len(found.logs) < 2:
        return "one log"
    unit = "days" if found.over == "days" else "Ah moved"
    return f"{len(found.logs)} logs over {found.way[-1]:.0f} {unit}"


def print_life(found: AgeingHistory) -> None:
    """A life for people."""
    data = found.to_dict()
    printing.say_notices(found.mismatches)
    printing.record_table(
        said_of_logs(found),
        log_rows(found),
        *LOG_COLUMNS,
    )
    trend, use = data["trend"], data["trend"]["use"]
    if not found.withheld:
        printing.say(said_of_change(found))
        printing.say(
            f"use now: {use['capacity_Ah']:.3f} +- {2 * use['capacity_std_Ah']:.3f} Ah, resistance "
            f"{use['resistance_scale']:.2f} +- {2 * use['resistance_std']:.2f} of the model's"
        )
    if trend["knee"] is not None:
        printing.say(f"the fade is faster from '{trend['knee']}' on")
    printing.say(f"next reference test: {trend['next_reference']}")
    notices = (*found.notices, *(n for one in found.logs for n in one.log.notices))
    printing.say_notices(n for n in notices if n not in found.mismatches)
