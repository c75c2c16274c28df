"""One switch over the whole panel, in a process of its own: kernels are compiled with it thrown.

python -m benchmarks.ablation.run SWITCH KEEP OUTPUT [ESTIMATORS]
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ablation.panel import Case, cases
from benchmarks.ablation.switches import Switch, switch_of
from benchmarks.measured_data import HOW, data_folder
from cellwise.estimate.adaptive import Adaptive, AdaptiveSettings
from cellwise.estimate.estimators import Estimator, make_estimator
from cellwise.estimate.noise import Noise
from cellwise.estimate.trace import Trace

ESTIMATORS = ("ekf", "ukf", "adaptive")


@dataclass(frozen=True)
class Result:
    """SOC after the first quarter [%], the stated deviation there, rows inside two of it."""

    group: str
    log: str
    estimator: str
    rmse: float
    sigma: float
    inside: float


def estimator_of(switch: Switch, name: str, case: Case) -> Estimator:
    """The filter with the switch's fields."""
    changed: dict[str, Any] = dict(switch.noise)
    noise = replace(Noise.of_model(case.model), **changed)
    if name == "adaptive":
        return Adaptive(case.model, noise, replace(AdaptiveSettings(), **switch.settings))
    return make_estimator(name, case.model, noise)


def judged(switch: Switch, name: str, case: Case) -> Result:
    """One filter over one case."""
    trace = estimator_of(switch, name, case).run(case.log, case.soc0, case.std)
    return result_of(case, name, trace)


def result_of(case: Case, name: str, trace: Trace) -> Result:
    """What a filter's replay of a case is worth, by the capacity that it agrees with best."""
    late = slice(len(case.log) // 4, None)
    errors = [trace.soc - truth for truth in case.truths]
    error = min(errors, key=lambda e: float(np.mean(e[late] ** 2)))
    inside = float(np.mean(np.abs(error) < 2.0 * trace.soc_std))
    rmse = float(np.sqrt(np.mean(error[late] ** 2)))
    sigma = float(np.mean(trace.soc_std[late]))
    return Result(case.group, case.log_name, name, 100 * rmse, 100 * sigma, 100 * inside)


def results(switch: Switch, keep: Path, estimators: tuple[str, ...]) -> Iterator[Result]:
    """The whole panel."""
    data = data_folder()
    if data is None:
        raise SystemExit(f"no measured data: {HOW}")
    for case in cases(data, keep):
        for name in estimators:
            yield judged(switch, name, case)


def main() -> None:
    """Write the results of one switch as JSON."""
    name, keep, output = sys.argv[1:4]
    estimators = tuple(sys.argv[4].split(",")) if len(sys.argv) > 4 else ESTIMATORS
    switch = switch_of(name)
    switch.throw()
    found = [asdict(r) for r in results(switch, Path(keep), estimators)]
    Path(output).write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    # A constant is no part of the key that numba keeps a kernel under.
    if "NUMBA_CACHE_DIR" not in os.environ:
        with tempfile.TemporaryDirectory() as folder:
            os.environ["NUMBA_CACHE_DIR"] = folder
            os.execv(
                sys.executable, [sys.executable, "-m", "benchmarks.ablation.run", *sys.argv[1:]]
            )
    main()
