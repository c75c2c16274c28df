"""Tests of two cells, scales or temperatures are refused or said first, good ones pass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise import CellLog, InputError, load_dataset, read_log
from cellwise.cell.plausibility.notice import Notice, in_order
from cellwise.cli.identifying import print_identification
from cellwise.identify import IdentifySettings, TestLogs, identify_cell
from cellwise.identify.contradictions import (
    capacity_notices,
    check_serves,
    contradictions,
    step_resistance,
    whole_charge_Ah,
)
from cellwise.logs.checks.sign import contradiction

CAPACITY = 5.0
QUICK = IdentifySettings(refine=False, nominal_Ah=CAPACITY)


@pytest.fixture(scope="module")
def hppc():
    return load_dataset("nmc_hppc")


@pytest.fixture(scope="module")
def low_rate():
    return load_dataset("nmc_ocv_c20")


@pytest.fixture(scope="module")
def drive():
    return load_dataset("nmc_drive_c")


@pytest.fixture(scope="module")
def lfp_drive():
    return load_dataset("lfp_hppc")


def scaled(log, factor, name="scaled"):
    charge = None if log.charge_Ah is None else factor * log.charge_Ah
    return replace(log, current_A=factor * log.current_A, charge_Ah=charge, name=name)


def together(hppc=(), drive=(), **others):
    return TestLogs(hppc=tuple((x, None) for x in hppc), drive=tuple((x, None) for x in drive),
                    **others)  # fmt: skip


def texts(notices):
    return " ".join(n.text for n in notices)


def test_logs_of_one_cell_pass_in_silence(hppc, low_rate, drive):
    tests = together((hppc,), (drive,), ocv=(low_rate,))
    assert contradictions(tests, 25.0, CAPACITY) == []
    assert capacity_notices(tests, CAPACITY, "nominal", CAPACITY) == []


@pytest.mark.parametrize("cells", [2, 3, 4])
@pytest.mark.parametrize("which", ["hppc", "ocv", "capacity", "drive"])
def test_a_pack_is_asked_for_its_cells_in_series(hppc, low_rate, drive, cells, which):
    logs = {"hppc": hppc, "ocv": low_rate, "capacity": low_rate, "drive": drive}
    pack = replace(logs[which], voltage_V=cells * logs[which].voltage_V, name="pack")
    tests = together((hppc,), (drive,), ocv=(low_rate,), capacity=(low_rate,))
    wrong = ((pack, None),) if which in ("hppc", "drive") else (pack,)
    with pytest.raises(InputError, match=r"'pack'.*`series=") as refused:
        contradictions(replace(tests, **{which: wrong}), 25.0)
    if cells > 2:  # two of 3 V are no more than one of 6 V
        assert f"{cells} cells in series" in refused.value.action


def test_a_cell_read_as_a_pack_is_refused_beside_one(hppc, drive):
    quarter = replace(drive, voltage_V=drive.voltage_V / 4, name="quarter")
    with pytest.raises(InputError, match=r"'quarter'.*`series="):
        contradictions(together((hppc,), (quarter,)), 25.0)


@pytest.mark.parametrize("factor", [10.0, 0.1, 1000.0])
def test_a_current_in_another_scale_is_refused(hppc, low_rate, drive, factor):
    for tests in (
        together((hppc,), (scaled(drive, factor),)),
        together((scaled(hppc, factor),), (drive,), ocv=(low_rate,)),
        together((hppc,), ocv=(scaled(low_rate, factor),)),
    ):
        with pytest.raises(InputError, match="'scaled'"):
            contradictions(tests, 25.0)


def test_a_part_of_a_drive_in_another_scale_is_noticed(hppc, drive):
    part = scaled(drive.part(0, 900), 10.0, "flight")
    (notice,) = contradictions(together((hppc,), (part,)), 25.0)
    assert "'flight'" in notice.text
    assert "mohm" in notice.text


@pytest.mark.parametrize("nominal", [0.5, 50.0])
def test_ten_times_the_nominal_capacity_is_refused(hppc, drive, nominal):
    for tests in (together((hppc,)), together((), (drive,))):
        with pytest.raises(InputError, match="nominal"):
            identify_cell(tests, replace(QUICK, nominal_Ah=nominal))


def test_another_capacity_than_the_nominal_one_is_said_with_both(hppc):
    (notice,) = capacity_notices(together((hppc,)), 4.9, "hppc-total", 3.0)
    assert "4.9 Ah (hppc-total) is 1.63 times the nominal 3 Ah" in notice.text


def test_a_capacity_log_of_another_cell_is_said_first(hppc, low_rate):
    other = scaled(load_dataset("nmc_cap_c5"), 1.6, "other")
    tests = together((hppc,), ocv=(low_rate,), capacity=(other,))
    assert "'other'" in first_said(tests, QUICK)


def test_the_command_says_it_in_its_first_line(hppc, low_rate, capsys):
    other = scaled(load_dataset("nmc_cap_c5"), 1.6, "other")
    tests = together((hppc,), ocv=(low_rate,), capacity=(other,))
    found = identify_cell(tests, QUICK)
    print_identification(found)
    first, *rest = capsys.readouterr().out.splitlines()
    assert first.startswith("  ! ")
    assert "'other'" in first
    assert not any(line == first for line in rest)


def first_said(tests, settings):
    try:
        return identify_cell(tests, settings).notices[0]
    except InputError as error:
        return error.found


def test_a_drive_of_another_cell_is_said_first(hppc, low_rate, lfp_drive):
    wrong = replace(lfp_drive, name="other")
    tests = together((hppc,), (wrong,), ocv=(low_rate,))
    assert "'other'" in first_said(tests, replace(QUICK, refine=True))


def test_exchanged_temperatures_are_said_with_the_resistances(hppc):
    cold = load_dataset("nmc_hppc_p00")
    right = TestLogs(hppc=((hppc, 25.0), (cold, 0.0)))
    assert contradictions(right, 25.0) == []
    bare = [replace(log, temperature_C=None) for log in (hppc, cold)]
    found = contradictions(TestLogs(hppc=((bare[0], 0.0), (bare[1], 25.0))), 25.0)
    assert "exchanged" in texts(found)
    measured = [
        replace(log, temperature_C=np.full(len(log), t)) for log, t in ((hppc, 25.0), (cold, 0.0))
    ]
    found = contradictions(TestLogs(hppc=((measured[0], 0.0), (measured[1], 25.0))), 25.0)
    assert "measured 25.0 to 25.0 degC" in texts(found)


def test_a_cold_log_says_nothing_of_the_capacity(hppc, drive):
    """At its lower limit under load it is far from empty."""
    half = replace(scaled(drive, 0.4, "cold"), temperature_C=np.full(len(drive), -20.0))
    assert not any("from full to empty" in n.text for n in contradictions(
        together((hppc,), (half,)), 25.0))  # fmt: skip


def test_the_charge_from_full_to_empty_is_that_of_one_discharge(low_rate):
    from cellwise.identify.contradictions import Tested

    others = [Tested(low_rate, 25.0, False, True)]
    found = whole_charge_Ah(low_rate, others)
    assert found == pytest.approx(CAPACITY, rel=0.03)
    half = low_rate.part(0, len(low_rate) // 4)
    assert whole_charge_Ah(half, [*others, Tested(half, 25.0, False, True)]) is None


def test_the_plateau_of_a_narrow_window_is_neither_full_nor_empty():
    """Pulses down to the lower limit all along an LFP plateau, and a slow discharge."""
    from cellwise.identify.contradictions import Tested

    capacity, points = 6.4, 4001
    soc = np.linspace(1.0, 0.0, points)
    ocv = 3.25 + 0.10 * (soc - 0.5) + 0.06 * np.exp(-40 * (1 - soc)) - 0.5 * np.exp(-30 * soc)
    hours = np.linspace(0.0, 20.0, points)
    pulses = np.where(np.arange(points) % 400 > 390, 4.0 * capacity, capacity / 20.0)
    charge = capacity * (1.0 - soc)

    def log(current, name):
        volts, warm = ocv - 0.01 * current, np.full(points, 25.0)
        return CellLog(3600.0 * hours, current, volts, warm, charge_Ah=charge, name=name)

    logs = [
        Tested(log(pulses, "pulses"), 25.0, True, True),
        Tested(log(np.full(points, capacity / 20.0), "slow"), 25.0, False, True),
    ]
    assert np.ptp([one.log.voltage_V for one in logs]) < 1.0
    for one in logs:
        assert whole_charge_Ah(one.log, logs) == pytest.approx(capacity, rel=0.02)


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_voltage_that_comes_late_does_not_change_the_resistance(hppc, late):
    moved = replace(hppc, voltage_V=np.roll(hppc.voltage_V, late))
    assert step_resistance(moved) == pytest.approx(step_resistance(hppc), rel=0.35)


def test_the_most_harmful_comes_first_and_a_wrong_sign_before_all():
    sign = contradiction("charge-positive")
    found = in_order([Notice(0.1, "b"), Notice(0.5, "a")], ("read", sign))
    assert found == (sign, "a", "b", "read")


def test_a_model_of_contradictory_tests_is_made_only_if_it_serves():
    wrong = [Notice(0.5, "two cells")]
    check_serves(0.05, wrong)
    check_serves(0.5, [])
    with pytest.raises(InputError, match=r"500 mV off its own logs; two cells"):
        check_serves(0.5, wrong)


@pytest.mark.parametrize(
    ("hppc", "others"),
    [
        ("panasonic_18650pf/hppc_{t}", ("panasonic_18650pf/drive_{t}_us06",)),
        ("nissan_leaf/hppc_{t}", ()),
    ],
)
@pytest.mark.parametrize("t", ["p25", "p10"])
def test_measured_logs_of_one_cell_do_not_contradict(real_data, hppc, others, t):
    logs = [read_log(real_data / f"{name.format(t=t)}.csv.gz") for name in (hppc, *others)]
    assert contradictions(together(logs[:1], logs[1:]), 25.0) == []
