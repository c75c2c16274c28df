"""The fixed step on measured drives: the SOC of the float64 EKF, in the cold too."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.noise import Noise
from cellwise.export.firmware import Firmware
from cellwise.identify import CellTests, IdentifySettings
from cellwise.logs import read_log
from cellwise.logs.cell_log import resample
from measured_models import identify_once

pytest.importorskip("cffi")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc"),
]


def log_of(folder, name):
    return read_log(folder / "panasonic_18650pf" / f"{name}.csv.gz")


@pytest.fixture(scope="module")
def cold_model(real_data):
    """From the pulses at -20 degC alone: time constants of thousands of steps."""
    tests = CellTests(
        hppc=((log_of(real_data, "hppc_n20"), -20.0),), ocv=(log_of(real_data, "ocv_c20_p25"),)
    )
    return identify_once(tests, IdentifySettings(nominal_Ah=2.9)).model


@pytest.mark.parametrize("dt_s", [0.1, 1.0])
@pytest.mark.parametrize("name", ["drive_n20_cycle_2", "drive_n20_us06", "drive_p25_us06"])
def test_soc_is_that_of_the_float64_ekf(name, dt_s, cold_model, real_data):
    log = resample(log_of(real_data, name), dt_s)
    # Full, as these drives begin. The hypothesis of an offset a target does not have.
    noise = replace(Noise.of_model(cold_model), offset_share=0.0)
    theirs = Ekf(cold_model, noise).run(log, 1.0, 0.015).soc
    ours = Firmware(cold_model, dt_s=dt_s).run(log, 1.0, 0.015).soc
    apart = 100 * np.sqrt(np.mean((ours - theirs) ** 2))
    assert apart < 0.05  # points


@pytest.fixture(scope="module")
def two_temperatures(real_data):
    """From C/20 and the pulses at 25 and at -10 degC: no drive."""
    tests = CellTests(
        hppc=tuple((log_of(real_data, f"hppc_{t}"), c) for t, c in (("p25", 25.0), ("n10", -10.0))),
        ocv=(log_of(real_data, "ocv_c20_p25"),),
    )
    return identify_once(tests, IdentifySettings(nominal_Ah=2.9)).model


def cut_in_the_middle(log, at):
    """From the first load below a SOC on, its true SOC over the C/20's charge beside it."""
    log = resample(log, 1.0)
    soc = 1.0 - (log.charge_Ah - log.charge_Ah[0]) / 2.9973
    first = int(np.argmax(soc < at))
    first += int(np.argmax(log.current_A[first:] > 1.0))
    return log.part(first, len(log)), soc[first:]


@pytest.mark.parametrize("tag", ["p25", "n10"])
def test_the_c_finds_a_start_as_the_float64_ekf_does(tag, two_temperatures, real_data):
    """Cut under load, 30 points wrong and told 15: what runs on the target, after ten minutes."""
    ekf, c = Ekf(two_temperatures), Firmware(two_temperatures, dt_s=1.0)
    apart, theirs, ours, inside = [], [], [], []
    for name in ("us06", "nn", "cycle_2", "hwfta" if tag == "p25" else "la92"):
        for at, wrong in ((0.65, -0.30), (0.50, 0.30)):
            log, soc = cut_in_the_middle(log_of(real_data, f"drive_{tag}_{name}"), at)
            late = log.time_s - log.time_s[0] > 600.0
            a, b = (f.run(log, float(soc[0]) + wrong, 0.15) for f in (ekf, c))
            apart.append(np.sqrt(np.mean((a.soc - b.soc)[late] ** 2)))
            theirs.append(np.sqrt(np.mean((a.soc - soc)[late] ** 2)))
            ours.append(np.sqrt(np.mean((b.soc - soc)[late] ** 2)))
            inside.append(np.mean(np.abs(b.soc - soc)[late] < 2.0 * b.soc_std[late]))
    assert len(ours) == 8
    assert np.median(ours) < np.median(theirs) + 0.003
    assert np.max(apart) < 0.01
    assert np.mean(inside) > 0.90


@pytest.mark.parametrize("tag", ["p25", "n10"])
def test_the_grid_of_the_tables_costs_no_accuracy(tag, two_temperatures, real_data):
    """As few SOC points as the model's error allows, beside all of the model's 201: 0.05 points."""
    chosen, all_points = (Firmware(two_temperatures, dt_s=1.0, points=n) for n in (None, 201))
    assert chosen.stepper(1.0).tables.options.points < two_temperatures.points == 201
    for name in ("us06", "nn"):
        log, soc = cut_in_the_middle(log_of(real_data, f"drive_{tag}_{name}"), 0.65)
        late = log.time_s - log.time_s[0] > 600.0
        for wrong, std in ((0.0, 0.01), (-0.30, 0.15)):
            runs = (f.run(log, float(soc[0]) + wrong, std) for f in (chosen, all_points))
            few, many = (100.0 * np.sqrt(np.mean((r.soc - soc)[late] ** 2)) for r in runs)
            assert few < many + 0.05
