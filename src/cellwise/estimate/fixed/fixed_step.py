"""The embedded filter in Python: float32 at a fixed time step, bit for bit what the C computes."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellwise.arguments import shown
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.cell.simulate import known_temperature_C
from cellwise.errors import InputError
from cellwise.estimate.filters.filter_state import EkfInfo
from cellwise.estimate.filters.kalman import check_components, known_start, one_reading
from cellwise.estimate.fixed.layout import CAPABILITY, INPUT, OUTLOOK, PHASE, PLAN_RESULT
from cellwise.estimate.fixed.options import Asked, CellSettings
from cellwise.estimate.fixed.stepper import (
    MADE_WITH,
    Stepper,
    check_record,
    info_of,
    numba_stepper,
    sequence_number,
    start_state,
)
from cellwise.estimate.fixed.tables import FixedStepTables, fixed_step_tables
from cellwise.estimate.noise import Noise, noise_for
from cellwise.estimate.status import VOLTAGE_INVALID
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog, resample
from cellwise.typing import IntArray


class FixedStep:
    """Fixed-step EKF, compiled by numba.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None       None: from the model's own validation error
    dt_s : float or None        time step [s]; None: the median interval of the log that is run
    asked                       fields of :class:`~cellwise.estimate.fixed.options.Asked`: an offset
                                of the current, power, remaining time, a history, cells of a pack
    """

    name = "fixed-step"

    def __init__(
        self,
        model: CellModel,
        noise: Noise | None = None,
        *,
        dt_s: float | None = None,
        **asked: Any,
    ) -> None:
        check_is_model(model)
        self.model = model
        self.noise = noise_for(model, noise)
        self.dt_s = dt_s
        self._asked = Asked(**asked)
        check_components(self._asked.components)
        self._stepper: Stepper | None = None
        self._sample = np.zeros(1, dtype=INPUT)
        self.stepper(1.0 if dt_s is None else dt_s)  # refuses now what it would refuse later

    def stepper(self, dt_s: float) -> Stepper:
        """What runs the step at a time step, kept for the next call."""
        if self._stepper is None or self._stepper.tables.dt_s != dt_s:
            tables = fixed_step_tables(self.model, dt_s, self.noise, **vars(self._asked))
            self._stepper = self._make(tables)
        return self._stepper

    def _make(self, tables: FixedStepTables) -> Stepper:
        return numba_stepper(tables)

    def init(self, soc0: float, soc0_std: float = 0.15) -> NDArray[Any]:
        """A state of one record: a cell at rest at ``soc0``, known to ``soc0_std``.

        Raises
        ------
        InputError        soc0 outside 0..1, soc0_std not above zero
        """
        return start_state(self._need_stepper(), soc0, soc0_std)

    def step(
        self,
        state: NDArray[Any],
        current_A: float,
        voltage_V: float,
        temperature_C: float | None = None,
        *,
        sequence: int,
    ) -> EkfInfo:
        """Take the sample of one time step; the state is stepped in place.

        ``sequence`` counts time steps and wraps at 2**32: one that is skipped is a gap, one that
        comes again is a duplicate.

        Raises
        ------
        InputError        a state, a reading or a sequence number of another type
        """
        stepper = self._need_stepper()
        warm = self.temperature_or_usual_C(temperature_C)
        check_record(state, stepper.tables, self.name)
        self._sample[0] = (
            one_reading("current_A", current_A, "ampere"),
            one_reading("voltage_V", voltage_V, "volt"),
            one_reading("temperature_C", warm, "degC"),
            sequence_number(sequence),
        )
        out = stepper.rows(state, self._sample)[0]
        return info_of(out, self.noise)

    def power(self, state: NDArray[Any]) -> NDArray[Any]:
        """State of power of a state: one record of ``layout.CAPABILITY`` [W].

        Raises
        ------
        InputError        no time step; not asked for when this was made
        """
        return self._need_stepper().need("power").answer("power", CAPABILITY, state)

    def remaining(
        self, state: NDArray[Any], load_A: float, hold: Literal["current", "power"] = "current"
    ) -> NDArray[Any]:
        """Time and energy to empty at a load: one record of ``layout.OUTLOOK`` [s, J].

        Parameters
        ----------
        load_A : float    [A]; 0 throughout where no cell carries it
        hold : str        what of it is held constant: its current, or the power it gives now

        Raises
        ------
        InputError        no time step; not asked for when this was made; an unknown ``hold``
        """
        stepper = self._need_stepper().need("remaining")
        _check_hold(hold)
        load = one_reading("load_A", load_A, "ampere")
        return stepper.answer("remaining", OUTLOOK, state, load, hold == "power")

    def plan(
        self,
        state: NDArray[Any],
        phases: ArrayLike,
        hold: Literal["current", "power"] = "power",
        above: float = 0.0,
    ) -> NDArray[Any]:
        """Where a plan of loads ends: one record of ``layout.PLAN_RESULT``.

        Parameters
        ----------
        phases : array (n, 2)    seconds, and power [W] or current [A] of one cell
        hold : str               which of the two
        above : float            SOC to end at or above, 0..1; outside 0 throughout

        Raises
        ------
        InputError        no time step; made without remaining time; an unknown ``hold``
        """
        stepper = self._need_stepper().need("remaining")
        _check_hold(hold)
        pairs = np.ascontiguousarray(phases, dtype=np.float32).reshape(-1, 2).view(PHASE)[:, 0]
        return stepper.answer("plan", PLAN_RESULT, state, pairs, pairs.size, hold == "power", above)

    def set_health(
        self, state: NDArray[Any], capacity_share: float, resistance_scale: float
    ) -> None:
        """What a history says of the cell beside the model; kept in the state.

        Parameters
        ----------
        capacity_share : float       of the model's capacity that is left, 0.1 to 2
        resistance_scale : float     of all resistances since, 0.1 to 20

        Raises
        ------
        InputError        not asked for when this was made; a number outside these
        """
        stepper = self._need_stepper().need("health")
        check_record(state, stepper.tables, self.name)
        share = one_reading("capacity_share", capacity_share, "a share")
        scale = one_reading("resistance_scale", resistance_scale, "a factor")
        if stepper.call("set_health", state, share, scale):
            raise InputError(
                f"capacity_share = {share:g}, resistance_scale = {scale:g}",
                "a share of 0.1 to 2, a scale of 0.1 to 20, a sound state",
                "Give what `cellwise history` says, beside the model's own.",
            )

    def run(self, log: CellLog, soc0: float | None = None, soc0_std: float = 0.15) -> Trace:
        """Replay a whole log at the time step; an uneven log is resampled first.

        Every row shows the last time step that ended at it or before.
        """
        soc0 = known_start(log, soc0)
        dt_s = median_interval_s(log) if self.dt_s is None else self.dt_s
        stepper = self.stepper(dt_s)
        samples = samples_of(self.model, log, dt_s)
        memory = stepper.start_filter(self._asked.components, soc0, soc0_std)
        out = stepper.filter_rows(memory, samples.records)[samples.row_sample]
        variance = out["innovation_variance_V2"].astype(np.float64)
        innovation = out["innovation_V"].astype(np.float64)
        innovation[(out["status"] & VOLTAGE_INVALID) != 0] = np.nan
        return Trace(
            time_s=log.time_s,
            soc=out["soc"].astype(np.float64),
            soc_std=np.sqrt(out["soc_variance"].astype(np.float64)),
            voltage_V=out["voltage_V"].astype(np.float64),
            innovation_V=innovation,
            innovation_variance_V2=variance,
            test_ratio=innovation**2 / (self.noise.gate**2 * variance),
            status=out["status"].astype(np.int32),
        )

    @property
    def cell_settings(self) -> CellSettings | None:
        """How cells of a pack differ, where they are followed."""
        return self._asked.cells

    @property
    def known_dt_s(self) -> float:
        """The time step [s].

        Raises
        ------
        InputError        none was given
        """
        if self.dt_s is None:
            raise InputError(
                "no time step", "dt_s, which the tables hold for", "Give FixedStep(..., dt_s=0.1)."
            )
        return self.dt_s

    def temperature_or_usual_C(self, temperature_C: float | None) -> float:
        """A reading, or without one the model's own temperature [degC]."""
        return self.model.usual_temperature_C if temperature_C is None else temperature_C

    def _need_stepper(self) -> Stepper:
        return self.stepper(self.known_dt_s)


EVEN = 0.02  # intervals that differ by less from the time step need no resampling


class Samples(NamedTuple):
    """A log as a target would see it: records of INPUT, and the sample of every row of the log."""

    records: NDArray[Any]
    row_sample: IntArray


def _check_hold(hold: str) -> None:
    if hold not in ("current", "power"):
        raise InputError(f"hold '{hold}'", "'current' or 'power'", "Choose one.")


def median_interval_s(log: CellLog) -> float:
    """The usual interval between two rows [s]."""
    interval = np.diff(log.time_s)
    return float(np.median(interval[interval > 0])) if np.any(interval > 0) else 1.0


def samples_of(model: CellModel, log: CellLog, dt_s: float) -> Samples:
    """A log as samples at a fixed time step.

    An even log is taken row by row. Any other is resampled between its gaps, charge kept; a gap is
    a jump of the sequence number, as where a target was switched off.
    """
    whole = np.round(log.interval_s / dt_s)
    gaps = log.gap_rows
    even = np.abs(log.interval_s - dt_s) <= EVEN * dt_s
    if np.all(even[1:] | gaps[1:]):
        records = _records(model, log)
        records["sequence"] = np.cumsum(whole).astype(np.uint64).astype(np.uint32)
        return Samples(records, np.arange(len(log), dtype=np.int32))
    edges = [0, *np.flatnonzero(gaps).tolist(), len(log)]
    parts, times = [], []
    for first, last in pairwise(edges):
        piece = log.part(first, last) if last - first > 1 else None
        if piece is not None and piece.duration_s >= dt_s:
            piece = resample(piece, dt_s)
            part, time = _records(model, piece), log.time_s[first] + piece.time_s - piece.time_s[0]
        else:
            alone = slice(first, first + 1)
            part, time = _records(model, log)[alone], log.time_s[alone]
        parts.append(part)
        times.append(time)
    records, time_s = np.concatenate(parts), np.concatenate(times)
    step = np.maximum(np.round((time_s - time_s[0]) / dt_s), 0.0)
    records["sequence"] = step.astype(np.uint64).astype(np.uint32)
    row = np.searchsorted(time_s, log.time_s + 1e-9, side="right") - 1
    return Samples(records, np.maximum(row, 0).astype(np.int32))


def _records(model: CellModel, log: CellLog) -> NDArray[Any]:
    records = np.zeros(len(log), dtype=INPUT)
    records["current_A"] = log.interval_current_A
    records["voltage_V"] = log.voltage_V
    records["temperature_C"] = known_temperature_C(model, log)
    return records


class BesideStep:
    """What is kept beside a fixed step, over logs as a target sees them.

    Parameters
    ----------
    filter_ : FixedStep      made with what ``part`` names; `Firmware` for the C

    Raises
    ------
    InputError        a filter without it
    """

    part: ClassVar[str]  # of MADE_WITH

    def __init__(self, filter_: FixedStep) -> None:
        if not isinstance(filter_, FixedStep):
            what, made = MADE_WITH[self.part]
            raise InputError(
                f"{shown(filter_)} as a filter",
                f"a FixedStep or Firmware with {what}",
                f"Make it with {made.replace('...', 'model')}.",
            )
        self.filter = filter_
        self.stepper()

    def stepper(self, dt_s: float = 1.0) -> Stepper:
        """What runs the step: at the filter's own time step, or at ``dt_s`` where it has none."""
        own_s = self.filter.dt_s
        return self.filter.stepper(dt_s if own_s is None else own_s).need(self.part)


def one_record(record: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    """A record to go on with, checked.

    Raises
    ------
    InputError        another type or number
    """
    if isinstance(record, np.ndarray) and record.dtype == kind and record.shape == (1,):
        return record
    raise InputError(
        f"{shown(record)} to go on with", "one record, as begin() gives it", "Pass on its own."
    )
