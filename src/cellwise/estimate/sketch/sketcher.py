"""The sketch that a target keeps, in Python: the bits of the C."""

from __future__ import annotations

import zlib
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import known_start
from cellwise.estimate.fixed.fixed_step import (
    BesideStep,
    median_interval_s,
    one_record,
    samples_of,
)
from cellwise.estimate.fixed.layout import sketch_type
from cellwise.estimate.fixed.stepper import start_state
from cellwise.estimate.sketch.stored import empty_sketch, read_sums, sealed
from cellwise.logs.cell_log import CellLog

KNOWN = 0.01  # deviation of a SOC that is stated


class Sketcher(BesideStep):
    """A sketch beside a fixed step, over logs as a target sees them.

    Parameters
    ----------
    filter_ : FixedStep      made with ``sketch=1024``, or as many bytes; `Firmware` for the C

    Raises
    ------
    InputError        a filter without it
    """

    part = "sketch"

    def begin(self, unit: int = 0, dt_s: float = 1.0) -> NDArray[Any]:
        """A sketch of the target with that number, in which nothing is summed."""
        return empty_sketch(self.stepper(dt_s), unit)

    def resumed(self, block: bytes) -> NDArray[Any]:
        """The sketch that `bytes_of` gave, to go on with.

        Raises
        ------
        InputError        damaged bytes; of other tables than this filter's
        """
        stepper = self.stepper()
        kind = sketch_type(stepper.tables.options)
        of_these = read_sums(block).model_crc == zlib.crc32(stepper.tables.to_bytes())
        if not of_these or len(block) != kind.itemsize:
            raise InputError(
                "a sketch of another model, period or size",
                "one of the same target",
                "Go on with its own, or begin a new one.",
            )
        return np.frombuffer(block, kind).copy()

    def run(
        self, log: CellLog, soc0: float | None = None, sketch: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """Step a log from a SOC that is known; a ``sketch`` goes on from an earlier one, in place.

        The log begins after a rest: a sketch of a log before goes on with a new simulation.

        Raises
        ------
        InputError        no SOC at the start; a sketch of another type
        """
        soc0 = known_start(log, soc0)
        dt_s = median_interval_s(log) if self.filter.dt_s is None else self.filter.dt_s
        stepper = self.stepper(dt_s)
        kind = sketch_type(stepper.tables.options)
        sketch = empty_sketch(stepper) if sketch is None else one_record(sketch, kind)
        samples = samples_of(self.filter.model, log, dt_s).records
        samples["sequence"] += sketch["sequence"][0] + np.uint32(2)  # a gap: it was switched off
        stepper.rows_beside("sketch_rows", start_state(stepper, soc0, KNOWN), sketch, samples)
        return sketch

    def bytes_of(self, sketch: NDArray[Any], dt_s: float = 1.0) -> bytes:
        """What a target gives when it is read out."""
        return sealed(sketch, self.stepper(dt_s).tables)


def means_of(log: CellLog, dt_s: float) -> CellLog:
    """Means of current, voltage and temperature over each period, as a target averages them."""
    if np.median(log.interval_s[1:]) > 0.75 * dt_s:
        return log
    period = np.floor((log.time_s - log.time_s[0]) / dt_s)
    first = np.flatnonzero(np.diff(period, prepend=-1.0))
    count = np.diff(first, append=len(log))

    def mean(values: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(np.add.reduceat(values, first) / count)

    warm = None if log.temperature_C is None else mean(log.temperature_C)
    return replace(
        log,
        time_s=(period[first] - period[0]) * dt_s,
        current_A=mean(log.interval_current_A),
        voltage_V=mean(log.voltage_V),
        temperature_C=warm,
        charge_Ah=None,
        step=None,
        current_meaning="interval_end",
    )
