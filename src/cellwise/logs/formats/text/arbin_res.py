"""Arbin's database ``.res``: an Access file, whose tables the program mdb-export prints."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

from cellwise.errors import InputError
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format, damaged
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.source import LogSource, RawLog, open_source
from cellwise.logs.formats.arbin import ARBIN_CSV

_MAGIC = b"\x00\x01\x00\x00Standard Jet DB", b"\x00\x01\x00\x00Standard ACE DB"
_TABLE = "Channel_Normal_Table"
_PROGRAM = "mdb-export"


def _read(source: LogSource, known: Format) -> RawLog:
    """The table of the channel, printed by mdbtools and read as Arbin's CSV."""
    program = shutil.which(_PROGRAM)
    if program is None:
        raise InputError(
            f"an Access database (Arbin .res) {source.where}, for which {_PROGRAM} of mdbtools is "
            "not installed",
            "the program mdb-export",
            "Install mdbtools (apt install mdbtools, brew install mdbtools), or export as CSV.",
        )
    limits = Limits.of(source.size)
    with tempfile.TemporaryDirectory() as folder:
        text = Path(folder) / "table.csv"
        try:
            with text.open("wb") as into:
                done = subprocess.run(
                    [program, str(source.path.resolve()), _TABLE],
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
            raise damaged(source, "Arbin .res file", said[0] if said else f"no table {_TABLE}")
        table = open_source(text, source.progress, source.options)
        try:
            return read_csv(table, known)
        except InputError as error:
            found = error.found.replace(f"'{text}'", source.where)
            raise InputError(found, error.expected, error.action) from None


ARBIN_RES = replace(
    ARBIN_CSV,
    name="arbin-res",
    matches=lambda source: source.head.startswith(_MAGIC),
    read=_read,
)
