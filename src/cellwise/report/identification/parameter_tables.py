"""Parameters over SOC: the model's tables, their standard errors, the single pulses' values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import SlowDiffusion, effect_table
from cellwise.cell.model import CellModel
from cellwise.identify.identification import Identification, TemperatureResult
from cellwise.identify.refinement.splines import greville
from cellwise.typing import BoolArray, FloatArray

NAMES = {
    "r0_ohm": "R₀",
    "r1_ohm": "R₁",
    "r2_ohm": "R₂",
    "r3_ohm": "R₃",
    "tau1_s": "τ₁",
    "tau2_s": "τ₂",
    "tau3_s": "τ₃",
    "c1_F": "C₁",
    "c2_F": "C₂",
    "c3_F": "C₃",
    "dc_ohm": "R₀ + R₁ + R₂",
}


class PulseValues(NamedTuple):
    """Values of one parameter from single pulses: arrays of shape (pulses,)."""

    soc: FloatArray
    value: FloatArray
    error: FloatArray
    discharge: BoolArray
    known: BoolArray


def model_table(model: CellModel, name: str, row: int) -> FloatArray | None:
    """One of ``NAMES`` over the model's SOC grid at one of its temperatures; None if absent."""
    slow = model.effect(SlowDiffusion)
    r3 = effect_table(slow.r3_ohm, model.ocv_V.shape)[row]
    has_slow = bool(np.any(r3 > 0.0))
    if name in ("r3_ohm", "tau3_s", "c3_F") and not has_slow:
        return None
    tau3 = effect_table(slow.tau3_s, model.ocv_V.shape)[row]
    if name == "r3_ohm":
        return np.asarray(r3)
    if name == "tau3_s":
        return np.asarray(tau3)
    if name == "c3_F":
        return np.asarray(tau3 / np.maximum(r3, 1e-12))
    if name == "dc_ohm":
        return np.asarray(model.r0_ohm[row] + model.r1_ohm[row] + model.r2_ohm[row])
    return np.asarray(getattr(model, name)[row])


def table_error(found: TemperatureResult, name: str, soc: FloatArray) -> FloatArray | None:
    """Standard error of a refined table as a share of its value, over SOC; None if unknown.

    The tables are splines of ln R and ln tau, whose coefficients act at the Greville points; the
    errors are joined by lines between these. That of C = tau / R leaves out their correlation.
    """
    result = found.refinement
    if result is None:
        return None
    lay, at = result.layout, greville(result.knots)

    def block(first: int) -> FloatArray:
        return np.asarray(np.interp(soc, at, result.theta_std[first : first + lay.knots]))

    if name == "r0_ohm":
        return block(lay.r0)
    if name == "dc_ohm":
        return None
    branch = int(next(c for c in name if c.isdigit())) - 1
    if branch >= lay.branches:
        return None
    if name.startswith("r"):
        return block(lay.r(branch))
    if name.startswith("tau"):
        return block(lay.tau(branch))
    return np.hypot(block(lay.r(branch)), block(lay.tau(branch)))


def pulse_values(found: TemperatureResult, name: str) -> PulseValues | None:
    """Values of one parameter from the single pulses of a temperature; None if they have none."""
    fits = [f for s in found.pulse_sets for f in s.fits if np.isfinite(f.soc)]
    if not fits or name in ("r3_ohm", "tau3_s", "c3_F"):
        return None
    soc = np.array([f.soc for f in fits])
    discharge = np.array([f.current_A > 0.0 for f in fits], dtype=bool)
    if name == "dc_ohm":
        value = np.array([f.r0_ohm + f.r1_ohm + f.r2_ohm for f in fits])
        error = np.full(value.size, np.nan)
        known = np.array([f.identified.r2_ohm > 0 or f.method == "segments" for f in fits])
        return PulseValues(soc, value, error, discharge, known)
    parts = [f"r{name[1]}_ohm", f"tau{name[1]}_s"] if name.startswith("c") else [name]
    value = np.array([getattr(f, name) for f in fits])
    shares = np.array(
        [[getattr(f.error, p) / max(getattr(f.value, p), 1e-12) for p in parts] for f in fits]
    )
    error = value * np.sqrt(np.sum(shares**2, axis=1))
    # A method without standard errors claims nothing: its values are shown as they are.
    known = np.array(
        [
            f.method == "segments" or all(getattr(f.identified, p) > 0.0 for p in parts)
            for f in fits
        ],
        dtype=bool,
    )
    return PulseValues(soc, value, error, discharge, known & np.isfinite(value) & (value > 0.0))


def shown_names(identification: Identification) -> tuple[tuple[str, ...], ...]:
    """Rows of panels: the resistances and the branches that the model has."""
    rows: list[tuple[str, ...]] = [("r0_ohm", "dc_ohm", "")]
    rows += [(f"r{j}_ohm", f"tau{j}_s", f"c{j}_F") for j in (1, 2)]
    if model_table(identification.model, "r3_ohm", 0) is not None:
        rows.append(("r3_ohm", "tau3_s", "c3_F"))
    return tuple(rows)
