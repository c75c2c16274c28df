"""How causes look in sketches: each hidden in the model's own logs, kept with the model.

The block ``sketch`` of a model's provenance: ``version`` of the sums, ``mark`` of the model it was
made of, and by the number of parameters ``clean`` (of the own logs as they are), ``causes`` (what
each adds at its usual size), ``sizes`` (the same over the own logs' ``excess``, by which a size is
read: parameters over the excess that a cause makes itself grow less than it) and their mean
``temperature_C``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_file import model_mark
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.sketch.sketcher import Sketcher, means_of
from cellwise.estimate.sketch.stored import MAGIC, SketchSums, read_sums
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

# In the order of a sketch's derivatives; a small sketch has the first six.
ORDER = (
    "current_offset", "time_skew", "slow_diffusion", "hysteresis", "initial_soc",
    "voltage_offset", "resistance_scale", "ohmic_resistance", "capacity",
)  # fmt: skip
NAMED = (
    "current_offset", "current_gain", "voltage_offset", "time_skew", "ohmic_resistance",
    "slow_diffusion", "hysteresis",
)  # fmt: skip
SMALL_BYTES, WHOLE_BYTES = 256, 1024
RIDGE = 8.0  # of every parameter, in its unit
PERIOD_S = 1.0  # at which the own logs are stepped
SLOW_S = 1500.0
PATH_PER_CAPACITY = 60.0
BLOCK, VERSION = "sketch", f"{MAGIC:x}-2"


class Pictures(NamedTuple):
    """Parameters of the own logs as they are, by cause what it adds, their mean temperature.

    ``sizes``: what a cause adds over the ``excess`` of the own logs.
    """

    clean: FloatArray
    causes: Mapping[str, FloatArray]
    temperature_C: float
    sizes: Mapping[str, FloatArray]
    excess: float


def usual(model: CellModel) -> dict[str, float]:
    """Size at which a cause is hidden: 3.5 % of 1C, 5.5 %, 20 mV, 0.7 s, 0.43 and 1.8 R0, 28 mV."""
    ohm = float(np.median(model.r0_ohm))
    return {
        "current_offset": 0.035 * model.capacity_Ah,
        "current_gain": 0.055,
        "voltage_offset": 0.020,
        "time_skew": 0.7,
        "ohmic_resistance": 0.425 * ohm,
        "slow_diffusion": 1.75 * ohm,
        "hysteresis": 0.0275,
    }


def parameters_of(
    model: CellModel, sketches: Sequence[SketchSums], excess: float | None = None
) -> FloatArray:
    """Parameters that sketches give together, in units of what is usual in the field.

    ``excess`` in place of each sketch's own: parameters are linear in a cause then.
    """
    shares = [1.0 if excess is None else s.excess / excess for s in sketches]
    ohm, capacity_Ah = float(np.median(model.r0_ohm)), model.capacity_Ah
    units = np.array([0.03 * capacity_Ah, 0.5, ohm, 0.03, -0.02, 0.02, 0.3, 0.3 * ohm, -0.05])
    units = units[: sketches[0].with_residual.size]
    each = list(zip(shares, sketches, strict=True))
    products = np.outer(units, units) * np.mean([w * s.products for w, s in each], axis=0)
    right = units * np.mean([w * s.with_residual for w, s in each], axis=0)
    return np.asarray(np.linalg.solve(products + RIDGE * np.eye(units.size), right))


def hidden(log: CellLog, cause: str, size: float, model: CellModel) -> CellLog:
    """The log with a cause in it, of a size in its unit (A, 1, V, s, ohm, ohm, V)."""
    volts, current = log.voltage_V, log.current_A
    if cause == "current_offset":
        return replace(log, current_A=current + size, charge_Ah=None)
    if cause == "current_gain":
        return replace(log, current_A=current * (1.0 + size), charge_Ah=None)
    if cause == "voltage_offset":
        return replace(log, voltage_V=volts + size)
    if cause == "time_skew":
        return replace(log, voltage_V=np.interp(log.time_s - size, log.time_s, volts))
    if cause == "ohmic_resistance":
        return replace(log, voltage_V=volts - size * log.interval_current_A)
    if cause == "slow_diffusion":
        slow_A = _followed(log, np.full(len(log), SLOW_S), log.interval_current_A)
        return replace(log, voltage_V=volts - size * slow_A)
    rate = PATH_PER_CAPACITY * np.abs(log.interval_current_A) / (3600.0 * model.capacity_Ah)
    path = _followed(log, 1.0 / np.maximum(rate, 1e-12), -np.sign(log.interval_current_A))
    return replace(log, voltage_V=volts + size * path)


def _followed(log: CellLog, tau_s: FloatArray, end: FloatArray) -> FloatArray:
    """What follows ``end`` by a time constant from 0."""
    keep = np.exp(-log.interval_s / tau_s)
    value, found = 0.0, np.zeros(len(log))
    for k in range(1, len(log)):
        value = keep[k] * value + (1.0 - keep[k]) * end[k]
        found[k] = value
    return found


def _mark(model: CellModel) -> str:
    """Of what a sketch is made with; a posterior is rounded where it is written."""
    return model_mark(replace(model, posterior=None))


def make_pictures(model: CellModel, logs: Iterable[CellLog]) -> CellModel:
    """The model with how causes look in sketches of its own logs, whose ``soc0`` is stated.

    Raises
    ------
    InputError        no log; a log without a stated start
    """
    own = [means_of(log, PERIOD_S) for log in logs]
    if not own:
        raise InputError("no drive to make pictures of", "own logs under load", "Give drives.")
    block: dict[str, Any] = {"version": VERSION, "mark": _mark(model)}
    for most in (SMALL_BYTES, WHOLE_BYTES):
        sketcher = Sketcher(FixedStep(model, dt_s=PERIOD_S, sketch=most))
        kept = _kept(sketcher, own)
        clean, excess = parameters_of(model, kept), float(np.mean([s.excess for s in kept]))
        level = parameters_of(model, kept, excess)
        causes, sizes = {}, {}
        for cause, size in usual(model).items():
            odd = _kept(sketcher, [hidden(log, cause, size, model) for log in own])
            causes[cause] = _rounded(parameters_of(model, odd) - clean)
            sizes[cause] = _rounded(parameters_of(model, odd, excess) - level)
        block[str(clean.size)] = {
            "clean": _rounded(clean),
            "temperature_C": round(float(np.mean([s.temperature_C for s in kept])), 2),
            "causes": causes,
            "sizes": sizes,
            "excess": float(f"{excess:.6g}"),
        }
    return replace(model, provenance={**model.provenance, BLOCK: block})


def _kept(sketcher: Sketcher, logs: Sequence[CellLog]) -> list[SketchSums]:
    return [read_sums(sketcher.bytes_of(sketcher.run(log))) for log in logs]


def _rounded(values: FloatArray) -> list[float]:
    return [float(f"{v:.6g}") for v in values]


def pictures_in(model: CellModel) -> dict[int, Pictures]:
    """The pictures that a model keeps, by the number of parameters.

    Raises
    ------
    InputError        none, of another version, or of another model
    """
    block = model.provenance.get(BLOCK)
    fits = isinstance(block, Mapping) and block.get("version") == VERSION
    if not isinstance(block, Mapping) or not fits or block.get("mark") != _mark(model):
        raise InputError(
            "a model that does not know how causes look in sketches of its own logs",
            "a model identified with its sketches, and not changed since",
            "Make it with `make_pictures(model, logs)`.",
        )
    return {
        int(size): Pictures(
            np.array(one["clean"]),
            {n: np.array(look) for n, look in one["causes"].items()},
            float(one["temperature_C"]),
            {n: np.array(look) for n, look in one["sizes"].items()},
            float(one["excess"]),
        )
        for size, one in block.items()
        if size.isdigit()
    }
