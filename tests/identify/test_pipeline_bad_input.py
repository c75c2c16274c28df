"""Tests that cannot be identified, or only in part: each has a defined answer and one message."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify import CellTests, IdentifySettings, identify_cell
from cellwise.logs.cell_log import CellLog
from cellwise.notices import texts
from synthetic import HppcPlan, Tester, drive_current, driven_log, finish, hppc_log, nmc_cell

CELL = nmc_cell(3.0)
SETTINGS = IdentifySettings(nominal_Ah=3.0, branches=2)
QUICK = replace(SETTINGS, refine=False)


def run(tests, settings=SETTINGS, **changes):
    return identify_cell(tests, replace(settings, **changes))


def pulses(log, **others) -> CellTests:
    return CellTests(hppc=((log, None),), **others)


def drives(*logs, **others) -> CellTests:
    return CellTests(drive=tuple((log, None) for log in logs), **others)


@pytest.fixture(scope="module")
def hppc() -> CellLog:
    levels = (*np.arange(0.9, 0.05, -0.1), 0.0)
    return hppc_log(CELL, HppcPlan(levels=levels, rates_c=(1.0,), noise_V=5e-4)).log


@pytest.fixture(scope="module")
def one_pulse() -> CellLog:
    plan = HppcPlan(levels=(0.7,), rates_c=(1.0,), order="discharge-only", noise_V=5e-4)
    return hppc_log(CELL, plan).log


def discharge(rate, until, name):
    """From full after an hour of rest; ``until`` is the share of the charge that is taken."""
    tester, plan = Tester(CELL, 1.0, np.random.default_rng(5)), HppcPlan(noise_V=5e-4, limit="stop")
    tester.run(0.0, 3600.0, 0.1, plan=plan)
    tester.run(3.0 * rate, 3600.0 * until / rate, 0.1, plan=plan, role="move")
    tester.run(0.0, 3600.0, 0.1, plan=plan)
    return replace(finish(tester, plan).log, name=name)


@pytest.fixture(scope="module")
def low_rate() -> CellLog:
    return discharge(1 / 20, 1.1, "C/20")


@pytest.fixture(scope="module")
def drive() -> CellLog:
    current = drive_current(4000, 1.0, 7.0, np.random.default_rng(1))
    return driven_log(CELL, current, 1.0, soc=1.0, noise_V=5e-4)


def never_rests(soc=1.0) -> CellLog:
    current = drive_current(4000, 1.0, 7.0, np.random.default_rng(1))
    return driven_log(CELL, current[current != 0.0], 1.0, soc=soc, noise_V=5e-4)


def resting() -> CellLog:
    noise = 1e-3 * np.random.default_rng(0).standard_normal(7200)
    return CellLog(np.arange(7200.0), np.zeros(7200), 3.9 + noise, name="rest")


def r0_error(found, lowest: float = 0.3) -> float:
    soc = np.linspace(lowest, 0.9, 30)
    r0 = np.interp(soc, found.model.soc, found.model.r0_ohm[0])
    return float(np.max(np.abs(r0 / CELL.r0_ohm(soc) - 1.0)))


# --- refused ------------------------------------------------------------------------------------


REFUSED = {
    "nothing": (lambda x: CellTests(), QUICK, "`hppc=LOG` or `drive=LOG`"),
    "no pulse": (lambda x: pulses(resting()), QUICK, "of the capacity moved in log 'rest'"),
    "no pulse, refined": (lambda x: pulses(resting()), SETTINGS, "of the capacity moved in log"),
    "no pulse beside an OCV": (
        lambda x: pulses(resting(), ocv=x("low_rate")), QUICK, "no pulse at all in 'rest'",
    ),
    "one long discharge": (
        lambda x: pulses(discharge(0.3, 0.9, "C/3"), ocv=x("low_rate")),
        QUICK,
        "less than a third of the charge",
    ),
    "no rest": (lambda x: pulses(never_rests()), QUICK, "no pulse at all"),
    "a drive, no capacity": (
        lambda x: drives(x("drive")), replace(SETTINGS, nominal_Ah=None), "`nominal_Ah=X`",
    ),
    "a drive, half a capacity test": (
        lambda x: drives(x("drive"), capacity=discharge(0.5, 0.5, "half")),
        replace(SETTINGS, nominal_Ah=None),
        "no complete capacity test",
    ),
    "drives alone, not refined": (lambda x: drives(x("drive")), QUICK, "`refine=False`"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_what_is_missing(case, request):
    tests, settings, said = REFUSED[case]
    with pytest.raises(InputError, match=said):
        run(tests(request.getfixturevalue), settings)


@pytest.mark.parametrize("which", ["hppc", "ocv", "capacity", "drive"])
@pytest.mark.parametrize("settings", [SETTINGS, QUICK], ids=["refined", "plain"])
def test_a_swapped_sign_in_any_log_is_refused(hppc, low_rate, drive, which, settings):
    tests = {"hppc": hppc, "ocv": low_rate, "capacity": low_rate, "drive": drive}
    wrong = tests[which]
    counter = None if wrong.charge_Ah is None else -wrong.charge_Ah
    wrong = replace(wrong, current_A=-wrong.current_A, charge_Ah=counter, name="swapped")
    logs = CellTests(hppc=((hppc, None),), ocv=(low_rate,), capacity=(low_rate,))
    logs = replace(logs, **{which: ((wrong, None),) if which in ("hppc", "drive") else (wrong,)})
    with pytest.raises(InputError, match=r"'swapped'.*`sign='charge-positive'`"):
        run(logs, settings)


@pytest.mark.parametrize("nominal", [0.0, -3.0, float("nan"), float("inf")])
def test_a_nominal_capacity_that_is_none(hppc, nominal):
    with pytest.raises(InputError, match="nominal capacity"):
        run(pulses(hppc), nominal_Ah=nominal)


@pytest.mark.parametrize("rows", [2, 3, 12])
def test_a_log_that_is_too_short(hppc, drive, rows):
    for tests in (pulses(hppc.part(0, rows)), drives(drive.part(0, rows))):
        with pytest.raises(InputError):
            run(tests)


# --- taken, with a notice -----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("tests", ["steady currents", "no pulse, no OCV"])
def test_what_the_tests_do_not_show_is_the_priors(low_rate, tests):
    """A model all the same, which states what it does not know.

    SOC refers to what a capacity test gives: down to 2.5 V, where the made cell's 0 is at 2.68 V.
    """
    given, holds_Ah = {
        "steady currents": (
            CellTests(capacity=(low_rate,), ocv=(low_rate,)),
            float(low_rate.counted_charge_Ah().max()),
        ),
        "no pulse, no OCV": (pulses(never_rests()), CELL.capacity_Ah),
    }[tests]
    found = run(given)
    soc = np.linspace(0.2, 0.9, 30)
    off = np.interp(soc, found.model.soc, found.model.ocv_at(25.0)) - CELL.ocv_V(soc)
    assert np.mean(np.abs(off) < 2.0 * found.model.error.at(soc)) > 0.8
    off = np.log(found.model.capacity_Ah / holds_Ah)
    assert abs(off) < 2.5 * found.model.posterior.capacity_std


def test_one_pulse_and_nothing_else_leaves_most_to_the_population(one_pulse):
    model = run(pulses(one_pulse)).model
    assert model.posterior.capacity_std > 0.02
    assert np.interp(0.7, model.soc, model.r0_ohm[0]) == pytest.approx(
        CELL.r0_ohm(np.array([0.7]))[0], rel=0.1
    )


@pytest.mark.slow
def test_a_drive_from_its_middle_beside_a_low_rate_test(low_rate):
    """The OCV says where the drive begins, but for what its unseen past may have left."""
    found = run(drives(never_rests(0.6), ocv=(low_rate,)))
    said = next(str(n) for n in texts(found.notices) if "by its voltages" in str(n))
    two_sigma = float(said.split("+- ")[1].split(" ")[0])
    assert found.simulations[0].soc0 == pytest.approx(0.6, abs=max(two_sigma, 0.03))
    driven = np.linspace(0.3, 0.6, 7)
    r0 = np.interp(driven, found.model.soc, found.model.r0_ohm[0])
    assert r0 == pytest.approx(CELL.r0_ohm(driven), rel=0.05)


def test_one_pulse_beside_a_low_rate_test(one_pulse, low_rate):
    found = run(pulses(one_pulse, ocv=(low_rate,)), QUICK)
    assert found.pulse_counts["healthy"] == 1
    # One SOC is all it says: its values everywhere.
    assert np.ptp(found.model.r0_ohm) < 1e-6 * found.model.r0_ohm[0, 0]
    assert found.model.r0_ohm[0, 0] == pytest.approx(CELL.r0_ohm(np.array([0.7]))[0], rel=0.02)


def test_a_capacity_test_that_never_reaches_the_limit(hppc):
    found = run(pulses(hppc, capacity=(discharge(0.5, 0.5, "half"),)), QUICK)
    assert found.capacity_choice == "hppc-total"
    assert not any(choice.startswith("rate:") for choice in found.capacities)
    assert any("lower limit" in n for n in texts(found.notices))
    with pytest.raises(InputError, match="one of: nominal"):
        run(
            pulses(hppc, capacity=(discharge(0.5, 0.5, "half"),)), QUICK, capacity_choice="rate:C/2"
        )


@pytest.mark.xfail(strict=True, reason="5.12 mV on its own logs")
def test_a_drive_beside_an_ocv_test_gives_the_truth_back(drive, low_rate):
    found = run(drives(drive, ocv=(low_rate,)))
    assert r0_error(found, lowest=0.5) < 0.02  # as far down as it drives
    assert found.simulations[0].rmse_above_10pct_V < 2e-3
    assert found.fit.rmse_V < 5e-3


def test_missing_voltages_in_the_middle(hppc):
    v = hppc.voltage_V.copy()
    v[2000:3000] = np.nan
    v[::97] = np.nan
    found = run(pulses(replace(hppc, voltage_V=v)))
    assert r0_error(found) < 0.06
    assert np.isfinite(found.fit.rmse_V)


@pytest.mark.parametrize("counter", [True, False])
def test_two_hours_without_a_row_do_not_move_the_parameters(hppc, counter):
    # Two hours without a row in a rest: the cell rested on, or the counter says what flowed.
    time = hppc.time_s.copy()
    row = int(np.flatnonzero(hppc.current_A == 0.0)[3000])
    time[row:] += 7200.0
    charge = hppc.charge_Ah if counter else None
    gap = replace(hppc, time_s=time, charge_Ah=charge)
    assert gap.gap_rows.any()
    found = run(pulses(gap))
    assert r0_error(found) < 0.06
    # Without the counter the later part begins in a rest whose past nobody saw.
    assert found.simulations[0].rmse_above_10pct_V < (3e-3 if counter else 4e-3)


def test_a_log_whose_start_is_unknown_has_it_fitted(hppc, low_rate):
    unknown = replace(never_rests(0.6), name="somewhere")
    found = run(pulses(hppc, ocv=(low_rate,), drive=((unknown, None),)))
    assert not any("'somewhere' left out" in n for n in texts(found.notices))
    starts = {s.log.name: s.soc0 for s in found.simulations}
    assert starts["somewhere"] == pytest.approx(0.6, abs=0.02)
    assert r0_error(found) < 0.06


def test_a_log_that_moves_more_than_the_cell_holds_makes_no_model(hppc, drive):
    # A model is made only if it would serve: this one is hundreds of millivolts off.
    twice = replace(drive, current_A=2.5 * drive.current_A, name="too much")
    with pytest.raises(InputError, match=r"mV off its own logs; .*'too much'"):
        run(pulses(hppc, drive=((twice, None),)))
