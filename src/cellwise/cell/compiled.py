"""How kernels are compiled: four decorators, so that every kernel is compiled in one way.

Nothing allocates and nothing counts references (`_nrt`): an array that a kernel is handed belongs
to the caller for as long as the call lasts. `inline` is done by LLVM, after types are known: it
costs a fraction of the compile time of numba's own inlining for the same machine code. Parts of
kernels get machine code in the kernel alone (:mod:`cellwise.cell.kernel_compiler`), and an entry
from Python only when they are called from there.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numba
import numpy as np
from numba import njit
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher
from numpy.typing import NDArray

from cellwise.typing import FloatArray

P = ParamSpec("P")
R = TypeVar("R")


# `kernel_compiler` stands on parts of numba that a later version may move. With one that nobody has
# tried numba's own compiler does it all: the same bits, in half as long again.
NEWEST_TRIED = (0, 68)
if tuple(int(part) for part in numba.__version__.split(".")[:2]) <= NEWEST_TRIED:
    from cellwise.cell.kernel_compiler import KernelCompiler, PartCache, PartCompiler, QuietCompiler

    BY: dict[str, dict[str, Any]] = {
        "other": {"pipeline_class": QuietCompiler},
        "kernel": {"pipeline_class": KernelCompiler},
        "part": {"pipeline_class": PartCompiler},
    }
    CACHE_OF_PARTS: type[FunctionCache] = PartCache
else:
    BY = {"other": {}, "kernel": {}, "part": {}}
    CACHE_OF_PARTS = FunctionCache

KEPT: dict[str, Any] = {"cache": True} | BY["other"]
OPTIONS: dict[str, Any] = BY["kernel"] | {
    "cache": True,
    "error_model": "numpy",
    "_nrt": False,
    "no_cfunc_wrapper": True,
    "forceinline": False,  # numba hands it on to what an inlined function calls
}
PART = OPTIONS | BY["part"] | {"no_cpython_wrapper": True}
INLINE = PART | {"forceinline": True}
QUIET = "CELLWISE_QUIET"  # set to anything: no word about compiling
LONGEST_S = 300.0  # nothing compiles for longer, on a slow machine beside other work either


class Equation(CPUDispatcher):
    """An inlined function: it has no entry from Python until Python calls it."""

    def __call__(self, *arguments: Any) -> Any:
        """Compile an entry at the first call; for tests, oracles and a look at an equation."""
        if self not in ENTRIES:
            ENTRIES[self] = _entry(self)
        return ENTRIES[self](*arguments)


ENTRIES: WeakKeyDictionary[Equation, Callable[..., Any]] = WeakKeyDictionary()


def _entry(equation: Equation) -> Callable[..., Any]:
    def call(*arguments):  # type: ignore[no-untyped-def]  # noqa: ANN002, ANN202
        return equation(*arguments)

    entry: Callable[..., Any] = njit(error_model="numpy")(call)
    return entry


def inline(function: Callable[P, R]) -> Callable[P, R]:
    """An equation: part of whatever compiled code calls it."""
    return _part(function, INLINE)


def part(function: Callable[P, R]) -> Callable[P, R]:
    """A function of its own within a kernel, where speed does not matter or the code would grow."""
    return _part(function, PART)


def noinline(function: Callable[P, R]) -> Callable[P, R]:
    """Mark what few fixed steps need: out of the others' registers and stack."""
    function.noinline = True  # type: ignore[attr-defined]
    return function


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Mark what every fixed step needs: no call there, whoever else calls it."""
    function.inlined = True  # type: ignore[attr-defined]
    return function


def _part(function: Callable[P, R], options: dict[str, Any]) -> Callable[P, R]:
    compiled: Any = _compiled(function, options)
    is_compiled = isinstance(compiled, CPUDispatcher)
    if is_compiled:  # with NUMBA_DISABLE_JIT it is the function itself
        compiled.__class__ = Equation
    if is_compiled and isinstance(compiled._cache, FunctionCache):
        compiled._cache = CACHE_OF_PARTS(function)
        _read_own_index(compiled)
    made: Callable[P, R] = compiled
    return made


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A function that Python calls."""
    compiled: Callable[P, R] = _compiled(function, OPTIONS)
    return compiled


def rows(function: Callable[P, R]) -> Callable[P, R]:
    """A loop over the rows of a log: other threads go on meanwhile."""
    compiled: Callable[P, R] = _compiled(function, OPTIONS | {"nogil": True})
    return compiled


def cached(**options: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Numba's ``njit`` with other options than those above, kept where there is a place."""

    def compiled(function: Callable[P, R]) -> Callable[P, R]:
        found: Callable[P, R] = _compiled(function, KEPT | options)
        return found

    return compiled


def _compiled(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """The function by numba; without its cache where no place of it can be written to."""
    try:
        compiled = njit(**options)(function)
        _read_own_index(compiled)
        return compiled
    except RuntimeError as error:
        if "locator" not in str(error):
            raise
    _say_without_cache()
    return njit(**options | {"cache": False})(function)


def _read_own_index(compiled: Any) -> None:
    """What was kept by another version of cellwise, or cut off, is not there: it is made again.

    Numba reads the types of an index before it looks whether the index is of this source, and a
    type may have moved.
    """
    file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if file is None:
        return
    load = file._load_index

    def load_index() -> dict[Any, Any]:
        try:
            found: dict[Any, Any] = load()
        except (ImportError, AttributeError, EOFError, TypeError, ValueError, UnpicklingError):
            return {}
        return found

    file._load_index = load_index


@lru_cache(maxsize=1)
def _say_without_cache() -> None:
    """Once, on standard error."""
    if not os.environ.get(QUIET):
        sys.stderr.write(
            "no place to keep compiled kernels (read-only installation, no home): every start "
            "compiles again; NUMBA_CACHE_DIR names a folder for them\n"
        )


class _Shared:
    """The memory of an array, as one that may be written to."""

    def __init__(self, array: NDArray[Any]) -> None:
        self.owner = array
        address, _ = array.__array_interface__["data"]
        self.__array_interface__ = {**array.__array_interface__, "data": (address, False)}


def for_kernel(array: FloatArray) -> FloatArray:
    """The same memory as the one kind of array that kernels are compiled for; nothing is copied.

    A log's channels are read-only, which numba takes for another type. Only for kernels that do not
    write to it.
    """
    if not array.flags.c_contiguous:
        return np.array(array)
    return array if array.flags.writeable else np.asarray(_Shared(array))


def announce(function: Any, what: str) -> None:
    """Say on standard error that ``what`` is compiled now, where it was not compiled before.

    The first call in a new environment takes seconds: nobody should have to guess why. While
    another process compiles (:mod:`cellwise.first_use`), what it makes is waited for.
    """
    if getattr(function, "overloads", None) or os.environ.get(QUIET) or is_compiled(function):
        return
    sys.stderr.write(f"compiling {what} for this machine, once: some seconds\n")
    sys.stderr.flush()
    while function.__name__ in _in_work() and not is_compiled(function):
        time.sleep(0.1)


def is_compiled(function: Any) -> bool:
    """Whether numba's cache holds a kernel."""
    try:
        return bool(function._cache._cache_file._load_index())
    except (AttributeError, OSError):  # not numba's, or without a cache
        return not hasattr(function, "overloads")


def keeps_compiled(function: Any) -> bool:
    """Whether there is a place where a kernel is kept."""
    return hasattr(function, "_cache") and function._cache.cache_path is not None


def others_compile() -> Path:
    """A file that is there while another process compiles for the same place: what is worth it."""
    place = f"{sys.prefix} {os.environ.get('NUMBA_CACHE_DIR', '')} {Path(__file__).parent}"
    mark = hashlib.sha256(place.encode()).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"cellwise-compiles-{mark}"


def _in_work() -> list[str]:
    """Names of the kernels that it makes and a command waits for; none of one that was killed."""
    mark = others_compile()
    try:
        young = time.time() - mark.stat().st_mtime < LONGEST_S
        return mark.read_text(encoding="utf-8").split() if young else []
    except OSError:
        return []
