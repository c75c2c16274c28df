"""How kernels are compiled: three decorators, so that every kernel is compiled in one way.

Nothing allocates and nothing counts references (`_nrt`): an array that a kernel is handed belongs
to the caller for as long as the call lasts. `inline` is done by LLVM, after types are known: it
costs a tenth of the compile time of numba's own inlining and gives the same machine code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")

OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}


def inline(function: Callable[P, R]) -> Callable[P, R]:
    """An equation: part of whatever calls it."""
    compiled: Callable[P, R] = njit(**OPTIONS, forceinline=True)(function)
    return compiled


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A function of its own, called where speed does not matter or the code would grow."""
    compiled: Callable[P, R] = njit(**OPTIONS)(function)
    return compiled


def rows(function: Callable[P, R]) -> Callable[P, R]:
    """A loop over the rows of a log: other threads go on meanwhile."""
    compiled: Callable[P, R] = njit(**OPTIONS, nogil=True)(function)
    return compiled
