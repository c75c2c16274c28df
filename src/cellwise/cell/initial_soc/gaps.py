"""A log with pauses that nobody counted: begun again after each."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.sizes import check_log_of
from cellwise.cell.plausibility.validity import check_cells_in_series
from cellwise.cell.simulate import Simulation
from cellwise.cell.simulate import simulate as simulate_from
from cellwise.logs.cell_log import CellLog
from cellwise.logs.gaps import uncounted_pauses
from cellwise.notices import Code, Notice

FEWEST_VOLTAGES = 3  # fewer say nothing of where a stretch begins


class LogSegment(NamedTuple):
    """Rows ``first`` to ``stop`` (not included) of a log, and where they begin."""

    first: int
    stop: int
    start: InitialSoc

    def of(self, log: CellLog) -> CellLog:
        """The rows as a log."""
        whole = self.first == 0 and self.stop == len(log)
        return log if whole else log.part(self.first, self.stop)


def stretches(model: CellModel, log: CellLog, start: InitialSoc) -> tuple[LogSegment, ...]:
    """A log cut at the pauses that nobody counted: a car may have been charged meanwhile.

    What is too short to say where it begins stays with what lies before; a first row that stands
    alone with what lies behind, which says where the log begins.

    Parameters
    ----------
    start : InitialSoc      of the log's first row
    """
    found = [LogSegment(0, len(log), start)]
    for row, stop in pairwise((*uncounted_pauses(log), len(log))):
        measured = np.isfinite(log.voltage_V[row:stop])
        if np.count_nonzero(measured) < FEWEST_VOLTAGES or np.isnan(log.current_A[row:stop]).all():
            continue
        begun = initial_soc(model, log.part(row, stop), whole_log=True)
        before = found[-1]._replace(stop=row)
        alone = row - before.first < 2 or not np.isfinite(log.voltage_V[before.first : row]).any()
        found[-1:] = (
            [LogSegment(before.first, len(log), begun)]
            if alone
            else [before, LogSegment(row, len(log), begun)]
        )
    return tuple(found)


def simulate_stretches(
    model: CellModel, log: CellLog, start: InitialSoc, h0: float | None = None
) -> Simulation:
    """A log simulated from ``start``, and from a start of its own after each such pause."""
    parts = stretches(model, log, start)
    first, *later = [
        simulate_from(model, part.of(log), part.start.soc, h0 if part.first == 0 else None)
        for part in parts
    ]
    if not later:
        return first
    said = (_begun_again(log, p) for p in parts[1:])
    return replace(
        first,
        log=log.with_notices((*log.notices, *said)),
        voltage_V=np.concatenate([one.voltage_V for one in (first, *later)]),
        soc=np.concatenate([one.soc for one in (first, *later)]),
    )


def _begun_again(log: CellLog, part: LogSegment) -> Notice:
    """That a simulation begins again behind a pause."""
    text = (
        f"nobody counted in the pause before {log.time_s[part.first]:.0f} s: there the simulation "
        f"begins again, at SOC {part.start.soc:.3f} +- {2 * part.start.std:.3f}"
    )
    return Notice(Code.PAUSE_NOT_COUNTED, text, rows=range(part.first, part.first + 1))


def simulate(
    model: CellModel, log: CellLog, soc0: float | None = None, h0: float | None = None
) -> Simulation:
    """Simulate the terminal voltage of a log from a cell at rest at ``soc0``.

    Exact for constant current within each interval, at any time step. Over gaps the current is
    what :meth:`CellLog.known_current_A` says (the counter's charge, else a rest); after a pause of
    minutes without a counter the simulation begins again, and a notice says so.

    Parameters
    ----------
    model : CellModel
    log : CellLog
    soc0 : float or None  SOC at the first row, 0..1; None: as ``cellwise simulate`` finds it (the
                          log's stated start, a rest at its beginning, or a fit of the log)
    h0 : float or None    hysteresis state at the first row, -1 (after a discharge) to 1 (after a
                          charge); None: +1 from the upper half of SOC, -1 from the lower

    Returns
    -------
    Simulation            its ``soc0`` is the start taken

    Raises
    ------
    InputError            soc0 outside 0..1; without a start, a pack read as one cell
    """
    check_log_of(model, log)
    if soc0 is None:
        check_cells_in_series(model, log)
    return simulate_stretches(model, log, initial_soc(model, log, soc0, whole_log=True), h0)
