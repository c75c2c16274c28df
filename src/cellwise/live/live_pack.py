"""The cells of a pack in a stream: stepped at a fixed interval beside the stream's own filter."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.cells.fixed_pack import FixedPack, PackState
from cellwise.estimate.cells.settings import CellSettings
from cellwise.estimate.filters.filter_state import EkfInfo
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.layout import CELL
from cellwise.estimate.noise import Noise
from cellwise.live.sample import Sample

DT_S = 1.0
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
        step = FixedStep(model, noise, dt_s=DT_S, cells=CellSettings())
        self._pack = FixedPack(step, cells)
        self._state: PackState | None = None
        self._kept: np.ndarray[Any, Any] | None = None
        self._sequence = 0
        self._begun_s = math.nan
        self._charge_As = self._since_s = 0.0
        self._warm_up()

    def take(self, sample: Sample, info: EkfInfo, dt_s: float, temperature_C: float) -> None:
        """A sample after the stream's filter has taken it; steps when a second has passed."""
        if self._state is None:
            self._state = self._pack.init(info.soc, min(max(info.soc_std, 1e-3), WIDEST_STD))
            if self._kept is not None:
                self._state = self._state._replace(cells=self._kept)
            self._begun_s = sample.time_s - DT_S * self._sequence
        if math.isfinite(sample.current_A):
            self._charge_As += sample.current_A * dt_s
            self._since_s += dt_s
        sequence = round((sample.time_s - self._begun_s) / DT_S)
        if sequence <= self._sequence and self._since_s < DT_S and dt_s > 0.0:
            return
        current = self._charge_As / self._since_s if self._since_s > 0.0 else sample.current_A
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
        """What outlives the program: the cells' differences and the count of time steps."""
        cells = self._kept if self._state is None else self._state.cells
        rows = [] if cells is None else [[v.item() for v in row] for row in cells]
        return {"cells": rows, "sequence": self._sequence}

    def resume(self, saved: Any, passed_s: float) -> None:
        """Take up what was put away; the time between is counted on.

        Raises
        ------
        InputError        of another pack
        """
        try:
            rows = [tuple(row) for row in saved["cells"]]
            cells = np.array(rows, dtype=CELL)
            sequence = int(saved["sequence"])
        except (TypeError, ValueError, KeyError, OverflowError) as error:
            raise InputError(
                f"a saved state whose cells cannot be read ({error})",
                "one that cellwise live wrote with the same number of cells",
                "Start afresh, or name another file.",
            ) from None
        if rows and len(rows) != self._pack.count:
            raise InputError(
                f"a saved state of {len(rows)} cells for a pack of {self._pack.count}",
                "one of the same pack",
                "Start afresh, or name another file.",
            )
        self._kept = cells if rows else None
        self._sequence = sequence + round(max(passed_s, 0.0) / DT_S)

    def _warm_up(self) -> None:
        """Compile before the first sample waits for it."""
        state = self._pack.init(0.5)
        self._pack.step(state, 0.0, np.full(self._pack.count, np.nan), sequence=0)
        self._pack.cells(state)
