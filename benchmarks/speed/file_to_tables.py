"""From a file of 1.4 million rows to tables: wall clock on two cores."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.figures import Figure, Progress
from benchmarks.measured_data import REPOSITORY
from benchmarks.speed.synthetic_truth import CAPACITY_AH, synthetic_hppc
from cellwise.logs import write_log

TARGET_S = 5.0
CORES = 2


def file_figures(data: Path | None, say: Progress, *, full: bool = False) -> list[Figure]:
    """Times by format, cold and warm."""
    say("synthetic HPPC test at 135 Hz")
    made = synthetic_hppc()
    with tempfile.TemporaryDirectory(prefix="cellwise-bench-") as folder:
        return _times(made, Path(folder), say)


def _times(made: Any, folder: Path, say: Progress) -> list[Figure]:
    group = f"file to tables, {len(made.log):,} rows, {CORES} cores"
    figures: list[Figure] = []
    for form in ("parquet", "csv"):
        file = folder / f"hppc.{form}"
        write_log(made.log, file)
        cache = folder / f"cache-{form}"
        megabytes = file.stat().st_size / 1e6
        for when in ("cold", "warm"):
            say(f"{form}, {when}")
            run = _process(file, cache)
            first = run["runs"][0] if when == "cold" else _quickest(run["runs"])
            how = (
                "first run ever: everything is compiled"
                if when == "cold"
                else f"process that runs on; its first run took {run['runs'][0]['tables_s']:.1f}"
            )
            whole = f"with error, pulses and check {first['model_s']:.1f} s"
            start = f"import {run['import_s']:.1f} s more"
            figures.append(
                Figure(
                    group,
                    f"{form} ({megabytes:.0f} MB), {when}",
                    first["tables_s"],
                    "s",
                    target=TARGET_S if when == "warm" else None,
                    note=f"reading {first['read_s']:.2f} s; {whole}; {start}; {how}",
                )
            )
            if when == "warm":
                figures.append(
                    Figure(
                        group,
                        f"{form}, warm, whole model",
                        first["model_s"],
                        "s",
                        target=TARGET_S,
                        note=f"RMSE {1e3 * first['rmse_V']:.2f} mV with 1 mV of noise",
                    )
                )
    return figures


def _quickest(runs: list[dict[str, Any]]) -> dict[str, Any]:
    return min(runs, key=lambda r: r["model_s"])


def _process(file: Path, cache: Path) -> dict[str, Any]:
    """A fresh Python on two cores, one BLAS thread; its compiled code is kept in ``cache``."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPATH": os.pathsep.join([str(REPOSITORY / "src"), os.environ.get("PYTHONPATH", "")]),
    }
    script = Path(__file__).with_name("file_run.py")
    done = subprocess.run(
        [sys.executable, str(script), str(file), str(CAPACITY_AH)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=_two_cores if hasattr(os, "sched_setaffinity") else None,
    )
    if done.returncode != 0:
        raise RuntimeError(f"{script.name} failed: {done.stderr.strip().splitlines()[-1]}")
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def _two_cores() -> None:
    usable = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, set(usable[:CORES]))
