"""Ways to build a gauge, and how wrong each is: on the certificate's virtual cells, without faults.

A coarse design: what laboratory tests leave open is what a model's posterior, its stated error and
cells of one type leave; what the circuit itself gets wrong stays as it is.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.benchmark.certify.certificate import life_error, soc_error
from cellwise.benchmark.certify.lives import MODEL, SETTLED_S, CertifiedLife, Fleet
from cellwise.benchmark.certify.virtual_cells import START_STD, CellSpread
from cellwise.benchmark.certify.worlds import PERFECT
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.options import Options
from cellwise.estimate.fixed.stepper import Stepper
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.sensor import CAR, CLASSES, SensorReadings, seen_by
from cellwise.export.firmware import Firmware, HostLibrary
from cellwise.fit.population import SAME_CELL
from cellwise.typing import FloatArray

LifeError = dict[str, Any]  # of `life_error`
LIFE_YEARS = 5.0  # to 80 % of the capacity, what UN GTR 22 asks of a vehicle's battery
UPDATED_YEARS = 1.0  # between two updates of capacity and resistances from a history
MOST_HOURS = 24.0  # of each cell
UNKNOWN_CAPACITY = 0.03  # of a data sheet's: between its minimum and its typical value
# Steps: what is asked for, its code in bytes and its mean instructions on a Cortex-M4F, of three
# states, as counted for benchmarks/results/firmware.json.
STEPS: dict[str, tuple[dict[str, Any], int, int]] = {
    "lean": ({"wide": False}, 2156, 401),
    "wide": ({"components": 1}, 10568, 781),
    "offset": ({"components": 1, "offset": True}, 11510, 1013),
    "bank": ({}, 10568, 1924),
}
POINTS = (11, 21, 51)  # of the tables over SOC
# Tests of one cell, each with those before it, and hours: a charge, rests and C/5; pulses at ten
# levels with rests of an hour; C/20 both ways.
TESTS = {"none": 0, "capacity": 10, "pulses": 26, "ocv": 68}


# What makes a design wrong, and what of the cells' spread is perfect without it.
CAUSES: dict[str, dict[str, float]] = {
    "age": {"age": 0.0},
    "temperature": {},
    "cells": dict.fromkeys(
        ("capacity", "resistance", "branch", "hysteresis_V", "activation_K"), 0.0
    ),
    "model_error": {"model_error": 0.0},
    "sensor": {},
    "start": {},
}


class Ask(NamedTuple):
    """A limit: the SOC error as a fraction, which figure of it, at a temperature, after years."""

    limit: float
    figure: str
    temperature_C: float
    years: float


@dataclass(frozen=True)
class DesignOption:
    """One way to build it.

    Parameters
    ----------
    sensor, step, tests : str     of `CLASSES`, `STEPS`, `TESTS`
    points : int                  of the tables over SOC
    updated : bool                capacity and resistances come from a history, once a year
    """

    sensor: str
    step: str
    points: int
    tests: str
    updated: bool


def all_options() -> list[DesignOption]:
    """Every combination."""
    return [DesignOption(*one) for one in product(CLASSES, STEPS, POINTS, TESTS, (False, True))]


@dataclass(frozen=True, eq=False)
class Design:
    """Options on virtual cells of a model.

    Parameters
    ----------
    model : CellModel
    ask : Ask
    dt_s : float              time step of the target [s]
    hours : float             of each cell, a day at most
    seed : int
    """

    model: CellModel
    ask: Ask
    dt_s: float
    hours: float
    seed: int

    def try_on(
        self, found: Sequence[list[LifeError]], options: Sequence[DesignOption], cells: int
    ) -> None:
        """Append errors of options that share their lives, up to so many cells."""
        steps = [self.step(option) for option in options]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for number in range(len(found[0]), cells):
                errors = _errors_of(self.model, self.life(options[0], number), self.dt_s)
                for own, error in zip(found, pool.map(errors, steps), strict=True):
                    own.append(error)

    def step(self, option: DesignOption) -> DesignStep:
        """The C of an option."""
        if option not in self._steps:
            self._steps[option] = self._made(option)
        return self._steps[option]

    def _made(self, option: DesignOption) -> DesignStep:
        own = seen_by(self._known(option.tests), CLASSES[option.sensor])
        asked = {**STEPS[option.step][0], "points": option.points}
        return DesignStep(self._libraries, own, self.dt_s, asked)

    @cached_property
    def _steps(self) -> dict[DesignOption, DesignStep]:
        return {}

    @cached_property
    def _libraries(self) -> dict[Options, HostLibrary]:
        return {}

    def without_each(self, option: DesignOption, cells: int) -> dict[str, float]:
        """The figure asked for over cells, with one of `CAUSES` made perfect in turn."""

        def left(cause: str) -> float:
            lives = (self.life(option, number, cause) for number in range(cells))
            step = self.step(option)
            found = [_errors_of(self.model, life, self.dt_s)(step) for life in lives]
            return soc_error(found)[self.ask.figure]

        return {cause: left(cause) for cause in CAUSES}

    def life(self, option: DesignOption, number: int, without: str = "") -> CertifiedLife:
        """The life of a number, as an option's sensor sees it; without one of `CAUSES`."""
        sensor = PERFECT if without == "sensor" else CLASSES[option.sensor]
        spread = self._spread(option.tests, option.updated)
        spread = replace(spread, **CAUSES.get(without, {}))
        known = self._known(option.tests)
        if without == "temperature":
            spread = replace(spread, temperature_C=self.model.usual_temperature_C)
        if without == "model_error":
            known = replace(known, posterior=None)
        own = sensor.of_cell(self.model.capacity_Ah)
        fleet = Fleet(0, 0, (), min(self.hours, MOST_HOURS), self.seed, own, spread)
        life = fleet.life(known, MODEL, 2 * number, self.dt_s)  # odd ones have faults
        if without == "start":
            known_start = float(np.clip(life.soc[0], 0.0, 1.0))
            life = replace(life, about={**life.about, "started_at": known_start})
        return life

    def _spread(self, tests: str, updated: bool) -> CellSpread:
        """How cells differ from the tables, at the temperature and the age that are asked for."""
        years = min(self.ask.years, UPDATED_YEARS) if updated else self.ask.years
        usual = CellSpread(age=years / LIFE_YEARS, temperature_C=self.ask.temperature_C)
        unknown = math.hypot(usual.capacity, UNKNOWN_CAPACITY * (tests == "none"))
        shape = SAME_CELL.ln_r if TESTS[tests] < TESTS["pulses"] else usual.resistance
        return replace(usual, capacity=unknown, resistance=shape)

    def _known(self, tests: str) -> CellModel:
        """The model after tests: what they show is left open no more."""
        hours, model = TESTS[tests], self.model
        shown = [
            name
            for name, test in (("capacity", "capacity"), ("resistance", "pulses"), ("ocv", "ocv"))
            if hours >= TESTS[test]
        ]
        if model.posterior is not None:
            kept = [not name.startswith(tuple(shown)) for name in model.posterior.directions]
            factor = model.posterior.factor * np.array(kept, dtype=np.float64)[:, None]
            model = replace(model, posterior=replace(model.posterior, factor=factor))
        least = ModelError.of_white_and_slow(CAR.voltage_noise_V, SAME_CELL.ocv_V)
        is_less = float(np.mean(model.error.at(model.soc))) > SAME_CELL.ocv_V
        return replace(model, error=least) if "ocv" in shown and is_less else model

    def costs(self, option: DesignOption) -> dict[str, float]:
        """What an option takes; a class of sensor by its rank, the better the higher."""
        _, code, instructions = STEPS[option.step]
        tables = self.step(option).stepper(self.dt_s).tables
        size_Ah = self.model.capacity_Ah
        rank = sorted(CLASSES, key=lambda name: -CLASSES[name].offset_A(size_Ah))
        return {
            "bytes": code + tables.flash_bytes,
            "instructions": instructions,
            "hours": TESTS[option.tests],
            "sensor_class": rank.index(option.sensor),
            "updates": int(option.updated),
        }


class DesignStep(Firmware):
    """The exported C on tables of its own: compiled once for all with the same options."""

    def __init__(
        self,
        libraries: dict[Options, HostLibrary],
        own: SensorReadings,
        dt_s: float,
        asked: Mapping[str, Any],
    ) -> None:
        self._libraries = libraries
        super().__init__(own.model, own.noise, dt_s=dt_s, **asked)

    def soc_of(self, records: NDArray[Any], soc: float) -> FloatArray:
        """SOC after each sample, as `run` says it, of samples that many steps share."""
        stepper = self.stepper(self.known_dt_s)
        memory = stepper.start_filter(self._asked.components, soc, START_STD)
        return np.asarray(stepper.filter_rows(memory, records)["soc"], dtype=np.float64)

    def _make(self, tables: FixedStepTables) -> Stepper:
        if tables.options not in self._libraries:
            self._libraries[tables.options] = HostLibrary(tables)
        return self._libraries[tables.options].on(tables)


def _errors_of(
    model: CellModel, life: CertifiedLife, dt_s: float
) -> Callable[[DesignStep], LifeError]:
    """The error of each step that is handed over, in a life after its first hour."""
    samples, start = samples_of(model, life.seen, dt_s), life.about["started_at"]
    scored = life.log.time_s - life.log.time_s[0] >= SETTLED_S
    truth, row_sample = life.soc[scored], samples.row_sample[scored]

    def errors(step: DesignStep) -> LifeError:
        return life_error(np.abs(step.soc_of(samples.records, start)[row_sample] - truth))

    return errors
