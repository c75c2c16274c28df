"""Battery Data Format (Battery Data Alliance), text and parquet: charge positive, fixed units."""

from __future__ import annotations

from cellwise.logs.files.columns import MILLI, OWN, TURNED, Channel, Unit
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.parquet_file import parquet_has, read_parquet

# Every quantity has a label for people and a name for machines.
_VOLTAGE = {"Voltage / V": OWN, "voltage_volt": OWN}
_CURRENT = {"Current / A": OWN, "current_ampere": OWN}
_TIME = {
    "Test Time / s": OWN,
    "test_time_second": OWN,
    "Unix Time / s": OWN,
    "unix_time_second": OWN,
    # The format has seconds; other programs write these.
    "Test Time / min": Unit(60.0),
    "Test Time / h": Unit(3600.0),
    "Test Time / ms": MILLI,
}
_SIGNATURE = (tuple(_VOLTAGE), tuple(_CURRENT))

_CHANNELS = (
    Channel("time_s", _TIME, required=True),
    Channel("current_A", _CURRENT, required=True),
    Channel("voltage_V", _VOLTAGE, required=True),
    Channel(
        "temperature_C",
        {
            "Surface Temperature T1 / degC": OWN,
            "temperature_t1_celsius": OWN,
            "Surface Temperature / degC": OWN,
            "surface_temperature_celsius": OWN,
            "Temperature T1 / degC": OWN,
            "Ambient Temperature / degC": OWN,
            "ambient_temperature_celsius": OWN,
        },
    ),
    Channel("charge_Ah", {"Net Capacity / Ah": TURNED, "net_capacity_ah": TURNED}),
    Channel(
        "charged_Ah",
        dict.fromkeys(
            ("Charging Capacity / Ah", "charging_capacity_ah", "Charge Capacity / Ah"), OWN
        ),
    ),
    Channel(
        "discharged_Ah",
        dict.fromkeys(
            ("Discharging Capacity / Ah", "discharging_capacity_ah", "Discharge Capacity / Ah"), OWN
        ),
    ),
    Channel("step", {"Step Count / 1": OWN, "step_count": OWN, "Step Index / 1": OWN}),
)
_KNOWN = (
    *("Cycle Count / 1", "cycle_count", "Step Index / 1", "step_index", "Step Capacity / Ah"),
    *("step_capacity_ah", "Cumulative Capacity / Ah", "cumulative_capacity_ah", "Power / W"),
    *("power_watt", "Charging Energy / Wh", "charging_energy_wh", "Discharging Energy / Wh"),
    *("discharging_energy_wh", "Step Energy / Wh", "step_energy_wh", "Net Energy / Wh"),
    *("net_energy_wh", "Cumulative Energy / Wh", "cumulative_energy_wh"),
    *("Internal Resistance / Ohm", "internal_resistance_ohm", "Ambient Pressure / Pa"),
    *("ambient_pressure_pa", "Applied Pressure / Pa", "applied_pressure_pa", "Step Time / s"),
    *("step_time_second", "Date Time ISO", "date_time_iso", "Step Type", "step_type"),
    *("Step Type / 1", "Protocol Name / 1"),
    *(f"Surface Temperature T{k} / degC" for k in range(2, 6)),
    *(f"temperature_t{k}_celsius" for k in range(2, 6)),
)

BDF_PARQUET = Format(
    name="bdf-parquet",
    matches=lambda source: parquet_has(source, *_SIGNATURE),
    channels=_CHANNELS,
    known=_KNOWN,
    read=read_parquet,
    sign="charge-positive",
)

BDF_CSV = Format(
    name="bdf-csv",
    matches=lambda source: has_names(source, *_SIGNATURE),
    channels=_CHANNELS,
    known=_KNOWN,
    read=read_csv,
    sign="charge-positive",
)
