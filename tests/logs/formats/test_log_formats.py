"""A format is one record: how its content tells it, its columns, its sign."""

from __future__ import annotations

import numpy as np

from cellwise.logs import FORMATS, read_log, reading
from cellwise.logs.files.columns import OWN, Channel, Unit
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from log_files import pulse_channels, write_csv

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


def test_a_new_format_is_read_with_its_units_and_its_sign_unless_overridden(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "FORMATS", (CYCLER, *FORMATS))
    truth = pulse_channels()
    path = write_csv(
        tmp_path / "export.csv",
        {"Zeit/ms": 1000 * truth["time_s"], "U/V": truth["voltage_V"],
         "I/mA": -1000 * truth["current_A"], "Q/Ah": -truth["ampere_hours"]},
    )  # fmt: skip
    log = read_log(path)
    assert log.format == "cycler"
    np.testing.assert_allclose(log.time_s, truth["time_s"], rtol=1e-15)
    np.testing.assert_allclose(log.current_A, truth["current_A"], rtol=1e-15)
    np.testing.assert_array_equal(log.charge_Ah, truth["ampere_hours"])
    assert not any("LOOKS WRONG" in notice for notice in log.notices)
    other = read_log(path, sign="discharge-positive")
    np.testing.assert_array_equal(other.current_A, -log.current_A)
    assert any("`sign='charge-positive'`" in notice for notice in other.notices)
