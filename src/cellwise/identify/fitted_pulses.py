"""Station: the pulses of every temperature, their fits, and tables of these over SOC."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.notice import Notice
from cellwise.errors import InputError
from cellwise.identify.by_temperature import grouped_by_temperature
from cellwise.identify.checked_logs import VOLT_PER_KELVIN, CheckedLogs
from cellwise.identify.hppc.pulses import Pulse, find_pulses, pulses_to_fit
from cellwise.identify.identification import IdentifySettings, PulseSet, TestLogs
from cellwise.identify.measured_ocv import pulse_counts
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.pulse_fit.fit_pulse import fit_pulses
from cellwise.identify.pulse_fit.pulse_data import PulseData, has_enough_rows, voltage_noise
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit
from cellwise.identify.pulse_fit.pulse_window import cut_pulses, slow_rows_notice
from cellwise.identify.soc_anchor import anchor_soc
from cellwise.identify.tables import GRID_POINTS, PulseTables, pulse_tables
from cellwise.logs.cell_log import CellLog

LARGEST_PULSE = 1.0 / 3.0  # of the capacity: a discharge beyond it has no parameters of one SOC
COLDER_K = 15.0  # from so much on a cold cell resists more, whatever pulses and samples do


class _Distorted(NamedTuple):
    """A pulse that a circuit misses by more than others of its log, as shares of the response.

    A misfit of 1 % shifts tau1 of a 60 s pulse by about half (synthetic cells with a bending OCV).
    What all pulses of a test show, as nonlinear kinetics in the cold, is no distortion of some.
    """

    least: float = 0.01
    usual: float = 3.0  # times the median of the log's pulses


DISTORTED = _Distorted()


@dataclass(frozen=True, eq=False)
class Group:
    """The tests of one temperature and what their pulses gave."""

    temperature_C: float
    tests: TestLogs
    pulse_sets: tuple[PulseSet, ...]
    tables: PulseTables | None


@dataclass(frozen=True, eq=False)
class FittedPulses:
    """The groups, coldest first, and what was found on the way."""

    groups: tuple[Group, ...]
    contradictions: tuple[Notice, ...]
    notices: tuple[str, ...]


def fit_all_pulses(
    checked: CheckedLogs, ocv: OcvCurve, capacity_Ah: float, settings: IdentifySettings
) -> FittedPulses:
    """Fit the healthy pulses of every HPPC log.

    Raises
    ------
    InputError        HPPC logs of a temperature without a pulse to fit, and no drive of it
    """
    parts = grouped_by_temperature(checked.tests, checked.low_rate, checked.default_C)
    groups = tuple(
        _group(temperature, part, ocv, capacity_Ah, settings) for temperature, part in parts.items()
    )
    slow = (slow_rows_notice(p.log, p.fitted) for g in groups for p in g.pulse_sets)
    return FittedPulses(groups, _exchanged(groups), tuple(n for n in slow if n))


def _group(
    temperature_C: float,
    part: TestLogs,
    ocv: OcvCurve,
    capacity_Ah: float,
    settings: IdentifySettings,
) -> Group:
    sets = tuple(_pulse_set(log, ocv, capacity_Ah, settings) for log, _ in part.hppc)
    fits = [f for s in sets for f in s.fits]
    if part.hppc and not fits and not part.drive:
        raise InputError(
            pulse_counts(part)[0],
            "a healthy pulse after a rest that moves less than a third of the charge",
            "Give an HPPC log whose pulses stay within the voltage limits, or a drive.",
        )
    tables = pulse_tables(fits, GRID_POINTS, settings.tables) if fits else None
    return Group(temperature_C, part, sets, tables)


def _pulse_set(
    log: CellLog, ocv: OcvCurve, capacity_Ah: float, settings: IdentifySettings
) -> PulseSet:
    pulses = find_pulses(log)
    anchor = anchor_soc(log, ocv, capacity_Ah, 0.0)
    soc = anchor.soc - log.counted_charge_Ah() / capacity_Ah
    table = ocv.function.evaluate
    cut = []
    for p in pulses_to_fit(pulses):
        inside = -0.02 <= soc[p.start] <= 1.02
        if not inside or abs(p.charge_Ah) > LARGEST_PULSE * capacity_Ah:
            continue
        # A paper's method takes the OCV of a pulse from the rest before it.
        own = table if settings.method == "varpro" or p.role == "move" else None
        with suppress(InputError):  # too few rows
            cut += [
                (p, d) for d in cut_pulses(log, [p], capacity_Ah, soc, own) if has_enough_rows(d)
            ]
    data = [d for _, d in cut]
    missed = _missed(data, fits := fit_pulses(data))
    if settings.method != "varpro":
        fits = fit_pulses(data, settings.method)
    most = float(np.clip(DISTORTED.usual * np.median(missed or [0.0]), DISTORTED.least, 1.0))
    bent = {p.start: share for (p, _), share in zip(cut, missed, strict=True) if share > most}
    kept = [(p, f) for (p, _), f in zip(cut, fits, strict=True) if p.start not in bent]
    judged = tuple(_distorted(p, bent[p.start], most) if p.start in bent else p for p in pulses)
    return PulseSet(log, anchor, judged, tuple(p for p, _ in kept), tuple(f for _, f in kept))


def _missed(data: Sequence[PulseData], fits: Sequence[PulseFit]) -> list[float]:
    """What a circuit of two branches leaves of each response beyond the noise, as a share."""
    shares = []
    for one, fit in zip(data, fits, strict=True):
        swing = float(np.ptp(one.voltage_V[max(one.start - 1, 0) : one.stop]))
        beyond = max(fit.rmse_V**2 - voltage_noise(one) ** 2, 0.0)
        shares.append(float(np.sqrt(beyond)) / max(swing, 1e-9))
    return shares


def _distorted(pulse: Pulse, share: float, most: float) -> Pulse:
    """The pulse with the verdict that the fits give of its shape."""
    why = f"two branches leave {share:.1%} of its response, {most:.1%} is allowed"
    return replace(pulse, quality="distorted", reason=why)


def _exchanged(groups: Sequence[Group]) -> tuple[Notice, ...]:
    """Temperatures of which the colder one resists less: a cold cell has more."""
    known = [(g, _resistance(g.tables)) for g in groups if g.tables is not None]
    found = []
    for pair in combinations(known, 2):
        (cold, at_cold), (warm, at_warm) = sorted(pair, key=lambda x: x[0].temperature_C)
        colder_K = warm.temperature_C - cold.temperature_C
        if colder_K >= COLDER_K and at_cold < at_warm:
            names = [g.pulse_sets[0].log.name for g in (cold, warm)]
            text = (
                f"'{names[0]}' at {cold.temperature_C:.0f} degC has {1e3 * at_cold:.3g} mohm, "
                f"'{names[1]}' at {warm.temperature_C:.0f} degC {1e3 * at_warm:.3g} mohm: a cold "
                "cell has more, are they exchanged?"
            )
            found.append(Notice(VOLT_PER_KELVIN * colder_K, text))
    return tuple(found)


def _resistance(tables: PulseTables) -> float:
    """R0 + R1 in the middle of the SOC range [ohm]."""
    return float(np.median(tables.values["r0_ohm"] + tables.values["r1_ohm"]))
