"""The tidy form is read whatever its file looks like."""

from __future__ import annotations

import gzip

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cellwise.errors import InputError
from cellwise.logs import CellLog, read_log
from cellwise.notices import Code, coded, texts
from log_files import csv_text, pulse_channels, write_csv

CHANNELS = pulse_channels()


def check(log: CellLog, columns: dict[str, np.ndarray] = CHANNELS) -> None:
    np.testing.assert_array_equal(log.time_s, columns["time_s"])
    np.testing.assert_array_equal(log.current_A, columns["current_A"])
    np.testing.assert_array_equal(log.voltage_V, columns["voltage_V"])
    np.testing.assert_array_equal(log.temperature_C, columns["temperature_C"])
    np.testing.assert_array_equal(log.charge_Ah, columns["ampere_hours"])


def test_a_tidy_csv_reads_as_it_stands(tmp_path):
    log = read_log(write_csv(tmp_path / "a_drive.csv", CHANNELS))
    check(log)
    assert log.format == "tidy-csv"
    assert log.name == "a_drive"
    assert log.source.endswith("a_drive.csv")
    assert log.notices == ()
    assert log.current_meaning == "interval_end"


@pytest.mark.parametrize("name", ["log.csv.gz", "log.csv", "log.bin", "log"])
def test_gzip_is_detected_by_content(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(gzip.compress(csv_text(CHANNELS).encode()))
    check(read_log(path))


TEXT = csv_text(CHANNELS)
GERMAN = csv_text({**CHANNELS, "Kanal": CHANNELS["time_s"]}, sep=";").replace(".", ",")
HEADS = ("# made by a tester\n# 25 degC\n\n", "\ufeff", "\ufeff# x\n", "\n")
FORMS = {
    "gzip of several members": gzip.compress(TEXT.encode()[:999])
    + gzip.compress(TEXT.encode()[999:]),
    **{f"head {k}": (head + TEXT).encode() for k, head in enumerate(HEADS)},
    **{f"head {k}, CR": (h + TEXT).replace("\n", "\r\n").encode() for k, h in enumerate(HEADS)},
    **{f"cells between {sep!r}": csv_text(CHANNELS, sep).encode() for sep in ";\t|"},
    "rows that end with a delimiter": TEXT.replace("\n", ",\n").replace(",\n", "\n", 1).encode(),
    "names in capitals": TEXT.replace("current_A", "CURRENT_A")
    .replace("time_s", "Time_S")
    .encode(),
    # Byte order mark, CR LF, semicolons, decimal commas, Latin-1 in a column not used.
    "German": GERMAN.replace("\n", "\r\n").encode("utf-8-sig").replace(b"Kanal", b"Gr\xf6\xdfe"),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_same_text_in_another_form(form, tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(FORMS[form])
    log = read_log(path)
    check(log)
    assert bool(coded(log.notices, Code.DECIMAL_COMMAS)) == (form == "German")


@pytest.mark.parametrize("name", ["log.parquet", "log.csv"])
@pytest.mark.parametrize("compression", ["none", "snappy", "zstd"])
def test_parquet_is_detected_by_content(tmp_path, name, compression):
    path = tmp_path / name
    pq.write_table(pa.table(CHANNELS), path, compression=compression, row_group_size=100)
    log = read_log(path)
    check(log)
    assert log.format == "tidy-parquet"


def test_parquet_of_other_number_types(tmp_path):
    table = pa.table(
        {
            "time_s": pa.array([0, 1, None, 3], pa.int64()),
            "current_A": pa.array([1.5, None, 2.5, 0.5], pa.float32()),
            "voltage_V": pa.array(["4.1", "4.0", "3.9", "3.8"]).cast(pa.decimal128(5, 2)),
            "step": pa.array([1, 1, 2, None], pa.int8()),
        }
    )
    pq.write_table(table, tmp_path / "log.parquet")
    log = read_log(tmp_path / "log.parquet")
    np.testing.assert_array_equal(log.time_s, [0, 1, 3])  # a row without time has no place
    np.testing.assert_array_equal(log.current_A, [1.5, np.nan, 0.5])
    np.testing.assert_allclose(log.voltage_V, [4.1, 4.0, 3.8], rtol=1e-15)
    np.testing.assert_array_equal(log.step, [1, 1, -1])
    assert any("without a time" in notice for notice in texts(log.notices))


def test_parquet_of_dates_where_a_time_belongs_and_where_none_does(tmp_path):
    dates = pa.array((np.arange(3) + 1_700_000_000).astype("datetime64[s]"))
    plain = pa.array([1.0, 2.0, 3.0])
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"time_s": dates, "current_A": plain, "voltage_V": plain}), path)
    np.testing.assert_array_equal(read_log(path).time_s, [0, 1, 2])
    pq.write_table(pa.table({"time_s": plain, "current_A": dates, "voltage_V": plain}), path)
    with pytest.raises(InputError, match="'current_A'"):
        read_log(path)


def test_columns_in_any_order_and_extra_ones(tmp_path):
    columns = {"comment": CHANNELS["time_s"], **dict(reversed(CHANNELS.items()))}
    log = read_log(write_csv(tmp_path / "log.csv", columns))
    check(log)
    assert texts(log.notices) == ["column(s) not used: 'comment'"]


def test_header_in_a_comment_as_numpy_writes_it(tmp_path):
    path = tmp_path / "log.csv"
    np.savetxt(
        path,
        np.column_stack(list(CHANNELS.values())),
        delimiter=",",
        header=",".join(CHANNELS),
        fmt="%.17g",
    )
    check(read_log(path))


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "NA", "null", "inf", "-inf", "--", "#DIV/0!"])
def test_missing_and_infinite_cells_are_missing_values(tmp_path, cell):
    path = tmp_path / "log.csv"
    path.write_text(f"time_s,current_A,voltage_V\n0,1,4.1\n1,{cell},4.0\n2,1,3.9\n")
    log = read_log(path)
    np.testing.assert_array_equal(log.current_A, [1, np.nan, 1])
    np.testing.assert_array_equal(log.known_current_A(), [1, 1, 1])


def test_numbers_read_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(5)
    columns = pulse_channels(600)
    columns["voltage_V"] = columns["voltage_V"] + rng.normal(0, 1e-3, 600)
    columns["time_s"] = np.cumsum(rng.uniform(0.5, 1.5, 600))
    log = read_log(write_csv(tmp_path / "log.csv", columns))
    np.testing.assert_array_equal(log.voltage_V, columns["voltage_V"])
    np.testing.assert_array_equal(log.time_s, columns["time_s"])


def test_a_log_of_many_batches_keeps_its_order(tmp_path):
    n = 250_000  # some 5 MB: several batches
    path = tmp_path / "log.csv"
    body = "\n".join(f"{k},{(k * 7) % 1000 / 500 - 1},{4 - k / 1e6}" for k in range(n))
    path.write_text(f"time_s,current_A,voltage_V\n{body}\n")
    done = []
    log = read_log(path, progress=lambda part, total: done.append((part, total)))
    np.testing.assert_array_equal(log.time_s, np.arange(n))
    np.testing.assert_array_equal(log.current_A, (np.arange(n) * 7) % 1000 / 500 - 1)
    assert len(done) > 1
    assert done == sorted(done)
    assert done[-1][0] == done[-1][1] == path.stat().st_size


def test_seconds_since_1970_are_counted_from_the_start(tmp_path):
    columns = pulse_channels(600)
    columns["time_s"] = columns["time_s"] + 1.7e9
    log = read_log(write_csv(tmp_path / "log.csv", columns))
    np.testing.assert_allclose(log.time_s, np.arange(600.0), atol=1e-6)
    assert any("counted from there" in notice for notice in texts(log.notices))


# Another name of a column: the usual one, factor and offset to its unit.
UNITS = {
    "current_mA": ("current_A", 1e-3, 0.0), "voltage_mV": ("voltage_V", 1e-3, 0.0),
    "time_ms": ("time_s", 1e-3, 0.0), "time_us": ("time_s", 1e-6, 0.0),
    "time_min": ("time_s", 60.0, 0.0), "time_h": ("time_s", 3600.0, 0.0),
    "temperature_K": ("temperature_C", 1.0, -273.15),
    "temperature_F": ("temperature_C", 5 / 9, -160 / 9),
    "charge_mAh": ("ampere_hours", 1e-3, 0.0), "milliampere_hours": ("ampere_hours", 1e-3, 0.0),
    "ampere_seconds": ("ampere_hours", 1 / 3600, 0.0),
}  # fmt: skip


@pytest.mark.parametrize("name", UNITS)
def test_units_that_the_name_tells(tmp_path, name):
    own, factor, offset = UNITS[name]
    columns = {n: v for n, v in CHANNELS.items() if n != own}
    columns[name] = (CHANNELS[own] - offset) / factor
    log = read_log(write_csv(tmp_path / "log.csv", columns))
    found = log.charge_Ah if own == "ampere_hours" else getattr(log, own)
    np.testing.assert_allclose(found, CHANNELS[own], rtol=1e-12, atol=1e-12)
    assert any(f"'{name}'" in notice and own in notice for notice in texts(log.notices))


@pytest.mark.parametrize("make", [dict, pd.DataFrame, pa.table])
def test_a_table_in_memory_reads_as_a_log(make):
    log = CellLog.from_table(make(CHANNELS), name="mine")
    check(log)
    assert log.name == "mine"
    assert log.format == "table"


def test_from_table_refuses_what_read_log_refuses():
    with pytest.raises(InputError, match="missing: voltage_V"):
        CellLog.from_table({"time_s": [0, 1], "current_A": [0, 1]})
    with pytest.raises(InputError, match="'voltage_V'"):
        CellLog.from_table({"time_s": [0, 1], "current_A": [0, 1], "voltage_V": ["a", "b"]})
