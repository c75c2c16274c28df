"""Proof by Frama-C Eva, and that it is one: seeded bugs are found."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace

import pytest

from cellwise.cell.effects import ChargeTransfer, Hysteresis, SlowDiffusion, SurfaceSoc
from cellwise.cell.plausibility.validity import Validity
from cellwise.estimate.fixed.options import CellSettings
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.c_tables import firmware_folder, put, write_sources
from example_cells import curved_cell
from firmware_cases import VALID, cutoff_asked, power_asked

pytestmark = [
    pytest.mark.skipif(shutil.which("frama-c") is None, reason="no frama-c: make firmware"),
    pytest.mark.slow,
]

# Name, what is replaced, by what: bugs that a review may overlook.
MUTANTS = {
    "index clamp removed": (
        "    k = (k < (points - 2u)) ? k : (points - 2u);\n",
        "",
    ),
    "NaN through the range test": (
        "if (!POSITIVE_WITHIN(voltage, c->voltage_low_V, c->voltage_high_V)) {",
        "if ((voltage < c->voltage_low_V) || (voltage > c->voltage_high_V)) {",
    ),
    "floor of the innovation variance removed": (
        "return (variance > 0.0f) ? variance : 0.0f;",
        "return variance;",
    ),
    "upper clamp of SOC removed": (
        "        x->soc = within_one(x->soc);",
        "        x->soc = (x->soc < 0.0f) ? 0.0f : x->soc;",
    ),
}


# States are kept apart where the sentences after them depend on it; elsewhere they are joined.
PRECISION = ["-eva-precision", "1", "-eva-split-return", "full"]
APART = "is_sound:900,covariance_is_sound:400,see:200,count_charge:200,cellwise_step:200"
OF_SOH = ",soh_is_sound:900,cellwise_soh_step:200,end_rest:200,cellwise_soh_of:900"
OF_CELLS = ",cell_is_sound:400,step_cell:60,cellwise_cell_of:60,cellwise_cells_step:60"
# 5 SOC points: the code does not depend on their number.
BUILDS = {
    "lean": {"model": curved_cell(5), "wide": False},
    "three states": {"model": curved_cell(5)},
    "offset": {"model": curved_cell(5), "offset": True},
    "slow": {"model": curved_cell(5, effects=(SlowDiffusion(r3_ohm=0.015, tau3_s=1500.0),))},
    "hysteresis": {"model": curved_cell(5, effects=(Hysteresis(m_V=0.02, gamma=40.0),))},
    "transfer": {"model": curved_cell(5, effects=(ChargeTransfer(60.0),)), "wide": False},
    "surface": {"model": curved_cell(5, effects=(SurfaceSoc(0.08, 200.0, 1500.0),)), "wide": False},
    # Intervals: a table of one variance that varies much by SOC would look as if it could be
    # negative between its points, so that the SOC is looked at where the table has its root.
    "validity": {"model": curved_cell(5, validity=replace(VALID, soc=None)), "wide": False},
    "validity of SOC": {"model": curved_cell(5, validity=Validity(soc=VALID.soc))},
}
LEAN = {"model": curved_cell(5), "wide": False}
BESIDE = {
    "power": {**LEAN, "power": power_asked(curved_cell(5))},
    "cells": {**LEAN, "health": True, "cells": CellSettings()},
    "soh": {**LEAN, "soh": True},
    "patch": {**LEAN, "health": True},
    "remaining": {**LEAN, "remaining_V": cutoff_asked(curved_cell(5))},
}
# What is entered with any bits, and the build that it is in.
PROVED = [
    *(("eva_any_bits", build) for build in BUILDS),
    ("eva_any_start", "lean"),
    ("eva_any_start", "three states"),
    ("eva_any_bank_alone", "three states"),
    ("eva_any_power", "power"),
    ("eva_any_remaining", "remaining"),
    ("eva_any_plan", "remaining"),
    ("eva_any_cells", "cells"),
    ("eva_any_soh", "soh"),
    ("eva_any_patch", "patch"),
]


def eva(folder, entry, mutant=None, build="lean"):
    """Alarms and assertions that Eva could not prove."""
    tables = fixed_step_tables(dt_s=1.0, **(BUILDS | BESIDE)[build])
    sources = dict(write_sources(tables, "0" * 64))
    if mutant:
        (name,) = (name for name, text in sources.items() if text.count(mutant[0]) == 1)
        sources[name] = sources[name].replace(*mutant)
    put(sources, folder)
    analysis = firmware_folder() / "analysis"
    # A name that is not there is refused.
    apart = APART + {"cells": OF_CELLS, "soh": OF_SOH}.get(build, "")
    command = ["frama-c", "-eva", *PRECISION, "-eva-slevel-function", apart]
    command += ["-warn-special-float", "none"]
    command += ["-machdep", "gcc_x86_32", "-main", entry]
    command += [f"-cpp-extra-args=-msse2 -mfpmath=sse -I{folder} -include "
                f"{analysis / 'eva_within.h'}"]  # fmt: skip
    files = [folder / "cellwise_ekf.c", folder / "cell_table.c", analysis / "eva_any_bits.c"]
    done = subprocess.run(
        [*command, *map(str, files)], capture_output=True, text=True, timeout=900, check=False
    )
    assert "ANALYSIS SUMMARY" in done.stdout, done.stdout[-2000:]
    return re.findall(r"\[eva:alarm\][^\n]*\n[^\n]*", done.stdout), done.stdout


@pytest.mark.parametrize(("entry", "build"), PROVED)
def test_no_alarm_whatever_bits(tmp_path, entry, build):
    alarms, text = eva(tmp_path, entry, build=build)
    assert alarms == []
    assert "100% of the logical properties reached have been proven" in text


@pytest.mark.parametrize("name", MUTANTS)
def test_seeded_bugs_are_found(tmp_path, name):
    alarms, _ = eva(tmp_path, "eva_any_bits", MUTANTS[name])
    assert alarms


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
def test_what_eva_reads_instead_of_bits_is_the_same(tmp_path):
    tables = fixed_step_tables(curved_cell(5), 1.0, wide=False)
    for name, text in write_sources(tables, "0" * 64):
        (tmp_path / name).write_text(text)
    source = firmware_folder() / "analysis" / "float_bits.c"
    build = ["gcc", "-O3", "-std=c99", "-ffp-contract=off", f"-I{tmp_path}", str(source)]
    subprocess.run([*build, "-o", str(tmp_path / "bits")], check=True)
    done = subprocess.run(
        [str(tmp_path / "bits"), "101"], capture_output=True, text=True, check=False
    )
    assert done.stdout == "0\n"
    assert done.returncode == 0
