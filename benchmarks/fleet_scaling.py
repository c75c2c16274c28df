"""Fleet replay against the kernel's own speed, with one and two workers.

python -m benchmarks.fleet_scaling [--logs 2000] [--samples 36000] [--json]

The logs are a few distinct drives under many names (hard links): what is read comes out of the
system's file cache. `kernel` is the estimator's compiled loop over a log in memory, on as many
threads as the fleet has workers, measured right before and after each run; the share is the fleet's
samples per second over the kernel's. `parsed` reads parquet (zstd) as `read_log` does, without the
check of the sign; `prepared` maps what --cache kept of an earlier run.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.example_cell import load_log, three_branches
from benchmarks.machine import describe_machine, machine_lines
from cellwise.estimate.replay import make_estimator
from cellwise.fleet import ReplayTask, run_fleet
from cellwise.logs import write_log

DISTINCT = 10
KERNEL_S = 3.0


def make_fleet(folder: Path, logs: int, samples: int) -> None:
    """Logs under many names."""
    first = []
    for seed in range(min(DISTINCT, logs)):
        first.append(write_log(load_log(samples, seed), folder / f"pack_{seed:05d}.parquet"))
    for k in range(len(first), logs):
        os.link(first[k % len(first)], folder / f"pack_{k:05d}.parquet")


def kernel_rate(estimator: str, samples: int, threads: int) -> float:
    """Samples per second of the compiled loop, all threads together."""
    model, log = three_branches(), load_log(samples)
    filters = [make_estimator(estimator, model) for _ in range(threads)]
    filters[0].run(log, 0.9)
    runs = [0] * threads
    end = time.perf_counter() + KERNEL_S

    def work(k: int) -> None:
        while time.perf_counter() < end:
            filters[k].run(log, 0.9)
            runs[k] += 1

    began = time.perf_counter()
    workers = [threading.Thread(target=work, args=(k,)) for k in range(threads)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return sum(runs) * samples / (time.perf_counter() - began)


def measure(folder: Path, estimator: str, workers: int, samples: int, how: str, scheduler: str):
    """One run of the fleet."""
    task = ReplayTask(
        three_branches(),
        estimator=estimator,
        cache=str(folder / "cache") if how == "prepared" else "",
    )
    before = kernel_rate(estimator, samples, workers)
    found = run_fleet(
        task, folder / "logs", folder / "out", scheduler=scheduler, workers=workers, fresh=True
    )
    after = kernel_rate(estimator, samples, workers)
    kernel = 0.5 * (before + after)
    return {
        "estimator": estimator,
        "scheduler": scheduler,
        "workers": workers,
        "logs": how,
        "seconds": found.seconds,
        "failed": found.failed,
        "samples_per_s": found.samples / found.seconds,
        "kernel_samples_per_s": kernel,
        "share_of_kernel": found.samples / found.seconds / kernel,
    }


def main(arguments: list[str] | None = None) -> int:
    """All combinations asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=2000)
    parser.add_argument("--samples", type=int, default=36_000)
    parser.add_argument("--estimators", default="ekf,ukf,adaptive")
    parser.add_argument("--schedulers", default="local,processes")
    parser.add_argument("--json", action="store_true")
    told = parser.parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "logs").mkdir()
        make_fleet(folder / "logs", told.logs, told.samples)
        filled = ReplayTask(three_branches(), cache=str(folder / "cache"))
        first = run_fleet(filled, folder / "logs", folder / "out", scheduler="processes")
        for estimator in told.estimators.split(","):
            for scheduler in told.schedulers.split(","):
                for how in ("parsed", "prepared"):
                    for workers in (1, 2):
                        row = measure(folder, estimator, workers, told.samples, how, scheduler)
                        rows.append(row)
                        if not told.json:
                            print(
                                f"{estimator:9s} {scheduler:9s} {how:8s} {workers} worker(s): "
                                f"{row['seconds']:6.1f} s, {1e-6 * row['samples_per_s']:5.2f} M "
                                f"samples/s, {100 * row['share_of_kernel']:.0f} % of the kernel",
                                flush=True,
                            )
    machine = describe_machine()
    if told.json:
        print(json.dumps({"machine": machine, "first_run_s": first.seconds, "fleet": rows}))
    else:
        print(f"first run, that reads, checks and keeps every log: {first.seconds:.1f} s")
        print("\n".join(machine_lines(machine)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
