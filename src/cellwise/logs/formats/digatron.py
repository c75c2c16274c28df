"""Digatron: MATLAB files with a structure of columns, and CSV exports; charge positive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import CLOCK, OWN, TURNED, Channel
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.extras import need
from cellwise.logs.files.format import Format, library_at_work
from cellwise.logs.files.named_arrays import channels_of
from cellwise.logs.files.source import LogSource, RawLog

_MATLAB_5 = b"MATLAB 5.0"
_MATLAB_7 = b"MATLAB 7.3"
_LEAST_ROWS = 2


def _read_mat(source: LogSource, known: Format) -> RawLog:
    """The structure, or the top level, that holds most of the channels."""
    if source.head.startswith(_MATLAB_7):
        tables = list(_hdf5_tables(source))
    else:
        from scipy.io import loadmat

        with library_at_work(source, "MATLAB file"), source.open() as file:
            tables = list(_tables("", loadmat(file, simplify_cells=True)))
    names = {name for c in known.channels for name in c.names}
    names |= set(source.options.channels.values())
    if not tables:
        raise InputError(
            f"no columns of numbers in {source.where}",
            "a structure with Time, Current and Voltage",
            "Export the measurement as columns.",
        )
    best = max(tables, key=lambda table: (len(names.intersection(table)), len(table)))
    return channels_of(best, source, known)


def _tables(place: str, level: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Every structure's columns, from the top down."""
    columns = {
        name: np.asarray(value).ravel()
        for name, value in level.items()
        if not name.startswith(("__", "#"))
        and not isinstance(value, Mapping)
        and np.size(value) >= _LEAST_ROWS
    }
    if columns:
        yield columns
    for name, value in level.items():
        if isinstance(value, Mapping):
            yield from _tables(f"{place}{name}.", value)


def _hdf5_tables(source: LogSource) -> Iterator[dict[str, Any]]:
    """The same of a file of MATLAB 7.3, which is HDF5."""
    h5py = need("h5py", "a MATLAB 7.3 file")

    def level(group: Any) -> dict[str, Any]:
        return {
            name: level(item) if isinstance(item, h5py.Group) else item[()]
            for name, item in group.items()
        }

    with library_at_work(source, "MATLAB 7.3 file"), h5py.File(source.path, "r") as file:
        content = level(file)
    yield from _tables("", content)


DIGATRON_MAT = Format(
    name="digatron-mat",
    matches=lambda source: source.head.startswith((_MATLAB_5, _MATLAB_7)),
    channels=(
        Channel("time_s", {"Time": OWN, "Time_s": OWN, "time_s": OWN, "t": OWN}, required=True),
        Channel(
            "current_A", {"Current": OWN, "Current_A": OWN, "I": OWN, "current": OWN}, required=True
        ),
        Channel("voltage_V", {"Voltage": OWN, "Voltage_V": OWN, "U": OWN, "V": OWN}, required=True),
        Channel(
            "temperature_C",
            {"Battery_Temp_degC": OWN, "Temperature": OWN, "Temp": OWN, "Temperature_degC": OWN},
        ),
        Channel("charge_Ah", {"Ah": TURNED, "Capacity": TURNED, "Amp_hours": TURNED}),
        Channel("step", {"Step": OWN}),
    ),
    known=("TimeStamp", "Wh", "Power", "Chamber_Temp_degC", "Status", "Cycle"),
    read=_read_mat,
    sign="charge-positive",
    apart=True,
)

DIGATRON_CSV = Format(
    name="digatron-csv",
    matches=lambda source: has_names(
        source, ("Prog Time", "Program Duration#s", "Program time"), ("Voltage", "Voltage#V")
    ),
    channels=(
        Channel(
            "time_s",
            dict.fromkeys(("Prog Time", "Program Duration#s", "Program time"), CLOCK),
            True,
        ),
        Channel("current_A", {"Current": OWN, "Current#A": OWN}, required=True),
        Channel("voltage_V", {"Voltage": OWN, "Voltage#V": OWN}, required=True),
        Channel("temperature_C", {"Temperature": OWN, "T1#degC": OWN, "LogTemp001": OWN}),
        Channel("charge_Ah", {"Capacity": TURNED, "AhBal#Ah": TURNED, "AhAccu": TURNED}),
        Channel("step", {"Step": OWN}),
    ),
    known=(
        *("Time Stamp", "Timestamp", "Status", "Step Time", "Step Duration#s", "Cycle", "Power#W"),
        *("Cycle Level", "Procedure", "WhAccu", "Cnt", "Tenv#degC", "AhCha#Ah", "AhDch#Ah", "Watt"),
        *("AhStep#Ah", "WhCha#Wh", "WhDch#Wh", "WhStep#Wh", "AhAccu#Ah", "WhAccu#Wh"),
    ),
    read=read_csv,
    sign="charge-positive",
)
