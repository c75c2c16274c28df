"""cellwise fleet: replay, diagnose, pack, history."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import log_options, options, printing
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.fleet.tasks import LogTask


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the commands about many logs."""
    fleet = commands.add_parser("fleet", help="thousands of logs: one row for each")
    actions = fleet.add_subparsers(dest="action", metavar="ACTION", required=True)
    replay = actions.add_parser("replay", help="SOC over every log of a folder")
    _common(replay)
    replay.add_argument("--estimator", default="ekf", metavar="E", help="as in cellwise replay")
    options.add_soc0_std(replay)
    options.add_reference(replay)
    replay.set_defaults(run=run_replay)
    diagnose = actions.add_parser("diagnose", help="the errors of the model on every log")
    _common(diagnose)
    options.several(diagnose, "--baseline", "LOG", "known to be good; several")
    options.several(diagnose, "--cause", "NAME", "try only this cause; several", default=None)
    diagnose.set_defaults(run=run_diagnose)
    history = actions.add_parser("history", help="a folder for each cell: capacity over its logs")
    _common(history)
    history.set_defaults(run=run_history)
    pack = actions.add_parser("pack", help="a folder for each pack: every cell over its logs")
    _running(pack)
    log_options.add_cells_options(pack)
    options.add_json(pack)
    pack.set_defaults(run=run_pack)


def _common(parser: argparse.ArgumentParser) -> None:
    _running(parser)
    options.add_soc0(parser)
    parser.add_argument("--cache", metavar="DIR", help="keep logs as they were read and checked")
    log_options.add_log_options(parser)
    options.add_json(parser)


def _running(parser: argparse.ArgumentParser) -> None:
    """What is run over which folder, and how."""
    options.add_model(parser, scalable=True)
    text = "searched with its subfolders; DIR@temperature_C=25,soc0=1 says it of every log"
    parser.add_argument("folder", metavar="DIR", help=text)
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="folder of parquet")
    text = "local (threads), processes, or a Dask scheduler's address [local]"
    parser.add_argument("--scheduler", default="local", metavar="S", help=text)
    options.count(parser, "--workers", "N", "of this machine [its cores]")
    parser.add_argument("--pattern", default="*", metavar="P", help="of the file names [*]")
    options.count(parser, "--batch", "N", "logs sent together [by their number]")
    options.flag(parser, "--fresh", "start again, whatever OUT holds")
    options.flag(parser, "--retry-failed", "try the logs again that have failed")


def run_replay(arguments: argparse.Namespace) -> None:
    """Replay every log of a folder."""
    from cellwise.estimate.estimators import make_estimator
    from cellwise.fleet import ReplayTask

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
    from cellwise.diagnose.causes.catalogue import CAUSES
    from cellwise.fleet import DiagnoseTask

    for name in arguments.cause or ():
        if name not in CAUSES:
            raise InputError(f"--cause {name}", f"one of {', '.join(CAUSES)}", "Correct its name.")
    task = DiagnoseTask(
        **_of_task(arguments),
        causes=arguments.cause,
        baseline=log_options.read_all(arguments.baseline, arguments),
    )
    _run(task, arguments)


def run_history(arguments: argparse.Namespace) -> None:
    """Follow every cell of a folder over its life."""
    from cellwise.fleet import HistoryTask

    _run(HistoryTask(**_of_task(arguments), pattern=arguments.pattern), arguments)


def run_pack(arguments: argparse.Namespace) -> None:
    """Estimate every pack of a folder."""
    from cellwise.fleet import PackTask

    task = PackTask(
        model=options.read_model(arguments),
        read={"sign": arguments.sign, **log_options.pack_arguments(arguments)},
        pattern=arguments.pattern,
    )
    _run(task, arguments)


def _of_task(arguments: argparse.Namespace) -> dict[str, Any]:
    from cellwise.logs import Stated

    soc0 = options.soc0_of(arguments)
    stated = Stated.parse(arguments.folder)
    arguments.folder = stated.path
    options.start_of(stated.soc0, soc0)
    return {
        "stated": None if stated.says_nothing else stated,
        "model": options.read_model(arguments),
        "soc0": soc0,
        "read": log_options.arguments_of_read(arguments),
        "cache": str(Path(arguments.cache).resolve()) if arguments.cache else "",
    }


def _run(task: LogTask, arguments: argparse.Namespace) -> None:
    from cellwise.fleet import run_fleet

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
        from cellwise.fleet.store import all_rows
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
