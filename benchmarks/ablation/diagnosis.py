"""What is lost without each mechanism of the diagnosis, on a small panel of hidden effects.

python -m benchmarks.ablation.diagnosis --model MODEL.json [--physics DIR] [--keep DIR]
    [--only "a,b" | --together "a,b"] [--every-cause]

MODEL is that of the measured cell (Panasonic, 25 degC tests), DIR holds cases of the physics
laboratory. A case is one effect hidden in a measured drive or in a cell of simulated physics, or
nothing at all; what is compared is whether it is named first, what else is named, and the lead: by
how many nats the likeliest explanation that is right is ahead of the likeliest that is not.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measured_data import data_folder, measured_log
from benchmarks.physics_laboratory.changes import CHANGES
from benchmarks.physics_laboratory.stored import model_of, read_cases
from cellwise import CellModel, read_model
from cellwise.diagnose import diagnosis as station
from cellwise.diagnose.applied import apply
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.fit.rests import NO_READING
from cellwise.diagnose.odds import Weighed
from cellwise.logs import CellLog
from cellwise.logs.cell_log import resample

DIAGNOSE = "cellwise.diagnose"
PHYSICS = Path(__file__).resolve().parents[2] / "tests/acceptance/physics_cases"
MOST_NATS = 20.0  # a lead beyond this is no news
STEP_S, ROWS = 0.5, 6_000  # of a measured drive: 50 minutes, most of its pulses kept
# What each effect is most easily taken for is among these; --every-cause tries all.
RIVALS = (
    "current_offset", "current_gain", "voltage_offset", "initial_soc", "capacity", "ocv_shift",
    "ohmic_resistance", "slow_diffusion", "hysteresis", "lithium_inventory",
)  # fmt: skip
# Effect to its right names and its size, about the least that acceptance asks for: share of 1C,
# factor, volt, ohm, volt, ohm of 1,500 s.
HIDDEN = {
    "current_offset": (("current_offset",), 0.02),
    "current_gain": (("current_gain",), -0.04),
    "voltage_offset": (("voltage_offset",), 0.014),
    "resistance": (("ohmic_resistance", "resistance_scale"), 0.008),
    "hysteresis": (("hysteresis",), 0.020),
    "slow_diffusion": (("slow_diffusion",), 0.035),
}
# The smallest changes that a measured drive could show, in the order of this record.
LIMITS = (
    ("voltage_offset", "offset_V"), ("hysteresis", "m_V"), ("current_gain", "gain"),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Case:
    """Logs in which an effect of the names ``right`` is hidden (none: nothing).

    ``there`` are the names that may stand beside it.
    """

    name: str
    right: tuple[str, ...]
    there: tuple[str, ...]
    model: CellModel
    logs: tuple[CellLog, ...]
    holdout: tuple[CellLog, ...]
    baseline: tuple[CellLog, ...]
    soc0: Any


@dataclass(frozen=True)
class Result:
    """What was said of a case.

    ``lead`` [nats]; ``first``: whether the verdict is right, ``false``: names that are not there;
    ``limits`` as in :data:`LIMITS`, empty without a measured cell.
    """

    case: str
    verdict: str
    named: tuple[str, ...]
    first: bool
    false: int
    lead: float
    seconds: float
    limits: tuple[float, ...] = field(default=())


def measured(model: CellModel, data: Path) -> Iterator[Case]:
    """Effects hidden in two measured drives, with a clean one as baseline, and clean drives."""
    nn, us06, good = (
        resample(measured_log(data, f"panasonic_18650pf/drive_p25_{n}"), STEP_S).part(0, ROWS)
        for n in ("nn", "us06", "hwfta")
    )
    for effect, (right, size) in HIDDEN.items():
        a, b = (with_effect(log, effect, size, model.capacity_Ah) for log in (nn, us06))
        yield Case(f"measured {effect}", right, right, model, (a,), (b,), (good,), 1.0)
    yield Case("measured none", (), (), model, (nn,), (us06,), (good,), 1.0)
    yield Case("measured none, no baseline", (), (), model, (us06,), (nn,), (), 1.0)


def with_effect(log: CellLog, effect: str, size: float, capacity_Ah: float) -> CellLog:
    """The log as it would have been; the tester's own counter, which would tell, is left out."""
    current, dt = log.known_current_A(), log.interval_s
    voltage, read = log.voltage_V, current
    if effect == "current_offset":
        read = current + size * capacity_Ah
    elif effect == "current_gain":
        read = current * (1.0 + size)
    elif effect == "voltage_offset":
        voltage = voltage + size
    elif effect == "resistance":
        voltage = voltage - size * current
    elif effect == "hysteresis":
        keep = np.exp(-60.0 * np.abs(current) * dt / (3600.0 * capacity_Ah))
        voltage = voltage + size * first_order(keep, -np.sign(current))
    else:
        voltage = voltage - size * first_order(np.exp(-dt / 1500.0), current)
    return replace(log, current_A=read, voltage_V=voltage, charge_Ah=None)


def first_order(keep: Any, drive: Any) -> Any:
    """What follows a drive, keeping so much of itself at each row."""
    state = np.zeros(drive.size)
    for k in range(1, drive.size):
        state[k] = keep[k] * state[k - 1] + (1.0 - keep[k]) * drive[k]
    return state


def cases(model: CellModel, data: Path | None, physics: Path) -> Iterator[Case]:
    """The panel."""
    if data is not None:
        yield from measured(model, data)
    for case in read_cases(physics):
        changes = [CHANGES[c] for c in case.changes]
        right, there = (
            tuple(sorted(frozenset().union(*(getattr(c, k) for c in changes))))
            for k in ("acceptable", "there")
        )
        name = f"physics {case.seed} {' + '.join(case.changes) or 'none'}"
        cell = model_of(physics, case.cell)
        logs = case.logs, case.holdout, case.baseline
        yield Case(name, right, there, cell, *logs, case.soc0)


Replace = Callable[[Any], Any]


def slow_alone(stated: Any) -> Any:
    """The stated error without its fast part."""

    def found(*given: Any) -> Any:
        one = stated(*given)
        return replace(one, fast_V=np.ones(one.evidence.rows), fast_weight=0.0 * one.fast_weight)

    return found


SWITCHES: dict[str, tuple[tuple[str, Replace], ...]] = {
    "tolerances tried at shares": (
        ("fit.cause_fits.OVER", lambda old: old._replace(shares=(1.0,))),
    ),
    "scale of the noise averaged": (
        ("fit.cause_fits._times", lambda _: lambda *_: np.array([1.0])),
    ),
    "share of shapes in the noise": (
        ("fit.noise.Objective.with_shape", lambda _: lambda stated, _: stated),
    ),
    "fast and slow apart": (
        ("fit.noise.Objective.scaled", lambda _: one_band),
        ("fit.cause_fits.stated_objective", slow_alone),
    ),
    "starts read again": (
        ("fit.priors.start_readings", lambda _: lambda *_: {}),
        ("limits.start_readings", lambda _: lambda *_: {}),
    ),
    "current at rest": (("fit.rows.rest_reading", lambda _: lambda *_: NO_READING),),
    "voltage at rest": (("fit.rests.RestVoltages.ln_likelihood", lambda _: lambda *_: 0.0),),
    "physical sizes": (("fit.cause_fits.ln_size", lambda _: lambda *_: 0.0),),
    "noise of the baseline": (
        ("fit.noise.KnownScale.with_more", lambda _: lambda known, *_: known),
    ),
    "baseline": (("fit.cause_fits.CauseFits.calibrate", lambda _: lambda *_: None),),
    **{
        f"search, {name} {value}": (
            ("sets.SEARCH", lambda old, n=name, v=value: old._replace(**{n: v})),
        )
        for name, value in (("beam", 1), ("beam", 2), ("tried_share", 1.0))
    },
    "slower diffusion": (("sets.forms_of", lambda _: lambda cause, _c: (cause,)),),
    "blocks weighed at random": (("sets.weigh", lambda _: plainly_weighed),),
    "age is one cause": (("odds.AGE", lambda _: frozenset()),),
    "rare since the baseline": (("odds.RARE", lambda old: old._replace(since_baseline=0.0)),),
    "kept only if it simulates better": (("diagnosis.applied", lambda _: always_applied),),
}


def one_band(objective: Any, columns: Any) -> Any:
    """No windows: everything is slow."""
    scale = objective.evidence.known * np.sqrt(objective.weight) / objective.size_V
    found = columns * scale[:, None]
    found[~objective.evidence.known] = 0.0
    return found


def plainly_weighed(hypotheses: Any, *_: Any) -> Any:
    """Sets by their odds alone."""
    odds = np.array([h[1] for h in hypotheses])
    share = np.exp(odds - odds.max())
    found = [Weighed(h[0], float(p)) for h, p in zip(hypotheses, share / share.sum(), strict=True)]
    return tuple(sorted(found, key=lambda w: -w.probability))


def always_applied(fits: Any, outcome: Any, logs: Any) -> Any:
    """All accepted causes, whatever held-out rows say."""
    causes = [a.cause for a in outcome.accepted]
    return apply(fits, causes, outcome.fit, logs) if causes else None


@contextmanager
def without(name: str) -> Iterator[None]:
    """The mechanism switched off."""
    undo = []
    for path, new in SWITCHES[name]:
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


def judged(case: Case, every: bool = False) -> Result:
    """One diagnosis; the lead is read where it is decided."""
    seen: list[Any] = []
    decide = station.decide

    def watched(sets: Any) -> Any:
        seen.append(sets)
        return decide(sets)

    tried = None if every else [n for n in CAUSES if n in {*RIVALS, *case.right}]
    groups = case.logs, case.holdout, case.baseline, case.soc0
    station.decide = watched  # type: ignore[attr-defined]
    began = time.process_time()
    try:
        said = station.diagnose(case.model, *groups, causes=tried)
    finally:
        station.decide = decide  # type: ignore[attr-defined]
    right, wrong = [-1e9], [-1e9]
    for one in seen[0].tried.values() if seen else ():
        fits = bool(set(case.right) & set(one.names)) if case.right else not one.causes
        (right if fits else wrong).append(seen[0].odds(one))
    lead = float(np.clip(max(right) - max(wrong), -MOST_NATS, MOST_NATS)) if seen else 0.0
    names = tuple(c.name for c in said.causes)
    limits: tuple[float, ...] = ()
    if case.name == "measured none":
        limits = tuple(said.limits.get(c, {}).get(p, np.inf) for c, p in LIMITS)
    return Result(
        case.name,
        said.verdict,
        names,
        said.verdict in (case.right or ("none", "unexplained")),
        len(set(names) - {*case.right, *case.there}),
        lead,
        time.process_time() - began,
        limits,
    )


def line(name: str, usual: list[Result], found: list[Result]) -> str:
    """A row of the table: what is named, the limits, and the lead that is lost."""
    lost = np.array([a.lead - b.lead for a, b in zip(usual, found, strict=True)])
    std = float(np.std(lost)) / np.sqrt(max(lost.size - 1, 1))
    k = int(np.argmax(lost))
    worst = f"{found[k].case} {lost[k]:+.1f}" if lost[k] > 0.5 else ""
    limits = next((r.limits for r in found if r.limits), None)
    shown = "" if limits is None else f"{1e3 * limits[0]:.1f}, {1e3 * limits[1]:.1f} mV, "
    shown += "" if limits is None else f"{100 * limits[2]:.1f} %"
    return (
        f"| {name} | {sum(r.first for r in found)} of {len(found)} | "
        f"{sum(r.false for r in found)} | {lost.mean():+.1f} +- {std:.1f} | {worst} | {shown} | "
        f"{sum(r.seconds for r in found):.0f} |"
    )


def main() -> int:
    """Run what is not kept yet, and print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--physics", type=Path, default=PHYSICS, help="cases of the laboratory")
    parser.add_argument("--keep", type=Path, default=Path("build/ablation_diagnosis"))
    parser.add_argument("--cases", default="", help="cases of these words, by commas")
    parser.add_argument("--only", default="", help="switches, separated by semicolons")
    parser.add_argument("--together", default="", help="the same, all of them off at once")
    parser.add_argument("--every-cause", action="store_true", help="not the usual rivals alone")
    chosen = parser.parse_args()
    chosen.keep.mkdir(parents=True, exist_ok=True)
    words = chosen.cases.split(",")
    panel = [
        case
        for case in cases(read_model(chosen.model), data_folder(), chosen.physics)
        if any(w in case.name for w in words)
    ]
    every = chosen.every_cause
    wanted: list[tuple[str, ...]] = [()]
    if chosen.together:
        wanted.append(tuple(chosen.together.split(";")))
    else:
        wanted += [(n,) for n in (chosen.only.split(";") if chosen.only else SWITCHES)]
    print("| without | first | false | lead lost [nats] | most | limits | cpu s |")
    print("|---|---|---|---|---|---|---|")
    usual: list[Result] = []
    for names in wanted:
        name = "; ".join(names) or "nothing"
        file = chosen.keep / f"without {name}{' every cause' * every}.json"
        if not file.exists():
            with ExitStack() as off:
                for one in names:
                    off.enter_context(without(one))
                found = [judged(case, every) for case in panel]
            file.write_text(json.dumps([asdict(r) for r in found]), encoding="utf-8")
        found = [Result(**r) for r in json.loads(file.read_text(encoding="utf-8"))]
        usual = usual or found
        print(line(name, usual, found), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
