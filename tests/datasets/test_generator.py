"""The generator: its rows and profiles without a cell, and the committed files with one."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "datasets"


@pytest.fixture(scope="module", autouse=True)
def generator_on_path():
    pytest.importorskip("pybamm", reason="PyBaMM is missing: install the extra 'generate'")
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


def test_unknown_name_is_refused(tmp_path):
    from generator.generate import generate

    with pytest.raises(ValueError, match=r"unknown data sets \['nmc_nothing'\]"):
        generate(tmp_path, ["nmc_nothing"])
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nmc_cap_c3", "lfp_cap_3c"])
def test_generating_again_gives_the_committed_file(tmp_path, name):
    from generator.generate import generate

    calls: list[tuple[str, int, int]] = []
    [path] = generate(tmp_path, [name], lambda *call: calls.append(call))
    assert calls == [(name, 0, 1), ("done", 1, 1)]
    relative = path.relative_to(tmp_path)
    again, kept = pq.read_table(path), pq.read_table(FOLDER / relative)
    assert again.column_names == kept.column_names
    assert again.num_rows == kept.num_rows
    # Same seed, same noise: what is left is the solver's tolerance and one step of rounding.
    for column, tolerance in (
        ("time_s", 0.5),
        ("current_A", 2.1e-3),
        ("voltage_V", 3e-4),
        ("ampere_hours", 2.1e-4),
    ):
        difference = np.abs(again[column].to_numpy() - kept[column].to_numpy())
        assert difference.max() <= tolerance, column
    [entry] = tomllib.loads((tmp_path / "catalogue.toml").read_text(encoding="utf-8"))["dataset"]
    assert entry["name"] == name
    assert entry["rows"] == kept.num_rows
