"""Station: the pulses of every temperature, their fits, and tables of these over SOC."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cellwise.errors import InputError
from cellwise.fit.start import InitialSoc
from cellwise.identify.checked_logs import CheckedLogs, grouped_by_temperature
from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.identify.identification import CellTests, IdentifySettings, PulseSet
from cellwise.identify.measured_ocv import pulse_counts
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.pulse_fit.fit_pulse import fit_pulse
from cellwise.identify.pulse_fit.pulse_data import cut_pulse
from cellwise.identify.tables import PulseTables, pulse_tables
from cellwise.logs.cell_log import CellLog
from cellwise.logs.stated import VOLT_PER_KELVIN
from cellwise.notices import Code, Notice

LARGEST_PULSE = 1.0 / 3.0  # of the capacity: a discharge beyond it has no parameters of one SOC
OUTSIDE = 0.02  # of the SOC range: a pulse may begin so far beyond its ends
COLDER_K = 15.0  # from so much on a cold cell resists more, whatever pulses and samples do
LATE_ROW_S = 2.5  # a drive changes its current every second or two


@dataclass(frozen=True, eq=False)
class Group:
    """The tests of one temperature and what their pulses gave."""

    temperature_C: float
    tests: CellTests
    pulse_sets: tuple[PulseSet, ...]
    tables: PulseTables | None


@dataclass(frozen=True, eq=False)
class FittedPulses:
    """The groups, coldest first, and what was found on the way."""

    groups: tuple[Group, ...]
    contradictions: tuple[Notice, ...]
    notices: tuple[Notice, ...]


def fit_all_pulses(
    checked: CheckedLogs,
    ocv: OcvCurve,
    capacity_Ah: float,
    settings: IdentifySettings,
    starts: Mapping[int, InitialSoc],
) -> FittedPulses:
    """Fit the healthy pulses of every HPPC log; ``starts`` of each log, by its ``id``.

    Raises
    ------
    InputError        HPPC logs of a temperature without a pulse to fit, and no drive of it
    """
    parts = grouped_by_temperature(checked.tests, checked.low_rate, checked.default_C)
    groups = []
    for temperature_C, part in parts.items():
        sets = tuple(
            _pulse_set(log, ocv, capacity_Ah, settings, starts[id(log)]) for log, _ in part.hppc
        )
        fits = [f for s in sets for f in s.fits]
        if part.hppc and not fits and not settings.refine:
            raise InputError(
                pulse_counts(part),
                "a healthy pulse after a rest that moves less than a third of the charge",
                "Give an HPPC log whose pulses stay within the voltage limits, or a drive.",
            )
        tables = pulse_tables(fits, settings.tables) if fits else None
        groups.append(Group(temperature_C, part, sets, tables))
    slow = [n for g in groups for s in g.pulse_sets for n in _late_rows(s)]
    return FittedPulses(tuple(groups), _exchanged(groups), tuple(slow))


def _pulse_set(
    log: CellLog,
    ocv: OcvCurve,
    capacity_Ah: float,
    settings: IdentifySettings,
    anchor: InitialSoc,
) -> PulseSet:
    pulses = find_pulses(log)
    soc = anchor.soc - log.counted_charge_Ah() / capacity_Ah
    rng = np.random.default_rng(0)  # one for all: alike draws of a swarm would err alike
    fitted, fits = [], []
    for p in pulses_to_fit(pulses):
        inside = -OUTSIDE <= soc[p.start] <= 1.0 + OUTSIDE
        if not inside or abs(p.charge_Ah) > LARGEST_PULSE * capacity_Ah:
            continue
        # A paper's method takes the OCV of a pulse from the rest before it.
        of_table = settings.method == "varpro" or p.role == "move"
        data = cut_pulse(log, p, soc, ocv.function.evaluate if of_table else None)
        with suppress(InputError):  # too few rows
            fits.append(fit_pulse(data, settings.method, rng))
            fitted.append(p)
    return PulseSet(log, anchor, pulses, tuple(fitted), tuple(fits))


def _exchanged(groups: Sequence[Group]) -> tuple[Notice, ...]:
    """Temperatures of which the colder one resists less: a cold cell has more."""
    found = []
    for cold, warm in combinations(groups, 2):  # coldest first
        colder_K = warm.temperature_C - cold.temperature_C
        if cold.tables is None or warm.tables is None or colder_K < COLDER_K:
            continue
        at_cold, at_warm = _resistance(cold.tables), _resistance(warm.tables)
        if at_cold < at_warm:
            names = [g.pulse_sets[0].log.name for g in (cold, warm)]
            text = (
                f" at {cold.temperature_C:.0f} degC has {1e3 * at_cold:.3g} mohm, "
                f"'{names[1]}' at {warm.temperature_C:.0f} degC {1e3 * at_warm:.3g} mohm: a cold "
                "cell has more, are they exchanged?"
            )
            size_V = VOLT_PER_KELVIN * colder_K
            found.append(Notice(Code.TEMPERATURES_EXCHANGED, text, log=names[0], size_V=size_V))
    return tuple(found)


def _resistance(tables: PulseTables) -> float:
    """R0 + R1 in the middle of the SOC range [ohm]."""
    return float(np.median(tables.values["r0_ohm"] + tables.values["r1_ohm"]))


def _late_rows(found: PulseSet) -> list[Notice]:
    """What a person should know of a log whose first row after a switch comes late."""
    first_s = [found.log.interval_s[p.start] for p in found.fitted]
    if not first_s or np.median(first_s) <= LATE_ROW_S:
        return []
    text = (
        f" has its first row {np.median(first_s):.3g} s after a switch: what its R0 says is the "
        "resistance after that time; for a drive log pulses every second or faster"
    )
    return [Notice(Code.LATE_FIRST_ROW, text, log=found.log.name)]
