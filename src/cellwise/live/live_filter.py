"""A filter over a stream, a pack's cells beside it: stamps to intervals, steps, saved state."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.arguments import check_kind, choice, number
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.model_file import model_mark
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.errors import InputError
from cellwise.estimate.filters.filter_state import EkfInfo, EkfState
from cellwise.estimate.filters.kalman import Ekf, KalmanFilter, Ukf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.layout import CELL
from cellwise.estimate.fixed.options import CellSettings
from cellwise.estimate.fixed_pack import FixedPack, FixedPackState
from cellwise.estimate.noise import Noise
from cellwise.estimate.saved_state import read_saved, state_from_dict, state_to_dict
from cellwise.files import write_atomically
from cellwise.live.samples import Sample
from cellwise.logs.cell_log import CellLog
from cellwise.logs.gaps import GAP_BESIDE, GAP_TIMES, LEAST_GAP_S, NEIGHBOURS

SHORTEST_S, LONGEST_S = 1.0, 60.0  # time step, as the stream's samples come
WIDEST_STD = 0.3
# A jump further than this is a broken stamp until more samples say the same.
JUMP_S = 3600.0
AGREEING = 5
# What is said of a pack's cells, and what its deviation is called.
SHOWN = {"soc": "soc", "capacity_share": "capacity", "resistance_scale": "resistance"}


class SampleInterval(NamedTuple):
    """The interval that ends at a sample, and whether its current is unknown."""

    dt_s: float
    gap: bool


class Timeline:
    """Takes stamps in the order in which samples come.

    A gap is what :func:`cellwise.logs.gaps.find_gaps` calls one, detected from the past alone. A
    sample that is older than the one before comes late and is left out. A stamp that jumps back, or
    forward by more than an hour, is left out until five samples in a row go on from there: then
    the sender's clock was set, and what has passed is what this machine's clock says.
    """

    def __init__(self) -> None:
        self.time_s = math.nan
        self._arrived_s = math.nan
        self._intervals: deque[float] = deque(maxlen=NEIGHBOURS)
        self._strange: deque[float] = deque(maxlen=AGREEING)
        self._away_s: float | None = None

    def resume(self, away_s: float) -> None:
        """Make the next sample end a gap of this length, as after a restart."""
        self._away_s = max(away_s, 0.0)

    def advance(self, time_s: float, arrived_s: float = math.nan) -> SampleInterval | None:
        """The interval that a stamp ends, or None for a sample to leave out.

        Parameters
        ----------
        time_s : float        stamp of the sample [s]
        arrived_s : float     when it came, by this machine's clock [s]
        """
        if not math.isfinite(time_s):
            return None
        if math.isnan(self.time_s):
            away, self._away_s = self._away_s, None
            self._accept(time_s, arrived_s)
            return (
                SampleInterval(0.0, gap=False) if away is None else SampleInterval(away, gap=True)
            )
        dt = time_s - self.time_s
        if dt < 0.0 or dt > JUMP_S:
            if not self._clock_was_set(time_s):
                return None
            passed = arrived_s - self._arrived_s
            away = passed if passed > 0.0 else max(dt, 0.0)
            self._accept(time_s, arrived_s)
            self._intervals.clear()
            return SampleInterval(away, gap=True)
        gap = self._is_gap(dt)
        self._accept(time_s, arrived_s)
        if dt > 0.0:
            self._intervals.append(dt)
        return SampleInterval(dt, gap)

    def _accept(self, time_s: float, arrived_s: float) -> None:
        self.time_s = time_s
        self._arrived_s = arrived_s
        self._strange.clear()

    def _clock_was_set(self, time_s: float) -> bool:
        """Whether enough samples in a row go on from a strange stamp."""
        strange = self._strange
        if strange and not 0.0 < time_s - strange[-1] <= JUMP_S:
            strange.clear()
        strange.append(time_s)
        return len(strange) == AGREEING

    def _is_gap(self, dt: float) -> bool:
        if dt <= LEAST_GAP_S or not self._intervals:
            return False
        longest = sorted(self._intervals)
        usual = longest[-2] if len(longest) >= 3 else longest[-1]
        return dt > GAP_TIMES * usual and dt > GAP_BESIDE * self._intervals[-1]


class LivePack:
    """Differences of a pack's cells from their mean cell, as a target with ``--cells`` has them.

    Parameters
    ----------
    model : CellModel       of the mean cell
    cells : int             in series
    noise : Noise or None   of the mean cell's filter
    """

    def __init__(self, model: CellModel, cells: int, noise: Noise | None = None) -> None:
        self._model, self._cells, self._noise = model, cells, noise
        self._pack = self._stepped_by(SHORTEST_S)
        self._state: FixedPackState | None = None
        self._kept: NDArray[Any] | None = None
        self._kept_s = self._passed_s = 0.0
        self._sequence = 0
        self._begun_s = math.nan
        self._charge_As = self._since_s = 0.0
        self._warm_up()

    def take(self, sample: Sample, info: EkfInfo, dt_s: float, temperature_C: float) -> None:
        """A sample after the stream's filter has taken it; steps when a time step has passed.

        The time step is the stream's first interval, at least a second.
        """
        if self._state is None:
            if not dt_s > 0.0:
                return
            self._begin(sample, info, min(max(dt_s, SHORTEST_S), LONGEST_S))
        if math.isfinite(sample.current_A):
            self._charge_As += sample.current_A * dt_s
            self._since_s += dt_s
        sequence = round((sample.time_s - self._begun_s) / self._pack.filter.known_dt_s)
        if self._state is None or sequence <= self._sequence:
            return
        current = self._charge_As / self._since_s if self._since_s > 0.0 else math.nan
        self._pack.step(
            self._state,
            current,
            sample.cell_V,
            temperature_C if math.isfinite(temperature_C) else None,
            sequence=sequence,
        )
        self._sequence, self._charge_As, self._since_s = sequence, 0.0, 0.0

    def columns(self) -> dict[str, Any]:
        """What is known of every cell, as values for JSON: one list each, cells in order."""
        if self._state is None:
            return {}
        found, shown = self._pack.cells(self._state), {}
        for value, stem in SHOWN.items():
            shown[value] = found[value].tolist()
            shown[f"{stem}_std"] = np.sqrt(found[f"{stem}_variance"]).tolist()
        return {"cells": shown}

    def to_dict(self) -> dict[str, Any]:
        """What outlives the program: the cells' differences and for how long they were followed."""
        cells, seconds = self._kept, self._kept_s
        if self._state is not None:
            cells = self._state.cells
            seconds = self._sequence * self._pack.filter.known_dt_s
        rows = [] if cells is None else [[v.item() for v in row] for row in cells]
        return {"cells": rows, "seconds": seconds}

    def resume(self, saved: Any, passed_s: float) -> None:
        """Take up what was put away; the cells have drifted apart in the time between.

        Raises
        ------
        InputError        of another pack
        """
        try:
            cells = np.array([tuple(row) for row in saved["cells"]], dtype=CELL)
            seconds = float(saved["seconds"])
        except (TypeError, ValueError, KeyError, OverflowError) as error:
            raise InputError(
                f"a saved state whose cells cannot be read ({error})",
                "one that cellwise live wrote with the same number of cells",
                "Start afresh, or name another file.",
            ) from None
        if cells.size not in (0, self._cells):
            raise InputError(
                f"a saved state of {cells.size} cells for a pack of {self._cells}",
                "one of the same pack",
                "Start afresh, or name another file.",
            )
        if cells.size and math.isfinite(seconds) and seconds >= 0.0:
            self._kept, self._kept_s, self._passed_s = cells, seconds, max(passed_s, 0.0)

    def _begin(self, sample: Sample, info: EkfInfo, dt_s: float) -> None:
        self._pack = self._stepped_by(dt_s)
        self._state = self._pack.init(info.soc, min(max(info.soc_std, 1e-3), WIDEST_STD))
        if self._kept is not None:
            cells = self._kept.copy()
            cells["seen_at"] = int(self._kept_s / dt_s) % 2**32
            self._state = self._state._replace(cells=cells)
        self._sequence = int((self._kept_s + self._passed_s) / dt_s)
        self._begun_s = sample.time_s - dt_s * (self._sequence + 1)

    def _stepped_by(self, dt_s: float) -> FixedPack:
        step = FixedStep(self._model, self._noise, dt_s=dt_s, cells=CellSettings())
        return FixedPack(step, self._cells)

    def _warm_up(self) -> None:
        """Compile before the first sample waits for it."""
        state = self._pack.init(0.5)
        self._pack.step(state, 0.0, np.full(self._pack.count, np.nan), sequence=0)
        self._pack.cells(state)


ESTIMATORS: Mapping[str, type[KalmanFilter]] = {"ekf": Ekf, "ukf": Ukf}


class Update(NamedTuple):
    """What one sample has made of the state."""

    sample: Sample
    info: EkfInfo
    dt_s: float
    gap: bool


class LiveFilter:
    """An EKF or UKF that is fed sample by sample and can be put away and taken up again.

    Without ``soc0`` the first sample with current and voltage gives the initial SOC, with a
    consistent deviation: at rest by the OCV, under load by the model.

    Parameters
    ----------
    model : CellModel
    estimator : str           ``ekf`` or ``ukf``
    soc0 : float or None      SOC at the first sample, 0..1
    soc0_std : float or None  its deviation; None: 0.15 where ``soc0`` is given
    noise : Noise or None     None: from the model's own validation error
    temperature_C : float     of the cell where a sample measured none [degC]; NaN: not known
    cells : int               follow so many cells of a pack beside their mean cell; 0: none

    Raises
    ------
    InputError                another estimator; soc0 outside 0..1
    """

    def __init__(
        self,
        model: CellModel,
        estimator: str = "ekf",
        soc0: float | None = None,
        *,
        soc0_std: float | None = None,
        noise: Noise | None = None,
        temperature_C: float = math.nan,
        cells: int = 0,
    ) -> None:
        check_is_model(model)
        estimator = choice("estimator of a stream", estimator, tuple(ESTIMATORS))
        self.model = model
        self.temperature_C = temperature_C
        self.filter = ESTIMATORS[estimator](model, noise)
        self.state: EkfState | None = None
        self.start: InitialSoc | None = None
        self.timeline = Timeline()
        self.pack = LivePack(model, cells, noise) if cells else None
        if soc0 is not None:
            self.start = initial_soc(model, _moment(0.0, 1.0), soc0)
        if soc0_std is not None and self.start is not None:
            self.start = InitialSoc(self.start.soc, soc0_std, self.start.how)
        self._warm_up()

    def take(self, sample: Sample) -> Update | None:
        """One step; None for a sample that comes late or that nothing can be begun with.

        Raises
        ------
        InputError        no `Sample`, or one of something else than numbers
        """
        sample = _checked(sample)
        begun = self.state
        if begun is None:
            begun = self._begin(sample)
            if begun is None:
                return None
        interval = self.timeline.advance(sample.time_s, sample.arrived_s)
        if interval is None:
            return None
        self.state, info = self.filter.step(
            begun,
            sample.current_A,
            sample.voltage_V,
            self.known_temperature_C(sample),
            dt_s=interval.dt_s,
            gap=interval.gap,
        )
        if self.pack is not None:
            self.pack.take(sample, info, interval.dt_s, self.known_temperature_C(sample))
        return Update(sample, info, interval.dt_s, interval.gap)

    def known_temperature_C(self, sample: Sample) -> float:
        """Temperature of a sample [degC]: measured, else stated; NaN where neither is known."""
        return sample.temperature_C if math.isfinite(sample.temperature_C) else self.temperature_C

    def save(self, path: Path | str, now_s: float) -> None:
        """Put the state away; ``now_s`` is the clock of the day [s]. Whole or not at all."""
        if self.state is None:
            return
        saved = state_to_dict(self.state, self.filter.name)
        saved["live"] = {"saved_s": now_s, "model": model_mark(self.model)}
        if self.pack is not None:
            saved["pack"] = self.pack.to_dict()
        write_atomically(path, json.dumps(saved, allow_nan=False))

    def resume(self, path: Path | str, now_s: float) -> bool:
        """Take up a state that was put away; the next sample ends a gap of the time between.

        Returns
        -------
        bool              False where there is no file yet, or an empty one after a loss of power

        Raises
        ------
        InputError        a file that is no such state, or one of another model or estimator
        """
        place = Path(path)
        if not place.exists() or (place.is_file() and place.stat().st_size == 0):
            return False
        saved = read_saved(place)
        state = state_from_dict(saved, self.filter.name)
        live = saved.get("live")
        live = live if isinstance(live, Mapping) else {}
        saved_s = live.get("saved_s")
        if not isinstance(saved_s, (int, float)) or live.get("model") != model_mark(self.model):
            raise InputError(
                f"a state in '{place}' that another model or program wrote",
                "a state of this model",
                "Start afresh, or name another file.",
            )
        if self.pack is not None and "pack" in saved:
            self.pack.resume(saved["pack"], now_s - float(saved_s))
        self.state = state
        self.start = InitialSoc(state.soc, state.soc_std, "saved state")
        self.timeline.resume(now_s - float(saved_s))
        return True

    def _begin(self, sample: Sample) -> EkfState | None:
        if not math.isfinite(sample.time_s):
            return None
        if self.start is None:
            noise = self.filter.noise
            possible = noise.voltage_low_V <= sample.voltage_V <= noise.voltage_high_V
            if not (possible and abs(sample.current_A) <= noise.current_limit_A):
                return None
            moment = _moment(sample.current_A, sample.voltage_V)
            temperature = self.known_temperature_C(sample)
            if math.isfinite(temperature):
                moment = replace(moment, temperature_C=np.full(2, temperature))
            self.start = initial_soc(self.model, moment)
        return self.filter.init(self.start.soc, self.start.std)

    def _warm_up(self) -> None:
        """Compile, or load what was compiled, before the first sample waits for it."""
        voltage = float(np.median(self.model.ocv_V))
        state = self.filter.init(0.5, 0.1)
        self.filter.step(state, 0.0, voltage, dt_s=1.0)
        for current_A in (0.0, self.model.capacity_Ah):
            initial_soc(self.model, _moment(current_A, voltage))


def _moment(current_A: float, voltage_V: float) -> CellLog:
    """A log of one moment, repeated: a log has two rows."""
    return CellLog(np.zeros(2), np.full(2, current_A), np.full(2, voltage_V))


def _checked(sample: Sample) -> Sample:
    """A sample of numbers."""
    check_kind("sample", sample, Sample, "Write Sample(time_s, current_A, voltage_V).")
    for name, value in zip(MEASURED, sample[: len(MEASURED)], strict=True):
        number(name, value, "a number, nan where it is missing")
    return sample


MEASURED = Sample._fields[:4]
