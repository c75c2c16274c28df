"""SOC at a log's first row when nobody says it: a rest, a short fit, or the whole log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.likeliest import (
    Past,
    likeliest_soc,
    ln_likelihood_of_starts,
    past_voltage,
)
from cellwise.cell.initial_soc.rest import (
    RELAXED_S,
    REST_RATE,
    SHORT_REST_V,
    ln_likelihood_of_ocv,
    soc_of_ocv,
    still_to_move_V,
)
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import check_soc0, known_temperature_C, model_temperature_C
from cellwise.logs.cell_log import CellLog
from cellwise.logs.measured_log import uncounted_pauses
from cellwise.typing import FloatArray

STATED_STD = 0.005  # a start that is known: full and empty of two tests differ by about this


class Looked(NamedTuple):
    """How much of a log is asked where it begins.

    Under load the first ``fit_s``, which cannot show by how much a used cell's ``resistance``
    differs from its model's; ``beginning`` rows before all of a log is, and of a very long one
    ``rows``. A rest that is surer than ``sure``, and likelier than full and empty, is enough.
    """

    fit_s: float = 60.0
    beginning: int = 2048
    resistance: float = 0.3
    sure: float = 0.02
    rows: int = 400_000


LOOKED = Looked()


@dataclass(frozen=True)
class InitialSoc:
    """SOC at the first row, its standard deviation, and how it was found.

    ``beginning`` is what the first rows alone say, where all of the log was asked; else None. A fit
    of the whole log takes the model for right, the beginning's rest or minute hardly does.
    """

    soc: float
    std: float
    how: str
    beginning: InitialSoc | None = None

    def to_dict(self) -> dict[str, float | str]:
        """As JSON values."""
        return {"value": self.soc, "std": self.std, "how": self.how}


def initial_soc(
    model: CellModel,
    log: CellLog,
    given: float | None = None,
    given_std: float = 0.15,
    *,
    whole_log: bool = False,
) -> InitialSoc:
    """SOC at the first row of a log.

    Taken as given, else as the log states it (`CellLog.soc0`); else from the voltage of a rest at
    the log's start through the OCV; else from the SOC at which the simulation fits the log's first
    minute best. Where that leaves more than two points open, ``whole_log`` asks all of the log.

    Parameters
    ----------
    given : float or None     SOC that the user states, 0..1
    given_std : float         how sure that is
    whole_log : bool          use the whole log where its beginning leaves it open (a plateau, a
                              load): not for what claims to work online

    Returns
    -------
    InitialSoc        the standard deviation includes the model's own voltage error, an unfinished
                      relaxation and a flat OCV: on a plateau it is large
    """
    if given is not None:
        check_soc0(given)
        return InitialSoc(float(given), given_std, "given")
    if log.soc0 is not None:
        return InitialSoc(log.soc0, STATED_STD, "stated")
    current, rest_end = _current_and_rest(model, log)
    measured = np.flatnonzero(np.isfinite(log.voltage_V[:rest_end]))
    last = int(measured[-1]) if measured.size else 0
    rest_s = float(log.time_s[last] - log.time_s[0])
    # One row without current is no rest: a car at a light has come from a load. A rest lasts.
    if measured.size and (rest_s > 0.0 or rest_end == len(log)):
        warm = float(known_temperature_C(model, log)[last])
        seen_V = log.voltage_V[measured]
        # Between what the branches of the model let it still move, and nothing.
        moves = 0.5 * still_to_move_V(model, log.time_s[measured], seen_V, warm)
        unfinished = float(np.hypot(SHORT_REST_V * np.exp(-rest_s / RELAXED_S), moves))
        rested_V = float(seen_V[-1]) + moves
        soc, std = soc_of_ocv(model, rested_V, unfinished, warm)
        how = f"rest of {rest_s:.0f} s at the start, {seen_V[-1]:.4f} V"
        found = InitialSoc(soc, max(std, 0.005), how)
        if not whole_log:
            return found

        def by_rest(soc0: FloatArray) -> FloatArray:
            return ln_likelihood_of_ocv(model, soc0, rested_V, unfinished, warm)

        return _from_whole_log(model, log, found, Past(-moves, unfinished), by_rest)
    found = _from_first_minute(model, log, current)
    return _from_whole_log(model, log, found, past_voltage(model, log)) if whole_log else found


def _current_and_rest(model: CellModel, log: CellLog) -> tuple[FloatArray, int]:
    """Currents of the beginning at least, and the row of the first load.

    Most logs need no more than their beginning: a fleet's logs are long, and read once.
    """
    minute = int(np.searchsorted(log.time_s, log.time_s[0] + LOOKED.fit_s, side="right"))
    rows = max(minute + 2, LOOKED.beginning)
    if rows < len(log) and np.isfinite(log.voltage_V[0]) and not log.gap_rows[:rows].any():
        current = log.interval_current_A[:rows]
        loaded = np.abs(current) >= REST_RATE * model.capacity_Ah
        if loaded.any() and np.isfinite(current).all():
            return current, int(np.argmax(loaded))
    current = log.known_current_A()
    resting = np.abs(current) < REST_RATE * model.capacity_Ah
    resting[: int(np.argmax(np.isfinite(log.interval_current_A)))] = False  # nobody knows
    return current, len(log) if resting.all() else int(np.argmin(resting))


def _from_first_minute(model: CellModel, log: CellLog, current: FloatArray) -> InitialSoc:
    known = np.isfinite(log.voltage_V[:1]).all()
    first = 0 if known else int(np.argmax(np.isfinite(log.voltage_V)))
    rows = max(
        first + 2, int(np.searchsorted(log.time_s, log.time_s[first] + LOOKED.fit_s, side="right"))
    )
    rows = min(rows, len(log))
    head = CellLog(
        log.time_s[:rows],
        current[:rows],
        log.voltage_V[:rows],
        np.full(rows, model_temperature_C(model))
        if log.temperature_C is None
        else log.temperature_C[:rows],
        None if log.charge_Ah is None else log.charge_Ah[:rows],
    )
    past = past_voltage(model, head)
    soc, std = likeliest_soc(model, head, past, other_resistance=LOOKED.resistance)
    return InitialSoc(soc, max(std, 0.01), f"fit of the first {head.duration_s:.0f} s under load")


def _from_whole_log(
    model: CellModel,
    log: CellLog,
    beginning: InitialSoc,
    past: Past,
    by_rest: Callable[[FloatArray], FloatArray] | None = None,
) -> InitialSoc:
    # After a pause that nobody counted another start may hold.
    log = log.part(0, min((len(log), LOOKED.rows, *uncounted_pauses(log))))
    if np.count_nonzero(np.isfinite(log.voltage_V)) < 2:
        return beginning
    if by_rest is not None and beginning.std <= LOOKED.sure:
        ends = np.array([beginning.soc, 0.0, 1.0])
        if np.argmax(ln_likelihood_of_starts(model, log, past, by_rest, ends)) == 0:
            return beginning
    soc, std = likeliest_soc(model, log, past, by_rest, candidates=(beginning.soc,))
    how = f"fit of the whole log, {log.duration_s / 3600.0:.2f} h"
    return InitialSoc(soc, max(std, STATED_STD), how, beginning)
