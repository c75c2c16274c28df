"""Files of sketches to causes, and the pictures that a model needs for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.cell.model import CellModel
from cellwise.diagnose.sketch_pictures import make_pictures
from cellwise.diagnose.sketched import (
    FleetDiagnosis,
    SketchDiagnosis,
    diagnose_fleet,
    without_details,
)
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import FixedStep, median_interval_s
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.sketch.sketcher import Sketcher, means_of
from cellwise.estimate.sketch.stored import SketchSums, read_sums, sketch_bytes
from cellwise.files import write_atomically
from cellwise.identify import Identification
from cellwise.logs.cell_log import CellLog
from cellwise.wording import arg
from cellwise.workflows.patching import check_tables, patch_from_sketch

KEEPERS = ("fixed-step", "firmware")
MOST_BYTES = 1024  # the larger of the two sketches


class SketchFiles(NamedTuple):
    """What files show (``found``), and what each of them is of (``sketches``), as JSON values.

    ``last`` are the sums of each target's last file, by its number.
    """

    found: FleetDiagnosis
    sketches: list[dict[str, Any]]
    last: Mapping[int, SketchSums]

    @property
    def shown(self) -> SketchDiagnosis:
        """Of all, or of the one target that there is."""
        units = self.found.units
        return self.found.common or next(iter(units.values()))

    def to_dict(self) -> dict[str, Any]:
        """As JSON values: the keys of a diagnosis; of several targets ``cells`` beside them."""
        cells = [
            {"unit": unit, **without_details(one).to_dict()}
            for unit, one in self.found.units.items()
        ]
        return {**self.shown.to_dict(), "cells": cells, "sketches": self.sketches}


def read_block(file: str) -> bytes:
    """The bytes of a sketch in a file.

    Raises
    ------
    InputError        no such file, no sketch
    """
    if not Path(file).is_file():
        raise InputError(f"no file '{file}'", "bytes of a sketch", "Correct the path.")
    block = Path(file).read_bytes()
    read_sums(block, file)
    return block


def diagnose_sketch_files(model: CellModel, files: Sequence[str]) -> SketchFiles:
    """Diagnose sketches of targets; those of one target in order of time.

    Raises
    ------
    InputError        no such file, no sketch, other tables; a model without pictures
    """
    units: dict[int, list[SketchSums]] = {}
    heads = []
    for file in files:
        sums = read_sums(read_block(file), file)
        units.setdefault(sums.unit, []).append(sums)
        heads.append({"file": file, **sums.head()})
    last = {unit: of[-1] for unit, of in units.items()}
    return SketchFiles(diagnose_fleet(model, units), heads, last)


def write_patches(
    files: SketchFiles,
    place: str,
    model: CellModel,
    generation: int = 1,
    tables: FixedStepTables | None = None,
) -> dict[int, dict[str, str | None]]:
    """A patch for every target that has a cause, at ``place``; of several with its number there.

    A sketch says of which tables it is; with ``tables`` it has to be of these.

    Returns
    -------
    dict        by target ``patch``, where it was written; else None and why (``no_patch``)

    Raises
    ------
    InputError        sketches of other tables than these
    """
    if tables is not None:
        check_tables(files.last.values(), tables)
    written: dict[int, dict[str, str | None]] = {}
    for unit, sketch in files.last.items():
        found, path = files.found.units[unit], Path(place)
        if len(files.last) > 1:
            path = path.with_stem(f"{path.stem}_{unit}")
        try:
            block = patch_from_sketch(found, sketch, model, generation)
        except InputError as error:  # said beside what was found
            written[unit] = {"patch": None, "no_patch": str(error.found)}
            continue
        write_atomically(path, block)
        written[unit] = {"patch": str(path)}
    return written


def keep_sketch(
    model: CellModel,
    estimator: str,
    logs: Sequence[CellLog],
    soc0: float | None = None,
    dt_s: float | None = None,
    before: bytes | None = None,
) -> bytes:
    """What a target with a sketch would keep after these logs, each begun after a rest.

    Parameters
    ----------
    estimator : str             fixed-step, or firmware for the compiled C: the same bytes
    logs : sequence of CellLog  of one target, one after the other, with a temperature
    soc0 : float or None        where each log begins; None: as it is stated of the log
    dt_s : float or None        the target's period, over which samples are means; None: the first
                                log's median interval
    before : bytes or None      an earlier sketch of the same target, which goes on

    Raises
    ------
    InputError        another estimator; no SOC at a start; a sketch of other tables, or none
    """
    check_keeper(estimator)
    if soc0 is None and any(log.soc0 is None for log in logs):
        raise InputError(
            "a sketch of a log whose initial SOC nobody stated",
            "where it begins: a sketch simulates from a SOC that is known",
            "Give " + arg("soc0", letter="SOC") + ".",
        )
    period_s = median_interval_s(logs[0]) if dt_s is None else dt_s
    most = MOST_BYTES if before is None else sketch_bytes(before)
    sketcher = Sketcher(make_kept(estimator, model, period_s, most))
    sketch = sketcher.begin() if before is None else sketcher.resumed(before)
    for log in logs:
        sketcher.run(means_of(log, period_s), soc0, sketch)
    return sketcher.bytes_of(sketch)


def check_keeper(estimator: str) -> None:
    """Refuse an estimator that keeps no sketch.

    Raises
    ------
    InputError        as said
    """
    if estimator not in KEEPERS:
        raise InputError(
            f"a sketch of estimator '{estimator}'",
            " or ".join(KEEPERS),
            "Give " + arg("estimator", KEEPERS[0]) + ".",
        )


def make_kept(estimator: str, model: CellModel, period_s: float, most: int) -> FixedStep:
    """The filter beside which a sketch of at most so many bytes is kept."""
    if estimator == "fixed-step":
        return FixedStep(model, dt_s=period_s, sketch=most)
    from cellwise.export.firmware import Firmware  # needs a C compiler

    return Firmware(model, dt_s=period_s, sketch=most)


def with_pictures(found: Identification) -> Identification:
    """An identification whose model knows how causes look in sketches of its own drives.

    Raises
    ------
    InputError        no log under load that took part
    """
    used = [o for o in found.own_logs if o.used]
    taken = [o for o in used if o.role == "drive"] or [o for o in used if o.role == "hppc"]
    logs = [replace(o.simulation.log, soc0=o.simulation.soc0) for o in taken]
    return replace(found, model=make_pictures(found.model, logs))
