"""Wrong units under a plain name: refused when definite, told when likely, never silent."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs import CellLog, read_log
from cellwise.notices import texts
from log_files import pulse_channels


def without_counter(columns):
    return {k: v for k, v in columns.items() if k != "ampere_hours"}


def scaled(name: str, factor: float, offset: float = 0.0) -> dict[str, np.ndarray]:
    columns = pulse_channels()
    columns[name] = columns[name] * factor + offset
    return columns


def notices(columns) -> str:
    return " / ".join(texts(CellLog.from_table(columns).notices))


def test_right_units_raise_no_notice():
    assert notices(pulse_channels()) == ""
    assert notices(without_counter(pulse_channels())) == ""


@pytest.mark.parametrize("field", ["current_A", "time_s"])
def test_milliampere_or_milliseconds_without_a_counter_are_said_first(field):
    """A thousand times the charge is more than a cell holds."""
    columns = without_counter(pulse_channels(24 * 3600))
    columns[field] = 1000.0 * columns[field]
    said = CellLog.from_table(columns).notices[0].text
    assert "current_mA" in said
    assert "time_ms" in said


def test_a_large_cell_is_not_taken_for_milliampere():
    """1500 A: a 300 Ah cell, and possible."""
    columns = pulse_channels()
    columns["current_A"] = columns["current_A"] * 500.0
    columns["ampere_hours"] = columns["ampere_hours"] * 500.0
    columns["voltage_V"] = 4.1 - 0.003 * columns["ampere_hours"] - 2e-4 * columns["current_A"]
    assert notices(columns) == ""
    assert notices(without_counter(columns)) == ""


@pytest.mark.parametrize(
    ("field", "factor", "name"),
    [("current_A", 1000.0, "current_mA"), ("time_s", 1000.0, "time_ms"), ("time_s", 1e6, "time_us"),
     ("time_s", 1 / 60, "time_min"), ("time_s", 1 / 3600, "time_h"),
     ("voltage_V", 1000.0, "voltage_mV")],
)  # fmt: skip
def test_another_unit_against_the_counter_or_any_cell_is_refused(field, factor, name):
    with pytest.raises(InputError, match=name):
        CellLog.from_table(scaled(field, factor))


@pytest.mark.parametrize(
    ("name", "factor", "offset", "says"),
    [("ampere_hours", 1000.0, 0.0, "milliampere hours"),
     ("ampere_hours", 3600.0, 0.0, "ampere seconds"),
     ("ampere_hours", -1.0, 0.0, "inverted"),  # the voltage confirms the current
     ("temperature_C", 1.0, 273.15, "kelvin")],
)  # fmt: skip
def test_what_is_sure_is_converted_and_said(name, factor, offset, says):
    log = CellLog.from_table(scaled(name, factor, offset))
    field = "charge_Ah" if name == "ampere_hours" else name
    np.testing.assert_allclose(getattr(log, field), pulse_channels()[name], atol=1e-12)
    assert any(says in notice for notice in texts(log.notices))


@pytest.mark.parametrize(
    ("cells", "says"), [(6, "some 7 cells in series"), (96, "pack of some 106 cells")]
)
def test_a_pack_is_reported_as_such(cells, says):
    assert says in notices(scaled("voltage_V", cells))


def test_a_voltage_below_zero_is_said():
    columns = pulse_channels()
    columns["voltage_V"][30] = -0.5
    assert "below zero" in notices(columns)


def test_impossible_temperatures_are_missing_values():
    columns = pulse_channels()
    columns["temperature_C"][5:8] = -273.15  # an open thermocouple
    log = CellLog.from_table(columns)
    assert np.isnan(log.temperature_C[5:8]).all()
    assert np.isfinite(log.temperature_C).sum() == len(log) - 3
    assert any("3 temperature(s)" in notice for notice in texts(log.notices))


def test_counter_that_restarts_is_joined_up():
    """As testers count: from zero in every step."""
    columns = pulse_channels()
    counter, truth = columns["ampere_hours"].copy(), columns["ampere_hours"]
    for row in (400, 700, 1000):
        counter[row:] -= counter[row - 1]
    log = CellLog.from_table({**columns, "ampere_hours": counter})
    np.testing.assert_allclose(log.charge_Ah, truth, atol=1e-12)
    assert any("restarts 3 time(s)" in notice for notice in texts(log.notices))


def test_counter_of_throughput_is_left_out():
    columns = pulse_channels()
    period = columns["time_s"] % 300.0
    columns["current_A"] = np.where(period < 100, 3.0, np.where(period < 200, -3.0, 0.0))
    moved = np.abs(columns["current_A"]) / 3600.0
    columns["ampere_hours"] = np.cumsum(moved)
    log = CellLog.from_table(columns)
    assert log.charge_Ah is None
    assert any("does not follow the current" in notice for notice in texts(log.notices))


def test_counter_that_disagrees_is_reported():
    """Net 180 - 30 = 150 A s of 210 A s moved in every period: 5 % of the net is 3.6 %."""
    assert "3.6 % of the charge moved" in notices(scaled("ampere_hours", 1.05))


def test_measured_logs_raise_no_suspicion_of_units(real_data):
    words = ("looks like", "name the column", "more than a cell holds", "LOOKS WRONG", "restarts")
    packs = ("copter_4s", "modules_")  # of these it is right to say so
    cells = [p for p in real_data.glob("*/*.csv.gz") if not p.name.startswith(packs)]
    for path in sorted(cells)[::5]:
        for notice in texts(read_log(path).notices):
            assert not any(word in notice for word in words), (path.name, notice)


@pytest.mark.parametrize("field", ["current_A", "time_s"])
@pytest.mark.parametrize("name", ["panasonic_18650pf/hppc_p25", "nissan_leaf/hppc_p25"])
def test_measured_logs_in_another_unit_are_said_or_refused(real_data, name, field):
    log = read_log(real_data / f"{name}.csv.gz")
    columns = {"time_s": log.time_s, "current_A": log.current_A, "voltage_V": log.voltage_V}
    columns[field] = 1000.0 * columns[field]
    assert "more than a cell holds" in CellLog.from_table(columns).notices[0].text
    with pytest.raises(InputError, match="current_mA"):
        CellLog.from_table({**columns, "ampere_hours": log.charge_Ah})
