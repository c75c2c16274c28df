"""What one process of the physics laboratory does: one cell, one case, one diagnosis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

# Of the laboratory: enough for identification to hold some out when it decides on effects.
DRIVES = 4


def make_cell(task: tuple[Path, str]) -> str:
    from benchmarks.physics_laboratory.cases import laboratory_drives
    from benchmarks.physics_laboratory.cell_physics import capacity_Ah
    from benchmarks.physics_laboratory.published_cells import CELLS
    from benchmarks.physics_laboratory.virtual_laboratory import hppc_log, low_rate_log
    from cellwise import (
        CellTests,
        IdentifySettings,
        identify_cell,
        simulate,
        write_log,
        write_model,
    )

    folder, name = task
    place, cell = folder / "cells" / name, CELLS[name]
    if (place / "model.json").exists():
        return f"{name} is there"
    place.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(list(name.encode()))
    hppc, low = hppc_log(cell, rng), low_rate_log(cell, rng)
    drives = laboratory_drives(cell, rng, DRIVES)
    write_log(hppc, place / "hppc.parquet")
    write_log(low, place / "c20.parquet")
    settings = IdentifySettings(nominal_Ah=capacity_Ah(cell), temperature_C=25.0, name=name)
    tests = CellTests(
        hppc=((hppc, 25.0),), ocv=(low,), drive=tuple((drive, 25.0) for drive in drives)
    )
    found = identify_cell(tests, settings)
    write_model(found.model, place / "model.json")
    own = [simulate(found.model, d, d.soc0).rmse_V for d in drives if d.soc0 is not None]
    return f"{name}: {found.model.capacity_Ah:.3f} Ah, its drives to {1e3 * np.mean(own):.1f} mV"


def make_case(task: tuple[Path, int, str, str, tuple[str, ...]]) -> str:
    from benchmarks.physics_laboratory.cases import draw_case
    from benchmarks.physics_laboratory.stored import write_case

    folder, seed, kind, cells, only = task
    if (folder / f"{kind}_{seed}" / "case.json").exists():
        return f"{kind} {seed} is there"
    try:
        case = draw_case(seed, kind, cells, only)
    except Exception as error:  # one case that a solver cannot do must not end a run of hours
        return f"{kind} {seed} cannot be made: {type(error).__name__}: {error}"
    write_case(case, folder)
    return case.label


def judge_case(task: tuple[Path, bool]) -> Any:
    from benchmarks.physics_laboratory.score import judge
    from benchmarks.physics_laboratory.stored import model_of, read_case
    from cellwise.diagnose import diagnose

    place, bare = task
    case = read_case(place)
    if bare:
        case = replace(case, baseline=())
    try:
        return judge(case, model_of(place.parent, case.cell), diagnose)
    except Exception as error:
        return f"{case.label} broken: {type(error).__name__}: {error}"
