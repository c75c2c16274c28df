"""Texts that name arguments as data: Python writes them as arguments, a command as its options."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple, Self

Pair = tuple[str, str]
Value = str | int | float | bool | Pair | tuple[Pair, ...]


class Option(NamedTuple):
    """An argument that a text names, and its value.

    ``letter`` stands in the text for a value that only the reader knows, ``...`` for whatever it
    is; a pair is an entry of a mapping (``channels``), several are several of them.
    """

    argument: str
    value: Value | None = None
    letter: str = ""


def pairs_of(value: object) -> tuple[Pair, ...]:
    """The entries of a mapping that a value states; none where it is another value."""
    if not isinstance(value, tuple):
        return ()
    return value if value and isinstance(value[0], tuple) else (value,)


def in_python(option: Option) -> str:
    """An option as an argument of Python, as documentation writes code."""
    pairs = pairs_of(option.value)
    written = repr(dict(pairs) if pairs else option.value)
    return f"`{option.argument}={option.letter or written}`"


class RowPlace(NamedTuple):
    """Words of a text that name rows of the log, counted from 0."""

    words: str
    rows: range


def place(rows: range) -> RowPlace:
    """Rows as people count them, from 1."""
    first, last = rows.start + 1, rows.stop
    return RowPlace(f"row {last}" if first == last else f"rows {first} to {last}", rows)


Piece = str | Option | RowPlace


class Text(str):
    """A text in Python's words that keeps what it names as data; ``+`` keeps it, too.

    Parameters
    ----------
    pieces : str, Option or RowPlace      its parts, in order
    """

    pieces: tuple[Piece, ...]

    def __new__(cls, *pieces: Piece) -> Self:
        """A text of its parts."""
        flat = tuple(p for piece in pieces for p in pieces_of(piece))
        made = super().__new__(cls, "".join(_written(p, in_python) for p in flat))
        made.pieces = flat
        return made

    def __getnewargs__(self) -> tuple[Piece, ...]:  # type: ignore[override]
        """What another process needs to make it again."""
        return self.pieces

    def __add__(self, more: str) -> Text:
        return Text(self, more)

    def __radd__(self, before: str) -> Text:
        return Text(before, self)

    def rendered(self, of_option: Callable[[Option], str]) -> str:
        """The text, with options as ``of_option`` writes them."""
        return "".join(_written(piece, of_option) for piece in self.pieces)

    @property
    def options(self) -> tuple[Option, ...]:
        """The arguments that it names."""
        return tuple(piece for piece in self.pieces if isinstance(piece, Option))


def pieces_of(piece: Piece) -> tuple[Piece, ...]:
    """The parts of a text; what has none is its own."""
    return piece.pieces if isinstance(piece, Text) else (piece,)


def _written(piece: Piece, of_option: Callable[[Option], str]) -> str:
    if isinstance(piece, Option):
        return of_option(piece)
    return piece.words if isinstance(piece, RowPlace) else piece


def arg(argument: str, value: Value | None = None, *, letter: str = "") -> Text:
    """The name of an argument with its value, or a letter in its place, within a text."""
    return Text(Option(argument, value, letter))


def within(text: str) -> Text:
    """The same with a small first letter, to go on with in another text."""
    first, *more = pieces_of(text)
    return Text(*([first[:1].lower(), first[1:]] if isinstance(first, str) else [first]), *more)


def joined_texts(texts: Iterable[str], between: str = "; ") -> Text:
    """Texts behind one another."""
    pieces = [piece for text in texts for piece in (between, text)]
    return Text(*pieces[1:])
