"""A format is one record: how its content tells it, its columns, its sign."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.logs import FORMATS, read_log, reading
from cellwise.logs.files.columns import OWN, Channel, Unit
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from log_files import csv_text, pulse_channels

CYCLER = Format(
    name="cycler",
    matches=lambda source: source.head.startswith(b"Zeit/ms"),
    channels=(
        Channel("time_s", {"Zeit/ms": Unit(1e-3)}, required=True),
        Channel("current_A", {"I/mA": Unit(1e-3)}, required=True),
        Channel("voltage_V", {"U/V": OWN}, required=True),
        Channel("charge_Ah", {"Q/Ah": OWN}),
    ),
    read=read_csv,
    sign="charge-positive",
)


@pytest.fixture
def cycler_file(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "FORMATS", (CYCLER, *FORMATS))
    columns = pulse_channels()
    path = tmp_path / "export.csv"
    path.write_text(
        csv_text(
            {
                "Zeit/ms": 1000 * columns["time_s"],
                "U/V": columns["voltage_V"],
                "I/mA": -1000 * columns["current_A"],
                "Q/Ah": -columns["ampere_hours"],
            }
        )
    )
    return path


def test_a_new_format_is_read_with_its_units_and_its_sign(cycler_file):
    truth = pulse_channels()
    log = read_log(cycler_file)
    assert log.format == "cycler"
    np.testing.assert_allclose(log.time_s, truth["time_s"], rtol=1e-15)
    np.testing.assert_allclose(log.current_A, truth["current_A"], rtol=1e-15)
    np.testing.assert_array_equal(log.charge_Ah, truth["ampere_hours"])
    assert not any("LOOKS WRONG" in notice for notice in log.notices)


def test_an_order_overrides_the_formats_sign(cycler_file):
    log = read_log(cycler_file, sign="discharge-positive")
    np.testing.assert_allclose(log.current_A, -pulse_channels()["current_A"], rtol=1e-15)
    assert any("`sign='charge-positive'`" in notice for notice in log.notices)
