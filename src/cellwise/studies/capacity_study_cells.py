"""Cells for the capacity study: embedded ones, measured ones, and the papers' order beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from cellwise.data import list_datasets, load_dataset
from cellwise.errors import InputError
from cellwise.identify.identification import IdentifySettings, TestLogs
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.studies.capacity_study import JudgedLog, StudyCell
from cellwise.studies.published import LFP_ERRORS, NCA_RESIDUALS

NMC_RATES = {"rate:C/20": "c20", "rate:C/5": "c5", "rate:C/3": "c3"}
NMC_DRIVES = ("nmc_drive_b", "nmc_drive_c")
LFP_RATES = ("0p5c", "1c", "2c", "3c")
# The LFP paper's choices over what its cell gave with CC and CV.
LFP_WHOLE = "cc-cv-average"
PAPER_RATIOS = {
    f"as {row.capacity_Ah:g} of {LFP_ERRORS[LFP_WHOLE].capacity_Ah:g}": row.capacity_Ah
    / LFP_ERRORS[LFP_WHOLE].capacity_Ah
    for name, row in LFP_ERRORS.items()
    if name != LFP_WHOLE
}


def published_orders() -> dict[str, tuple[str, ...]]:
    """Choices of both papers from the smallest voltage RMSE to the largest."""
    lfp = sorted(LFP_ERRORS.items(), key=lambda item: item[1].rms_mV)
    nca = sorted(NCA_RESIDUALS.items(), key=lambda item: item[1].rmse_mV)
    return {
        "lfp": tuple(name for name, _ in lfp),
        "ncr18650b": tuple(f"rate:{rate}" for rate, _ in nca),
    }


def _tests(
    read: Callable[[str], CellLog],
    *,
    hppc: Iterable[str] = (),
    ocv: Iterable[str] = (),
    capacity: Iterable[str] = (),
    drive: Iterable[str] = (),
) -> TestLogs:
    """Tests by the names of their logs."""
    return TestLogs(
        hppc=tuple((read(name), None) for name in hppc),
        ocv=tuple(read(name) for name in ocv),
        capacity=tuple(read(name) for name in capacity),
        drive=tuple((read(name), None) for name in drive),
    )


def _embedded(name: str, nominal_Ah: float, judged: Iterable[str], tests: TestLogs) -> StudyCell:
    """A cell of the physics models; their catalogue knows its capacity and where its logs begin."""
    entries = [_entry(log) for log in judged]
    return StudyCell(
        name=name,
        tests=tests,
        judged=tuple(
            JudgedLog(load_dataset(str(e["name"])), float(str(e["initial_soc"]))) for e in entries
        ),
        reference_Ah=float(str(entries[0]["true_capacity_Ah"])),
        reference="the physics model's own inventory",
        settings=IdentifySettings(nominal_Ah=nominal_Ah, name=name),
    )


def embedded_nmc() -> StudyCell:
    """NMC cell of the physics model: three capacity tests, two drives it has not seen."""
    tests = _tests(
        load_dataset,
        hppc=["nmc_hppc"],
        ocv=["nmc_ocv_c20"],
        capacity=[f"nmc_cap_{tag}" for tag in NMC_RATES.values()],
        drive=["nmc_drive_a"],
    )
    return _embedded("embedded NMC", 5.0, NMC_DRIVES, tests)


def embedded_nmc_rates() -> StudyCell:
    """The same cell characterized at one rate at a time, as in the NCR18650B paper."""
    cell = _embedded("embedded NMC", 5.0, NMC_DRIVES, TestLogs())
    tests = {
        choice: _tests(load_dataset, hppc=[f"nmc_hppc_{tag}"], capacity=[f"nmc_cap_{tag}"])
        for choice, tag in NMC_RATES.items()
    }
    return replace(cell, name="embedded NMC, one rate", tests_of=tests)


def embedded_lfp() -> StudyCell:
    """LFP cell of the physics model on a charge-depleting cycle, with the LFP paper's ratios."""
    capacity = [f"lfp_cap_{rate}" for rate in LFP_RATES]
    tests = _tests(load_dataset, hppc=["lfp_hppc"], capacity=capacity)
    cell = _embedded("embedded LFP", 2.3, ["lfp_cdc"], tests)
    return replace(
        cell,
        settings=replace(cell.settings, chemistry="LFP"),
        values_Ah={name: ratio * 2.3 for name, ratio in PAPER_RATIOS.items()},
    )


def panasonic(data: Path) -> StudyCell:
    """Panasonic 18650PF at 25 degC."""
    read = _reader(data / "panasonic_18650pf")
    return StudyCell(
        name="Panasonic 18650PF",
        tests=_tests(
            read,
            hppc=["hppc_p25"],
            ocv=["ocv_c20_p25"],
            capacity=["ocv_c20_p25", "cap_1c_p25_start_1", "cap_1c_p25_start_2"],
            drive=["drive_p25_cycle_2"],
        ),
        judged=tuple(JudgedLog(read(f"drive_p25_{n}"), 1.0) for n in ("us06", "hwfta", "nn")),
        reference_Ah=2.997,
        reference="the C/20 discharge",
        settings=IdentifySettings(nominal_Ah=2.9, name="Panasonic 18650PF"),
    )


def a123(data: Path) -> StudyCell:
    """A123 26650 (LFP) at 25 degC, with the LFP paper's ratios to its full charge."""
    read, whole = _reader(data / "plett_a123"), 2.0725
    low_rate = [f"ocv_p25_s{k}" for k in (1, 2, 3, 4)]
    drives = ["dyn_p35_s1", "dyn_p45_s1"]
    return StudyCell(
        name="A123 26650",
        tests=_tests(read, ocv=low_rate, capacity=low_rate[:1], drive=drives),
        judged=(JudgedLog(read("dyn_p25_s1"), 1.0),),
        reference_Ah=whole,
        reference="C/30 discharge at 25 degC to the last dither",
        settings=IdentifySettings(nominal_Ah=2.3, name="A123 26650", chemistry="LFP"),
        values_Ah={name: ratio * whole for name, ratio in PAPER_RATIOS.items()},
    )


def leaf(data: Path) -> StudyCell:
    """Nissan Leaf cell at 25 degC; there is no drive of it, so it is judged on 3C discharges."""
    read = _reader(data / "nissan_leaf")
    return StudyCell(
        name="Nissan Leaf",
        tests=_tests(read, hppc=["hppc_p25"], capacity=["cap_1c_p23", "cap_2c_p23"]),
        judged=(JudgedLog(read("cap_3c_p23"), 1.0),),
        reference_Ah=30.48,
        reference="all charge of the HPPC test",
        settings=IdentifySettings(nominal_Ah=33.1, name="Nissan Leaf"),
    )


def _reader(folder: Path) -> Callable[[str], CellLog]:
    """Reads a log of a folder of measured data by its name; each file once."""
    return cache(lambda name: read_log(folder / f"{name}.csv.gz"))


def _entry(name: str) -> dict[str, object]:
    return next(e for e in list_datasets() if e["name"] == name)


EMBEDDED: dict[str, Callable[[], StudyCell]] = {
    "embedded-nmc": embedded_nmc,
    "embedded-nmc-rates": embedded_nmc_rates,
    "embedded-lfp": embedded_lfp,
}
MEASURED: dict[str, Callable[[Path], StudyCell]] = {
    "panasonic": panasonic, "a123": a123, "leaf": leaf,
}  # fmt: skip


def study_cells(names: tuple[str, ...], data: Path | None) -> tuple[StudyCell, ...]:
    """Cells by name; no name means all embedded ones, and all measured ones if there is a folder.

    Raises
    ------
    InputError        an unknown name; a measured cell without the folder
    """
    wanted = names or (*EMBEDDED, *(MEASURED if data is not None else ()))
    unknown = [name for name in wanted if name not in EMBEDDED | MEASURED]
    if unknown:
        raise InputError(
            f"a cell '{unknown[0]}'",
            f"one of {', '.join((*EMBEDDED, *MEASURED))}",
            "Choose one of them.",
        )
    measured = [name for name in wanted if name in MEASURED]
    if data is None and measured:
        raise InputError(
            f"the measured cell '{measured[0]}' and no folder of measured data",
            "the folder",
            "Add `data=DIR` or set CELLWISE_DATA.",
        )
    made = EMBEDDED | {name: partial(MEASURED[name], data) for name in measured if data}
    return tuple(made[name]() for name in wanted)
