"""The kernels of the usual commands compiled once for this machine, beside the first command.

A command compiles what it needs; what the next ones need is compiled meanwhile, by a process of
its own: numba compiles on one core. `announce` waits for it where both want the same kernel.
"""

from __future__ import annotations

import os
import subprocess
import sys

from cellwise.cell.compiled import QUIET, is_compiled, keeps_compiled, others_compile

# A log with rows enough for a forecast and a diagnosis, and a stock model scaled to its cell.
LOG, ROWS = "nmc_drive_b", 300
MODEL, CAPACITY_AH = "nmc-18650", 5.0
# They take longest, and come first; a command makes smaller ones sooner by itself.
WAITED_FOR = ("kalman_rows", "adaptive_rows")


def begin() -> bool:
    """Start that process where nothing was compiled before; whether it was started."""
    from cellwise.estimate.filters.kalman_kernels import adaptive_rows

    if is_compiled(adaptive_rows) or not keeps_compiled(adaptive_rows):
        return False
    try:
        with others_compile().open("x", encoding="utf-8") as mark:
            mark.write(" ".join(WAITED_FOR))
    except OSError:
        return False  # it runs, or there is no place for its mark
    # It outlives the command, and the terminal is none of its business.
    subprocess.Popen(
        [sys.executable, "-m", "cellwise.first_use"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {QUIET: "1"},
        start_new_session=True,
    )
    return True


def main() -> None:
    """Call each kernel once, those first that are wanted first and take longest."""
    from cellwise.cell.stock import named_model
    from cellwise.data import load_dataset
    from cellwise.diagnose import diagnose
    from cellwise.estimate.filters.kalman import Ekf
    from cellwise.estimate.replay import replay
    from cellwise.forecast.remaining import forecast

    model = named_model(MODEL, CAPACITY_AH)
    log = load_dataset(LOG).part(0, ROWS)
    found = replay(model, log, "ekf", soc0=0.9)
    forecast(model, found)
    replay(model, log, "adaptive", soc0=0.9)
    diagnose(model, log)
    ekf = Ekf(model)
    ekf.step(ekf.init(0.5), 1.0, 3.7, 25.0, dt_s=1.0)


if __name__ == "__main__":
    try:
        main()
    finally:
        others_compile().unlink(missing_ok=True)
