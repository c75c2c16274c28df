"""Many steps of a repeated drive in C: the covariance stays positive, SOC within its bounds."""

from __future__ import annotations

import re
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.example_cell import START_SOC, load_log, two_branches
from benchmarks.figures import Figure, Progress, missing
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.tables import FixedStepTables, fixed_step_tables
from cellwise.export.c_tables import STRICT_FLAGS, firmware_folder, write_sources
from cellwise.export.firmware import host_compiler

STEPS = 10**8
DT_S = 0.1
GROUP = f"Endurance: {STEPS:.0e} steps of {DT_S:g} s, a drive there and back, three states in C"


def endurance_figures(data: Path | None, say: Progress) -> list[Figure]:
    """Smallest leading minor of the scaled covariance, which must stay above zero."""
    figures = []
    for name, wide in (("--lean", False), ("full", True)):
        say(f"{STEPS:,} steps, {name}")
        tables = fixed_step_tables(two_branches(), DT_S, wide=wide)
        try:
            output = long_run(tables, STEPS)
        except InputError as error:
            figures.append(missing(GROUP, name, "", str(error)))
            continue
        found = re.search(r"smallest minor ([-\d.e+]+)", output)
        least = float(found.group(1)) if found else float("nan")
        figures.append(
            Figure(
                GROUP, f"smallest minor, {name}", least, "", target=0.0, at_least=True, note=output
            )
        )
    return figures


def long_run(tables: FixedStepTables, steps: int) -> str:
    """What ``analysis/long_run.c`` says after so many steps.

    Raises
    ------
    InputError        no C compiler
    """
    log = load_log(20_000)
    log = replace(log, time_s=DT_S * np.arange(len(log)), voltage_V=log.voltage_V)
    log = replace(log, voltage_V=simulate(two_branches(), log, START_SOC).voltage_V)
    there = samples_of(two_branches(), log, DT_S).records
    back = there[::-1].copy()
    back["current_A"] *= -1.0
    with tempfile.TemporaryDirectory(prefix="cellwise-") as name:
        folder = Path(name)
        for file, text in write_sources(tables, "0" * 64):
            (folder / file).write_text(text, encoding="utf-8")
        np.concatenate([there, back]).tofile(folder / "drive.bin")
        program = firmware_folder() / "analysis" / "long_run.c"
        sources = ["cellwise_ekf.c", "cell_table.c", str(program)]
        build = [*host_compiler(), *STRICT_FLAGS, "-I.", *sources, "-o", "program", "-lm"]
        subprocess.run(build, cwd=folder, check=True, capture_output=True)
        done = subprocess.run(
            ["./program", "drive.bin", str(steps)],
            cwd=folder, check=False, capture_output=True, text=True,
        )  # fmt: skip
    return done.stdout.strip()
