"""How printed C looks: comments, line breaks, numbers, conditions of the preprocessor."""

from __future__ import annotations

import io
import re
import textwrap
import tokenize
from collections.abc import Iterable
from typing import Any

from cellwise.estimate.fixed.layout import hex_float
from cellwise.estimate.fixed.options import IN_C

WIDTH = 100
Guard = frozenset[str]  # options that must hold: "SLOW", "not WIDE"
ALWAYS: Guard = frozenset()


def comment(text: str, indent: int = 0) -> list[str]:
    """A comment of C, broken to the width."""
    plain = re.sub(r"\s+", " ", text.replace("``", "`")).strip()
    pad = " " * indent
    lines = textwrap.wrap(plain, WIDTH - indent - 6, break_on_hyphens=False)
    return [f"{pad}{'/* ' if k == 0 else ' * '}{line}" + (" */" if k == len(lines) - 1 else "")
            for k, line in enumerate(lines)]  # fmt: skip


def comments_of(source: str) -> tuple[dict[int, str], dict[int, str]]:
    """Comments of a Python source by line: those that stand alone, those behind a statement."""
    alone: dict[int, str] = {}
    behind: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        text = token.string.lstrip("# ").rstrip()
        if token.type == tokenize.COMMENT and not re.match(r"(fmt|type|noqa)\b", text):
            (alone if not token.line[: token.start[1]].strip() else behind)[token.start[0]] = text
    return alone, behind


def broken(line: str, indent: int) -> list[str]:
    """A line of C in pieces within the width, cut where the fewest parentheses are open."""
    pieces: list[str] = []
    column = indent
    while column + len(line) > WIDTH:
        opened: list[int] = []
        cuts = []
        for k, ch in enumerate(line[: WIDTH - column]):
            if ch == "(":
                opened.append(k + 1)
            elif ch == ")" and opened:
                opened.pop()
            elif ch == " " and k > 8 and line[k - 1] in ",&|=+-*/?:":
                cuts.append((-len(opened), k, opened[-1] if opened else 0))
        _, cut, inside = max(cuts)
        pieces.append(" " * column + line[:cut])
        line = line[cut + 1 :]
        column = column + inside if inside and column + inside < 60 else indent + 4
    return [*pieces, " " * column + line]


def float_literal(value: Any) -> str:
    """A float32 as C reads it to the same bits: short decimals as they are, else a hex float."""
    decimal = f"{float(value):.7g}"
    if value == 0 or (float(decimal) == float(value) and 1e-3 < abs(value) < 1e5):
        return decimal + ("f" if "." in decimal else ".0f")
    return hex_float(value)


def preprocessor(guard: Guard) -> str:
    """Options that must all hold, as ``#if`` asks for them."""
    order = sorted(guard, key=lambda term: (term.startswith("not "), term))
    return _joined([_term(t) for t in order], " && ")


def any_of(guards: Iterable[Guard]) -> str:
    """Conditions of which one must hold; empty where one always does."""
    least = resolved(guards)
    return "" if ALWAYS in least else _joined(sorted(map(preprocessor, least)), " || ")


def resolved(guards: Iterable[Guard]) -> set[Guard]:
    """The same conditions in the fewest: an option and its opposite cancel."""
    found = set(guards)
    while True:
        more = {
            g - {term}
            for g in found
            for term in g
            if any(other <= (g - {term}) | {opposite(term)} for other in found)
        }
        if more <= found:
            return {g for g in found if not any(other < g for other in found)}
        found |= more


def opposite(term: str) -> str:
    """The other value of an option."""
    return term.removeprefix("not ") if term.startswith("not ") else f"not {term}"


def _term(term: str) -> str:
    name = term.removeprefix("not ")
    text = IN_C.get(name, f"CELLWISE_{name}")
    if not term.startswith("not "):
        return text
    return f"!({text})" if " " in text else f"!{text}"


def _joined(terms: list[str], operator: str) -> str:
    if len(terms) == 1:
        return terms[0]
    return operator.join(f"({t})" if " " in t else t for t in terms)


def merged(lines: list[str]) -> list[str]:
    """Lines without ``#endif`` and the same ``#if`` again."""
    found: list[str] = []
    opened: list[list[str]] = []  # conditions, with what closed last
    closed: list[str] | None = None
    for line in lines:
        if line.startswith("#if") and closed == [line]:
            found.pop()
            opened.append([line])
        else:
            if line.startswith("#if"):
                opened.append([line])
            elif line.startswith("#else"):
                opened[-1].append(line)
            found.append(line)
        closed = opened.pop() if line.startswith("#endif") else None
    return found
