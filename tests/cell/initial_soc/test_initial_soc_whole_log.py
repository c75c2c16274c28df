"""SOC at the first row by the whole log, where its beginning cannot tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.simulate import simulate
from cellwise.identify import CellTests, IdentifySettings
from cellwise.logs import read_log
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, lfp_cell
from measured_models import AT_ITS_BOUND, identify_once, missed
from virtual_tester import logged

A123_AH = 2.0725
CUTS = (0.95, 0.8, 0.6, 0.4)


def driven(model, soc0, first_row, rows=10_000):
    """A drive of 25 s pulses at up to 1C to 3 % SOC, cut while the load has polarised the cell."""
    rng = np.random.default_rng(3)
    current = model.capacity_Ah * np.repeat(rng.uniform(-0.2, 1.0, 400), 25)
    log = CellLog(np.arange(float(current.size)), current, np.zeros(current.size))
    whole = simulate(model, log, soc0)
    noise = 0.002 * rng.standard_normal(len(log))
    end = min(first_row + rows, int(np.argmax(whole.soc < 0.03)))
    part = replace(log, voltage_V=whole.voltage_V + noise).part(first_row, end)
    return part, float(whole.soc[first_row])


@pytest.mark.parametrize("soc0", [0.95, 0.8, 0.7])
def test_on_a_plateau_the_knee_at_the_end_tells_where_it_began(soc0):
    model = lfp_cell().with_effect(SlowDiffusion(0.01, 1200.0))
    part, true = driven(model, soc0, 1500)
    beginning = initial_soc(model, part)
    found = initial_soc(model, part, whole_log=True)
    assert beginning.std > 0.05
    assert abs(found.soc - true) < 0.02
    assert abs(found.soc - true) < 2.5 * found.std
    assert found.std < 0.5 * beginning.std
    assert found.how.startswith("fit of the whole log, ")
    assert found.how.endswith(" h")


def test_what_the_log_cannot_tell_stays_open():
    model = lfp_cell().with_effect(SlowDiffusion(0.01, 1200.0))
    part, true = driven(model, 0.7, 1500, 600)
    found = initial_soc(model, part, whole_log=True)
    assert found.std > 0.05
    assert abs(found.soc - true) < 2.0 * found.std


def test_a_rest_on_a_steep_ocv_is_enough():
    model = curved_cell()
    log = CellLog(np.arange(4000.0), np.r_[np.zeros(3600), np.full(400, 2.0)], np.zeros(4000))
    log = logged(model, log, 0.4)
    assert initial_soc(model, log, whole_log=True) == initial_soc(model, log)


def test_without_a_later_voltage_the_beginning_counts():
    model = curved_cell()
    part, _ = driven(model, 0.8, 1500, 3000)
    lost = part.voltage_V.copy()
    lost[2:] = np.nan
    found = initial_soc(model, replace(part, voltage_V=lost), whole_log=True)
    assert 0.0 <= found.soc <= 1.0
    assert np.isfinite(found.std)


@pytest.mark.parametrize(
    "name",
    missed(
        ("dyn_p25_s1", "dyn_p45_s1"),
        dyn_p25_s1="3.3 points with 3.1 stated",
        dyn_p45_s1=f"2.01 points with 8.1 stated: {AT_ITS_BOUND}",
    ),
)
def test_measured_lfp_drives_cut_on_the_plateau(real_data, a123, name):
    log = read_log(real_data / f"plett_a123/{name}.csv.gz")
    soc = 1.0 - log.counted_charge_Ah() / A123_AH
    for cut in CUTS:
        row = int(np.argmax(soc < cut))
        row += int(np.argmax(log.current_A[row:] > 0.3 * A123_AH))
        part = replace(log.part(row, len(log)), charge_Ah=None, soc0=None)
        found = initial_soc(a123, part, whole_log=True)
        assert abs(found.soc - soc[row]) < 0.02, (cut, found)
        assert simulate(a123, part, found.soc).rmse_V < 0.03


@pytest.fixture(scope="module")
def a123(real_data):
    def log(name):
        return read_log(real_data / f"plett_a123/{name}.csv.gz")

    tests = CellTests(
        ocv=tuple(log(f"ocv_p25_s{k}") for k in (1, 2, 3, 4)),
        drive=((log("dyn_p35_s1"), None),),
    )
    return identify_once(tests, IdentifySettings(nominal_Ah=2.3, chemistry="LFP")).model


@pytest.mark.parametrize("row", [300, 307, 320])
def test_a_rest_that_was_cut_out_of_a_load_is_not_taken_for_a_finished_one(row):
    """A voltage that still rises says less of the OCV, and more than it reads."""
    model = curved_cell().with_effect(SlowDiffusion(0.03, 1200.0))
    current = np.r_[np.full(300, model.capacity_Ah), np.zeros(60)]
    log = CellLog(np.arange(360.0), current, np.zeros(360))
    whole = simulate(model, log, 0.9)
    noise = model.error.white_V * np.random.default_rng(1).standard_normal(360)
    part = replace(log, voltage_V=whole.voltage_V + noise).part(row, row + 12)
    found = initial_soc(model, part)
    assert abs(found.soc - whole.soc[row]) < 3.0 * found.std
    read_as_ocv = float(np.interp(part.voltage_V[-1], model.ocv_V[0], model.soc))
    assert found.soc > read_as_ocv + 0.01
