"""What a fleet keeps on disk: result columns, parts of parquet, and logs that were read before."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.errors import InputError, MachineError
from cellwise.files import made_folder, write_atomically
from cellwise.logs.cell_log import CHANNELS, CellLog
from cellwise.logs.reading import read_log
from cellwise.logs.writing import read_rows, write_rows
from cellwise.notices import Code, Notice, from_json, to_json
from cellwise.wording import arg

BY_LOG, BY_MACHINE, BY_US = "log", "machine", "cellwise"  # whose fault a failure is
INTERNAL = "internal error"


def failure(error: Exception) -> dict[str, Any]:
    """Columns of a log that could not be finished: what happened, and whose fault it is.

    A failure of the machine (no space, no memory, a disk or network that does not answer) is none
    of the log: it is tried again when the run goes on.
    """
    if isinstance(error, MachineError):
        return {"error": error.text, "failed_by": BY_MACHINE}
    if isinstance(error, InputError):
        return {"error": error.text, "failed_by": BY_LOG}
    if isinstance(error, (OSError, MemoryError)):
        said = getattr(error, "strerror", None) or str(error) or "out of memory"
        return {"error": f"{type(error).__name__}: {said}", "failed_by": BY_MACHINE}
    return {"error": f"{INTERNAL}, {type(error).__name__}: {error}", "failed_by": BY_US}


def typed(*, texts: str = "", whole: str = "", numbers: str = "") -> dict[str, type]:
    """Names of columns, between blanks, to their types."""
    return {
        **dict.fromkeys(texts.split(), str),
        **dict.fromkeys(whole.split(), int),
        **dict.fromkeys(numbers.split(), float),
    }


# Which log this is, and whether it is done; `log` is the path below the fleet's folder.
IDENTITY = typed(texts="log cell error failed_by", whole="bytes modified_ns", numbers="seconds")
LOG = typed(texts="format sign notices", whole="samples gaps", numbers="duration_s")
REPLAY: Mapping[str, type] = {
    **IDENTITY,
    **LOG,
    **typed(texts="estimator soc0_how", whole="status", numbers="soc0 soc0_std"),
    **typed(numbers="soc_final soc_final_std soc_min soc_max soc_rmse soc_mae soc_max_error"),
    **typed(numbers="convergence_s settled_rmse coverage_2sigma nis_mean voltage_rmse_V"),
    **typed(numbers="rejected_share ns_per_step offset_A offset_std_A capacity_Ah"),
    **typed(numbers="capacity_std_Ah resistance_scale soh_capacity soh_resistance"),
}
DIAGNOSE: Mapping[str, type] = {
    **IDENTITY,
    **LOG,
    **typed(texts="verdict causes parameters next_test"),
    **typed(numbers="gain gain_low gain_high rmse_before_V rmse_after_V"),
}
# Of a folder of logs: one pack's or one cell's, in order.
FOLDER = IDENTITY | typed(texts="unread notices", whole="logs samples")
PACK: Mapping[str, type] = {
    **FOLDER,
    **typed(whole="cells", numbers="soc_min soc_mean soc_max capacity_min_Ah capacity_mean_Ah"),
    **typed(numbers="capacity_std_Ah resistance_max usable_Ah usable_Wh left_Ah"),
    **typed(texts="weakest_by_soc weakest_by_capacity weakest_by_resistance weak causes"),
    **typed(numbers="balancing_gain_Ah voltage_rmse_V"),
}
HISTORY: Mapping[str, type] = {
    **FOLDER,
    **typed(texts="first_day last_day knee next_reference"),
    **typed(numbers="throughput_Ah capacity_share capacity_Ah capacity_std_Ah"),
    **typed(numbers="resistance_scale resistance_std"),
}

VERSION = 8  # of a log that is kept
KEPT = ("name", "format", "current_meaning", "series", "parallel")


def read_prepared(path: Path, cache: str | Path = "", **options: Any) -> CellLog:
    """`read_log` of a file, from the cache if it is there and the file is the same.

    Parameters
    ----------
    path : Path
    cache : str or Path     folder of prepared logs; empty: none
    options                 of `read_log`; without a cache the sign is not checked, for the
                            sake of speed

    Raises
    ------
    InputError              as `read_log`
    """
    if not cache:
        return read_log(path, check_sign=False, **options)
    place = Path(cache) / f"{_key(path, options)}.npy"
    # None is there, or one that is not whole.
    with suppress(OSError, EOFError, KeyError, TypeError, ValueError), place.open("rb") as file:
        rows = np.load(file)
        said = json.load(file)
        channels = dict(zip(said.pop("channels"), rows, strict=True))
        said["notices"] = tuple(map(from_json, said["notices"]))
        return CellLog(**channels, **said, source=str(path))
    log = read_log(path, **options)
    try:
        made_folder(cache)
        write_atomically(place, lambda target: _keep(log, target))
    except MachineError as error:
        # What is wrong with the cache is not wrong with the log.
        noted = Notice(Code.NOT_CACHED, "not kept in the cache: " + error.found)
        return log.with_notices((*log.notices, noted))
    return log


def _key(path: Path, options: dict[str, Any]) -> str:
    """A name that changes with the file, and with how it is read."""
    with suppress(OSError):
        status = path.stat()
        what = [VERSION, str(path.absolute()), status.st_size, status.st_mtime_ns]
        text = json.dumps([*what, sorted(options.items())], default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:24]
    return "none"


def _keep(log: CellLog, target: Path) -> None:
    """The channels as one array, and what is known beside them below it."""
    names = [field for field in CHANNELS if getattr(log, field) is not None]
    said = {name: getattr(log, name) for name in KEPT}
    said["notices"] = list(map(to_json, log.notices))
    with target.open("wb") as file:
        np.save(file, np.stack([getattr(log, name) for name in names]))
        file.write(json.dumps(said | {"channels": names}).encode())


MANIFEST = "_fleet.json"
PART = "part-{:06d}.parquet"


def all_rows(place: Path) -> dict[str, list[Any]]:
    """The rows of all parts of a folder of results, column by column."""
    rows: dict[str, list[Any]] = {}
    for part in sorted(place.glob("part-[0-9]*.parquet")):
        for name, values in read_rows(part).items():
            rows.setdefault(name, []).extend(values)
    return rows


class ResultFolder:
    """Parts appear whole or not at all, so whatever ends a run leaves only finished rows.

    Parameters
    ----------
    place : Path
    columns : mapping       name to type, the same in every part
    settings : mapping      JSON values that must be the same when a run goes on
    fresh : bool            start again: drop the parts of another run

    Raises
    ------
    InputError              a folder of something else, or of a run with other settings; a place
                            that cannot be written to
    """

    def __init__(
        self,
        place: Path,
        columns: Mapping[str, type],
        settings: Mapping[str, Any],
        *,
        fresh: bool = False,
    ) -> None:
        self.place = place
        self._columns = columns
        self._settings = dict(settings)
        self._check(fresh)
        self._next = 0

    def begin(self) -> None:
        """Make the folder, if it is not there."""
        made_folder(self.place, "the results")
        text = json.dumps(self._settings, indent=1, sort_keys=True)
        write_atomically(self.place / MANIFEST, text)
        self._next = 1 + max((int(p.stem[5:]) for p in self.parts()), default=-1)

    def parts(self) -> list[Path]:
        """The parts that are there."""
        return sorted(self.place.glob("part-[0-9]*.parquet"))

    def done(
        self, still: Mapping[str, tuple[int, int]], *, retry_failed: bool = False
    ) -> tuple[set[str], set[str]]:
        """Logs that have their row, and those of them whose row is an error.

        Rows of logs that have changed since are dropped, and those of which the machine failed.

        Parameters
        ----------
        still : mapping         log to its size and time of change now
        retry_failed : bool     drop the rows with an error too
        """
        found: set[str] = set()
        wrong: set[str] = set()
        for part in self.parts():
            rows = read_rows(part)
            by = rows.setdefault("failed_by", [None] * len(rows["log"]))
            keys = zip(rows["log"], rows["bytes"], rows["modified_ns"], strict=True)
            keep = [
                still.get(log) in (None, (size, changed))
                and not (retry_failed and error)
                and whose != BY_MACHINE
                for (log, size, changed), error, whose in zip(keys, rows["error"], by, strict=True)
            ]
            kept = {name: [v for v, k in zip(values, keep, strict=True) if k]
                    for name, values in rows.items()}  # fmt: skip
            found.update(kept["log"])
            wrong.update(
                log for log, error in zip(kept["log"], kept["error"], strict=True) if error
            )
            if not kept["log"]:
                part.unlink()
            elif not all(keep):
                write_rows(kept, self._columns, part)
        return found, wrong & set(still)

    def drop(self) -> None:
        """Take away what a run has written, and the folder if nothing else is in it."""
        for path in (*self.parts(), self.place / MANIFEST):
            path.unlink(missing_ok=True)
        with suppress(OSError):
            self.place.rmdir()

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """One more part."""
        rows = list(rows)
        if not rows:
            return
        table = {name: [row.get(name) for row in rows] for name in self._columns}
        write_rows(table, self._columns, self.place / PART.format(self._next))
        self._next += 1

    def _check(self, fresh: bool) -> None:
        place = self.place
        if place.exists() and not place.is_dir():
            raise InputError(f"a file at '{place}'", "a folder", "Name another one.")
        if not place.is_dir() or not any(place.iterdir()):
            return
        manifest = place / MANIFEST
        if not manifest.is_file():
            raise InputError(
                f"a folder '{place}' that holds something else",
                "an empty folder, or one that this command wrote",
                "Name another one.",
            )
        if fresh:
            for part in self.parts():
                part.unlink()
            return
        try:
            before = json.loads(manifest.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            before = {}
        if before != self._settings:
            wrong = [k for k in self._settings if before.get(k) != self._settings[k]]
            raise InputError(
                f"results in '{place}' of a run with another {', '.join(wrong) or 'setting'}",
                "the settings of that run, to go on with it",
                "Start again with " + arg("fresh", True) + ", or name another folder.",
            )
