"""What a pulse test says of the capacity: the charge it moved, if it went from full to empty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.identify.capacity.half_cycles import join_logs
from cellwise.identify.hppc.phases import Phase, find_phases
from cellwise.logs.cell_log import CellLog

CLIMBS = 2.0  # a log that brings back so many times what it takes climbs
# At the lower limit the voltage falls this much faster than in the middle, in every chemistry.
STEEP_END = 4.0
WHOLE_CELL = 0.7  # of nominal: a test that moved less went through a part of the SOC range
NEARLY_WHOLE = 0.97  # of nominal: a test that does not end empty and yet is the whole cell


def whole_hppc_Ah(
    logs: Sequence[CellLog], nominal_Ah: float | None, notices: list[str]
) -> float | None:
    """Charge of the pulse test that moved most [Ah]; None where it was not the whole cell.

    Parameters
    ----------
    logs : sequence of CellLog     pulse tests
    nominal_Ah : float or None     without it the charge counts anyway, with a notice
    notices : list of str          what was found is added
    """
    most = max(logs, key=hppc_total_Ah, default=None)
    if most is None:
        return None
    total = hppc_total_Ah(most)
    whole = hppc_reaches_empty(most)
    if nominal_Ah is None:
        if not whole:
            notices.append(
                f"'{most.name}' is not seen to go from full to empty: its {total:.3f} Ah are taken "
                "for the capacity, for want of a nominal one"
            )
        return total
    if total >= (WHOLE_CELL if whole else NEARLY_WHOLE) * nominal_Ah:
        return total
    notices.append(
        f"the HPPC test moved {total:.3f} Ah, {100 * total / nominal_Ah:.0f} % of nominal: "
        "it did not go from full to empty and is no capacity"
    )
    return None


def hppc_total_Ah(log: CellLog | Sequence[CellLog]) -> float:
    """Net charge from the fullest to the emptiest moment after it, all pulses included [Ah].

    The ``hppc-total`` choice: it is a capacity as far as the log begins, or is charged, full and
    ends empty. Of a log that climbs, the charge from its emptiest to its fullest moment.
    """
    charge = join_logs(log).charge_Ah
    down = float(np.max(charge - np.minimum.accumulate(charge)))
    up = float(np.max(np.maximum.accumulate(charge) - charge))
    return up if up > CLIMBS * down else down


def hppc_reaches_empty(log: CellLog) -> bool:
    """Whether a pulse test ends as a cell does at its lower limit: bending down.

    The slope at the end of the last discharge against that at the end of the usual ones.
    """
    steps = [p for p in find_phases(log) if p.kind == "cc" and p.current_A > 0.0]
    most = max((p.charge_Ah for p in steps), default=0.0)
    ends = [_end_slope(log, p) for p in steps if p.charge_Ah >= 0.1 * most]
    ends = [slope for slope in ends if np.isfinite(slope)]
    return len(ends) > 1 and ends[-1] >= STEEP_END * float(np.median(ends))


def _end_slope(log: CellLog, step: Phase) -> float:
    """Fall of the voltage over the last third of a constant current's charge [V per Ah]."""
    rows = slice(max(step.start - 1, 0), step.stop)
    t, v = log.time_s[rows], log.voltage_V[rows]
    known = np.isfinite(v)
    late = t[-1] - 0.3 * (t[-1] - t[0])
    if np.count_nonzero(known) < 2 or not t[-1] > t[0]:
        return float("nan")
    at, end = np.interp(np.array([late, t[-1]]), t[known], v[known])
    return float((at - end) / (0.3 * step.charge_Ah))
