"""Which claim of measured data can be had through the command, on the files as published.

A capability that a test shows in Python has its door twin: the same claim through `cellwise`, on
files that nobody prepared. Those without one are listed with the reason.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import NamedTuple

import pytest

from sources import tree_of

TESTS = Path(__file__).resolve().parents[1]
DOOR = "cli/test_door_twins.py"


class Capability(NamedTuple):
    """A module that shows it on measured cells; its twin as file::function, or why none."""

    claim: str
    shown_in: str
    twin: str = ""
    why_none: str = ""


CAPABILITIES = (
    Capability("laboratory tests to a model", "acceptance/test_pipeline_real.py",
               f"{DOOR}::test_capacities_are_those_of_the_readme"),
    Capability("held-out drives and their SOC", "acceptance/test_pipeline_real.py",
               f"{DOOR}::test_a_held_out_drive_and_its_soc"),
    Capability("a fast discharge of pulses and a slow one", "acceptance/test_pipeline_real.py",
               f"{DOOR}::test_a_fast_discharge_of_pulses_and_a_slow_one"),
    Capability("a month of a car holds for others", "acceptance/test_one_drive_real.py",
               f"{DOOR}::test_a_month_of_a_car_holds_for_the_next"),
    Capability("nobody of a healthy pack is accused", "acceptance/test_leaf_pack.py",
               f"{DOOR}::test_nobody_of_a_healthy_pack_is_accused"),
    Capability("a life by its discharges", "acceptance/test_samsung_life.py",
               f"{DOOR}::test_a_life_in_the_order_of_its_files"),
    Capability("fade over 48 cycles", "history/test_ageing.py",
               f"{DOOR}::test_history_finds_the_measured_fade_of_a_lipo_at_4c"),
    Capability("one start of a log", "cell/initial_soc/test_initial_soc_whole_log.py",
               f"{DOOR}::test_a_log_cut_anywhere_has_one_start_in_every_command"),
    Capability("fixed step as the EKF", "estimate/fixed/test_fixed_step_measured.py",
               f"{DOOR}::test_the_fixed_step_is_the_ekf"),
    Capability("native files as their tidy twins", "logs/formats/test_native_files.py",
               f"{DOOR}::test_every_native_file_is_inspected"),
    Capability("a test is known by its content", "identify/hppc/test_phases.py",
               "cli/runs/test_start.py::test_measured_files_are_what_their_makers_named_them"),
    Capability("cells of two kinds in one folder", "logs/formats/test_native_files.py",
               "cli/runs/test_start.py::test_native_files_are_read_and_grouped_by_cell"),
    Capability("a fault put into one cell of a pack", "acceptance/test_leaf_pack.py",
               why_none="the fault is put into the cells of whole months in Python"),
    Capability("rest voltages of 96 cells", "acceptance/test_leaf_rests.py",
               why_none="`pack` does not print the rests it found"),
    Capability("the capacity that a target estimates", "estimate/capacity/test_soh_measured.py",
               why_none="it is read in the target's firmware: no command steps it"),
    Capability("a life by drives and rests", "acceptance/test_panasonic_life.py",
               why_none="two capacities bound it, which the test works out from rests"),
    Capability("rates and temperatures without pulses",
               "acceptance/test_rates_and_temperatures_real.py",
               why_none="28 logs in one fit: a minute of processor time, once is enough"),
    Capability("faults that the adaptive filter finds", "acceptance/test_adaptive_real.py",
               why_none="offset, gain and skew are added to the logs in Python"),
    Capability("no worse than counting", "acceptance/test_no_worse_than_counting.py",
               why_none="starts and offsets are varied in Python; a panel of hundreds of runs"),
    Capability("the same on other cells", "acceptance/test_no_worse_on_other_cells.py",
               why_none="a panel of models and starts"),
    Capability("LFP on its plateau", "acceptance/test_lfp_plateau.py",
               why_none="each temperature is left out of a fit in turn"),
    Capability("power of a pulse left out", "acceptance/test_power_real.py",
               why_none="every second SOC level is taken out of a pulse test in Python"),
    Capability("the end of a discharge", "acceptance/test_flight_real.py",
               why_none="forecasts are judged in the middle of a log, which is cut for it"),
    Capability("time to full", "forecast/test_charging.py",
               why_none="forecasts are judged at many rows of a charge"),
    Capability("hidden effects named", "acceptance/test_hidden_effects.py",
               why_none="the effect is hidden in Python"),
    Capability("a cold cell is not called aged", "diagnose/test_age.py",
               why_none="ten models of subsets of temperatures"),
    Capability("a flight sample by sample", "live/test_ulog_stream.py",
               why_none="the stream is compared with the library that reads the whole file"),
    Capability("an unknown start in a stream", "live/test_live_filter.py",
               f"{DOOR}::test_a_measured_drive_as_a_stream_begins_as_the_log_does"),
    Capability("a measured drive by a broker", "live/test_mqtt.py",
               "live/test_mqtt.py::test_a_measured_drive_by_a_broker_is_the_same_as_by_a_file"),
)  # fmt: skip


def functions_of(path: Path) -> set[str]:
    return {node.name for node in ast.walk(tree_of(path)) if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("one", CAPABILITIES, ids=lambda one: one.claim)
def test_a_twin_exists_and_runs_the_command(one):
    assert (TESTS / one.shown_in).is_file()
    assert bool(one.twin) != bool(one.why_none)
    if one.twin:
        file, _, function = one.twin.partition("::")
        assert function in functions_of(TESTS / file)


def test_every_module_that_shows_what_a_command_can_is_listed():
    """Of the folders whose measured tests claim a result; those of readers and fits claim none."""
    folders = ("estimate", "forecast", "history", "pack", "live")
    shown = {
        path.relative_to(TESTS).as_posix()
        for folder in folders
        for path in (TESTS / folder).rglob("test_*.py")
        if "real_data" in path.read_text()
    }
    # The current of a file adds up; the bits of a sketch are those of the C.
    plumbing = {"estimate/filters/test_coulomb.py", "estimate/sketch/test_accumulate.py"}
    assert shown - {one.shown_in for one in CAPABILITIES} == plumbing
