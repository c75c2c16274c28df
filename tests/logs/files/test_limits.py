"""Files that would take all memory or all time: one refusal each, and this process goes on."""

from __future__ import annotations

import gzip
import struct
import time

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs import read_log
from log_files import pulse_channels
from tester_files import far_cell_workbook, write_mpr
from vehicle_files import write_mdf

C = pulse_channels(600)
GROUP = [(n, u, C["time_s"], C[n]) for n, u in (("current_A", "A"), ("voltage_V", "V"))]


def refusal(path, **options):
    with pytest.raises(InputError) as caught:
        read_log(path, **options)
    return str(caught.value)


def test_a_workbook_with_one_far_cell(tmp_path):
    pytest.importorskip("python_calamine")
    path = far_cell_workbook(tmp_path / "far.xlsx")
    assert path.stat().st_size < 3000
    message = refusal(path)
    assert "far.xlsx" in message
    assert "memory" in message


def test_the_next_file_is_read_after_one_that_ended_its_process(tmp_path):
    pytest.importorskip("python_calamine")
    pytest.importorskip("galvani")
    refusal(far_cell_workbook(tmp_path / "far.xlsx"))
    log = read_log(write_mpr(tmp_path / "good.mpr", C))
    np.testing.assert_allclose(log.voltage_V, C["voltage_V"], atol=1e-6)


@pytest.mark.slow
def test_a_recording_whose_blocks_run_in_a_circle(tmp_path, monkeypatch):
    """An MDF file whose data group links to itself: its library follows it for ever."""
    pytest.importorskip("asammdf")
    path = write_mdf(tmp_path / "log.mf4", [GROUP])
    content = bytearray(path.read_bytes())
    (group,) = struct.unpack_from("<Q", content, 64 + 24)  # first data group, of the header block
    assert content[group : group + 4] == b"##DG"
    struct.pack_into("<Q", content, group + 24, group)  # its next one: itself
    path.write_bytes(bytes(content))
    monkeypatch.setenv("CELLWISE_READ_SECONDS", "2.5")
    began = time.monotonic()
    message = refusal(path)
    assert time.monotonic() - began < 30
    assert "limit of time" in message or "limit of memory" in message
    assert "log.mf4" in message


@pytest.mark.slow
def test_a_small_matlab_file_of_gigabytes(tmp_path, monkeypatch):
    """Zeros compress a thousandfold."""
    from scipy.io import savemat

    path = tmp_path / "zeros.mat"
    zeros = np.zeros(20_000_000)
    savemat(path, {"meas": {"Time": zeros, "Current": zeros}}, do_compression=True)
    assert path.stat().st_size < 1_000_000
    monkeypatch.setenv("CELLWISE_READ_MEMORY_GB", "0.3")
    assert "limit of memory" in refusal(path)


def test_a_parquet_file_of_a_few_bytes_a_million_rows(tmp_path):
    import pyarrow as pa
    from pyarrow import parquet

    path = tmp_path / "long.parquet"
    rows = 1_000_000
    schema = pa.schema([(n, pa.float64()) for n in ("time_s", "current_A", "voltage_V")])
    batch = pa.record_batch([pa.array(np.zeros(rows))] * 3, schema=schema)
    with parquet.ParquetWriter(path, schema) as writer:
        for _ in range(11):
            writer.write_batch(batch)
    assert path.stat().st_size < 200_000
    message = refusal(path)
    assert "11,000,000 rows" in message
    assert "CELLWISE_READ_ROWS" in message


def test_a_column_of_texts_is_refused_before_it_is_read(tmp_path):
    """One text of a megabyte in a million rows would be a terabyte."""
    import pyarrow as pa
    from pyarrow import parquet

    path = tmp_path / "texts.parquet"
    text = pa.DictionaryArray.from_arrays(pa.array(np.zeros(50_000, np.int32)), ["x" * 1_000_000])
    plain = pa.array(np.zeros(50_000))
    parquet.write_table(pa.table({"time_s": text, "current_A": plain, "voltage_V": plain}), path)
    assert path.stat().st_size < 100_000
    assert "of type" in refusal(path)


@pytest.mark.parametrize(
    ("rows", "limit", "most", "says"),
    [(b"1,1,3.7\n" * 200_000, "ROWS", "100000", "rows or more"),
     (b"1,1,3.7\n" + b"\n" * 200_000_000, "SECONDS", "0.1", "limit of time")],
    ids=["rows", "blank lines"],
)  # fmt: skip
def test_compressed_text_has_its_limits(rows, limit, most, says, tmp_path, monkeypatch):
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(b"time_s,current_A,voltage_V\n" + rows, 1))
    monkeypatch.setenv(f"CELLWISE_READ_{limit}", most)
    assert says in refusal(path)


@pytest.mark.parametrize("value", ["much", "-1", "0", "nan"])
def test_a_limit_that_is_no_number_is_said(value, tmp_path, monkeypatch):
    monkeypatch.setenv("CELLWISE_READ_ROWS", value)
    path = tmp_path / "log.csv"
    path.write_text("time_s,current_A,voltage_V\n0,1,3.7\n1,1,3.7\n")
    assert "CELLWISE_READ_ROWS" in refusal(path)


def test_progress_comes_from_the_other_process(tmp_path):
    pytest.importorskip("can")
    pytest.importorskip("cantools")
    from vehicle_files import write_can, write_dbc

    seen = []
    path = write_can(tmp_path / "log.blf", C, "blf")
    read_log(path, dbc=write_dbc(tmp_path / "x.dbc"), progress=lambda *done: seen.append(done))
    assert seen
    assert all(0 <= done <= total for done, total in seen)
