"""A small fleet: logs of one model, one wrong way round, one that is no log."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cellwise.logs import write_log
from example_cells import curved_cell
from fleet_logs import drive

pytest.importorskip("distributed")


@pytest.fixture(scope="session")
def model():
    return curved_cell(name="fleet")


@pytest.fixture
def folder(tmp_path):
    """Five good logs in two folders, one with the sign turned round, two that are none."""
    place = tmp_path / "logs"
    for k in range(5):
        into = place / ("truck_1" if k < 2 else "truck_2")
        into.mkdir(parents=True, exist_ok=True)
        write_log(drive(k, 0.5 + 0.1 * k), into / f"day_{k}.parquet")
    turned = drive(9, 0.8)
    write_log(
        replace(turned, current_A=-turned.current_A, charge_Ah=None), place / "turned.parquet"
    )
    (place / "empty.parquet").touch()
    (place / "notes.md").write_text("not a log\n")
    return place
