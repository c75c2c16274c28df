"""Cases on disk: their logs, what was told, what was changed; models of their cells."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from cellwise import CellModel, read_log, read_model, write_log
from cellwise.logs.cell_log import CellLog


@dataclass(frozen=True, eq=False)
class Case:
    """Logs of a cell, and the truth. ``told``: SOC at the start of each log, None: nobody knows."""

    seed: int
    kind: str
    cell: str
    changes: tuple[str, ...]
    sizes_V: tuple[float, ...]
    told: tuple[float, ...] | None
    told_baseline: float | None
    logs: tuple[CellLog, ...]
    holdout: tuple[CellLog, ...]
    baseline: tuple[CellLog, ...]

    @property
    def soc0(self) -> list[float] | None:
        """Starts as `diagnose` takes them: logs, held-out logs, baseline."""
        if self.told is None or self.told_baseline is None:
            return None
        return [*self.told, *(self.told_baseline for _ in self.baseline)]

    @property
    def label(self) -> str:
        """For people."""
        what = " + ".join(self.changes) or "nothing"
        sizes = ", ".join(f"{1e3 * s:.1f}" for s in self.sizes_V)
        return f"seed {self.seed} {self.cell}: {what} ({sizes} mV)"


_GROUPS = ("logs", "holdout", "baseline")


def write_case(case: Case, folder: Path) -> None:
    """A folder with a parquet for each log and the truth beside them."""
    place = folder / f"{case.kind}_{case.seed}"
    place.mkdir(parents=True, exist_ok=True)
    for group in _GROUPS:
        for k, log in enumerate(getattr(case, group)):
            write_log(log, place / f"{group}_{k}.parquet")
    plain = ("seed", "kind", "cell", "changes", "sizes_V", "told", "told_baseline")
    record = {name: getattr(case, name) for name in plain}
    record |= {group: len(getattr(case, group)) for group in _GROUPS}
    (place / "case.json").write_text(json.dumps(record, indent=1) + "\n")


def read_cases(folder: Path) -> list[Case]:
    """Every case of a folder, by name."""
    return [read_case(place.parent) for place in sorted(folder.glob("*/case.json"))]


def read_case(place: Path) -> Case:
    record = json.loads((place / "case.json").read_text())
    for group in _GROUPS:
        paths = [place / f"{group}_{k}.parquet" for k in range(record[group])]
        record[group] = tuple(read_log(path) for path in paths)
    for name in ("changes", "sizes_V"):
        record[name] = tuple(record[name])
    return Case(**record)


def model_of(folder: Path, cell: str) -> CellModel:
    """The model that was identified on the cell's laboratory tests."""
    return read_model(folder / "cells" / cell / "model.json")
