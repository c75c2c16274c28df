"""Other people's estimators in a suite: an environment each, a process each, their own fit.

A row is a file of the adapters' folder (``benchmarks/rows`` of the repository), run by
``serve.py`` there in a Python that has what the row requires. It is handed the tests of a cell to
fit on, and later the rows of a log; never a judged log's truth.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import venv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.estimate.estimators import samples, trace_of
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog

SERVE = "serve.py"
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
INSTALL_S = 1800.0
LONGEST_REST_S = 600.0  # what a longer gap of a test is shortened to for a fit
GRID_C = np.arange(-30.0, 51.0, 5.0)  # where a model of all temperatures is tabulated
TABLES = ("ocv_V", "r0_ohm", "r1_ohm", "c1_F", "r2_ohm", "c2_F")
HERE = Path(__file__).resolve().parents[3] / "benchmarks" / "rows"


@dataclass(frozen=True)
class PackageRow:
    """An estimator that is not ours, as a suite names it.

    Parameters
    ----------
    name : str
    file : str                   the adapter, in the folder of adapters
    about : str                  whose it is, and what it was identified with
    requires : tuple of str      pins of its environment; none: the Python that runs the suite
    period_s : float or None     it steps no more often than this, counting in between
    cut : str                    "whole", or "quick" for one that takes too long
    options : tuple of str       handed to the adapter
    """

    name: str
    file: str
    about: str
    requires: tuple[str, ...] = ()
    period_s: float | None = None
    cut: str = "whole"
    options: tuple[str, ...] = ()


@dataclass(frozen=True)
class NotRun:
    """A row that was wanted and is not run, and why."""

    name: str
    why: str


class RowError(Exception):
    """Why a row could not be made ready, fitted or run."""


def adapters_folder(given: Path | None) -> Path | None:
    """Where the adapters are: as stated, else in this repository; None where there are none."""
    for folder in (given,) if given is not None else (HERE, Path("benchmarks") / "rows"):
        if (folder / SERVE).is_file():
            return folder
    return None


def row_digest(row: PackageRow, adapters: Path) -> str:
    """What a row's runs depend on beside the log: its adapter, what that imports, its pins."""
    return _digest(adapters, row.file, SERVE, parts=(repr(row),))


def _digest(adapters: Path, *files: str, parts: Iterable[str]) -> str:
    """Of files, of the modules beside them that they import, and of more."""
    texts = [(adapters / name).read_text(encoding="utf-8") for name in files]
    for beside in sorted(adapters.glob("*.py")):
        if any(f"from {beside.stem} import" in text for text in texts) and beside.name not in files:
            texts.append(beside.read_text(encoding="utf-8"))
    return hashlib.sha256("\0".join((*texts, *parts)).encode()).hexdigest()[:16]


def environment(row: PackageRow, folder: Path) -> Path:
    """A Python that has what the row requires, made below ``folder`` where there is none yet.

    Raises
    ------
    RowError         a package that does not install by name
    """
    if not row.requires:
        return Path(sys.executable)
    mark = hashlib.sha256("\n".join((sys.version, *row.requires)).encode()).hexdigest()[:12]
    place = folder / mark
    python, ready = place / "bin" / "python", place / "installed.txt"
    if sys.platform == "win32":
        python = place / "Scripts" / "python.exe"
    if not ready.is_file():
        install = [str(python), "-m", "pip", "install", "-q", *row.requires]
        try:
            venv.create(place, clear=True, with_pip=True)
            done = subprocess.run(
                install, capture_output=True, text=True, timeout=INSTALL_S, check=False
            )
        except (OSError, subprocess.SubprocessError) as error:
            raise RowError(f"{' '.join(row.requires)}: {error}") from error
        if done.returncode:
            said = [line for line in done.stderr.splitlines() if "ERROR" in line]
            raise RowError(" ".join([*row.requires, "did not install:", *said[-1:]]))
        ready.write_text("\n".join(row.requires) + "\n", encoding="utf-8")
    return python


def training_arrays(
    model: CellModel, temperature_C: float, logs: list[tuple[str, CellLog, float]]
) -> dict[str, Any]:
    """All that a row may be fitted on: a cell's tests with their SOC, and our model's tables.

    Parameters
    ----------
    logs : of (role, log, SOC at its first row)    role: hppc, ocv, capacity or drive
    """
    warm = [model.at_temperature(float(t)) for t in GRID_C]
    found: dict[str, Any] = {
        "capacity_Ah": model.capacity_Ah,
        "temperature_C": temperature_C,
        "soc": model.soc,
        "grid_C": GRID_C,
        "roles": np.array([role for role, _, _ in logs]),
    }
    for name in TABLES:
        found[name] = np.array([getattr(one, name)[0] for one in warm])
    for k, (_, log, soc0) in enumerate(logs):
        current = np.nan_to_num(log.interval_current_A)
        current[log.gap_rows] = 0.0  # a pause, whatever flowed before it
        moved = np.cumsum(current * log.interval_s) / 3600.0
        seen = np.maximum.accumulate(np.where(np.isfinite(log.voltage_V), np.arange(len(log)), 0))
        rows = {
            "time_s": np.cumsum(np.minimum(log.interval_s, LONGEST_REST_S)),
            "current_A": current,
            "voltage_V": log.voltage_V[seen],
            "temperature_C": known_temperature_C(model, log),
            "soc": soc0 - moved / model.capacity_Ah,
        }
        found |= {f"log{k}_{name}": values for name, values in rows.items()}
    return found


class RowProcess:
    """One row in its own process: asked by a line of JSON, arrays in files between."""

    def __init__(self, python: Path, adapters: Path, row: PackageRow) -> None:
        self.row = row
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115
        self.process = subprocess.Popen(
            [str(python), str(adapters / SERVE), str(adapters / row.file), *row.options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
            env={**os.environ, **dict.fromkeys(ONE_THREAD, "1")},
        )

    def ask(self, **what: Any) -> dict[str, Any]:
        """Its answer.

        Raises
        ------
        RowError         it failed, or ended
        """
        stdin, stdout = self.process.stdin, self.process.stdout
        if stdin is None or stdout is None:
            raise RowError("its process has no pipes")
        try:
            stdin.write(json.dumps(what) + "\n")
            stdin.flush()
            answer: dict[str, Any] = json.loads(stdout.readline() or "{}")
        except (OSError, ValueError) as error:
            raise RowError(f"its process broke off ({error})") from error
        if not answer:
            self.errors.seek(0)
            said = self.errors.read().decode(errors="replace").strip().splitlines()
            raise RowError("its process ended: " + (said[-1] if said else "nothing said"))
        if "problem" in answer:
            raise RowError(str(answer["problem"]))
        return answer

    def close(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        self.errors.close()


_running: dict[tuple[Path, Path, PackageRow], RowProcess] = {}


def row_process(python: Path, adapters: Path, row: PackageRow) -> RowProcess:
    """The row's process; the one of another row is ended, so that few are in memory."""
    key = (python, adapters, row)
    there = _running.get(key)
    if there is None or there.process.poll() is not None:
        close_rows()
        there = _running[key] = RowProcess(python, adapters, row)
    return there


def close_rows() -> None:
    """End every process of a row that this one started."""
    for one in _running.values():
        one.close()
    _running.clear()


class RowEstimator:
    """A fitted row as an estimator that replays logs.

    Parameters
    ----------
    training, fitted : Path     what it was fitted on, and what came of it
    """

    def __init__(self, process: RowProcess, model: CellModel, training: Path, fitted: Path) -> None:
        self.name = process.row.name
        self._process, self._model = process, model
        self._files = {"training": str(training), "fitted": str(fitted)}
        self.ns_per_step = self.process_MB = float("nan")
        self.state_bytes = 0

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Hand a log's rows to the process, which steps through them one by one."""
        with tempfile.TemporaryDirectory() as folder:
            rows, answer = Path(folder) / "rows.npz", Path(folder) / "answer.npy"
            np.savez(rows, data=samples(self._model, log))
            found = self._process.ask(
                do="run",
                rows=str(rows),
                answer=str(answer),
                soc0=soc0,
                soc0_std=soc0_std,
                period_s=self._process.row.period_s or 0.0,
                **self._files,
            )
            soc, std, voltage = np.load(answer)
        self.ns_per_step = float(found["ns_per_step"])
        self.process_MB = float(found["process_MB"])
        self.state_bytes = int(found["state_bytes"])
        return trace_of(log, soc, std, voltage)


_failed: dict[Path, str] = {}


def fitted_row(
    python: Path, adapters: Path, row: PackageRow, training: Path, seed: int
) -> tuple[RowProcess, Path]:
    """The row's process, and what its fit on a cell's tests made, kept beside them.

    Raises
    ------
    RowError         its fit failed
    """
    mark = _digest(adapters, row.file, SERVE, parts=row.requires)
    fitted = training.with_name(f"{training.name.partition('.')[0]}.{mark}.fit")
    if fitted in _failed:
        raise RowError(_failed[fitted])
    process = row_process(python, adapters, row)
    if not fitted.is_file():
        try:
            process.ask(do="fit", training=str(training), fitted=str(fitted), seed=seed)
        except RowError as error:
            _failed[fitted] = f"its fit: {error}"
            raise RowError(_failed[fitted]) from error
    return process, fitted
