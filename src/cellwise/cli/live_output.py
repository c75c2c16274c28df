"""What is said of a stream: JSON lines, a panel on the terminal, a notice where it is due."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

from rich.console import Console
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table

from cellwise.cell.plausibility.notice import FarOffStream, outside_moment, withheld
from cellwise.cli.common import printing
from cellwise.estimate.power.along import PowerFollower
from cellwise.estimate.sensing_kernels import Reading
from cellwise.estimate.status import Status
from cellwise.forecast.display import Displayed
from cellwise.forecast.outlook import Outlook
from cellwise.live import Counts, LiveFilter, Update

FORECAST_EVERY_S = 1.0
REFRESH_S = 0.25  # of the panel
SILENT_S = 2.0  # after which the panel says that nothing comes


@dataclass
class Followed:
    """A filter on a stream, and what follows it: time and energy left, power, a percentage."""

    live: LiveFilter
    outlook: Outlook
    power: PowerFollower | None = None
    displayed: Displayed | None = None
    far: FarOffStream | None = None
    percent: float = math.nan
    since_expected_s: float = math.inf

    def take(self, update: Update) -> None:
        """Hand a sample on to what follows the filter."""
        self.outlook.take(update)
        sample, info, state = update.sample, update.info, self.live.state
        if self.far is not None:
            known_C = self.live.known_temperature_C(sample)
            self.far.look(update.dt_s, info.innovation_V, info.soc, info.voltage_V, known_C)
        warm = self._temperature_C(update)
        if self.displayed is not None:
            self.since_expected_s += update.dt_s
            if self.since_expected_s >= FORECAST_EVERY_S:
                self.since_expected_s = 0.0
                self.displayed.expect(*self.outlook.end_socs(state, warm))
            dt_s = 0.0 if update.gap else update.dt_s
            self.percent = self.displayed.take(info.soc, sample.current_A, sample.voltage_V, dt_s)
        if self.power is not None and state is not None:
            reading = Reading(sample.current_A, sample.voltage_V, warm, update.dt_s, update.gap)
            self.power.take(reading, state, info.status)

    @property
    def far_off(self) -> str | None:
        """What is said of a stream that is far off its model; then nothing is foreseen."""
        return None if self.far is None or self.far.text is None else withheld(self.far.text)

    def columns(self, update: Update) -> dict[str, Any]:
        """Time and energy to empty, power if it is asked for, the cells of a pack: for JSON."""
        state, warm = self.live.state, self._temperature_C(update)
        foreseen = self.outlook.columns(state, warm)
        foreseen |= {} if self.power is None else self.power.columns(state, warm)
        cells = {} if self.live.pack is None else self.live.pack.columns()
        if self.far_off is not None:
            foreseen = dict.fromkeys(foreseen)
            cells = {k: {n: c[n] for n in ("soc", "soc_std")} for k, c in cells.items()}
        shown = {} if self.displayed is None else {"displayed_percent": self.percent}
        return foreseen | shown | cells

    def row(self, update: Update) -> dict[str, Any]:
        """All that is known after a sample, for whoever is sent it."""
        warm = self.live.known_temperature_C(update.sample)
        return state_row(update) | {"temperature_C": warm} | self.columns(update)

    def outside(self, update: Update) -> str | None:
        """That a sample lies outside what the model's data covered, and where; else None."""
        sample, info, model = update.sample, update.info, self.live.model
        if not info.status & Status.OUTSIDE:
            return None
        warm = self.live.known_temperature_C(sample)
        where = outside_moment(model.validity, info.soc, warm, sample.current_A)
        if where is None:
            return None
        grows = "not validated there, the standard deviation grows"
        return f"at {sample.time_s:.1f} s {where}: {grows}"

    def _temperature_C(self, update: Update) -> float:
        """The sample's temperature, else the model's."""
        measured = self.live.known_temperature_C(update.sample)
        return measured if math.isfinite(measured) else self.live.model.usual_temperature_C


def state_row(update: Update) -> dict[str, Any]:
    """An update as values for JSON; what the filter predicts beside what was measured."""
    sample, info = update.sample, update.info
    return {
        "time_s": sample.time_s,
        "soc": info.soc,
        "soc_std": info.soc_std,
        "current_A": sample.current_A,
        "measured_voltage_V": sample.voltage_V,
        "voltage_V": info.voltage_V,
        "innovation_V": info.innovation_V,
        "test_ratio": info.test_ratio,
        "status": info.status,
        "flags": [bit.name for bit in Status(info.status)] if info.status else [],
    }


class LineWriter:
    """One JSON object per update, at most one in ``every_s`` of the stream's time."""

    def __init__(self, file: IO[str], followed: Followed, every_s: float = 0.0) -> None:
        self._file, self._followed, self._every_s = file, followed, every_s
        self._waited_s = self._since_forecast_s = math.inf

    def __call__(self, update: Update) -> None:
        """Write a line if it is time."""
        self._waited_s += update.dt_s
        self._since_forecast_s += update.dt_s
        if self._waited_s < self._every_s * (1.0 - 1e-9):
            return
        self._waited_s = 0.0
        row = state_row(update)
        if self._since_forecast_s >= FORECAST_EVERY_S:
            self._since_forecast_s = 0.0
            row |= self._followed.columns(update)
        self._file.write(json.dumps(printing.clean(row), allow_nan=False) + "\n")
        self._file.flush()


def warned_once(what: Callable[[Update], str | None]) -> Callable[[Update], None]:
    """Says on standard error, once, what comes true of a stream."""
    said = False

    def take(update: Update) -> None:
        nonlocal said
        if not said and (text := what(update)) is not None:
            said = True
            printing.warn(f"cellwise live: {text}")

    return take


@contextmanager
def live_panel(
    name: str, followed: Followed, console: Console | None = None
) -> Iterator[Callable[[Counts], None]]:
    """A panel that is drawn at most four times a second, and what it is shown the counts by."""
    seen, latest = 0, None
    drawn_s, heard_s = -math.inf, time.monotonic()
    with Live(console=console or Console(), auto_refresh=False) as shown:

        def look(counts: Counts) -> None:
            nonlocal seen, latest, drawn_s, heard_s
            now_s, latest = time.monotonic(), counts
            if counts.samples != seen:
                heard_s, seen = now_s, counts.samples
            if now_s - drawn_s >= REFRESH_S:
                drawn_s = now_s
                shown.update(panel(name, followed, counts, now_s - heard_s), refresh=True)

        try:
            yield look
        finally:
            if latest is not None:
                shown.update(panel(name, followed, latest))


def panel(name: str, followed: Followed, counts: Counts, silent_s: float = 0.0) -> Panel:
    """What stands on the terminal: the state, and all that a line of JSON would say beside it."""
    last, stray = counts.last, sum(counts.stray.values())
    if last is None:
        return Panel(f"waiting for samples ({stray} not readable)", title=name)
    row, late = followed.row(last), counts.latency.to_dict()
    said = {} if followed.far_off is None else {"far off": followed.far_off}
    said |= {
        "current": f"{row['current_A']:.3f} A",
        "voltage": f"{row['measured_voltage_V']:.4f} V, {row['voltage_V']:.4f} expected",
        "temperature": f"{row['temperature_C']:.1f} degC",
        "flags": ", ".join(row["flags"]).lower() or "-",
    }
    foreseen = followed.columns(last)
    for key, value in foreseen.items():
        label = key.replace("_", " ")
        if key == "cells":
            said[label] = f"SOC {100 * min(value['soc']):.1f} to {100 * max(value['soc']):.1f} %"
        elif key.endswith("_s") and value is not None:
            low, high = foreseen[f"{key}_band"]
            minutes = f"{value / 60:.1f} min ({low / 60:.1f} to {high / 60:.1f})"
            said[label.removesuffix(" s")] = minutes
        elif isinstance(value, float):
            said[label] = f"{value:.3g}"
    said["stream"] = (
        f"{counts.samples:,} samples, {counts.gaps} gap(s), {counts.late} late, "
        f"{stray} not readable"
    )
    said["latency"] = f"{late['p50_ms']:.2f} ms, 99 % {late['p99_ms']:.2f} ms"
    grid = Table.grid(padding=(0, 2))
    grid.add_column(justify="right", style="bold")
    grid.add_row("SOC", f"{100 * row['soc']:.2f} % +- {200 * row['soc_std']:.2f}")
    grid.add_row("", ProgressBar(total=1.0, completed=min(max(row["soc"], 0.0), 1.0), width=40))
    for label, text in said.items():
        grid.add_row(label, text)
    silent = f"nothing for {silent_s:.0f} s | " if silent_s > SILENT_S else ""
    return Panel(grid, title=silent + name, width=72)
