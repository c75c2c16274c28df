"""Small logs with a known truth, and their text, for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

R0_OHM = 0.03
CAPACITY_AH = 3.0


def pulse_channels(seconds: int = 1200, dt: float = 1.0) -> dict[str, np.ndarray]:
    """Rest, pulses of both directions and net discharge of a cell with R0 and a linear OCV.

    The counter is exact: the current of a row flows during the interval that ends there.
    """
    time = np.arange(0.0, seconds, dt)
    period = time % 300.0
    current = np.where((period >= 100) & (period < 160), 3.0, 0.0)
    current = np.where((period >= 200) & (period < 220), -1.5, current)
    charge = np.cumsum(current * np.diff(time, prepend=time[0])) / 3600.0
    voltage = 4.1 - 0.8 * charge / CAPACITY_AH - R0_OHM * current
    return {
        "time_s": time,
        "current_A": current,
        "voltage_V": voltage,
        "temperature_C": np.full(time.size, 25.0),
        "ampere_hours": charge,
    }


def csv_text(columns: dict[str, np.ndarray], sep: str = ",") -> str:
    """Columns as CSV text with every digit."""
    rows = zip(*(np.asarray(c, dtype=float).tolist() for c in columns.values()), strict=True)
    lines = [sep.join(columns), *(sep.join(repr(x) for x in row) for row in rows)]
    return "\n".join(lines) + "\n"


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> Path:
    path.write_text(csv_text(columns))
    return path
