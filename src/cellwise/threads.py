"""One thread of the linear algebra library at a time: the matrices are small, the logs many.

Logs run side by side in threads of their own. OpenBLAS then starts as many again in each, which
wait for each other in busy loops: on two cores a refinement took three to five times as long.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """A function during which the linear algebra library has one thread; then as before.

    Of calls in several threads the one that limited first restores: others only get slower then.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
