"""Blackbox recordings of Betaflight and INAV (``.bbl``, ``.bfl``, ``.txt``), by orangebox."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.format import Format, chosen_log, library_at_work, need
from cellwise.logs.files.source import LogSource, RawLog, ReadLimits
from cellwise.logs.files.tables import channels_of
from cellwise.logs.formats.column_maps import mapped
from cellwise.notices import Code, Notice
from cellwise.wording import arg

_HEADER = b"H Product:Blackbox flight data recorder"
LOOK_FRAMES = 1000  # between two looks at the limits


def _read(source: LogSource, known: Format) -> RawLog:
    """The battery's channels of one session; a file holds one for each time it was armed."""
    what = "a blackbox recording"
    reading, parsing = (need(f"orangebox.{m}", what, "orangebox") for m in ("reader", "parser"))
    limits = ReadLimits.of(source.size)
    with library_at_work(source, "blackbox recording"):
        file: Any = reading.Reader(str(source.path), allow_invalid_header=True)
        edges = (*file.log_pointers, source.size)
    sizes = [f"session {k + 1}, {(b - a) / 1e3:.0f} kB" for k, (a, b) in enumerate(pairwise(edges))]
    session = chosen_log(sizes, source)
    rows: list[list[float]] = []
    notices = []
    with library_at_work(source, "blackbox recording"):
        file.set_log_index(session + 1)
        parser = parsing.Parser(file)
        used = {name for c in known.channels for name in c.names}
        places = {n: k for k, n in enumerate(map(str, parser.field_names)) if n in used}
        try:
            for number, frame in enumerate(parser.frames()):
                if number % LOOK_FRAMES == 0:
                    limits.check(source.where, number)
                rows.append([frame.data[k] for k in places.values()])
        except (TypeError, IndexError):  # as the library takes the end of the bytes
            if file.tell() < len(file):
                raise
            text = "the recording has no end: the power was cut, or the memory was full"
            notices.append(Notice(Code.FILE_CUT_OFF, text))
    if not rows:
        raise InputError(
            f"no frame in {source.where}, session {session + 1}",
            "a recording of a flight",
            "Choose another session with "
            + arg("instance", letter="K")
            + ", or copy the file again.",
        )
    table = np.array(rows, dtype=np.float64)
    arrays = {name: table[:, k] for k, name in enumerate(places)}
    return channels_of(arrays, source, known).noted(notices)


BLACKBOX = mapped(
    "blackbox",
    matches=lambda source: source.head.startswith(_HEADER),
    read=_read,
    instances=True,
    isolated=True,
)
