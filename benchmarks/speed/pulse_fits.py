"""One pulse at 135 Hz identified by variable projection, scipy's optimisers and the swarm."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.figures import Figure, Progress, clock, with_ratios
from benchmarks.measured_data import HOW, REPOSITORY, measured_log
from benchmarks.speed.pulse_references import Optimiser, ScipyPulse
from benchmarks.speed.synthetic_truth import (
    CAPACITY_AH,
    LEVELS,
    PARAMETERS,
    level_of,
    relative_error,
    synthetic_hppc,
)
from cellwise.identify.fitted_pulses import cut_pulses
from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.identify.papers.swarm import SwarmOptions, fit_swarm
from cellwise.identify.pulse_fit.fit_pulse import fit_pulse
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.logs import CellLog, read_log
from cellwise.typing import FloatArray

UNIT = "ms/pulse"
TIMES_FASTER = 50.0
OTHER_PULSES = 12  # of each log that the fit is compared on
WORSE_BY = 1e-3  # less than this share is rounding


@dataclass(frozen=True)
class Fitted:
    """One pulse fitted by somebody."""

    seconds: float
    rmse_V: float
    values: FloatArray  # R0, R1, tau1, R2, tau2


def pulse_figures(data: Path | None, say: Progress) -> list[Figure]:
    """Time, error against the truth and residual, over one pulse of each level."""
    say("synthetic HPPC test at 135 Hz")
    made = synthetic_hppc()
    pulses = _one_per_level(healthy_pulses(made.log, CAPACITY_AH, 1.0))
    rows = int(np.median([len(p) for p in pulses]))
    group = f"identify one pulse, 135 Hz, median of {len(pulses)} levels, {rows:,} rows each"
    methods: dict[str, Callable[[PulseData], Fitted]] = {
        "varpro (7 parameters)": lambda p: _ours(p, None),
        "scipy least_squares lm": lambda p: _scipy(p, "lm"),
        "scipy least_squares trf": lambda p: _scipy(p, "trf"),
        "scipy curve_fit": lambda p: _scipy(p, "curve_fit"),
        "swarm 64 x 180, 5 parameters (LFP paper)": lambda p: _ours(p, SwarmOptions()),
        "swarm 64 x 180, 7 parameters": lambda p: _ours(p, SwarmOptions(free=7)),
    }
    fitted: dict[str, list[Fitted]] = {}
    for who, fit in methods.items():
        say(who)
        fit(pulses[0])
        fitted[who] = [fit(p) for p in pulses]
    figures = with_ratios(
        [_time_row(group, who, fits, made.cell, pulses) for who, fits in fitted.items()]
    )
    return figures + _promises(group, fitted, data, say)


def healthy_pulses(log: CellLog, capacity_Ah: float, soc0: float) -> list[PulseData]:
    """The healthy pulses of a log, cut."""
    soc = soc0 - log.counted_charge_Ah() / capacity_Ah
    return list(cut_pulses(log, pulses_to_fit(find_pulses(log)), capacity_Ah, soc))


def _one_per_level(pulses: Sequence[PulseData]) -> list[PulseData]:
    """The discharge pulse nearest to 1C of every level."""
    level = level_of(np.array([p.soc for p in pulses]))
    chosen = []
    for at in LEVELS:
        here = [p for p, x in zip(pulses, level, strict=True) if x == at]
        down = [p for p in here if p.pulse_current_A > 0.0] or here
        if down:
            chosen.append(min(down, key=lambda p: abs(abs(p.pulse_current_A) - CAPACITY_AH)))
    return chosen


def _ours(pulse: PulseData, swarm: SwarmOptions | None) -> Fitted:
    if swarm is not None:
        began = time.perf_counter()
        fit = fit_swarm(pulse, swarm)
        seconds = time.perf_counter() - began
    else:
        fit = fit_pulse(pulse)
        seconds = clock(lambda: fit_pulse(pulse), seconds=0.1).best
    return Fitted(seconds, fit.rmse_V, np.array(fit.value[:5]))


def _scipy(pulse: PulseData, optimiser: Optimiser) -> Fitted:
    problem = ScipyPulse(pulse)
    p = problem.fit(optimiser)
    seconds = clock(lambda: problem.fit(optimiser), seconds=0.2, most=10).best
    return Fitted(seconds, problem.rmse_V(p), p[2:])


def _time_row(
    group: str, who: str, fits: Sequence[Fitted], cell: object, pulses: Sequence[PulseData]
) -> Figure:
    errors = [
        100.0
        * float(
            np.median(
                [
                    abs(relative_error(cell, name, p.soc, f.values[k]))
                    for f, p in zip(fits, pulses, strict=True)
                ]
            )
        )
        for k, name in enumerate(PARAMETERS)
    ]
    symbols = ("R0", "R1", "tau1", "R2", "tau2")
    said = ", ".join(f"{s} {e:.2g}" for s, e in zip(symbols, errors, strict=True))
    rmse = 1e3 * float(np.median([f.rmse_V for f in fits]))
    return Figure(
        group,
        who,
        1e3 * float(np.median([f.seconds for f in fits])),
        UNIT,
        note=f"median error % {said}; residual {rmse:.3f} mV",
    )


def _promises(
    group: str, fitted: dict[str, list[Fitted]], data: Path | None, say: Progress
) -> list[Figure]:
    """At least fifty times faster than the swarm, and never a worse fit."""
    ours = fitted["varpro (7 parameters)"]
    figures = []
    for who, fits in fitted.items():
        if not who.startswith("swarm"):
            continue
        faster = float(np.min([f.seconds / o.seconds for f, o in zip(fits, ours, strict=True)]))
        figures.append(
            Figure(
                group,
                f"varpro faster than {who}",
                faster,
                "times",
                target=TIMES_FASTER,
                at_least=True,
                note="the smallest ratio of all levels",
            )
        )
    worse = sum(
        o.rmse_V > (1.0 + WORSE_BY) * f.rmse_V
        for who, fits in fitted.items()
        if who.startswith("swarm")
        for f, o in zip(fits, ours, strict=True)
    )
    compared = 2 * len(ours)
    sources = ["synthetic"]
    for name, log, capacity in _other_logs(data, say):
        pulses = healthy_pulses(log, capacity, 1.0)
        for pulse in pulses[:: max(1, len(pulses) // OTHER_PULSES)]:
            best = fit_pulse(pulse).rmse_V
            for options in (SwarmOptions(), SwarmOptions(free=7)):
                swarm = fit_swarm(pulse, options)
                compared += 1
                worse += best > (1.0 + WORSE_BY) * swarm.rmse_V
        sources.append(name)
    note = f"of {compared} comparisons: {', '.join(sources)}"
    if data is None:
        note += f"; no measured pulses: {HOW}"
    figures.append(
        Figure(
            group, "varpro fits worse than the swarm", float(worse), "pulses", target=0.0, note=note
        )
    )
    return figures


def _other_logs(data: Path | None, say: Progress) -> list[tuple[str, CellLog, float]]:
    """Pulses of physics and of measured cells, where the circuit is not the truth."""
    logs = [
        ("embedded nmc", read_log(REPOSITORY / "datasets" / "nmc" / "hppc.parquet"), 5.13),
        ("embedded lfp", read_log(REPOSITORY / "datasets" / "lfp" / "hppc.parquet"), 2.30),
    ]
    if data is not None:
        logs += [
            ("Panasonic", measured_log(data, "panasonic_18650pf/hppc_p25"), 2.997),
            ("Panasonic -10 degC", measured_log(data, "panasonic_18650pf/hppc_n10"), 2.997),
        ]
    for name, *_ in logs:
        say(f"fits compared on {name}")
    return logs
