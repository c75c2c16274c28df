"""What the benchmark of hidden effects runs: one task is one case, or one scan over sizes."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from benchmarks.measured_data import HOW, REPOSITORY, data_folder

sys.path.insert(0, str(REPOSITORY / "tests" / "support"))
sys.path.insert(0, str(REPOSITORY / "tests" / "support" / "hidden_effects"))

from emulator_effects import NAMES
from hidden_cases import Plan, Sealed, hidden_case, random_pair
from hidden_score import SMALL_V, Outcome, judge, smallest_found
from hide import POSSIBLE, hidden_real_case, measured_cell

SIZES_V = tuple(0.001 * 2.0 ** (k / 2.0) for k in range(11))  # 1 to 32 mV
REAL_SIZES = (2.0, 4.0)  # times the limit on the emulator, on top of a cell's own residual
REAL_LIMIT_V = 0.010


@dataclass(frozen=True)
class Task:
    """One case; ``limit``: the smallest size of the case that is found."""

    part: str
    seed: int
    effects: tuple[str, ...]
    size_V: float
    rows: int = 5000
    model: Literal["known", "identified"] | None = None
    cell: str = ""


@dataclass(frozen=True)
class Broken:
    """The outcome of a diagnosis that raised."""

    verdict: str
    causes: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Found:
    """The outcomes of a task, and the smallest size found where it looked for one [V]."""

    outcomes: tuple[Outcome, ...]
    smallest_V: float = float("nan")


def tasks(
    part: str,
    seed: int,
    cases: int,
    effects: tuple[str, ...],
    size_mV: float | None,
    rows: int,
    model: Literal["known", "identified"] | None,
) -> list[Task]:
    """Cases of one part, each with its own seed; effects take turns."""
    made = []
    for k in range(cases):
        rng = np.random.default_rng([seed + k, 99])
        if part == "real":
            made += _real(seed + k, k, effects, size_mV, rng)
            continue
        hidden = _hidden(part, k, effects, rng)
        size = rng.uniform(2.0, 5.0) * SMALL_V if hidden else 0.0
        made.append(Task(part, seed + k, hidden, 1e-3 * size_mV if size_mV else size, rows, model))
    return made


def _hidden(
    part: str, k: int, effects: tuple[str, ...], rng: np.random.Generator
) -> tuple[str, ...]:
    if part == "none":
        return ()
    if part == "pairs":
        return random_pair(rng)
    return ((effects or NAMES)[k % len(effects or NAMES)],)


def _real(
    seed: int, k: int, effects: tuple[str, ...], size_mV: float | None, rng: np.random.Generator
) -> list[Task]:
    if data_folder() is None:
        raise SystemExit(f"no measured cells: {HOW}")
    made = []
    for cell, possible in POSSIBLE.items():
        names = [e for e in possible if not effects or e in effects]
        size = 1e-3 * size_mV if size_mV else REAL_LIMIT_V * rng.uniform(*REAL_SIZES)
        made.append(Task("real", seed, (names[k % len(names)],), size, cell=cell))
    return made


def limit_tasks(
    seed: int,
    cases: int,
    effects: tuple[str, ...],
    rows: int,
    model: Literal["known", "identified"] | None,
) -> list[Task]:
    """A scan over sizes for each effect and seed."""
    return [
        Task("limit", seed + k, (name,), float("nan"), rows, model)
        for k in range(cases)
        for name in effects or NAMES
    ]


def run(task: Task) -> tuple[Task, Found]:
    """One task, in a process of its own."""
    from cellwise.diagnose import diagnose

    return task, run_with(task, diagnose)


def run_with(task: Task, diagnose: Callable[..., Any]) -> Found:
    """One task by a given diagnosis."""
    if task.part != "limit":
        return Found((_outcome(task, task.size_V, diagnose),))
    outcomes: list[Outcome] = []

    def found_at(size_V: float) -> bool:
        outcomes.append(_outcome(task, size_V, diagnose))
        return outcomes[-1].right

    smallest = smallest_found(found_at, SIZES_V)
    if np.isfinite(smallest):  # physics may not have allowed the size that was asked for
        smallest = min(o.size_V for o in outcomes if o.right)
    return Found(tuple(outcomes), smallest)


def _outcome(task: Task, size_V: float, diagnose: Callable[..., Any]) -> Outcome:
    case = sealed_case(task, size_V)
    began = time.perf_counter()
    try:
        said = diagnose(
            case.model, case.logs, holdout=case.holdout, baseline=case.baseline, soc0=case.soc0
        )
    except Exception as error:  # one broken case must not end a run of hours
        said = Broken(f"broken: {type(error).__name__}: {error}")
    return judge(case, said, time.perf_counter() - began)


def sealed_case(task: Task, size_V: float) -> Sealed:
    """The case of a task at one size."""
    if task.cell:
        folder = data_folder()
        if folder is None:
            raise SystemExit(f"no measured cells: {HOW}")
        return hidden_real_case(measured_cell(folder, task.cell), task.seed, task.effects, size_V)
    return hidden_case(task.seed, task.effects, size_V, Plan(rows=task.rows, model=task.model))
