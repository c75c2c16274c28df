"""The formats that can be read: one declarative file each."""

from __future__ import annotations

from cellwise.logs.files.format import Format
from cellwise.logs.formats.arbin import ARBIN_CSV
from cellwise.logs.formats.bdf import BDF_CSV, BDF_PARQUET
from cellwise.logs.formats.biologic import BIOLOGIC_MPR, BIOLOGIC_MPT
from cellwise.logs.formats.bitrode import BITRODE_CSV
from cellwise.logs.formats.can import CAN_LOG, CAN_TEXT
from cellwise.logs.formats.dataflash import ARDUPILOT_DATAFLASH
from cellwise.logs.formats.digatron import DIGATRON_CSV, DIGATRON_MAT
from cellwise.logs.formats.excel import ARBIN_EXCEL
from cellwise.logs.formats.maccor import MACCOR_TEXT
from cellwise.logs.formats.mdf import ASAM_MDF
from cellwise.logs.formats.neware import NEWARE_CSV, NEWARE_STORED
from cellwise.logs.formats.text.arbin_res import ARBIN_RES
from cellwise.logs.formats.text.basytec import BASYTEC_TEXT
from cellwise.logs.formats.text.leafspy import LEAFSPY_CSV
from cellwise.logs.formats.text.neware_levels import NEWARE_LEVELS
from cellwise.logs.formats.text.novonix import NOVONIX_CSV
from cellwise.logs.formats.text.pec import PEC_CSV
from cellwise.logs.formats.tidy import TIDY_CSV, TIDY_PARQUET
from cellwise.logs.formats.ulog import PX4_ULOG

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
    BDF_PARQUET,
    TIDY_PARQUET,
    BDF_CSV,
    LEAFSPY_CSV,
    NOVONIX_CSV,
    PEC_CSV,
    BASYTEC_TEXT,
    NEWARE_LEVELS,
    MACCOR_TEXT,  # before Arbin's, whose Test_Time is spelled like its TestTime
    ARBIN_CSV,
    BITRODE_CSV,
    NEWARE_CSV,
    BIOLOGIC_MPT,
    DIGATRON_CSV,
    TIDY_CSV,
)
