"""Neware: CSV exports of BTSDA, and ``.nda`` / ``.ndax`` as the server stores them."""

from __future__ import annotations

import tempfile
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cellwise.logs.files.columns import CLOCK, MILLI, OWN, TURNED_MILLI, Channel
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.extras import need
from cellwise.logs.files.format import Format, library_at_work
from cellwise.logs.files.named_arrays import channels_of
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.files.text_cells import labels

_MAGIC = b"NEWARE"
_ZIP = b"PK\x03\x04"
_IN_ZIP = (b".ndc", b"VersionInfo.xml", b"TestInfo.xml", b"Step.xml")

_STEP_TYPE = labels(
    **dict.fromkeys(
        ("CC_Chg", "CV_Chg", "CCCV_Chg", "CP_Chg", "CR_Chg", "CPCV_Chg", "Charge"), -1.0
    ),
    **dict.fromkeys(("CC_DChg", "CV_DChg", "CCCV_DChg", "CP_DChg", "CR_DChg", "DCharge"), 1.0),
    **dict.fromkeys(("C_CC", "C_CV", "C_CCCV", "CCCharge", "CVCharge"), -1.0),
    **dict.fromkeys(("D_CC", "D_CV", "D_CCCV", "D_CP", "D_CR", "CCDischarge", "Discharge"), 1.0),
    **dict.fromkeys(("Rest", "Pause", "OCV", "R", "Finish", "End"), 0.0),
)
_TOTAL = (
    "Total Time",
    "Cumulative Time",
    "Total Time(s)",
    "Test Time(s)",
    "TotalTime(s)",
    "总时间",
)

NEWARE_CSV = Format(
    name="neware-csv",
    matches=lambda source: has_names(
        source,
        ("DataPoint", "Record number", "Record ID", "Record Index", "数据序号"),
        ("Voltage(V)", "Voltage(mV)", "Vol(mV)", "电压(V)"),
    ),
    channels=(
        Channel("time_s", dict.fromkeys(_TOTAL, CLOCK), required=True, instead="step_time_s"),
        Channel(
            "step_time_s",
            dict.fromkeys(("Time", "Time(s)", "Relative Time", "Step Time(s)", "时间"), CLOCK)
            | {"Relative Time(h:min:s.ms)": CLOCK, "Time(h:min:s.ms)": CLOCK},
        ),
        Channel(
            "current_A",
            {"Current(A)": OWN, "Current(mA)": MILLI, "Cur(mA)": MILLI}
            | {"电流(A)": OWN, "电流(mA)": MILLI},
            required=True,
        ),
        Channel(
            "voltage_V",
            {"Voltage(V)": OWN, "Voltage(mV)": MILLI, "Vol(mV)": MILLI, "电压(V)": OWN},
            required=True,
        ),
        Channel(
            "temperature_C",
            dict.fromkeys(
                ("T1(℃)", "T1(°C)", "T1(?)", "T1", "Temperature(°C)", "Temperature(℃)"), OWN
            )
            | {"Aux. CH1 Temp(℃)": OWN, "温度(°C)": OWN},
        ),
        Channel("charged_Ah", {"Chg. Cap.(Ah)": OWN, "Chg. Cap.(mAh)": MILLI}),
        Channel("discharged_Ah", {"DChg. Cap.(Ah)": OWN, "DChg. Cap.(mAh)": MILLI}),
        Channel(
            "moved_Ah",
            {"Capacity(Ah)": OWN, "Capacity(mAh)": MILLI, "CapaCity(mAh)": MILLI, "容量(Ah)": OWN},
        ),
        Channel("step", {"Step Index": OWN, "Steps": OWN, "Step": OWN, "工步号": OWN}),
        Channel(
            "direction", {"Step Type": _STEP_TYPE, "State": _STEP_TYPE, "工步类型": _STEP_TYPE}
        ),
    ),
    known=(
        *("DataPoint", "Record number", "Record ID", "Cycle Index", "Cycle", "Cycle ID", "Jump"),
        *("Step ID", "Spec. Cap.(mAh/g)", "Chg. Spec. Cap.(mAh/g)", "DChg. Spec. Cap.(mAh/g)"),
        *("Energy(Wh)", "Energy(mWh)", "Spec. Energy(mWh/g)", "Chg. Energy(Wh)", "Power(mW)"),
        *("DChg. Energy(Wh)", "Chg. Spec. Energy(mWh/g)", "DChg. Spec. Energy(mWh/g)", "Date"),
        *("Power(W)", "dQ/dV(mAh/V)", "dQm/dV(mAh/V.g)", "Contact resistance(mΩ)", "DCIR(mΩ)"),
        *("Contact resistance(mO)", "V1(V)", "CPU(℃)", "CPU(?)"),
        *("Module start-stop switch", "DChg. Energy(mWh)", "Chg. Energy(mWh)", "Realtime"),
        *("Date(h:min:s.ms)", "SpeCap(mAh/g)", "CmpEng(mWh/g)", "Min-T(C)", "Max-T(C)"),
    ),
    read=read_csv,
    sign="charge-positive",
)


def _is_stored(source: LogSource) -> bool:
    """A database file, or a zip archive whose first member is one of Neware's."""
    if source.head.startswith(_MAGIC):
        return True
    if not source.head.startswith(_ZIP):
        return False
    length = int.from_bytes(source.head[26:28], "little")
    return source.head[30 : 30 + length].endswith(_IN_ZIP)


@contextmanager
def _own_zlib() -> Iterator[None]:
    """Put back what fastnda replaces in zlib for everybody, with other errors of its own."""
    kept = zlib.decompress, zlib.decompressobj
    try:
        yield
    finally:
        zlib.decompress, zlib.decompressobj = kept


def _read_stored(source: LogSource, known: Format) -> RawLog:
    suffix = ".nda" if source.head.startswith(_MAGIC) else ".ndax"
    kind = f"Neware {suffix} file"
    with (
        _own_zlib(),
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(record=True) as caught,
        library_at_work(source, kind),
    ):
        warnings.simplefilter("always")
        fastnda = need("fastnda", "a Neware file")
        path = source.path
        if path.suffix.casefold() != suffix:  # the library goes by their suffix
            path = Path(folder) / f"log{suffix}"
            path.symlink_to(source.path.resolve())
        frame: Any = fastnda.read(path)
        arrays = {name: frame[name].to_numpy() for name in frame.columns}
    raw = channels_of(arrays, source, known)
    notices = tuple(str(warning.message).split(" If you can")[0] for warning in caught)
    return RawLog(raw.channels, (*raw.notices, *notices))


NEWARE_STORED = Format(
    name="neware-nda",
    matches=_is_stored,
    channels=(
        Channel("time_s", {"total_time_s": OWN}, required=True),
        Channel("current_A", {"current_mA": MILLI}, required=True),
        Channel("voltage_V", {"voltage_V": OWN}, required=True),
        Channel(
            "temperature_C",
            dict.fromkeys((f"aux{k}_temperature_degC" for k in range(1, 9)), OWN),
        ),
        Channel("charge_Ah", {"capacity_mAh": TURNED_MILLI}),
        Channel("step", {"step_index": OWN}),
    ),
    known=(
        *("index", "unix_time_s", "step_time_s", "cycle_count", "step_count", "step_type"),
        *(
            "energy_mWh",
            *(f"aux{k}_{what}" for k in range(1, 9) for what in ("voltage_V", "index")),
        ),
    ),
    read=_read_stored,
    sign="charge-positive",
    apart=True,
)
