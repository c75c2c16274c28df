"""A model as firmware and in other programs' formats, with what it costs and what it loses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.fixed.options import Asked
from cellwise.estimate.sensor import Sensor, seen_by
from cellwise.export.accuracy import FixedAndFloat, fixed_and_float, target_costs
from cellwise.export.package import Export, check_folder, write_package
from cellwise.export.voltage_table import SOURCES, write_voltage_forms
from cellwise.files import file_place
from cellwise.identify.ocv.voltage_only import read_voltage_table
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Notice, texts
from cellwise.wording import arg
from cellwise.workflows.starts import start_of

# What is written beside the folder of C, each by the module of its name.
FORMATS = {
    name: f"cellwise.export.{name}" for name in ("fmu", "page", "pybamm", "can", "submission")
}


@dataclass(frozen=True)
class ExportedFirmware:
    """What was written, its description as JSON, runs on the log that was given, and notices."""

    export: Export
    report: dict[str, Any]
    runs: tuple[FixedAndFloat, ...] = ()
    notices: tuple[Notice, ...] = ()

    @property
    def own_run(self) -> FixedAndFloat | None:
        """The run with the SOC points of the export; None without a log."""
        points = self.export.tables.options.points
        return next((run for run in self.runs if run.points == points), None)


def firmware_of(
    model: CellModel,
    dt_s: float | None,
    asked: Asked | None = None,
    *,
    without: Sequence[str] = (),
    noise: Mapping[str, float] | None = None,
    sensor: Sensor | None = None,
    **more: Any,
) -> Export:
    """A model made ready for a target.

    Parameters
    ----------
    dt_s : float or None     time step of the target [s]
    asked : Asked            what is compiled in
    without : sequence of str        effects of the model that are left out
    noise : mapping          fields of `Noise` and their values, in place of the model's
    sensor : Sensor or None  what the target's sensors are off by; None: as a car's
    more                     other fields of `Export`: ``cells``, ``prefix``, ``layout``, ``what``

    Raises
    ------
    InputError        an effect that the model does not have; as `Noise` and `Export`
    """
    model = without_effects(model, without)
    stated: dict[str, Any] = dict(noise or {})
    filtered = replace(seen_by(model, sensor).noise, **stated)
    return Export(model, dt_s, filtered, asked or Asked(), sensor=sensor, **more)


def without_effects(model: CellModel, names: Sequence[str]) -> CellModel:
    """The model without some of its effects.

    Raises
    ------
    InputError        an effect that it does not have
    """
    there = {effect.name: effect for effect in model.effects}
    for name in names:
        if name not in there:
            expected = f"an effect of the model: {', '.join(there) or 'it has none'}"
            raise InputError(
                arg("without", letter=name), expected, "Leave it out, or correct its name."
            )
    kept = tuple(effect for name, effect in there.items() if name not in names)
    return replace(model, effects=kept) if names else model


def check_export(folder: str | Path | None, formats: Mapping[str, str]) -> None:
    """Refuse what could only fail after the work is done.

    Parameters
    ----------
    folder : str, Path or None     of C sources
    formats : mapping              names of ``FORMATS``, each to the file that is written

    Raises
    ------
    InputError        a folder that is in use; a suffix of another format; no place; a package or a
                      compiler that is missing
    """
    if folder:
        check_folder(Path(folder))
    for name, place in formats.items():
        file_place(place)
        module = import_module(FORMATS[name])
        if not place.lower().endswith(module.SUFFIXES):
            ends = " or ".join(module.SUFFIXES)
            raise InputError(arg(name, letter=place), f"a name that ends in {ends}", "Name it so.")
        module.check(place)


def export_firmware(
    export: Export,
    folder: str | Path | None = None,
    log: CellLog | None = None,
    *,
    soc0: float | None = None,
    formats: Mapping[str, str] | None = None,
    follow: Callable[[str], object] = lambda _: None,
) -> ExportedFirmware:
    """Write a model as C sources and in other formats, counted and compared with the float64 EKF.

    Parameters
    ----------
    export : Export
    folder : str, Path or None    new folder of C sources; None: other formats alone
    log : CellLog or None         to count and compare on; None: no comparison
    soc0 : float or None          SOC at the log's start; None: as stated of it, or as it shows
    formats : mapping             names of ``FORMATS``, each to the file that is written
    follow : callable             what is being done

    Returns
    -------
    ExportedFirmware              its ``report`` is what ``cellwise export`` prints

    Raises
    ------
    InputError        as `check_export`; a start other than the log's stated one
    """
    check_export(folder, formats or {})
    report = export.description
    written, said = _write_formats(export, formats or {})
    report |= {"sockets": written, "notices": texts(said)}
    if not folder:
        return ExportedFirmware(export, report, notices=tuple(said))
    follow("counting instructions")
    report["targets"] = target_costs(export, log, follow)
    runs = () if log is None else tuple(_beside_float64(export, log, soc0))
    report["accuracy"] = [run.to_dict() for run in runs]
    report["files"] = write_package(export, Path(folder), report)
    return ExportedFirmware(export, report, runs, tuple(said))


def export_voltage_table(table: str | Path, folder: str | Path) -> dict[str, str]:
    """Write a table of remaining time in every form; each file with the page that describes it.

    Raises
    ------
    InputError        no such table; a folder that is in use
    """
    files = write_voltage_forms(read_voltage_table(table), folder)
    return {name: SOURCES.get(name, "") for name in files}


def _write_formats(
    export: Export, formats: Mapping[str, str]
) -> tuple[dict[str, str], list[Notice]]:
    """The places that were written, by format, and what to know of them."""
    written: dict[str, str] = {}
    said: list[Notice] = []
    for name, place in formats.items():
        places, notices = import_module(FORMATS[name]).write(export, place)
        written[name] = ", ".join(map(str, places))
        said += notices
    return written, said


def _beside_float64(export: Export, log: CellLog, soc0: float | None) -> list[FixedAndFloat]:
    """What is exported and the float64 EKF on the log, by number of SOC points."""
    if export.dt_s is None:
        raise InputError("no time step", "that of the target", "Give " + arg("dt_s", 1) + ", say.")
    return fixed_and_float(
        export.seen.model,
        log,
        export.dt_s,
        soc0=start_of(log.soc0, soc0),
        lean=not export.asked.wide,
        points=export.tables.options.points,
        noise=export.seen.noise,
    )
