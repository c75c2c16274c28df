"""What an estimator made of a log, row by row."""

from __future__ import annotations

from dataclasses import dataclass

from cellwise.typing import FloatArray, IntArray


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """Every array has shape (rows,).

    ``voltage_V`` is the voltage predicted before the row's own voltage was used; ``innovation_V``
    is measured minus predicted, ``innovation_variance_V2`` its variance, ``test_ratio`` its square
    over gate squared times variance; ``status`` are the bits of
    :class:`cellwise.estimate.status.Status`. Figures that an estimator does not have are NaN.
    """

    time_s: FloatArray
    soc: FloatArray
    soc_std: FloatArray
    voltage_V: FloatArray
    innovation_V: FloatArray
    innovation_variance_V2: FloatArray
    test_ratio: FloatArray
    status: IntArray

    def __len__(self) -> int:
        return self.time_s.size

    def __repr__(self) -> str:
        return f"Trace({len(self)} rows, final SOC {self.soc[-1]:.4f} +- {self.soc_std[-1]:.4f})"
