"""Files that testers' own programs store, read by the libraries that others keep for them.

BioLogic ``.mpr``, Neware ``.nda`` and ``.ndax``, Digatron's MATLAB structures, Arbin's workbooks
and Access databases.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import folded
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format, damaged, library_at_work, need
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.named_columns import channels_of
from cellwise.logs.files.source import LogSource, RawLog, open_source
from cellwise.logs.formats.column_maps import mapped

_ZIP = b"PK\x03\x04"
_MATLAB_5, _MATLAB_7 = b"MATLAB 5.0", b"MATLAB 7.3"
_NEWARE = b"NEWARE"
_NEWARE_IN_ZIP = (b".ndc", b"VersionInfo.xml", b"TestInfo.xml", b"Step.xml")
_XLS = b"\xd0\xcf\x11\xe0"
_INSIDE_XLSX = (b"xl/", b"[Content_Types].xml")
_ACCESS = b"\x00\x01\x00\x00Standard Jet DB", b"\x00\x01\x00\x00Standard ACE DB"
_ARBIN_TABLE = "Channel_Normal_Table"
_MDB_EXPORT = "mdb-export"


def _read_mpr(source: LogSource, known: Format) -> RawLog:
    biologic = need("galvani.BioLogic", "a BioLogic .mpr file")
    with library_at_work(source, "BioLogic .mpr file"), source.open() as file:
        data: Any = biologic.MPRfile(file).data
    return channels_of({name: np.asarray(data[name]) for name in data.dtype.names}, source, known)


BIOLOGIC_MPR = mapped(
    "biologic",
    "biologic-mpr",
    matches=lambda source: source.head.startswith(b"BIO-LOGIC MODULAR FILE"),
    read=_read_mpr,
    isolated=True,
)


def _is_neware(source: LogSource) -> bool:
    """A database file, or a zip archive whose first member is one of Neware's."""
    if source.head.startswith(_NEWARE):
        return True
    if not source.head.startswith(_ZIP):
        return False
    length = int.from_bytes(source.head[26:28], "little")
    return source.head[30 : 30 + length].endswith(_NEWARE_IN_ZIP)


@contextmanager
def _own_zlib() -> Iterator[None]:
    """Put back what fastnda replaces in zlib for everybody, with other errors of its own."""
    kept = zlib.decompress, zlib.decompressobj
    try:
        yield
    finally:
        zlib.decompress, zlib.decompressobj = kept


def _read_neware(source: LogSource, known: Format) -> RawLog:
    suffix = ".nda" if source.head.startswith(_NEWARE) else ".ndax"
    with (
        _own_zlib(),
        tempfile.TemporaryDirectory() as folder,
        warnings.catch_warnings(record=True) as caught,
        library_at_work(source, f"Neware {suffix} file"),
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
    return raw.noted(str(warning.message).split(" If you can")[0] for warning in caught)


NEWARE_STORED = mapped("neware-nda", matches=_is_neware, read=_read_neware, isolated=True)


def _read_matlab(source: LogSource, known: Format) -> RawLog:
    """The structure, or the top level, that holds most of the channels."""
    content: Mapping[str, Any]
    if source.head.startswith(_MATLAB_7):
        h5py = need("h5py", "a MATLAB 7.3 file")

        def level(group: Any) -> dict[str, Any]:
            return {
                name: level(item) if isinstance(item, h5py.Group) else item[()]
                for name, item in group.items()
            }

        with library_at_work(source, "MATLAB 7.3 file"), h5py.File(source.path, "r") as file:
            content = level(file)
    else:
        from scipy.io import loadmat

        with library_at_work(source, "MATLAB file"), source.open() as stream:
            content = loadmat(stream, simplify_cells=True)
    with library_at_work(source, "MATLAB file"):
        tables = list(_structures(content))
    if not tables:
        raise InputError(
            f"no columns of numbers in {source.where}",
            "a structure with Time, Current and Voltage",
            "Export the measurement as columns.",
        )
    names = {name for c in known.channels for name in c.names}
    names |= set(source.options.channels.values())
    best = max(tables, key=lambda table: (len(names.intersection(table)), len(table)))
    return channels_of(best, source, known)


def _structures(level: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Every structure's columns, from the top down."""
    columns = {
        name: np.asarray(value).ravel()
        for name, value in level.items()
        if not name.startswith(("__", "#"))
        and not isinstance(value, Mapping)
        and np.size(value) > 1
    }
    if columns:
        yield columns
    for value in level.values():
        if isinstance(value, Mapping):
            yield from _structures(value)


DIGATRON_MAT = mapped(
    "digatron-mat",
    matches=lambda source: source.head.startswith((_MATLAB_5, _MATLAB_7)),
    read=_read_matlab,
    isolated=True,
)


def _is_workbook(source: LogSource) -> bool:
    if source.head.startswith(_ZIP):
        return any(name in source.head for name in _INSIDE_XLSX)
    return source.head.startswith(_XLS)


def _read_workbook(source: LogSource, known: Format) -> RawLog:
    """The sheets with the channel's columns: a long test goes on on further ones."""
    calamine = need("python_calamine", "an Excel workbook", "python-calamine")
    with library_at_work(source, "Excel workbook"), source.open() as stream:
        book = calamine.CalamineWorkbook.from_filelike(stream)
        sheets = {name: book.get_sheet_by_name(name).to_python() for name in book.sheet_names}
    times = {folded(name) for name in known.channels[0].names}
    parts = [
        rows
        for rows in sheets.values()
        if rows and times.intersection(folded(str(name)) for name in rows[0])
    ]
    if not parts:
        names = ", ".join(list(sheets)[:8])
        raise InputError(
            f"no sheet with Test_Time(s) in {source.where}, which has {names or 'no sheet'}",
            "a workbook as Arbin's software exports it",
            "Export the sheet of the channel as CSV.",
        )
    header = [str(name) for name in parts[0][0]]
    rows = [row for part in parts if [str(n) for n in part[0]] == header for row in part[1:]]
    if not rows:
        raise InputError(f"no rows in {source.where}", "rows of numbers", "Check the export.")
    arrays = {
        name: np.array([_number(row[k]) if k < len(row) else np.nan for row in rows])
        for k, name in enumerate(header)
        if name and any(isinstance(row[k], (int, float)) for row in rows[:50] if k < len(row))
    }
    return channels_of(arrays, source, known)


def _number(cell: Any) -> float:
    return float(cell) if isinstance(cell, (int, float)) else np.nan


ARBIN_EXCEL = mapped(
    "arbin", "arbin-excel", matches=_is_workbook, read=_read_workbook, isolated=True
)


def _read_access(source: LogSource, known: Format) -> RawLog:
    """The table of the channel, printed by mdbtools and read as Arbin's CSV."""
    program = shutil.which(_MDB_EXPORT)
    if program is None:
        raise InputError(
            f"an Access database (Arbin .res) {source.where}, for which {_MDB_EXPORT} of mdbtools "
            "is not installed",
            f"the program {_MDB_EXPORT}",
            "Install mdbtools (apt install mdbtools, brew install mdbtools), or export as CSV.",
        )
    limits = Limits.of(source.size)
    with tempfile.TemporaryDirectory() as folder:
        text = Path(folder) / "table.csv"
        try:
            with text.open("wb") as into:
                done = subprocess.run(
                    [program, str(source.path.resolve()), _ARBIN_TABLE],
                    stdout=into,
                    stderr=subprocess.PIPE,
                    stdin=subprocess.DEVNULL,
                    timeout=limits.seconds,
                    check=False,
                )
        except subprocess.TimeoutExpired:
            raise limits.too_slow(source.where) from None
        if done.returncode != 0 or text.stat().st_size == 0:
            said = done.stderr.decode("utf-8", errors="replace").strip().splitlines()
            raise damaged(
                source, "Arbin .res file", said[0] if said else f"no table {_ARBIN_TABLE}"
            )
        try:
            return read_csv(open_source(text, source.progress, source.options), known)
        except InputError as error:
            found = error.found.replace(f"'{text}'", source.where)
            raise InputError(found, error.expected, error.action) from None


ARBIN_RES = mapped(
    "arbin",
    "arbin-res",
    matches=lambda source: source.head.startswith(_ACCESS),
    read=_read_access,
)
