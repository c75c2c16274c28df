"""A log simulated from where it begins, with stretches behind pauses that nobody counted."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

from cellwise.cell.initial_soc.gaps import simulate_stretches
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation, simulate
from cellwise.logs.cell_log import CellLog
from cellwise.workflows.starts import start_of


class SimulatedLog(NamedTuple):
    """A log simulated, where it was found to begin, and how long the simulation took [s]."""

    simulation: Simulation
    start: InitialSoc
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """JSON values, keys as the command prints them."""
        figures = {**self.simulation.to_dict(), "soc0": self.start.to_dict()}
        return {"log": self.simulation.log.name, **figures, "seconds": self.seconds}


def simulate_from_start(model: CellModel, log: CellLog, soc0: float | None = None) -> SimulatedLog:
    """Simulate a log from its start, and again behind every pause that nobody counted.

    Parameters
    ----------
    soc0 : float or None      SOC at the first row; None: as stated of the log, or as it shows

    Raises
    ------
    InputError        a start other than the log's stated one; as `initial_soc`
    """
    start = initial_soc(model, log, start_of(log.soc0, soc0), whole_log=True)
    simulate(model, log.part(0, 2), start.soc)  # compiles outside the clock
    began = time.perf_counter()
    found = simulate_stretches(model, log, start)
    return SimulatedLog(found, start, time.perf_counter() - began)
