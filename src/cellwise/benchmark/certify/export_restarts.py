"""An exported filter that loses its power: its own store keeps its state, and takes it back."""

from __future__ import annotations

import zlib
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.benchmark.certify.exported import Bytes, Exported
from cellwise.benchmark.certify.gauge import RESTART, TORN, UPDATED
from cellwise.estimate.fixed.layout import OUTPUT

# The head of cellwise_stored in words; behind it the state and one word more.
HEAD_WORDS, MODEL_CRC = 8, 3
AGE_UNKNOWN = 0xFFFFFFFF  # a board without a clock that runs on
INVERTED = 0xFFFFFFFF


def run_restarted(
    exported: Exported,
    records: NDArray[Any],
    event: NDArray[Any],
    start: tuple[float, float],
    aged_Ah: float,
) -> NDArray[Any]:
    """Step the C through samples and losses of power.

    Parameters
    ----------
    records : (n,) of layout.INPUT
    event : (n,) int                before each sample, as of `power_events`
    start : (float, float)          SOC and its deviation, where nothing is kept
    aged_Ah : float                 capacity of the tables after an update

    Returns
    -------
    (n,) of layout.OUTPUT
    """
    records, outputs = records.copy(), np.zeros(records.size, dtype=OUTPUT)
    slots = [np.zeros(4 * (HEAD_WORDS + 1) + exported.state_bytes, np.uint8) for _ in range(2)]
    tables, state = exported.tables(), exported.started(*start)
    for first, last in pairwise([0, *np.flatnonzero(event), records.size]):
        kind = event[first] if last > first else 0
        if kind and kind != RESTART:
            _write(exported, slots, state, kind == TORN)
        if kind == UPDATED:
            tables = exported.tables(aged_Ah)
            slots = [_of_other_tables(slot) for slot in slots]
        if kind >= RESTART:
            state = _restored(exported, tables, slots, start)
            records["sequence"][first:] -= records["sequence"][first]
        exported.step(tables, state, records[first:last], outputs[first:last])
    return outputs


def _write(exported: Exported, slots: list[Bytes], state: Bytes, torn: bool) -> None:
    """Keep a state in the slot that is not the newest; torn: half of it comes down."""
    newest = exported.call("newest_slot", *slots)
    whole = slots[1 - newest].copy()
    exported.call("keep", whole, state, slots[newest])
    written = whole.size // 2 if torn else whole.size
    slots[1 - newest][:written] = whole[:written]


def _restored(
    exported: Exported, tables: Bytes, slots: list[Bytes], start: tuple[float, float]
) -> Bytes:
    """The state after a start: of the newest slot, else as nobody knows better."""
    state = exported.started(*start)
    newest = slots[exported.call("newest_slot", *slots)]
    exported.call("restore", tables, state, newest, AGE_UNKNOWN)  # else it stays as started
    return state


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
