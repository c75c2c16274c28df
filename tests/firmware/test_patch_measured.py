"""SOC of the C with a patch, beside new tables of the same finding, on measured drives.

An effect is hidden in measured drives at 25 degC as `benchmarks.ablation.diagnosis` hides them: two
drives are seen by the diagnosis or by a fit that goes on from the model, the SOC is judged on three
others. The truth is what the tester counted.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.measured_data import measured_log

from cellwise.diagnose import diagnose
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.export.firmware import HostLibrary
from cellwise.export.patch import HELD, patch_between, patch_of, patched_rows, taken
from cellwise.identify import CellTests, IdentifySettings
from cellwise.logs import CellLog
from cellwise.logs.cell_log import resample
from measured_models import identified_samsung, identify_once, rmse, samsung_log

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc"),
]
SEEN, JUDGED = ("nn", "hwfta"), ("us06", "hwftb", "cycle_4")
STARTS = ((1.0, 0.02, 0.0), (0.85, 0.15, 0.2))  # SOC, its deviation, share of the log not judged
SETTLED = 600  # rows before which a filter finds its start
OF_FULL, OF_NONE = 0.003, 0.002  # the issue's: of what new tables give, of what no patch gives
SHIFT_V = (0.0, -0.02, -0.035, -0.03, -0.01, 0.01, 0.02, 0.01, 0.0)


def hidden(log, effect, capacity_Ah):
    """The log as a cell and sensors with the effect would give it, and its SOC."""
    log = resample(log, 1.0)
    current_A = log.known_current_A()
    soc = 1.0 - np.cumsum(current_A * log.interval_s) / 3600.0 / capacity_Ah
    read_A, voltage_V = current_A, log.voltage_V
    if effect == "offset":
        read_A = current_A + 0.06
    elif effect == "gain":
        read_A = 0.92 * current_A
    elif effect == "capacity":  # every ampere moves it further
        read_A = 0.9 * current_A
    elif effect == "ocv":
        voltage_V = voltage_V + np.interp(soc, np.linspace(0.0, 1.0, 9), SHIFT_V)
    elif effect in ("ohmic", "ohmic towards empty"):
        grows = np.clip(1.0 - 2.0 * soc, 0.0, 1.0) if effect != "ohmic" else 1.0
        voltage_V = voltage_V - 0.02 * grows * current_A
    return CellLog(log.time_s, read_A, voltage_V, log.temperature_C, name=log.name), soc


@cache
def bench(folder):
    """Model of the cell by its tests and two drives, the drives that are seen and judged."""

    def log(name):
        return measured_log(folder, f"panasonic_18650pf/{name}")

    two = tuple(log(f"drive_p25_cycle_{k}") for k in (2, 3))
    tests = CellTests(
        hppc=log("hppc_p25"), ocv=log("ocv_c20_p25"), capacity=log("cap_1c_p25_start_1"), drive=two
    )
    model = identify_once(tests, IdentifySettings(nominal_Ah=2.9)).model
    return model, *([log(f"drive_p25_{n}") for n in names] for names in (SEEN, JUDGED))


def soc_of(cell, log, soc0, std, patch=None):
    """SOC of the compiled C."""
    made = fixed_step_tables(cell, 1.0, health=True)
    stepper = HostLibrary(made)
    memory = stepper.start_filter(11, soc0, std)
    records = samples_of(cell, log, 1.0).records
    if patch is None:
        return stepper.filter_rows(memory, records)["soc"].astype(float)
    block = taken(patch.block(made), made)
    return patched_rows(stepper, block, memory, records)["soc"].astype(float)


def errors(folder, effect, found):
    """SOC RMSE without, with the patch, with new tables, (runs, 3); ``found`` makes both."""
    model, seen, judged = bench(folder)
    known = [hidden(log, effect, model.capacity_Ah)[0] for log in seen]
    patch, new, of_sensor = found(model, known)
    rows = []
    for one in judged:
        log, soc = hidden(one, effect, model.capacity_Ah)
        right_A = (log.current_A - of_sensor.get("offset_A", 0.0)) / of_sensor.get("gain", 1.0)
        right = replace(log, current_A=right_A)
        for soc0, std, unjudged in STARTS:
            from_row = int(unjudged * soc.size)
            runs = (
                soc_of(model, log, soc0, std),
                soc_of(model, log, soc0, std, patch),
                soc_of(new, right, soc0, std),
            )
            rows.append([rmse((run - soc)[from_row:]) for run in runs])
    return np.array(rows).T


def diagnosed(model, logs, soc0=1.0):
    warm = np.concatenate([log.temperature_C for log in logs])
    found = diagnose(model, logs[:1], holdout=logs[1:], soc0=soc0)
    causes = {c.name: c.parameters for c in found.causes}
    new = found.extended_model or model
    patch = patch_of(causes, model, 1, new, (float(warm.min()), float(warm.max())))
    sensors = {HELD[name]: of[HELD[name]] for name, of in causes.items() if HELD.get(name)}
    return patch, new, sensors


def fitted(model, logs):
    warm = np.concatenate([log.temperature_C for log in logs])
    tests = CellTests(drive=tuple((replace(log, soc0=1.0), None) for log in logs))
    new = identify_once(tests, IdentifySettings(nominal_Ah=2.9, prior=model)).model
    return patch_between(model, new, 1, (float(warm.min()), float(warm.max()))), new, {}


@pytest.mark.parametrize("effect", ["offset", "gain", "capacity", "ocv", "ohmic"])
def test_a_diagnosis_as_a_patch_gives_the_soc_of_its_new_tables(real_data, effect):
    without, patched, full = errors(real_data, effect, diagnosed)
    assert np.all(patched <= full + OF_FULL)
    assert np.all(patched <= without + OF_NONE)
    assert np.mean(patched) < np.mean(without)


@pytest.mark.parametrize("effect", ["ohmic", "ohmic towards empty", "ocv"])
def test_a_new_fit_as_a_patch_gives_the_soc_of_its_new_tables(real_data, effect):
    _, patched, full = errors(real_data, effect, fitted)
    assert np.all(patched <= full + OF_FULL)


@pytest.mark.parametrize("cycle", [401, 431])
def test_an_aged_cell_as_a_patch_gives_the_soc_of_its_new_tables(real_data, cycle):
    """Samsung 30Q after so many cycles, tables of new cells; judged 10 and 20 cycles later.

    The truth is counted from full over what the discharge to 2.5 V then gives.
    """
    model = identified_samsung(real_data)

    def life(number):
        return resample(samsung_log(real_data, f"d1_cellA_cycle{number:03d}"), 1.0)

    patch, new, sensors = diagnosed(model, [life(cycle)], soc0=None)
    assert not sensors
    errors = []
    for later in (10, 20):
        log = life(cycle + later)
        left_Ah = np.cumsum(log.known_current_A() * log.interval_s) / 3600.0
        soc = 1.0 - (left_Ah - left_Ah.min()) / np.ptp(left_Ah)
        for off, std in ((0.0, 0.02), (0.15, 0.15)):
            start = float(np.clip(soc[0] + off, 0.0, 1.0))
            runs = (
                soc_of(model, log, start, std),
                soc_of(model, log, start, std, patch),
                soc_of(new, log, start, std),
            )
            errors.append([rmse((run - soc)[SETTLED:]) for run in runs])
    without, patched, full = np.array(errors).T
    assert np.all(patched <= full + OF_FULL)
    assert np.all(patched < without)
    assert np.mean(patched) < 0.75 * np.mean(without)
