"""cellwise start: look at a folder, print the commands that fit it, and run them if asked."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import options, printing
from cellwise.cli.common.log_options import SIGNS
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cli.start.found_files import FoundFile
    from cellwise.cli.start.plan import Plan


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the command that begins with whatever there is."""
    p = commands.add_parser("start", help="say what lies in a folder and which commands fit it")
    p.add_argument("folder", metavar="FOLDER", help="logs of a cell, a pack or a flight")
    text = "run the commands and end on a page"
    p.add_argument("--run", dest="run_them", action="store_true", help=text)
    options.number(p, "--nominal-ah", "X", "rated capacity [the largest whole discharge]")
    p.add_argument("--prior", metavar="MODEL", help="model to start from [by the logs]")
    p.add_argument("--sign", choices=SIGNS, default="auto", help="sign of the current [auto]")
    text = "where models and pages go, one folder for each cell [started]"
    p.add_argument("-o", "--output", default="started", metavar="DIR", help=text)
    options.add_json(p)
    p.set_defaults(run=run_start)


def run_start(arguments: argparse.Namespace) -> None:
    """Look at the folder, plan, print, run."""
    from cellwise.cli.start.found_files import look_at
    from cellwise.cli.start.plan import groups_of, plan_of

    folder, out = Path(arguments.folder), Path(arguments.output)
    with printing.working(f"looking at {folder}") as follow:
        files = look_at(folder, arguments, follow)
    groups = groups_of(files)
    if not groups:
        raise _nothing(folder, files)
    places = [out] if len(groups) == 1 else [out / f"cell_{k + 1}" for k in range(len(groups))]
    plans = [plan_of(g, arguments, place) for g, place in zip(groups, places, strict=True)]
    names = [""] if len(plans) == 1 else [f"{place.name}: " for place in places]
    found: dict[str, Any] = {
        "files": [{"path": str(f.path), "kind": f.kind, "why": f.why} for f in files],
        "missing": [n + m for n, plan in zip(names, plans, strict=True) for m in plan.missing],
        "commands": [line for plan in plans for line in plan.lines],
    }
    if arguments.run_them and not any(plan.runs for plan in plans):
        what = f"logs in '{folder}' that do not say all that is needed"
        raise InputError(what, plans[0].missing[0], "Give it.")
    if not arguments.json:
        _print(folder, found)
    if arguments.run_them:
        found["ran"] = _run_all(plans, places, quiet=arguments.json)
        found["pages"] = [r["page"] for r in found["ran"] if r["page"]]
        if len(found["pages"]) > 1 and not arguments.json:  # of one, its command has said it
            printing.say(f"pages to open: {', '.join(found['pages'])}")
    if arguments.json:
        printing.print_json(found)


def _nothing(folder: Path, files: list[FoundFile]) -> InputError:
    """Why a folder gives nothing to do."""
    unread = next((f for f in files if f.kind == "unread"), None)
    inside = sorted(p.name for p in folder.iterdir() if p.is_dir() and p.name[0] not in "._")
    what = f"no battery log in the folder '{folder}' ({len(files)} file(s)"
    what += f"; '{unread.path.name}': {unread.why.rstrip('.')})" if unread else ")"
    hint = f"Name one of its folders: {', '.join(inside[:8])}." if inside else "Check the path."
    return InputError(what, "logs with time, current and voltage of a cell", hint)


def _print(folder: Path, found: dict[str, Any]) -> None:
    rows = [(Path(f["path"]).name, f["kind"], f["why"]) for f in found["files"]]
    printing.table(str(folder), ("file", "taken for", "why"), rows)
    for text in found["missing"]:
        printing.say(f"  missing: {text}")
    printing.say("commands (--run runs them):")
    for line in found["commands"]:
        printing.say(f"  {line}")


def _run_all(plans: list[Plan], places: list[Path], *, quiet: bool) -> list[dict[str, Any]]:
    """Run each cell's commands in a process of their own; what came of each cell.

    Raises
    ------
    InputError        no cell's commands came to an end
    """
    from cellwise.files import made_folder

    ran = []
    for plan, place in zip(plans, places, strict=True):
        if not plan.runs:
            ran.append({"page": None, "error": f"not run: {plan.missing[0]} is needed"})
            continue
        made_folder(place, "models and pages")
        error = next(filter(None, (_run(c, quiet=quiet) for c in plan.commands)), None)
        ran.append({"page": None if error else plan.page, "error": error})
    errors = [one["error"] for one in ran if one["error"]]
    if len(errors) < len(ran):
        for error in errors:
            printing.warn(error)
    else:
        raise InputError(
            f"no cell whose commands ran to their end ({errors[0]})",
            "logs that give a model",
            "See the table without --run, and state what is missing.",
        )
    return ran


def _run(command: tuple[str, ...], *, quiet: bool) -> str | None:
    """Run one command; what it says where it was refused."""
    out = subprocess.DEVNULL if quiet else None
    done = subprocess.run(
        [sys.executable, "-m", "cellwise", *command],
        stdout=out,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines() or [f"cellwise {command[0]} ended unexpectedly"]
    return lines[-1]
