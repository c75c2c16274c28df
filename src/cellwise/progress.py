"""How far a long call is: one line in a terminal, a bar in a notebook, nothing in a file."""

from __future__ import annotations

import sys
from html import escape
from importlib import import_module
from types import TracebackType
from typing import Protocol, Self

CLEAR_LINE = "\r\x1b[2K"


class Display(Protocol):
    """What IPython gives for a shown thing that changes."""

    def update(self, shown: object) -> None:
        """Show this in its place."""
        ...


class ProgressBar:
    """Hand it to any ``progress`` of cellwise; :meth:`close` takes it away.

    It takes what those calls say: a text, a share done, a number done and the number of all.

    Examples
    --------
    >>> with progress_bar() as bar:                                   # doctest: +SKIP
    ...     found = diagnose(model, logs, progress=bar)
    """

    def __init__(self) -> None:
        self._shown: Display | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __call__(self, *said: str | float | None) -> None:
        """Show what a call says of itself."""
        text, share = read_progress(said)
        if "ipykernel" in sys.modules:
            self._show(_bar(text, share))
        elif sys.stderr.isatty():
            part = "" if share is None else f"{share:4.0%} "
            sys.stderr.write(f"{CLEAR_LINE}{part}{text}")
            sys.stderr.flush()

    def close(self) -> None:
        """Take the line or the bar away."""
        if self._shown is not None:
            self._show("")
        elif sys.stderr.isatty():
            sys.stderr.write(CLEAR_LINE)
            sys.stderr.flush()

    def _show(self, html: str) -> None:
        display = import_module("IPython.display")
        if self._shown is None:
            self._shown = display.display(display.HTML(html), display_id=True)
        else:
            self._shown.update(display.HTML(html))


def progress_bar() -> ProgressBar:
    """A bar for ``progress`` of `identify_cell`, `diagnose`, `read_log`, benchmarks and fleets."""
    return ProgressBar()


def read_progress(said: tuple[str | float | None, ...]) -> tuple[str, float | None]:
    """What is being done, and the share that is done, None where nobody knows.

    One number is a share; of several the first is done and the last is all.
    """
    text = ", ".join(one for one in said if isinstance(one, str))
    numbers = [float(one) for one in said if isinstance(one, (int, float))]
    if len(numbers) == 1:
        return text, min(max(numbers[0], 0.0), 1.0)
    if not numbers or numbers[-1] <= 0.0:
        return text, None
    counted = f"{numbers[0]:,.0f} of {numbers[-1]:,.0f}"
    return f"{text}, {counted}" if text else counted, min(numbers[0] / numbers[-1], 1.0)


def _bar(text: str, share: float | None) -> str:
    value = "" if share is None else f" value='{share:.3f}'"
    return f"<progress max='1'{value}></progress> {escape(text)}"
