"""An interrupt ends a command with one line, wherever it strikes."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Interrupts:
    """Whether the command was interrupted.

    An interrupt inside the import of a compiled library or a compiler's callback may come out as
    any error, or as none that can be caught.
    """

    def __init__(self) -> None:
        self.struck = False

    def strike(self, number: int, frame: FrameType | None) -> None:
        """Remember it and raise it, as Python does."""
        self.struck = True
        raise KeyboardInterrupt


@contextmanager
def watched() -> Iterator[Interrupts]:
    """Watch for interrupts; what cannot be raised after one is not printed either."""
    interrupts = Interrupts()
    if threading.current_thread() is not threading.main_thread():
        yield interrupts  # signals are the main thread's
        return
    before = signal.signal(signal.SIGINT, interrupts.strike)
    hook = sys.unraisablehook

    def quiet(error: Any) -> None:
        if not interrupts.struck:
            hook(error)

    sys.unraisablehook = quiet
    try:
        yield interrupts
    finally:
        signal.signal(signal.SIGINT, before)
        if not interrupts.struck:  # else what is torn down at exit would be printed
            sys.unraisablehook = hook
