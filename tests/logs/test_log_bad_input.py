"""Every kind of bad input has one defined answer."""

from __future__ import annotations

import gzip
import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cellwise.errors import InputError
from cellwise.logs import read_log
from cellwise.notices import texts
from log_files import csv_text, pulse_channels, write_csv

TEXT = csv_text(pulse_channels(600))


def refusal(path) -> InputError:
    with pytest.raises(InputError) as caught:
        read_log(path)
    error = caught.value
    assert error.found
    assert error.expected
    assert error.action
    return error


def test_missing_file_names_the_near_ones(tmp_path):
    write_csv(tmp_path / "drive_25.csv", pulse_channels())
    error = refusal(tmp_path / "drive_35.csv")
    assert "drive_35.csv" in error.found
    assert "drive_25.csv" in error.action


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission_is_refused(tmp_path):
    path = write_csv(tmp_path / "log.csv", pulse_channels())
    path.chmod(0)
    assert "cannot be read" in refusal(path).found


HEAD = "time_s,current_A,voltage_V"
GZIPPED = gzip.compress(TEXT.encode(), mtime=0)
FLIPPED = GZIPPED[:-6] + bytes([GZIPPED[-6] ^ 0xFF]) + GZIPPED[-5:]  # the checksum at its end
SHORT_ROW = "\n".join([*TEXT.splitlines()[:40], "39.0,0.0", *TEXT.splitlines()[41:]]) + "\n"
# Content of a file, and a word of its refusal.
CONTENTS = [
    (b"", "empty"),
    (gzip.compress(b"", mtime=0), "empty"),
    *((text, "blank lines and comments") for text in ("\n\n", "# only a comment\n", "\ufeff\n")),
    *((HEAD + end, "no rows") for end in ("", "\n", "\r\n", "\n\n")),
    (HEAD + "\n0,1,4\n", "1 row(s)"),
    (HEAD + "\n0,,4\n1,nan,4\n2,inf,4\n", "no finite value of current_A"),
    ("0,1.5,4.1\n1,1.5,4.0\n", "no column names"),
    (HEAD + ",current_A\n0,1,4,2\n1,1,4,2\n", "2 columns named 'current_A'"),
    (HEAD + "\n0,0,1,5,4,1\n1,0,1,5,4,0\n", "semicolons"),
    (HEAD + "\n0:01,1,4\n1 of May,1,4\n0:03,1,4\n", "'1 of May' in column 'time_s'"),
    (SHORT_ROW, "2 cells in row 40"),
    *((GZIPPED[: int(keep * len(GZIPPED))], "gzip") for keep in (0.9, 0.5, 0.02)),
    (FLIPPED, "damaged gzip"),
    (np.random.default_rng(3).bytes(5000), "no known format"),
    (b"PK\x03\x04" + bytes(100), "Excel"),
    (b"\0\1\0\0Standard Jet DB" + bytes(100), "mdb-export"),
    (b"\x89HDF\r\n\x1a\n" + bytes(100), "HDF5"),
    (bytes(1000), "no known format"),
]


@pytest.mark.parametrize(("content", "says"), CONTENTS, ids=range(len(CONTENTS)))
def test_content_that_is_no_log_says_what_it_is(content, says, tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert says in str(refusal(path))


def test_truncated_gzip_of_many_blocks(tmp_path):
    rows = np.random.default_rng(0).normal(3.7, 0.1, (10_000, 2))
    body = "".join(f"{k},{a:.6f},{b:.6f}\n" for k, (a, b) in enumerate(rows))
    whole = gzip.compress(f"time_s,current_A,voltage_V\n{40 * body}".encode(), 1)
    path = tmp_path / "log.csv.gz"
    path.write_bytes(whole[: int(0.8 * len(whole))])
    assert "gzip" in refusal(path).found


# A column's name, and the one of the tidy form that it is most likely.
NEAREST = {
    "Time of run": "time_s", "currrent_A": "current_A", "Strom": "current_A",
    "Rig current / A": "current_A", "voltge": "voltage_V", "Ewe/V": "voltage_V",
}  # fmt: skip


@pytest.mark.parametrize("name", NEAREST)
def test_a_missing_column_is_named_with_the_nearest(tmp_path, name):
    wanted = NEAREST[name]
    names = [name if n == wanted else n for n in ("time_s", "current_A", "voltage_V")] + ["foo"]
    path = tmp_path / "log.csv"
    path.write_text(",".join(names) + "\n0,1,4,0\n1,1,4,0\n")
    error = refusal(path)
    assert all(f"'{n}'" in error.found for n in names)
    assert f"missing: {wanted}" in error.found
    assert f"`channels={{'{wanted}': '{name}'}}`" in error.action


@pytest.mark.parametrize("row", [1, 3])
def test_text_in_a_number_column_says_row_and_column(tmp_path, row):
    lines = [f"{k},1.5,{4 - 1e-6 * k:.6f}" for k in range(row + 5)]
    lines[row - 1] = f"{row - 1},OVERFLOW,4.0"
    path = tmp_path / "log.csv"
    path.write_text("time_s,current_A,voltage_V\n" + "\n".join(lines) + "\n")
    error = refusal(path)
    assert "'OVERFLOW'" in error.found
    assert "'current_A'" in error.found
    assert f"row {row} " in error.found


def test_text_column_in_parquet(tmp_path):
    columns = {**pulse_channels(600)}
    columns["current_A"] = np.array([f"{x} A" for x in columns["current_A"]])
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table(columns), path)
    assert "'current_A' of type string" in refusal(path).found


def test_last_line_cut_off_is_left_out_and_told(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(TEXT[: TEXT.rstrip("\n").rindex(",") - 8])
    log = read_log(path)
    assert len(log) == 599
    assert any("cut off" in notice for notice in texts(log.notices))


def test_time_running_backwards(tmp_path):
    columns = pulse_channels(600)
    columns["time_s"][300:] -= 250.0
    error = refusal(write_csv(tmp_path / "log.csv", columns))
    assert "backwards" in error.found
    assert "row 299" in error.found
    assert "split" in error.action


def test_a_log_mostly_without_time_is_refused(tmp_path):
    columns = pulse_channels(600)
    columns["time_s"][::3] = np.nan
    assert "without a time" in refusal(write_csv(tmp_path / "log.csv", columns)).found
