"""What is lost without each rule of the joint fit: cells identified again, judged on other logs.

python -m benchmarks.ablation.joint_fit [--keep DIR] [--only "RULE,RULE"] [--cells "NAME,NAME"]

A rule is switched off by setting names of its modules for a while. Judged is the
voltage of logs that took no part, above 10 % SOC, and the stated over the measured error of each
band above 15 % SOC; what is decided and noticed on the way is kept beside it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ablation.identify import Case, kept, log_of, tests_of, thrown
from benchmarks.accuracy.lfp import CHAMBER_C
from benchmarks.measured_data import HOW, data_folder
from cellwise import CellTests, IdentifySettings, identify_cell
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import in_bands
from cellwise.cell.simulate import known_temperature_C, simulate
from cellwise.cell.stock import stock_model
from cellwise.fit.model_error import polarisation_of
from cellwise.fit.problem import EVIDENCE
from cellwise.identify import Identification, effect_selection
from cellwise.identify.joint_fit import ROLES
from cellwise.identify.measured_capacity import SPREAD
from cellwise.logs import CellLog
from cellwise.typing import FloatArray

PANASONIC, LG = "panasonic_18650pf", "lg_18650hg2"
SAMSUNG, A123 = "samsung_30q_ageing", "plett_a123"
WARM_C = {"p25": 25, "p10": 10, "p00": 0, "n10": -10, "n20": -20}
LEAF_SERIES = 96
MIDDLE_SOC, PANASONIC_AH = (0.46, 0.66), 2.997
CUT = "prior: the middle of a drive"
Names = tuple[str, ...]


def of(cell: str, *names: str, stated: str = "") -> Names:
    """Names of a cell's logs, with what is stated of each."""
    return tuple(f"{cell}/{name}{stated}" for name in names)


def full(cell: str, *names: str) -> tuple[tuple[str, float | None], ...]:
    """Logs to judge on that begin full."""
    return tuple((name, 1.0) for name in of(cell, *names))


def unknown(cell: str, *names: str) -> tuple[tuple[str, float | None], ...]:
    """Logs to judge on whose start is found."""
    return tuple((name, None) for name in of(cell, *names))


def warm_drives(*names: str) -> Names:
    """Panasonic drives at five temperatures, which began full."""
    return tuple(
        f"{PANASONIC}/drive_{tag}_{name}@temperature_C={warm},soc0=1"
        for tag, warm in WARM_C.items()
        for name in names
    )


def lfp(left_out: str) -> Case:
    """A123: C/30 branches at 25 degC and drives at all temperatures but one."""
    drives = {
        tag: f"{A123}/dyn_{tag}_s1@temperature_C={warm:g},soc0=1" for tag, warm in CHAMBER_C.items()
    }
    judged = drives.pop(left_out)
    name = f"A123 without {CHAMBER_C[left_out]:g} degC"
    branches = of(A123, "ocv_p25_s1", "ocv_p25_s3", stated="@25")
    return Case(name, 2.07, (), branches, (), tuple(drives.values()), ((judged, 1.0),))


def car() -> Case:
    """A car's pack from the laboratory's cell of the kind and a fortnight of drives."""
    files = sorted(Path(str(data_folder())).glob("leaf_pack/leaf_201706*.parquet"))
    names = [f"leaf_pack/{file.stem}" for file in files]
    judged = tuple((name, None) for name in names[15:18])
    return Case("prior: a car's pack", 65.0, drive=tuple(names[:15]), judged=judged,
                prior="lmo-pouch", series=LEAF_SERIES)  # fmt: skip


PULSES, SLOW, ONE_C = (of(PANASONIC, n) for n in ("hppc_p25", "ocv_c20_p25", "cap_1c_p25_start_1"))
DRIVES_25 = ("drive_p25_nn", "drive_p25_hwfta", "drive_p25_hwftb", "drive_p25_us06", "drive_p10_nn")
LG_RUNS = {"p25": 549, "p10": 575, "p00": 585, "n10": 593, "n20": 607, "p40": 555}
LG_1C = ("p25_551", "p10_571", "p00_589", "n10_596", "n20_610", "p40_557")
CELLS = {
    case.name: case
    for case in (
        Case(
            "Panasonic, pulses and two drives", 2.9, PULSES, SLOW, ONE_C,
            of(PANASONIC, "drive_p25_cycle_2", "drive_p25_cycle_3"), full(PANASONIC, *DRIVES_25),
        ),
        Case("Panasonic, laboratory", 2.9, PULSES, SLOW, ONE_C, (), full(PANASONIC, *DRIVES_25)),
        Case(
            "Panasonic, pulses", 2.9, PULSES,
            judged=full(PANASONIC, "drive_p25_nn", "drive_p25_hwfta", "drive_p25_us06"),
        ),
        Case(
            "Panasonic, C/20 and three drives", 2.9, (), SLOW, (),
            of(PANASONIC, *(f"drive_p25_{n}" for n in ("cycle_2", "cycle_3", "us06"))),
            full(PANASONIC, *DRIVES_25[:3]),
        ),
        Case(
            "Panasonic, five temperatures", 2.9,
            tuple(f"{PANASONIC}/hppc_{t}@{c}" for t, c in WARM_C.items()), SLOW, (),
            warm_drives("cycle_2", "cycle_4", "us06"),
            full(PANASONIC, "drive_p25_nn", "drive_p10_nn", "drive_p00_la92", "drive_p00_nn",
                 "drive_n10_la92", "drive_n10_nn", "drive_n20_la92", "drive_n20_nn"),
        ),
        Case(
            "Samsung, pulses of another sample", 3.0,
            of(SAMSUNG, *(f"hppc_dnn01_1c_p{t}_time_rebuilt" for t in (20, 30, 40))),
            of(SAMSUNG, "fresh_s001_discharge_c10"),
            judged=full(SAMSUNG, *(f"fresh_s001_discharge_{r}" for r in ("1c", "2c", "3c"))),
        ),
        Case(  # C/20 and three rates at six temperatures, short cycles; no pulses, no whole drive
            "LG, constant currents", 3.0, (),
            of(LG, *(f"ocv_c20_{t}_{n}" for t, n in LG_RUNS.items())),
            of(LG, *(f"cap_{r}_{t}_{n}" for t, n in LG_RUNS.items() for r in ("0p5c", "2c")),
               *(f"cap_1c_{n}" for n in LG_1C)),
            of(LG, *(f"pauscycl_{n}" for n in ("n10_604", "n20_611", "p00_590", "p10_571")),
               stated="@soc0=1"),
            full(LG, "drive_us06_n10_601", "drive_us06_n20_610", "drive_mixed7_p40_562"),
        ),
        lfp("p25"),
        lfp("n15"),
        Case(
            "A123, four scripts", 2.3, (), of(A123, *(f"ocv_p25_s{k}" for k in (1, 2, 3, 4))), (),
            of(A123, "dyn_p35_s1", "dyn_p45_s1"),
            tuple((n, 1.0) for n in of(A123, "dyn_p25_s1", stated="@25")),
        ),
        Case(
            "Leaf cell, pulses", 33.1,
            tuple(f"nissan_leaf/hppc_p{t}@{t}" for t in (10, 25, 40)), (),
            of("nissan_leaf", "cap_1c_p23"), (),
            unknown("nissan_leaf", "cap_2c_p23", "cap_3c_p23"),
        ),
        Case(
            "LiPo, two rates", 5.45, (), (), of("lipo_5450", "c1_cycle01", "c3_cycle01"), (),
            unknown("lipo_5450", "c2_cycle01", "c4_cycle01", "c1_cycle03"),
        ),
        Case(
            "prior: one drive", 2.9, drive=of(PANASONIC, "drive_p25_us06@soc0=1"),
            judged=full(PANASONIC, "drive_p25_cycle_3", "drive_p25_nn", "drive_p25_hwfta"),
            prior="nmc-18650",
        ),
        Case(CUT, 2.9, drive=of(PANASONIC, "drive_p25_nn"),
             judged=full(PANASONIC, "drive_p25_us06", "drive_p25_hwfta")),
        Case(
            "prior: one discharge", 2.9, capacity=ONE_C,
            judged=full(PANASONIC, "drive_p25_us06", "drive_p25_nn", "drive_p25_hwfta"),
            prior="nmc-18650",
        ),
        Case(
            "prior: LFP drive", 2.07, drive=of(A123, "dyn_p25_s1@25"), prior="lfp-26650",
            judged=tuple((f"{A123}/dyn_{t}_s1@{CHAMBER_C[t]:g}", 1.0) for t in ("p35", "p45")),
        ),
        car(),
    )
}  # fmt: skip


def prepared(case: Case) -> tuple[CellTests, IdentifySettings]:
    """What is identified, and how; of one drive the middle alone."""
    prior = stock_model(case.prior) if case.prior else None
    settings = IdentifySettings(nominal_Ah=case.nominal_Ah, prior=prior)
    tests = tests_of(case)
    if case.name == CUT:
        ((whole, _),) = tests.drive
        soc = 1.0 - whole.counted_charge_Ah() / PANASONIC_AH
        rows = np.flatnonzero((soc > MIDDLE_SOC[0]) & (soc < MIDDLE_SOC[1]))
        tests = CellTests(drive=((whole.part(int(rows[0]), int(rows[-1])), None),))
    return tests, settings


@dataclass(frozen=True)
class Rule:
    """What is off: names within modules below ``cellwise``, and the cells it can touch."""

    name: str
    names: tuple[tuple[str, Any], ...] = ()
    cells: tuple[str, ...] = ()

    @property
    def places(self) -> tuple[tuple[str, str, Any], ...]:
        """Module, name and value of each."""
        ways = ((path.rsplit(".", 1), value) for path, value in self.names)
        return tuple((f"cellwise.{way[0]}", way[1], value) for way, value in ways)


def _without(name: str) -> Callable[..., Any]:
    """The candidates of the effects' station but one."""
    candidates = effect_selection._candidates
    return lambda joint: tuple(n for n in candidates(joint) if n != name)


TRIED = ("Panasonic, five temperatures", "LG, constant currents", "A123 without -15 degC")
FIT, LIKELIHOOD = "identify.joint_fit", "fit.problem"
CANDIDATES = "identify.effect_selection._candidates"
RULES: tuple[Rule, ...] = (
    Rule("nothing"),
    Rule(
        "a test of the capacity keeps its own",
        ((f"{FIT}.CAPACITY_SPREAD", SPREAD._replace(pulses=0.0)),),
        ("Panasonic, pulses and two drives",),
    ),
    Rule(
        "roles as evidence of a full start",
        ((f"{FIT}.ROLES", ROLES._replace(test_full=0.1, drive_full=0.1)),),
    ),
    Rule("charge_transfer", ((CANDIDATES, _without("charge_transfer")),), TRIED),
    Rule("surface_soc", ((CANDIDATES, _without("surface_soc")),), TRIED),
    Rule("own activations", ((CANDIDATES, _without("temperature_dependence")),), TRIED),
    Rule("robust", ((f"{LIKELIHOOD}.EVIDENCE", EVIDENCE._replace(robust=1e6)),)),
    Rule(
        "one error in five minutes",
        ((f"{LIKELIHOOD}.EVIDENCE", EVIDENCE._replace(memory_s=1e-3)),),
    ),
    Rule(
        "one error in two per cent of SOC",
        ((f"{LIKELIHOOD}.EVIDENCE", EVIDENCE._replace(cell_soc=1e-4)),),
    ),
    Rule(
        "no fit better than two logs are alike",
        ((f"{LIKELIHOOD}.EVIDENCE", EVIDENCE._replace(least_V=5e-4)),),
    ),
)


def bands_of(model: CellModel, log: CellLog, soc0: float | None) -> list[list[float]]:
    """Mean squares stated and measured in each band above 15 % SOC [V^2]."""
    simulation = simulate(model, log, start_of(model, log, soc0))
    known = np.isfinite(simulation.residual_V) & (simulation.soc >= 0.0)
    warm = known_temperature_C(model, log)[known]
    soc = simulation.soc[known]
    drop = polarisation_of(model, soc, warm, simulation.voltage_V[known])
    measured = in_bands(log.time_s[known], simulation.residual_V[known]) ** 2
    stated = np.array([stated_V2(model, k, soc, drop, warm) for k in range(measured.shape[0])])
    rows = soc > 0.15
    return [x[:, rows].mean(axis=1).tolist() for x in (stated, measured)]


def stated_V2(
    model: CellModel, band: int, soc: FloatArray, polarisation_V: FloatArray, warm_C: FloatArray
) -> FloatArray:
    """Stated variance of one band at every row."""
    error = model.error
    share = np.where(polarisation_V < 0.0, error.shares(-1.0)[band], error.shares()[band])
    warm = float(np.median(warm_C))
    return np.asarray(error.variance_V2(band, soc, warm) + (share * polarisation_V) ** 2)


def start_of(model: CellModel, log: CellLog, soc0: float | None) -> float:
    """As stated, else as ``simulate`` finds it."""
    from cellwise.cell.initial_soc.initial_soc import initial_soc

    return initial_soc(model, log, whole_log=True).soc if soc0 is None else soc0


def judged(found: Identification, logs: Sequence[tuple[CellLog, float | None]]) -> dict[str, Any]:
    """Everything that a rule may move."""
    model = found.model
    rmse = {}
    bands = []
    for log, soc0 in logs:
        simulation = simulate(model, log, start_of(model, log, soc0))
        rmse[log.name] = 1e3 * simulation.rmse_above_10pct_V
        bands.append(bands_of(model, log, soc0))
    stated, measured = np.mean(bands, axis=0)
    return {
        "rmse_mV": rmse,
        "stated_over_measured": np.sqrt(stated / np.maximum(measured, 1e-12)).tolist(),
        "own_mV": 1e3 * found.fit.rmse_V,
        "capacity_Ah": model.capacity_Ah,
        "error": model.error.to_dict(),
        "effects": [e.name for e in model.effects],
        "decided": [d.to_dict() for d in found.decided],
        "notices": [notice.text for notice in found.notices],
        "contradictions": list(found.contradictions),
        "own_logs": {o.simulation.log.name: [o.used, o.simulation.soc0] for o in found.own_logs},
    }


def run(rule: Rule, cell: str) -> dict[str, Any]:
    """One cell without one rule."""
    case = CELLS[cell]
    tests, settings = prepared(case)
    logs = [(log_of(name, case.series), soc0) for name, soc0 in case.judged]
    began = time.perf_counter()
    with thrown(rule.places):
        found = identify_cell(tests, settings)
    return {**judged(found, logs), "seconds": time.perf_counter() - began}


def kept_file(keep: Path, rule: str, cell: str) -> Path:
    """Where a result is."""
    return keep / f"{rule} - {cell}.json".replace("/", "_")


def row_of(rule: str, with_it: dict[str, Any], without: dict[str, Any]) -> tuple[float, float]:
    """Millivolts lost on average over the judged logs, and the most on one."""
    lost = [without["rmse_mV"][n] - v for n, v in with_it["rmse_mV"].items()]
    return float(np.mean(lost)), max(lost, key=abs)


def main() -> int:
    """Run what is not kept yet and print a line for each rule and cell."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--keep", type=Path, default=Path("build/ablation"))
    parser.add_argument("--only", default="")
    parser.add_argument("--cells", default="")
    chosen = parser.parse_args()
    chosen.keep.mkdir(parents=True, exist_ok=True)
    if data_folder() is None:
        raise SystemExit(f"no measured data: {HOW}")
    rules = [r for r in RULES if not chosen.only or r.name in chosen.only.split(",")]
    for rule in rules:
        for cell in rule.cells or CELLS:
            if chosen.cells and not any(part in cell for part in chosen.cells.split(";")):
                continue
            file = kept_file(chosen.keep, rule.name, cell)
            try:
                without = kept(file, lambda r=rule, c=cell: run(r, c))
            except Exception as error:  # the others go on
                print(f"{rule.name} | {cell} | {type(error).__name__}: {error}", flush=True)
                continue
            base = kept_file(chosen.keep, "nothing", cell)
            with_it = json.loads(base.read_text(encoding="utf-8")) if base.exists() else without
            mean, most = row_of(rule.name, with_it, without)
            ratio = " ".join(f"{v:.2f}" for v in without["stated_over_measured"])
            level = np.mean(list(without["rmse_mV"].values()))
            lost = f"{level:.2f} mV | {mean:+.2f} mV, most {most:+.2f}"
            print(f"{rule.name} | {cell} | {lost} | {ratio}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
