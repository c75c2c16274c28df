"""A stream of samples, followed as they come.

cellwise live: a stream of samples to SOC, as they come
    requires a model and a source of samples
    $ live --model cell.json --source stdin < samples.csv
    $ live --model cell.json --source can:can0 --dbc pack.dbc --state soc.state
<scaled model>
    --source FROM!  stdin (JSON lines), json:FILE, can:INTERFACE:CHANNEL, ulog:FILE (- for stdin),
        mavlink:LINK, mqtt://HOST/TOPIC, ble:DEVICE; json:FILE@soc0=1 says how it begins
    --follow  wait for more at a file's end
    --estimator E=ekf  ekf or ukf
<start>
<start std>
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
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from cellwise.cell.initial_soc.initial_soc import STATED_STD
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import FarOffStream
from cellwise.cli.common import forecast_options, log_options, options, printing
from cellwise.cli.live_output import Followed, LineWriter, live_panel, state_row, warned_once
from cellwise.errors import InputError
from cellwise.estimate.power.along import PowerFollower
from cellwise.estimate.power.limits import LEAST_LOAD_C
from cellwise.forecast.display import Displayed
from cellwise.forecast.outlook import Outlook
from cellwise.forecast.remaining import cutoff_of
from cellwise.live import Counts, LiveFilter, Update, open_source
from cellwise.live import run_live as follow_source
from cellwise.live.run import LatencyMeter, check_any
from cellwise.live.source import sender_to
from cellwise.logs import Stated


def run_live(arguments: argparse.Namespace) -> None:
    """Follow a stream: JSON lines, a view for people, or one object at the end."""
    _check(arguments)
    model = options.read_model(arguments)
    name, stated = _stated(arguments.source)
    followed = _followed(model, stated, arguments)
    reading = log_options.read_options(arguments)
    source = open_source(
        name, reading, arguments.sign, follow=arguments.follow, cells=arguments.cells
    )
    deadline = arguments.deadline_ms
    counts = Counts(latency=LatencyMeter(None if deadline is None else 1e-3 * deadline))
    viewed = arguments.view or (sys.stdout.isatty() and not arguments.json)
    takers: list[Callable[[Update], None]] = [followed.take]

    def take(update: Update) -> None:
        for taker in takers:
            taker(update)

    with ExitStack() as stack:
        stack.callback(source.close)
        if arguments.send:
            least_A = LEAST_LOAD_C * model.capacity_Ah
            to = sender_to(arguments.send, arguments.send_every, source, reading, least_A)
            stack.callback(to.close)
            takers.append(lambda update: to.take(update, followed.row))
        look = None
        if arguments.output:
            file = stack.enter_context(Path(arguments.output).open("a", encoding="utf-8"))
            takers.append(LineWriter(file, followed, arguments.every))
        if viewed:
            look = stack.enter_context(live_panel(source.name, followed))
        elif not (arguments.output or arguments.json):
            takers.append(LineWriter(sys.stdout, followed, arguments.every))
        if not viewed:  # the panel shows both
            takers.append(warned_once(followed.outside))
            takers.append(warned_once(lambda _: followed.far_off))
        stack.enter_context(_stopped_by_signal())
        follow_source(
            source,
            followed.live,
            take,
            counts=counts,
            look=look,
            state=arguments.state,
            save_every_s=arguments.save_every,
            most_samples=arguments.samples,
            idle_s=arguments.idle,
        )
    check_any(source, counts)
    _report_end(arguments, followed, counts, viewed)


def _check(arguments: argparse.Namespace) -> None:
    options.check_places(arguments.output, arguments.state)
    for option in ("save_every", "every", "send_every", "deadline_ms", "samples", "idle"):
        value = getattr(arguments, option)
        if value is not None and not 0.0 <= value < 1e9:
            name = "--" + option.replace("_", "-")
            raise InputError(f"{name} {value:g}", "a number of at least 0", "Correct it.")


def _stated(source: str) -> tuple[str, Stated]:
    """A source's name, and what is stated of its stream behind it."""
    kind, colon, rest = source.partition(":")
    stated = Stated.parse(rest if colon else kind)
    return f"{kind}:{stated.path}" if colon else stated.path, stated


def _followed(model: CellModel, stated: Stated, arguments: argparse.Namespace) -> Followed:
    """The filter, and what else is asked of the stream."""
    charger = (arguments.charge_limit_v, arguments.charge_end_a)
    outlook = Outlook(model, cutoff_of(model, arguments.cutoff_v), arguments.load, *charger)
    power = forecast_options.power_of(arguments, model)
    for notice in () if power is None else power.known.notices:  # limits that nobody stated
        printing.warn(f"cellwise live: {notice}")
    how = forecast_options.how_displayed(arguments, model)
    return Followed(
        _filter(model, stated, arguments),
        outlook,
        None if power is None else PowerFollower(power),
        None if how is None else Displayed(how),
        None if arguments.anyway else FarOffStream(model),
    )


def _filter(model: CellModel, stated: Stated, arguments: argparse.Namespace) -> LiveFilter:
    asked = options.start_of(stated.soc0, options.soc0_of(arguments))
    std = arguments.soc0_std
    live = LiveFilter(
        model,
        arguments.estimator,
        soc0=asked if stated.soc0 is None else stated.soc0,
        soc0_std=STATED_STD if std is None and stated.soc0 is not None else std,
        temperature_C=math.nan if stated.temperature_C is None else stated.temperature_C,
        cells=arguments.cells,
    )
    kept = None if arguments.fresh else arguments.state
    if kept and not live.resume(kept, time.time()) and Path(kept).exists():
        printing.warn(f"cellwise live: '{kept}' is empty: started again")
    return live


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


def _report_end(
    arguments: argparse.Namespace, followed: Followed, counts: Counts, viewed: bool
) -> None:
    """The end of a stream: one object, or a few lines for people."""
    last, start = counts.last, followed.live.start
    if last is None or start is None:
        return
    data = {
        **state_row(last),
        **followed.columns(last),
        "far_off": followed.far_off,
        "estimator": followed.live.filter.name,
        "soc0": start.to_dict(),
        **counts.to_dict(),
    }
    if arguments.json:
        printing.print_json(data)
    elif viewed or arguments.output:
        slow = data["latency"]
        printing.say_notices(filter(None, [followed.far_off]))
        printing.say(
            f"{counts.samples:,} samples, SOC {last.info.soc:.4f} +- {2 * last.info.soc_std:.4f} "
            f"(start {start.soc:.4f} +- {2 * start.std:.4f}, {start.how}); {counts.gaps} gap(s), "
            f"{counts.late} late, {sum(counts.stray.values())} not readable, {counts.outside} "
            f"outside the model's data; latency {slow['p50_ms']:.3f} ms, 99 % "
            f"{slow['p99_ms']:.3f} ms, {slow['missed_deadlines']} too late"
        )
