"""cellwise live."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cellwise.cli.common import forecast_options, log_options, options, printing
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.cli.live_output import Followed
    from cellwise.live import Counts, LiveFilter, Update
    from cellwise.logs import Stated


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the command that follows a stream."""
    live = commands.add_parser("live", help="a stream of samples to SOC, as they come")
    options.add_model(live, scalable=True)
    text = "stdin (JSON lines), json:FILE, can:INTERFACE:CHANNEL, ulog:FILE (- for stdin), "
    text += "mavlink:LINK, mqtt://HOST/TOPIC, ble:DEVICE; json:FILE@soc0=1 says how it begins"
    live.add_argument("--source", required=True, metavar="S", help=text)
    options.flag(live, "--follow", "wait for more at a file's end")
    live.add_argument("--estimator", default="ekf", metavar="E", help="ekf or ukf [ekf]")
    options.add_soc0(live)
    options.add_soc0_std(live)
    live.add_argument("--state", metavar="FILE", help="goes on where FILE says, and keeps it there")
    options.flag(live, "--fresh", "start again, whatever FILE says")
    options.number(live, "--save-every", "S", "seconds [10]", default=10.0)
    live.add_argument("-o", "--output", metavar="OUT", help="JSON lines, added at the end of OUT")
    options.number(live, "--every", "S", "at most one line in S seconds [0]", default=0.0)
    options.flag(live, "--view", "a view instead of lines [on a terminal]")
    text = "state to others: MESSAGE.SIGNAL of the CAN bus, mavlink:LINK, mqtt://HOST/PACK"
    live.add_argument("--send", metavar="TO", help=text)
    options.number(live, "--send-every", "S", "seconds [1; on a CAN bus 0.1]")
    options.number(live, "--cutoff-v", "V", "voltage at which the load stops [model]")
    options.number(live, "--load", "W", "how long, too, at a load of W watts in each cell")
    forecast_options.add_charger(live)
    forecast_options.add_display(live)
    forecast_options.add_power_options(live)
    options.flag(live, "--anyway", "forecasts, power and health of a stream far off the model, too")
    text = "follow N cells in series, each by itself"
    options.count(live, "--cells", "N", text, default=0)
    options.number(live, "--deadline-ms", "MS", "[the sample's interval]")
    options.count(live, "--samples", "N", "stop after N samples")
    options.number(live, "--idle", "S", "stop when nothing came for S seconds")
    log_options.add_pack_options(live)
    options.add_json(live)
    live.set_defaults(run=run_live_command)


def run_live_command(arguments: argparse.Namespace) -> None:
    """Follow a stream: JSON lines, a view for people, or one object at the end."""
    from cellwise.cli.live_output import LineWriter, live_panel, warned_once
    from cellwise.estimate.power.limits import LEAST_LOAD_C
    from cellwise.live import Counts, open_source, run_live
    from cellwise.live.run import LatencyMeter, check_any
    from cellwise.live.source import sender_to

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
        run_live(
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
    from cellwise.logs import Stated

    kind, colon, rest = source.partition(":")
    stated = Stated.parse(rest if colon else kind)
    return f"{kind}:{stated.path}" if colon else stated.path, stated


def _followed(model: CellModel, stated: Stated, arguments: argparse.Namespace) -> Followed:
    """The filter, and what else is asked of the stream."""
    from cellwise.cell.plausibility.notice import FarOffStream
    from cellwise.cli.live_output import Followed
    from cellwise.estimate.power.along import PowerFollower
    from cellwise.forecast.display import Displayed
    from cellwise.forecast.outlook import Outlook
    from cellwise.forecast.remaining import cutoff_of

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
    import math
    import time

    from cellwise.cell.initial_soc.initial_soc import STATED_STD
    from cellwise.live import LiveFilter

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
    import signal
    import threading

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
    from cellwise.cli.live_output import state_row

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
