"""Tests of two cells, scales or temperatures are refused or said first, good ones pass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise import InputError, load_dataset, read_log
from cellwise.cell.plausibility.notice import in_order
from cellwise.cli.identifying import print_identification
from cellwise.identify import CellTests, IdentifySettings, identify_cell
from cellwise.identify.checked_logs import check_logs
from cellwise.identify.measured_capacity import measure_capacity
from cellwise.logs.checks.sign import contradiction
from cellwise.notices import Code, Notice, coded

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
    return CellTests(hppc=tuple((x, None) for x in hppc), drive=tuple((x, None) for x in drive),
                    **others)  # fmt: skip


def contradictions(tests, settings=QUICK):
    """What the first two stations find."""
    checked = check_logs(tests, settings)
    return [*checked.contradictions, *measure_capacity(checked, settings).contradictions]


def texts(notices):
    return " ".join(n.text for n in notices)


def test_logs_of_one_cell_pass_in_silence(hppc, low_rate, drive):
    tests = together((hppc,), (drive,), ocv=(low_rate,))
    assert contradictions(tests) == []


@pytest.mark.parametrize("cells", [2, 3, 4])
@pytest.mark.parametrize("which", ["hppc", "ocv", "capacity", "drive"])
def test_a_pack_is_asked_for_its_cells_in_series(hppc, low_rate, drive, cells, which):
    logs = {"hppc": hppc, "ocv": low_rate, "capacity": low_rate, "drive": drive}
    pack = replace(logs[which], voltage_V=cells * logs[which].voltage_V, name="pack")
    tests = together((hppc,), (drive,), ocv=(low_rate,), capacity=(low_rate,))
    wrong = ((pack, None),) if which in ("hppc", "drive") else (pack,)
    with pytest.raises(InputError, match=r"'pack'.*`series=") as refused:
        contradictions(replace(tests, **{which: wrong}))
    if cells > 2:  # two of 3 V are no more than one of 6 V
        assert f"{cells} cells in series" in refused.value.action


def test_a_cell_read_as_a_pack_is_refused_beside_one(hppc, drive):
    quarter = replace(drive, voltage_V=drive.voltage_V / 4, name="quarter")
    with pytest.raises(InputError, match=r"'quarter'.*`series="):
        contradictions(together((hppc,), (quarter,)))


@pytest.mark.parametrize("factor", [10.0, 1000.0])
def test_a_current_in_another_scale_is_refused(hppc, low_rate, drive, factor):
    for tests in (
        together((hppc,), (scaled(drive, factor),)),
        together((scaled(hppc, factor),), (drive,), ocv=(low_rate,)),
        together((hppc,), ocv=(scaled(low_rate, factor),)),
    ):
        with pytest.raises(InputError, match="mA for A"):
            contradictions(tests)


def test_a_part_of_a_drive_in_another_scale_is_said_first(hppc, drive):
    part = replace(scaled(drive.part(0, 900), 10.0, "flight"), soc0=1.0)
    tests = together((hppc,), (part,))
    assert "'flight'" in first_said(tests, replace(QUICK, refine=True, branches=2))


def test_a_tenth_of_the_nominal_capacity_is_refused_and_ten_times_of_it_said_first(hppc):
    with pytest.raises(InputError, match="nominal"):
        identify_cell(together((hppc,)), replace(QUICK, nominal_Ah=0.5))
    assert "empty after" in first_said(together((hppc,)), replace(QUICK, nominal_Ah=50.0))


def test_another_capacity_than_the_nominal_one_is_said_with_both(hppc):
    (notice,) = contradictions(together((hppc,)), replace(QUICK, nominal_Ah=3.0))
    assert "Ah (hppc-total) is 1.7" in notice.text
    assert "times the nominal 3 Ah" in notice.text


def test_the_command_says_it_in_its_first_line(hppc, low_rate, capsys):
    other = scaled(load_dataset("nmc_cap_c5"), 1.3, "other")
    tests = together((hppc,), ocv=(low_rate,), capacity=(other,))
    found = identify_cell(tests, QUICK)
    print_identification(found)
    first, *rest = capsys.readouterr().out.splitlines()
    assert first.startswith("  ! ")
    assert "'other'" in first
    assert not any(line == first for line in rest)


def test_a_capacity_test_of_far_more_charge_is_said_first_and_moves_nothing(hppc, low_rate):
    """It keeps a capacity of its own; what the others say of the cell stays."""
    other = scaled(load_dataset("nmc_cap_c5"), 1.6, "other")
    found = identify_cell(together((hppc,), ocv=(low_rate,), capacity=(other,)), QUICK)
    assert "'other' moves" in found.notices[0].text
    assert found.model.capacity_Ah == pytest.approx(found.capacities["rate:C/20"], rel=5e-3)
    of_others = [o for o in found.own_logs if o.simulation.log.name != "other"]
    assert max(o.simulation.rmse_V for o in of_others) < 0.03


def first_said(tests, settings):
    try:
        return identify_cell(tests, settings).notices[0].text
    except InputError as error:
        return error.found


def test_a_drive_of_another_cell_is_said_first(hppc, low_rate, lfp_drive):
    wrong = replace(lfp_drive, name="other")
    tests = together((hppc,), (wrong,), ocv=(low_rate,))
    assert "'other'" in first_said(tests, replace(QUICK, refine=True))


@pytest.mark.slow
def test_exchanged_temperatures_are_said_with_the_resistances(hppc):
    cold = load_dataset("nmc_hppc_p00")
    bare = [replace(log, temperature_C=None) for log in (hppc, cold)]
    right = identify_cell(CellTests(hppc=((bare[0], 25.0), (bare[1], 0.0))), QUICK)
    assert not coded(right.contradictions, Code.TEMPERATURES_EXCHANGED)
    found = identify_cell(CellTests(hppc=((bare[0], 0.0), (bare[1], 25.0))), QUICK)
    assert found.contradictions[0].code is Code.TEMPERATURES_EXCHANGED
    measured = [
        replace(log, temperature_C=np.full(len(log), t)) for log, t in ((hppc, 25.0), (cold, 0.0))
    ]
    stated = contradictions(CellTests(hppc=((measured[0], 0.0), (measured[1], 25.0))))
    assert "measured 25.0 to 25.0 degC" in texts(stated)


def test_drives_of_a_part_of_the_range_are_no_full_discharges(drive):
    """A pack's highest and lowest voltages of a month are neither full nor empty."""
    little, much = drive.part(0, len(drive) // 6), drive.part(0, len(drive) // 2)
    voltage = little.voltage_V.copy()
    voltage[-1] = float(np.nanmin(much.voltage_V)) - 0.05
    wide = replace(little, voltage_V=voltage, name="little")
    assert contradictions(together((), (wide, replace(much, name="much")))) == []


def test_the_most_harmful_comes_first_and_a_wrong_sign_before_all():
    sign = contradiction("charge-positive")
    small, large, read = (Notice(Code.GAP, "a gap", size_V=size) for size in (0.1, 0.5, 9.0))
    found = in_order([small, large], (read, sign))
    assert found == (sign, large, small, read)


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
    settings = IdentifySettings()
    assert contradictions(together(logs[:1], logs[1:]), settings) == []
