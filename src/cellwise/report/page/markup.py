"""Pieces of HTML: escaped text, tables, data for machines, links from notices to rows."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple, TypeVar

from cellwise.logs.cell_log import CellLog
from cellwise.notices import Notice
from cellwise.report.page.numerals import NONE
from cellwise.wording import Option, RowPlace, in_python

T = TypeVar("T")


class Markup(str):
    """Text that is HTML already; everything else is escaped before it enters a page."""

    __slots__ = ()


EMPTY = Markup("")


class PageLimits(NamedTuple):
    """How much a page holds, each a number of things: beyond, it is long to read and to open."""

    bullets: int = 3  # before the first picture
    columns: int = 9  # of a table whose head stays on one line
    plots: int = 6  # of one kind: of simulations, of replays, of pulses
    listed: int = 6  # of what is compared: causes, cells, replays side by side
    pulses: int = 300  # rows of the table of those not healthy
    cells: int = 2000  # rows of a fleet's table
    samples: int = 3_000_000  # in the plots of every sample


MOST = PageLimits()


@cache
def page_file(name: str) -> str:
    """A stylesheet or program of the page, as its file has it."""
    return (files("cellwise.report.page") / name).read_text(encoding="utf-8")


def escape(text: object) -> Markup:
    """Text made safe inside an element or an attribute; markup stays as it is."""
    return text if isinstance(text, Markup) else Markup(html.escape(str(text), quote=True))


def paragraph(text: object, kind: str = "") -> Markup:
    """A paragraph, of a class if one is named."""
    named = f' class="{escape(kind)}"' if kind else ""
    return Markup(f"<p{named}>{escape(text)}</p>")


def bullets(items: Iterable[object], kind: str = "") -> Markup:
    """A list; nothing where there is nothing to list."""
    inside = "".join(f"<li>{escape(item)}</li>" for item in items)
    named = f' class="{escape(kind)}"' if kind else ""
    return Markup(f"<ul{named}>{inside}</ul>" if inside else "")


def lead_of(alerts: Sequence[object], figures: Markup, lines: Sequence[object] = ()) -> Markup:
    """What stands before the first picture: alerts, key figures, lines; three bullets in all.

    What is beyond three opens on a click.
    """
    first = list(alerts)[: MOST.bullets]
    then = list(lines)[: MOST.bullets - len(first)]
    rest = [*list(alerts)[len(first) :], *list(lines)[len(then) :]]
    more = details(f"{len(rest)} more", bullets(rest)) if rest else ""
    return Markup(bullets(first, "notices") + figures + bullets(then) + more)


def table(
    head: Sequence[object],
    rows: Iterable[Sequence[object]],
    *,
    caption: str = "",
    marked: int | None = None,
    text_columns: Iterable[int] = (0,),
    sortable: bool = False,
) -> Markup:
    """A table; columns hold numbers but for ``text_columns``; one row may be marked.

    Columns of which no row says anything are left out. ``sortable``: a click on a column's head
    puts the rows in its order.
    """
    rows = list(rows)
    said = [any(row[k] not in ("", "-", NONE) for row in rows) for k in range(len(head))]
    kept = [k for k, one in enumerate(said) if one or not rows]
    text = {kept.index(k) for k in text_columns if k in kept}
    head, *rows = [[row[k] for k in kept] for row in (head, *rows)]

    def cells(row: Sequence[object], tag: str) -> str:
        kinds = ("" if k in text else ' class="n"' for k in range(len(row)))
        return "".join(
            f"<{tag}{kind}>{escape(cell)}</{tag}>" for kind, cell in zip(kinds, row, strict=True)
        )

    mark = ' class="marked"'
    kinds = ["many"] * (len(head) > MOST.columns) + ["sort"] * sortable
    kind = f' class="{" ".join(kinds)}"' if kinds else ""
    body = "".join(
        f"<tr{mark if k == marked else ''}>{cells(row, 'td')}</tr>\n" for k, row in enumerate(rows)
    )
    note = paragraph(caption, "note") if caption else ""
    return Markup(
        f'{note}<div class="scroll"><table{kind}><thead><tr>{cells(head, "th")}</tr></thead>\n'
        f"<tbody>\n{body}</tbody></table></div>"
    )


def record_table(
    items: Iterable[T], *columns: tuple[object, Callable[[T], object]], **options: Any
) -> Markup:
    """A table of a row per item; a column is its head and how an item reads in it.

    ``options`` as of :func:`table`.
    """
    rows = [[read(item) for _, read in columns] for item in items]
    return table([head for head, _ in columns], rows, **options)


def details(summary: object, inside: Markup) -> Markup:
    """Something long that opens on a click, without any script."""
    return Markup(f"<details><summary>{escape(summary)}</summary>\n{inside}\n</details>")


def tiles(facts: Iterable[tuple[object, object]]) -> Markup:
    """A row of key figures: value large, name small."""
    inside = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in facts
    )
    return Markup(f'<dl class="tiles">{inside}</dl>')


def beside(*blocks: str) -> Markup:
    """Blocks beside one another where the window is wide enough."""
    inside = "".join(f"<div>{block}</div>" for block in blocks if block)
    return Markup(f'<div class="beside">{inside}</div>')


def data_block(data: Mapping[str, Any]) -> Markup:
    """The figures as JSON in the page, under the id ``cellwise-data``.

    A figure that does not exist is null. No ``<`` stands in it, so nothing in it can end it.
    """
    text = json.dumps(finite(data), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    return Markup(f'<script type="application/json" id="cellwise-data">{text}</script>')


def finite(value: Any) -> Any:
    """JSON values with null for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, bool | int | str) or value is None:
        return value
    number = float(value)
    return number if math.isfinite(number) else None


def clock_of(log: CellLog) -> str:
    """What the plots of a log share, so that a time in one of them is a time in all."""
    return log.name or "log"


def linked(notice: Notice, log: CellLog, shown: CellLog | None = None) -> Markup:
    """A notice about a log; the rows that it names are links that show them in its plots.

    Parameters
    ----------
    notice : Notice
    log : CellLog            whose rows they are
    shown : CellLog or None  the part of it that is drawn; None: all of it

    Returns
    -------
    Markup        the text, escaped; without links where it names no row that the log has
    """
    named = any(isinstance(piece, RowPlace) for piece in notice.pieces)
    parts = [escape(notice.before)]
    for piece in notice.pieces:
        if isinstance(piece, RowPlace):
            parts.append(_link(piece.words, log, piece.rows, shown or log))
        else:
            parts.append(escape(in_python(piece) if isinstance(piece, Option) else piece))
    if notice.rows is not None and not named:
        parts += [Markup(" "), _link("show", log, notice.rows, shown or log)]
    return Markup("".join(parts))


def _link(text: str, log: CellLog, rows: range, shown: CellLog) -> Markup:
    """A link, or the text alone where those rows are not drawn."""
    if not 0 <= rows.start < rows.stop <= len(log):
        return escape(text) if text != "show" else EMPTY
    ends = log.time_s[rows.start], log.time_s[rows.stop - 1]
    if ends[0] < shown.time_s[0] or ends[1] > shown.time_s[-1]:
        return escape(text) if text != "show" else EMPTY
    return _jump(text, shown, *(f"{s - shown.time_s[0]:.10g}" for s in ends))


def jump(text: str, log: CellLog, rows: slice) -> Markup:
    """A link that shows rows of a log in its plots."""
    ends = (log.time_s[k] - log.time_s[0] for k in (rows.start, rows.stop - 1))
    return _jump(text, log, *(f"{s:.10g}" for s in ends))


def _jump(text: str, log: CellLog, low: str, high: str) -> Markup:
    return Markup(
        f'<button class="jump" data-clock="{escape(clock_of(log))}" data-from="{low}" '
        f'data-to="{high}">{escape(text)}</button>'
    )


def linked_among(notice: Notice, logs: Iterable[CellLog]) -> Markup:
    """A notice that begins with the name of one of several logs, with links to its rows."""
    own = next((log for log in logs if log.name and log.name == notice.log), None)
    return escape(notice.text) if own is None else linked(notice, own)
