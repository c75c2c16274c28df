"""The formats that can be read: tables are data in `column_maps.toml`, the others a file each."""

from __future__ import annotations

from dataclasses import replace

from cellwise.logs.files.columns import TIDY_CHANNELS
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.source import LogSource
from cellwise.logs.files.tables import is_parquet, parquet_has, read_parquet
from cellwise.logs.formats.blackbox import BLACKBOX
from cellwise.logs.formats.can import CAN_LOG
from cellwise.logs.formats.column_maps import mapped, marked_tables, marks
from cellwise.logs.formats.long_table import LONG_TABLE
from cellwise.logs.formats.ros_bag import ROS_BAG
from cellwise.logs.formats.tester_files import (
    BASYTEC_TEXT,
    BIOLOGIC_MPR,
    DIGATRON_MAT,
    NEWARE_LEVELS,
    NEWARE_STORED,
)
from cellwise.logs.formats.vehicle_logs import ARDUPILOT_DATAFLASH, ASAM_MDF, PX4_ULOG
from cellwise.logs.formats.workbook import workbook


def _is_bdf_parquet(source: LogSource) -> bool:
    return parquet_has(source, marks("bdf-csv"))


TABLE = Format(
    "tidy-csv",
    lambda source: source.is_text,
    TIDY_CHANNELS,
    read_csv,
    "discharge-positive",
    instances=True,
)

TABLES: tuple[Format, ...] = (
    mapped("bdf-csv", "bdf-parquet", matches=_is_bdf_parquet, read=read_parquet),
    replace(TABLE, name="tidy-parquet", matches=is_parquet, read=read_parquet),
    BASYTEC_TEXT,
    NEWARE_LEVELS,
    *map(mapped, marked_tables()),
    LONG_TABLE,
    TABLE,
)
# In this order: what a program marks as its own, then tables by their names; plain tables last.
FORMATS: tuple[Format, ...] = (
    PX4_ULOG,
    ARDUPILOT_DATAFLASH,
    BLACKBOX,
    ROS_BAG,
    BIOLOGIC_MPR,
    NEWARE_STORED,
    DIGATRON_MAT,
    ASAM_MDF,
    workbook(TABLES),
    CAN_LOG,
    *TABLES,
)
