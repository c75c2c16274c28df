"""Model and logs to what is wrong, and by how much.

cellwise diagnose: model and logs to what is wrong, and by how much
    requires a model and a log, or sketches; a second log shows what the finding gains
    $ diagnose --model cell.json odd.csv --holdout other.csv -o extended.json
    $ diagnose --model cell.json odd.csv --baseline healthy.csv --report found.html
<scaled model>
    LOG*  what is to be explained
    --sketch FILE+  instead of logs: what targets exported with --sketch kept; of one target the
        first while its cell was good, one each of a fleet; several
    --holdout LOG+  log on which gains are measured [later parts of the logs]; several
    --baseline LOG+  log of the same cell and instruments that is known to be good; several
    --soc0 SOC=auto  of logs without LOG@soc0=X: 0..1, or auto
    --cause C...  try only this cause; several [all but charge_transfer]
    --reference-capacity-ah X  measured apart from these logs: what SOC is judged over [the
        model's own]
    -o, --output MODEL2  the model with the causes known; with --sketch the patch
    --corrected DIR  folder for logs without the sensors' faults
    --patch FILE  what a target takes of the causes without new tables, for the --export; of
        several targets one each, with its number before the ending
    --export DIR  folder that `cellwise export --health` wrote of the model
    --generation N=1  of the patch: a target takes none that is older
<page>
<log options>
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cell.model_file import write_model
from cellwise.cli.common import log_options, options, page_options, printing
from cellwise.diagnose import diagnose
from cellwise.diagnose.result import Diagnosis, FoundCause
from cellwise.diagnose.sketch_pictures import pictures_in
from cellwise.diagnose.sketched import SketchCause
from cellwise.errors import InputError
from cellwise.files import made_folder, write_atomically
from cellwise.logs import CellLog, write_log
from cellwise.logs.stated import logs_of
from cellwise.notices import critical_first
from cellwise.report.page.markup import MOST
from cellwise.workflows.sketches import diagnose_sketch_files, write_patches

if TYPE_CHECKING:
    from cellwise.benchmark.certify.exported import Exported

# What only goes with logs.
OF_LOGS = ("logs", "holdout", "baseline", "report", "corrected", "cause")


def run_diagnose(arguments: argparse.Namespace) -> None:
    """Diagnose, write what was asked for, print the verdict."""
    _check_places(arguments)
    if arguments.sketch or not arguments.logs:
        run_sketches(arguments)
        return
    soc0 = options.soc0_of(arguments)
    model = options.read_model(arguments)
    logs, holdout, baseline = (
        log_options.read_cut(paths, arguments)
        for paths in (arguments.logs, arguments.holdout, arguments.baseline)
    )
    exported = _exported(arguments)
    began = time.perf_counter()
    with printing.working("diagnose") as follow:
        found = diagnose(
            model,
            logs,
            holdout,
            baseline,
            soc0,
            causes=arguments.cause or None,
            reference_capacity_Ah=arguments.reference_capacity_ah,
            progress=lambda share, what: follow(what, share),
        )
    seconds = time.perf_counter() - began
    written = _write(found, arguments, exported)
    notices = critical_first(
        [*found.notices, *(n for log in (*logs, *holdout, *baseline) for n in log.notices)]
    )
    if arguments.json:
        said = {"seconds": seconds, "notices": printing.rendered(notices)}
        printing.print_json({**found.to_dict(), **written, **said})
        return
    printing.say_notices(n for n in notices if n.is_critical)
    print_diagnosis(found)
    if "no_patch" in written:
        printing.say(f"no patch: {written.pop('no_patch')}")
    for name, place in written.items():
        for path in place if isinstance(place, list) else [place] if place else []:
            printing.say(f"{name.replace('_', ' ')}: {path}")
    if arguments.output and written["extended_model"] is None:
        printing.say(f"no cause changes the model: '{arguments.output}' is as '{arguments.model}'")


def run_sketches(arguments: argparse.Namespace) -> None:
    """Diagnose what targets kept, write patches where they are asked for, and print it."""
    said = vars(arguments)
    others = [n for n in OF_LOGS if said[n]]
    if not arguments.sketch:
        typed = f"cellwise diagnose nmc_drive_a --model {arguments.model}"
        raise InputError("no LOG", "what is to be explained, or --sketch", f"Add it: {typed}.")
    if others:
        what = f"--sketch with {' and '.join(others)}"
        raise InputError(what, "logs, or --sketch FILE alone", "Give one or the other.")
    model = options.read_model(arguments)
    try:
        pictures_in(model)
    except InputError as error:
        run = "Identify it by cellwise identify --sketch ... -o MODEL."
        raise InputError(error.found, error.expected, run) from None
    exported = _exported(arguments)
    files = diagnose_sketch_files(model, arguments.sketch)
    written: dict[int, dict[str, str | None]] = {}
    place = arguments.patch or arguments.output
    if place:
        tables = None if exported is None else exported.stepper.tables
        written = write_patches(files, place, model, arguments.generation, tables)
    if arguments.json:
        shown = files.to_dict()
        for cell in shown["cells"]:
            cell |= written.get(cell["unit"], {})
        alone = next(iter(written.values())) if len(written) == 1 else {}
        printing.print_json({**shown, **alone})
        return
    found, units = files.shown, files.found.units
    of = f"what all {len(units)} targets have" if files.found.common else "verdict"
    printing.say(f"{of}: {found.verdict}\n")
    for reason in found.reasons:
        printing.say(f"  - {reason}")
    printing.record_table(
        "what was tried",
        found.candidates,
        ("cause", lambda c: c.name),
        ("probability", lambda c: f"{c.probability:.3f}"),
        ("value, were it alone (95 %)", lambda c: "\n".join(_values(c, c.parameters.items()))),
        ("would be named from", lambda c: _least(found.limits[c.name])),
    )
    own = [(str(u), one.verdict) for u, one in units.items() if one.verdict != "none"]
    if len(units) > 1:
        printing.table("what one target has", ("target", "verdict"), own)
    for unit, one in written.items():
        of_one = f" of target {unit}" if len(written) > 1 else ""
        if one["patch"] is not None:
            printing.say(f"patch{of_one}: {one['patch']}")
        elif units[unit].causes or not of_one:
            printing.say(f"no patch{of_one}: {one['no_patch']}")


def _least(limit: Mapping[str, float] | None) -> str:
    return "at no size" if limit is None else ", ".join(f"{k} {v:.3g}" for k, v in limit.items())


def _check_places(arguments: argparse.Namespace) -> None:
    """Refuse what could only fail after the work is done."""
    options.check_places(arguments.output, arguments.patch)
    if arguments.sketch and arguments.patch and arguments.output:
        what = "--patch and -o: with --sketch both are the patch"
        raise InputError(what, "one of them", "Leave one out.")
    if not arguments.sketch and (arguments.patch is None) != (arguments.export is None):
        raise InputError(
            "--patch without --export" if arguments.export is None else "--export without --patch",
            "both: a patch is of the tables of one export",
            "Add --export DIR, a folder that `cellwise export --health` wrote, and --patch FILE.",
        )
    page_options.check_page_options(arguments)
    if arguments.corrected and Path(arguments.corrected).is_file():
        raise InputError(
            f"a file at '{arguments.corrected}'", "a folder for the corrected logs", "Rename it."
        )
    seen = set(_files(arguments.logs))
    for path in (*arguments.holdout, *arguments.baseline):
        if seen.intersection(_files([path])):
            raise InputError(
                f"'{path}' both as LOG and as --holdout or --baseline",
                "logs that the fit has not seen",
                "Give another log, or leave it out: later parts of LOG are held out then.",
            )


def _files(paths: list[str]) -> list[Path]:
    """The files that paths mean, whatever is stated of them."""
    return [Path(one.path).resolve() for path in paths for one in logs_of(path).logs]


def _write(
    found: Diagnosis, arguments: argparse.Namespace, exported: Exported | None
) -> dict[str, Any]:
    """Write model, logs and page; where they are."""
    written: dict[str, Any] = {"extended_model": None, "corrected": [], "report": None}
    with page_options.page_places(arguments) as pages:
        if pages is not None:
            from cellwise.report.diagnosis.page import diagnose_page

            diagnose_page(found, pages.page, figures=pages.figures)
    if arguments.report:
        written["report"] = arguments.report
    if arguments.corrected and any(c.kind == "measurement" for c in found.causes):
        written["corrected"] = _write_logs(found.corrected, arguments.corrected)
    if exported is not None:
        from cellwise.workflows.patching import patch_for

        target = exported.model, exported.stepper.tables
        try:
            write_atomically(arguments.patch, patch_for(found, *target, arguments.generation))
            written["patch"] = arguments.patch
        except InputError as error:  # said beside what was found
            written |= {"patch": None, "no_patch": str(error.found)}
    if arguments.output:
        # The next command reads it either way: where no cause changes the model it stays as it is.
        write_model(found.extended_model or found.model, arguments.output)
        written["extended_model"] = arguments.output if found.extended_model else None
    return written


def _exported(arguments: argparse.Namespace) -> Exported | None:
    """What a patch is for; None where none is asked for.

    Raises
    ------
    InputError        no such folder, or exported without health
    """
    if arguments.export is None:
        return None
    from cellwise.benchmark.certify.exported import read_export

    exported = read_export(arguments.export)
    exported.stepper.need("health")
    return exported


def _write_logs(logs: tuple[CellLog, ...], folder: str) -> list[str]:
    place = made_folder(folder, "the corrected logs")
    names: list[str] = []
    for log in logs:
        name = stem = (Path(log.source).name or log.name or "log").split(".")[0]
        while name in names:
            name = f"{stem}_{len(names) + 1}"
        names.append(name)
        write_log(log, place / f"{name}.parquet")
    return [str(place / f"{name}.parquet") for name in names]


def print_diagnosis(found: Diagnosis) -> None:
    """A diagnosis for people: what to do, what is unsure, the figures, and how it was found."""
    from cellwise.report.diagnosis import statements

    printing.say_notices(found.notices)
    printing.say(f"verdict: {found.verdict}\n{statements.diagnosis_finding(found)}\n")
    if found.next_test:
        printing.say(f"measure next: {found.next_test}")
    for line in statements.unsure_lines(found):
        printing.say(f"  - {line}")
    gain = found.soc_gain
    if gain is not None:
        printing.say(
            f"SOC RMSE of the EKF on {gain['log'] or 'the log'}: "
            f"{printing.percent(gain['soc_rmse_before'])} % before, "
            f"{printing.percent(gain['soc_rmse_after'])} % after, over "
            f"{gain['reference_capacity_Ah']:.4g} Ah: {gain['reference']}"
        )
    print_figures(found)
    for reason in found.reasons:
        printing.say(f"  - {reason}")
    for c in found.causes:
        printing.say(f"  {c.name}: {c.meaning}")
        for line in c.evidence:
            printing.say(f"    {line}")
        if c.confusable_with:
            printing.say(f"    easily confused with {', '.join(c.confusable_with)}")
    for c in found.causes:
        if usual := set(c.prior_only) - {k for k, _ in statements.shown_parameters(c)}:
            folded = ((k, v) for k, v in c.parameters.items() if k in usual)
            printing.say(f"  {c.name}, of which these logs say no more than is usual:")
            printing.say("\n".join(f"    {line}" for line in _values(c, folded)))


def print_figures(found: Diagnosis) -> None:
    """Every log, the causes, what was tried, what competes."""
    from cellwise.report.diagnosis import page, statements

    millivolt, percent = printing.millivolt, printing.percent
    printing.record_table("every log", found.runs, *page.run_columns(bool(found.causes)))
    if found.causes:
        corrects = {"cell": "the model", "start": "the initial SOC"}
        printing.record_table(
            "what was found",
            found.causes,
            ("cause", lambda c: c.name),
            ("probability", lambda c: statements.probability(c.probability)),
            ("corrects", lambda c: corrects.get(c.kind, "the log")),
            ("value (95 %)", lambda c: "\n".join(_values(c, statements.shown_parameters(c)))),
            (
                "held-out RMSE mV",
                lambda c: (
                    f"{millivolt(c.holdout_rmse_before_V)} -> {millivolt(c.holdout_rmse_after_V)}"
                ),
            ),
            (
                "gain (95 %)",
                lambda c: (
                    f"{percent(c.gain, 0)} % ({percent(c.gain_ci95[0], 0)} to "
                    f"{percent(c.gain_ci95[1], 0)})"
                ),
            ),
        )
    if found.competing:
        printing.record_table(
            "what competes",
            statements.weights(found),
            ("explanation", lambda w: w[0]),
            ("probability", lambda w: w[1]),
        )
    if found.candidates:
        tried = found.candidates[: MOST.listed]
        printing.record_table("what was tried", tried, *page.TRIED_COLUMNS)


def _values(cause: FoundCause | SketchCause, parameters: Iterable[tuple[str, float]]) -> list[str]:
    """Parameters with their intervals, a line each."""
    lines = []
    for name, value in parameters:
        low, high = cause.ci95.get(name, (float("nan"), float("nan")))
        lines.append(f"{name} {value:.4g} ({low:.4g} to {high:.4g})")
    return lines
