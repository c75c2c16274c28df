"""Derivatives by a coordinate: of the packed table, of the cell's scalars, of the current."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellwise.cell.point_kernels import ENTROPY, OCV, R0, R3, CellScalars, M
from cellwise.diagnose.causes.coordinates import (
    LOSS_NAMES,
    OCV_NAMES,
    R_NAMES,
    RESISTANCES,
    UNSEEN_NAMES,
    UNSEEN_OCV_NAMES,
    UNSEEN_R_NAMES,
    Coordinates,
    KernelInputs,
)
from cellwise.diagnose.causes.sensitivity_kernels import Directions
from cellwise.typing import FloatArray, IntArray

_TAU_ACTIVATIONS = ("tau1_activation_K", "tau2_activation_K", "tau3_activation_K")
_SCALAR = {
    "ln_capacity": "charge_As",
    "activation_K": "activation_K",
    "r0_K": "r0_activation_K",
    "ln_gamma": "hysteresis_rate",
    "rate_h": "rate_per_A",
    "asinh_per_V": "asinh_per_V",
    "ln_charge_scale": "charge_scale",
    "leak_A": "leak_A",
    "rth_K_per_W": "heating_K_per_W",
    "ln_thermal_s": "heating_s",
}


def table_direction(at: Coordinates, name: str, inputs: KernelInputs) -> FloatArray | None:
    """Derivative of the packed table with respect to one coordinate, or None."""
    t = inputs.table
    d = np.zeros_like(t)
    if name in LOSS_NAMES:
        d[..., OCV] = at.by_loss(name, inputs.point)[0]
    elif name == "added_r0":
        before = at.table[..., R0] + inputs.point.get(name, 0.0) * at.r_typical_ohm
        d[..., R0] = at.r_typical_ohm * t[..., R0] / before
    elif name == "docv_dT":
        d[..., ENTROPY] = 1.0
    elif name in UNSEEN_NAMES and at.unseen_C is None:
        pass  # every temperature is one that the model was measured at
    elif name in UNSEEN_R_NAMES:
        by_K = at.unseen_per_K * at.r_hats[UNSEEN_R_NAMES.index(name)]
        for c in RESISTANCES:
            d[at.row, :, c] = t[at.row, :, c] * by_K
    elif name in UNSEEN_OCV_NAMES and at.unseen_C is not None:
        away = at.unseen_C - at.unseen_from_C
        d[at.row, :, OCV] = away * at.r_hats[UNSEEN_OCV_NAMES.index(name)]
    elif name in OCV_NAMES:
        d[..., OCV] = at.hats[OCV_NAMES.index(name)]
    elif name in at.factors:
        over_soc = at.r_hats[R_NAMES.index(name)] if name in R_NAMES else 1.0
        for column in at.factors[name]:
            d[..., column] = t[..., column] * over_soc
    elif name == "r3":
        d[..., R3] = at.r_typical_ohm
    elif name == "m_V":
        d[..., M] = 1.0
    else:
        return None
    return d


def scalar_direction(at: Coordinates, name: str, inputs: KernelInputs) -> FloatArray:
    """Derivatives of the scalars with respect to one coordinate."""
    d = np.zeros(len(CellScalars._fields))
    scalar = _SCALAR.get(name)
    if name in LOSS_NAMES:
        by_share = at.by_loss(name, inputs.point)[1]
        d[CellScalars._fields.index("charge_As")] = inputs.scalars.charge_As * by_share
    for branch in _TAU_ACTIVATIONS if name == "tau_K" else ():
        d[CellScalars._fields.index(branch)] = 1.0
    if scalar is not None:
        unit = getattr(inputs.scalars, scalar) if name.startswith("ln_") else 1.0
        if name == "rate_h":
            unit = 1.0 / at.model.capacity_Ah
        d[CellScalars._fields.index(scalar)] = unit
    return d


def directions(
    at: Coordinates, names: Sequence[str], inputs: KernelInputs, currents: Mapping[str, FloatArray]
) -> Directions:
    """What :func:`derivative_rows` takes for the named coordinates."""
    tables: list[FloatArray] = []
    flows: list[FloatArray] = []
    table_of: list[int] = []
    flow_of: list[int] = []
    for name in names:
        table = table_direction(at, name, inputs)
        table_of.append(len(tables) if table is not None else -1)
        if table is not None:
            tables.append(table)
        flow_of.append(len(flows) if name in currents else -1)
        if name in currents:
            flows.append(currents[name])
    none = np.zeros((1, *inputs.table.shape))
    return Directions(
        np.array([scalar_direction(at, n, inputs) for n in names]),
        np.array([float(n == "soc0") for n in names]),
        np.array([float(n == "offset_V") for n in names]),
        np.array(tables) if tables else none,
        _ints(table_of),
        np.array(flows) if flows else np.zeros((1, 1)),
        _ints(flow_of),
    )


def _ints(values: Sequence[int]) -> IntArray:
    return np.array(values, dtype=np.int32)
