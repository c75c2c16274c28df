"""Maccor text exports: a state (``C``, ``D``, ``R``) signs the current, or states its sign."""

from __future__ import annotations

from cellwise.logs.files.columns import CLOCK, MILLI, OWN, Channel, Unit
from cellwise.logs.files.csv_layout import has_names
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.text_cells import labels

# Charge, discharge, rest, pause, suspend, end, open circuit, internal resistance, auxiliary.
_STATE = labels(C=-1.0, D=1.0, R=0.0, P=0.0, S=0.0, E=0.0, O=0.0, I=0.0, A=0.0)

MACCOR_TEXT = Format(
    name="maccor-text",
    matches=lambda source: has_names(
        source,
        ("Rec#", "Rec", "RecNum"),
        ("Amps", "mAmps", "Current [A]", "Current", "Current [mA]"),
    ),
    channels=(
        Channel(
            "time_s",
            {
                "Test (Sec)": OWN,
                "TestTime": CLOCK,  # also Test Time
                "Test (Min)": Unit(60.0),
                "Test (Hrs)": Unit(3600.0),
                "TestTime(s)": OWN,
                "Test Time (sec)": OWN,
                "TestTime(h)": Unit(3600.0),
            },
            required=True,
        ),
        Channel(
            "current_A",
            {"Amps": OWN, "Current [A]": OWN, "Current": OWN, "Current (A)": OWN}
            | {"mAmps": MILLI, "Current [mA]": MILLI},
            required=True,
        ),
        Channel(
            "voltage_V",
            {"Volts": OWN, "Voltage [V]": OWN, "Voltage": OWN, "Voltage (V)": OWN},
            required=True,
        ),
        Channel(
            "temperature_C",
            {"Temp 1": OWN, "Temp 1 [C]": OWN, "Temp1": OWN, "EVTemp (C)": OWN, "EV Temp": OWN}
            | {"Temperature": OWN, "Temperature [C]": OWN, "Temp 1 (C)": OWN},
        ),
        Channel(
            "moved_Ah",
            {"Amp-hr": OWN, "Cap. [Ah]": OWN, "Capacity": OWN, "Capacity (Ah)": OWN}
            | {"mAmp-hr": MILLI, "Cap. [mAh]": MILLI, "Capacity [Ah]": OWN},
        ),
        Channel("step", {"Step": OWN}),
        Channel("direction", {"State": _STATE, "Md": _STATE}),
    ),
    known=(
        *("Rec#", "Rec", "RecNum", "Cyc#", "Cycle", "Cycle P", "Cycle C", "Step (Sec)"),
        *(
            "StepTime",
            "Step (Min)",
            "Step (Hrs)",
            "StepTime(s)",
            "Watt-hr",
            "mWatt-hr",
            "Ener. [Wh]",
        ),
        *("Energy", "Energy (Wh)", "ES", "DPt Time", "ACR", "DCIR", "ACImp/Ohms", "ACR [Ohm]"),
        *("DCIR [Ohm]", "Power", "Loop1", "Loop2", "Loop3", "Loop4", "Chamber Temp", "Watt"),
        *("Temp 2", "Temp 3", "Humidity", "Pressure", "VAR1", "GlobFlags", "AC Phase", "Aux #1"),
        *("Units", "DCIR/Ohms", "WF Chg Cap", "WF Dis Cap", "WF Chg E", "WF Dis E", "Range"),
        "Step Time (sec)",
    ),
    read=read_csv,
    sign="discharge-positive",
)
