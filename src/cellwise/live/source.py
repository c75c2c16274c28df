"""From a source's name to a stream."""

from __future__ import annotations

from cellwise.errors import InputError
from cellwise.live.json_lines import JsonLines
from cellwise.live.pieces import STDIN, Pieces
from cellwise.live.sample import Source
from cellwise.logs.files.source import NOTHING_SAID, ReadOptions

WAYS = "stdin, json:FILE, can:INTERFACE:CHANNEL, ulog:FILE (- for standard input)"


def open_source(
    name: str,
    options: ReadOptions = NOTHING_SAID,
    sign: str = "auto",
    *,
    follow: bool = False,
    cells: int = 0,
) -> Source:
    """A stream by its name in the command line.

    Parameters
    ----------
    name : str              ``stdin``, ``json:FILE``, ``can:INTERFACE:CHANNEL``, ``ulog:FILE``; a
                            FILE of ``-`` is standard input
    options : ReadOptions   pack, channels, instance, database
    sign : str              ``charge-positive`` turns the current round
    follow : bool           wait for more at a file's end
    cells : int             voltages of so many cells of a pack, too; 0: none

    Raises
    ------
    InputError              none of these, or what it names cannot be opened
    """
    kind, _, rest = name.partition(":")
    if options.dbc is not None and kind != "can":
        raise InputError("a DBC file for a stream without CAN frames", "can:...", "Omit it.")
    if options.instance is not None and kind != "ulog":
        raise InputError("`instance=...` for a stream of one battery", "ulog:...", "Omit it.")
    if cells and kind == "ulog":
        raise InputError("cells of a pack in a ULog stream", "json:... or can:...", "Omit them.")
    if name in ("stdin", STDIN):
        return JsonLines(Pieces(STDIN), options, sign, cells)
    if kind == "json" and rest:
        return JsonLines(Pieces(rest, follow=follow), options, sign, cells)
    if kind == "can" and rest.count(":") >= 1:
        from cellwise.live.can_stream import CanStream

        interface, _, channel = rest.partition(":")
        return CanStream(interface, channel, options, sign, cells)
    if kind == "ulog" and rest:
        from cellwise.live.ulog_stream import UlogStream

        return UlogStream(Pieces(rest, follow=follow), options, sign)
    raise InputError(f"a source '{name}'", f"one of {WAYS}", "Name where the samples come from.")
