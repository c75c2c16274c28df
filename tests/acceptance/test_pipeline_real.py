"""Measured cells against the targets of issue 2; no log that is judged took part in the fit."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellwise.cell.effects import Hysteresis
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model_file import read_model
from cellwise.cell.simulate import simulate
from cellwise.cli import main
from cellwise.estimate.replay import replay
from cellwise.identify import CellTests, Identification, IdentifySettings, identify_cell
from cellwise.logs import CellLog, read_log
from cellwise.notices import texts
from measured_models import identify_once, missed

pytestmark = pytest.mark.slow

JUDGED = ("us06", "hwfta", "nn", "cycle_4")
# The testers' C/20 and OCV tests say how much charge lies between full and empty.
PANASONIC_AH, A123_AH = 2.997, 2.0725
START_ERROR = 0.3
SHORT_OF_IT = "the C/20 gave 4 % more than loads of other days, below 15 % SOC no OCV serves both"


@pytest.fixture(scope="module")
def read(real_data: Path):
    def one(name: str) -> CellLog:
        return read_log(real_data / f"{name}.csv.gz")

    return one


def panasonic(read, *drives) -> Identification:
    folder = "panasonic_18650pf/"
    tests = CellTests(
        hppc=((read(folder + "hppc_p25"), None),),
        ocv=(read(folder + "ocv_c20_p25"),),
        capacity=tuple(read(f"{folder}cap_1c_p25_start_{k}") for k in (1, 2)),
        drive=tuple((read(f"{folder}drive_p25_{name}"), None) for name in drives),
    )
    return identify_once(tests, IdentifySettings(nominal_Ah=2.9))


@pytest.fixture(scope="module")
def laboratory(read):
    return panasonic(read)


@pytest.fixture(scope="module")
def driven(read):
    return panasonic(read, "cycle_2", "cycle_3")


def drive_error_V(model, log) -> float:
    return simulate(model, log, 1.0).rmse_above_10pct_V


def ekf(model, log, capacity_Ah, soc0):
    return replay(
        model, log, "ekf", soc0=soc0, reference_soc0=1.0, reference_capacity_Ah=capacity_Ah
    )


@pytest.mark.xfail(strict=True, reason="29 mV (HWFTa): " + SHORT_OF_IT)
def test_panasonic_from_laboratory_tests_alone(read, laboratory):
    for name in JUDGED:
        log = read(f"panasonic_18650pf/drive_p25_{name}")
        assert drive_error_V(laboratory.model, log) < 0.025
        found = ekf(laboratory.model, log, PANASONIC_AH, 1.0 - START_ERROR)
        assert found.convergence_s is not None
        assert found.convergence_s < 300.0
        assert found.settled.rmse < 0.012


@pytest.mark.xfail(strict=True, reason="15.8 mV in the mean, HWFTa 24: " + SHORT_OF_IT)
def test_panasonic_with_two_drives(read, driven):
    logs = [read(f"panasonic_18650pf/drive_p25_{name}") for name in JUDGED]
    errors = [drive_error_V(driven.model, log) for log in logs]
    assert np.mean(errors) < 0.012
    assert max(errors) < 0.018


def test_the_aged_cells_capacity_test_beside_tests_of_the_new_one(real_data, tmp_path, capsys):
    """Through the command: 12 % less charge is found and said, and drives of the new cell follow.

    Its README has 2.798 Ah of the first 1C test and 2.434 Ah of the one at the end.
    """
    folder = real_data / "panasonic_18650pf"
    model = tmp_path / "model.json"
    files = {"hppc": "hppc_p25", "ocv": "ocv_c20_p25", "capacity": "cap_1c_p25_end_1"}
    given = [a for k, n in files.items() for a in (f"--{k}", str(folder / f"{n}.csv.gz"))]
    for name in ("cycle_2", "cycle_3"):
        given += ["--drive", str(folder / f"drive_p25_{name}.csv.gz")]
    assert main(["identify", *given, "--nominal-ah", "2.9", "-o", str(model), "--json"]) == 0
    said = next(n for n in json.loads(capsys.readouterr().out)["notices"] if "cap_1c" in n)
    held = float(re.search(r"([+-][0-9.]+) % of the others", said).group(1))
    assert held == pytest.approx(100.0 * (2.434 / 2.798 - 1.0), abs=2.0)
    drives = [folder / f"drive_p25_{name}.csv.gz" for name in JUDGED]
    errors = [drive_error_V(read_model(model), read_log(f)) for f in drives]
    assert np.mean(errors) < 0.020  # 0.035 while it bent the tables


@pytest.mark.parametrize("name", missed(JUDGED, hwfta="1.11 %: " + SHORT_OF_IT))
def test_panasonic_with_two_drives_finds_soc(read, driven, name):
    log = read(f"panasonic_18650pf/drive_p25_{name}")
    found = ekf(driven.model, log, PANASONIC_AH, 1.0 - START_ERROR)
    assert found.convergence_s is not None
    assert found.convergence_s < 300.0
    assert found.coverage_2sigma > 0.9
    if name == "cycle_4":
        pytest.xfail(
            "0.74 %: at 7 % SOC a rest is 0.2 V off, five times what is stated; it recovers"
        )
    assert found.settled.rmse < 0.006


def test_the_panasonic_capacities_are_those_of_its_readme(laboratory):
    assert laboratory.model.capacity_Ah == pytest.approx(PANASONIC_AH, rel=0.01)
    assert laboratory.capacities["rate:1C"] == pytest.approx((2.798 + 2.752) / 2, rel=2e-3)
    assert laboratory.capacities["hppc-total"] == pytest.approx(2.83264, rel=1e-3)


def test_the_incomplete_panasonic_charge_branch_is_said(laboratory):
    assert any("charge branch: 2.61" in n for n in texts(laboratory.notices))


def test_the_panasonic_laboratorys_pulses(laboratory):
    # Five discharge pulses at each of 14 levels, fewer where the cold end of a limit stops them.
    assert 60 <= sum(laboratory.pulse_counts.values()) <= 70
    assert laboratory.pulse_counts["healthy"] >= 50


def test_the_leaf_simulates_its_2c_discharge(read):
    tests = CellTests(
        hppc=((read("nissan_leaf/hppc_p25"), None),), capacity=(read("nissan_leaf/cap_1c_p23"),)
    )
    found = identify_once(tests, IdentifySettings(nominal_Ah=33.1))
    assert found.model.capacity_Ah == pytest.approx(30.3, rel=0.01)
    start = found.temperatures[0].pulse_sets[0].anchor
    assert start.soc == pytest.approx(0.0, abs=0.03), "the file begins empty"
    log = read("nissan_leaf/cap_2c_p23")
    soc0 = initial_soc(found.model, log, whole_log=True).soc
    assert simulate(found.model, log, soc0).rmse_above_10pct_V < 0.030


@pytest.fixture(scope="module")
def a123(read):
    tests = CellTests(
        ocv=tuple(read(f"plett_a123/ocv_p25_s{k}") for k in (1, 2, 3, 4)),
        drive=tuple((read(f"plett_a123/dyn_{t}_s1"), None) for t in ("p35", "p45")),
    )
    return identify_once(tests, IdentifySettings(nominal_Ah=2.3))


def test_a123_from_the_right_start_and_from_thirty_points_off(read, a123):
    log = read("plett_a123/dyn_p25_s1")
    right = ekf(a123.model, log, A123_AH, 1.0)
    assert right.errors.rmse < 0.02
    wrong = ekf(a123.model, log, A123_AH, 1.0 - START_ERROR)
    late = log.time_s - log.time_s[0] > 1800.0
    assert float(np.sqrt(np.nanmean(wrong.error[late] ** 2))) < 0.03


def test_a123_capacity_and_hysteresis_are_those_of_its_readme(a123):
    assert a123.model.capacity_Ah == pytest.approx(A123_AH, rel=2e-3)
    m = np.asarray(a123.model.effect(Hysteresis).m_V)
    # LFP keeps a gap of some 10 to 50 mV between its branches.
    assert 0.002 < float(np.median(m)) < 0.030


@pytest.mark.slow
@pytest.mark.parametrize("tag", ["p35", "p45"])
def test_a123_scripts_that_finish_a_charge_at_another_temperature_spoil_nothing(read, tag):
    """They begin near full and move 1 %: taken as a discharge from full they bent the OCV."""
    warm, others = float(tag[1:]), [t for t in ("p25", "p35", "p45") if t != tag]
    tests = CellTests(
        ocv=tuple(read(f"plett_a123/ocv_{tag}_s{k}") for k in (1, 2, 3, 4)),
        drive=tuple((read(f"plett_a123/dyn_{t}_s1"), warm) for t in others),
    )
    found = identify_once(tests, IdentifySettings(nominal_Ah=2.3, temperature_C=warm))
    judged = ekf(found.model, read(f"plett_a123/dyn_{tag}_s1"), A123_AH, 1.0)
    assert judged.errors.rmse < 0.02  # 16 % at 45 degC while they took part
    assert judged.coverage_2sigma > 0.93


@pytest.mark.parametrize("name", ["hppc_p25", "cap_1c_p23"])
def test_a_leaf_log_with_its_sign_swapped_is_refused(read, name):
    from cellwise.errors import InputError

    log = read(f"nissan_leaf/{name}")
    wrong = replace(log, current_A=-log.current_A, charge_Ah=-log.charge_Ah)
    hppc = wrong if name == "hppc_p25" else read("nissan_leaf/hppc_p25")
    capacity = () if name == "hppc_p25" else (wrong,)
    with pytest.raises(InputError, match="`sign="):
        identify_cell(CellTests(hppc=((hppc, None),), capacity=capacity))
