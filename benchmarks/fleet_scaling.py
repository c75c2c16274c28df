"""Fleet replay against the kernel's own speed, with one and two workers.

python -m benchmarks.fleet_scaling [--logs 2000] [--samples 36000] [--json]

The logs are a few distinct drives under many names (hard links): what is read comes out of the
system's file cache. `kernel` is the estimator's compiled loop over a log in memory, on as many
threads as the fleet has workers, measured right before and after each run. Its share is
stated twice: by the clock, and by the processor time that a sample takes in the kernel and in all
of the run, which is what the clock says of an idle machine. `csv`, `parquet` are
read as `read_log` does, without the check of the sign; `prepared` maps what --cache kept of an
earlier run.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import tempfile
import threading
import time
from pathlib import Path

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.example_cell import load_log, three_branches
from benchmarks.figures import describe_machine, machine_lines
from cellwise.estimate.estimators import make_estimator
from cellwise.fleet import ReplayTask, run_fleet
from cellwise.logs import write_log

DISTINCT = 10
KERNEL_S = 3.0


def make_fleet(folder: Path, logs: int, samples: int, kind: str) -> None:
    """Logs under many names."""
    folder.mkdir()
    first = []
    for seed in range(min(DISTINCT, logs)):
        first.append(write_log(load_log(samples, seed), folder / f"pack_{seed:05d}.{kind}"))
    for k in range(len(first), logs):
        os.link(first[k % len(first)], folder / f"pack_{k:05d}.{kind}")


def cpu_s() -> float:
    """Processor time of this process and of the children that have ended [s]."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


def kernel_rate(estimator: str, samples: int, threads: int) -> tuple[float, float]:
    """Samples per second of the compiled loop: of the clock, and of processor time."""
    model, log = three_branches(), load_log(samples)
    filters = [make_estimator(estimator, model) for _ in range(threads)]
    filters[0].run(log, 0.9)
    runs = [0] * threads
    end = time.perf_counter() + KERNEL_S

    def work(k: int) -> None:
        while time.perf_counter() < end:
            filters[k].run(log, 0.9)
            runs[k] += 1

    began, used = time.perf_counter(), cpu_s()
    workers = [threading.Thread(target=work, args=(k,)) for k in range(threads)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    done = sum(runs) * samples
    return done / (time.perf_counter() - began), done / (cpu_s() - used)


def measure(folder: Path, estimator: str, workers: int, samples: int, how: str, scheduler: str):
    """One run of the fleet."""
    task = ReplayTask(
        three_branches(),
        estimator=estimator,
        cache=str(folder / "cache") if how == "prepared" else "",
    )
    before, before_cpu = kernel_rate(estimator, samples, workers)
    used = cpu_s()
    logs = folder / ("parquet" if how == "prepared" else how)
    found = run_fleet(task, logs, folder / "out", scheduler=scheduler, workers=workers, fresh=True)
    used = cpu_s() - used
    after, after_cpu = kernel_rate(estimator, samples, workers)
    kernel, kernel_cpu = 0.5 * (before + after), 0.5 * (before_cpu + after_cpu)
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
        "cpu_ms_per_log": 1e3 * used / found.done,
        "kernel_cpu_ms_per_log": 1e3 * samples / kernel_cpu,
        "share_of_cpu": found.samples / used / kernel_cpu,
    }


def main(arguments: list[str] | None = None) -> int:
    """All combinations asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=2000)
    parser.add_argument("--samples", type=int, default=36_000)
    parser.add_argument("--estimators", default="ekf,ukf,adaptive")
    parser.add_argument("--schedulers", default="local,processes")
    parser.add_argument("--kinds", default="csv,parquet,prepared")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kinds = chosen.kinds.split(",")
        for kind in {"parquet", *kinds} - {"prepared"}:
            make_fleet(folder / kind, chosen.logs, chosen.samples, kind)
        filled = ReplayTask(three_branches(), cache=str(folder / "cache"))
        first_s = 0.0
        if "prepared" in kinds:
            first = run_fleet(filled, folder / "parquet", folder / "out", scheduler="processes")
            first_s = first.seconds
        for estimator in chosen.estimators.split(","):
            for scheduler in chosen.schedulers.split(","):
                for how in kinds:
                    for workers in (1, 2):
                        row = measure(folder, estimator, workers, chosen.samples, how, scheduler)
                        rows.append(row)
                        if not chosen.json:
                            print(
                                f"{estimator:9s} {scheduler:9s} {how:8s} {workers} worker(s): "
                                f"{row['seconds']:6.1f} s, {1e-6 * row['samples_per_s']:5.2f} M "
                                f"samples/s, {100 * row['share_of_kernel']:.0f} % of the kernel; "
                                f"{row['cpu_ms_per_log']:.1f} ms of CPU a log, "
                                f"{100 * row['share_of_cpu']:.0f} % of it the kernel's",
                                flush=True,
                            )
    machine = describe_machine()
    if chosen.json:
        print(json.dumps({"machine": machine, "first_run_s": first_s, "fleet": rows}))
    else:
        print(f"first run, that reads, checks and keeps every log: {first_s:.1f} s")
        print("\n".join(machine_lines(machine)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
