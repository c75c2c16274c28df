"""Whole studies on the embedded data.

cellwise papers: the two papers' tables, on embedded data
    requires nothing
    $ papers
    $ papers --json

cellwise demo: identify, simulate and replay on embedded data
    requires nothing
    $ demo
    $ demo -o pages
    -o, --output DIR=demo  the folder
<figures>

cellwise capacity-study: what each choice of the capacity does to voltage and SOC
    requires nothing (embedded cells), or tests of a cell and a log to judge by
    $ capacity-study --cell embedded-nmc --report study.html
    $ capacity-study --hppc hppc.csv --ocv c20.csv --judge drive.csv --nominal-ah 2.9
    --cell NAME...  embedded-nmc, embedded-nmc-rates, embedded-lfp [all]
    --estimator E...  only these [all four]
<page>
    a cell of your own:
<tests>
    --judge LOG...  log with a charge counter to judge the choices on
    --nominal-ah X  rated capacity
    --reference-capacity-ah X  of the reference
    --reference-soc0 X  [as stated, else 1]
<log options>
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from cellwise.cli.common import log_options, page_options, printing
from cellwise.cli.estimating import print_simulation
from cellwise.cli.identifying import print_identification
from cellwise.cli.replay_output import print_replay
from cellwise.data import datasets_folder
from cellwise.errors import InputError
from cellwise.estimate.estimators import ESTIMATORS
from cellwise.identify import IdentifySettings
from cellwise.logs import CellLog
from cellwise.report import capacity_study_page as study_page
from cellwise.report.demo_page import demo_page
from cellwise.studies import demo, papers
from cellwise.studies.capacity_study import (
    STUDIED,
    CellStudy,
    StudyCell,
    published_orders,
    study_cell,
    study_cells,
)
from cellwise.workflows.starts import start_of


def run_papers(arguments: argparse.Namespace) -> None:
    """Print the tables of both papers."""
    with printing.working("papers") as follow:
        found = papers.paper_tables(datasets_folder(), follow)
    if arguments.json:
        printing.print_json(found)
        return
    for paper, tables in found.items():
        if isinstance(tables, dict):
            printing.say(f"{paper} on {tables['cell']}; published: measured on another cell, "
                         f"{tables['published_cell']}")  # fmt: skip
            for title, entries in tables.items():
                if isinstance(entries, list):
                    printing.table(title, *paper_rows(entries))


def paper_rows(entries: list[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of a table: one for each entry, below it one for each record within."""
    head, rows = [""], []
    for entry in entries:
        own = {k: v for k, v in entry.items() if v is not None and not isinstance(v, dict)}
        within = {k: v for k, v in entry.items() if isinstance(v, dict) and k != "methods"}
        for name, record in {"": own, **entry.get("methods", {}), **within}.items():
            head += [key for key in record if key not in head]
            shown = {"": name, **{k: figure_of(v) for k, v in record.items()}}
            rows.append(shown)
    return head, [[row.get(key, "") for key in head] for row in rows]


def figure_of(value: Any) -> str:
    """A figure, or the two ends of an interval."""
    if isinstance(value, (list, tuple)):
        return " .. ".join(map(figure_of, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def run_demo(arguments: argparse.Namespace) -> None:
    """The main job on embedded data: identify, simulate, replay, one page."""
    page_options.check_page_options(arguments)
    figures = page_options.figure_files(arguments)
    with printing.working("demo") as follow:
        found = demo.run_demo(Path(arguments.output), follow)
        follow("page")
        simulations = [simulation for simulation, _ in found.simulations]
        demo_page(found.identification, simulations, found.replays, found.page, figures=figures)
    if arguments.json:
        printing.print_json(found.to_dict())
        return

    print_identification(found.identification)
    for simulation, start in found.simulations:
        print_simulation(simulation, start)
    for replay in found.replays:
        print_replay(replay)
    printing.say_notices(n for replay in found.replays for n in replay.notices)
    printing.say(f"\nOpen this page: {found.page}")


def run_capacity_study(arguments: argparse.Namespace) -> None:
    """Study the cells, print which choice wins, write the page."""
    page_options.check_page_options(arguments)
    estimators = tuple(arguments.estimator or STUDIED)
    for name in estimators:
        if name not in ESTIMATORS:
            raise InputError(
                f"estimator '{name}'", f"one of {', '.join(ESTIMATORS)}", "Choose one of them."
            )
    own = own_cell(arguments)
    cells = (own,) if own is not None else study_cells(tuple(arguments.cell))
    with printing.working("capacity study") as follow:
        studies = [study_cell(cell, None, estimators, follow) for cell in cells]
        with page_options.page_places(arguments) as pages:
            if pages is not None:
                follow("page")
                study_page.capacity_study_page(studies, pages.page, figures=pages.figures)
    if arguments.json:
        orders = {name: list(order) for name, order in published_orders().items()}
        printing.print_json({"studies": [s.to_dict() for s in studies], "published_orders": orders})
        return
    print_studies(studies)
    page_options.say_pages(arguments)


def own_cell(arguments: argparse.Namespace) -> StudyCell | None:
    """The user's cell, None where no log of one is given.

    Raises
    ------
    InputError        tests without a log to judge on, a reference that is missing or impossible
    """
    tests = arguments.hppc + arguments.ocv + arguments.capacity + arguments.drive
    if not tests and not arguments.judge:
        return None
    capacity, soc0 = arguments.reference_capacity_ah, arguments.reference_soc0
    if not tests or not arguments.judge or capacity is None:
        raise InputError(
            f"{len(tests)} test(s), {len(arguments.judge)} log(s) to judge on and "
            f"{'no' if capacity is None else 'a'} reference capacity",
            "tests, --judge LOG and --reference-capacity-ah X",
            "Give all three, or --cell for a cell that is known.",
        )
    if not capacity > 0.0 or not (soc0 is None or 0.0 <= soc0 <= 1.0):
        raise InputError(
            f"a reference of {capacity:g} Ah from SOC {1.0 if soc0 is None else soc0:g}",
            "a capacity above zero, a SOC from 0 to 1",
            "Correct it.",
        )

    def judged(path: str) -> CellLog:
        log = log_options.read(path, arguments)
        start = start_of(log.soc0, arguments.reference_soc0, "reference_soc0")
        return log if start is None else replace(log, soc0=start)

    return StudyCell(
        name=Path(arguments.judge[0]).name.split(".")[0],
        tests=log_options.test_logs(arguments),
        judged=tuple(judged(path) for path in arguments.judge),
        reference_Ah=capacity,
        reference="given",
        settings=IdentifySettings(nominal_Ah=arguments.nominal_ah),
    )


def print_studies(studies: list[CellStudy]) -> None:
    """Tables and verdicts for people."""
    for study in studies:
        printing.table(
            f"{study.name}: RMSE by capacity, reference {study.reference_Ah:g} Ah "
            f"({study.reference}), judged on {', '.join(study.logs)}",
            *study_page.choices(study),
        )
        for line in study_page.verdicts(study):
            printing.say(f"  {line}")
        printing.say(f"  {study.seconds:.1f} s\n")
    for line in study_page.papers_beside():
        printing.say(line)
