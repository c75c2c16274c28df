"""The tidy form: time_s, current_A, voltage_V[, temperature_C][, ampere_hours][, step]."""

from __future__ import annotations

from cellwise.logs.columns import TIDY_CHANNELS
from cellwise.logs.csv_text import read_csv
from cellwise.logs.format import Format
from cellwise.logs.parquet_file import is_parquet, read_parquet

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
