"""Bluetooth: the battery management systems that `aiobmsble` knows, asked once a second.

The library asks for Python 3.12, and says of itself that nothing that matters for safety may rely
on it. Its current is positive on charge.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterator
from typing import Any

from cellwise.errors import InputError
from cellwise.live.samples import CELL_FIELDS, FAILURES, Readings, Sample, Stray
from cellwise.logs.files.format import need
from cellwise.logs.files.source import ReadOptions

SCAN_S = 10.0
EVERY_S = 1.0


class BleStream:
    """Samples of one battery management system within reach.

    Parameters
    ----------
    place : str             address or name of the device; what it is its advertisement says
    options : ReadOptions   pack
    sign : str              ``auto``: as the library has it; else as stated
    cells : int             voltages of so many cells; 0: none

    Raises
    ------
    InputError              no library, no adapter, no such device of its list
    """

    def __init__(self, place: str, options: ReadOptions, sign: str, cells: int = 0) -> None:
        self.name = f"BLE {place}"
        sign = "charge-positive" if sign == "auto" else sign
        self._readings = Readings(options, sign, cells)
        known = need("aiobmsble.utils", "a BLE source", "aiobmsble")
        self._bleak = need("bleak", "a BLE source")
        self._loop = asyncio.new_event_loop()
        try:
            self._bms = self._loop.run_until_complete(self._found(place, known))
        except BaseException:
            self._loop.close()
            raise

    async def _found(self, place: str, known: Any) -> Any:
        try:
            seen = await self._bleak.BleakScanner.discover(timeout=SCAN_S, return_adv=True)
        except (self._bleak.exc.BleakError, OSError) as error:
            none = f"no Bluetooth here ({error})"
            raise InputError(none, "an adapter that is up", "Switch it on.") from error
        for address, (device, said) in seen.items():
            if place.casefold() in (address.casefold(), (device.name or "").casefold()):
                kind = await known.bms_identify(said, address)
                if kind is None:
                    unknown = f"a device '{place}' that aiobmsble does not know"
                    raise InputError(unknown, "one of its list", "Choose another device.")
                return kind(device)
        there = ", ".join(sorted(str(d.name or a) for a, (d, _) in seen.items())) or "none"
        raise InputError(
            f"no BLE device '{place}' within reach",
            f"one of {there}",
            "Go nearer, and close any app that holds its connection.",
        )

    def __iter__(self) -> Iterator[Sample | Stray | None]:
        failures = 0
        while True:
            began_s = time.monotonic()
            try:
                found = self._loop.run_until_complete(self._bms.async_update())
            except (self._bleak.exc.BleakError, TimeoutError) as error:
                failures += 1
                if failures > FAILURES:
                    said = f"{self.name}, which does not answer ({error})"
                    raise InputError(said, "a device in reach", "Go nearer to it.") from error
                yield Stray("no answer")
            else:
                failures = 0
                yield self._sample(found, time.time())
            left_s = EVERY_S - (time.monotonic() - began_s)
            self._loop.run_until_complete(asyncio.sleep(max(left_s, 0.0)))

    def _sample(self, found: dict[str, Any], now_s: float) -> Sample:
        for k, volts in enumerate(found.get("cell_voltages", ())):
            self._readings.take(k, float(volts), now_s)
        for field in CELL_FIELDS:
            name = field.partition("_")[0]
            self._readings.take(field, float(found.get(name, math.nan)), now_s)
        return self._readings.sample(now_s, now_s)

    def close(self) -> None:
        """Disconnect."""
        self._loop.run_until_complete(self._bms.disconnect())
        self._loop.close()
