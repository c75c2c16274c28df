"""What an exported filter lives through: a cell's true log, what its sensors do, how it is started.

Three sources: the exported model, varied and aged; porous electrodes in its place; measured logs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellwise.benchmark.certify.physics_cells import physics_cell
from cellwise.benchmark.certify.virtual_cells import (
    FAULTS,
    NO_FAULT,
    START_STD,
    CellSpread,
    draw_cell,
    with_sensor,
)
from cellwise.benchmark.faults import faulty_log
from cellwise.benchmark.suite_logs import JudgedLog
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import USUAL_C, CellModel
from cellwise.cell.protocol import run_protocol
from cellwise.errors import InputError
from cellwise.estimate.replay import reference_soc
from cellwise.estimate.sensor import Sensor
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

MODEL, PHYSICS, MEASURED = "model", "physics", "measured"
AS_CELLS = CellSpread()
PHYSICS_SEED = 1_000_000  # its cells are other draws than the model's
PHYSICS_HOURS = 20.0  # of one cell: porous electrodes take a thousand times longer
KNOWN_STD = 0.02  # of a start that serves as a reference
SETTLED_S = 3600.0  # what a filter has to find its start is not scored


@dataclass(frozen=True, eq=False)
class CertifiedLife:
    """A cell from its start on.

    Parameters
    ----------
    about : dict              source, number and name of the cell, its age (0 new, 1 at the end of
                              its life; None: not known), capacity, temperature, fault, and the SOC
                              that the filter is started with
    log : CellLog             what an ideal instrument has logged
    soc : (n,) float          true SOC
    seen : CellLog            what the filter sees
    truth : CellModel         the cell, as far as it is known
    """

    about: dict[str, Any]
    log: CellLog
    soc: FloatArray
    seen: CellLog
    truth: CellModel


@dataclass(frozen=True, eq=False)
class Fleet:
    """Everything that is drawn, and what it is drawn with.

    Parameters
    ----------
    cells : int               of the model
    physics : int             of porous electrodes
    measured : sequence of JudgedLog     each is lived once as it is and once with each fault
    hours, seed, sensor : float, int, Sensor
    spread : CellSpread       of the model's cells
    """

    cells: int
    physics: int
    measured: tuple[JudgedLog, ...]
    hours: float
    seed: int
    sensor: Sensor
    spread: CellSpread = AS_CELLS

    @property
    def names(self) -> list[tuple[str, int]]:
        """Source and number of every life; what takes longest comes first."""
        logs = len(self.measured) * (1 + len(FAULTS))
        counts = {PHYSICS: self.physics, MODEL: self.cells, MEASURED: logs}
        return [(source, k) for source, count in counts.items() for k in range(count)]

    def life(self, model: CellModel, source: str, number: int, dt_s: float) -> CertifiedLife:
        """The life of a number: the same for the same seed, whatever is drawn beside it."""
        if source == MEASURED:
            return self._measured(model, number)
        physics = source == PHYSICS
        index = number + PHYSICS_SEED * physics
        hours = min(self.hours, PHYSICS_HOURS) if physics else self.hours
        spread = replace(self.spread, model_error=0.0) if physics else self.spread
        cell = draw_cell(model, index, self.seed, hours, dt_s, self.sensor, spread)
        if physics:
            porous = physics_cell(cell.truth, cell.temperature_C)
            log, soc = porous.lived(cell.steps, cell.soc0, dt_s)
        else:
            log = run_protocol(cell.truth, cell.steps, cell.soc0, dt_s, cell.temperature_C)
            soc = counted_soc(log, cell.soc0, cell.truth)
        rows = int(np.searchsorted(log.time_s, 3600.0 * hours, side="right"))
        log, soc = log.part(0, rows), soc[:rows]
        capacity_Ah = cell.truth.capacity_Ah
        rng = np.random.default_rng([self.seed, index, 1])
        about = {
            "source": source,
            "cell": number,
            "name": f"{source} {number}",
            "age": round(cell.age, 4),
            "capacity_Ah": capacity_Ah,
            "temperature_C": round(cell.temperature_C, 2),
            "fault": cell.fault.name,
            "started_at": cell.given_soc0,
        }
        seen = faulty_log(cell.fault, log, capacity_Ah, rng)
        return CertifiedLife(about, log, soc, seen, cell.truth)

    def _measured(self, model: CellModel, number: int) -> CertifiedLife:
        which, what = divmod(number, 1 + len(FAULTS))
        one = self.measured[which]
        rng = np.random.default_rng([self.seed, which, what, 2])
        plain, capacity_Ah = (NO_FAULT, *FAULTS)[what], one.reference_Ah
        # A measured log has its own noise.
        offsets = replace(self.sensor, current_noise_A=0.0, voltage_noise_V=0.0)
        fault = with_sensor(plain, offsets, capacity_Ah, rng)
        start = float(np.clip(one.soc0 + START_STD * rng.standard_normal(), 0.0, 1.0))
        about = {
            "source": MEASURED,
            "cell": number,
            "name": one.log.name,
            "age": None,
            "capacity_Ah": capacity_Ah,
            "temperature_C": round(USUAL_C if one.temperature_C is None else one.temperature_C, 2),
            "fault": plain.name,
            "started_at": start,
        }
        seen = faulty_log(fault, one.log, capacity_Ah, rng)
        truth = replace(model, capacity_Ah=capacity_Ah)
        return CertifiedLife(about, one.log, one.truth, seen, truth)


def measured_log(
    model: CellModel, log: CellLog, soc0: float | None, capacity_Ah: float | None
) -> JudgedLog:
    """A log with its true SOC, from a start that is stated or that the log shows.

    Parameters
    ----------
    soc0 : float or None              None: found, where the log shows it within two points
    capacity_Ah : float or None       measured, of this sample; None: the model's

    Raises
    ------
    InputError        a start that the log does not show; a log that is over before the filter is
                      scored
    """
    if soc0 is None:
        start = initial_soc(model, log)
        if start.std > KNOWN_STD:
            raise InputError(
                f"a log '{log.name}' that begins at {start.soc:.2f} +- {2 * start.std:.2f}",
                f"a start that is known within {KNOWN_STD:g}: its SOC is counted from there",
                "State it behind the file, as LOG@soc0=1.",
            )
        soc0 = start.soc
    if log.duration_s <= 1.5 * SETTLED_S:
        raise InputError(
            f"a log '{log.name}' of {log.duration_s / 3600.0:.2f} h",
            "more than an hour and a half: the first hour is not scored",
            "Leave it out.",
        )
    capacity = model.capacity_Ah if capacity_Ah is None else capacity_Ah
    counted = reference_soc(log, soc0, capacity)
    if counted is None:
        counted = counted_soc(log, soc0, replace(model, capacity_Ah=capacity))
    return JudgedLog(log, counted, capacity)


def counted_soc(log: CellLog, soc0: float, cell: CellModel) -> FloatArray:
    """SOC by the true current of a cell, shape (n,)."""
    used = np.where(log.current_A > 0.0, 1.0, cell.charge_efficiency) * log.current_A
    moved_As = np.cumsum(used * np.diff(log.time_s, prepend=log.time_s[0]))
    return np.asarray(soc0 - moved_As / (3600.0 * cell.capacity_Ah))
