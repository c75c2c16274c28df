"""Little data: where they have been they rule, elsewhere the prior stands, marked and uncertain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from prior_cells import CAPACITY_AH, drive_of, other_cell

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import named_model, stock_model
from cellwise.errors import InputError
from cellwise.estimate.replay import replay
from cellwise.identify import IdentifySettings, TestLogs, identify_cell
from cellwise.identify.prior.from_prior import Choice
from cellwise.logs.cell_log import CellLog

SETTINGS = IdentifySettings(nominal_Ah=CAPACITY_AH)
PRIOR = replace(SETTINGS, prior=stock_model("nmc-18650"))


def drives(*logs):
    return TestLogs(drive=tuple((log, None) for log in logs))


def ocv_error(found, cell, low, high):
    soc = np.linspace(low, high, 50)
    one, true = (np.interp(soc, m.soc, m.ocv_V[0]) for m in (found, cell))
    return one - true


@pytest.fixture(scope="module")
def known(cell, flight):
    """One flight whose initial SOC is stated."""
    return identify_cell(drives(replace(flight, soc0=0.65)), PRIOR)


@pytest.fixture(scope="module")
def unknown(flight):
    return identify_cell(drives(flight), PRIOR)


def test_where_the_data_have_been_they_rule(known, cell):
    stock = named_model("nmc-18650", CAPACITY_AH)
    before = np.sqrt(np.mean(ocv_error(stock, cell, 0.47, 0.63) ** 2))
    after = np.sqrt(np.mean(ocv_error(known.model, cell, 0.47, 0.63) ** 2))
    assert after < 0.3 * before
    middle = slice(47, 64)
    factor = np.median(known.model.r0_ohm[0, middle] / stock.r0_ohm[0, middle])
    assert factor == pytest.approx(1.3, rel=0.05)


def test_elsewhere_the_prior_stands_and_is_marked(known):
    (low, high), *others = known.model.provenance["prior"]["seen"]["soc"]
    assert not others
    assert (low, high) == pytest.approx((0.45, 0.65), abs=0.05)
    unseen = known.model.provenance["prior"]["from_prior"]["soc"]
    assert [s[0] for s in unseen] == pytest.approx([0.0, 0.65], abs=0.05)
    assert any("the model is the prior nmc-18650" in n for n in known.notices)
    assert known.to_dict()["prior"]["name"] == "nmc-18650"


def test_the_model_is_valid_where_its_own_data_have_been(known, flight):
    assert known.model.validity.soc == pytest.approx((0.45, 0.65), abs=0.02)
    assert known.model.validity.current_A[1] <= float(np.max(flight.current_A))


def test_the_error_grows_from_what_was_seen_to_the_prior(known):
    error, stock = known.model.error, stock_model("nmc-18650").error
    # The drive ends where it ends; a fifth of the range further the prior's spread is back.
    assert error.at(0.55) < 0.5 * stock.at(0.55)
    assert error.at(0.15) > 0.6 * stock.at(0.15)


def test_a_part_charged_pack_never_reads_full(unknown, flight):
    start = next(o.simulation.soc0 for o in unknown.own_logs)
    assert start == pytest.approx(0.65, abs=0.1)
    assert initial_soc(unknown.model, flight).soc == pytest.approx(0.65, abs=0.1)


@pytest.mark.parametrize("shift", [-0.06, -0.03, 0.03, 0.06])
def test_the_stated_deviation_of_the_soc_holds_the_truth(shift):
    cell = other_cell(shift=shift)
    log = drive_of(cell, 0.65, 0.45, seed=5)
    found = replay(identify_cell(drives(log), PRIOR).model, log)
    truth = 0.65 - log.counted_charge_Ah() / CAPACITY_AH
    away = np.abs(found.trace.soc - truth) / found.trace.soc_std
    assert np.median(away) < 2.5


def test_without_a_prior_one_is_chosen_by_the_voltage_window(flight):
    found = identify_cell(drives(flight), SETTINGS)
    assert found.model.provenance["prior"]["name"] in ("nmc-18650", "nca-18650")
    assert any("`prior=NAME`" in n for n in found.notices)
    assert found.model.ocv_V.min() > 2.0


def test_a_stated_start_over_most_of_the_range_needs_no_prior(cell):
    log = replace(drive_of(cell, 1.0, 0.1), soc0=1.0)
    assert identify_cell(drives(log), SETTINGS).to_dict()["prior"] is None


@pytest.mark.slow
def test_thirty_drives_know_the_capacity_better_than_one(cell, flight):
    aged = replace(cell, capacity_Ah=0.88 * CAPACITY_AH)
    rng = np.random.default_rng(8)
    starts = rng.uniform(0.5, 0.95, 30)
    logs = [drive_of(aged, s, s - 0.25, seed=20 + k) for k, s in enumerate(starts)]
    found = identify_cell(drives(*logs), PRIOR)
    assert abs(found.model.capacity_Ah / aged.capacity_Ah - 1.0) < 0.06
    one = identify_cell(drives(flight), PRIOR)
    several, alone = (f.model.provenance["prior"]["capacity_std_Ah"] for f in (found, one))
    assert several < 0.6 * alone


@pytest.mark.slow
def test_a_capacity_test_alone_is_enough(cell):
    current = np.concatenate((np.zeros(600), np.full(40_000, CAPACITY_AH / 2.0), np.zeros(600)))
    log = CellLog(
        time_s=np.arange(current.size, dtype=float),
        current_A=current,
        voltage_V=np.full(current.size, 3.7),
        name="half a C",
    )
    voltage = simulate(cell, log, 1.0).voltage_V
    last = int(np.argmax(voltage < 2.8))
    assert last > 0
    log = replace(log.part(0, last), voltage_V=voltage[:last])
    found = identify_cell(TestLogs(capacity=(log,)), PRIOR)
    assert found.model.capacity_Ah == pytest.approx(CAPACITY_AH, rel=0.04)
    assert np.sqrt(np.mean(ocv_error(found.model, cell, 0.2, 0.95) ** 2)) < 0.03
    chosen = identify_cell(TestLogs(capacity=(log,)), SETTINGS)
    assert chosen.model.capacity_Ah == pytest.approx(CAPACITY_AH, rel=0.06)


def test_no_size_of_the_cell_is_refused(flight):
    with pytest.raises(InputError, match="`nominal_Ah=X`"):
        identify_cell(drives(flight), replace(PRIOR, nominal_Ah=None))


def test_a_voltage_that_no_stock_model_has_is_refused(flight):
    odd = replace(flight, voltage_V=flight.voltage_V - 2.2)
    with pytest.raises(InputError, match="`prior="):
        identify_cell(drives(odd), SETTINGS)


def test_a_log_that_hardly_moves_is_refused_alone_and_left_out_beside_another(flight):
    n = 600
    rest = CellLog(time_s=np.arange(n, dtype=float), current_A=np.zeros(n),
                   voltage_V=np.full(n, 3.9), name="rest")  # fmt: skip
    with pytest.raises(InputError, match="of the capacity moved in log 'rest'"):
        identify_cell(drives(rest), PRIOR)
    own = {o.simulation.log.name: o for o in identify_cell(drives(flight, rest), PRIOR).own_logs}
    assert not own["rest"].used
    assert "moved" in own["rest"].reason


@pytest.mark.slow
def test_what_several_kinds_show_alike_is_not_known(monkeypatch):
    """Were all kinds as probable, what they differ by would be the model's error."""
    cell = other_cell()
    short = drive_of(cell, 0.6, 0.57)
    sure = identify_cell(drives(short), SETTINGS)
    alike = Choice(undecided=1e9, other_soc=-1.0)
    monkeypatch.setattr("cellwise.identify.prior.from_prior.LIMITS", alike)
    found = identify_cell(drives(short), SETTINGS)
    assert "several kinds of cell show alike" in found.notices[0]
    assert found.model.capacity_std_Ah > sure.model.capacity_std_Ah
    stated = found.model.error.at(np.linspace(0.1, 0.95, 50))
    assert np.mean(stated) > np.mean(sure.model.error.at(np.linspace(0.1, 0.95, 50)))
    assert np.mean(np.abs(ocv_error(found.model, cell, 0.1, 0.95)) < 2.0 * stated) > 0.95


def test_a_log_that_moves_more_than_the_cell_holds_is_refused(flight):
    with pytest.raises(InputError, match="mA for A"):
        identify_cell(drives(flight), replace(PRIOR, nominal_Ah=0.5))
