"""What the gauge says as CAN signals: a DBC, and the C that packs them, both by cantools."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.status import Status
from cellwise.export.c_tables import comment
from cellwise.export.firmware import need_package
from cellwise.export.package import Export
from cellwise.files import write_atomically
from cellwise.notices import Notice

if TYPE_CHECKING:
    from cantools.database.can import Database


class Bus(NamedTuple):
    """How the frames go over a bus.

    Below ``first_id`` are what a bus needs sooner, above it diagnosis; a signal has so many
    ``steps``. The largest power shown is that of ``rate_h`` times the capacity in an hour.
    """

    first_id: int = 0x5A0
    cycle_ms: int = 100
    steps: int = 2**16
    rate_h: float = 10.0


BUS = Bus()
SUFFIXES = (".dbc",)
POWER_FACTORS_W = (0.01, 0.1, 1.0, 10.0, 100.0)


class Value(NamedTuple):
    """A signal of 16 bits: name, value of one step, unit, meaning."""

    name: str
    factor: float
    unit: str
    meaning: str


def messages_of(model: CellModel, cells: int = 1) -> dict[str, tuple[Value, ...]]:
    """The signals by message, in the order of their identifiers."""
    most_W = BUS.rate_h * model.capacity_Ah * float(model.ocv_V.max()) * max(cells, 1)
    watt = next((f for f in POWER_FACTORS_W if f * (BUS.steps - 2) >= most_W), POWER_FACTORS_W[-1])
    return {
        "Soc": (
            Value("Soc", 0.01, "%", "state of charge"),
            Value("SocLow", 0.01, "%", "two deviations less"),
            Value("SocHigh", 0.01, "%", "two deviations more"),
            Value("Status", 1.0, "", ", ".join(f"{int(s)} {s.name}" for s in Status)),
        ),
        "Remaining": (
            Value("Time", 2.0, "s", "until the load reaches the cutoff"),
            Value("TimeLow", 2.0, "s", "two deviations less"),
            Value("TimeHigh", 2.0, "s", "two deviations more"),
        ),
        "Power": (
            Value("Discharge", watt, "W", "what the cells can give for the horizon of the export"),
            Value("DischargeLow", watt, "W", "and sustain with 95 %"),
            Value("Charge", watt, "W", "what they can take, without sign"),
            Value("ChargeLow", watt, "W", "and sustain with 95 %"),
        ),
    }


def check(_: str) -> None:
    """Refuse to write without cantools."""
    need_package("cantools")


def write(export: Export, path: str) -> tuple[list[Path], list[Notice]]:
    """Write the DBC and, beside it, the C that packs its signals: OUT.dbc, OUT.h, OUT.c.

    Raises
    ------
    InputError        a file name that is no name of C; a path that cannot be written
    """
    from cantools.database.can import c_source

    place = Path(path)
    name = place.stem.lower()
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", name):
        raise InputError(
            f"a file name '{place.stem}'",
            "a name of C, which its functions begin with",
            "Rename it.",
        )
    database = database_of(export.model, export.cells)
    header, source, *_ = c_source.generate(
        database, name, f"{name}.h", f"{name}.c", f"{name}_fuzz.c", use_float=True
    )
    texts = {place: database.as_dbc_string(), place.with_suffix(".h"): header}
    texts[place.with_suffix(".c")] = source
    return [write_atomically(where, text) for where, text in texts.items()], []


def database_of(model: CellModel, cells: int) -> Database:
    """The messages as cantools knows them."""
    from cantools.database.can import Database, Message, Node, Signal
    from cantools.database.conversion import BaseConversion

    def signal(value: Value, k: int) -> Any:
        return Signal(
            value.name,
            16 * k,
            16,
            conversion=BaseConversion.factory(scale=value.factor),
            minimum=0,
            maximum=round(value.factor * (BUS.steps - 1), 6),
            unit=value.unit or None,
            comment=value.meaning,
        )

    messages = [
        Message(
            BUS.first_id + k,
            name,
            2 * len(values),
            [signal(value, j) for j, value in enumerate(values)],
            cycle_time=BUS.cycle_ms,
            senders=["Gauge"],
            comment=f"{comment(model.name) or 'unnamed cell'}; 65535 steps: not known",
        )
        for k, (name, values) in enumerate(messages_of(model, cells).items())
    ]
    return Database(messages, nodes=[Node("Gauge")])
