"""Recordings to compact parquet files, and the catalogue that describes them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from .instrument import Recording


def write_parquet(recording: Recording, path: Path) -> None:
    """Write a tidy log; the file appears whole or not at all.

    Quantised columns repeat their values, which a dictionary packs into few bits; columns that
    hardly repeat do better with their bytes split by significance. Each column is tried both ways.
    """
    columns = {name: values for name, values in recording._asdict().items() if values is not None}
    table = pa.table(columns)
    dictionary = [name for name in columns if _prefers_dictionary(table.select([name]))]
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    _write(table, part, dictionary)
    os.replace(part, path)


def _write(table: pa.Table, target: Path | pa.BufferOutputStream, dictionary: list[str]) -> None:
    """Write with the named columns as dictionaries and the others byte-split."""
    pq.write_table(
        table,
        target,
        compression="zstd",
        compression_level=19,
        use_dictionary=dictionary,
        column_encoding={
            name: "BYTE_STREAM_SPLIT" for name in table.column_names if name not in dictionary
        },
        dictionary_pagesize_limit=2**23,
        write_statistics=False,
        store_schema=False,
    )


def _prefers_dictionary(column: pa.Table) -> bool:
    sizes: list[int] = []
    choices: tuple[list[str], ...] = (column.column_names, [])
    for dictionary in choices:
        buffer = pa.BufferOutputStream()
        _write(column, buffer, dictionary)
        sizes.append(buffer.getvalue().size)
    return sizes[0] < sizes[1]


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _toml_value(value: object) -> str:
    """Write a string, number or list of numbers as TOML."""
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    if isinstance(value, list):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    return repr(value)


def write_catalogue(head: str, entries: list[Mapping[str, Any]], path: Path) -> None:
    """Write `[[dataset]]` tables in TOML under a comment.

    Parameters
    ----------
    head : str         lines of the comment
    entries : list     one mapping per file, values are strings, numbers or lists of numbers
    path : Path
    """
    lines = [f"# {line}".rstrip() for line in head.splitlines()]
    for entry in entries:
        lines += ["", "[[dataset]]"]
        lines += [f"{key} = {_toml_value(value)}" for key, value in entry.items()]
    part = path.with_suffix(".part")
    part.write_text("\n".join(lines) + "\n", encoding="utf-8")
    os.replace(part, path)
