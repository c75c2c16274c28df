"""Cells for the capacity study: embedded ones, measured ones, and the papers' order beside them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cellwise.data import list_datasets, load_dataset
from cellwise.errors import InputError
from cellwise.identify.identification import IdentifySettings, TestLogs
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.studies.capacity_study import JudgedLog, StudyCell
from cellwise.studies.published import LFP_ERRORS, NCA_RESIDUALS

NMC_RATES = {"rate:C/20": "c20", "rate:C/5": "c5", "rate:C/3": "c3"}
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


def embedded_nmc() -> StudyCell:
    """NMC cell of the physics model: three capacity tests, two drives it has not seen."""
    return StudyCell(
        name="embedded NMC",
        tests=TestLogs(
            hppc=((load_dataset("nmc_hppc"), None),),
            ocv=(load_dataset("nmc_ocv_c20"),),
            capacity=tuple(load_dataset(f"nmc_cap_{tag}") for tag in NMC_RATES.values()),
            drive=((load_dataset("nmc_drive_a"), None),),
        ),
        judged=_embedded("nmc_drive_b", "nmc_drive_c"),
        reference_Ah=_true_capacity("nmc_drive_b"),
        reference="the physics model's own inventory",
        settings=IdentifySettings(nominal_Ah=5.0, name="embedded NMC"),
    )


def embedded_nmc_rates() -> StudyCell:
    """The same cell characterized at one rate at a time, as in the NCR18650B paper."""
    return StudyCell(
        name="embedded NMC, one rate",
        tests=TestLogs(),
        judged=_embedded("nmc_drive_b", "nmc_drive_c"),
        reference_Ah=_true_capacity("nmc_drive_b"),
        reference="the physics model's own inventory",
        settings=IdentifySettings(nominal_Ah=5.0, name="embedded NMC"),
        tests_of={
            choice: TestLogs(
                hppc=((load_dataset(f"nmc_hppc_{tag}"), None),),
                capacity=(load_dataset(f"nmc_cap_{tag}"),),
            )
            for choice, tag in NMC_RATES.items()
        },
    )


def embedded_lfp() -> StudyCell:
    """LFP cell of the physics model on a charge-depleting cycle, with the LFP paper's ratios."""
    whole = 2.3
    return StudyCell(
        name="embedded LFP",
        tests=TestLogs(
            hppc=((load_dataset("lfp_hppc"), None),),
            capacity=tuple(load_dataset(f"lfp_cap_{rate}") for rate in LFP_RATES),
        ),
        judged=_embedded("lfp_cdc"),
        reference_Ah=_true_capacity("lfp_cdc"),
        reference="the physics model's own inventory",
        settings=IdentifySettings(nominal_Ah=2.3, name="embedded LFP", chemistry="LFP"),
        values_Ah={name: ratio * whole for name, ratio in PAPER_RATIOS.items()},
    )


def panasonic(data: Path) -> StudyCell:
    """Panasonic 18650PF at 25 degC."""
    folder = "panasonic_18650pf"
    low_rate = _measured(data, folder, "ocv_c20_p25")
    return StudyCell(
        name="Panasonic 18650PF",
        tests=TestLogs(
            hppc=((_measured(data, folder, "hppc_p25"), None),),
            ocv=(low_rate,),
            capacity=(
                low_rate,
                *(_measured(data, folder, f"cap_1c_p25_start_{k}") for k in (1, 2)),
            ),
            drive=((_measured(data, folder, "drive_p25_cycle_2"), None),),
        ),
        judged=tuple(
            JudgedLog(_measured(data, folder, f"drive_p25_{name}"), 1.0)
            for name in ("us06", "hwfta", "nn")
        ),
        reference_Ah=2.997,
        reference="the C/20 discharge",
        settings=IdentifySettings(nominal_Ah=2.9, name="Panasonic 18650PF"),
    )


def a123(data: Path) -> StudyCell:
    """A123 26650 (LFP) at 25 degC, with the LFP paper's ratios to its full charge."""
    folder, whole = "plett_a123", 2.0725
    low_rate = tuple(_measured(data, folder, f"ocv_p25_s{k}") for k in (1, 2, 3, 4))
    return StudyCell(
        name="A123 26650",
        tests=TestLogs(
            ocv=low_rate,
            capacity=low_rate[:1],
            drive=tuple((_measured(data, folder, f"dyn_{t}_s1"), None) for t in ("p35", "p45")),
        ),
        judged=(JudgedLog(_measured(data, folder, "dyn_p25_s1"), 1.0),),
        reference_Ah=whole,
        reference="C/30 discharge at 25 degC to the last dither",
        settings=IdentifySettings(nominal_Ah=2.3, name="A123 26650", chemistry="LFP"),
        values_Ah={name: ratio * whole for name, ratio in PAPER_RATIOS.items()},
    )


def leaf(data: Path) -> StudyCell:
    """Nissan Leaf cell at 25 degC; there is no drive of it, so it is judged on 3C discharges."""
    folder = "nissan_leaf"
    return StudyCell(
        name="Nissan Leaf",
        tests=TestLogs(
            hppc=((_measured(data, folder, "hppc_p25"), None),),
            capacity=tuple(_measured(data, folder, f"cap_{rate}_p23") for rate in ("1c", "2c")),
        ),
        judged=(JudgedLog(_measured(data, folder, "cap_3c_p23"), 1.0),),
        reference_Ah=30.48,
        reference="all charge of the HPPC test",
        settings=IdentifySettings(nominal_Ah=33.1, name="Nissan Leaf"),
    )


EMBEDDED: dict[str, Callable[[], StudyCell]] = {
    "embedded-nmc": embedded_nmc,
    "embedded-nmc-rates": embedded_nmc_rates,
    "embedded-lfp": embedded_lfp,
}
MEASURED: dict[str, Callable[[Path], StudyCell]] = {
    "panasonic": panasonic,
    "a123": a123,
    "leaf": leaf,
}


def study_cells(names: tuple[str, ...], data: Path | None) -> tuple[StudyCell, ...]:
    """Cells by name; no name means all embedded ones, and all measured ones if there is a folder.

    Raises
    ------
    InputError        an unknown name; a measured cell without the folder
    """
    wanted = names or (*EMBEDDED, *(MEASURED if data is not None else ()))
    found = []
    for name in wanted:
        if name in EMBEDDED:
            found.append(EMBEDDED[name]())
        elif name in MEASURED:
            if data is None:
                raise InputError(
                    f"the measured cell '{name}' and no folder of measured data",
                    "the folder",
                    "Add `data=DIR` or set CELLWISE_DATA.",
                )
            found.append(MEASURED[name](data))
        else:
            raise InputError(
                f"a cell '{name}'",
                f"one of {', '.join((*EMBEDDED, *MEASURED))}",
                "Choose one of them.",
            )
    return tuple(found)


def _measured(data: Path, folder: str, name: str) -> CellLog:
    return read_log(data / folder / f"{name}.csv.gz")


def _entry(name: str) -> dict[str, object]:
    return next(e for e in list_datasets() if e["name"] == name)


def _true_capacity(name: str) -> float:
    return float(str(_entry(name)["true_capacity_Ah"]))


def _embedded(*names: str) -> tuple[JudgedLog, ...]:
    return tuple(
        JudgedLog(load_dataset(name), float(str(_entry(name)["initial_soc"]))) for name in names
    )
