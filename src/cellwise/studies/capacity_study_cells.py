"""Cells for the capacity study: the embedded ones, and the papers' order beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from cellwise.data import list_datasets, load_dataset
from cellwise.errors import InputError
from cellwise.identify.identification import IdentifySettings, TestLogs
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
    tests = TestLogs(
        hppc=((load_dataset("nmc_hppc"), None),),
        ocv=(load_dataset("nmc_ocv_c20"),),
        capacity=tuple(load_dataset(f"nmc_cap_{tag}") for tag in NMC_RATES.values()),
        drive=((load_dataset("nmc_drive_a"), None),),
    )
    return _embedded("embedded NMC", 5.0, NMC_DRIVES, tests)


def embedded_nmc_rates() -> StudyCell:
    """The same cell characterized at one rate at a time, as in the NCR18650B paper."""
    cell = _embedded("embedded NMC", 5.0, NMC_DRIVES, TestLogs())
    tests = {
        choice: TestLogs(
            hppc=((load_dataset(f"nmc_hppc_{tag}"), None),),
            capacity=(load_dataset(f"nmc_cap_{tag}"),),
        )
        for choice, tag in NMC_RATES.items()
    }
    return replace(cell, name="embedded NMC, one rate", tests_of=tests)


def embedded_lfp() -> StudyCell:
    """LFP cell of the physics model on a charge-depleting cycle, with the LFP paper's ratios."""
    capacity = tuple(load_dataset(f"lfp_cap_{rate}") for rate in LFP_RATES)
    tests = TestLogs(hppc=((load_dataset("lfp_hppc"), None),), capacity=capacity)
    cell = _embedded("embedded LFP", 2.3, ["lfp_cdc"], tests)
    return replace(
        cell,
        settings=replace(cell.settings, chemistry="LFP"),
        values_Ah={name: ratio * 2.3 for name, ratio in PAPER_RATIOS.items()},
    )


def _entry(name: str) -> dict[str, object]:
    return next(e for e in list_datasets() if e["name"] == name)


EMBEDDED: dict[str, Callable[[], StudyCell]] = {
    "embedded-nmc": embedded_nmc,
    "embedded-nmc-rates": embedded_nmc_rates,
    "embedded-lfp": embedded_lfp,
}


def study_cells(names: tuple[str, ...]) -> tuple[StudyCell, ...]:
    """Embedded cells by name; no name means all.

    Raises
    ------
    InputError        an unknown name
    """
    unknown = [name for name in names if name not in EMBEDDED]
    if unknown:
        raise InputError(
            f"a cell '{unknown[0]}'", f"one of {', '.join(EMBEDDED)}", "Choose one of them."
        )
    return tuple(EMBEDDED[name]() for name in names or EMBEDDED)
