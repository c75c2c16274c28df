"""What is lost without each mechanism of the diagnosis, on a small panel of hidden effects.

python -m benchmarks.ablation.diagnosis --model MODEL.json [--keep DIR] [--only "a,b"]

MODEL is that of the measured cell (Panasonic, 25 degC tests). A case is one effect hidden in
measured drives, in an emulated cell or in a cell of the physics laboratory, or nothing at all; what
is compared is whether it is named first, what else is named, and the lead: by how many nats the
likeliest explanation that is right is ahead of the likeliest that is not.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measured_data import data_folder, measured_log
from benchmarks.physics_laboratory.stored import model_of, read_cases
from cellwise import CellModel, read_model
from cellwise.diagnose import diagnosis as station
from cellwise.diagnose.decision.odds import Weighed
from cellwise.diagnose.fit.priors import AGE
from cellwise.diagnose.fit.rests import NO_READING
from cellwise.diagnose.log_runs import apply
from cellwise.logs import CellLog
from cellwise.logs.resample import resample
from emulator import Sensor
from emulator_effects import World
from hidden_cases import Plan, hidden_case
from hide import emulated_cell, hide_in

DIAGNOSE = "cellwise.diagnose"
PHYSICS = Path(__file__).resolve().parents[2] / "tests/diagnose/physics_cases"
MOST_NATS = 20.0  # a lead beyond this is no news
REST_OHM = 0.028  # of the measured cell under load: sizes are shares of it
STEP_S, ROWS = 0.2, 8_000  # of a measured drive: its pulses are kept, and an hour is enough
EMULATED = ("initial_soc", "hysteresis", "ocv_shift")


@dataclass(frozen=True, eq=False)
class Case:
    """Logs in which ``truth`` is hidden ("none": nothing)."""

    name: str
    truth: str
    model: CellModel
    logs: tuple[CellLog, ...]
    holdout: tuple[CellLog, ...]
    baseline: tuple[CellLog, ...]
    soc0: Any


@dataclass(frozen=True)
class Result:
    """What was said of a case. ``lead`` [nats]; ``gain`` of the first cause on held-out rows."""

    case: str
    truth: str
    verdict: str
    named: tuple[str, ...]
    lead: float
    gain: float
    seconds: float


def measured(model: CellModel, data: Path) -> Iterator[Case]:
    """Effects hidden in two measured drives, with a clean one beside them, and clean drives."""
    us06, nn, good = (
        resample(measured_log(data, f"panasonic_18650pf/drive_p25_{n}"), STEP_S).part(0, ROWS)
        for n in ("us06", "nn", "hwfta")
    )
    drives = {"us06": us06, "nn": nn}
    cell = emulated_cell(model)
    ah = model.capacity_Ah
    worlds = {
        "current_gain": World(cell, Sensor(gain=0.95)),
        "time_skew": World(cell, Sensor(skew_s=0.6)),
        "capacity": World(replace(cell, capacity_Ah=0.93 * ah)),
        "none": World(cell),
    }
    for truth, world in worlds.items():
        a, b = (hide_in(log, World(cell), world, 1.0, n) for n, log in drives.items())
        yield Case(f"measured {truth}", truth, model, (a,), (b,), (good,), 1.0)
    for truth in ("resistance_scale", "slow_diffusion"):
        a, b = (shifted(log, truth) for log in drives.values())
        yield Case(f"measured {truth}", truth, model, (a,), (b,), (good,), 1.0)
    alone = tuple(drives.values())
    yield Case("measured none alone", "none", model, alone[:1], alone[1:], (), 1.0)


def shifted(log: CellLog, truth: str) -> CellLog:
    """A drop that the cell does not have, added to the voltage."""
    drive, current = np.zeros(len(log)), log.known_current_A()
    if truth == "resistance_scale":
        drive = 0.4 * REST_OHM * current
    else:
        keep = np.exp(-log.interval_s / 1500.0)
        for k in range(1, len(log)):
            drive[k] = keep[k] * drive[k - 1] + (1.0 - keep[k]) * 1.5 * REST_OHM * current[k]
    return replace(log, voltage_V=log.voltage_V - drive, charge_Ah=None)


def cases(model: CellModel, data: Path | None) -> Iterator[Case]:
    """The panel."""
    if data is not None:
        yield from measured(model, data)
    for k, truth in enumerate((*EMULATED, "none")):
        hidden = () if truth == "none" else (truth,)
        sealed = hidden_case(500 + k, hidden, 0.015, Plan(rows=2500, rate_hz=1.0, model="known"))
        logs = sealed.logs, sealed.holdout, sealed.baseline
        yield Case(f"emulated {truth}", truth, sealed.model, *logs, sealed.soc0)
    names = {(): "none", ("contact_resistance",): "ohmic_resistance"}
    for case in read_cases(PHYSICS):
        logs = case.logs, case.holdout, case.baseline
        truth = names[case.changes]
        yield Case(f"physics {truth}", truth, model_of(PHYSICS, case.cell), *logs, case.soc0)


Replace = Callable[[Any], Any]
SWITCHES: dict[str, tuple[tuple[str, Replace], ...]] = {
    "tolerances tried at shares": (("fit.likelihood.SHARES", lambda _: (1.0,)),),
    "scale of the noise averaged": (
        ("fit.likelihood._times", lambda _: lambda *_: np.array([1.0])),
    ),
    "wrong shapes": (
        ("fit.likelihood.wrong_shapes", lambda _: lambda e, *_: np.zeros((e.rows, 0))),
    ),
    "share of shapes in the noise": (
        ("fit.cause_fits.with_shape", lambda _: lambda _e, size, weight, _s: (size, weight)),
    ),
    "fast and slow apart": (
        ("fit.least_squares.Objective.bands", lambda _: lambda o, c: (one_band(o, c), 0.0 * c)),
        (
            "fit.cause_fits.fast_part",
            lambda _: lambda _m, e, *_: (np.ones(e.rows), np.zeros(e.rows)),
        ),
    ),
    "what comes back": (("fit.noise.STATED", lambda old: old._replace(returns=0.0)),),
    "tolerances by what comes back": (("fit.priors._owed", lambda _: lambda *_: {}),),
    "starts read again": (
        ("fit.priors.start_readings", lambda _: lambda *_: {}),
        ("fit.limits.start_readings", lambda _: lambda *_: {}),
    ),
    "stated starts wrong together": (
        ("fit.least_squares.Prior.together", lambda _: lambda prior, *_: prior),
    ),
    "start between the branches": (("fit.priors.GOOD", lambda old: old._replace(off_branch=1e-6)),),
    "current at rest": (("fit.rows.rest_reading", lambda _: lambda *_: NO_READING),),
    "voltage at rest": (("fit.rests.RestVoltages.ln_likelihood", lambda _: lambda *_: 0.0),),
    "physical sizes": (("fit.cause_fits.ln_size", lambda _: lambda *_: 0.0),),
    "sizes since the baseline": (("fit.priors.SAME_AGE", lambda _: AGE),),
    "noise of the baseline": (
        ("fit.noise.KnownScale.with_more", lambda _: lambda known, *_: known),
    ),
    "baseline": (("fit.cause_fits.CauseFits.calibrate", lambda _: lambda *_: None),),
    "beginnings in the score test": (
        ("decision.explanations._from_beginnings", lambda _: lambda *_: 0.0),
    ),
    **{
        f"search, {name} {value}": (
            ("decision.explanations.SEARCH", lambda old, n=name, v=value: old._replace(**{n: v})),
        )
        for name, value in (("beam", 1), ("beam", 2), ("beginnings", 1), ("tried_share", 1.0))
    },
    "slower diffusion": (("decision.explanations.forms_of", lambda _: lambda cause, _c: (cause,)),),
    "blocks weighed at random": (("decision.outcome.weigh", lambda _: plainly_weighed),),
    "age is one cause": (("decision.odds.AGE", lambda _: frozenset()),),
    "rare since the baseline": (("decision.odds.SINCE_BASELINE_NATS", lambda _: 0.0),),
    "kept only if it simulates better": (("diagnosis.applied", lambda _: always_applied),),
    "the whole cell beside a cause": (
        ("log_runs._explained", lambda old: lambda f, c, n, _w: old(f, c, n, False)),
    ),
}


def one_band(objective: Any, columns: Any) -> Any:
    """No windows: everything is slow."""
    scale = objective.evidence.known * np.sqrt(objective.weight) / objective.size_V
    found = columns * scale[:, None]
    found[~objective.evidence.known] = 0.0
    return found


def plainly_weighed(hypotheses: Any, *_: Any) -> Any:
    """Sets by their odds alone."""
    odds = np.array([h.total - h.rarity for h in hypotheses])
    share = np.exp(odds - odds.max())
    found = [
        Weighed(h.causes, float(p)) for h, p in zip(hypotheses, share / share.sum(), strict=True)
    ]
    return tuple(sorted(found, key=lambda w: -w.probability))


def always_applied(fits: Any, outcome: Any, logs: Any) -> Any:
    """All accepted causes, whatever held-out rows say."""
    causes = [a.cause for a in outcome.accepted]
    return apply(fits, causes, outcome.fit, outcome.noise, logs) if causes else None


@contextmanager
def without(name: str) -> Iterator[None]:
    """The mechanism switched off."""
    undo = []
    for path, new in SWITCHES.get(name, ()):
        *way, last = path.split(".")
        owner: Any = None
        for k in range(len(way), 0, -1):
            try:
                owner = importlib.import_module(".".join((DIAGNOSE, *way[:k])))
            except ModuleNotFoundError:
                continue
            for inner in way[k:]:
                owner = getattr(owner, inner)
            break
        old = getattr(owner, last)
        undo.append((owner, last, old))
        setattr(owner, last, new(old))
    try:
        yield
    finally:
        for owner, last, old in undo:
            setattr(owner, last, old)


def judged(case: Case) -> Result:
    """One diagnosis; the lead is read where it is decided."""
    seen: list[Any] = []
    decide = station.decide

    def watched(sets: Any) -> Any:
        seen.append(sets)
        return decide(sets)

    station.decide = watched  # type: ignore[attr-defined]
    began = time.perf_counter()
    try:
        said = station.diagnose(case.model, case.logs, case.holdout, case.baseline, case.soc0)
    finally:
        station.decide = decide  # type: ignore[attr-defined]
    right, wrong = [-1e9], [-1e9]
    for one in seen[0].tried.values() if seen else ():
        fits = not one.causes if case.truth == "none" else case.truth in one.names
        (right if fits else wrong).append(seen[0].odds(one))
    lead = float(np.clip(max(right) - max(wrong), -MOST_NATS, MOST_NATS)) if seen else 0.0
    gain = said.causes[0].gain if said.causes else 0.0
    names = tuple(c.name for c in said.causes)
    seconds = time.perf_counter() - began
    return Result(case.name, case.truth, said.verdict, names, lead, float(gain), seconds)


def line(name: str, usual: list[Result], found: list[Result]) -> str:
    """A row of the table: what is named, and the lead that is lost."""
    first = sum(r.verdict in (r.truth, "unexplained" if r.truth == "none" else "") for r in found)
    false = sum(len(set(r.named) - {r.truth}) for r in found)
    lost = np.array([a.lead - b.lead for a, b in zip(usual, found, strict=True)])
    std = float(np.std(lost)) / np.sqrt(max(lost.size - 1, 1))
    worst = found[int(np.argmax(lost))].case if np.max(lost) > 0.5 else ""
    seconds = sum(r.seconds for r in found)
    return (
        f"| {name} | {first} of {len(found)} | {false} | {lost.mean():+.1f} +- {std:.1f} | "
        f"{worst} {max(lost.max(), 0.0):+.1f} | {seconds:.0f} |"
    )


def main() -> int:
    """Run what is not kept yet, and print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--keep", type=Path, default=Path("build/ablation_diagnosis"))
    parser.add_argument("--only", default="", help="comma-separated names of switches")
    chosen = parser.parse_args()
    chosen.keep.mkdir(parents=True, exist_ok=True)
    panel = list(cases(read_model(chosen.model), data_folder()))
    wanted = ["nothing", *(chosen.only.split(",") if chosen.only else SWITCHES)]
    print("| without | named first | false names | lead lost [nats] | most | s |")
    print("|---|---|---|---|---|---|")
    usual: list[Result] = []
    for name in wanted:
        file = chosen.keep / f"without {name}.json"
        if not file.exists():
            with without(name):
                found = [judged(case) for case in panel]
            file.write_text(json.dumps([asdict(r) for r in found]), encoding="utf-8")
        found = [Result(**r) for r in json.loads(file.read_text(encoding="utf-8"))]
        usual = usual or found
        print(line(name, usual, found), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
