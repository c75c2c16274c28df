"""What is known of one cell in the field, as a block that its firmware takes without new tables.

36 bytes: capacity, all resistances, offset and gain of the current sensor. `cellwise_take_patch`
checks it and refuses what is damaged, older, of other tables or beyond its bounds; the fixed step
in Python goes on with the same bits.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.tables import FixedStepTables

# `cellwise_patch` of cellwise_store.h.
BLOCK = np.dtype(
    [(n, "<u4") for n in ("magic", "layout", "model_crc", "generation")]
    + [(n, "<f4") for n in ("capacity_share", "resistance_scale", "offset_A", "per_gain")]
    + [("crc", "<u4")]
)
MAGIC, LAYOUT = 0x50573031, 1
MOST_GENERATION = 2**32 - 1


class PatchBounds(NamedTuple):
    """What a target takes, ends included: of the capacity, of the resistances, of the gain."""

    capacity_share: tuple[float, float] = (0.1, 2.0)
    resistance_scale: tuple[float, float] = (0.1, 20.0)
    gain: tuple[float, float] = (0.5, 2.0)


@dataclass(frozen=True)
class Patch:
    """What is known of one cell and its current sensor beside the model.

    Parameters
    ----------
    generation : int             1 and up; a target takes no older one
    capacity_share : float       of the model's capacity that is left
    resistance_scale : float     factor on all resistances
    offset_A : float             what the sensor shows without a current [A]
    gain : float                 what it shows for each ampere beside that

    Raises
    ------
    InputError        outside :class:`PatchBounds`
    """

    generation: int
    capacity_share: float = 1.0
    resistance_scale: float = 1.0
    offset_A: float = 0.0
    gain: float = 1.0

    def __post_init__(self) -> None:
        limits = {"generation": (1, MOST_GENERATION), **PatchBounds()._asdict()}
        for name, (least, most) in limits.items():
            if not least <= getattr(self, name) <= most:
                raise _refused(f"{name} = {getattr(self, name)}", f"{least:g} to {most:g}")

    def block(self, tables: FixedStepTables) -> bytes:
        """The bytes for a target with these tables, least significant first.

        Raises
        ------
        InputError        an offset beyond half of 1C
        """
        most_A = float(np.sqrt(tables.constants["lost_A2"][0]))
        if not abs(self.offset_A) <= most_A:
            raise _refused(f"offset_A = {self.offset_A}", f"at most {most_A:g} A")
        block = np.zeros((), dtype=BLOCK)
        block["magic"], block["layout"] = MAGIC, LAYOUT
        block["model_crc"] = zlib.crc32(tables.to_bytes())
        for name in ("generation", "capacity_share", "resistance_scale", "offset_A"):
            block[name] = getattr(self, name)
        block["per_gain"] = np.float32(1.0 / self.gain)
        block["crc"] = zlib.crc32(block.tobytes()[:-4])
        return block.tobytes()

    def take(self, fixed: FixedStep, state: NDArray[Any]) -> None:
        """Go on with it in Python: capacity and resistances into a state of ``fixed``.

        Raises
        ------
        InputError        as :meth:`FixedStep.set_health`
        """
        fixed.set_health(state, self.capacity_share, self.resistance_scale)

    def corrected_A(self, current_A: ArrayLike) -> NDArray[np.float32]:
        """Currents for a step, of what the sensor shows [A]: the bits of the C."""
        shown = np.asarray(current_A, dtype=np.float32)
        return np.asarray((shown - np.float32(self.offset_A)) * np.float32(1.0 / self.gain))


def patch_of(causes: Mapping[str, Mapping[str, float]], model: CellModel, generation: int) -> Patch:
    """A patch of the causes that a diagnosis named.

    Parameters
    ----------
    causes : mapping    of names to parameters: ``{c.name: c.parameters for c in found.causes}``
    model : CellModel   that the target has

    Raises
    ------
    InputError        no cause, or one that needs new tables; beyond the bounds of a patch
    """
    known = {
        ("capacity", "capacity_Ah"): ("capacity_share", model.capacity_Ah),
        ("resistance_scale", "scale"): ("resistance_scale", 1.0),
        ("current_offset", "offset_A"): ("offset_A", 1.0),
        ("current_gain", "gain"): ("gain", 1.0),
    }
    found = {known.get((name, p)): v for name, of in causes.items() for p, v in of.items()}
    if not found or None in found:
        raise _refused(f"causes {', '.join(causes) or 'none'}", "capacity, resistances, current")
    return Patch(generation, **{to[0]: v / to[1] for to, v in found.items() if to})


def _refused(what: str, expected: str) -> InputError:
    return InputError(what, f"what a patch holds: {expected}", "Export new tables instead.")
