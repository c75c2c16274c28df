"""Columns as files: what is written comes back, and a failed write leaves nothing behind."""

from __future__ import annotations

import gzip

import numpy as np
import pandas as pd
import pytest

from cellwise.errors import InputError
from cellwise.logs.writing import write_columns

COLUMNS = {
    "time_s": np.array([0.0, 0.1, 1e6]),
    "soc": np.array([1.0, 1.0 / 3.0, np.nan]),
    "status": np.array([0, 4, 7], dtype=np.uint8),
}


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("out.csv", pd.read_csv),
        ("out.csv.gz", pd.read_csv),
        ("out.parquet", pd.read_parquet),
        ("OUT.CSV", pd.read_csv),
    ],
)
def test_columns_come_back_to_the_last_digit(tmp_path, name, read):
    path = write_columns(COLUMNS, tmp_path / name)
    assert path == tmp_path / name
    found = read(path)
    assert list(found.columns) == list(COLUMNS)
    for key, values in COLUMNS.items():
        np.testing.assert_array_equal(found[key].to_numpy(dtype=float), values.astype(float))


def test_gzip_is_gzip_and_csv_is_not(tmp_path):
    packed = write_columns(COLUMNS, tmp_path / "a.csv.gz").read_bytes()
    assert gzip.decompress(packed) == write_columns(COLUMNS, tmp_path / "a.csv").read_bytes()


def test_a_missing_number_is_no_word(tmp_path):
    # "nan" would be read as text by half of the tools; an empty field or NaN by pandas as missing.
    write_columns(COLUMNS, tmp_path / "a.csv")
    assert pd.read_csv(tmp_path / "a.csv")["soc"].dtype == np.float64


@pytest.mark.parametrize("name", ["out.xlsx", "out", "out.gz", "out.csv.zip"])
def test_another_suffix_is_refused(tmp_path, name):
    with pytest.raises(InputError, match=r"\.parquet, \.csv, \.csv\.gz"):
        write_columns(COLUMNS, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.parquet"])
def test_an_existing_file_is_replaced_whole(tmp_path, name):
    path = tmp_path / name
    path.write_text("old " * 10_000)
    write_columns(COLUMNS, path)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    read = pd.read_parquet if name.endswith("parquet") else pd.read_csv
    assert len(read(path)) == 3


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.parquet"])
def test_a_write_that_fails_leaves_what_was_there(tmp_path, name, monkeypatch):
    path = tmp_path / name
    path.write_text("kept")

    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pyarrow.csv.write_csv", full)
    monkeypatch.setattr("pyarrow.parquet.write_table", full)
    with pytest.raises(InputError, match="No space left"):
        write_columns(COLUMNS, path)
    assert path.read_text() == "kept"
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="no folder"):
        write_columns(COLUMNS, tmp_path / "nowhere" / "a.csv")
