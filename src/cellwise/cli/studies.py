"""cellwise papers, cellwise demo."""

from __future__ import annotations

import argparse
from pathlib import Path

from cellwise.cli.common import options, page_options, printing


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the commands that run whole studies on the embedded data."""
    papers = commands.add_parser("papers", help="the two papers' tables, on embedded data")
    options.add_json(papers)
    papers.set_defaults(run=run_papers)
    demo = commands.add_parser("demo", help="identify, simulate and replay on embedded data")
    demo.add_argument("-o", "--output", default="demo", metavar="DIR")
    page_options.add_figure_options(demo)
    options.add_json(demo)
    demo.set_defaults(run=run_demo)


def run_papers(arguments: argparse.Namespace) -> None:
    """Print the tables of both papers."""
    from cellwise.data import datasets_folder
    from cellwise.studies.papers import paper_tables
    from cellwise.studies.papers_text import print_papers

    with printing.working("papers") as follow:
        found = paper_tables(datasets_folder(), follow)
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    print_papers(found)


def run_demo(arguments: argparse.Namespace) -> None:
    """The main job on embedded data: identify, simulate, replay, one page."""
    from cellwise.report import demo_page
    from cellwise.studies.demo import run_demo as run

    page_options.check_page_options(arguments)
    figures = page_options.figure_files(arguments)
    with printing.working("demo") as follow:
        found = run(Path(arguments.output), follow)
        follow("page")
        simulations = [simulation for simulation, _ in found.simulations]
        demo_page(found.identification, simulations, found.replays, found.page, figures=figures)
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
