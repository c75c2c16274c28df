"""Files of testers that are more than a table: texts with levels, and what their programs store.

Basytec between blanks, Neware's levels; by the libraries that others keep for them also
BioLogic ``.mpr``, Neware ``.nda`` and ``.ndax``, Digatron's MATLAB structures.
"""

from __future__ import annotations

import csv
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import TIDY_CHANNELS
from cellwise.logs.files.format import Format, chosen_log, library_at_work, need
from cellwise.logs.files.header import header_cells
from cellwise.logs.files.source import NOTHING_SAID, LogSource, RawLog, lines_of
from cellwise.logs.files.tables import channels_of
from cellwise.logs.formats.column_maps import mapped
from cellwise.notices import Code, Notice

# Basytec: lines with a tilde before the rows, cells between tabs or blanks.


def _basytec_header(source: LogSource) -> str:
    return next((line for line in source.first_lines if "U[" in line and "Time[" in line), "")


def _is_basytec(source: LogSource) -> bool:
    times = {c.field: c.names for c in BASYTEC_TEXT.channels}["time_s"]
    return any(name in _basytec_header(source).split() for name in times)


BASYTEC_TEXT = mapped("basytec-text", matches=_is_basytec)


# Neware's levels: a row for a cycle, below it its steps, below these their records. The first step
# of a cycle may stand in the row of the cycle, behind its cells.
_CYCLE, _STEP, _RECORD = (
    ("Cycle ID", "Cycle Index"),
    ("Step ID", "Step Index"),
    ("Record ID", "DataPoint", "Record Index"),
)
_STEP_NAMES = ("Step Name", "Step Type", "State")


def _level_headers(source: LogSource) -> list[list[str]] | None:
    """The three header lines; None of another file."""
    lines = [line for line in source.first_lines[:6] if line]
    if len(lines) < 3:
        return None
    rows = [[cell.strip() for cell in header_cells(line)] for line in lines[:3]]
    for level, (row, wanted) in enumerate(zip(rows, (_CYCLE, _STEP, _RECORD), strict=True)):
        if len(row) <= level or row[level] not in wanted or any(row[:level]):
            return None
    return rows


def _read_levels(source: LogSource, known: Format) -> RawLog:
    cycle_header, step_header, header = _level_headers(source) or ([], [], [])
    cycle_cells = max((k + 1 for k, name in enumerate(cycle_header) if name), default=0)
    place = next((k for k, name in enumerate(step_header) if name in _STEP_NAMES), None)
    columns = {name: k for k, name in enumerate(header) if name}
    cells: dict[str, list[str]] = {name: [] for name in columns}
    steps: list[float] = []
    states: list[str] = []
    step, state = 0, ""
    for row in _level_rows(source, len(header)):
        if row[0]:
            row = ["", *row[cycle_cells:], ""]
            if not row[1]:
                continue
        if row[1]:
            step += 1
            state = row[place] if place is not None and place < len(row) else ""
        elif row[2]:
            for name, k in columns.items():
                cells[name].append(row[k] if k < len(row) else "")
            steps.append(step)
            states.append(state)
    arrays = {name: _numbers(values) for name, values in cells.items()}
    arrays["Step Index"] = np.array(steps)
    if place is not None:
        arrays["Step Type"] = np.array(states)
    return channels_of(arrays, source, known)


def _level_rows(source: LogSource, width: int) -> Iterator[list[str]]:
    """Cells of the rows below the headers."""
    delimiter = max(",;\t", key=source.first_lines[2].count)
    try:
        for number, row in enumerate(csv.reader(lines_of(source), delimiter=delimiter)):
            if number >= 3 and len(row) >= 3:
                yield [cell.strip() for cell in row]
    except csv.Error as error:
        raise InputError(
            f"text in {source.where} that cannot be read as a table ({error})",
            f"rows of {width} cells",
            "Check the export.",
        ) from None


def _numbers(values: list[str]) -> np.ndarray:
    """Numbers where all cells are, else the texts."""
    try:
        return np.array([float(v) if v not in ("", "-", "--") else np.nan for v in values])
    except ValueError:
        return np.array(values)


NEWARE_LEVELS = mapped(
    "neware-levels",
    matches=lambda source: _level_headers(source) is not None,
    read=_read_levels,
)


_ZIP = b"PK\x03\x04"
_MATLAB_5, _MATLAB_7 = b"MATLAB 5.0", b"MATLAB 7.3"
_NEWARE = b"NEWARE"
_NEWARE_IN_ZIP = (b".ndc", b"VersionInfo.xml", b"TestInfo.xml", b"Step.xml")


def _read_mpr(source: LogSource, known: Format) -> RawLog:
    biologic = need("galvani.BioLogic", "a BioLogic .mpr file")
    with library_at_work(source, "BioLogic .mpr file"), source.open() as file:
        data: Any = biologic.MPRfile(file).data
    return channels_of({name: np.asarray(data[name]) for name in data.dtype.names}, source, known)


BIOLOGIC_MPR = mapped(
    "biologic-mpt",
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


def _read_neware(source: LogSource, known: Format) -> RawLog:
    suffix = ".nda" if source.head.startswith(_NEWARE) else ".ndax"
    with (
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
    said = (str(warning.message).split(" If you can")[0] for warning in caught)
    return raw.noted(Notice(Code.LIBRARY_WARNING, text) for text in said)


NEWARE_STORED = mapped("neware-nda", matches=_is_neware, read=_read_neware, isolated=True)


def _read_matlab(source: LogSource, known: Format) -> RawLog:
    """The structure, or the top level, that holds most of the channels."""
    content: Mapping[str, Any]
    if source.head.startswith(_MATLAB_7):
        h5py = need("h5py", "a MATLAB 7.3 file")

        def level(item: Any) -> Any:
            if isinstance(item, h5py.Group):
                return {name: level(item[name]) for name in item if name[0] != "#"}
            if h5py.check_ref_dtype(item.dtype) is not None:  # cells, or structures in an array
                inner = [level(item.file[ref]) for ref in np.ravel(item[()])]
                return inner if len(inner) > 1 else inner[0]
            if item.attrs.get("MATLAB_class") == b"char":
                return "".join(map(chr, np.ravel(item[()], order="F")))
            return item[()]

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
    logs = [one for one in tables if _is_log(one[1], source, known)]
    if not logs:
        logs = [max(tables, key=lambda one: (len(names.intersection(one[1])), len(one[1])))]
    sizes = (max(map(np.size, columns.values())) for _, columns in logs)
    called = [f"{name or 'top level'}, {n} rows" for (name, _), n in zip(logs, sizes, strict=True)]
    _, columns = logs[chosen_log(called, source)]
    raw = _log_of(columns, source, known)
    # Whoever fills a structure by hand decides what its current's sign means.
    return raw if any(name in columns for name in _SIGNED) else replace(raw, signed=False)


_SIGNED = ("Battery_Temp_degC", "TimeStamp", "Ah", "Current_measured")


def _is_log(columns: Mapping[str, Any], source: LogSource, known: Format) -> bool:
    """A structure has time, current and voltage of one length, as stated or by its names."""
    for options in (source.options, NOTHING_SAID):
        with suppress(InputError):
            _log_of(columns, replace(source, options=options), known)
            return True
    return False


def _log_of(columns: Mapping[str, Any], source: LogSource, known: Format) -> RawLog:
    """Its channels, by Digatron's names, else by words for them."""
    try:
        return channels_of(columns, source, known)
    except InputError:
        with suppress(InputError):
            return channels_of(columns, source, replace(known, channels=TIDY_CHANNELS, known=None))
        raise


def _structures(level: Any, name: str = "", said: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every structure's columns and what it is called, from the top down, arrays in order."""
    if isinstance(level, Mapping):
        inner = {n: v for n, v in level.items() if not n.startswith(("__", "#"))}
        columns = {n: np.asarray(v).ravel() for n, v in inner.items() if _is_column(v)}
        said = next((f", {v}" for v in map(inner.get, ("type", "name")) if _is_word(v)), said)
        if columns:
            yield f"{name}{said}", columns
        # An array of cells for each quantity is an array of structures.
        sides = {n: v for n, v in inner.items() if _is_array(v) and all(map(_is_column, v))}
        if len({len(v) for v in sides.values()}) == 1 and len(sides) > 1:
            rows = [dict(zip(sides, row, strict=True)) for row in zip(*sides.values(), strict=True)]
            yield from _structures(rows, name, said)
        # So is a matrix for each, of a column for each test; what they share is one column.
        wide = {n: v for n, v in inner.items() if _is_column(v) and np.squeeze(v).ndim == 2}
        if len({np.shape(v) for v in wide.values()}) == 1 and len(wide) > 1:
            for k, parts in enumerate(zip(*map(np.transpose, wide.values()), strict=True)):
                yield f"{name}({k + 1}){said}", {**columns, **dict(zip(wide, parts, strict=True))}
        for key, value in inner.items():
            if key not in sides:
                yield from _structures(value, f"{name}.{key}" if name else key, said)
    elif _is_array(level):
        for k, value in enumerate(level):
            yield from _structures(value, f"{name}({k + 1})", said)


def _is_array(value: Any) -> bool:
    """An array of structures or of cells, as their library gives it."""
    return isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object)


def _is_column(value: Any) -> bool:
    return isinstance(value, (np.ndarray, list)) and not _is_array(value) and np.size(value) > 1


def _is_word(value: Any) -> bool:
    return isinstance(value, str) and bool(value.strip())


DIGATRON_MAT = mapped(
    "digatron-mat",
    matches=lambda source: source.head.startswith((_MATLAB_5, _MATLAB_7)),
    read=_read_matlab,
    isolated=True,
    instances=True,
)
