"""What is known of one cell in the field, as a block that its firmware takes without new tables.

116 bytes: capacity, resistances over SOC and temperature, a shift of the OCV, offset and gain of
the current sensor. `cellwise_take_patch` checks it and refuses what is damaged, older, of other
tables or beyond its bounds; before each step `cellwise_patch_sample` brings sample and state to
what the tables' own cell would show. The fixed step in Python goes on with the same bits.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellwise.arguments import shown
from cellwise.cell.equations import look_up
from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import INPUT, OUTPUT
from cellwise.estimate.fixed.stepper import FilterMemory, Stepper
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.export.firmware import HostLibrary

# `cellwise_patch` of cellwise_store.h.
RESISTANCE_KNOTS, SHIFT_KNOTS = 5, 9  # over SOC, evenly from 0 to 1, as those of a diagnosis
BLOCK = np.dtype(
    [(n, "<u4") for n in ("magic", "layout", "model_crc", "generation")]
    + [(n, "<f4") for n in ("per_capacity", "offset_A", "per_gain", "cold_C", "per_K")]
    + [("resistance", "<f4", (2, RESISTANCE_KNOTS)), ("shift_V", "<f4", (SHIFT_KNOTS,))]
    + [("crc", "<u4")]
)
MAGIC, LAYOUT = 0x50573031, 2
MOST_GENERATION = 2**32 - 1
NONE = (1.0,) * RESISTANCE_KNOTS


class PatchBounds(NamedTuple):
    """What a target takes, ends included.

    Of the capacity, of every resistance, of the gain, of the OCV's shift [V], of temperatures
    [degC].
    """

    capacity_share: tuple[float, float] = (0.1, 2.0)
    resistance: tuple[float, float] = (0.1, 20.0)
    gain: tuple[float, float] = (0.5, 2.0)
    shift_V: tuple[float, float] = (-0.2, 0.2)
    temperature_C: tuple[float, float] = (-60.0, 100.0)


@dataclass(frozen=True)
class Patch:
    """What is known of one cell and its current sensor beside the model.

    Parameters
    ----------
    generation : int             1 and up; a target takes no older one
    capacity_share : float       of the model's capacity that is left
    resistance : (2, 5) float    factors on all resistances at even knots over SOC, cold and warm
    temperature_C : (2,) float   where the two rows hold [degC], at least 1 K apart; between them
                                 factors are linear, beyond them they stay
    shift_V : (9,) float         of the OCV at even knots over SOC [V]
    offset_A : float             what the sensor shows without a current [A]
    gain : float                 what it shows for each ampere beside that

    Raises
    ------
    InputError        outside :class:`PatchBounds`; another number of knots
    """

    generation: int
    capacity_share: float = 1.0
    resistance: ArrayLike = (NONE, NONE)
    temperature_C: tuple[float, float] = (0.0, 25.0)
    shift_V: ArrayLike = (0.0,) * SHIFT_KNOTS
    offset_A: float = 0.0
    gain: float = 1.0

    def __post_init__(self) -> None:
        for name, shape in (("resistance", (2, RESISTANCE_KNOTS)), ("shift_V", (SHIFT_KNOTS,))):
            if np.shape(getattr(self, name)) != shape:
                raise _refused(f"{name} = {shown(getattr(self, name))}", f"an array {shape}")
        limits = {"generation": (1, MOST_GENERATION), **PatchBounds()._asdict()}
        for name, (least, most) in limits.items():
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if not np.all((value >= least) & (value <= most)):
                raise _refused(f"{name} = {shown(value.tolist())}", f"{least:g} to {most:g}")
        cold_C, warm_C = self.temperature_C
        if not warm_C - cold_C >= 1.0:
            raise _refused(f"rows at {cold_C:g} and {warm_C:g} degC", "rows 1 K apart at least")

    def block(self, tables: FixedStepTables) -> bytes:
        """The bytes for a target with these tables, least significant first.

        Raises
        ------
        InputError        an offset beyond half of 1C
        """
        most_A = float(np.sqrt(tables.constants["lost_A2"][0]))
        return self.block_of(zlib.crc32(tables.to_bytes()), most_A)

    def block_of(self, model_crc: int, most_A: float) -> bytes:
        """The bytes for a target whose tables have that CRC-32, with an offset of at most so much.

        Raises
        ------
        InputError        an offset beyond it
        """
        if not abs(self.offset_A) <= most_A:
            raise _refused(f"offset_A = {self.offset_A}", f"at most {most_A:g} A")
        block = np.zeros((), dtype=BLOCK)
        block["magic"], block["layout"] = MAGIC, LAYOUT
        block["model_crc"] = model_crc
        for name in ("generation", "offset_A", "resistance", "shift_V"):
            block[name] = getattr(self, name)
        block["per_capacity"] = 1.0 / self.capacity_share
        block["per_gain"] = 1.0 / self.gain
        cold_C, warm_C = self.temperature_C
        block["cold_C"], block["per_K"] = cold_C, 1.0 / (warm_C - cold_C)
        block["crc"] = zlib.crc32(block.tobytes()[:-4])
        return block.tobytes()


def patch_between(
    model: CellModel,
    new: CellModel,
    generation: int,
    temperature_C: tuple[float, float],
    **sensors: float,
) -> Patch:
    """What makes a target with ``model`` follow the cell that ``new`` describes.

    Capacity, OCV and, by what a long load drops, resistances; not how a drop is shared between
    branches, nor what has no form in a patch (hysteresis, self-discharge, warming).

    Parameters
    ----------
    model, new : CellModel       of the target's tables; extended by a diagnosis or fitted again
    temperature_C : (2,) float   where ``new`` is known; within 1 K of each other both count as one
    sensors                      ``offset_A`` and ``gain`` of a patch; ``offset_V``, which the
                                 voltage sensor adds

    Raises
    ------
    InputError        as :class:`Patch`
    """
    low_C, high_C = temperature_C
    if high_C - low_C < 1.0:
        low_C, high_C = low_C - 1.0, high_C + 1.0
    before, after = (
        [[look_up(m.parameters(), s, t) for s in _KNOTS] for t in (low_C, high_C)]
        for m in (model, new)
    )
    drop = [
        [[p.r0_ohm + p.r1_ohm + p.r2_ohm + p.r3_ohm for p in row] for row in of]
        for of in (before, after)
    ]
    ocv_V = np.array([[[p.ocv_V for p in row] for row in of] for of in (before, after)])
    ratio = np.array(drop[1]) / np.array(drop[0])
    shift_V = np.mean(ocv_V[1] - ocv_V[0], axis=0) + sensors.pop("offset_V", 0.0)
    return Patch(
        generation,
        new.capacity_Ah / model.capacity_Ah,
        ratio[:, :: (SHIFT_KNOTS - 1) // (RESISTANCE_KNOTS - 1)],
        (low_C, high_C),
        shift_V,
        **sensors,
    )


def patch_of(
    causes: Mapping[str, Mapping[str, float]],
    model: CellModel,
    generation: int,
    new: CellModel | None = None,
    temperature_C: tuple[float, float] = (0.0, 25.0),
) -> Patch:
    """A patch of the causes that a diagnosis named.

    Parameters
    ----------
    causes : mapping             of their names to parameters, as a `FoundCause` has them
    model : CellModel            that the target has
    new : CellModel or None      what the diagnosis extended; None: capacity, one factor on all
                                 resistances, a shift of the OCV by their parameters, no other
    temperature_C : (2,) float   of the logs, from the lowest to the highest [degC]

    Raises
    ------
    InputError        no cause, or one that needs new tables; as :class:`Patch`
    """
    known = HELD if new is not None else {n: p for n, p in HELD.items() if p or n in OF_ONE_CELL}
    beyond = sorted(set(causes) - known.keys() - OF_LOGS)
    held = {name: of for name, of in causes.items() if name in known}
    if beyond or not held:
        raise _refused(", ".join(beyond or causes) or "no cause", ", ".join(known))
    sensors = {HELD[name]: of[HELD[name]] for name, of in held.items() if HELD[name]}
    if new is not None:
        return patch_between(model, new, generation, temperature_C, **sensors)
    capacity_Ah = held.get("capacity", {}).get("capacity_Ah", model.capacity_Ah)
    scale = held.get("resistance_scale", {}).get("scale", 1.0)
    knots_V = np.array([*held.get("ocv_shift", {}).values()] or [0.0] * SHIFT_KNOTS)
    return Patch(
        generation,
        capacity_Ah / model.capacity_Ah,
        np.full((2, RESISTANCE_KNOTS), scale),
        temperature_C,
        knots_V + sensors.pop("offset_V", 0.0),
        **sensors,
    )


# Causes that a patch holds, those of a sensor by their parameter; and those that no target has.
HELD = {
    "current_offset": "offset_A",
    "current_gain": "gain",
    "voltage_offset": "offset_V",
    **dict.fromkeys(("capacity", "resistance_scale", "ohmic_resistance", "ocv_shift"), ""),
    **dict.fromkeys(("lithium_inventory", "active_material_negative"), ""),
    **dict.fromkeys(("active_material_positive", "temperature_dependence"), ""),
}
OF_ONE_CELL = ("capacity", "resistance_scale", "ocv_shift")
OF_LOGS = {"initial_soc", "sensor_fault"}
_KNOTS = np.linspace(0.0, 1.0, SHIFT_KNOTS)


def read_patch(path: str | Path) -> bytes:
    """The block of a file, as it is.

    Raises
    ------
    InputError        no file that can be read
    """
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise _refused(f"'{path}', which cannot be read ({error.strerror})", "a file") from error


def taken(block: bytes, tables: FixedStepTables) -> NDArray[Any]:
    """A block as a target with these tables has it once it has taken it: one record of BLOCK.

    Raises
    ------
    InputError        what the target refuses: damaged, another version, of other tables
    """
    head = np.frombuffer(block[:8].ljust(8, b"\0"), dtype="<u4")
    if head[0] != MAGIC:
        raise _refused(f"{len(block)} bytes that are no patch", "what a diagnosis writes")
    if head[1] != LAYOUT:
        raise _refused(f"a patch of version {head[1]}", f"version {LAYOUT}")
    if len(block) != BLOCK.itemsize or zlib.crc32(block[:-4]) != int.from_bytes(
        block[-4:], "little"
    ):
        raise _refused("a damaged patch", f"{BLOCK.itemsize} bytes with their CRC")
    found = np.frombuffer(block, dtype=BLOCK)
    if found["model_crc"][0] != zlib.crc32(tables.to_bytes()):
        raise _refused("a patch of other tables", "one of the tables at hand")
    return found


def patched_sample(patch: NDArray[Any], states: NDArray[Any], sample: NDArray[Any]) -> None:
    """`cellwise_patch_sample` in Python, in place: a sample, and states before its step."""
    one = patch[0]
    soc = _held(states["soc"], 0.0, 1.0)
    weight = np.zeros(soc.size, dtype=np.float32)
    if "temperature_C" in (states.dtype.names or ()):
        weight = _held((states["temperature_C"] - one["cold_C"]) * one["per_K"], 0.0, 1.0)
    cold, warm = (_at_knots(row, soc) for row in one["resistance"])
    bounds = PatchBounds()
    states["per_capacity"] = _held(one["per_capacity"], *_inverse(bounds.capacity_share))
    states["resistance_scale"] = _held(cold + weight * (warm - cold), *bounds.resistance)
    sample["current_A"] = (sample["current_A"] - one["offset_A"]) * one["per_gain"]
    sample["voltage_V"] = sample["voltage_V"] - _at_knots(one["shift_V"], soc[:1])


def patched_rows(
    stepper: Stepper, patch: NDArray[Any], memory: FilterMemory, samples: NDArray[Any]
) -> NDArray[Any]:
    """Step every sample with a patch that was taken: records of OUTPUT, shape (samples,).

    Compiled C takes and applies it itself.

    Raises
    ------
    InputError        made without ``health``; a patch that the C refuses
    """
    stepper.need("health")
    outputs = np.zeros(samples.size, dtype=OUTPUT)
    seen = np.array(samples, dtype=INPUT)
    if isinstance(stepper, HostLibrary):
        handed: tuple[Any, ...] = (memory.states, seen, outputs, seen.size)
        name = "patched_rows"
        if memory.bank is not None:
            count = memory.states.size - 1
            name, handed = "patched_bank_rows", (memory.bank, memory.states, count, *handed[1:])
        refused = stepper.call(name, patch, *handed)
        if refused:
            raise _refused(f"a patch that the C refuses with {refused}", "a block of `Patch`")
        return outputs
    for k in range(seen.size):
        sample = seen[k : k + 1]
        alone = memory.bank is None or not memory.bank["spread"][0]
        patched_sample(patch, memory.states[:1] if alone else memory.states, sample)
        outputs[k] = stepper.filter_rows(memory, sample)[0]
    return outputs


def _held(value: NDArray[Any], least: float, most: float) -> NDArray[Any]:
    """Within a range; what is no number at its lower end."""
    return np.fmin(np.where(value > np.float32(least), value, np.float32(least)), np.float32(most))


def _inverse(of: tuple[float, float]) -> tuple[float, float]:
    return 1.0 / of[1], 1.0 / of[0]


def _at_knots(over: NDArray[Any], soc: NDArray[Any]) -> NDArray[Any]:
    """A line between even knots over SOC."""
    last = over.size - 1
    place = soc * np.float32(last)
    k = np.minimum(place.astype(np.uint32), np.uint32(last - 1))
    share = place - k.astype(np.float32)
    return np.asarray(over[k] + share * (over[k + 1] - over[k]))


def _refused(what: str, expected: str) -> InputError:
    return InputError(what, f"what a patch holds: {expected}", "Export new tables instead.")
