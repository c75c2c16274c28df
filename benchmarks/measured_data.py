"""Where the measured cells are: $CELLWISE_DATA, else the folder beside the project."""

from __future__ import annotations

import os
from pathlib import Path

from cellwise.logs import CellLog, read_log

REPOSITORY = Path(__file__).resolve().parents[1]
HOW = "set CELLWISE_DATA to the folder of the measured cells"


def data_folder() -> Path | None:
    """The folder, or None where there is none."""
    named = os.environ.get("CELLWISE_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    return folder if folder.is_dir() else None


def measured_log(folder: Path, name: str) -> CellLog:
    """A log by ``cell/test``."""
    return read_log(folder / f"{name}.csv.gz")
