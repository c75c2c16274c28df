"""The laboratory tests, each as the list of steps a technician would program."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .cells import LFP, NMC, CellSetup
from .missions import flight_current, orbit_steps
from .tester import ConstantCurrent, ConstantVoltage, Profile, Rest, RowPlan, Step
from .vehicle import MOTORWAY, RURAL, URBAN, Style, Vehicle, depleting_cycle, drive_current

HOUR = 3600.0
ROOM_C = 25.0
FOREVER = 1e9

SLOW: RowPlan = ((10.0, 1.0), (60.0, 10.0), (FOREVER, 60.0))
MEDIUM: RowPlan = ((10.0, 1.0), (FOREVER, 10.0))
PULSE_10HZ: RowPlan = ((FOREVER, 0.1),)
ONE_HZ: RowPlan = ((FOREVER, 1.0),)
RELAX_10HZ: RowPlan = ((20.0, 0.1), (120.0, 1.0), (600.0, 10.0), (FOREVER, 60.0))
RELAX_1HZ: RowPlan = ((300.0, 1.0), (900.0, 10.0), (FOREVER, 60.0))
RELAX: RowPlan = ((30.0, 1.0), (300.0, 10.0), (FOREVER, 60.0))

StepSource = Callable[[np.random.Generator], list[Step]]


@dataclass(frozen=True)
class Test:
    """One test: what the catalogue says of it, and its steps.

    Attributes
    ----------
    name : str            `<cell>_<test>`
    cell : CellSetup
    kind : str            capacity, ocv, hppc or drive
    description : str
    range_A : float       current range of the tester [A]
    steps : callable      generator -> steps, drives draw their route from it
    rate : str            C rate where the test has one, else empty
    ambient_C : float     temperature of the chamber [degC]
    """

    name: str
    cell: CellSetup
    kind: str
    description: str
    range_A: float
    steps: StepSource
    rate: str = ""
    ambient_C: float = ROOM_C


def charge_full(cell: CellSetup, rows: RowPlan = MEDIUM) -> list[Step]:
    """CC-CV charge at C/3 to the upper limit and the cell's cut-off current."""
    return [
        ConstantCurrent(-cell.nominal_Ah / 3.0, rows),
        ConstantVoltage(-1.0, cell.charge_cutoff_A, rows),
    ]


def capacity_steps(cell: CellSetup, c_rate: float, rows: RowPlan, with_cv: bool) -> list[Step]:
    """Rest, CC discharge (then CV), rest, CC-CV charge, rest."""
    steps: list[Step] = [
        Rest(HOUR, RELAX),
        ConstantCurrent(c_rate * cell.nominal_Ah, rows),
    ]
    if with_cv:
        steps.append(ConstantVoltage(1.0, cell.discharge_cutoff_A, MEDIUM))
    return [*steps, Rest(HOUR, RELAX), *charge_full(cell), Rest(0.5 * HOUR, RELAX)]


def ocv_steps(cell: CellSetup) -> list[Step]:
    """C/20 down, an hour of rest, C/20 up, all in rows of 60 s."""
    current = cell.nominal_Ah / 20.0
    return [
        Rest(HOUR, RELAX),
        ConstantCurrent(current, SLOW),
        Rest(HOUR, RELAX),
        ConstantCurrent(-current, SLOW),
        Rest(HOUR, RELAX),
    ]


def discharge_hppc_steps(cell: CellSetup, hours_of_rate: float) -> list[Step]:
    """Ten discharges of 10 % each, an hour of rest after each (NCR18650B paper, one rate)."""
    current = cell.nominal_Ah / hours_of_rate
    seconds = 0.1 * cell.nominal_Ah / current * HOUR
    steps: list[Step] = [Rest(HOUR, RELAX)]
    for _ in range(10):
        steps += [ConstantCurrent(current, ONE_HZ, seconds), Rest(HOUR, RELAX_1HZ)]
    return steps


def multirate_hppc_steps(cell: CellSetup) -> list[Step]:
    """At each 10 %: 10 s discharge, 40 s rest, 10 s charge at three rates; then C/3 onwards."""
    nominal = cell.nominal_Ah
    steps: list[Step] = [Rest(HOUR, RELAX)]
    for level in range(11):
        for c_rate in (0.5, 1.0, 2.0):
            steps += [
                ConstantCurrent(c_rate * nominal, PULSE_10HZ, 10.0, hold_at_limit=True),
                Rest(40.0, PULSE_10HZ),
                ConstantCurrent(-c_rate * nominal, PULSE_10HZ, 10.0, hold_at_limit=True),
                Rest(600.0, RELAX_10HZ),
            ]
        seconds = 1080.0 if level < 10 else HOUR
        steps += [ConstantCurrent(nominal / 3.0, MEDIUM, seconds), Rest(HOUR, RELAX_10HZ)]
    return steps


# Shares of the nominal capacity moved after each of the 18 tests; 5 % where the paper's tables
# need the detail (both ends), 10 % in the flat middle. The last move stops at the lower limit.
LFP_MOVES = (*(0.05,) * 7, *(0.10,) * 3, *(0.05,) * 6, 0.025, 0.05)


def paired_hppc_steps(cell: CellSetup) -> list[Step]:
    """18 tests of 60 s pulse pairs at four rates (LFP040AHA paper), 20 min of rest between.

    Discharge comes first in the upper half and charge first in the lower half, so that the
    first pulse of a pair leads away from the limit; the second may still be trimmed by it.
    """
    nominal = cell.nominal_Ah
    relax: RowPlan = ((15.0, 0.1), (240.0, 1.0), (FOREVER, 20.0))
    steps: list[Step] = [Rest(HOUR, RELAX)]
    soc = 1.0
    for move in LFP_MOVES:
        first = 1.0 if soc > 0.5 else -1.0
        for c_rate in (0.5, 1.0, 2.0, 3.0):
            for sign in (first, -first):
                steps += [
                    ConstantCurrent(sign * c_rate * nominal, PULSE_10HZ, 60.0, hold_at_limit=True),
                    Rest(1200.0, relax),
                ]
        seconds = move / 0.5 * HOUR
        steps += [ConstantCurrent(0.5 * nominal, MEDIUM, seconds), Rest(1200.0, relax)]
        soc -= move
    return steps


# One car, packs of different size: a small one in town, so that all routes work the cell.
PACK_CELLS = {"urban": 1000, "motorway": 1900, "mixed": 1500}
HYBRID = Vehicle(cells=2600, cell_V=3.25, peak_A=7.5, regen_A=5.0)


def drive_steps(styles: tuple[Style, ...], cells: int, depth_Ah: float) -> StepSource:
    """Rest, a drive that takes `depth_Ah` from the full cell, rest."""
    car = Vehicle(cells=cells, cell_V=3.65, peak_A=14.5, regen_A=7.5)

    def steps(rng: np.random.Generator) -> list[Step]:
        current = drive_current(styles, car, depth_Ah, rng)
        return [Rest(1800.0, RELAX), Profile(current), Rest(1800.0, RELAX_1HZ)]

    return steps


def depleting_steps(cell: CellSetup, cycles: int) -> StepSource:
    """The same 420 s cycle over and over, 3.3 % of nominal each, until nearly empty."""

    def steps(rng: np.random.Generator) -> list[Step]:
        one = depleting_cycle(HYBRID, 0.033 * cell.nominal_Ah, 420, rng)
        return [Rest(HOUR, RELAX), *(Profile(one) for _ in range(cycles)), Rest(HOUR, RELAX_1HZ)]

    return steps


def orbiting_steps(cell: CellSetup, orbits: int) -> StepSource:
    """Rest, orbits, rest."""

    def steps(rng: np.random.Generator) -> list[Step]:
        return [
            Rest(1800.0, RELAX),
            *orbit_steps(cell.nominal_Ah, orbits, rng),
            Rest(1800.0, RELAX),
        ]

    return steps


def flying_steps(cell: CellSetup, hovers_s: tuple[float, ...]) -> StepSource:
    """Rest, flights with ten minutes on the ground between them, rest."""

    def steps(rng: np.random.Generator) -> list[Step]:
        flights: list[Step] = []
        for hover in hovers_s:
            flights += [Profile(flight_current(cell.nominal_Ah, hover, rng)), Rest(600.0, RELAX)]
        return [Rest(1800.0, RELAX), *flights, Rest(1800.0, RELAX_1HZ)]

    return steps


def _fixed(steps: list[Step]) -> StepSource:
    return lambda _rng: steps


def _capacity(
    cell: CellSetup, tag: str, rate: str, c_rate: float, range_A: float, rows: RowPlan
) -> Test:
    with_cv = cell is LFP
    end = ", then CV until nearly no current" if with_cv else ""
    return Test(
        name=f"{cell.key}_cap_{tag}",
        cell=cell,
        kind="capacity",
        description=(
            f"From full (CC-CV, 60 min rest): {rate} discharge to {cell.lower_V} V{end}, "
            f"60 min rest, CC-CV charge at C/3 to {cell.upper_V} V and "
            f"{1000 * cell.charge_cutoff_A:.0f} mA, 30 min rest"
        ),
        range_A=range_A,
        steps=_fixed(capacity_steps(cell, c_rate, rows, with_cv)),
        rate=rate,
    )


def _ocv(cell: CellSetup) -> Test:
    return Test(
        name=f"{cell.key}_ocv_c20",
        cell=cell,
        kind="ocv",
        description="From full: C/20 discharge to the lower limit, 60 min rest, C/20 charge to "
        "the upper limit without CV, 60 min rest",
        range_A=1.0,
        steps=_fixed(ocv_steps(cell)),
        rate="C/20",
    )


def _discharge_hppc(tag: str, hours_of_rate: float, range_A: float) -> Test:
    seconds = 0.1 * hours_of_rate * HOUR
    return Test(
        name=f"nmc_hppc_{tag}",
        cell=NMC,
        kind="hppc",
        description=f"From full: ten discharges of 10 % of nominal at C/{hours_of_rate:.0f} "
        f"({seconds:.0f} s each, or to 2.5 V), 3600 s rest after each; 1 s rows in the pulse",
        range_A=range_A,
        steps=_fixed(discharge_hppc_steps(NMC, hours_of_rate)),
        rate=f"C/{hours_of_rate:.0f}",
    )


def _hppc(name: str, ambient_C: float) -> Test:
    return Test(
        name=name,
        cell=NMC,
        kind="hppc",
        description="From full, at each 10 % of nominal: 10 s discharge, 40 s rest, 10 s charge at "
        "0.5C, 1C and 2C, 10 min apart, 10 Hz rows; then 10 % at C/3 and 60 min rest, to 2.5 V",
        range_A=20.0,
        steps=_fixed(multirate_hppc_steps(NMC)),
        ambient_C=ambient_C,
    )


def _drive(
    name: str, styles: tuple[Style, ...], depth_Ah: float, character: str, ambient_C: float = ROOM_C
) -> Test:
    return Test(
        name=name,
        cell=NMC,
        kind="drive",
        description=f"From full: stochastic {character} driving in rows of 1 s until "
        f"{depth_Ah} Ah are asked for, 30 min rest; peaks and regeneration trimmed at the limits",
        range_A=20.0,
        steps=drive_steps(styles, PACK_CELLS[character], depth_Ah),
        ambient_C=ambient_C,
    )


TESTS: tuple[Test, ...] = (
    _ocv(NMC),
    _capacity(NMC, "c20", "C/20", 1.0 / 20.0, 1.0, SLOW),
    _capacity(NMC, "c5", "C/5", 1.0 / 5.0, 5.0, MEDIUM),
    _capacity(NMC, "c3", "C/3", 1.0 / 3.0, 5.0, MEDIUM),
    _hppc("nmc_hppc", ROOM_C),
    _drive("nmc_drive_a", (URBAN,), 4.75, "urban"),
    _drive("nmc_drive_b", (MOTORWAY,), 4.70, "motorway"),
    _drive("nmc_drive_c", (URBAN, URBAN, RURAL, MOTORWAY), 4.80, "mixed"),
    _hppc("nmc_hppc_p00", 0.0),
    _drive("nmc_drive_p00", (URBAN, URBAN, RURAL), 4.0, "mixed", 0.0),
    Test(
        name="nmc_leo",
        cell=NMC,
        kind="orbit",
        description="From full: 12 low earth orbits of 90 min, 36 in eclipse (about 30 % of "
        "nominal, payload on for some minutes) and 54 of charge at 0.4C held at 4.2 V, 30 min rest",
        range_A=5.0,
        steps=orbiting_steps(NMC, 12),
    ),
    Test(
        name="nmc_flight",
        cell=NMC,
        kind="flight",
        description="From full: three multicopter flights of 8, 12 and 13 min in gusts (1C to "
        "2.4C, rows of 1 s), 10 min on the ground after each, 30 min rest; limits held",
        range_A=20.0,
        steps=flying_steps(NMC, (480.0, 720.0, 780.0)),
    ),
    _discharge_hppc("c20", 20.0, 1.0),
    _discharge_hppc("c5", 5.0, 5.0),
    _discharge_hppc("c3", 3.0, 5.0),
    _ocv(LFP),
    _capacity(LFP, "0p5c", "0.5C", 0.5, 5.0, MEDIUM),
    _capacity(LFP, "1c", "1C", 1.0, 5.0, ((FOREVER, 5.0),)),
    _capacity(LFP, "2c", "2C", 2.0, 5.0, ((FOREVER, 2.0),)),
    _capacity(LFP, "3c", "3C", 3.0, 10.0, ONE_HZ),
    Test(
        name="lfp_hppc",
        cell=LFP,
        kind="hppc",
        description="From full, 18 tests: 60 s pulse pairs of 0.5C, 1C, 2C, 3C with 20 min rest "
        "after each pulse, then 5 % or 10 % of nominal at 0.5C; discharge pulse first above "
        "50 %, charge pulse first below; 10 Hz rows; pulses at the ends trimmed by the limits",
        range_A=10.0,
        steps=_fixed(paired_hppc_steps(LFP)),
    ),
    Test(
        name="lfp_cdc",
        cell=LFP,
        kind="drive",
        description="From full: 30 charge-depleting cycles of 420 s and 3.3 % of nominal each, "
        "rows of 1 s, limits held, 60 min rest",
        range_A=10.0,
        steps=depleting_steps(LFP, 30),
    ),
)
