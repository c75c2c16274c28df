"""Many logs, one row for each.

cellwise fleet: thousands of logs: one row for each

cellwise fleet replay: SOC over every log of a folder
    requires a model, a folder of logs and a place for the table
    $ fleet replay --model cell.json logs -o soc.parquet
    $ fleet replay --model cell.json logs -o adaptive.parquet --estimator adaptive --workers 8
    --estimator E=ekf  as in cellwise replay
<start std>
<reference>
<fleet of logs>

cellwise fleet diagnose: the errors of the model on every log
    requires a model, a folder of logs and a place for the table
    $ fleet diagnose --model cell.json logs -o causes.parquet
    $ fleet diagnose --model cell.json logs -o causes.parquet --retry-failed
    --baseline LOG...  known to be good; several
    --cause NAME...  try only this cause; several
<fleet of logs>

cellwise fleet pack: a folder for each pack: every cell over its logs
    requires a model, a folder with one folder of logs for each pack, a place for the table
    $ fleet pack --model cell.json packs -o cells.parquet
    $ fleet pack --model cell.json packs -o cells.parquet --workers 8
<fleet>
<cells options>

cellwise fleet history: a folder for each cell: capacity over its logs
    requires a model, a folder with one folder of logs for each cell, a place for the table
    $ fleet history --model cell.json cells -o ageing.parquet
    $ fleet history --model cell.json cells -o ageing.parquet --fresh
<fleet of logs>
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cellwise.cli.common import log_options, options, printing
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.errors import InputError
from cellwise.estimate.estimators import make_estimator
from cellwise.fleet import DiagnoseTask, HistoryTask, PackTask, ReplayTask, run_fleet
from cellwise.fleet.store import all_rows
from cellwise.fleet.tasks import LogTask
from cellwise.logs import Stated
from cellwise.workflows.starts import start_of


def run_replay(arguments: argparse.Namespace) -> None:
    """Replay every log of a folder."""
    task = ReplayTask(
        **_of_task(arguments),
        estimator=arguments.estimator,
        soc0_std=arguments.soc0_std,
        reference_soc0=arguments.reference_soc0,
        reference_capacity_Ah=arguments.reference_capacity_ah,
    )
    make_estimator(task.estimator, task.model)  # refuses an unknown name before any work
    _run(task, arguments)


def run_diagnose(arguments: argparse.Namespace) -> None:
    """Diagnose every log of a folder."""
    for name in arguments.cause:
        if name not in CAUSES:
            raise InputError(f"--cause {name}", f"one of {', '.join(CAUSES)}", "Correct its name.")
    task = DiagnoseTask(
        **_of_task(arguments),
        causes=arguments.cause or None,
        baseline=log_options.read_all(arguments.baseline, arguments),
    )
    _run(task, arguments)


def run_history(arguments: argparse.Namespace) -> None:
    """Follow every cell of a folder over its life."""
    _run(HistoryTask(**_of_task(arguments), pattern=arguments.pattern), arguments)


def run_pack(arguments: argparse.Namespace) -> None:
    """Estimate every pack of a folder."""
    task = PackTask(
        model=options.read_model(arguments),
        read={"sign": arguments.sign, **log_options.pack_arguments(arguments)},
        pattern=arguments.pattern,
    )
    _run(task, arguments)


def _of_task(arguments: argparse.Namespace) -> dict[str, Any]:
    soc0 = options.soc0_of(arguments)
    stated = Stated.parse(arguments.folder)
    arguments.folder = stated.path
    start_of(stated.soc0, soc0)
    return {
        "stated": None if stated.says_nothing else stated,
        "model": options.read_model(arguments),
        "soc0": soc0,
        "read": log_options.arguments_of_read(arguments),
        "cache": str(Path(arguments.cache).resolve()) if arguments.cache else "",
    }


def _run(task: LogTask, arguments: argparse.Namespace) -> None:
    label = f"fleet {task.kind}"
    with printing.working(label) as follow:
        found = run_fleet(
            task,
            arguments.folder,
            arguments.output,
            scheduler=arguments.scheduler,
            workers=arguments.workers,
            pattern=arguments.pattern,
            batch=arguments.batch,
            fresh=arguments.fresh,
            retry_failed=arguments.retry_failed,
            progress=lambda done, failed, all_: follow(
                f"{label}, {failed} failed" if failed else label, done, all_
            ),
        )
    page = None
    if task.kind == "replay":
        from cellwise.report.fleet_page import fleet_page

        # Names that begin so are no part of the data to those who read the folder.
        page = fleet_page(all_rows(found.folder), found.folder / "_report.html")
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    if found.machine:
        printing.say(
            f"  ! for {found.machine:,} {task.unit} the machine failed, not the log (column "
            "failed_by): run the command again, and they are tried again"
        )
    printing.say(
        f"{found.done:,} of {found.logs:,} {task.unit} done in {found.seconds:.1f} s, "
        f"{found.failed:,} failed (rows with an error), {found.resumed:,} were done before; "
        f"rows in {found.folder}" + (f", every cell on {page}" if page else "")
    )
