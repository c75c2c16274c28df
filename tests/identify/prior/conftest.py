"""One cell of the kind of a stock model, and one flight of it."""

from __future__ import annotations

import pytest
from prior_cells import drive_of, other_cell


@pytest.fixture(scope="session")
def cell():
    return other_cell()


@pytest.fixture(scope="session")
def flight(cell):
    """A fifth of the SOC range, in its middle."""
    return drive_of(cell, 0.65, 0.45)
