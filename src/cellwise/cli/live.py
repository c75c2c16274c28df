"""A stream of samples, followed as they come.

cellwise live: a stream of samples to SOC, as they come
    requires a model and a source of samples
    $ live --model cell.json --source stdin < samples.csv
    $ live --model cell.json --source can:can0 --dbc pack.dbc --state soc.state
<scaled model>
    --source FROM!  stdin (JSON lines or CSV), json:FILE, csv:FILE, can:INTERFACE:CHANNEL,
        ulog:FILE (- for stdin), mavlink:LINK, mqtt://HOST/TOPIC, ble:DEVICE; json:FILE@soc0=1
        says how it begins
    --follow  wait for more at a file's end
    --estimator E=ekf  ekf or ukf
<start>
<start std>
<sensor>
    --state FILE  goes on where FILE says, and keeps it there
    --fresh  start again, whatever FILE says
    --save-every S=10  seconds
    -o, --output OUT  JSON lines, added at the end of OUT
    --every S=0  at most one line in S seconds
    --view  a view instead of lines [on a terminal]
    --send TO  state to others: MESSAGE.SIGNAL of the CAN bus, mavlink:LINK, mqtt://HOST/PACK
    --send-every S  seconds [1; on a CAN bus 0.1]
    --load W  how long, too, at a load of W watts in each cell
<ahead>
    --cells N=0  follow N cells in series, each by itself
    --deadline-ms MS  [the sample's interval]
    --samples N  stop after N samples
    --idle S  stop when nothing came for S seconds
<stream options>
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

from rich.console import Console
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table

from cellwise.cell.model import CellModel
from cellwise.cli.common import forecast_options, log_options, options, printing
from cellwise.errors import InputError
from cellwise.estimate.sensor import assumed_text, seen_by
from cellwise.live import Counts, Update
from cellwise.live.followed import FORECAST_EVERY_S, FollowedFilter, state_row
from cellwise.workflows.following import FollowedStream, FollowRequest, Taker, follow_stream

REFRESH_S = 0.25  # of the panel
SILENT_S = 2.0  # after which the panel says that nothing comes


def run_live(arguments: argparse.Namespace) -> None:
    """Follow a stream: JSON lines, a view for people, or one object at the end."""
    _check(arguments)
    ahead = forecast_options.ahead_of(arguments)
    reading, model = log_options.read_options(arguments), options.read_model(arguments)
    stream = follow_stream(model, arguments.source, asked_of(model, arguments), ahead, reading)
    for notice in stream.notices:
        printing.warn(f"cellwise live: {notice.rendered(printing.in_command)}")
    viewed = arguments.view or (sys.stdout.isatty() and not arguments.json)
    with ExitStack() as stack:
        stack.callback(stream.source.close)
        takers, look = _takers(stream, arguments, stack, viewed=viewed)
        stack.enter_context(_stopped_by_signal())
        end = stream.run(
            takers,
            look=look,
            save_every_s=arguments.save_every,
            most_samples=arguments.samples,
            idle_s=arguments.idle,
        )
    if arguments.json:
        printing.print_json({**end, "far_off": mismatch_of(stream.followed)})
    elif viewed or arguments.output:
        _print_end(stream, end)


def asked_of(model: CellModel, arguments: argparse.Namespace) -> FollowRequest:
    """How the arguments ask for a stream to be followed."""
    sensor, deadline = options.sensor_of(arguments), arguments.deadline_ms
    return FollowRequest(
        arguments.estimator,
        soc0=options.soc0_of(arguments),
        soc0_std=arguments.soc0_std,
        cells=arguments.cells,
        sensor=sensor,
        power=forecast_options.power_of(arguments, seen_by(model, sensor).model),
        sign=arguments.sign,
        state=arguments.state,
        fresh=arguments.fresh,
        waits=arguments.follow,
        deadline_s=None if deadline is None else 1e-3 * deadline,
    )


def _takers(
    stream: FollowedStream, arguments: argparse.Namespace, stack: ExitStack, *, viewed: bool
) -> tuple[list[Taker], Callable[[Counts], None] | None]:
    """Who gets every update, and what shows the counts; ``stack`` ends them."""
    takers: list[Taker] = []
    look, followed = None, stream.followed
    if arguments.send:
        taker, close = stream.sender(arguments.send, arguments.send_every)
        stack.callback(close)
        takers.append(taker)
    if arguments.output:
        file = stack.enter_context(_appended(Path(arguments.output)))
        takers.append(LineWriter(file, followed, arguments.every))
    if viewed:
        look = stack.enter_context(live_panel(stream.source.name, followed))
    elif not (arguments.output or arguments.json):
        takers.append(LineWriter(sys.stdout, followed, arguments.every))
    takers.append(warned_once(lambda _: getattr(stream.source, "note", None)))
    if not viewed:  # the panel shows both
        takers.append(warned_once(followed.outside))
        takers.append(warned_once(lambda _: mismatch_of(followed)))
    return takers, look


def _check(arguments: argparse.Namespace) -> None:
    options.check_places(arguments.output, arguments.state)
    for option in ("save_every", "every", "send_every", "deadline_ms", "samples", "idle"):
        value = getattr(arguments, option)
        if value is not None and not 0.0 <= value < 1e9:
            name = "--" + option.replace("_", "-")
            raise InputError(f"{name} {value:g}", "a number of at least 0", "Correct it.")


@contextmanager
def _stopped_by_signal() -> Iterator[None]:
    """A service manager's way to stop a program, and Ctrl-C, are the usual end of a stream."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    stops = (signal.SIGTERM, signal.SIGINT)
    before = [signal.signal(number, signal.default_int_handler) for number in stops]
    try:
        yield
    finally:
        for number, handler in zip(stops, before, strict=True):
            signal.signal(number, handler)


@contextmanager
def _appended(place: Path) -> Iterator[IO[str]]:
    with place.open("a", encoding="utf-8") as file:
        yield file


def _print_end(stream: FollowedStream, end: dict[str, Any]) -> None:
    """The end of a stream for people."""
    counts, followed = stream.counts, stream.followed
    if not end:
        return
    slow, start = end["latency"], end["soc0"]
    printing.say_notices(filter(None, [followed.model_mismatch]))
    printing.say(
        f"{counts.samples:,} samples, SOC {end['soc']:.4f} +- {2 * end['soc_std']:.4f} "
        f"(start {start['value']:.4f} +- {2 * start['std']:.4f}, {start['how']}); "
        f"{counts.gaps} gap(s), {counts.late} late, {sum(counts.stray.values())} not readable, "
        f"{counts.outside} outside the model's data; latency {slow['p50_ms']:.3f} ms, 99 % "
        f"{slow['p99_ms']:.3f} ms, {slow['missed_deadlines']} too late"
    )
    if end["sensor"]["by_default"]:
        printing.say(assumed_text(end["sensor"]))


def mismatch_of(followed: FollowedFilter) -> str | None:
    """Why nothing is foreseen, in a command's words; None where something is."""
    mismatch = followed.model_mismatch
    return None if mismatch is None else mismatch.rendered(printing.in_command)


class LineWriter:
    """One JSON object per update, at most one in ``every_s`` of the stream's time."""

    def __init__(self, file: IO[str], followed: FollowedFilter, every_s: float = 0.0) -> None:
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
    name: str, followed: FollowedFilter, console: Console | None = None
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


def panel(name: str, followed: FollowedFilter, counts: Counts, silent_s: float = 0.0) -> Panel:
    """What stands on the terminal: the state, and all that a line of JSON would say beside it."""
    last, stray = counts.last, sum(counts.stray.values())
    if last is None:
        return Panel(f"waiting for samples ({stray} not readable)", title=name)
    row, late = followed.row(last), counts.latency.to_dict()
    mismatch = mismatch_of(followed)
    said = {} if mismatch is None else {"far off": mismatch}
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
