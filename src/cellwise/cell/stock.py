"""The stock models that are part of cellwise, and a model by its name or by its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.arguments import file_path, number
from cellwise.cell.effects import Effect, SelfDischarge, SelfHeating
from cellwise.cell.model import CellModel
from cellwise.cell.model_file import read_model
from cellwise.errors import InputError
from cellwise.files import embedded_folder

FOLDER = "stock"
SUFFIX = ".json"


def stock_folder() -> Path:
    """Folder of the stock models.

    Raises
    ------
    InputError        no embedded data beside this installation
    """
    return embedded_folder() / FOLDER


def stock_names() -> tuple[str, ...]:
    """Names of the stock models, in alphabetical order."""
    return tuple(sorted(path.stem for path in stock_folder().glob(f"*{SUFFIX}")))


def stock_model(name: str) -> CellModel:
    """A stock model as it was measured.

    Its ``error`` says how far another cell of the kind may be from it, not how well it fits its own
    data; ``provenance["stock"]`` holds source, validity and spread.

    Raises
    ------
    InputError        no stock model of that name; the message lists those there are
    """
    names = stock_names()
    if name not in names:
        raise InputError(
            f"stock model '{name}'", f"one of {', '.join(names)}", "See `cellwise data list`."
        )
    return read_model(stock_folder() / f"{name}{SUFFIX}")


def named_model(text: str | Path, capacity_Ah: float | None = None) -> CellModel:
    """The model that a user names: a file, else a stock model of that name.

    Parameters
    ----------
    text : str or Path            a file has precedence over a stock model of the same name
    capacity_Ah : float or None   scale the model to this capacity, see :func:`scaled_model`

    Raises
    ------
    InputError        neither a file nor the name of a stock model; a file that `read_model`
                      refuses; a capacity that is not above zero
    """
    path = file_path("model", text)
    stock = str(text) in stock_names()
    if path.is_file() or (path.exists() and not stock):
        model = read_model(path)
    elif stock:
        model = stock_model(str(text))
    else:
        raise InputError(
            f"no model file and no stock model '{text}'",
            f"a file written by `cellwise identify`, or one of {', '.join(stock_names())}",
            "Check the path or the name.",
        )
    if capacity_Ah is None:
        return model
    return scaled_model(model, number("capacity_Ah", capacity_Ah, "a capacity above zero [Ah]"))


def list_stock() -> list[dict[str, Any]]:
    """What `cellwise data list` shows: name, cell, capacity, source, licence, validity, spread."""
    return [
        {
            "name": name,
            "cell": model.name,
            "chemistry": model.chemistry,
            "capacity_Ah": model.capacity_Ah,
            "window_V": [model.voltage_min_V, model.voltage_max_V],
            **model.provenance.get("stock", {}),
        }
        for name, model in ((name, stock_model(name)) for name in stock_names())
    ]


def scaled_model(model: CellModel, capacity_Ah: float) -> CellModel:
    """The model at another capacity.

    Cells in parallel are one larger cell: every resistance and the thermal resistance become
    smaller by the ratio of the capacities, a self-discharge current larger; OCV, time constants and
    everything in volts stay. What a fit left open of the capacity is of the other one.

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
    share, validity = model.capacity_Ah / capacity_Ah, model.validity
    if validity.current_A is not None:
        low, high = validity.current_A
        validity = replace(validity, current_A=(low / share, high / share))
    wider = model.with_resistances(share)
    fitted = model.posterior  # its capacity was another one
    return replace(
        wider,
        capacity_Ah=float(capacity_Ah),
        effects=tuple(_scaled(e, share) for e in wider.effects),
        validity=validity,
        posterior=None if fitted is None else fitted.with_capacity_std(0.0),
        provenance={**model.provenance, "scaled_from_Ah": float(model.capacity_Ah)},
    )


def _scaled(effect: Effect, share: float) -> Effect:
    if isinstance(effect, SelfHeating):
        return replace(effect, rth_K_per_W=share * effect.rth_K_per_W)
    if isinstance(effect, SelfDischarge):
        return replace(effect, leak_A=effect.leak_A / share)
    return effect
