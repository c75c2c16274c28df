"""A model of one size of cell as that of another: the same electrodes, more or less of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwise.cell.effects import Effect, SelfDischarge, SelfHeating, SlowDiffusion
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import Validity
from cellwise.errors import InputError


def scaled_model(model: CellModel, capacity_Ah: float) -> CellModel:
    """The model at another capacity.

    Cells in parallel are one larger cell: every resistance and the thermal resistance become
    smaller by the ratio of the capacities, a self-discharge current larger; OCV, time constants and
    everything in volts stay.

    Parameters
    ----------
    model : CellModel
    capacity_Ah : float       of the cell that it shall describe [Ah]

    Raises
    ------
    InputError        a capacity that is not above zero
    """
    if not (np.isfinite(capacity_Ah) and capacity_Ah > 0.0):
        raise InputError(
            f"a capacity of {capacity_Ah:g} Ah", "a number above zero", "Give it in Ah."
        )
    share = model.capacity_Ah / capacity_Ah
    return replace(
        model,
        capacity_Ah=float(capacity_Ah),
        r0_ohm=share * model.r0_ohm,
        r1_ohm=share * model.r1_ohm,
        r2_ohm=share * model.r2_ohm,
        effects=tuple(_scaled(effect, share) for effect in model.effects),
        validity=_scaled_validity(model.validity, share),
        provenance={**model.provenance, "scaled_from_Ah": float(model.capacity_Ah)},
    )


def _scaled_validity(validity: Validity, share: float) -> Validity:
    if validity.current_A is None:
        return validity
    low, high = validity.current_A
    return replace(validity, current_A=(low / share, high / share))


def _scaled(effect: Effect, share: float) -> Effect:
    if isinstance(effect, SlowDiffusion):
        return replace(effect, r3_ohm=share * np.asarray(effect.r3_ohm))
    if isinstance(effect, SelfHeating):
        return replace(effect, rth_K_per_W=share * effect.rth_K_per_W)
    if isinstance(effect, SelfDischarge):
        return replace(effect, leak_A=effect.leak_A / share)
    return effect
