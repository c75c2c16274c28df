"""Whether tests can be of one cell: what cannot is refused, the rest is said with its size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.model_file import check_physical
from cellwise.cell.plausibility.cells_in_series import check_one_cell
from cellwise.cell.plausibility.notice import RANGE_V, Notice, in_order
from cellwise.cell.plausibility.simulated import (
    LARGE_ERROR_V,
    LARGE_RMSE_V,
    error_notices,
    soc_notices,
)
from cellwise.cell.simulate import Simulation, simulate
from cellwise.errors import InputError
from cellwise.identify.identification import TestLogs, log_temperature_C
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.ocv.ocv_rests import find_ocv_rests
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.units import CELL
from cellwise.logs.stated import OTHER_TEMPERATURE_K, other_temperature

# The highest voltages of a log of an empty cell and one of a full differ by less (LTO: 1.87); those
# of one cell and two in series by 2.
OTHER_VOLTAGE = 1.9
# From full to empty: cells of one kind, of any age and at loads up to some C, differ by less than
# the first; no two by the second.
OTHER_CHARGE, FAR_CHARGE = 1.4, 2.5
FAR_BELOW = 4.0
WARM_C = 20.0  # a colder cell meets its lower limit under load when it is far from empty
MUCH_CHARGE = 1.15
NEAR_NOMINAL = 1.25
# Full and empty lie so near to the ends of the voltages seen; of a window as narrow as an LFP
# cell's, less: its plateau is neither.
TOP_V, BOTTOM_V = 0.15, 0.6
TOP_SHARE, BOTTOM_SHARE = 0.1, 0.35
# Steps of 0.1 s and of some seconds show the ohmic resistance with more or less of the first
# branch, within a factor of 2; ten times the current shows a tenth. The voltage of some loggers
# comes a row or two after the current.
STEP_ROWS, STEP_SHARE, FEWEST_STEPS = 3, 0.2, 5
LONGEST_STEP_S = 5.0
OTHER_SCALE, IMPOSSIBLE_SCALE = 4.0, 30.0
COLDER_K, LESS_RESISTANCE = 15.0, 0.8
DROP_AT_1C_V, PER_KELVIN = 0.07, 0.04  # of usual cells: what the wrong temperature does


LONG_REST_S = 600.0
FEWEST_RESTS = 3
OFF_THE_OCV_V = 0.05  # hysteresis, age and the cold leave less


class Tested(NamedTuple):
    """A log, and at which temperature it is taken to be [degC]."""

    log: CellLog
    temperature_C: float
    pulsed: bool
    warm: bool


def contradictions(
    tests: TestLogs, default_C: float, nominal_Ah: float | None = None
) -> list[Notice]:
    """Where the logs contradict each other in voltage, charge, scale or temperature.

    Parameters
    ----------
    default_C : float             temperature of logs that neither measured nor state one
    nominal_Ah : float or None    that the logs' charges have to be possible with

    Raises
    ------
    InputError        a pack beside or instead of a cell, currents or charges that no two logs of
                      one cell can have
    """
    logs = _tested(tests, default_C)
    for one in logs:
        check_one_cell(one.log)
    _check_voltages(logs)
    if nominal_Ah is not None:
        _check_charges(logs, nominal_Ah, "nominal")
    return [*_charges(logs), *_scales(logs), *_temperatures(tests, logs)]


def rest_notices(tests: TestLogs, ocv: OcvCurve, capacity_Ah: float) -> list[Notice]:
    """Logs whose rests do not lie on the OCV, wherever on the SOC axis they may begin."""
    soc = np.linspace(0.0, 1.0, 201)
    level = ocv.function.evaluate(soc)
    notices = []
    for one in _tested(tests, 25.0):
        try:
            rests = find_ocv_rests(one.log, min_rest_s=LONG_REST_S)
        except InputError:
            continue
        rests = tuple(r for r in rests if r.duration_s >= LONG_REST_S)
        if len(rests) < FEWEST_RESTS:
            continue
        charge = np.array([r.charge_Ah for r in rests]) / capacity_Ah
        voltage = np.array([r.final_V for r in rests])
        starts = soc if one.log.soc0 is None else np.array([one.log.soc0])
        off = np.array([np.median(np.abs(voltage - np.interp(s - charge, soc, level)))
                        for s in starts])  # fmt: skip
        least = float(np.min(off))
        if least >= OFF_THE_OCV_V:
            text = (
                f"{len(rests)} rests of '{one.log.name}' lie {1e3 * least:.0f} mV (median) off the "
                f"OCV ({ocv.source}) wherever it may begin: a log of another cell?"
            )
            notices.append(Notice(least, text))
    return notices


def capacity_notices(
    tests: TestLogs, capacity_Ah: float, choice: str, nominal_Ah: float | None
) -> list[Notice]:
    """Where the capacity contradicts the nominal one, or what a log moves.

    Raises
    ------
    InputError        a log that moves several times the capacity, or a capacity that is several
                      times what a log moved from full to empty
    """
    notices = []
    if nominal_Ah is not None:
        ratio = capacity_Ah / nominal_Ah
        if not 1.0 / NEAR_NOMINAL < ratio < NEAR_NOMINAL:
            text = (
                f"the capacity of {capacity_Ah:.4g} Ah ({choice}) is {ratio:.2f} times the nominal "
                f"{nominal_Ah:.4g} Ah: another cell, an aged one, or another unit?"
            )
            notices.append(Notice(RANGE_V * abs(math.log(ratio)), text))
    if capacity_Ah > CELL.largest_Ah:
        text = f"a cell of {capacity_Ah:.0f} Ah: is the current in milliampere (current_mA)?"
        notices.append(Notice(RANGE_V, text))
    logs = _tested(tests, 25.0)
    _check_charges(logs, capacity_Ah, choice)
    for one in logs:
        share = float(np.ptp(one.log.counted_charge_Ah())) / capacity_Ah
        if share > MUCH_CHARGE:
            text = (
                f"'{one.log.name}' moves {share * capacity_Ah:.4g} Ah through a cell of "
                f"{capacity_Ah:.4g} Ah ({choice}): a log of another cell, or in another scale?"
            )
            notices.append(Notice(RANGE_V * (share - 1.0), text))
    return notices


def check_possible(model: CellModel, found: Sequence[Notice]) -> None:
    """Refuse a model that no cell can be, with what is wrong with its tests.

    Raises
    ------
    InputError        see :func:`cellwise.cell.model_file.check_physical`
    """
    try:
        check_physical(model, "the model")
    except InputError as error:
        first = "".join(f"; {text}" for text in in_order(found)[:1])
        raise InputError(
            f"tests that give {error.found}{first}",
            error.expected,
            "Check that the logs are of one cell and in one scale, and their temperatures.",
        ) from None


def check_serves(rmse_V: float, found: Sequence[Notice]) -> None:
    """Refuse a model of tests that contradict each other if it is far from what made it.

    Raises
    ------
    InputError        an error of hundreds of millivolts on its own logs, and a contradiction
    """
    if found and rmse_V >= LARGE_ERROR_V:
        raise InputError(
            f"tests that give a model {1e3 * rmse_V:.0f} mV off its own logs; {in_order(found)[0]}",
            "logs of one cell, in one scale",
            "Leave out the log that does not belong to them.",
        )


def own_log_notices(
    model: CellModel, tests: TestLogs, simulations: Sequence[Simulation]
) -> list[Notice]:
    """Where the finished model is far from the logs that made it.

    Logs that no simulation is given of are simulated from where their first rows say.
    """
    found = []
    for s in simulations:
        if np.ptp(s.soc) <= MUCH_CHARGE:  # else `capacity_notices` has said it
            found += soc_notices(s.log, s.soc)
        found += error_notices(s.log, s.error_V, s.soc)
    done = {id(s.log) for s in simulations}
    for log in (*tests.ocv, *tests.capacity):
        if id(log) not in done:
            s = simulate(model, log, initial_soc(model, log, likeliest=True, whole_log=True).soc)
            if s.metrics.rmse_V >= LARGE_RMSE_V:
                found += error_notices(log, s.error_V, s.soc)
    return found


def reading_notices(tests: TestLogs) -> list[str]:
    """What reading the logs has noted, each with the name of its log."""
    return [
        n if one.log.name and one.log.name in n else f"'{one.log.name}': {n}"
        for one in _tested(tests, 25.0)
        for n in one.log.notices
    ]


def whole_charge_Ah(log: CellLog, others: Sequence[Tested]) -> float | None:
    """Charge from full to empty; None for a log that did not go from one to the other.

    Full and empty are the highest and lowest voltages that the logs show together. A cold log
    shows neither.
    """
    if not next(one.warm for one in others if one.log is log):
        return None
    top = max(float(np.nanmax(one.log.voltage_V)) for one in others)
    bottom = min(float(np.nanmin(one.log.voltage_V)) for one in others)
    full_V = top - min(TOP_V, TOP_SHARE * (top - bottom))
    empty_V = bottom + min(BOTTOM_V, BOTTOM_SHARE * (top - bottom))
    # Under a heavy load a cell is not empty at its lowest voltage.
    voltage = log.voltage_V + (step_resistance(log) or 0.0) * log.known_current_A()
    last = int(np.nanargmin(voltage))
    full = np.flatnonzero(voltage[: last + 1] >= full_V)
    if full.size == 0 or voltage[last] > empty_V:
        return None
    empty = np.flatnonzero(voltage[: int(full[-1])] <= empty_V)
    begun = full[full > empty[-1]] if empty.size else full
    charge = log.counted_charge_Ah()
    moved = float(charge[last] - np.min(charge[begun]))
    return moved if moved > 0.0 else None


def step_resistance(log: CellLog) -> float | None:
    """Median answer of the voltage to the largest steps of the current [ohm]; None without some."""
    current, voltage = log.interval_current_A, log.voltage_V
    if len(log) <= STEP_ROWS:
        return None
    with np.errstate(invalid="ignore"):
        sudden = np.abs(np.diff(current)[: len(log) - STEP_ROWS]) > STEP_SHARE * np.nanmax(
            np.abs(current)
        )
        change = current[STEP_ROWS:] - current[:-STEP_ROWS]
        quick = log.time_s[STEP_ROWS:] - log.time_s[:-STEP_ROWS] <= LONGEST_STEP_S
        steps = quick & sudden & (np.abs(change) > STEP_SHARE * np.nanmax(np.abs(current)))
    answer = -(voltage[STEP_ROWS:] - voltage[:-STEP_ROWS])
    steps &= np.isfinite(answer)
    if np.count_nonzero(steps) < FEWEST_STEPS:
        return None
    found = float(np.median(answer[steps] / change[steps]))
    return found if found > 0.0 else None


def _tested(tests: TestLogs, default_C: float) -> list[Tested]:
    pulsed = [(log, t, True) for log, t in (*tests.hppc, *tests.drive)]
    steady = [(log, None, False) for log in (*tests.ocv, *tests.capacity)]
    found = {}
    for log, t, p in (*pulsed, *steady):
        stated, measured = (log_temperature_C(log, x, default_C) for x in (t, None))
        found[id(log)] = Tested(log, stated, p, min(stated, measured) >= WARM_C)
    return list(found.values())


def _check_charges(logs: Sequence[Tested], capacity_Ah: float, choice: str) -> None:
    """Refuse logs that move several times the capacity, or that are empty after a small part."""
    for one in logs:
        moved, among = float(np.ptp(one.log.counted_charge_Ah())), ""
        whole = whole_charge_Ah(one.log, logs)
        if moved <= FAR_CHARGE * capacity_Ah:
            if whole is None or whole * FAR_BELOW >= capacity_Ah:
                continue
            moved, among = whole, " from full to empty"
        raise InputError(
            f"'{one.log.name}' that moves {moved:.4g} Ah{among} for a cell of {capacity_Ah:.4g} Ah "
            f"({choice})",
            "logs of one cell, with current in ampere",
            "Check the unit of the current (mA for A?), `parallel=N`, and the capacity.",
        )


def _check_voltages(logs: Sequence[Tested]) -> None:
    """Refuse a pack beside a cell."""
    highest = [float(np.nanmax(one.log.voltage_V)) for one in logs]
    for low, high in combinations(np.argsort(highest), 2):
        if highest[high] > OTHER_VOLTAGE * highest[low]:
            raise InputError(
                f"up to {highest[high]:.3g} V in '{logs[high].log.name}' beside "
                f"{highest[low]:.3g} V in '{logs[low].log.name}'",
                "logs of one cell",
                "Other cells in series? Read that log alone with its own `series=N`, and write it "
                "as a log of one cell (write_log, cellwise convert).",
            )


def _charges(logs: Sequence[Tested]) -> list[Notice]:
    """The two logs that went from full to empty with the most different charges."""
    whole = [(one, q) for one in logs if (q := whole_charge_Ah(one.log, logs)) is not None]
    worst: Notice | None = None
    for (a, qa), (b, qb) in combinations(whole, 2):
        (small, least), (large, most) = sorted(((a, qa), (b, qb)), key=lambda x: x[1])
        ratio = most / least
        if ratio <= OTHER_CHARGE:
            continue
        said = (
            f"'{large.log.name}' moves {most:.4g} Ah from full to empty, '{small.log.name}' "
            f"{least:.4g} Ah"
        )
        if ratio > FAR_CHARGE:
            raise InputError(
                said,
                "logs of one cell, in one scale",
                "Leave one of them out, or check the unit of its current (mA for A?).",
            )
        notice = Notice(RANGE_V * math.log(ratio), f"{said}: logs of one cell, in one scale?")
        worst = max((n for n in (worst, notice) if n is not None), key=lambda n: n.size_V)
    return [] if worst is None else [worst]


def _scales(logs: Sequence[Tested]) -> list[Notice]:
    """The two logs whose voltages answer their currents most differently."""
    seen = [(one, r) for one in logs if one.pulsed and (r := step_resistance(one.log))]
    worst: Notice | None = None
    for (a, ra), (b, rb) in combinations(seen, 2):
        ratio = max(ra, rb) / min(ra, rb)
        if abs(a.temperature_C - b.temperature_C) > OTHER_TEMPERATURE_K or ratio <= OTHER_SCALE:
            continue
        said = (
            f"'{a.log.name}' answers a current step with {1e3 * ra:.3g} mohm, '{b.log.name}' with "
            f"{1e3 * rb:.3g} mohm"
        )
        if ratio > IMPOSSIBLE_SCALE:
            raise InputError(
                said,
                "logs of one cell, with current in ampere and voltage in volt",
                "Check the units (mA for A?) and the cells in parallel of the two.",
            )
        text = f"{said}: logs of one cell, in one scale and at the temperatures stated?"
        notice = Notice(RANGE_V * math.log(ratio), text)
        worst = max((n for n in (worst, notice) if n is not None), key=lambda n: n.size_V)
    return [] if worst is None else [worst]


def _temperatures(tests: TestLogs, logs: Sequence[Tested]) -> list[Notice]:
    """Stated temperatures that contradict the measured ones, or the resistances."""
    notices = []
    for log, stated in (*tests.hppc, *tests.drive):
        found = None if stated is None else other_temperature(log, stated)
        if found is not None:
            off_K, text = found
            notices.append(Notice(DROP_AT_1C_V * math.expm1(PER_KELVIN * off_K), text))
    pulses = {id(log) for log, _ in tests.hppc}
    seen = [(o, r) for o in logs if id(o.log) in pulses and (r := step_resistance(o.log))]
    for a, b in combinations(seen, 2):
        (cold, at_cold), (warm, at_warm) = sorted((a, b), key=lambda x: x[0].temperature_C)
        colder = warm.temperature_C - cold.temperature_C
        if colder >= COLDER_K and at_cold < LESS_RESISTANCE * at_warm:
            text = (
                f"'{cold.log.name}' at {cold.temperature_C:.0f} degC answers a current step with "
                f"{1e3 * at_cold:.3g} mohm, '{warm.log.name}' at {warm.temperature_C:.0f} degC "
                f"with {1e3 * at_warm:.3g} mohm: a cold cell has more, are they exchanged?"
            )
            notices.append(Notice(DROP_AT_1C_V * math.expm1(PER_KELVIN * colder), text))
    return notices
