"""The capacity that a target estimates, in Python: the bits of the C."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.arguments import shown
from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import known_start
from cellwise.estimate.fixed.fixed_step import FixedStep, median_interval_s, samples_of
from cellwise.estimate.fixed.layout import SOH
from cellwise.estimate.fixed.stepper import Stepper, start_state
from cellwise.logs.cell_log import CellLog


class EstimatedSoh(NamedTuple):
    """Share of the model's capacity that is left and scale of its resistances, with deviations.

    ``pairs`` of rests and ``loads`` after a rest say so. As the current sensor counts it: one that
    shows too much shows too much capacity and too little resistance.
    """

    share: float
    share_std: float
    pairs: int
    resistance: float
    resistance_std: float
    loads: int

    @classmethod
    def of(cls, record: NDArray[Any]) -> EstimatedSoh:
        """Of a record that a target has kept, or of :meth:`SohEstimator.begin`."""
        one = record[0]
        share_std, resistance_std = (
            float(np.sqrt(one[f"{name}_variance"])) for name in ("share", "resistance")
        )
        return cls(
            float(one["share"]), share_std, int(one["pairs"]),
            float(one["resistance"]), resistance_std, int(one["loads"]),
        )  # fmt: skip


class SohEstimator:
    """The estimate beside a fixed step, over logs as a target sees them.

    Parameters
    ----------
    filter_ : FixedStep      made with ``soh=True``; `Firmware` for the C

    Raises
    ------
    InputError        a filter without it
    """

    def __init__(self, filter_: FixedStep) -> None:
        if not isinstance(filter_, FixedStep):
            raise InputError(
                f"{shown(filter_)} as a filter",
                "a FixedStep or Firmware with soh",
                "Make it with FixedStep(model, soh=True).",
            )
        self.filter = filter_
        self._of(1.0 if filter_.dt_s is None else filter_.dt_s)

    def begin(self) -> NDArray[Any]:
        """A record that knows nothing yet."""
        record = np.zeros(1, dtype=SOH)
        self._of(1.0 if self.filter.dt_s is None else self.filter.dt_s).call("start_soh", record)
        return record

    def run(
        self, log: CellLog, soc0: float | None = None, record: NDArray[Any] | None = None
    ) -> EstimatedSoh:
        """Step a log and estimate; a ``record`` goes on from an earlier one, in place.

        Raises
        ------
        InputError        no SOC at the start; a record of another type
        """
        soc0 = known_start(log, soc0)
        dt_s = median_interval_s(log) if self.filter.dt_s is None else self.filter.dt_s
        stepper = self._of(dt_s)
        if record is None:
            record = self.begin()
        elif not (isinstance(record, np.ndarray) and record.dtype == SOH and record.shape == (1,)):
            raise InputError(
                f"record = {shown(record)}", "one record, as begin() gives it", "Pass on its own."
            )
        samples = samples_of(self.filter.model, log, dt_s).records
        stepper.soh_rows(start_state(stepper, soc0, 0.15), record, samples)
        return EstimatedSoh.of(record)

    def _of(self, dt_s: float) -> Stepper:
        return self.filter.stepper(dt_s).need("soh")
