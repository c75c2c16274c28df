"""What is lost without each rule of the identification, on measured cells and on the project's own.

python -m benchmarks.ablation.identify [--keep DIR] [--only "trend,bends"] [--list]

A switch sets names within modules; nothing of it is in the package. With a rule off, capacity, OCV
and pulses of each cell are measured again; where they are as before nothing can have changed, else
the fit follows, and logs that took no part are simulated.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ablation.identify_rules import RULES, Rule
from benchmarks.measured_data import HOW, REPOSITORY, data_folder
from cellwise import CellTests, IdentifySettings, identify_cell
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.identify.checked_logs import check_logs
from cellwise.identify.fitted_pulses import measure_pulses
from cellwise.identify.hppc import phases
from cellwise.identify.measured_capacity import measure_capacity
from cellwise.identify.measured_ocv import measure_ocv
from cellwise.logs import CellLog, read_log
from cellwise.logs.stated import Stated

DIGITS = 6  # of a fingerprint: what differs less is rounding


@dataclass(frozen=True)
class Case:
    """Logs by role, ``cell/test`` and what is stated of it behind an @; logs that take no part.

    Each of these with its start (None: by its first rows). ``series`` cells are in a log.
    """

    name: str
    nominal_Ah: float
    hppc: tuple[str, ...] = ()
    ocv: tuple[str, ...] = ()
    capacity: tuple[str, ...] = ()
    drive: tuple[str, ...] = ()
    judged: tuple[tuple[str, float | None], ...] = ()
    prior: str = ""
    series: int | None = None


def _in(folder: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{folder}/{name}" for name in names)


P, LEAF, A123, LG = "panasonic_18650pf", "nissan_leaf", "plett_a123", "lg_18650hg2"
SAMSUNG, NMC, LFP = "samsung_30q_ageing", "nmc", "lfp"
US06, NN = f"{P}/drive_p25_us06", f"{P}/drive_p25_nn"

CASES = (
    Case(
        "Panasonic, 25 degC", 2.9, _in(P, "hppc_p25"), _in(P, "ocv_c20_p25"),
        _in(P, "cap_1c_p25_start_1", "cap_1c_p25_start_2"), judged=((US06, 1.0), (NN, 1.0)),
    ),
    Case("Panasonic, pulses only", 2.9, _in(P, "hppc_p25"), judged=((US06, 1.0), (NN, 1.0))),
    Case(
        "Panasonic, -10 degC", 2.9, _in(P, "hppc_n10"), _in(P, "ocv_c20_p25"),
        judged=((f"{P}/drive_n10_us06", 1.0), (f"{P}/drive_n10_nn", 1.0)),
    ),
    Case(
        "Leaf", 33.1, _in(LEAF, "hppc_p25"), capacity=_in(LEAF, "cap_1c_p23"),
        judged=((f"{LEAF}/cap_2c_p23", None),),
    ),
    Case(
        "Samsung", 3.0, _in(SAMSUNG, "hppc_dnn01_1c_p30_time_rebuilt"),
        _in(SAMSUNG, "fresh_s001_discharge_c10"),
        judged=((f"{SAMSUNG}/hppc_dnn01_2c_p30_time_rebuilt", None),),
    ),
    Case(
        "A123", 2.3, ocv=_in(A123, "ocv_p25_s1", "ocv_p25_s2", "ocv_p25_s3", "ocv_p25_s4"),
        drive=_in(A123, "dyn_p35_s1"), judged=((f"{A123}/dyn_p25_s1", 1.0),),
    ),
    Case(
        "LG, -10 degC", 3.0, ocv=_in(LG, "ocv_c20_p25_549"),
        capacity=_in(LG, "cap_0p5c_p25_549", "cap_1c_p25_551"),
        drive=_in(LG, "pauscycl_n10_604"), judged=((f"{LG}/drive_us06_n10_601", 1.0),),
    ),
    Case(
        "made NMC", 3.4, _in(NMC, "hppc"), _in(NMC, "ocv_c20"), _in(NMC, "cap_c3", "cap_c5"),
        judged=((f"{NMC}/drive_a", 1.0), (f"{NMC}/flight", 1.0)),
    ),
    Case(
        "made LFP", 2.3, _in(LFP, "hppc"), _in(LFP, "ocv_c20"), _in(LFP, "cap_0p5c", "cap_2c"),
        judged=((f"{LFP}/cdc", 1.0),),
    ),
)  # fmt: skip


@cache
def log_of(name: str, series: int | None = None) -> CellLog:
    """A measured log, or one of the project's own, with what is stated of it."""
    stated = Stated.parse(name)
    own = REPOSITORY / "datasets" / f"{stated.path}.parquet"
    other = Path(str(data_folder())) / stated.path
    found = own if own.exists() else other.with_name(f"{other.name}.csv.gz")
    path = found if found.exists() else other.with_name(f"{other.name}.parquet")
    log = read_log(path) if series is None else read_log(path, series=series)
    return stated.applied(log)


def tests_of(case: Case) -> CellTests:
    """Its logs by what they are."""

    def warm(names: tuple[str, ...]) -> tuple[tuple[CellLog, float | None], ...]:
        return tuple((log_of(n, case.series), Stated.parse(n).temperature_C) for n in names)

    return CellTests(
        hppc=warm(case.hppc),
        ocv=tuple(log_of(n) for n in case.ocv),
        capacity=tuple(log_of(n) for n in case.capacity),
        drive=warm(case.drive),
    )


@contextmanager
def thrown(names: tuple[tuple[str, str, Any], ...]) -> Iterator[None]:
    """Names within modules set for a while."""
    kept = []
    try:
        for module, name, value in names:
            found = importlib.import_module(module)
            kept.append((found, name, getattr(found, name)))
            setattr(found, name, value)
        phases._FOUND.clear()  # each log is cut once, by the rules of then
        yield
    finally:
        for found, name, value in reversed(kept):
            setattr(found, name, value)
        phases._FOUND.clear()


def begin_of(case: Case) -> str:
    """All that is measured without the fit, as one line: capacity, OCV and its notes, pulses."""
    settings = IdentifySettings(nominal_Ah=case.nominal_Ah)
    try:
        checked = check_logs(tests_of(case), settings)
        capacity = measure_capacity(checked, settings).capacity_Ah
        ocv, *_ = measure_ocv(checked, capacity)
        full = {id(log): InitialSoc(1.0, 0.01, "full") for log, _ in checked.tests.hppc}
        pulses = measure_pulses(checked, ocv, capacity, settings, full)
    except InputError as error:
        return str(error)
    figures = [capacity, *ocv.voltage_V]
    for sets in pulses.sets.values():
        for one in sets:
            figures += [x for f in one.fits for x in (*f.value, *f.error)]
            figures += [one.anchor.soc, *(ord(p.quality[0]) + p.start for p in one.pulses)]
    return " ".join(f"{x:.{DIGITS}g}" for x in figures) + repr(ocv.notes)


def identified(case: Case) -> dict[str, Any]:
    """The whole identification: its figures, and what logs are missed by that took no part."""
    try:
        found = identify_cell(tests_of(case), IdentifySettings(nominal_Ah=case.nominal_Ah))
    except InputError as error:
        return {"error": str(error)}
    missed = {}
    for name, start in case.judged:
        log = log_of(name)
        soc0 = initial_soc(found.model, log).soc if start is None else start
        missed[name] = 1e3 * simulate(found.model, log, soc0).rmse_above_10pct_V
    return {
        "missed_mV": missed,
        "capacity_Ah": found.model.capacity_Ah,
        "pulses": found.pulse_counts,
        "own_mV": 1e3 * found.fit.rmse_V,
        "notices": [notice.text for notice in found.notices],
    }


def kept(file: Path, make: Callable[[], Any]) -> Any:
    """From a file, else made now and written there."""
    if not file.exists():
        file.write_text(json.dumps(make()), encoding="utf-8")
    return json.loads(file.read_text(encoding="utf-8"))


def lost(rule: Rule, case: Case, keep: Path) -> str:
    """What the rule's absence changes for one cell, as text; empty: nothing."""
    before = kept(keep / f"{case.name}.begin.json", lambda: begin_of(case))
    with thrown(rule.names):
        if not rule.late and begin_of(case) == before:
            return ""
        now = identified(case)
    was = kept(keep / f"{case.name}.json", lambda: identified(case))
    if "error" in now:
        return f"refused: {now['error'][:160]}"
    said = [
        f"{Path(name).name} {was['missed_mV'][name]:.2f} -> {value:.2f} mV"
        for name, value in now["missed_mV"].items()
    ]
    if now["pulses"] != was["pulses"]:
        said.append(f"pulses {list(was['pulses'].values())} -> {list(now['pulses'].values())}")
    if not np.isclose(now["capacity_Ah"], was["capacity_Ah"], rtol=1e-6):
        said.append(f"capacity {was['capacity_Ah']:.4f} -> {now['capacity_Ah']:.4f} Ah")
    fewer, more = set(was["notices"]) - set(now["notices"]), len(now["notices"])
    if fewer:
        said.append(f"{len(fewer)} notice(s) other of {more}: {min(fewer)[:90]}")
    return "; ".join(said)


def main(arguments: list[str] | None = None) -> int:
    """Every rule off, one at a time, over all cells."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "identify")
    parser.add_argument("--only", default="", help="comma-separated names of rules")
    parser.add_argument("--cells", default="", help="comma-separated beginnings of cells' names")
    parser.add_argument("--list", action="store_true", help="names of all rules")
    chosen = parser.parse_args(arguments)
    if chosen.list:
        print("\n".join(rule.name for rule in RULES))
        return 0
    if data_folder() is None:
        print(f"skipped: no measured data; {HOW}")
        return 0
    chosen.keep.mkdir(parents=True, exist_ok=True)
    wanted = chosen.only.split(",") if chosen.only else [rule.name for rule in RULES]
    cells = tuple(chosen.cells.split(","))
    warnings.simplefilter("ignore")
    for rule in (r for r in RULES if r.name in wanted):
        print(f"## {rule.name}", flush=True)
        for case in (c for c in CASES if c.name.startswith(cells)):
            said = lost(rule, case, chosen.keep)
            if said:
                print(f"   {case.name}: {said}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
