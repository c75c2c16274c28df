"""What the printers share: a head that says so, and lines of at most 100 characters."""

from __future__ import annotations

from collections.abc import Sequence

COMMAND = "python -m cellwise.printing"
WIDTH = 100


def head(title: str, *more: str) -> list[str]:
    """First lines of a printed Python module."""
    return [
        f'"""{title}',
        "",
        *more,
        *([""] if more else []),
        f"Printed from :mod:`cellwise.cell.description` by `{COMMAND}`; do not edit.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
    ]


def wrapped_call(start: str, arguments: Sequence[str], end: str = "") -> list[str]:
    """``start(arguments)end`` as the formatter writes it: in one line, in two, or one each."""
    listed = ", ".join(arguments)
    whole = f"{start}({listed}){end}"
    if len(whole) <= WIDTH:
        return [whole]
    indent = " " * (len(start) - len(start.lstrip()))
    return [f"{start}(", *(f"{indent}    {a}," for a in arguments), f"{indent}){end}"]
