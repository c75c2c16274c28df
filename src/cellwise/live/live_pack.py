"""The cells of a pack in a stream: stepped at a fixed interval beside the stream's own filter."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.cells.fixed_pack import FixedPack, PackState
from cellwise.estimate.cells.settings import CellSettings
from cellwise.estimate.filters.filter_state import EkfInfo
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.layout import CELL
from cellwise.estimate.noise import Noise
from cellwise.live.samples import Sample

SHORTEST_S, LONGEST_S = 1.0, 60.0  # time step, as the stream's samples come
WIDEST_STD = 0.3


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
        self._state: PackState | None = None
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
        found = self._pack.cells(self._state)
        return {
            "cells": {
                "soc": found["soc"].tolist(),
                "soc_std": np.sqrt(found["soc_variance"]).tolist(),
                "capacity_share": found["capacity_share"].tolist(),
                "capacity_std": np.sqrt(found["capacity_variance"]).tolist(),
                "resistance_scale": found["resistance_scale"].tolist(),
                "resistance_std": np.sqrt(found["resistance_variance"]).tolist(),
            }
        }

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
