"""cellwise papers, cellwise demo."""

from __future__ import annotations

import argparse
from pathlib import Path

from cellwise.cli.common import page_options, printing


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands that run whole studies on the embedded data."""
    papers = commands.add_parser("papers", help="the two papers' tables, on embedded data")
    printing.add_json(papers)
    papers.set_defaults(run=run_papers)
    demo = commands.add_parser("demo", help="identify, simulate and replay on embedded data")
    demo.add_argument("-o", "--output", default="demo", metavar="DIR")
    page_options.add_figure_options(demo)
    printing.add_json(demo)
    demo.set_defaults(run=run_demo)


def run_papers(arguments: argparse.Namespace) -> None:
    """Print the tables of both papers."""
    from cellwise.data import datasets_folder
    from cellwise.studies.papers import paper_tables, print_paper_tables

    with printing.bar() as progress:
        task = progress.add_task("papers", total=None)
        found = paper_tables(
            datasets_folder(), lambda text: progress.update(task, description=text)
        )
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    print_paper_tables(found)


def run_demo(arguments: argparse.Namespace) -> None:
    """The main job on embedded data: identify, simulate, replay, one page."""
    from cellwise.studies.demo import run_demo as run

    page_options.check_page_options(arguments)
    with printing.bar() as progress:
        task = progress.add_task("demo", total=None)
        found = run(
            Path(arguments.output),
            lambda text: progress.update(task, description=text),
            page_options.figure_files(arguments),
        )
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    from cellwise.cli.estimating import print_replay, print_simulation
    from cellwise.cli.identifying import print_identification

    print_identification(found.identification)
    for simulation, start in found.simulations:
        print_simulation(simulation, start)
    for replay in found.replays:
        print_replay(replay)
    printing.say(f"\nOpen this page: {found.page}")
