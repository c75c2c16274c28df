r"""The exponential of the kernels: a table, multiplications and additions.

.. math:: e^x = 2^{n/N} 2^{r/N}, \qquad x N / \ln 2 = n + r, \quad |r| \le \tfrac12

with n the nearest whole number, 2^(n/N) from a table of N and the series of the rest to its fifth
power. It is part of the kernel that takes it, where the library's is a call that no register
outlives; a loop over many cells takes eight at once. Good to 3e-16 times 1 + abs(x).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import config, types
from numba.extending import intrinsic

from cellwise.cell.compiled import inline

STEPS = 128
TABLE = np.array([2.0 ** (k / STEPS) for k in range(STEPS)])
PER_STEP = STEPS / math.log(2.0)
C1, C2, C3, C4, C5 = (PER_STEP**-k / math.factorial(k) for k in range(1, 6))
TO_WHOLE = 1.5 * 2.0**52  # a small number beside it is a whole one, in the last bits of the sum
LARGEST = 700.0  # the result stays a normal number


def _reads(to: Any, of: Any, llvm: Any) -> Any:
    """A number's bits as another kind of number; compiled code only."""

    def typed(typing: Any, number: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.bitcast(arguments[0], llvm)

        return to(of), build

    return intrinsic(typed)


bits_of: Any = _reads(types.uint64, types.float64, ir.IntType(64))
float_of: Any = _reads(types.float64, types.uint64, ir.DoubleType())


@inline
def exponential(x: float) -> float:
    """e^x for x from -LARGEST to LARGEST; beyond, that of the end."""
    at = min(max(x, -LARGEST), LARGEST) * PER_STEP
    whole = at + TO_WHOLE
    r = at - (whole - TO_WHOLE)
    n = bits_of(whole)
    # The rest of n goes into the exponent.
    power = np.uint64(n >> np.uint64(7)) << np.uint64(52)
    step: float = float_of(bits_of(TABLE[n & np.uint64(STEPS - 1)]) + power)
    r2 = r * r
    return step + step * (r * C1 + r2 * ((C2 + r * C3) + r2 * (C4 + r * C5)))


if config.DISABLE_JIT:  # type: ignore[attr-defined]
    exponential = math.exp  # type: ignore[assignment]
