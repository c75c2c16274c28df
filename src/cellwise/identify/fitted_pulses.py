"""Station: the pulses of every temperature, for the report and the papers' methods.

A fit takes rows: nothing of a model but those of ``refine=False`` is made of pulses.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.identify.checked_logs import CheckedLogs, grouped_by_temperature
from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.identify.identification import IdentifySettings, PulseSet
from cellwise.identify.ocv.curve import OUTSIDE, OcvCurve
from cellwise.identify.pulse_fit.pulse_data import cut_pulse
from cellwise.logs.cell_log import CellLog
from cellwise.logs.stated import VOLT_PER_KELVIN
from cellwise.notices import Code, Notice

LARGEST_PULSE = 1.0 / 3.0  # of the capacity: a discharge beyond it has no parameters of one SOC
COLDER_K = 15.0  # from so much on a cold cell resists more, whatever pulses and samples do
LATE_ROW_S = 2.5  # a drive changes its current every second or two


class MeasuredPulses(NamedTuple):
    """The pulses of every temperature [degC], coldest first, and what was found on the way."""

    sets: Mapping[float, tuple[PulseSet, ...]]
    contradictions: tuple[Notice, ...]
    notices: tuple[Notice, ...]


def measure_pulses(
    checked: CheckedLogs,
    ocv: OcvCurve,
    capacity_Ah: float,
    settings: IdentifySettings,
    starts: Mapping[int, InitialSoc],
) -> MeasuredPulses:
    """Find the healthy pulses of every HPPC log; ``starts`` of each log, by its ``id``."""
    parts = grouped_by_temperature(checked.tests, checked.low_rate, checked.default_C)
    sets = {
        temperature_C: tuple(
            _pulse_set(log, ocv, capacity_Ah, settings, starts[id(log)]) for log, _ in part.hppc
        )
        for temperature_C, part in parts.items()
    }
    slow = [n for several in sets.values() for s in several for n in _late_rows(s)]
    return MeasuredPulses(sets, _exchanged(sets), tuple(slow))


def _pulse_set(
    log: CellLog,
    ocv: OcvCurve,
    capacity_Ah: float,
    settings: IdentifySettings,
    anchor: InitialSoc,
) -> PulseSet:
    pulses = find_pulses(log)
    soc = anchor.soc - log.counted_charge_Ah() / capacity_Ah
    windows = []
    for p in pulses_to_fit(pulses):
        inside = -OUTSIDE <= soc[p.start] <= 1.0 + OUTSIDE
        if not inside or abs(p.charge_Ah) > LARGEST_PULSE * capacity_Ah:
            continue
        # A paper's method takes the OCV of a pulse from the rest before it.
        of_table = settings.method == "varpro" or p.role == "move"
        windows.append(cut_pulse(log, p, soc, ocv.function.evaluate if of_table else None))
    return PulseSet(log, anchor, pulses, tuple(windows), settings.method)


def _exchanged(sets: Mapping[float, tuple[PulseSet, ...]]) -> tuple[Notice, ...]:
    """Temperatures of which the colder one resists less: a cold cell has more."""
    found = []
    for (cold_C, cold), (warm_C, warm) in combinations(sets.items(), 2):
        at_cold, at_warm = _resistance(cold), _resistance(warm)
        if warm_C - cold_C >= COLDER_K and at_cold < at_warm:
            text = (
                f" at {cold_C:.0f} degC has {1e3 * at_cold:.3g} mohm, "
                f"'{warm[0].log.name}' at {warm_C:.0f} degC {1e3 * at_warm:.3g} mohm: a cold "
                "cell has more, are they exchanged?"
            )
            size_V = VOLT_PER_KELVIN * (warm_C - cold_C)
            name = cold[0].log.name
            found.append(Notice(Code.TEMPERATURES_EXCHANGED, text, log=name, size_V=size_V))
    return tuple(found)


def _resistance(sets: tuple[PulseSet, ...]) -> float:
    """What pulses drop at their end over their current, in the median [ohm]; NaN without one."""
    drops = [
        abs(w.voltage_V[w.stop - 1] - w.voltage_V[w.start - 1]) / abs(w.pulse_current_A)
        for one in sets
        for w in one.windows
        if w.stop > w.start > 0
    ]
    return float(np.median(drops)) if drops else float("nan")


def _late_rows(found: PulseSet) -> list[Notice]:
    """What a person should know of a log whose first row after a switch comes late."""
    first_s = [w.interval_s[w.start] for w in found.windows if w.stop > w.start]
    if not first_s or np.median(first_s) <= LATE_ROW_S:
        return []
    text = (
        f" has its first row {np.median(first_s):.3g} s after a switch: what its R0 says is the "
        "resistance after that time; for a drive log pulses every second or faster"
    )
    return [Notice(Code.LATE_FIRST_ROW, text, log=found.log.name)]
