"""The panel: measured cells, easy and hard starts, faults; each case with its true SOC.

Models are identified once and kept. Judged are logs that no fit has seen, by the tester's counter
over the laboratory's capacity; where the cold's capacity is not the laboratory's, by the nearest of
those stated for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.accuracy.lfp import CHAMBER_C, chamber_log, drive, model_without
from benchmarks.accuracy.lfp import REFERENCE_AH as LFP_AH
from benchmarks.measured_data import measured_log
from cellwise import CellTests, IdentifySettings, identify_cell
from cellwise.benchmark.faults import Fault, faulty_log, faulty_model
from cellwise.cell.model import CellModel
from cellwise.cell.model_file import read_model, write_model
from cellwise.fit.start import initial_soc
from cellwise.logs import CellLog
from cellwise.typing import FloatArray

PANASONIC, LG, SAMSUNG = "panasonic_18650pf", "lg_18650hg2", "samsung_30q_ageing"
PANASONIC_AH = 2.997
COLD_AH = (2.8, 2.9, PANASONIC_AH)
PULSED_AH = (2.833, PANASONIC_AH)  # full to empty by the pulse test's own cut-off, and at C/20
WARM_C = {"p25": 25.0, "p10": 10.0, "p00": 0.0, "n10": -10.0, "n20": -20.0}
FITTED = ("cycle_2", "cycle_4", "us06")
STARTS = ((0.65, -0.30), (0.50, 0.30))
KNOWN, GUESSED = 0.005, 0.15
LOADED, RESTING = 0.35, 0.005  # of 1C
RESTED_ROWS = 60
LFP_TAGS = ("n15", "p05", "p25", "p45")
FAULTS = (
    Fault("voltage +30 mV", voltage_offset_V=0.03),
    Fault("voltage -30 mV", voltage_offset_V=-0.03),
    Fault("current +3 % of 1C", current_offset_C=0.03),
    Fault("current -3 % of 1C", current_offset_C=-0.03),
    Fault("gain 3 %", current_gain=1.03),
    Fault("voltage 0.2 s late", voltage_lag_samples=2),  # of 0.1 s
    Fault("capacity 10 % less", capacity=0.9),
)


@dataclass(frozen=True)
class Case:
    """One replay: a model, a log, a start, and the SOC by each capacity that may be the true one.

    ``log_name`` is what cases have in common that are no evidence of their own.
    """

    group: str
    log_name: str
    model: CellModel
    log: CellLog
    soc0: float
    std: float
    truths: tuple[FloatArray, ...]


def kept(folder: Path, name: str, make: Callable[[], CellModel]) -> CellModel:
    """A model that was identified before, else now."""
    file = folder / f"{name}.json"
    if not file.exists():
        write_model(make(), file)
    return read_model(file)


def with_fault(
    fault: Fault, model: CellModel, log: CellLog, capacity_Ah: float
) -> tuple[CellModel, CellLog]:
    """Model and log as a filter has them."""
    seen = faulty_log(fault, log, capacity_Ah, np.random.default_rng(0))
    return faulty_model(fault, model), seen


def counter(log: CellLog) -> FloatArray:
    """What the tester counted since the first row [Ah]."""
    if log.charge_Ah is None:
        charge = np.cumsum(log.current_A * log.interval_s) / 3600.0
        return np.asarray(charge - charge[0])
    return np.asarray(log.charge_Ah - log.charge_Ah[0])


def cases(data: Path, keep: Path) -> Iterator[Case]:
    """All of them; cells whose data are not there are left out."""
    for part in (panasonic, faulty, colder, lfp, lg, samsung):
        yield from part(data, keep)


def of_all_temperatures(data: Path) -> CellModel:
    """Panasonic: pulses and three drives at every temperature."""
    hppc = tuple((measured_log(data, f"{PANASONIC}/hppc_{t}"), c) for t, c in WARM_C.items())
    drives = tuple(
        (replace(measured_log(data, f"{PANASONIC}/drive_{t}_{n}"), soc0=1.0), c)
        for t, c in WARM_C.items()
        for n in FITTED
    )
    ocv = (measured_log(data, f"{PANASONIC}/ocv_c20_p25"),)
    tests = CellTests(hppc=hppc, ocv=ocv, drive=drives)
    return identify_cell(tests, IdentifySettings(nominal_Ah=2.9)).model


def of_pulses(data: Path) -> CellModel:
    """Panasonic: the pulse test at 25 degC alone, OCV and all."""
    tests = CellTests(hppc=((measured_log(data, f"{PANASONIC}/hppc_p25"), None),))
    return identify_cell(tests, IdentifySettings(nominal_Ah=2.9)).model


def from_start(
    group: str, model: CellModel, log: CellLog, capacities: tuple[float, ...], true0: float = 1.0
) -> Iterator[Case]:
    """From a start that is known, and from the same one that nobody vouches for."""
    truths = tuple(true0 - counter(log) / q for q in capacities)
    yield Case(f"{group}, known start", log.name, model, log, true0, KNOWN, truths)
    yield Case(f"{group}, true start, 15 points", log.name, model, log, true0, GUESSED, truths)


def misled(case: Case) -> Case:
    """A known start, as somebody stated it who was 30 points wrong: only a gate can find it."""
    return replace(case, group=f"{case.group}, 30 points wrong", soc0=case.soc0 - 0.3)


def from_middle(
    group: str,
    model: CellModel,
    log: CellLog,
    capacities: tuple[float, ...],
    starts: tuple[tuple[float, float], ...] = STARTS,
) -> Iterator[Case]:
    """Cut under load, 30 points wrong; nothing tells that the cell was full."""
    whole = 1.0 - counter(log) / capacities[-1]
    for at, wrong in starts:
        row = int(np.argmax(whole < at))
        row += int(np.argmax(log.current_A[row:] > LOADED * capacities[-1]))
        truths = tuple((1.0 - counter(log) / q)[row:] for q in capacities)
        part = log.part(row, len(log))
        start = min(max(float(whole[row]) + wrong, 0.0), 1.0)
        yield Case(f"{group}, 30 points wrong", log.name, model, part, start, GUESSED, truths)


def at_rest(
    group: str, model: CellModel, log: CellLog, capacities: tuple[float, ...]
) -> Iterator[Case]:
    """Cut in a rest, 30 points wrong either way."""
    whole = 1.0 - counter(log) / capacities[-1]
    resting = np.abs(log.current_A) < RESTING * capacities[-1]
    row = int(np.argmax((whole < STARTS[0][0]) & resting & np.roll(resting, -RESTED_ROWS)))
    part = log.part(row, len(log))
    truths = tuple((1.0 - counter(log) / q)[row:] for q in capacities)
    for wrong in (-0.3, 0.3):
        start = min(max(float(whole[row]) + wrong, 0.0), 1.0)
        yield Case(
            f"{group}, 30 points wrong at rest", log.name, model, part, start, GUESSED, truths
        )


def named(data: Path, cell: str, name: str) -> CellLog:
    """A log under its own name."""
    return replace(measured_log(data, f"{cell}/{name}"), name=name)


def panasonic(data: Path, keep: Path) -> Iterator[Case]:
    """Drives at five temperatures that the model has not seen."""
    model = kept(keep, "panasonic_all", lambda: of_all_temperatures(data))
    for t in WARM_C:
        capacities = COLD_AH if t in ("n10", "n20") else (PANASONIC_AH,)
        for n in ("nn", "hwfta", "cycle_3") if t == "p25" else ("nn", "la92", "cycle_1"):
            log = named(data, PANASONIC, f"drive_{t}_{n}")
            group = "Panasonic, cold" if t in ("n10", "n20", "p00") else "Panasonic, warm"
            yield from from_start(group, model, log, capacities)
            yield misled(next(from_start(group, model, log, capacities)))
            yield from from_middle(group, model, log, capacities)


def faulty(data: Path, keep: Path) -> Iterator[Case]:
    """The same cell with one thing wrong, from a known start and from 30 points wrong."""
    model = kept(keep, "panasonic_all", lambda: of_all_temperatures(data))
    for n in ("p25_nn", "p25_hwfta", "p00_nn", "p00_la92"):
        log = named(data, PANASONIC, f"drive_{n}")
        for fault in FAULTS:
            wrong, seen = with_fault(fault, model, log, PANASONIC_AH)
            group = f"Panasonic, {fault.name}"
            truths = (PANASONIC_AH,)
            yield from from_middle(group, wrong, seen, truths, STARTS[1:])
            yield next(from_start(group, wrong, seen, truths))


def colder(data: Path, keep: Path) -> Iterator[Case]:
    """A model of pulses at 25 degC: warm, beyond its data, and after a charge from empty."""
    model = kept(keep, "panasonic_pulses", lambda: of_pulses(data))
    for n in ("p25_nn", "p25_hwfta", "p10_nn", "p00_nn"):
        log = named(data, PANASONIC, f"drive_{n}")
        group = "Model of 25 degC pulses" if n[:3] == "p25" else "Model of 25 degC in the cold"
        yield from from_start(group, model, log, PULSED_AH)
        yield from from_middle(group, model, log, PULSED_AH)
    slow = named(data, PANASONIC, "ocv_c20_p25")
    empty = int(np.argmin(slow.voltage_V))
    for n in ("p25_nn", "p25_hwfta", "p25_cycle_3"):
        driven = named(data, PANASONIC, f"drive_{n}")
        yield charged_first(model, slow.part(empty, len(slow)), driven, PULSED_AH)


def charged_first(
    model: CellModel, charge: CellLog, driven: CellLog, capacities: tuple[float, ...]
) -> Case:
    """Charged from empty, then driven from full; the start is read from the log."""
    log = joined(charge, driven)
    counted = counter(log)
    full = counted[len(charge) - 1]
    start = initial_soc(model, log)
    truths = tuple(1.0 - (counted - full) / q for q in capacities)
    group = "Charged from empty, then driven"
    return Case(group, driven.name, model, log, start.soc, start.std, truths)


def joined(first: CellLog, second: CellLog) -> CellLog:
    """One after the other, a second apart."""
    later = second.time_s - second.time_s[0] + first.time_s[-1] - first.time_s[0] + 1.0
    warm = None
    if first.temperature_C is not None and second.temperature_C is not None:
        warm = np.concatenate((first.temperature_C, second.temperature_C))
    before = counter(first)
    return CellLog(
        np.concatenate((first.time_s - first.time_s[0], later)),
        np.concatenate((first.current_A, second.current_A)),
        np.concatenate((first.voltage_V, second.voltage_V)),
        warm,
        np.concatenate((before, before[-1] + counter(second))),
        name=second.name,
    )


def lfp(data: Path, keep: Path) -> Iterator[Case]:
    """A123, the temperature left out of the fit: plateau, faults, charged first."""
    plateau = ((0.65, -0.3), (0.5, 0.3), (0.5, -0.3))
    for tag in LFP_TAGS:
        model = kept(keep, f"lfp_without_{tag}", lambda tag=tag: model_without(data, tag))
        log = drive(data, tag)
        truths = (LFP_AH,)
        yield from from_start("LFP", model, log, truths)
        yield misled(next(from_start("LFP", model, log, truths)))
        yield from from_middle("LFP", model, log, truths, plateau)
        yield from at_rest("LFP", model, log, truths)
        for fault in FAULTS[:4]:  # either sign is one group
            wrong, seen = with_fault(fault, model, log, LFP_AH)
            kind = fault.name.replace("+", "").replace("-", "")
            yield from from_start(f"LFP, {kind} off", wrong, seen, truths)
        slow = chamber_log(data, f"ocv_{tag}_s1", CHAMBER_C[tag], None)
        yield from from_start("LFP, C/30", model, slow, truths)
        charge = chamber_log(data, f"dyn_{tag}_s3", CHAMBER_C["p25"], None)
        yield charged_first(model, charge, log, (LFP_AH,))


def lg(data: Path, keep: Path) -> Iterator[Case]:
    """A model of slow, constant currents and short loads, driven in the cold."""

    def make() -> CellModel:
        tags = ("p25", "p10", "p00", "n10", "n20")
        ocv = (measured_log(data, f"{LG}/ocv_c20_p25_549"),)
        names = ("cap_1c_p25_551", "cap_1c_p10_576", "cap_1c_p00_589", "cap_1c_n10_596")
        loads = ("p10_571", "p00_590", "n10_604", "n20_611")
        drives = tuple(
            (measured_log(data, f"{LG}/pauscycl_{n}"), WARM_C[t])
            for t in tags
            for n in loads
            if n.startswith(t)
        )
        rates = tuple((measured_log(data, f"{LG}/{n}"), None) for n in names)
        tests = CellTests(ocv=ocv, drive=(*drives, *rates))
        return identify_cell(tests, IdentifySettings(nominal_Ah=3.0)).model

    model = kept(keep, "lg", make)
    for n in ("us06_n10_601", "us06_n20_610"):
        log = named(data, LG, f"drive_{n}")
        yield from from_start("LG", model, log, (2.78,))
        yield from from_middle("LG", model, log, (2.78,))


def samsung(data: Path, keep: Path) -> Iterator[Case]:
    """A model of the fresh cell's pulses, one discharge of it at every age."""

    def make() -> CellModel:
        name = f"{SAMSUNG}/hppc_dnn01_1c_p20_time_rebuilt"
        tests = CellTests(hppc=((measured_log(data, name), None),))
        return identify_cell(tests, IdentifySettings(nominal_Ah=3.0)).model

    model = kept(keep, "samsung", make)
    for cycle in ("001", "441", "541", "641"):
        log = named(data, SAMSUNG, f"d1_cellA_cycle{cycle}")
        discharge = log.part(0, int(np.argmin(log.voltage_V)) + 1)
        capacity = (float(counter(discharge)[-1]),)
        yield from from_start("Samsung, aged", model, discharge, capacity)
