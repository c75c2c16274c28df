"""Files of sketches to causes, as `cellwise diagnose --sketch` takes them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.cell.model import CellModel
from cellwise.diagnose.sketched import SketchDiagnosis, diagnose_sketch
from cellwise.errors import InputError
from cellwise.estimate.sketch.stored import read_sums


class SketchFiles(NamedTuple):
    """What files show (``found``), and what each of them is of (``sketches``), as JSON values."""

    found: SketchDiagnosis
    sketches: list[dict[str, Any]]


def diagnose_sketch_files(model: CellModel, files: Sequence[str]) -> SketchFiles:
    """Diagnose sketches of one cell; the first, of several, is of when it was good.

    Raises
    ------
    InputError        no such file, no sketch, other tables
    """
    sums = []
    for file in files:
        if not Path(file).is_file():
            raise InputError(f"no file '{file}'", "bytes of a sketch", "Correct the path.")
        sums.append(read_sums(Path(file).read_bytes(), file))
    found = diagnose_sketch(model, sums[0] if len(sums) > 1 else None, sums[1:])
    heads = [{"file": file, **one.head()} for file, one in zip(files, sums, strict=True)]
    return SketchFiles(found, heads)
