"""How printed C looks: comments, line breaks, numbers."""

from __future__ import annotations

import io
import re
import textwrap
import tokenize
from typing import Any

from cellwise.estimate.fixed.layout import hex_float

WIDTH = 120


def comment(text: str, indent: int = 0) -> list[str]:
    """A comment of C, broken to the width."""
    plain = re.sub(r":\w+:(?=`)", "", re.sub(r"\s+", " ", text.replace("``", "`"))).strip()
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
        if inside and column + inside < 60:
            column += inside
        elif len(pieces) == 1:  # later ones stand under the second
            column = indent + 4
    return [*pieces, " " * column + line]


def float_literal(value: Any) -> str:
    """A float32 as C reads it to the same bits: short decimals as they are, else a hex float."""
    decimal = f"{float(value):.7g}"
    if value == 0 or (float(decimal) == float(value) and 1e-3 < abs(value) < 1e5):
        return decimal + ("f" if "." in decimal else ".0f")
    return hex_float(value)
