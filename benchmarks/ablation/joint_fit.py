"""What is lost without each rule of the joint fit: cells identified again, judged on other logs.

python -m benchmarks.ablation.joint_fit [--keep DIR] [--only "RULE,RULE"] [--cells "NAME,NAME"]

A rule is switched off by setting names of its modules, in a process of its own. Judged is the
voltage of logs that took no part, above 10 % SOC, and the stated over the measured error of each
band above 15 % SOC; what is decided and noticed on the way is kept beside it.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.lfp import CHAMBER_C, chamber_log, drive
from benchmarks.measured_data import HOW, data_folder, measured_log
from cellwise import IdentifySettings, TestLogs, identify_cell
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import in_bands
from cellwise.cell.simulate import known_temperature_C, simulate
from cellwise.cell.stock import stock_model
from cellwise.identify import Identification
from cellwise.identify.prior.corrections import UsualDifference
from cellwise.identify.prior.update import Evidence
from cellwise.logs import CellLog, read_log
from cellwise.typing import FloatArray

PANASONIC, LG, SAMSUNG, LEAF = "panasonic_18650pf", "lg_18650hg2", "samsung_30q_ageing", "leaf_pack"
WARM_C = {"p25": 25.0, "p10": 10.0, "p00": 0.0, "n10": -10.0, "n20": -20.0}
LEAF_SERIES = 96
Prepared = tuple[TestLogs, IdentifySettings, list[tuple[CellLog, float | None]]]


def of_panasonic(data: Path, name: str, soc0: float | None = None) -> CellLog:
    """A log under its own name."""
    return replace(measured_log(data, f"{PANASONIC}/{name}"), name=name, soc0=soc0)


def full(data: Path, *names: str) -> list[tuple[CellLog, float | None]]:
    """Panasonic drives, which begin full."""
    return [(of_panasonic(data, f"drive_{n}"), 1.0) for n in names]


def pulses_and_drives(data: Path) -> Prepared:
    """Laboratory tests and two drives at 25 degC."""
    tests = TestLogs(
        hppc=of_panasonic(data, "hppc_p25"),
        ocv=of_panasonic(data, "ocv_c20_p25"),
        capacity=of_panasonic(data, "cap_1c_p25_start_1"),
        drive=[of_panasonic(data, f"drive_p25_cycle_{k}") for k in (2, 3)],
    )
    judged = full(data, "p25_nn", "p25_hwfta", "p25_hwftb", "p25_us06", "p10_nn")
    return tests, IdentifySettings(nominal_Ah=2.9), judged


def laboratory(data: Path) -> Prepared:
    """Laboratory tests alone."""
    tests, settings, judged = pulses_and_drives(data)
    return replace(tests, drive=()), settings, judged


def pulses(data: Path) -> Prepared:
    """A pulse test alone."""
    tests = TestLogs(hppc=of_panasonic(data, "hppc_p25"))
    return tests, IdentifySettings(nominal_Ah=2.9), full(data, "p25_nn", "p25_hwfta", "p25_us06")


def driven(data: Path) -> Prepared:
    """C/20 and three drives at 25 degC."""
    tests = TestLogs(
        ocv=of_panasonic(data, "ocv_c20_p25"),
        drive=[of_panasonic(data, f"drive_p25_{n}") for n in ("cycle_2", "cycle_3", "us06")],
    )
    return tests, IdentifySettings(nominal_Ah=2.9), full(data, "p25_nn", "p25_hwfta", "p25_hwftb")


def temperatures(data: Path) -> Prepared:
    """Pulses and three drives at each of five temperatures."""
    tests = TestLogs(
        ocv=of_panasonic(data, "ocv_c20_p25"),
        hppc=[(of_panasonic(data, f"hppc_{t}"), c) for t, c in WARM_C.items()],
        drive=[
            (of_panasonic(data, f"drive_{t}_{n}", 1.0), c)
            for t, c in WARM_C.items()
            for n in ("cycle_2", "cycle_4", "us06")
        ],
    )
    judged = ("p25_nn", "p10_nn", "p00_la92", "p00_nn", "n10_la92", "n10_nn", "n20_la92", "n20_nn")
    return tests, IdentifySettings(nominal_Ah=2.9), full(data, *judged)


def samsung(data: Path) -> Prepared:
    """Pulses of one cell at three temperatures, C/10 of another."""

    def log(name: str) -> CellLog:
        return replace(measured_log(data, f"{SAMSUNG}/{name}"), name=name)

    tests = TestLogs(
        hppc=[log(f"hppc_dnn01_1c_p{t}_time_rebuilt") for t in (20, 30, 40)],
        ocv=log("fresh_s001_discharge_c10"),
    )
    judged = [(log(f"fresh_s001_discharge_{r}"), 1.0) for r in ("1c", "2c", "3c")]
    return tests, IdentifySettings(nominal_Ah=3.0), judged


def lg(data: Path) -> Prepared:
    """C/20 and three rates at six temperatures, short cycles; no pulse test, no whole drive."""

    def log(name: str, soc0: float | None = None) -> CellLog:
        return replace(measured_log(data, f"{LG}/{name}"), name=name, soc0=soc0)

    runs = {"p25": 549, "p10": 575, "p00": 585, "n10": 593, "n20": 607, "p40": 555}
    rates = [f"cap_{r}_{t}_{n}" for t, n in runs.items() for r in ("0p5c", "2c")]
    one_c = ("p25_551", "p10_571", "p00_589", "n10_596", "n20_610", "p40_557")
    tests = TestLogs(
        ocv=[log(f"ocv_c20_{t}_{n}") for t, n in runs.items()],
        capacity=[log(n) for n in (*rates, *(f"cap_1c_{n}" for n in one_c))],
        drive=[log(f"pauscycl_{n}", 1.0) for n in ("n10_604", "n20_611", "p00_590", "p10_571")],
    )
    names = ("us06_n10_601", "us06_n20_610", "mixed7_p40_562")
    judged: list[tuple[CellLog, float | None]] = [(log(f"drive_{n}"), 1.0) for n in names]
    return tests, IdentifySettings(nominal_Ah=3.0), judged


def lfp(data: Path, tag: str) -> Prepared:
    """A123: C/30 branches at 25 degC and drives at all temperatures but one."""
    tests = TestLogs(
        ocv=[chamber_log(data, f"ocv_p25_{part}", 25.0, None) for part in ("s1", "s3")],
        drive=[(drive(data, t), c) for t, c in CHAMBER_C.items() if t != tag],
    )
    return tests, IdentifySettings(nominal_Ah=2.07), [(drive(data, tag), 1.0)]


def lfp_twice(data: Path) -> Prepared:
    """A123: all four C/30 scripts and two drives, of one temperature."""
    tests = TestLogs(
        ocv=[measured_log(data, f"plett_a123/ocv_p25_s{k}") for k in (1, 2, 3, 4)],
        drive=[measured_log(data, f"plett_a123/dyn_{t}_s1") for t in ("p35", "p45")],
    )
    judged: list[tuple[CellLog, float | None]] = [(drive(data, "p25"), 1.0)]
    return tests, IdentifySettings(nominal_Ah=2.3), judged


def leaf_cell(data: Path) -> Prepared:
    """A pouch cell: pulses at three temperatures, 1C."""

    def log(name: str) -> CellLog:
        return replace(measured_log(data, f"nissan_leaf/{name}"), name=name)

    tests = TestLogs(
        hppc=[(log(f"hppc_p{t}"), float(t)) for t in (10, 25, 40)], capacity=log("cap_1c_p23")
    )
    judged: list[tuple[CellLog, float | None]] = [(log(f"cap_{r}_p23"), None) for r in ("2c", "3c")]
    return tests, IdentifySettings(nominal_Ah=33.1), judged


def lipo(data: Path) -> Prepared:
    """Discharges at 1C and 3C, which warm the cell; nothing else."""

    def log(name: str) -> CellLog:
        return replace(measured_log(data, f"lipo_5450/{name}"), name=name)

    tests = TestLogs(capacity=[log(f"c{r}_cycle01") for r in (1, 3)])
    judged: list[tuple[CellLog, float | None]] = [
        (log(n), None) for n in ("c2_cycle01", "c4_cycle01", "c1_cycle03")
    ]
    return tests, IdentifySettings(nominal_Ah=5.45), judged


def one_drive(data: Path) -> Prepared:
    """A stock model of another kind and one drive that began full."""
    tests = TestLogs(drive=of_panasonic(data, "drive_p25_us06", 1.0))
    settings = IdentifySettings(nominal_Ah=2.9, prior=stock_model("nmc-18650"))
    return tests, settings, full(data, "p25_cycle_3", "p25_nn", "p25_hwfta")


def cut_drive(data: Path) -> Prepared:
    """No prior named, and a drive of which only the middle is there."""
    whole = of_panasonic(data, "drive_p25_nn")
    soc = 1.0 - whole.counted_charge_Ah() / 2.997
    rows = np.flatnonzero((soc < 0.66) & (soc > 0.46))
    tests = TestLogs(drive=whole.part(int(rows[0]), int(rows[-1])))
    settings = IdentifySettings(nominal_Ah=2.9)
    return tests, settings, full(data, "p25_us06", "p25_hwfta")


def one_discharge(data: Path) -> Prepared:
    """A stock model and one 1C discharge."""
    tests = TestLogs(capacity=of_panasonic(data, "cap_1c_p25_start_1"))
    settings = IdentifySettings(nominal_Ah=2.9, prior=stock_model("nmc-18650"))
    return tests, settings, full(data, "p25_us06", "p25_nn", "p25_hwfta")


def lfp_drive(data: Path) -> Prepared:
    """A stock LFP model and one drive of another cell on the plateau."""
    tests = TestLogs(drive=replace(drive(data, "p25"), soc0=None))
    settings = IdentifySettings(nominal_Ah=2.07, prior=stock_model("lfp-26650"))
    return tests, settings, [(drive(data, "p35"), 1.0), (drive(data, "p45"), 1.0)]


def car(data: Path) -> Prepared:
    """A car's pack from the laboratory's cell of the kind and a fortnight of drives."""
    files = sorted((data / LEAF).glob("leaf_201706*.parquet"))

    def log(path: Path) -> CellLog:
        read = read_log(path, series=LEAF_SERIES)
        return replace(read, name=path.stem)

    tests = TestLogs(drive=[log(f) for f in files[:15]])
    settings = IdentifySettings(nominal_Ah=65.0, prior=stock_model("lmo-pouch"))
    return tests, settings, [(log(f), None) for f in files[15:18]]


CELLS: dict[str, Callable[[Path], Prepared]] = {
    "Panasonic, pulses and two drives": pulses_and_drives,
    "Panasonic, laboratory": laboratory,
    "Panasonic, pulses": pulses,
    "Panasonic, C/20 and three drives": driven,
    "Panasonic, five temperatures": temperatures,
    "Samsung, pulses of another sample": samsung,
    "LG, constant currents": lg,
    "A123 without 25 degC": lambda data: lfp(data, "p25"),
    "A123 without -15 degC": lambda data: lfp(data, "n15"),
    "A123, four scripts": lfp_twice,
    "Leaf cell, pulses": leaf_cell,
    "LiPo, two rates": lipo,
    "prior: one drive": one_drive,
    "prior: the middle of a drive": cut_drive,
    "prior: one discharge": one_discharge,
    "prior: LFP drive": lfp_drive,
    "prior: a car's pack": car,
}


@dataclass(frozen=True)
class Rule:
    """What is off: names within modules below ``cellwise.identify``, and the cells it can touch."""

    name: str
    names: tuple[tuple[str, Any], ...] = ()
    cells: tuple[str, ...] = ()

    def throw(self) -> None:
        """Set the names."""
        for path, value in self.names:
            module, name = path.rsplit(".", 1)
            found = importlib.import_module(f"cellwise.identify.{module}")
            if not hasattr(found, name):
                raise AttributeError(f"{path}: the rule '{self.name}' is stale")
            setattr(found, name, value)


def _without(name: str) -> Callable[..., Any]:
    """The candidates of the effects' station but one."""
    from cellwise.identify.refinement import effects

    candidates = effects._candidates
    return lambda joint: tuple(n for n in candidates(joint) if n != name)


SEVERAL = ("Panasonic, five temperatures", "LG, constant currents", "Leaf cell, pulses")
TRIED = ("Panasonic, five temperatures", "LG, constant currents", "A123 without -15 degC")
PRIORS = tuple(name for name in CELLS if name.startswith("prior"))
FIT, EFFECTS, PRIOR = "refinement.joint_fit", "refinement.effects", "prior.update"
RULES: tuple[Rule, ...] = (
    Rule("nothing"),
    Rule("a log that is fitted worse counts less", ((f"{FIT}.BALANCE", 0.0),), SEVERAL),
    Rule("smoother with several temperatures", ((f"{FIT}.SMOOTH_OF_SEVERAL", 0.01),), SEVERAL),
    Rule(
        "hysteresis in the fit",
        ((f"{FIT}.HYSTERESIS_FROM_V", np.inf),),
        ("A123, four scripts", "A123 without -15 degC"),
    ),
    Rule(
        "capacity tests keep their own",
        ((f"{FIT}.keep_own_capacity", lambda *_: False),),
        ("Panasonic, pulses and two drives",),
    ),
    Rule("charge_transfer", ((f"{EFFECTS}._candidates", _without("charge_transfer")),), TRIED),
    Rule("surface_soc", ((f"{EFFECTS}._candidates", _without("surface_soc")),), TRIED),
    Rule(
        "own activations", ((f"{EFFECTS}._candidates", _without("temperature_dependence")),), TRIED
    ),
    Rule("prior, robust", ((f"{PRIOR}.OF_A_LOG", Evidence(robust=1e6)),), PRIORS),
    Rule(
        "prior, one error in five minutes",
        ((f"{PRIOR}.OF_A_LOG", Evidence(memory_s=1e-3)),),
        PRIORS,
    ),
    Rule(
        "prior, activation",
        (("prior.corrections.USUAL", UsualDifference(activation_K=1e-3)),),
        PRIORS,
    ),
)


def bands_of(model: CellModel, log: CellLog, soc0: float | None) -> list[list[float]]:
    """Mean squares stated and measured in each band above 15 % SOC [V^2]."""
    from cellwise.identify.refinement.model_error import polarisation_V

    simulation = simulate(model, log, start_of(model, log, soc0))
    known = np.isfinite(simulation.error_V) & (simulation.soc >= 0.0)
    warm = known_temperature_C(model, log)[known]
    soc = simulation.soc[known]
    drop = polarisation_V(model, soc, warm, simulation.voltage_V[known])
    measured = in_bands(log.time_s[known], simulation.error_V[known]) ** 2
    stated = np.array([stated_V2(model, k, soc, drop, warm) for k in range(measured.shape[0])])
    rows = soc > 0.15
    return [x[:, rows].mean(axis=1).tolist() for x in (stated, measured)]


def stated_V2(
    model: CellModel, band: int, soc: FloatArray, drop_V: FloatArray, warm_C: FloatArray
) -> FloatArray:
    """Stated variance of one band at every row."""
    error = model.error
    share = np.where(drop_V < 0.0, error.shares(-1.0)[band], error.shares()[band])
    warm = float(np.median(warm_C))
    return np.asarray(error.variance_V2(band, soc, warm) + (share * drop_V) ** 2)


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
        "notices": list(found.notices),
        "contradictions": list(found.contradictions),
        "own_logs": {o.simulation.log.name: [o.used, o.simulation.soc0] for o in found.own_logs},
    }


def run(rule: str, cell: str, output: Path) -> None:
    """One cell without one rule."""
    data = data_folder()
    if data is None:
        raise SystemExit(f"no measured data: {HOW}")
    next(r for r in RULES if r.name == rule).throw()
    tests, settings, logs = CELLS[cell](data)
    began = time.perf_counter()
    found = identify_cell(tests, settings)
    seconds = time.perf_counter() - began
    result = {**judged(found, logs), "seconds": seconds}
    output.write_text(json.dumps(result, indent=1), encoding="utf-8")


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
    parser.add_argument("--run", nargs=2, metavar=("RULE", "CELL"))
    chosen = parser.parse_args()
    chosen.keep.mkdir(parents=True, exist_ok=True)
    if chosen.run:
        run(*chosen.run, kept_file(chosen.keep, *chosen.run))
        return 0
    rules = [r for r in RULES if not chosen.only or r.name in chosen.only.split(",")]
    for rule in rules:
        for cell in rule.cells or CELLS:
            if chosen.cells and not any(part in cell for part in chosen.cells.split(";")):
                continue
            file = kept_file(chosen.keep, rule.name, cell)
            if not file.exists():
                command = [sys.executable, "-m", "benchmarks.ablation.joint_fit", "--keep"]
                command += [str(chosen.keep), "--run", rule.name, cell]
                done = subprocess.run(command, env=os.environ, capture_output=True, text=True)
                if done.returncode:
                    print(f"{rule.name} | {cell} | {done.stderr.strip().splitlines()[-1]}")
                    continue
            without = json.loads(file.read_text(encoding="utf-8"))
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
