"""The formats that can be read: tables are data in `column_maps.toml`, the others a file each."""

from __future__ import annotations

from cellwise.logs.files.columns import TIDY_CHANNELS
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.named_columns import is_parquet, parquet_has, read_parquet
from cellwise.logs.files.source import LogSource
from cellwise.logs.formats.can import CAN_LOG, CAN_TEXT
from cellwise.logs.formats.column_maps import mapped, marks
from cellwise.logs.formats.dataflash import ARDUPILOT_DATAFLASH
from cellwise.logs.formats.mdf import ASAM_MDF
from cellwise.logs.formats.tester_files import (
    ARBIN_EXCEL,
    ARBIN_RES,
    BIOLOGIC_MPR,
    DIGATRON_MAT,
    NEWARE_STORED,
)
from cellwise.logs.formats.text_layouts import (
    BASYTEC_TEXT,
    BIOLOGIC_MPT,
    LEAFSPY_CSV,
    NEWARE_LEVELS,
)
from cellwise.logs.formats.ulog import PX4_ULOG


def _is_bdf_parquet(source: LogSource) -> bool:
    return parquet_has(source, marks("bdf"))


# In this order: what a program marks as its own, then tables by their names; plain tables last.
FORMATS: tuple[Format, ...] = (
    PX4_ULOG,
    ARDUPILOT_DATAFLASH,
    BIOLOGIC_MPR,
    NEWARE_STORED,
    DIGATRON_MAT,
    ASAM_MDF,
    ARBIN_EXCEL,
    ARBIN_RES,
    CAN_LOG,
    CAN_TEXT,
    mapped("bdf", "bdf-parquet", matches=_is_bdf_parquet, read=read_parquet),
    Format("tidy-parquet", is_parquet, TIDY_CHANNELS, read_parquet, "discharge-positive"),
    mapped("bdf", "bdf-csv"),
    LEAFSPY_CSV,
    mapped("novonix-csv"),
    mapped("pec-csv"),
    BASYTEC_TEXT,
    NEWARE_LEVELS,
    mapped("maccor-text"),  # before Arbin's, whose Test_Time is spelled like its TestTime
    mapped("arbin", "arbin-csv"),
    mapped("bitrode-csv"),
    mapped("neware-csv"),
    BIOLOGIC_MPT,
    mapped("digatron-csv"),
    Format("tidy-csv", lambda s: s.is_text, TIDY_CHANNELS, read_csv, "discharge-positive"),
)
