"""The tidy form: time_s, current_A, voltage_V[, temperature_C][, ampere_hours][, step]."""

from __future__ import annotations

from cellwise.logs.files.columns import TIDY_CHANNELS
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.parquet_file import is_parquet, read_parquet

TIDY_PARQUET = Format(
    name="tidy-parquet",
    matches=is_parquet,
    channels=TIDY_CHANNELS,
    read=read_parquet,
    sign="discharge-positive",
)

TIDY_CSV = Format(
    name="tidy-csv",
    matches=lambda source: source.is_text,
    channels=TIDY_CHANNELS,
    read=read_csv,
    sign="discharge-positive",
)
