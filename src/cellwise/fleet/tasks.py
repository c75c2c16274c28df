"""What is done with one log: replay or diagnosis, to one row."""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.cells_in_series import check_cells_in_series
from cellwise.errors import InputError, MachineError
from cellwise.estimate.estimators import Estimator, make_estimator
from cellwise.estimate.replay import Replay, reference_soc
from cellwise.fleet.store import (
    BY_LOG,
    BY_MACHINE,
    BY_US,
    DIAGNOSE,
    REPLAY,
    read_prepared,
)
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.sign import verify_sign
from cellwise.logs.stated import Stated


class Surprised(NamedTuple):
    """From where on the model does not know a log, and its sign is worth a look.

    Share of the voltages that are rejected, and times the model's usual error.
    """

    share: float = 0.02
    times: float = 4.0


SURPRISED = Surprised()
INTERNAL = "internal error"

_of_thread = threading.local()


@dataclass(frozen=True)
class LogTask:
    """How logs of a fleet are read.

    Parameters
    ----------
    model : CellModel
    soc0 : float or None      initial SOC of every log; None: found in each
    read : mapping            arguments of `read_log`
    cache : str               folder for logs that were read and checked before; empty: none
    stated : Stated or None   what is known of every log
    """

    kind: ClassVar[str] = ""
    unit: ClassVar[str] = "files"  # what has a row each
    columns: ClassVar[Mapping[str, type]] = {}

    model: CellModel
    soc0: float | None = None
    read: Mapping[str, Any] = field(default_factory=dict)
    cache: str = ""
    stated: Stated | None = None

    def settings(self) -> dict[str, Any]:
        """What must be the same when a run is resumed, as JSON values."""
        names = [f.name for f in fields(self) if f.name not in ("model", "cache", "stated")]
        said = {name: getattr(self, name) for name in names}
        if self.stated is not None:
            said["stated"] = [self.stated.temperature_C, self.stated.soc0]
        return {"kind": self.kind, **json.loads(json.dumps(said, default=str))}

    def places(self, logs: Mapping[str, tuple[int, int]]) -> dict[str, tuple[int, int]]:
        """What has a row each, with its size and time of change: here every log."""
        return dict(logs)

    def identity(self, folder: Path, name: str) -> dict[str, Any]:
        """Which one a row is of."""
        return identity(folder, name)

    def failed_row(self, folder: Path, name: str, reason: str) -> dict[str, Any]:
        """A row of one that could not be finished."""
        row = self.identity(folder, name)
        return row | {"error": reason, "failed_by": BY_LOG, "seconds": math.nan}

    def rows(self, folder: str, names: Sequence[str]) -> list[dict[str, Any]]:
        """One row for each log; one that fails is a row with its error."""
        return list(self._rows(Path(folder), names))

    def _rows(self, folder: Path, names: Sequence[str]) -> Iterator[dict[str, Any]]:
        work = self.work()
        for name in names:
            began = time.perf_counter()
            row = self.identity(folder, name)
            try:
                row |= work(self.given(folder, name))
            except Exception as error:
                row |= failure(error)
            row["seconds"] = time.perf_counter() - began
            yield row

    def given(self, folder: Path, name: str) -> Any:
        """What a row is made of: here the log."""
        log = self.log(folder / name)
        check_cells_in_series(self.model, log)
        return log

    def log(self, path: Path) -> CellLog:
        """A log as it was read or prepared before, with what is stated of it."""
        log = read_prepared(path, self.cache, **self.read)
        return log if self.stated is None else self.stated.applied(log)

    def begin(self) -> Any:
        """What makes a row of a log; made once for several."""
        raise NotImplementedError

    def work(self) -> Any:
        """`begin`, once for each thread."""
        task, work = getattr(_of_thread, "kept", (None, None))
        if task is not self:
            work = self.begin()
            _of_thread.kept = self, work
        return work


@dataclass(frozen=True)
class ReplayTask(LogTask):
    """SOC over each log, and how it did.

    Parameters
    ----------
    estimator : str                       a name of `ESTIMATORS`
    soc0_std : float or None              how sure ``soc0`` is
    reference_soc0 : float or None        true SOC at every log's first row
    reference_capacity_Ah : float or None     charge between SOC 1 and 0, for the error of SOC
    """

    kind: ClassVar[str] = "replay"
    columns: ClassVar[Mapping[str, type]] = REPLAY

    estimator: str = "ekf"
    soc0_std: float | None = None
    reference_soc0: float | None = None
    reference_capacity_Ah: float | None = None

    @cached_property
    def usual_error_V(self) -> float:
        """The model's own error over the SOC range, not below two millivolts."""
        return max(float(np.median(self.model.error.at(self.model.soc))), 2e-3)

    def begin(self) -> Any:
        """An estimator for some logs in a row."""
        filter_ = make_estimator(self.estimator, self.model)
        return lambda log: self._replay(filter_, log)

    def _replay(self, filter_: Estimator, log: CellLog) -> dict[str, Any]:
        start = initial_soc(self.model, log, self.soc0)
        if self.soc0_std is not None:
            start = InitialSoc(start.soc, self.soc0_std, start.how)
        began = time.perf_counter()
        trace = filter_.run(log, start.soc, start.std)
        ns = 1e9 * (time.perf_counter() - began) / len(log)
        reference = None
        if self.reference_capacity_Ah is not None:
            given = self.reference_soc0
            true0 = initial_soc(self.model, log, whole_log=True).soc if given is None else given
            reference = reference_soc(log, true0, self.reference_capacity_Ah)
        found = Replay(log, filter_.name, start, trace, ns, reference, self.model.validity,
                       model=self.model)  # fmt: skip
        notices = "; ".join(found.notices) or None
        return {**_of_log(log), **self._figures(found), "notices": notices}

    def _figures(self, found: Replay) -> dict[str, Any]:
        figures = found.to_dict()
        settled, estimated = figures.pop("settled"), figures.pop("parameters", None) or {}
        start = figures.pop("soc0")
        trace = found.trace
        rejected = found.sums.rejected / len(trace)
        row = {
            **figures,
            "soc0": start["value"],
            "soc0_std": start["std"],
            "soc0_how": start["how"],
            "soc_min": float(np.min(trace.soc)),
            "soc_max": float(np.max(trace.soc)),
            "settled_rmse": None if settled is None else settled["rmse"],
            "rejected_share": rejected,
            "status": found.sums.status,
            "sign": self._sign(found, rejected),
        }
        for name in ("offset_A", "capacity_Ah"):
            if name in estimated:
                stem, _, unit = name.rpartition("_")
                row[name] = estimated[name]["value"]
                row[f"{stem}_std_{unit}"] = estimated[name]["std"]
        if estimated:
            row["resistance_scale"] = estimated["resistance_scale"]["value"]
            row |= {k: estimated[k] for k in ("soh_capacity", "soh_resistance")}
        return row

    def _sign(self, found: Replay, rejected: float) -> str:
        """The sign's verdict where the filter is surprised; elsewhere the filter has shown it."""
        known = (
            found.voltage_rmse_V <= SURPRISED.times * self.usual_error_V
            and rejected <= SURPRISED.share
        )
        return "not checked" if known else verify_sign(found.log).verdict


@dataclass(frozen=True)
class DiagnoseTask(LogTask):
    """What the model gets wrong about each log, and why.

    Parameters
    ----------
    causes : sequence of str or None      only these causes
    baseline : sequence of CellLog        logs of the same kind that are known to be good
    """

    kind: ClassVar[str] = "diagnose"
    columns: ClassVar[Mapping[str, type]] = DIAGNOSE

    causes: Sequence[str] | None = None
    baseline: Sequence[CellLog] = ()

    def settings(self) -> dict[str, Any]:
        """As of every task; of the baseline, the names."""
        return {**super().settings(), "baseline": [log.name for log in self.baseline]}

    def begin(self) -> Any:
        """The diagnosis of one log."""
        return self._diagnose

    def _diagnose(self, log: CellLog) -> dict[str, Any]:
        from cellwise.diagnose.diagnosis import diagnose

        found = diagnose(
            self.model,
            log,
            baseline=tuple(self.baseline),
            soc0="auto" if self.soc0 is None else self.soc0,
            causes=self.causes,
        ).to_dict()
        causes = found["causes"]
        row = {
            **_of_log(log),
            "sign": verify_sign(log).verdict,
            "verdict": found["verdict"],
            "causes": ",".join(c["name"] for c in causes),
            "parameters": json.dumps({k: v for c in causes for k, v in c["parameters"].items()}),
            "next_test": found["next_test"],
        }
        if causes:
            low, high = causes[-1]["gain_ci95"]
            row |= {
                "gain": causes[-1]["gain"],
                "gain_low": low,
                "gain_high": high,
                "rmse_before_V": causes[0]["holdout_rmse_before_V"],
                "rmse_after_V": causes[-1]["holdout_rmse_after_V"],
            }
        return row


def identity(folder: Path, name: str) -> dict[str, Any]:
    """Which log a row is of; its cell is the folder that it lies in, else its own name."""
    try:
        status = os.stat(f"{folder}/{name}")
        size, modified = status.st_size, status.st_mtime_ns
    except OSError:
        size = modified = -1
    parent, _, own_name = name.rpartition("/")
    cell = parent or own_name.partition(".")[0]
    return {"log": name, "cell": cell, "bytes": size, "modified_ns": modified, "error": None}


def _of_log(log: CellLog) -> dict[str, Any]:
    return {
        "samples": len(log),
        "duration_s": log.duration_s,
        "gaps": int(np.count_nonzero(log.gap_rows)),
        "format": log.format,
        "notices": "; ".join(log.notices) or None,
    }


def failure(error: Exception) -> dict[str, Any]:
    """Columns of a log that could not be finished: what happened, and whose fault it is.

    A failure of the machine (no space, no memory, a disk or network that does not answer) is none
    of the log: it is tried again when the run goes on.
    """
    if isinstance(error, MachineError):
        return {"error": str(error), "failed_by": BY_MACHINE}
    if isinstance(error, InputError):
        return {"error": str(error), "failed_by": BY_LOG}
    if isinstance(error, (OSError, MemoryError)):
        said = getattr(error, "strerror", None) or str(error) or "out of memory"
        return {"error": f"{type(error).__name__}: {said}", "failed_by": BY_MACHINE}
    return {"error": f"{INTERNAL}, {type(error).__name__}: {error}", "failed_by": BY_US}
