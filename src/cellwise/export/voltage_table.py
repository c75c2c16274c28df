"""A table of remaining time over voltage for boards without a current sensor: C, CSV, JSON.

And in the forms of firmware that has a place for such a table, each as its documentation has it in
November 2026; all three expect eleven voltages or pairs of numbers, and know no band.
"""

from __future__ import annotations

import json
from pathlib import Path

from cellwise.export.c_tables import put
from cellwise.export.package import check_folder
from cellwise.files import made_folder
from cellwise.identify.ocv.voltage_only import UNKNOWN, VoltageTable

TENTHS = 11
SOURCES = {
    "zephyr.overlay": "https://docs.zephyrproject.org/latest/build/dts/api/bindings/fuel-gauge/"
    "zephyr,fuel-gauge-composite.html",
    "meshtastic_variant.h": "https://github.com/meshtastic/firmware/blob/master/src/power.h",
    "esphome.yaml": "https://esphome.io/components/sensor/filter/calibrate_linear/",
}


def write_voltage_forms(table: VoltageTable, folder: str | Path) -> list[str]:
    """Write a table in every form into a folder; the names of the files.

    Raises
    ------
    InputError        a folder that is in use
    """
    check_folder(Path(folder))
    files = voltage_forms(table)
    put(files, made_folder(folder, "the table"))
    return list(files)


def voltage_forms(table: VoltageTable) -> dict[str, str]:
    """The files, by name."""
    tenths = [round(1000.0 * v) for v in table.points(TENTHS)]
    pairs = zip(tenths, range(0, 101, 10), strict=True)
    about = {name: f"As {place} describes it." for name, place in SOURCES.items()}
    whose = f"Of {len(table.hours)} discharges; written by `cellwise export`."
    micro = " ".join(f"{v}000" for v in tenths)
    rows = zip(table.remaining, table.voltage_V, table.low, table.high, strict=True)
    return {
        "battery_table.h": _c_table(table),
        "battery_table.csv": "remaining,voltage_V,low,high\n"
        + "".join(f"{r:.4f},{v:.4f},{a:.4f},{b:.4f}\n" for r, v, a, b in rows),
        "battery_table.json": json.dumps(table.to_dict(), indent=1) + "\n",
        # Microvolts from empty to full.
        "zephyr.overlay": f"/* {about['zephyr.overlay']}\n   {whose} */\n"
        f"&fuel_gauge {{\n    ocv-capacity-table-0 = <{micro}>;\n}};\n",
        # Millivolts of one cell from full to empty.
        "meshtastic_variant.h": f"/* {about['meshtastic_variant.h']}\n   {whose} */\n"
        f"#define NUM_OCV_POINTS {TENTHS}\n"
        f"#define OCV_ARRAY {', '.join(map(str, reversed(tenths)))}\n",
        # Volts to per cent, connected by straight lines, which go on beyond the ends.
        "esphome.yaml": f"# {about['esphome.yaml']}\n# {whose}\nfilters:\n"
        "  - calibrate_linear:\n      method: exact\n      datapoints:\n"
        + "".join(f"        - {v / 1000.0:.3f} -> {p}\n" for v, p in pairs)
        + "  - clamp:\n      min_value: 0\n      max_value: 100\n",
    }


def _c_table(table: VoltageTable) -> str:
    count = table.remaining.size
    columns = {
        "uint16_t battery_table_mV": table.points(count),
        "uint16_t battery_table_low": table.low,
        "uint16_t battery_table_high": table.high,
    }
    arrays = [
        f"static const {name}[BATTERY_TABLE_POINTS] = {{"
        + ", ".join(str(round(1000.0 * v)) for v in values)
        + "};"
        for name, values in columns.items()
    ]
    full, empty = (f"{v:.3f}" for v in (table.full_V, table.empty_V))
    unknown = "\n".join(f"   - {text}" for text in UNKNOWN)
    return f"""/* Written by `cellwise export`; do not edit.
   Remaining running time at the usual load, by the voltage of one cell averaged over
   {table.average_s:g} s, of {len(table.hours)} discharges from {full} to {empty} V.
   Points are even from empty to full; the band holds 95 %. What the table cannot know:
{unknown} */
#ifndef BATTERY_TABLE_H
#define BATTERY_TABLE_H

#include <stdint.h>

#define BATTERY_TABLE_POINTS {count}u
/* millivolt, rising; ends of the band in thousandths */
{chr(10).join(arrays)}

/* Thousandths that remain, 0 to 1000; `low` and `high` take the ends of its band. */
static inline uint16_t battery_remaining(uint16_t millivolt, uint16_t *low, uint16_t *high)
{{
    const uint32_t last = BATTERY_TABLE_POINTS - 1u;
    uint32_t k = 0u, part = 0u, width = 1u;
    if (millivolt >= battery_table_mV[last]) {{
        k = last;
    }} else if (millivolt > battery_table_mV[0]) {{
        while (millivolt >= battery_table_mV[k + 1u]) {{
            k++;
        }}
        width = (uint32_t)battery_table_mV[k + 1u] - battery_table_mV[k];
        part = (uint32_t)millivolt - battery_table_mV[k];
    }}
    const uint32_t next = k < last ? k + 1u : last;
    const uint32_t left = width - part;
    *low = (uint16_t)((battery_table_low[k] * left + battery_table_low[next] * part) / width);
    *high = (uint16_t)((battery_table_high[k] * left + battery_table_high[next] * part) / width);
    return (uint16_t)((1000u * (k * width + part)) / (last * width));
}}

#endif
"""
