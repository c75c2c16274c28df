"""Cells and logs for the tests: linear, curved, with every effect, drawn at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.cell.effects import Hysteresis, SlowDiffusion, TemperatureDependence, TimeSkew
from cellwise.cell.model import CellModel
from cellwise.logs.cell_log import CellLog


def linear_cell(points: int = 11, **changes) -> CellModel:
    """OCV linear in SOC, every other table constant: a linear system."""
    soc = np.linspace(0.0, 1.0, points)
    values = {
        "capacity_Ah": 3.0,
        "ocv_V": 3.2 + 0.9 * soc,
        "r0_ohm": np.full(points, 0.030),
        "r1_ohm": np.full(points, 0.012),
        "tau1_s": np.full(points, 7.0),
        "r2_ohm": np.full(points, 0.020),
        "tau2_s": np.full(points, 90.0),
    }
    return CellModel(**{**values, **changes})


def curved_cell(points: int = 101, **changes) -> CellModel:
    """An NMC-like cell: steep at the ends, every table depends on SOC."""
    s = np.linspace(0.0, 1.0, points)
    values = {
        "capacity_Ah": 3.0,
        "ocv_V": 3.3 + 0.55 * s + 0.35 * s**3 - 0.5 * np.exp(-20.0 * s),
        "r0_ohm": 0.028 + 0.02 * (1.0 - s) ** 4,
        "r1_ohm": 0.010 + 0.02 * (1.0 - s) ** 3,
        "tau1_s": 4.0 + 4.0 * s,
        "r2_ohm": 0.018 + 0.03 * (1.0 - s) ** 5,
        "tau2_s": 70.0 + 50.0 * s,
    }
    return CellModel(**{**values, **changes})


def lfp_cell(points: int = 201) -> CellModel:
    """A flat OCV."""
    s = np.linspace(0.0, 1.0, points)
    ocv = 3.25 + 0.05 * s + 0.02 * np.tanh(14.0 * (s - 0.62))
    ocv += 0.09 * np.exp(-60.0 * (1.0 - s)) - 0.45 * np.exp(-28.0 * s)
    return curved_cell(points, ocv_V=ocv, capacity_Ah=2.3)


EFFECTS = (
    SlowDiffusion(r3_ohm=0.015, tau3_s=1500.0),
    Hysteresis(m_V=0.02, gamma=40.0),
    TemperatureDependence(activation_K=2500.0, reference_C=25.0),
    TimeSkew(skew_s=0.4),
)


def within_its_error(model: CellModel, rng: np.random.Generator) -> CellModel:
    """A cell as far from its model as the model states: OCV and resistances are off."""
    share = 1.0 + model.error.shown_share() * rng.normal()
    return replace(
        model,
        r0_ohm=model.r0_ohm * share,
        r1_ohm=model.r1_ohm * share,
        r2_ohm=model.r2_ohm * share,
        ocv_V=model.ocv_V + float(model.error.at(0.0)) * rng.normal(),
    )


def random_model(
    rng: np.random.Generator, *, points: int = 21, temperatures: int = 3, effects: bool = True
) -> CellModel:
    """A valid model whose every table entry is drawn at random."""
    shape = (temperatures, points)
    tau1 = rng.uniform(1.0, 10.0, shape)
    kinds = (
        SlowDiffusion(rng.uniform(0.001, 0.03, shape), rng.uniform(400.0, 4000.0, shape)),
        Hysteresis(rng.uniform(-0.01, 0.03, shape), float(rng.uniform(1.0, 200.0))),
        TemperatureDependence(float(rng.uniform(500.0, 5000.0)), 25.0),
        TimeSkew(float(rng.uniform(0.0, 2.0))),
    )
    return CellModel(
        capacity_Ah=float(rng.uniform(1.0, 50.0)),
        ocv_V=3.0 + np.cumsum(rng.uniform(0.0, 0.08, shape), axis=1),
        r0_ohm=rng.uniform(0.001, 0.05, shape),
        r1_ohm=rng.uniform(0.001, 0.05, shape),
        tau1_s=tau1,
        r2_ohm=rng.uniform(0.001, 0.05, shape),
        tau2_s=tau1 * rng.uniform(3.0, 50.0, shape),
        temperature_C=np.sort(rng.uniform(-20.0, 50.0, temperatures)),
        charge_efficiency=float(rng.uniform(0.95, 1.0)),
        effects=kinds if effects else (),
    )


def random_log(
    rng: np.random.Generator,
    rows: int = 500,
    *,
    scale_A: float = 3.0,
    dt_s: float = 1.0,
    jitter: float = 0.0,
    rest_first: bool = True,
    temperature_C: tuple[float, float] | None = None,
) -> CellLog:
    """Random current held for a random while; the voltage is a placeholder."""
    held = np.repeat(rng.normal(0.3, 1.0, rows), rng.integers(1, 20, rows))[:rows] * scale_A
    if rest_first:
        held[0] = 0.0
    step = dt_s * (1.0 + jitter * rng.uniform(-0.5, 0.5, rows))
    time = np.concatenate(([0.0], np.cumsum(step[1:])))
    temperature = None if temperature_C is None else rng.uniform(*temperature_C, rows)
    return CellLog(time, held, np.full(rows, 3.7), temperature_C=temperature)
