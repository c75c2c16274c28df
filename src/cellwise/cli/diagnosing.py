"""cellwise diagnose."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import log_options, model_options, page_options, printing
from cellwise.errors import InputError
from cellwise.files import made_folder

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.diagnose.log_runs import LogRun
    from cellwise.diagnose.result import Diagnosis, FoundCause
    from cellwise.logs import CellLog

SHOWN = 6
LOG_HEAD = ("log", "used", "initial SOC", "RMSE mV", "with causes", "log corrected, too")


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command that criticises a model."""
    p = commands.add_parser("diagnose", help="model and logs to what is wrong, and by how much")
    model_options.add_model(p)
    p.add_argument("logs", nargs="+", metavar="LOG", help="what is to be explained")
    for option, text in (
        ("--holdout", "log on which gains are measured [later parts of the logs]"),
        ("--baseline", "log of the same cell and instruments that is known to be good"),
    ):
        p.add_argument(
            option, action="extend", nargs="+", default=[], metavar="LOG", help=f"{text}; several"
        )
    p.add_argument(
        "--soc0",
        default="auto",
        metavar="X",
        help="of logs without LOG@soc0=X: 0..1, or auto [auto]",
    )
    p.add_argument(
        "--cause",
        action="append",
        metavar="C",
        help="try only this cause; several [all but charge_transfer]",
    )
    p.add_argument(
        "--reference-capacity-ah",
        type=float,
        metavar="X",
        help="measured apart from these logs: what SOC is judged over [the model's own]",
    )
    p.add_argument("-o", "--output", metavar="MODEL2", help="the model with the causes known")
    p.add_argument("--corrected", metavar="DIR", help="folder for logs without the sensors' faults")
    page_options.add_page_options(p)
    log_options.add_log_options(p)
    printing.add_json(p)
    p.set_defaults(run=run_diagnose)


def run_diagnose(arguments: argparse.Namespace) -> None:
    """Diagnose, write what was asked for, print the verdict."""
    from cellwise.cell.simulate import check_soc0
    from cellwise.diagnose import diagnose

    _check_places(arguments)
    soc0 = log_options.parse_soc0(arguments.soc0)
    if soc0 is not None:
        check_soc0(soc0)
    from cellwise.logs.checks.grave import graves_first, is_grave

    model = model_options.read(arguments)
    logs, holdout, baseline = (
        [log_options.read(path, arguments) for path in paths]
        for paths in (arguments.logs, arguments.holdout, arguments.baseline)
    )
    began = time.perf_counter()
    with printing.bar() as progress:
        task = progress.add_task("diagnose", total=1.0)
        found = diagnose(
            model,
            logs,
            holdout,
            baseline,
            "auto" if soc0 is None else soc0,
            causes=arguments.cause,
            reference_capacity_Ah=arguments.reference_capacity_ah,
            progress=lambda share, what: progress.update(task, completed=share, description=what),
        )
    seconds = time.perf_counter() - began
    written = _write(found, arguments)
    notices = graves_first([n for log in (*logs, *holdout, *baseline) for n in log.notices])
    if arguments.json:
        printing.print_json({**found.to_dict(), **written, "seconds": seconds, "notices": notices})
        return
    for notice in filter(is_grave, notices):
        printing.say(f"  ! {notice}")
    print_diagnosis(found)
    for name, place in written.items():
        for path in place if isinstance(place, list) else [place] if place else []:
            printing.say(f"{name.replace('_', ' ')}: {path}")
    if arguments.output and written["extended_model"] is None:
        printing.say(f"no cause was accepted: '{arguments.output}' was not written")


def _check_places(arguments: argparse.Namespace) -> None:
    """Refuse what could only fail after the work is done."""
    printing.check_places(arguments.output)
    page_options.check_page_options(arguments)
    if arguments.corrected and Path(arguments.corrected).is_file():
        raise InputError(
            f"a file at '{arguments.corrected}'", "a folder for the corrected logs", "Rename it."
        )
    seen = {_place(p) for p in arguments.logs}
    for path in (*arguments.holdout, *arguments.baseline):
        if _place(path) in seen:
            raise InputError(
                f"'{path}' both as LOG and as --holdout or --baseline",
                "logs that the fit has not seen",
                "Give another log, or leave it out: later parts of LOG are held out then.",
            )


def _place(text: str) -> Path:
    """Where a log lies, whatever is stated of it."""
    from cellwise.logs import Stated

    return Path(Stated.parse(text).path).resolve()


def _write(found: Diagnosis, arguments: argparse.Namespace) -> dict[str, Any]:
    """Write model, logs and page; where they are."""
    from cellwise.cell.model_file import write_model

    extended: CellModel | None = found.extended_model
    written: dict[str, Any] = {"extended_model": None, "corrected": [], "report": None}
    with page_options.page_places(arguments) as places:
        if places is not None:
            from cellwise.report.diagnosis.page import diagnose_page

            diagnose_page(found, places.page, figures=places.figures)
    if arguments.report:
        written["report"] = arguments.report
    if arguments.corrected and any(c.kind == "measurement" for c in found.causes):
        written["corrected"] = _write_logs(found.corrected, arguments.logs, arguments.corrected)
    if arguments.output and extended is not None:
        write_model(extended, arguments.output)
        written["extended_model"] = arguments.output
    return written


def _write_logs(logs: tuple[CellLog, ...], sources: list[str], folder: str) -> list[str]:
    from cellwise.logs import write_log

    place = made_folder(folder, "the corrected logs")
    names: list[str] = []
    for log, source in zip(logs, sources, strict=True):
        name = stem = _place(source).name.split(".")[0]
        while name in names:
            name = f"{stem}_{len(names) + 1}"
        names.append(name)
        write_log(log, place / f"{name}.parquet")
    return [str(place / f"{name}.parquet") for name in names]


def print_diagnosis(found: Diagnosis) -> None:
    """A diagnosis for people."""
    from cellwise.report.diagnosis.statements import diagnosis_finding

    printing.say(f"verdict: {found.verdict}\n{diagnosis_finding(found)}\n")
    printing.table("every log", LOG_HEAD, [_log_row(r) for r in found.runs])
    if found.causes:
        head = ("cause", "corrects", "value (95 %)", "held-out RMSE mV", "gain (95 %)")
        printing.table("what was found", head, [_cause_row(c) for c in found.causes])
        for c in found.causes:
            printing.say(f"  {c.name}: {c.meaning}")
            for line in c.evidence:
                printing.say(f"    {line}")
            if c.confusable_with:
                printing.say(f"    easily confused with {', '.join(c.confusable_with)}")
    rows = [
        (
            c.name,
            "-" if c.score != c.score else f"{c.score:.0f}",
            printing.millivolt(c.holdout_rmse_V),
            ", ".join(f"{k} {v:.4g}" for k, v in list(c.parameters.items())[:2]),
        )
        for c in found.candidates[:SHOWN]
    ]
    if rows:
        columns = ("first candidates", "score (nats)", "held-out RMSE mV", "parameters")
        printing.table("what was tried", columns, rows)
    if found.competing:
        weighed = [
            (", ".join(w.causes) or "none", f"{printing.percent(w.probability, 0)} %")
            for w in found.competing
        ]
        printing.table("what competes", ("explanation", "probability"), weighed)
    for group in found.inseparable:
        printing.say(f"  - not separable by these logs: {', '.join(group)}")
    for reason in found.reasons:
        printing.say(f"  - {reason}")
    if found.soc_gain and "soc_rmse_before" in found.soc_gain:
        before, after = (found.soc_gain[f"soc_rmse_{k}"] for k in ("before", "after"))
        printing.say(
            f"SOC RMSE of the EKF: {printing.percent(before)} % before, "
            f"{printing.percent(after)} % after, over "
            f"{found.soc_gain['reference_capacity_Ah']:.4g} Ah: {found.soc_gain['reference']}"
        )
    elif found.no_soc_gain:
        printing.say(f"no gain in SOC is claimed: {found.no_soc_gain}")
    if found.next_test:
        printing.say(f"next test: {found.next_test}")


def _log_row(run: LogRun) -> tuple[str, ...]:
    corrected = run.corrected
    return (
        run.log.name or "log",
        "held out" if run.used == "holdout" else "fitted",
        f"{run.before.soc0:.3f}",
        printing.millivolt(run.before.metrics.rmse_V),
        printing.millivolt(run.after.metrics.rmse_V),
        "" if corrected is None else printing.millivolt(corrected.metrics.rmse_V),
    )


def _cause_row(c: FoundCause) -> tuple[str, ...]:
    values = []
    for name, value in list(c.parameters.items()):
        low, high = c.ci95.get(name, (float("nan"), float("nan")))
        values.append(f"{name} {value:.4g} ({low:.4g} to {high:.4g})")
    low, high = c.gain_ci95
    return (
        c.name,
        {"cell": "the model", "start": "the initial SOC"}.get(c.kind, "the log"),
        "\n".join(values),
        f"{printing.millivolt(c.holdout_rmse_before_V)} -> "
        f"{printing.millivolt(c.holdout_rmse_after_V)}",
        f"{printing.percent(c.gain, 0)} % ({printing.percent(low, 0)} to "
        f"{printing.percent(high, 0)})",
    )
