"""A stream for people: one panel on the terminal that changes as samples come."""

from __future__ import annotations

import math
import time
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table

from cellwise.cell.plausibility.notice import FarOffStream, withheld
from cellwise.estimate.power.along import PowerFollower
from cellwise.estimate.status import Status
from cellwise.forecast.outlook import ForecastNow, Outlook
from cellwise.live import Counts, LiveFilter, Update

if TYPE_CHECKING:
    from cellwise.live.samples import Source

REFRESH_S = 0.25
SILENT_S = 2.0


class LiveView:
    """Draws at most four times a second, however fast samples come."""

    def __init__(
        self,
        source: Source,
        live: LiveFilter,
        outlook: Outlook,
        console: Console | None = None,
        power: PowerFollower | None = None,
        far: FarOffStream | None = None,
    ) -> None:
        self._source, self._filter, self._outlook = source, live, outlook
        self._power, self._far = power, far
        self._live = Live(console=console or Console(), auto_refresh=False, transient=False)
        self._drawn_s = -math.inf
        self._seen = 0
        self._counts: Counts | None = None
        self._heard_s = time.monotonic()

    def __enter__(self) -> LiveView:
        self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._counts is not None:
            self._live.update(self.panel(self._counts))
        self._live.stop()

    def look(self, counts: Counts) -> None:
        """Draw if it is time."""
        now_s = time.monotonic()
        self._counts = counts
        if counts.samples != self._seen:
            self._heard_s, self._seen = now_s, counts.samples
        if now_s - self._drawn_s < REFRESH_S:
            return
        self._drawn_s = now_s
        self._live.update(self.panel(counts, now_s - self._heard_s), refresh=True)

    def panel(self, counts: Counts, silent_s: float = 0.0) -> Panel:
        """What stands on the terminal."""
        last = counts.last
        if last is None:
            text = f"waiting for samples ({sum(counts.stray.values())} not readable)"
            return Panel(text, title=self._source.name)
        title = self._source.name
        if silent_s > SILENT_S:
            title = f"nothing for {silent_s:.0f} s | {title}"
        grid = Table.grid(padding=(0, 2))
        grid.add_column(justify="right", style="bold")
        grid.add_column()
        soc = last.info.soc
        bar = ProgressBar(total=1.0, completed=min(max(soc, 0.0), 1.0), width=40)
        grid.add_row("SOC", f"{100 * soc:.2f} % +- {200 * last.info.soc_std:.2f}")
        grid.add_row("", bar)
        if self._far_off is not None:
            grid.add_row("far off", withheld(self._far_off))
        for name, text in self._rows(last, counts):
            grid.add_row(name, text)
        return Panel(grid, title=title, width=72)

    def _rows(self, last: Update, counts: Counts) -> list[tuple[str, str]]:
        sample, info = last.sample, last.info
        warm = sample.temperature_C
        flags = ", ".join(str(bit.name).lower() for bit in Status(info.status)) or "-"
        latency = counts.latency.to_dict()
        return [
            ("current", f"{_number(sample.current_A, 3)} A"),
            (
                "voltage",
                f"{_number(sample.voltage_V, 4)} V measured, {_number(info.voltage_V, 4)} expected",
            ),
            ("temperature", f"{_number(warm, 1)} degC"),
            *self._foreseen_rows(warm if warm == warm else 25.0),
            ("flags", flags),
            (
                "stream",
                f"{counts.samples:,} samples, {counts.gaps} gap(s), {counts.late} late, "
                f"{sum(counts.stray.values())} not readable",
            ),
            (
                "latency",
                f"{latency['p50_ms']:.2f} ms, 99 % {latency['p99_ms']:.2f} ms, "
                f"{latency['missed_deadlines']} too late",
            ),
        ]

    @property
    def _far_off(self) -> str | None:
        return None if self._far is None else self._far.text

    def _foreseen_rows(self, temperature_C: float) -> list[tuple[str, str]]:
        if self._far_off is not None:
            return []
        now = self._outlook.forecast(self._filter.state, temperature_C)
        return [
            ("remaining", _remaining(now)),
            *self._charge_rows(temperature_C),
            *self._power_rows(temperature_C),
            *self._cell_rows(),
        ]

    def _cell_rows(self) -> list[tuple[str, str]]:
        found = {} if self._filter.pack is None else self._filter.pack.columns().get("cells", {})
        if not found:
            return []
        soc, ohm = found["soc"], found["resistance_scale"]
        empty, full, weak = soc.index(min(soc)), soc.index(max(soc)), ohm.index(max(ohm))
        return [
            (
                "cells",
                f"emptiest {empty + 1} ({100 * soc[empty]:.1f} %), fullest {full + 1} "
                f"({100 * soc[full]:.1f} %), resistance of {weak + 1} {ohm[weak]:.2f}",
            )
        ]

    def _charge_rows(self, temperature_C: float) -> list[tuple[str, str]]:
        now = self._outlook.to_full(self._filter.state, temperature_C)
        return [] if now is None else [("to full", _remaining(now))]

    def _power_rows(self, temperature_C: float) -> list[tuple[str, str]]:
        if self._power is None:
            return []
        now = self._power.now(self._filter.state, temperature_C)
        return [
            (
                f"power {s.horizon_s:g} s",
                f"{s.discharge.power_W:.1f} W out (at least {s.discharge.power_low_W:.1f}), "
                f"{s.charge.power_W:.1f} W in (at least {s.charge.power_low_W:.1f})",
            )
            for s in now
        ]


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _remaining(now: ForecastNow | None) -> str:
    if now is None:
        return "no load"
    low, high = now.remaining_s_band

    def minutes(seconds: float) -> str:
        return f"{seconds / 60:.1f}" if math.isfinite(seconds) else "-"

    return (
        f"{minutes(now.remaining_s)} min ({minutes(low)} to {minutes(high)}), "
        f"{now.remaining_Wh:.2f} Wh at {now.load_A:.2f} A"
    )
