"""A submission scored on one's own logs, by the published rules of McMaster's Blind Modeling Tool.

The rules are those of its documentation ("Scoring methodology" and "The evaluation engine" below
docs/walkthrough of github.com/McMaster-Battery-Research-Group/battery-soc-benchmark; data
doi:10.5683/SP3/ZVTR4B): rows of 1 s, one call for each; an hour of the first row before every run,
not scored; RMSE of each run, means over test cases, and a weighted sum. The logs and cells there
are hidden: a score of one's own logs compares submissions with one another, not with theirs.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError, not_installed
from cellwise.logs.cell_log import CellLog, resample
from cellwise.records import need
from cellwise.typing import FloatArray

PADDING_ROWS = 3600
STARTS = {0.9: 3.0, 0.6: 2.0, 0.3: 1.0}  # true SOC at a late start, and its weight
OFFSETS_A = (-0.3, 0.3)
TEMPERATURES_C = (-20.0, -10.0, 0.0, 10.0, 25.0, 40.0)
# Cells (hidden, open: 0.1 each), payloads (0.2), cycles (standard, others: 0.1 each) are all means
# over drives; one's own logs have no such groups.
WEIGHTS = {
    "drives": 0.6,
    "temperatures": 0.1,
    "charging": 0.1,
    "late starts": 0.1,
    "current offset": 0.1,
}
FEWEST_ROWS = 60
DRIVER = """
jobs = load('jobs.mat');
names = fieldnames(jobs);
soc = cell(1, numel(names));
for j = 1:numel(names)
    X = jobs.(names{j});
    y = zeros(size(X, 1), 1);
    [y(1), z] = Model(X(1, :));
    for k = 2:size(X, 1)
        [y(k), z] = Model(X(k, :), z);
    end
    soc{j} = y;
end
save('-v7', 'soc.mat', 'soc');
"""


class ScoredRun(NamedTuple):
    """One run: its ``case`` of `WEIGHTS`, log, what was done to it, RMSE of the SOC [points]."""

    case: str
    log: str
    change: str
    rmse: float


class Score(NamedTuple):
    """``weighted`` error [points] over the ``cases`` that the logs have, and every run."""

    weighted: float
    cases: dict[str, float]
    runs: tuple[ScoredRun, ...]

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        missing = [name for name in WEIGHTS if name not in self.cases]
        runs = [run._asdict() for run in self.runs]
        said = {"weighted_error_points": self.weighted, "cases": self.cases}
        return {**said, "missing_cases": missing, "runs": runs}


class _Job(NamedTuple):
    """What is run: rows behind their padding, the SOC of these rows, the temperature."""

    case: str
    log: str
    change: str
    rows: FloatArray
    truth: FloatArray
    temperature_C: float


def score_submission(
    path: str | Path, logs: Sequence[tuple[CellLog, float]], capacity_Ah: float
) -> Score:
    """Score ``Model.py`` or ``Model.m`` on logs.

    Parameters
    ----------
    path : str or Path      defines ``Model(X, z) -> (soc, z)``; X: current (positive on charge),
                            voltage, temperature; run in this process (.py) or by GNU Octave (.m)
    logs : sequence         a log with its true SOC at the first row; one that charges more than it
                            discharges is a charge
    capacity_Ah : float     that the truth is counted over

    Raises
    ------
    InputError        no log; a log without temperature; a model that fails or gives no number;
                      Octave is missing
    """
    need(bool(logs), "no log", "logs with their true SOC", "Name some.")
    need(capacity_Ah > 0.0, f"a capacity of {capacity_Ah:g} Ah", "one above zero")
    jobs = [job for log, soc0 in logs for job in _jobs(log, soc0, capacity_Ah)]
    place = Path(path)
    need(place.is_file(), f"no file '{path}'", "a Model.py or Model.m", "Correct the path.")
    run = _by_octave if place.suffix == ".m" else _in_process
    answers = run(place, [job.rows for job in jobs])
    runs, temperature_C = [], []
    for job, soc in zip(jobs, answers, strict=True):
        off = 100.0 * (soc[PADDING_ROWS:] - job.truth)
        need(
            bool(np.isfinite(off).all()),
            f"a SOC that is no number, of '{path}' on '{job.log}'",
            "a number for each row",
            "Correct the model.",
        )
        runs.append(ScoredRun(job.case, job.log, job.change, float(np.sqrt(np.mean(off**2)))))
        temperature_C.append(job.temperature_C)
    cases = _cases(runs, np.array(temperature_C))
    weight = sum(WEIGHTS[name] for name in cases)
    return Score(sum(WEIGHTS[n] * v for n, v in cases.items()) / weight, cases, tuple(runs))


def _jobs(log: CellLog, soc0: float, capacity_Ah: float) -> list[_Job]:
    temperature_C = log.temperature_C
    if temperature_C is None:
        raise InputError(
            f"a log '{log.name}' without temperature",
            "one that was measured: a submission is handed it",
            "State it behind the file, as LOG@temperature_C=25.",
        )
    log = resample(log, 1.0)
    temperature_C = np.full(len(log), np.nan) if log.temperature_C is None else log.temperature_C
    truth = soc0 - log.counted_charge_Ah() / capacity_Ah
    rows = np.column_stack([-log.known_current_A(), log.voltage_V, temperature_C])
    known = np.isfinite(rows).all(axis=1)
    rows, truth = rows[known], truth[known]
    need(
        len(rows) > FEWEST_ROWS,
        f"{len(rows)} rows of 1 s in '{log.name}'",
        f"more than {FEWEST_ROWS}",
        "Leave it out.",
    )
    mean_C = float(np.mean(rows[:, 2]))

    def job(case: str, change: str, of: FloatArray, true: FloatArray, **at_rest: bool) -> _Job:
        first = of[:1] * ([[0.0, 1.0, 1.0]] if at_rest else 1.0)
        padded = np.concatenate([np.repeat(first, PADDING_ROWS, axis=0), of])
        return _Job(case, log.name, change, padded, true, mean_C)

    if truth[-1] > truth[0]:
        return [job("charging", "", rows, truth)]
    found = [job("drives", "", rows, truth)]
    for level in STARTS:
        late = int(np.argmax(truth < level))
        if truth[late] < level and late > 0 and len(rows) - late > FEWEST_ROWS:
            change = f"from {level:.0%}"
            found.append(job("late starts", change, rows[late:], truth[late:], at_rest=True))
    for offset_A in OFFSETS_A:
        change = f"{offset_A:+g} A"
        off = rows + np.array([offset_A, 0.0, 0.0])
        found.append(job("current offset", change, off, truth))
    return found


def _cases(runs: Sequence[ScoredRun], warm: FloatArray) -> dict[str, float]:
    """Error of each test case that the runs have [points]."""
    named = np.array([run.case for run in runs])
    rmse = np.array([run.rmse for run in runs])
    found = {}
    for name in WEIGHTS:
        if name == "temperatures" and (named == "drives").any():
            own = named == "drives"
            nearest = np.abs(warm[own, None] - TEMPERATURES_C).argmin(axis=1)
            found[name] = float(
                np.mean([rmse[own][nearest == k].mean() for k in np.unique(nearest)])
            )
        elif name == "late starts" and (named == name).any():
            levels = {f"from {level:.0%}": w for level, w in STARTS.items()}
            each = {c: [r.rmse for r in runs if r.change == c] for c in levels}
            mean = {c: float(np.mean(v)) for c, v in each.items() if v}
            whole = sum(levels[c] for c in mean)
            found[name] = sum(levels[c] * v for c, v in mean.items()) / whole
        elif (named == name).any():
            found[name] = float(rmse[named == name].mean())
    return found


def _in_process(path: Path, jobs: Sequence[FloatArray]) -> list[FloatArray]:
    """SOC of every row, by the Python file's function, a call for each."""
    spec = importlib.util.spec_from_file_location("submitted_model", path)
    try:
        module = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]
        spec.loader.exec_module(module)  # type: ignore[union-attr]
        return [_stepped(module.Model, rows) for rows in jobs]
    except Exception as error:
        raise InputError(
            f"'{path}', whose model fails ({type(error).__name__}: {error})",
            "a file that defines Model(X, z) -> (soc, z)",
            "Correct it.",
        ) from error


def _stepped(model: Callable[..., tuple[Any, Any]], rows: FloatArray) -> FloatArray:
    soc, z = model(rows[0])
    found = [float(soc)]
    for row in rows[1:]:
        soc, z = model(row, z)
        found.append(float(soc))
    return np.array(found)


def _by_octave(path: Path, jobs: Sequence[FloatArray]) -> list[FloatArray]:
    """The same by GNU Octave, which runs MATLAB's language."""
    from scipy.io import loadmat, savemat

    octave = shutil.which("octave-cli")
    if octave is None:
        raise not_installed("octave", f"'{path}', a MATLAB file", "GNU Octave (octave-cli)")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        shutil.copy(path, place / "Model.m")
        (place / "driver.m").write_text(DRIVER, encoding="utf-8")
        savemat(place / "jobs.mat", {f"job{k:04d}": rows for k, rows in enumerate(jobs)})
        ran = subprocess.run(
            [octave, "--no-init-file", "driver.m"], cwd=place, capture_output=True, text=True
        )
        if ran.returncode:
            said = next((s for s in ran.stderr.splitlines() if s.strip()), "no message")
            raise InputError(
                f"'{path}', whose model fails ({said})",
                "a file that defines [soc, z] = Model(X, z)",
                "Correct it.",
            )
        return [np.ravel(one) for one in np.ravel(loadmat(place / "soc.mat")["soc"])]
