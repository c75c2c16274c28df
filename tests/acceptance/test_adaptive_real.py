"""Panasonic 18650PF at 25 degC, made wrong: sensors, capacity. Means over six drives not fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.estimate.replay import replay
from cellwise.identify import CellTests, IdentifySettings
from cellwise.logs import read_log
from measured_models import identify_once

REFERENCE_AH = 2.997
JUDGED = ("us06", "hwfta", "hwftb", "nn", "cycle_3", "cycle_4")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def panasonic(real_data):
    folder = real_data / "panasonic_18650pf"

    def log(name):
        return read_log(folder / f"{name}.csv.gz")

    tests = CellTests(
        hppc=((log("hppc_p25"), None),),
        ocv=(log("ocv_c20_p25"),),
        capacity=(log("cap_1c_p25_start_1"), log("cap_1c_p25_start_2")),
        drive=((log("drive_p25_cycle_2"), None),),
    )
    model = identify_once(tests, IdentifySettings(nominal_Ah=2.9)).model
    return model, [log(f"drive_p25_{name}") for name in JUDGED]


def judged(model, logs, estimator):
    found = [
        replay(model, log, estimator, soc0=0.7, reference_soc0=1.0,
               reference_capacity_Ah=REFERENCE_AH)
        for log in logs
    ]  # fmt: skip
    return float(np.mean([r.settled.rmse for r in found])), found


# At its bound: on another processor it may lie on its other side.
@pytest.mark.parametrize(
    "offset",
    [pytest.param(0.1, marks=pytest.mark.xfail(strict=False, reason="1.21 %")), -0.1],
)
def test_an_offset_of_3_per_cent_of_1c(panasonic, offset):
    model, logs = panasonic
    rmse, found = judged(model, [replace(g, current_A=g.current_A + offset) for g in logs],
                         "adaptive")  # fmt: skip
    assert rmse < 0.012
    told = [one.trace.parameters().offset_A.value / offset for one in found]
    assert min(told) > 0.0
    assert np.median(told) > 0.5  # above C/100 a rest may be a load: only voltages tell


@pytest.mark.parametrize("gain", [0.97, 1.03])
def test_a_gain_of_3_per_cent(panasonic, gain):
    model, logs = panasonic
    rmse, _ = judged(model, [replace(g, current_A=g.current_A * gain) for g in logs], "adaptive")
    assert rmse < 0.012


@pytest.mark.parametrize("offset", [0.005, -0.005])
def test_a_voltage_offset_of_5_mV(panasonic, offset):
    model, logs = panasonic
    moved = [replace(g, voltage_V=g.voltage_V + offset) for g in logs]
    assert judged(model, moved, "adaptive")[0] < 0.010


LATE = pytest.mark.xfail(strict=True, reason="another capacity is found late: 1.6, 1.8 %")


@pytest.mark.parametrize("factor", [pytest.param(0.9, marks=LATE), pytest.param(1.1, marks=LATE)])
def test_a_capacity_that_is_10_per_cent_wrong(panasonic, factor):
    model, logs = panasonic
    wrong = replace(model, capacity_Ah=factor * model.capacity_Ah)
    rmse, found = judged(wrong, logs, "adaptive")
    assert rmse < 0.015
    for one in found:
        value = one.trace.parameters().capacity_Ah.value
        assert value == pytest.approx(REFERENCE_AH, rel=0.03)


def test_without_a_fault_it_is_hardly_worse_than_the_ekf(panasonic):
    model, logs = panasonic
    assert judged(model, logs, "adaptive")[0] < judged(model, logs, "ekf")[0] + 0.002
