"""Which test a log is: by its phases, its pulses and its rate, as the stations of `identify` do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from cellwise.identify.fitted_pulses import LARGEST_PULSE
from cellwise.identify.hppc.phases import Phase, find_phases
from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.identify.ocv.ocv_lowrate import LIMITS as LOW_RATE
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.sign import is_at_rest

Kind = Literal["hppc", "ocv", "capacity", "charge", "drive", "rest"]


class _TestKindLimits(NamedTuple):
    """What makes a test one of its kind."""

    driven: float = 0.5  # of the time under current, at currents that hold no level
    pulses: int = 3  # healthy after a rest: fewer may be the switching of a charger
    charged: float = 0.95  # of what it moves: nothing but a charge
    steady: float = 0.5  # of the charge that the log moves, by one constant current


LIMITS = _TestKindLimits()


@dataclass(frozen=True)
class TestKind:
    """What a log is taken for, and why.

    ``current_A`` and ``charge_Ah`` are those of its steady current, positive; 0 without one.
    """

    kind: Kind
    why: str
    current_A: float = 0.0
    charge_Ah: float = 0.0


def kind_of(log: CellLog, capacity_Ah: float | None = None) -> TestKind:
    """What a log of one cell is.

    Parameters
    ----------
    log : CellLog
    capacity_Ah : float or None      what a rate refers to [Ah]; None: what the log moves

    Returns
    -------
    TestKind
    """
    current = log.known_current_A()
    if is_at_rest(current, log.voltage_V):
        return TestKind("rest", "no current")
    phases = find_phases(log)
    moved = float(np.ptp(log.counted_charge_Ah()))
    capacity = capacity_Ah or moved
    under = sum(p.duration_s for p in phases if p.kind != "rest")
    driven = sum(p.duration_s for p in phases if p.kind == "dynamic")
    if driven > LIMITS.driven * under:
        return TestKind("drive", f"a load that changes during {driven / under:.0%} of its time")
    pulses = [
        p
        for p in pulses_to_fit(find_pulses(log))
        if abs(p.charge_Ah) <= LARGEST_PULSE * capacity
        and abs(p.current_A) > LOW_RATE.low_rate * capacity  # less is the dither of a low-rate test
    ]
    if len(pulses) >= LIMITS.pulses:
        return TestKind("hppc", f"{len(pulses)} pulses after rests")
    steady = [p for p in phases if p.kind == "cc" and abs(p.charge_Ah) >= LIMITS.steady * moved]
    if steady:
        return _steady(steady, capacity)
    if float(log.counted_charge_Ah()[-1]) <= -LIMITS.charged * moved:
        return TestKind("charge", f"{moved:.3g} Ah charged at several currents")
    return TestKind("drive", "neither pulses after rests nor one steady current")


def _steady(steady: list[Phase], capacity_Ah: float) -> TestKind:
    """A test at constant current: a discharge goes before a charge."""
    one = max(steady, key=lambda p: (not p.charging, abs(p.charge_Ah)))
    current, charge = abs(one.current_A), abs(one.charge_Ah)
    rate = current / capacity_Ah
    kind: Kind = "charge" if one.charging else "capacity"
    if rate <= LOW_RATE.low_rate:
        kind = "ocv"
    what = "charge" if one.charging else "discharge"
    said = f"{what} at {current:.3g} A, {_named(rate)}, {charge:.3g} Ah"
    return TestKind(kind, said, current, charge)


def _named(rate: float) -> str:
    return f"{rate:.1f}C" if rate >= 0.95 else f"C/{1.0 / rate:.3g}"
