"""Tables of a fixed step as C: cell_table.h says what is in, cell_table.c holds the numbers."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import hex_float, row_names
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.files import shipped_folder
from cellwise.printing.firmware import HEADERS, print_files
from cellwise.wording import arg

BY_HAND = (
    "cellwise_float.h",
    "cellwise_store.h",
    "cellwise_store.c",
    "cellwise_crc.h",
    "cellwise_patch.h",
    "cellwise_seal.h",
    "cellwise_clock.h",
    "cellwise_cell.h",
)
# Headers that an application includes; the others are parts of cellwise_ekf.c.
PUBLIC_HEADERS = (
    *HEADERS,
    "cellwise_store.h",
    "cellwise_clock.h",
    "cellwise_cell.h",
    "cell_table.h",
)
# Every optimisation that keeps IEEE 754 float32, and no contraction.
STRICT_FLAGS = ("-std=c99", "-ffp-contract=off", "-fno-math-errno")
WARNING_FLAGS = (
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wdouble-promotion",
    "-Wconversion",
    "-Wfloat-equal",
    "-Wshadow",
    "-Werror",
)


def firmware_folder() -> Path:
    """Folder of the C sources and templates; raises as `shipped_folder`."""
    return shipped_folder("_firmware", "firmware_ref", BY_HAND[0])


def header_text(tables: FixedStepTables, sha256: str, name: str = "") -> str:
    """cell_table.h: what is compiled in, the time step, and which model it was."""
    unsigned = ("CELLWISE_POINTS", "CELLWISE_TEMPERATURES")
    marks = {
        "@NAME@": comment(name) or "unnamed",
        "@SHA256@": sha256,
        "@DT_S@": f"{hex_float(tables.dt_s)} /* {tables.dt_s:g} s */",
        "@BYTES@": str(tables.flash_bytes),
        "@CRC@": f"{zlib.crc32(tables.to_bytes()):08X}",
        "@DEFINES@": "\n".join(
            f"#define {key} {value}{'u' if key in unsigned or value > 1 else ''}"
            for key, value in tables.options.defines().items()
        ),
    }
    return filled((firmware_folder() / "cell_table.h.in").read_text(encoding="utf-8"), marks)


def source_text(tables: FixedStepTables) -> str:
    """cell_table.c: the constant ``cellwise_cell``, every number a hex float."""
    lines = [
        "/* Written by `cellwise export`; do not edit. */",
        '#include "cellwise_cell.h"',
        "",
        "const cellwise_model cellwise_cell = {",
        "    {",
    ]
    record = tables.constants[0]
    for name in tables.constants.dtype.names or ():
        lines.append(f"        {initialiser(record[name])}, /* {name} */")
    lines += ["    },", "    {"]
    lines.append(f"        /* {', '.join(row_names(tables.options))} */")
    for rows in tables.table:
        lines.append("        {")
        lines += (f"            {initialiser(row)}," for row in rows)
        lines.append("        },")
    return "\n".join([*lines, "    },", "};", ""])


def write_sources(
    tables: FixedStepTables, sha256: str, name: str = ""
) -> Iterator[tuple[str, str]]:
    """Names and texts of every file that a target compiles."""
    folder = firmware_folder()
    yield from print_files(tables.options).items()
    for source in BY_HAND:
        yield source, (folder / source).read_text(encoding="utf-8")
    yield "cell_table.h", header_text(tables, sha256, name)
    yield "cell_table.c", source_text(tables)


def put(files: Mapping[str, str] | Iterable[tuple[str, str]], folder: Path) -> None:
    """Texts by their names below a folder."""
    for name, text in dict(files).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


def filled(text: str, marks: Mapping[str, str]) -> str:
    """A template with every mark replaced."""
    for mark, content in marks.items():
        text = text.replace(mark, content)
    return text


def zipped(files: Mapping[str, str | bytes]) -> bytes:
    """Files by their names as a ZIP archive, the same bytes each time."""
    place = io.BytesIO()
    with zipfile.ZipFile(place, "w") as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return place.getvalue()


def initialiser(value: Any) -> str:
    """A number, an array of numbers or a record of them as C."""
    if np.ndim(value) or np.asarray(value).dtype.names:
        return "{" + ", ".join(initialiser(v) for v in value) + "}"
    if np.issubdtype(np.asarray(value).dtype, np.integer):
        return f"{int(value)}u"
    return hex_float(float(value))


def comment(text: str) -> str:
    """Text that can neither end a comment nor begin one, join lines or be a trigraph."""
    plain = filled(text, {"*/": "* /", "/*": "/ *", "\\": "/", "??": "? ?"})
    return "".join(ch if ch.isprintable() and ord(ch) < 127 else "?" for ch in plain)


def prefixed(files: Mapping[str, str], prefix: str) -> dict[str, str]:
    """The same files with other names of everything: two chemistries in one image.

    Raises
    ------
    InputError        no name of C, or one that is taken
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,30}", prefix) or prefix.casefold() == "cellwise":
        raise InputError(
            f"a prefix '{prefix}'",
            "a name of C: a letter, then letters, digits and _, up to 31",
            "Write e.g. " + arg("prefix", "nmc") + ".",
        )
    flat = [PurePosixPath(name).name for name in files]
    names = {
        name: f"{prefix}_{name.removeprefix('cellwise_')}"
        for name in flat
        if name.endswith((".c", ".h")) and name != "main.c"
    }
    found = {}
    for name, text in files.items():
        for old, new in names.items():
            text = re.sub(rf"(?<![A-Za-z0-9_]){re.escape(old)}", new, text)
        text = re.sub(r"\bcellwise_(?=[a-z])", f"{prefix}_", text)
        text = re.sub(r"\bCELLWISE_(?=[A-Z])", f"{prefix.upper()}_", text)
        place = PurePosixPath(name)
        found[str(place.with_name(names.get(place.name, place.name)))] = text
    return found
