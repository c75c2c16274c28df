"""BioLogic EC-Lab: ``.mpt`` text and ``.mpr`` binary, oxidation (charge) positive."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellwise.logs.files.columns import MILLI, OWN, TURNED, TURNED_MILLI, Channel
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.extras import need
from cellwise.logs.files.format import Format, library_at_work
from cellwise.logs.files.named_arrays import channels_of
from cellwise.logs.files.source import LogSource, RawLog

_TEXT = ("EC-Lab ASCII FILE", "BT-Lab ASCII FILE")
_BINARY = b"BIO-LOGIC MODULAR FILE"

_VOLTAGES = ("Ewe/V", "Ecell/V", "<Ewe>/V", "<Ecell>/V", "Ewe-Ece/V")
_CURRENTS = ("<I>/mA", "I/mA", "<I>/A", "I/A")

_CHANNELS = (
    Channel("time_s", {"time/s": OWN}, required=True),
    Channel(
        "current_A",
        {"<I>/mA": MILLI, "I/mA": MILLI, "<I>/A": OWN, "I/A": OWN},
        required=True,
        instead="charge_Ah",  # galvanostatic files hold the charge of every row instead
    ),
    Channel(
        "voltage_V",
        {"Ecell/V": OWN, "<Ecell>/V": OWN, "Ewe-Ece/V": OWN},
        required=True,
        instead="working_V",  # the cell, of two electrodes
    ),
    Channel("working_V", {"Ewe/V": OWN, "<Ewe>/V": OWN}),
    Channel("counter_V", {"Ece/V": OWN, "<Ece>/V": OWN}),
    Channel(
        "temperature_C",
        {"Temperature/°C": OWN, "Temperature/C": OWN, "Analog IN 1/°C": OWN, "T/°C": OWN},
    ),
    Channel(
        "charge_Ah",
        {"(Q-Qo)/mA.h": TURNED_MILLI, "(Q-Qo)/A.h": TURNED, "(Q-Q0)/mA.h": TURNED_MILLI},
    ),
    Channel("step", {"Ns": OWN}),
)
_KNOWN = (
    *("mode", "ox/red", "error", "control changes", "Ns changes", "counter inc.", "flags"),
    *("control/V/mA", "control/V", "control/mA", "dq/mA.h", "dQ/mA.h", "dQ/C", "(Q-Qo)/C", "P/W"),
    *("I Range", "cycle number", "half cycle", "z cycle", "x", "|Ece|/V", "Energy/W.h"),
    *("Energy charge/W.h", "Energy discharge/W.h", "|Energy|/W.h", "Capacity/mA.h", "R/Ohm"),
    *("Q charge/discharge/mA.h", "Q charge/mA.h", "Q discharge/mA.h", "Efficiency/%", "Rcmp/Ohm"),
    *("step time/s", "Capacitance charge/µF", "Capacitance discharge/µF", "Analog IN 1/V"),
    *("Analog IN 2/V", "Rdc/Ohm", "Energy we charge/W.h", "Energy we discharge/W.h"),
    *("Energy ce charge/W.h", "Energy ce discharge/W.h", "Energy we-ce charge/W.h"),
    *("Energy we-ce discharge/W.h", "Pwe/W", "Pce/W", "Pwe-ce/W", "Rwe/Ohm", "Rce/Ohm"),
    "Rwe-ce/Ohm",
)


def _is_text(source: LogSource) -> bool:
    lines = source.first_lines
    if lines and lines[0].lstrip("\ufeff").startswith(_TEXT):
        return True
    return has_names(source, ("time/s",), _VOLTAGES, ("mode", "ox/red", "Ns changes", *_CURRENTS))


def _read_binary(source: LogSource, known: Format) -> RawLog:
    biologic = need("galvani.BioLogic", "a BioLogic .mpr file")
    with library_at_work(source, "BioLogic .mpr file"), source.open() as file:
        data: Any = biologic.MPRfile(file).data
    names = data.dtype.names
    return channels_of({name: np.asarray(data[name]) for name in names}, source, known)


BIOLOGIC_MPT = Format(
    name="biologic-mpt",
    matches=_is_text,
    channels=_CHANNELS,
    known=_KNOWN,
    read=read_csv,
    sign="charge-positive",
)

BIOLOGIC_MPR = Format(
    name="biologic-mpr",
    matches=lambda source: source.head.startswith(_BINARY),
    channels=_CHANNELS,
    known=_KNOWN,
    read=_read_binary,
    sign="charge-positive",
    apart=True,
)
