"""Write a log in the tidy form, and columns of results, whole or not at all."""

from __future__ import annotations

import gzip
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.arguments import file_path
from cellwise.errors import InputError
from cellwise.files import write_atomically
from cellwise.logs.cell_log import CHANNELS, CellLog
from cellwise.logs.checks.units import check_is_log
from cellwise.logs.files.arrow import from_numpy
from cellwise.wording import arg

if TYPE_CHECKING:
    import pyarrow
    from numpy.typing import NDArray

BDF = ".bdf"  # before the suffix of a Battery Data Format
SUFFIXES = (
    *(".parquet", ".csv", ".csv.gz", ".mat", ".bdf", ".bdf.gz", ".bdf.csv", ".bdf.csv.gz"),
    ".bdf.parquet",
)
# Battery Data Format 1.0, preferred labels: https://github.com/battery-data-alliance
BDF_LABELS = (
    *("Test Time / s", "Current / A", "Voltage / V", "Surface Temperature T1 / degC"),
    *("Net Capacity / Ah", "Step Count / 1"),
)
# As a Digatron exports its measurement, and the public logs in MATLAB files have it.
MATLAB_STRUCTURE = "meas"
MATLAB_NAMES = ("Time", "Current", "Voltage", "Battery_Temp_degC", "Ah", "Step")
CHARGE_POSITIVE = ("current_A", "charge_Ah")  # in both of these formats, the other way than here
ROWS_AT_ONCE = 250_000
GZIP_LEVEL = 4

Columns = Mapping[str, "NDArray[Any]"]


def write_log(log: CellLog, path: str | Path) -> Path:
    """Write a log, whole or not at all; the suffix says in which form.

    The tidy form as ``.csv``, ``.csv.gz`` or ``.parquet``; the Battery Data Format as ``.bdf``,
    ``.bdf.gz``, ``.bdf.csv``, ``.bdf.csv.gz`` or ``.bdf.parquet``; ``.mat`` as a structure ``meas``
    of MATLAB. The latter two are positive on charge, as their other writers have it. Every number
    is written so that it reads back the same. Missing values are empty cells, NaN in MATLAB.

    Returns
    -------
    Path              where the file now is

    Raises
    ------
    InputError        another suffix, or a place that cannot be written to
    """
    check_is_log(log)
    place = file_path("path", path)
    name = place.name.casefold()
    if name.endswith(".mat"):
        return write_atomically(place, lambda target: _write_matlab(log, target))
    standard = name.endswith(tuple(s for s in SUFFIXES if s.startswith(BDF)))
    columns = _turned(log, BDF_LABELS) if standard else log.columns()
    return _written(_table(columns), place, SUFFIXES)


def _turned(log: CellLog, labels: Sequence[str]) -> Columns:
    """The same by other labels, current and counter positive on charge."""
    found: dict[str, NDArray[Any]] = {}
    for field, label in zip(CHANNELS, labels, strict=True):
        values = log.interval_current_A if field == "current_A" else getattr(log, field)
        if values is not None:
            found[label] = 0.0 - values if field in CHARGE_POSITIVE else values
    return found


def _write_matlab(log: CellLog, target: Path) -> None:
    from scipy.io import savemat

    structure = {MATLAB_STRUCTURE: dict(_turned(log, MATLAB_NAMES))}
    savemat(target, structure, appendmat=False, oned_as="column", do_compression=True)


def _table(columns: Columns) -> pyarrow.Table:
    """The columns as they lie in memory, NaN as nulls."""
    import pyarrow as pa

    return pa.table({name: from_numpy(values) for name, values in columns.items()})


def _written(table: pyarrow.Table, path: Path, suffixes: Sequence[str]) -> Path:
    """Write a table, whole or not at all, in the form that the suffix says."""
    name = path.name.casefold()
    if not name.endswith(tuple(suffixes)):
        raise InputError(
            f"an output file '{path.name}'",
            f"a name that ends in {', '.join(suffixes)}",
            "The suffix says in which form it is written.",
        )
    if name.endswith(".parquet"):
        return write_atomically(path, lambda target: _write_parquet(table, target))
    packed = name.endswith(".gz")
    return write_atomically(path, lambda target: _write_csv(table, target, compressed=packed))


def _write_parquet(table: pyarrow.Table, target: Path) -> None:
    from pyarrow import parquet, types

    floats = [field.name for field in table.schema if types.is_floating(field.type)]
    others = [name for name in table.column_names if name not in floats]
    # The bytes of floating point numbers apart: a third smaller than with a dictionary, and read in
    # half the time.
    parquet.write_table(
        table, target, row_group_size=ROWS_AT_ONCE, compression="zstd", use_dictionary=others,
        use_byte_stream_split=floats,
    )  # fmt: skip


def _write_csv(table: pyarrow.Table, target: Path, *, compressed: bool) -> None:
    from pyarrow import csv

    with target.open("wb") as file:
        # Without a name and a time in its header, the same log makes the same bytes.
        stream = gzip.GzipFile("", "wb", GZIP_LEVEL, file, mtime=0) if compressed else file
        stream.write((",".join(table.column_names) + "\n").encode())
        csv.write_csv(table, stream, csv.WriteOptions(include_header=False))
        if compressed:
            stream.close()


def write_columns(columns: Mapping[str, Any], path: Path) -> Path:
    """Write arrays of one length as columns; the suffix says in which form.

    Raises
    ------
    InputError        another suffix, or a place that cannot be written to
    """
    import pyarrow as pa

    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    return _written(table, path, (".parquet", ".csv", ".csv.gz"))


def write_rows(columns: Mapping[str, Any], types: Mapping[str, type], path: Path) -> Path:
    """Write lists of one length as a parquet file whose types do not depend on the values.

    Parameters
    ----------
    columns : mapping       name to list, None for what is missing
    types : mapping         name to ``int``, ``float`` or ``str``
    path : Path             appears whole or not at all
    """
    import pyarrow as pa

    kinds = {int: pa.int64(), float: pa.float64(), str: pa.string()}
    table = pa.table({n: pa.array(list(columns[n]), kinds[kind]) for n, kind in types.items()})
    return write_atomically(path, lambda target: _write_parquet(table, target))


def read_rows(path: Path) -> dict[str, list[Any]]:
    """Columns of a parquet file as lists.

    Raises
    ------
    InputError        no parquet file
    """
    import pyarrow as pa
    import pyarrow.parquet

    try:
        with pa.parquet.ParquetFile(path) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            f"'{path}', which is no parquet file ({str(error).splitlines()[0]})",
            "a part that this command wrote",
            "Remove it, or start again with " + arg("fresh", True) + ".",
        ) from None
    return dict(table.to_pydict())
