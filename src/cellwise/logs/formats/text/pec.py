"""PEC CSV: ``Total Time`` in a unit or as a clock, two counters, charge positive or unsigned."""

from __future__ import annotations

from cellwise.logs.files.columns import CLOCK, MILLI, OWN, Channel, Unit
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format

_TIME = {
    "Total Time (Seconds)": OWN,
    "Total Time (Minutes)": Unit(60.0),
    "Total Time (Hours)": Unit(3600.0),
    "Total Time (Hours in hh:mm:ss.xxx)": CLOCK,
}

PEC_CSV = Format(
    name="pec-csv",
    matches=lambda source: has_names(
        source, tuple(_TIME), ("Voltage (mV)", "Voltage (V)"), ("Current (mA)", "Current (A)")
    ),
    channels=(
        Channel("time_s", _TIME, required=True),
        Channel("current_A", {"Current (A)": OWN, "Current (mA)": MILLI}, required=True),
        Channel("voltage_V", {"Voltage (V)": OWN, "Voltage (mV)": MILLI}, required=True),
        Channel(
            "temperature_C",
            {"Temperature (°C)": OWN, "Temperature (C)": OWN, "Temperature 1 (°C)": OWN}
            | {"Temp (°C)": OWN, "Temp (C)": OWN},
        ),
        Channel("charged_Ah", {"Charge Capacity (Ah)": OWN, "Charge Capacity (mAh)": MILLI}),
        Channel(
            "discharged_Ah", {"Discharge Capacity (Ah)": OWN, "Discharge Capacity (mAh)": MILLI}
        ),
        Channel("step", {"Step": OWN}),
    ),
    known=(
        *("Test", "Cell", "Rack", "Shelf", "Position", "Cell ID", "Load On time", "Real Time"),
        *("Step Time (Seconds)", "Step Time (Minutes)", "Step Time (Hours)", "Cycle"),
        *("Charge Energy (Wh)", "Discharge Energy (Wh)", "Charge Energy (mWh)"),
        *("Discharge Energy (mWh)", "Internal Resistance 1 (mOhm)", "ReasonCode", "Data Point"),
        *("Load On Time (Hours in hh:mm:ss.xxx)", "Cycle Charge Time (Hours in hh:mm:ss.xxx)"),
        *("Cycle Discharge Time (Hours in hh:mm:ss.xxx)", "Position Start Time"),
        *("Instruction Name", "Station Temperature (°C)", "Coulombic Efficiency"),
        *("Charge Energy Density (Wh/kg)", "Discharge Energy Density (Wh/kg)"),
        *("50% DoD (mV)", "50% DoD vs CRate (mV)", "PeakPower 1 (W)"),
        "Open Circuit Voltage 1 (mV)",
    ),
    read=read_csv,
    sign="charge-positive",
)
