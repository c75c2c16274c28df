"""LeafSpy's log of a car over OBD: the pack, discharge positive, and the voltage of every cell."""

from __future__ import annotations

import re
from dataclasses import replace

from cellwise.logs.files.columns import CLOCK, OWN, Channel
from cellwise.logs.files.csv_layout import has_names, header_cells
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.source import LogSource, RawLog

_VOLTAGE = ("Pack Volts", "Pack volts")
_CURRENT = ("Pack Amps", "Pack amps")
_CELL = re.compile(r"CP\d+")
_SENSORS = ("Pack T1 C", "Pack T2 C", "Pack T4 C", "Pack 1 temp (C)")


def _read(source: LogSource, known: Format) -> RawLog:
    """The pack's channels, and how many cells in series the header names."""
    raw = read_csv(source, known)
    header = next(line for line in source.first_lines if any(name in line for name in _CURRENT))
    cells = sum(bool(_CELL.fullmatch(name.strip())) for name in header_cells(header))
    return replace(raw, cells=cells or None)


LEAFSPY_CSV = Format(
    name="leafspy-csv",
    matches=lambda source: has_names(source, _VOLTAGE, _CURRENT),
    channels=(
        Channel("time_s", {"epoch time": OWN, "Date/Time": CLOCK}, required=True),
        Channel("current_A", dict.fromkeys(_CURRENT, OWN), required=True),
        Channel("voltage_V", dict.fromkeys(_VOLTAGE, OWN), required=True),
        Channel("temperature_C", dict.fromkeys(_SENSORS, OWN)),
    ),
    known=(
        *("Date/Time", "Lat", "Long", "Elv", "Speed", "Gids", "SOC", "AHr", "Max CP mV"),
        *("Min CP mV", "Avg CP mV", "CP mV Diff", "12v Bat Amps"),
        *(f"Pack T{k} {unit}" for k in range(1, 5) for unit in "FC"),
        *(f"CP{k}" for k in range(1, 193)),
        *("VIN", "Hx", "12v Bat Volts", "Odo(km)", "QC", "L1/L2", "TP-FL", "TP-FR", "TP-RR"),
        *("TP-RL", "Ambient", "SOH", "RegenWh", "BLevel", "epoch time", "Motor Pwr(100w)"),
        *("Motor Pwr(w)", "Aux Pwr(100w)", "A/C Pwr(250w)", "A/C Comp(0.1MPa)"),
        *("Est Pwr A/C(50w)", "Est Pwr Htr(250w)", "Plug State", "Charge Mode", "OBC Out Pwr"),
        *("Chrg Pwr", "Gear", "HVolt1", "HVolt2", "GPS Status", "Power SW", "BMS", "OBC", "Debug"),
        *("Motor Temp", "Inverter 2 Temp", "Inverter 4 Temp", "Speed1", "Speed2", "Wiper Status"),
    ),
    read=_read,
    sign="discharge-positive",
)
