"""Novonix CSV: sections in brackets, then a table with times in hours, charge positive."""

from __future__ import annotations

from cellwise.logs.files.columns import OWN, Channel, Unit
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format

NOVONIX_CSV = Format(
    name="novonix-csv",
    matches=lambda source: has_names(source, ("Run Time (h)",), ("Potential (V)", "Voltage (V)")),
    channels=(
        Channel("time_s", {"Run Time (h)": Unit(3600.0)}, required=True),
        Channel("current_A", {"Current (A)": OWN}, required=True),
        Channel("voltage_V", {"Potential (V)": OWN, "Voltage (V)": OWN}, required=True),
        Channel("temperature_C", {"Temperature (°C)": OWN, "Temperature (C)": OWN}),
        Channel("step", {"Step Number": OWN}),
    ),
    known=(
        *("Date and Time", "Cycle Number", "Step Type", "Step Time (h)", "Capacity (Ah)"),
        *("Circuit Temperature (°C)", "Energy (Wh)", "dVdt (I/h)", "dIdt (V/h)", "dVdt (V/h)"),
        *("dIdt (A/h)", "Step position", "Power(W)", "Power (W)"),
    ),
    read=read_csv,
    sign="charge-positive",
)
