"""An exported filter that loses its power: its own store keeps its state, and takes it back."""

from __future__ import annotations

import zlib
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.benchmark.certify.exported import Exported
from cellwise.benchmark.certify.gauge import RESTART, TORN, UPDATED
from cellwise.estimate.fixed.layout import OUTPUT
from cellwise.estimate.fixed.stepper import FilterMemory
from cellwise.export.firmware import HostLibrary, LoadedLibrary
from cellwise.typing import BoolArray

Bytes = NDArray[np.uint8]

# The head of cellwise_stored in words; behind it the state and one word more.
HEAD_WORDS, MODEL_CRC = 8, 3
AGE_UNKNOWN = 0xFFFFFFFF  # a board without a clock that runs on
# As the glue of every layout does: beside regular writes one where the SOC has moved by a point
# since the last. It is looked at as often.
MOVED_SOC, LOOK_S = 0.01, 60.0
INVERTED = 0xFFFFFFFF


def run_restarted(
    exported: Exported,
    records: NDArray[Any],
    event: NDArray[Any],
    start: tuple[float, float],
    aged_Ah: float,
) -> tuple[NDArray[Any], BoolArray]:
    """Step the C through samples and losses of power.

    Parameters
    ----------
    records : (n,) of layout.INPUT
    event : (n,) int                before each sample, as of `power_events`
    start : (float, float)          SOC and its deviation, where nothing is kept
    aged_Ah : float                 capacity of the tables after an update

    Returns
    -------
    (n,) of layout.OUTPUT, (n,) bool       what it says, and before which samples it has written
    """
    records, outputs = records.copy(), np.zeros(records.size, dtype=OUTPUT)
    written = np.zeros(records.size, dtype=np.bool_)
    look = max(round(LOOK_S / exported.dt_s), 1)
    stepper, memory = exported.stepper, exported.started(*start)
    size = 4 * (HEAD_WORDS + 1) + memory.states.itemsize
    slots = [np.zeros(size, np.uint8) for _ in range(2)]
    for first, last in pairwise([0, *np.flatnonzero(event), records.size]):
        kind = event[first] if last > first else 0
        if kind and kind != RESTART:
            _write(stepper.loaded, slots, memory, kind == TORN)
            written[first] = kind != TORN
        if kind == UPDATED:
            stepper = exported.of_capacity(aged_Ah)
            slots = [_of_other_tables(slot) for slot in slots]
        if kind >= RESTART:
            memory = exported.started(*start)  # as nobody knows better, unless a slot does
            _restore(stepper, slots, memory)
            records["sequence"][first:] -= records["sequence"][first]
        kept_soc = memory.states["soc"][0] if written.any() else np.nan
        for row in range(first, last, look):
            if abs(memory.states["soc"][0] - kept_soc) >= MOVED_SOC:
                _write(stepper.loaded, slots, memory, torn=False)
                written[row], kept_soc = True, memory.states["soc"][0]
            rows = slice(row, min(row + look, last))
            outputs[rows] = stepper.filter_rows(memory, records[rows])
    return outputs, written


def _write(library: LoadedLibrary, slots: list[Bytes], memory: FilterMemory, torn: bool) -> None:
    """Keep the estimate in the slot that is not the newest; torn: half of it comes down."""
    newest = library.call("newest_slot", *slots)
    whole = slots[1 - newest].copy()
    library.call("keep", whole, memory.states, slots[newest])
    written = whole.size // 2 if torn else whole.size
    slots[1 - newest][:written] = whole[:written]


def _restore(stepper: HostLibrary, slots: list[Bytes], memory: FilterMemory) -> None:
    """Take back what the newest slot holds; of one that is damaged nothing."""
    newest = slots[stepper.loaded.call("newest_slot", *slots)]
    if memory.bank is None:
        stepper.call("restore", memory.states, newest, AGE_UNKNOWN)
    else:
        count = memory.states.size - 1
        stepper.call("bank_restore", memory.bank, memory.states, count, newest, AGE_UNKNOWN)


def _of_other_tables(slot: Bytes) -> Bytes:
    """What is kept as if it had been written with other tables, its checks right again."""
    words = slot.copy().view("<u4")
    was_whole = np.array_equal(words, _checked(words))
    words[MODEL_CRC] ^= 1
    return (_checked(words) if was_whole else words).view(np.uint8)


def _checked(words: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """A record with the CRCs of what is in it."""
    found, last = words.copy(), HEAD_WORDS - 1
    found[last] = zlib.crc32(found[:last].tobytes())
    found[-1] = zlib.crc32(found[HEAD_WORDS:-1].tobytes(), INVERTED ^ int(found[last]))
    return found
