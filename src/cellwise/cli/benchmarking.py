"""Estimators, and an export, judged.

cellwise benchmark: estimators, yours among them, x logs x sensor faults
    requires nothing (the embedded suite), or the file or name of a suite
    $ benchmark --estimator ekf --estimator ukf -o results
    $ benchmark suite.toml --estimator mine.py:Mine -o results
    [SUITE=embedded]  a TOML file, or embedded, leo, flight, panasonic, a123, public-1; or submit,
        for a row of another run; or score, for a file of `export --submission`
    [ROW]  with submit: the row's JSON, drawn in beside the rows of the run in DIR; with score: the
        Model.py or Model.m
    -o, --output DIR=benchmark  the folder
<data folder>
    --estimator E...  instead of the suite's: a name, or file.py:Name of your own; baselines
        always run
    --processes N=2  at once
    --fresh  forget what an earlier run left in DIR
    --no-page  no index.html (it needs matplotlib)
    --quick  the suite's quick cut alone
    --own  no rows of other packages: cellwise's, and --estimator
    --rows DIR  of adapters of other packages [benchmarks/rows of the repository]
    --list  suites that come with cellwise
    --log LOG...  of score: a drive or a charge, LOG@soc0=X its true start
    --reference-capacity-ah X  of score: what the truth is counted over
<figures>
<log options>

cellwise certify: how wrong exported or any C will be, on a virtual fleet
    requires a folder that `cellwise export` wrote, or a gauge's source; and a C compiler
    $ certify firmware --sensor sensor.toml --most-p95 0.05 --least-coverage 0.9 -o certificate
    $ certify --gauge gauge.c --model nmc-18650 -o certificate
    [EXPORT]  folder that `cellwise export` wrote
    --gauge SOURCE.c  a gauge behind gauge_init and gauge_step instead of an export
    --ask TEXT  which sensor, tests, tables and step keep a limit: '5 % worst at -10 degC, 3 years'
    --gauge-dir FOLDER  of the gauge's own sources: compiled with it, its headers found
    --gauge-header OUT.h  write the declarations of the two functions, and no more
    --dt S=1  time step of the gauge [s]
    --model MODEL  that was exported [the one in the folder]; of a gauge: the cells, a stock model
        too
    --cells N=200  cells
    --hours H=100  hours of each
    --sensor F.toml  what the target's sensors are off by, as TOML [as exported, else a car's]
    --seed N=1  of all that is drawn
    --physics N  cells of porous electrodes beside, 20 h each [one for 20, where PyBaMM is
        installed]
    --log LOG...  a measured log of this cell, run as it is and with faults; LOG@soc0=X states its
        start
    --reference-capacity-ah X  of the sample that was logged, below its SOC [the model's]
    --patch FILE  of `diagnose --patch`: every life without and with it, limits of those with it
    --keep-logs N=0  write what the filter saw of the N worst
    --scheduler WHERE=local  local (threads), processes, or a Dask scheduler's address
    --most-rmse X  limit of the SOC error, RMS (0.03: three points)
    --most-p95 X  limit of the SOC error in 95 % of the time
    --most-worst X  limit of the worst SOC error
    --least-coverage X  limit of the time within two deviations
    -o, --output DIR  for the certificate, its page and finished cells; a run goes on there
<log options>
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from cellwise.benchmark.certify import (
    Certificate,
    Exported,
    Gauge,
    Limits,
    certify,
    measured_log,
    read_export,
)
from cellwise.benchmark.certify.ask import (
    FRONT_COLUMNS,
    ask_data,
    ask_finding,
    ask_page,
    find_designs,
    parse_ask,
)
from cellwise.benchmark.certify.certificate import (
    CAUSE_COLUMNS,
    CORRECTION,
    GROUP_COLUMNS,
    SHOWN,
    advice,
    certificate_page,
    groups_of,
    split_causes,
)
from cellwise.benchmark.certify.designs import Design
from cellwise.benchmark.certify.gauge import gauge_header
from cellwise.benchmark.leaderboard import LEADERBOARD, TABLE, parts_of, read_entries, submit
from cellwise.benchmark.page import division_table, divisions, standings_page
from cellwise.benchmark.run_suite import BenchmarkResult, run_suite
from cellwise.benchmark.standings import by_estimator, choice_of, standings, suite_tables
from cellwise.benchmark.submission_score import score_submission
from cellwise.benchmark.suite import read_suite, shipped_suites, with_estimators
from cellwise.cell.model_file import read_model
from cellwise.cli.common import log_options, options, page_options, printing
from cellwise.errors import InputError
from cellwise.estimate.sensor import assumed_text
from cellwise.export.patch import read_patch
from cellwise.files import made_folder, write_atomically

MOST_PROCESSES = 64
SUBMIT, SCORE = "submit", "score"
JSON_FILE, PAGE_FILE, ASK_FILE = "certificate.json", "index.html", "design.json"
BEYOND = 1  # exit code where a limit of a certificate is not kept


def run_benchmark(arguments: argparse.Namespace) -> None:
    """Run a suite, print the ranking, write table and page."""
    if arguments.list:
        list_suites(arguments.json)
        return
    if arguments.suite == SUBMIT:
        run_submit(arguments)
        return
    if arguments.suite == SCORE:
        run_score(arguments)
        return
    if arguments.row is not None:
        raise InputError(
            f"'{arguments.row}' behind suite '{arguments.suite}'",
            f"a file only with {SUBMIT} or {SCORE}",
            f"Write cellwise benchmark {SUBMIT} ROW.json -o DIR.",
        )
    if not 1 <= arguments.processes <= MOST_PROCESSES:
        raise InputError(
            f"--processes {arguments.processes}", f"1 to {MOST_PROCESSES}", "Give e.g. 2."
        )
    page_options.check_page_options(arguments)
    if arguments.no_page and arguments.figures:
        raise InputError("--figures with --no-page", "one of them", "Leave --no-page away.")
    suite = read_suite(arguments.suite)
    if arguments.estimator:
        suite = with_estimators(suite, tuple(arguments.estimator))
    if arguments.own:
        suite = replace(suite, rows=(), not_run=())
    if arguments.quick and not any(log.quick for log in suite.logs):
        raise InputError(
            f"--quick of suite '{suite.name}', which has no quick cut",
            "a suite with [quick] and logs marked quick",
            "Leave --quick away.",
        )
    suite = replace(suite, only_quick=arguments.quick)
    data = options.data_folder(arguments)
    with printing.working(suite.name) as follow:
        found = run_suite(
            suite,
            Path(arguments.output),
            data=data,
            processes=arguments.processes,
            fresh=arguments.fresh,
            page=not arguments.no_page,
            figures=page_options.figure_files(arguments),
            adapters=None if arguments.rows is None else Path(arguments.rows),
            progress=follow,
        )
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    print_benchmark(found)


def run_submit(arguments: argparse.Namespace) -> None:
    """Check a row from elsewhere and draw it in."""
    folder = Path(arguments.output)
    if arguments.row is None:
        raise InputError(
            f"{SUBMIT} without a row",
            "the JSON of a row",
            f"Write cellwise benchmark {SUBMIT} ROW.json -o DIR.",
        )
    names = submit(Path(arguments.row), folder)
    page = None
    if not arguments.no_page:
        entries = read_entries(folder / LEADERBOARD)
        parts = parts_of(entries)
        page = standings_page(entries[0]["suite"], parts, folder / "leaderboard.html")
    if arguments.json:
        printing.print_json(
            {"submitted": names, "table": str(folder / TABLE), "page": page and str(page)}
        )
        return
    printing.say(f"{', '.join(names)}: checked, and drawn in: {folder / TABLE}")
    if page is not None:
        printing.say(f"page to open: {page}")


def run_score(arguments: argparse.Namespace) -> None:
    """Score a submission's file on one's own logs, by the published rules."""
    capacity = arguments.reference_capacity_ah
    if arguments.row is None or not arguments.log or capacity is None:
        raise InputError(
            f"{SCORE} without a file, --log or --reference-capacity-ah",
            "all three",
            f"Write cellwise benchmark {SCORE} Model.py --log drive.csv@soc0=1 "
            "--reference-capacity-ah 2.9.",
        )
    logs = log_options.read_all(arguments.log, arguments)
    for log in logs:
        if log.soc0 is None:
            raise InputError(
                f"a log '{log.name}' whose start is not stated",
                "its true SOC, which the error is counted from",
                "State it behind the file, as LOG@soc0=1.",
            )
    with printing.working("scoring"):
        found = score_submission(
            arguments.row, [(log, log.soc0) for log in logs if log.soc0 is not None], capacity
        )
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    printing.record_table(
        "RMSE of every run, points of SOC",
        found.runs,
        ("case", lambda r: r.case),
        ("log", lambda r: r.log),
        ("change", lambda r: r.change),
        ("RMSE", lambda r: f"{r.rmse:.2f}"),
    )
    for name, error in found.cases.items():
        printing.say(f"{name}: {error:.2f}")
    missing = found.to_dict()["missing_cases"]
    left = f", without {', '.join(missing)}" if missing else ""
    printing.say(f"weighted error: {found.weighted:.2f} points{left}")


def list_suites(as_json: bool) -> None:
    """Shipped suites with what they are."""
    suites = [read_suite(name) for name in shipped_suites()]
    if as_json:
        shown = [
            {"name": s.name, "about": s.about, "logs": [g.shown for g in s.logs]} for s in suites
        ]
        printing.print_json({"suites": shown})
        return
    for suite in suites:
        printing.say(f"{suite.name}: {suite.about}")


def print_benchmark(found: BenchmarkResult) -> None:
    """A benchmark for people: how estimators stand, faults, what could not be judged."""
    rows = found.rows
    stand = standings(by_estimator(rows), fewer=True)
    for one in suite_tables(stand):
        printing.table(f"{found.suite.name}, points of SOC", one.head, one.rows)
    printing.say(choice_of(stand))
    for division in divisions(rows):
        if division.key == "faults":
            printing.table("mean settled RMSE by fault", *division_table(division)[:2])
    for text in dict.fromkeys(f"{r['estimator']}: {r['problem']}" for r in rows if r["problem"]):
        printing.say(f"  ! {text}")
    taken = f", {found.resumed} of them from an earlier run" if found.resumed else ""
    printing.say(f"{len(rows)} runs{taken}: {found.parquet}")
    if found.page is not None:
        printing.say(f"page to open: {found.page}")


def run_certify(arguments: argparse.Namespace) -> None:
    """Run the exported C over cells that vary and age; exit 1 beyond a stated limit."""
    limits = Limits(
        arguments.most_rmse, arguments.most_p95, arguments.most_worst, arguments.least_coverage
    )
    sensor = options.sensor_of(arguments)
    if arguments.gauge_header is not None:
        write_atomically(arguments.gauge_header, gauge_header())
        printing.say(f"written: {arguments.gauge_header}")
        return
    if arguments.ask is not None:
        run_ask(arguments)
        return
    exported = judged_of(arguments)
    measured = [
        measured_log(exported.model, log, log.soc0, arguments.reference_capacity_ah)
        for log in log_options.read_all(arguments.log, arguments)
    ]
    with printing.working("cells") as follow:
        found = certify(
            exported,
            arguments.cells,
            arguments.hours,
            sensor=sensor,
            seed=arguments.seed,
            limits=limits,
            physics=arguments.physics,
            measured=measured,
            scheduler=arguments.scheduler,
            folder=arguments.output,
            keep_logs=arguments.keep_logs,
            patch=None if arguments.patch is None else read_patch(arguments.patch),
            follow=lambda done, of: follow("cells", done, of),
        )
    data = found.to_dict()
    if arguments.output is not None:
        place = Path(arguments.output)
        text = json.dumps(printing.clean(data), indent=1, allow_nan=False) + "\n"
        write_atomically(place / JSON_FILE, text)
        certificate_page(data, exported.description["model"], place / PAGE_FILE)
    if arguments.json:
        printing.print_json(data)
    else:
        print_certificate(found, data, arguments.output)
    if found.beyond:
        sys.stdout.flush()
        raise SystemExit(BEYOND)


def run_ask(arguments: argparse.Namespace) -> None:
    """Search options that keep a limit on cells of a model.

    Raises
    ------
    InputError        no model, or no limit
    """
    ask = parse_ask(arguments.ask)
    if arguments.model is None:
        raise InputError(
            "--ask without --model", "the model of the cells", "Add --model nmc-18650, say."
        )
    model = options.read_model(arguments)
    design = Design(model, ask, arguments.dt, arguments.hours, arguments.seed)
    with printing.working("options") as follow:
        found = find_designs(
            design, arguments.cells, follow=lambda done, of: follow("options", done, of)
        )
    data = ask_data(design, found)
    if arguments.output is not None:
        place = made_folder(arguments.output, "the design")
        text = json.dumps(printing.clean(data), indent=1, allow_nan=False) + "\n"
        write_atomically(place / ASK_FILE, text)
        ask_page(data, model.name, str(place / PAGE_FILE))
    if arguments.json:
        printing.print_json(data)
        return
    head = [name for name, _ in FRONT_COLUMNS]
    rows = [[said(row) for _, said in FRONT_COLUMNS] for row in data["front"]]
    printing.table(ask_finding(data), head, rows)


def judged_of(arguments: argparse.Namespace) -> Exported | Gauge:
    """The export or the gauge that the arguments name.

    Raises
    ------
    InputError        neither, both, or a gauge without the model of its cells
    """
    folder, source = arguments.export, arguments.gauge
    if (folder is None) == (source is None):
        raise InputError(
            "neither an export nor a gauge" if source is None else "an export and a gauge",
            "one of them",
            "Name a folder that `cellwise export` wrote, or --gauge SOURCE.c.",
        )
    if source is None:
        model = None if arguments.model is None else read_model(arguments.model)
        return read_export(folder, model)
    if arguments.model is None:
        raise InputError(
            "--gauge without --model", "the model of its cells", "Add --model nmc-18650, say."
        )
    beside = None if arguments.gauge_dir is None else Path(arguments.gauge_dir)
    gauge = Gauge(Path(source), beside, options.read_model(arguments), arguments.dt)
    _ = gauge.program  # refused before cells are drawn
    return gauge


def print_certificate(found: Certificate, data: dict[str, Any], folder: str | None) -> None:
    """The certificate for people: whole, by what, verdict."""
    printing.say(repr(found))
    printing.say(
        f"{printing.percent(data['discharges_within_3_points'], 1)} % of {data['discharges']} "
        "discharges end within three points of SOC"
    )
    for name, own in groups_of(data).items():
        printing.record_table(f"by {name}", own.items(), (name, lambda g: g[0]), *GROUP_COLUMNS)
    if "causes" in data:
        numbers, left = split_causes(data["causes"])
        printing.record_table("its own numbers", numbers, *CAUSE_COLUMNS, CORRECTION)
        printing.record_table("what no number corrects", left, *CAUSE_COLUMNS)
        printing.record_table("the fleet's causes", data["fleet_causes"], *CAUSE_COLUMNS)
        printing.say(advice(data))
        for failure in data["failures"][:SHOWN]:
            printing.say(f"  ! {failure['name']} ({failure['fault']}): {failure['problem']}")
    if data["sensor"]["by_default"]:
        printing.say(assumed_text(data["sensor"]))
    if data["verdict"]["limits"]:
        beyond = data["verdict"]["beyond"]
        printing.say("BEYOND: " + "; ".join(beyond) if beyond else "within every stated limit")
    if folder is not None:
        printing.say(f"{Path(folder) / PAGE_FILE}")
