"""Sealed cases: logs of an emulated cell in which nothing, one or two effects are hidden.

case = hidden_case(seed=7, effects=("current_offset",), size_V=0.010)
d = diagnose(case.model, case.logs, case.holdout, case.baseline, case.soc0)
truth = case.open(d)         # only now
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from cellwise import CellModel, simulate
from cellwise.logs.cell_log import CellLog
from emulator import Sensor, emulate, measure
from emulator_cells import Chemistry, Misfit, identified_model, known_model, random_cell
from emulator_drives import Load, random_load
from emulator_effects import EFFECTS, FAMILIES, World, amplitude, draw_effect, size_of

FASTER = 3.0  # 10 Hz logs have so many times the rows, and a third of the hours


@dataclass(frozen=True)
class Plan:
    """How a case is made; None: drawn at random. ``rows`` are those of a log at 1 Hz."""

    rows: int = 5000
    rate_hz: float | None = None
    chemistry: Chemistry | None = None
    baseline: bool | None = None
    train: int = 2
    model: Literal["known", "identified"] | None = None
    misfit: Misfit = field(default_factory=Misfit)


@dataclass(frozen=True)
class HiddenEffect:
    """One hidden effect: its parameters as the contract names them, and its size [V]."""

    name: str
    parameters: dict[str, float]
    size_V: float


@dataclass(frozen=True)
class Truth:
    """What was hidden, and what the held-out error would be without it."""

    effects: tuple[HiddenEffect, ...]
    world: World
    plain: World
    soc0: tuple[float, ...]  # told, of the training logs
    possible_rmse_V: float
    about: str

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(e.name for e in self.effects)


class Sealed:
    """A case whose answer comes out only against a verdict."""

    def __init__(
        self,
        label: str,
        model: CellModel,
        logs: Sequence[CellLog],
        holdout: Sequence[CellLog],
        baseline: Sequence[CellLog],
        soc0: float | Literal["auto"],
        answer: Callable[[], Truth],
    ) -> None:
        self.label = label
        self.model = model
        self.logs = tuple(logs)
        self.holdout = tuple(holdout)
        self.baseline = tuple(baseline)
        self.soc0 = soc0
        self.__answer = answer

    def open(self, diagnosis: Any) -> Truth:
        """The truth, for a diagnosis that has made up its mind."""
        verdict = getattr(diagnosis, "verdict", None)
        if not (isinstance(verdict, str) and verdict):
            raise ValueError("the answer stays sealed until there is a verdict")
        return self.__answer()


@dataclass(frozen=True, eq=False)
class _Setting:
    """Everything of a case but its effects; the last load is the good log's."""

    seed: int
    plain: World
    model: CellModel
    loads: tuple[Load, ...]
    told: tuple[float, ...]
    soc0: float | Literal["auto"]
    with_baseline: bool
    about: str

    def log(self, world: World, k: int, name: str) -> CellLog:
        """The log of one load; its noise is the same whatever is hidden."""
        load, start = self.loads[k], self.told[k] + world.soc0_shift
        run = emulate(world.cell, load.time_s, load.current_A, load.temperature_C, start)
        return measure(run, world.sensor, np.random.default_rng([self.seed, 1000 + k]), name)


def hidden_case(
    seed: int, effects: tuple[str, ...] = (), size_V: float = 0.010, plan: Plan | None = None
) -> Sealed:
    """One case: cell, loads, instrument and the effects' sign and shape are drawn from the seed.

    ``size_V`` is the size of each effect in the training logs, as `emulator_effects` means it.
    """
    plan = plan or Plan()
    rng = np.random.default_rng([seed, len(effects)])
    setting = _setting(seed, effects, plan, rng)
    train = list(zip(setting.loads, setting.told, strict=True))[: plan.train]
    world, hidden = setting.plain, []
    for name in effects:
        draw = draw_effect(rng)
        if name == "initial_soc" and setting.told[0] > 0.94:
            draw = replace(draw, sign=-1.0)  # nothing is fuller than full
        put, x = EFFECTS[name][0], amplitude(name, draw, setting.plain, train, size_V)
        alone, values = put(setting.plain, draw, x)
        world = put(world, draw, x)[0]
        if name == "initial_soc":
            values = {"soc0": setting.told[0] + values["soc0"]}
        hidden.append(HiddenEffect(name, values, size_of(setting.plain, alone, train)))

    def answer() -> Truth:
        clean = setting.log(setting.plain, plan.train, "clean")
        possible = simulate(setting.model, clean, setting.told[plan.train]).metrics.rmse_V
        told = setting.told[: plan.train]
        return Truth(tuple(hidden), world, setting.plain, told, possible, setting.about)

    logs = [setting.log(world, k, f"log {k + 1}") for k in range(plan.train + 1)]
    good = [setting.log(setting.plain, -1, "good log")] if setting.with_baseline else []
    return Sealed(
        label=f"seed {seed}",
        model=setting.model,
        logs=logs[: plan.train],
        holdout=logs[plan.train :],
        baseline=good,
        soc0=setting.soc0,
        answer=answer,
    )


def _setting(seed: int, effects: tuple[str, ...], plan: Plan, rng: np.random.Generator) -> _Setting:
    chemistry: Chemistry = plan.chemistry or ("nmc" if rng.random() < 0.7 else "lfp")
    rate = plan.rate_hz or (1.0 if rng.random() < 0.8 else 10.0)
    baseline = rng.random() < 0.5 if plan.baseline is None else plan.baseline
    # What is hidden must not be in the model already, and heat shows only through Arrhenius.
    third = rng.random() < 0.35 and "slow_diffusion" not in effects
    warm = (rng.random() < 0.3 or "self_heating" in effects) and (
        "temperature_dependence" not in effects
    )
    # A start that is told may be wrong; on a flat OCV nobody would trust the first rest.
    auto = rng.random() < 0.4 and chemistry == "nmc" and "initial_soc" not in effects
    cell = random_cell(
        rng, chemistry, third=third, activation_K=float(rng.uniform(1500.0, 3500.0)) * warm
    )
    noise_V = float(rng.uniform(0.3e-3, 1.5e-3))
    plain = World(cell, _instrument(rng, cell.capacity_Ah, noise_V))
    known = (plan.model or ("known", "identified")[int(rng.integers(2))]) == "known"
    model = known_model(cell, rng, plan.misfit, noise_V) if known else identified_model(cell, rng)
    count = plan.train + 2
    told = tuple(float(x) for x in rng.uniform(0.85, 0.96, count))
    told = told if auto else told[:1] * count
    loads = tuple(
        random_load(
            rng,
            cell.capacity_Ah,
            told[k],
            rows=round(plan.rows * (1.0 if rate == 1.0 else FASTER) * rng.uniform(0.8, 1.2)),
            rate_hz=rate,
            charge=k in (0, plan.train) or rng.random() < 0.5,
            temperature_C=(5.0, 42.0),
        )
        for k in range(count)
    )
    about = f"{chemistry} {cell.capacity_Ah:.1f} Ah {rate:g} Hz soc0 {'auto' if auto else 'told'}"
    about += "".join(
        f", {word}"
        for word, is_so in (
            ("baseline", baseline),
            ("3 RC", third),
            ("warm", warm),
            ("identified", not known),
        )
        if is_so
    )
    return _Setting(seed, plain, model, loads, told, "auto" if auto else told[0], baseline, about)


def random_pair(rng: np.random.Generator) -> tuple[str, str]:
    """Two effects of two families."""
    first, second = rng.choice(len(FAMILIES), 2, replace=False)
    return str(rng.choice(FAMILIES[first])), str(rng.choice(FAMILIES[second]))


def _instrument(rng: np.random.Generator, capacity_Ah: float, noise_V: float) -> Sensor:
    return Sensor(
        noise_A=float(10.0 ** rng.uniform(-3.5, -2.5)) * capacity_Ah,
        noise_V=noise_V,
        noise_C=0.05,
        step_A=float(rng.choice([0.0, 1e-4, 1e-3])) * capacity_Ah,
        step_V=float(rng.choice([0.0, 1e-4, 1e-3])),
        step_C=0.1,
    )
