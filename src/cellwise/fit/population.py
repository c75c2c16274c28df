"""The prior over cells: what a cell of a class may be like, by cells that were measured.

A class has the curves of its members. Their mean and what they differ by, in a few modes and a
rest, are the prior of a cell of which nothing is known but its class. The stock models are members,
and curves from physics (see `datasets/population.py`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import Hysteresis, SlowDiffusion, TemperatureDependence
from cellwise.cell.model import CellModel
from cellwise.cell.stock import stock_model, stock_names
from cellwise.errors import InputError
from cellwise.files import embedded_folder
from cellwise.fit.problem import EVIDENCE
from cellwise.fit.rows import BaseOcv, FitLog, inverse_K
from cellwise.fit.solver import Prior
from cellwise.fit.splines import OCV_KNOTS, TABLE_KNOTS, greville
from cellwise.fit.splines import SOC_GRID as SOC
from cellwise.fit.unknowns import (
    ACTIVATION_UNIT_K,
    ASINH_UNIT_PER_V,
    BENDS,
    FitSettings,
    Layout,
)
from cellwise.typing import FloatArray

HOME_C = 25.0  # of the members' curves
TABLES = ("r0", "r1", "tau1", "r2", "tau2", "r3", "tau3")


class PopulationSpread(NamedTuple):
    """How cells differ beyond what a few members show.

    Parameters
    ----------
    along, across_V : float       of an OCV: by so much SOC, and by so many volts
    full_share, full_soc : float  share of ``along`` that is left at full, all of it so far below
    rest : float                  share of that which is of short range, over ``rest_soc``
    soc : float                   over how much SOC OCVs differ alike
    least_ln, shape_ln : float    of a table of logarithms: its level, its shape
    empty_ln : float              more of its shape near empty, over ``EVIDENCE.near_soc``
    table_soc : float             over how much SOC a table's shape is alike
    activation_K, activation_std_K : float      of the resistances
    temperature_ln : float        of a table from one temperature to the next, beside activation
    gap : float                   share of a hysteresis
    bend_soc : float              of a low-rate test in its middle, which another age shifts beside
                                  the loads, as does a current that never rests
    """

    along: float = 0.025
    across_V: float = 0.015
    full_share: float = 0.25
    full_soc: float = 0.1
    rest: float = 0.3
    rest_soc: float = 0.05
    soc: float = 0.3
    least_ln: float = 1.2
    shape_ln: float = 1.0
    empty_ln: float = 0.9
    table_soc: float = 0.2
    activation_K: float = 3000.0
    activation_std_K: float = 2000.0
    temperature_ln: float = 1.0
    gap: float = 0.8
    bend_soc: float = 0.02


class SameCell(NamedTuple):
    """How far a cell may be from a model of its kind, at least.

    OCV over how much SOC alike; a table of logarithms; the activation of its resistances.
    """

    ocv_V: float = 0.003
    soc: float = 1.0
    ln_r: float = 0.1
    activation_K: float = 1000.0


SPREAD, SAME_CELL = PopulationSpread(), SameCell()
MODEL_STEP_K = 10.0  # between rows of a model that is a prior
NUGGET_LN, NUGGET_V = 0.01, 1e-4  # of a knot by itself: keeps covariances apart from singular


@dataclass(frozen=True, eq=False)
class CellClass:
    """The members of one class.

    Parameters
    ----------
    name : str
    ocv_V : (members, 201) float           over SOC
    ln_tables : mapping                    (members, 201) each: ln of R times capacity [V], of tau
    hysteresis_V : (201,) float            mean
    without : names                        lineages that are left out
    """

    name: str
    ocv_V: FloatArray
    ln_tables: Mapping[str, FloatArray]
    hysteresis_V: FloatArray
    without: frozenset[str] = frozenset()

    def said(self) -> str:
        """For people: which prior this is."""
        left = f" without {', '.join(sorted(self.without))}" if self.without else ""
        return f"population of {self.name} cells{left}"

    def base(self) -> BaseOcv:
        """Mean OCV, rising."""
        return BaseOcv(np.maximum.accumulate(self.ocv_V.mean(axis=0)))

    def ocv_covariance(self, soc: FloatArray) -> FloatArray:
        """Of the OCV at some SOC, shape (n, n) [V^2]: what the members show, and the rest."""
        n = len(self.ocv_V)
        mean = self.ocv_V.mean(axis=0)
        slope = np.interp(soc, SOC, np.gradient(mean, SOC))
        # Full is where the charger's voltage is reached: there curves are alike along the SOC.
        near_full = np.minimum(1.0, SPREAD.full_share + (1.0 - soc) / SPREAD.full_soc)
        size = np.hypot(SPREAD.along * near_full * slope, SPREAD.across_V)
        apart = np.abs(np.subtract.outer(soc, soc))
        alike = (1.0 - SPREAD.rest) * np.exp(-0.5 * (apart / SPREAD.soc) ** 2)
        alike += SPREAD.rest * np.exp(-apart / SPREAD.rest_soc)
        found = np.outer(size, size) * alike
        if n > 3:
            deviations = np.array([np.interp(soc, SOC, row) for row in self.ocv_V - mean])
            found += deviations.T @ deviations / (n - 1) * (1.0 + 1.0 / n)
        return np.asarray(found)

    def table(
        self, name: str, soc: FloatArray, grid_C: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Mean (temperatures x n) and covariance of a table's logarithm, R times capacity.

        Members differ in level and shape; a temperature by the activation, and by itself.
        """
        rows = np.array([np.interp(soc, SOC, row) for row in self.ln_tables[name]])
        row = rows.mean(axis=0)
        n = len(rows)
        level = (rows - row).mean(axis=1)
        level_std = max(float(np.std(level, ddof=1)) * (1.0 + 1.0 / n), SPREAD.least_ln)
        size = SPREAD.shape_ln + SPREAD.empty_ln * np.exp(-soc / EVIDENCE.near_soc)
        apart = np.abs(np.subtract.outer(soc, soc))
        alike = 0.9 * np.exp(-0.5 * (apart / SPREAD.table_soc) ** 2) + 0.1 * np.exp(-apart / 0.1)
        shape = level_std**2 + np.outer(size, size) * alike
        x = inverse_K(grid_C, HOME_C)
        resists = name.startswith("r")
        warm_K, std_K = self.activation_K if resists else (0.0, SPREAD.activation_std_K / 2.0)
        covariance = np.kron(np.ones((x.size, x.size)), shape)
        covariance += np.kron(std_K**2 * np.outer(x, x), np.ones((soc.size, soc.size)))
        if x.size > 1:
            steps = np.abs(np.subtract.outer(x, x)) / abs(float(inverse_K(25.0, 10.0)))
            near = np.exp(-0.5 * (apart / 0.3) ** 2)
            covariance += np.kron(SPREAD.temperature_ln**2 * np.exp(-0.5 * steps), near)
        return np.asarray(warm_K * x[:, None] + row).ravel(), np.asarray(covariance)

    def gap(self, soc: FloatArray, temperatures: int) -> tuple[FloatArray, FloatArray]:
        """Mean (temperatures x n) and covariance of the hysteresis [V]."""
        level = np.interp(soc, SOC, self.hysteresis_V)
        near = np.exp(-0.5 * (np.subtract.outer(soc, soc) / 0.15) ** 2)
        along = (SPREAD.gap * np.outer(level, level) * SPREAD.gap) * (0.5 + 0.5 * near)
        both = 0.7 + 0.3 * np.eye(temperatures)
        return np.tile(level, temperatures), np.asarray(np.kron(both, along), dtype=np.float64)

    @property
    def activation_K(self) -> tuple[float, float]:
        """Of the resistances, and its deviation."""
        return SPREAD.activation_K, SPREAD.activation_std_K


@dataclass(frozen=True, eq=False)
class ModelPrior:
    """One model as the prior: of this cell before, or of a cell of its kind.

    Its ``error`` says how far another cell may be from it, times ``error_scale``.
    """

    model: CellModel
    error_scale: float = 1.0

    @property
    def name(self) -> str:
        """The class of its chemistry."""
        return class_of(self.model.chemistry)

    @property
    def grid_C(self) -> FloatArray:
        """Temperatures with tables of their own, thinned.

        Not those beyond its data, where it is as a prior over cells had it.
        """
        rows = self.model.temperature_C
        low, high = self.model.validity.temperature_C or (rows[0], rows[-1])
        shown = (rows >= low - 0.5 * MODEL_STEP_K) & (rows <= high + 0.5 * MODEL_STEP_K)
        kept: list[float] = []
        for warm in rows[shown] if shown.any() else rows:
            if not kept or warm - kept[-1] >= MODEL_STEP_K:
                kept.append(float(warm))
        return np.array(kept)

    def said(self) -> str:
        """For people: which prior this is."""
        return f"model {self.model.name or 'given'}"

    def base(self) -> BaseOcv:
        """Its OCV."""
        return BaseOcv(np.interp(SOC, self.model.soc, self.model.ocv_at(HOME_C)))

    def ocv_covariance(self, soc: FloatArray) -> FloatArray:
        """Of the OCV at some SOC, shape (n, n) [V^2]."""
        size = np.maximum(self.error_scale * self.model.error.at(soc), SAME_CELL.ocv_V)
        apart = np.abs(np.subtract.outer(soc, soc))
        return np.asarray(np.outer(size, size) * np.exp(-apart / SAME_CELL.soc))

    def table(
        self, name: str, soc: FloatArray, grid_C: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Mean (temperatures x n) and covariance of a table's logarithm, R times capacity."""
        rows = [np.interp(soc, SOC, _ln_table(self.model, name, float(warm))) for warm in grid_C]
        share = max(self.error_scale * self.model.error.shown_share(), SAME_CELL.ln_r)
        apart = np.abs(np.subtract.outer(soc, soc))
        shape = share**2 * (0.5 + 0.5 * np.exp(-0.5 * (apart / SPREAD.soc) ** 2))
        x = inverse_K(grid_C, HOME_C)
        covariance = np.kron(np.ones((x.size, x.size)), shape)
        covariance += np.kron(SAME_CELL.activation_K**2 * np.outer(x, x), np.ones(apart.shape))
        return np.array(rows).ravel(), np.asarray(covariance, dtype=np.float64)

    def gap(self, soc: FloatArray, temperatures: int) -> tuple[FloatArray, FloatArray]:
        """Mean (temperatures x n) and covariance of the hysteresis [V]."""
        effect = self.model.effect(Hysteresis)
        known = np.broadcast_to(np.asarray(effect.m_V), self.model.ocv_V.shape)[0]
        level = np.interp(soc, self.model.soc, known)
        size = SPREAD.gap * level + 1e-3
        alike = np.kron(np.ones((temperatures, temperatures)), np.outer(size, size))
        return np.tile(level, temperatures), np.asarray(alike, dtype=np.float64)

    @property
    def activation_K(self) -> tuple[float, float]:
        """Of the resistances, and its deviation."""
        effect = self.model.effect(TemperatureDependence)
        return float(effect.activation_K), SAME_CELL.activation_K


CellPrior = CellClass | ModelPrior


@cache
def cell_classes(without: frozenset[str] = frozenset()) -> tuple[CellClass, ...]:
    """The classes, without the members of some lineages.

    Raises
    ------
    InputError        a lineage of no stock model
    """
    unknown = sorted(without - set(stock_names()))
    if unknown:
        raise InputError(
            f"a lineage '{unknown[0]}'",
            f"one of {', '.join(stock_names())}",
            "See `cellwise data list`.",
        )
    models = [stock_model(name) for name in stock_names() if name not in without]
    ln_tables = {name: np.array([_ln_table(m, name) for m in models]) for name in TABLES}
    path = embedded_folder() / "population" / "ocv.json"
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    found = []
    for name in ("layered", "lfp"):
        own = [m for m in models if (class_of(m.chemistry) == name)]
        curves = [np.interp(SOC, m.soc, m.ocv_at(HOME_C)) for m in own]
        for cell in cells:
            if cell["class"] == name and not set(cell["lineage"]) & without:
                known = np.linspace(0.0, 1.0, len(cell["ocv_V"]))
                curves.append(np.interp(SOC, known, cell["ocv_V"]))
        gap = np.full(SOC.size, 0.012 if name == "lfp" else 0.004)
        found.append(CellClass(name, np.array(curves), ln_tables, gap, without))
    return tuple(found)


def class_of(chemistry: str) -> str:
    """The class of a chemistry as people write it; empty for one that is not known."""
    text = chemistry.upper()
    if "LFP" in text or "FEPO" in text:
        return "lfp"
    layered = ("NMC", "NCA", "LCO", "LMO", "NCM", "COO2", "LAYERED")
    return "layered" if any(x in text for x in layered) else ""


def _ln_table(model: CellModel, name: str, warm_C: float = HOME_C) -> FloatArray:
    """A table of a model at one temperature, as the prior has it; without a third branch, small."""
    at = model.at_temperature(warm_C)
    slow = at.effect(SlowDiffusion)
    if name in ("r3", "tau3"):
        values = np.asarray(slow.r3_ohm if name == "r3" else slow.tau3_s)
        row = np.broadcast_to(values, at.ocv_V.shape)[0]
    else:
        row = getattr(at, f"{name}_ohm" if name.startswith("r") else f"{name}_s")[0]
    scale = at.capacity_Ah if name.startswith("r") else 1.0
    return np.asarray(np.interp(SOC, at.soc, np.log(np.maximum(row * scale, 1e-4))))


def prior_of(
    cells: CellPrior,
    layout: Layout,
    logs: tuple[FitLog, ...],
    capacity_Ah: float,
    grid_C: FloatArray,
    reference_C: float,
    settings: FitSettings,
) -> Prior:
    """The prior of all unknowns of a fit."""
    mean, std = np.zeros(layout.size), np.zeros(layout.size)
    precision = np.zeros((layout.size, layout.size))
    free = np.zeros(layout.size, dtype=np.bool_)

    def block(at: int, covariance: FloatArray) -> None:
        part = slice(at, at + len(covariance))
        precision[part, part] = np.linalg.inv(covariance)
        free[part] = True

    block(0, cells.ocv_covariance(greville(OCV_KNOTS)))
    at_soc = greville(TABLE_KNOTS)
    several = grid_C.size > 1
    for name, at in zip(TABLES, layout.tables(), strict=False):
        row, covariance = cells.table(name, at_soc, grid_C)
        mean[at : at + layout.block] = row - (np.log(capacity_Ah) if name.startswith("r") else 0.0)
        block(at, covariance + NUGGET_LN**2 * np.eye(layout.block))
    if layout.hysteresis:
        level, covariance = cells.gap(at_soc, layout.temperatures)
        mean[layout.m : layout.gamma] = level
        block(layout.m, covariance + NUGGET_V**2 * np.eye(layout.block))
        mean[layout.gamma], std[layout.gamma] = np.log(50.0), 1.0
    if not several:
        activation = np.array(cells.activation_K) / ACTIVATION_UNIT_K
        mean[layout.activation], std[layout.activation] = activation
        std[layout.own_activation : layout.capacity] = (
            settings.own_activation_std_K / ACTIVATION_UNIT_K
        )
    std[layout.skew] = 1.0 if settings.skew else 0.0
    if settings.charge_transfer:
        mean[layout.asinh], std[layout.asinh] = settings.asinh_per_V / ASINH_UNIT_PER_V, 1.0
    std[layout.capacity] = settings.ln_capacity_std
    for k, item in enumerate(logs):
        mean[layout.sample + k], std[layout.sample + k] = item.ln_sample, item.sample_std
        std[layout.start + k] = item.soc0_std
        first = layout.past + k * layout.branches
        std[first] = 0.2 * item.past_V
        std[first + 1 : first + layout.branches] = item.past_V
        if item.low_rate:
            at = layout.bend + k * BENDS
            std[at : at + BENDS] = SPREAD.bend_soc / np.arange(1, BENDS + 1)
    known = np.flatnonzero(std)
    precision[known, known], free[known] = 1.0 / std[known] ** 2, True
    if settings.ln_resistance_std > 0.0:
        held = precision @ layout.resistances()
        stiffness = settings.ln_resistance_std**-2 + layout.resistances() @ held
        precision -= np.outer(held, held) / stiffness  # Sherman and Morrison
    return Prior(mean, precision, free)
