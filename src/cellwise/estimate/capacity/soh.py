"""The capacity that a target estimates, in Python: the bits of the C."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.estimate.filters.kalman import known_start
from cellwise.estimate.fixed.fixed_step import (
    BesideStep,
    median_interval_s,
    one_record,
    samples_of,
)
from cellwise.estimate.fixed.layout import SOH
from cellwise.estimate.fixed.stepper import start_state
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


class SohEstimator(BesideStep):
    """The estimate beside a fixed step, over logs as a target sees them.

    Parameters
    ----------
    filter_ : FixedStep      made with ``soh=True``; `Firmware` for the C

    Raises
    ------
    InputError        a filter without it
    """

    part = "soh"

    def begin(self) -> NDArray[Any]:
        """A record that knows nothing yet."""
        record = np.zeros(1, dtype=SOH)
        self.stepper().call("start_soh", record)
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
        stepper = self.stepper(dt_s)
        record = self.begin() if record is None else one_record(record, SOH)
        samples = samples_of(self.filter.model, log, dt_s).records
        stepper.rows_beside("soh_rows", start_state(stepper, soc0, 0.15), record, samples)
        return EstimatedSoh.of(record)
