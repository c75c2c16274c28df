"""cellwise live."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from cellwise.cli.common import (
    forecast_options,
    log_options,
    options,
    printing,
)
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.cell.plausibility.notice import FarOffStream
    from cellwise.estimate.power.along import PowerFollower
    from cellwise.forecast.display import Display
    from cellwise.forecast.outlook import Outlook
    from cellwise.live import Counts, LiveFilter, Update
    from cellwise.logs import Stated

FORECAST_EVERY_S = 1.0


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
    from cellwise.cell.plausibility.notice import FarOffStream
    from cellwise.estimate.power.fixed_tables import LEAST_LOAD_C
    from cellwise.forecast.outlook import Outlook
    from cellwise.forecast.remaining import cutoff_of
    from cellwise.live import Counts, open_source, run_live
    from cellwise.live.run import LatencyMeter, check_any
    from cellwise.live.source import sender_to

    _check(arguments)
    model = options.read_model(arguments)
    charger = (arguments.charge_limit_v, arguments.charge_end_a)
    outlook = Outlook(model, cutoff_of(model, arguments.cutoff_v), arguments.load, *charger)
    power = _power(model, arguments)
    name, stated = _stated(arguments.source)
    live = _filter(model, stated, arguments)
    how = forecast_options.how_displayed(arguments, model)
    far = None if arguments.anyway else FarOffStream(model)
    followed = Followed(live, outlook, power, None if how is None else Shown(how), far)
    reading = log_options.read_options(arguments)
    source = open_source(
        name, reading, arguments.sign, follow=arguments.follow, cells=arguments.cells
    )
    deadline = arguments.deadline_ms
    counts = Counts(latency=LatencyMeter(None if deadline is None else 1e-3 * deadline))
    viewed = arguments.view or (sys.stdout.isatty() and not arguments.json)
    takers: list[Callable[[Update], None]] = [followed.take]
    with ExitStack() as stack:
        stack.callback(source.close)
        if arguments.send:
            least_A = LEAST_LOAD_C * model.capacity_Ah
            to = sender_to(arguments.send, arguments.send_every, source, reading, least_A)
            stack.callback(to.close)
            takers.append(lambda update: to.take(update, followed.row))
        look = None
        if arguments.output:
            file = stack.enter_context(_appended(arguments.output))
            takers.append(LineWriter(file, followed, arguments.every))
        if viewed:
            from cellwise.cli.live_view import LiveView

            look = stack.enter_context(LiveView(source, live, outlook, power=power, far=far)).look
        elif not (arguments.output or arguments.json):
            takers.append(LineWriter(sys.stdout, followed, arguments.every))
        if not viewed:  # the view shows it among its flags
            takers.append(said_once(partial(outside_text, live)))
            takers.append(said_once(lambda _: followed.far_off))
        stack.enter_context(_stopped_by_signal())
        run_live(
            source,
            live,
            partial(_hand_out, takers),
            counts=counts,
            look=look,
            state=arguments.state,
            save_every_s=arguments.save_every,
            most_samples=arguments.samples,
            idle_s=arguments.idle,
        )
    check_any(source, counts)
    _report_end(arguments, followed, counts, viewed)


def _hand_out(takers: list[Callable[[Update], None]], update: Update) -> None:
    for taker in takers:
        taker(update)


class Followed(NamedTuple):
    """A filter on a stream, and what follows it: remaining time and energy, and the power."""

    live: LiveFilter
    outlook: Outlook
    power: PowerFollower | None = None
    shown: Shown | None = None
    far: FarOffStream | None = None

    def take(self, update: Update) -> None:
        """Hand a sample on to what follows the filter."""
        from cellwise.estimate.sensing_kernels import Reading

        self.outlook.take(update)
        if self.far is not None:
            info, known_C = update.info, self.live.known_temperature_C(update.sample)
            self.far.look(update.dt_s, info.innovation_V, info.soc, info.voltage_V, known_C)
        if self.shown is not None:
            self.shown.take(update, self)
        if self.power is None or self.live.state is None:
            return
        sample, warm = update.sample, self.temperature_C(update)
        reading = Reading(sample.current_A, sample.voltage_V, warm, update.dt_s, update.gap)
        self.power.take(reading, self.live.state, update.info.status)

    def columns(self, update: Update) -> dict[str, Any]:
        """Time and energy to empty, power if it is asked for, the cells of a pack: for JSON."""
        state, warm = self.live.state, self.temperature_C(update)
        foreseen = self.outlook.columns(state, warm)
        foreseen |= {} if self.power is None else self.power.columns(state, warm)
        cells = {} if self.live.pack is None else self.live.pack.columns()
        if self.far_off is not None:
            foreseen = dict.fromkeys(foreseen)
            cells = {k: {n: c[n] for n in ("soc", "soc_std")} for k, c in cells.items()}
        shown = {} if self.shown is None else {"displayed_percent": self.shown.percent}
        return foreseen | shown | cells

    @property
    def far_off(self) -> str | None:
        """What is said of a stream that is far off its model; then nothing is foreseen."""
        from cellwise.cell.plausibility.notice import withheld

        return None if self.far is None or self.far.text is None else withheld(self.far.text)

    def row(self, update: Update) -> dict[str, Any]:
        """All that is known after a sample, for whoever is sent it."""
        warm = self.live.known_temperature_C(update.sample)
        return state_row(update) | {"temperature_C": warm} | self.columns(update)

    def temperature_C(self, update: Update) -> float:
        """The sample's temperature, else the model's."""
        from math import isfinite

        measured = self.live.known_temperature_C(update.sample)
        return measured if isfinite(measured) else self.live.model.usual_temperature_C


class Shown:
    """The displayed percentage, and what it expects of the device's own ends once a second."""

    def __init__(self, how: Display) -> None:
        from cellwise.forecast.display import Displayed

        self._displayed = Displayed(how)
        self._since_s = float("inf")
        self.percent = float("nan")

    def take(self, update: Update, followed: Followed) -> None:
        """Follow one sample."""
        self._since_s += update.dt_s
        if self._since_s >= FORECAST_EVERY_S:
            self._since_s = 0.0
            state, warm = followed.live.state, followed.temperature_C(update)
            empty, full = followed.outlook.end_socs(state, warm)
            self._displayed.expect(empty, full)
        sample, dt_s = update.sample, 0.0 if update.gap else update.dt_s
        soc = update.info.soc
        self.percent = self._displayed.take(soc, sample.current_A, sample.voltage_V, dt_s)


class LineWriter:
    """One JSON object per update, at most one in ``every_s`` of the stream's time."""

    def __init__(self, file: IO[str], followed: Followed, every_s: float = 0.0) -> None:
        self._file, self._followed, self._every_s = file, followed, every_s
        self._waited_s = self._since_forecast_s = float("inf")

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


def said_once(what: Callable[[Update], str | None]) -> Callable[[Update], None]:
    """Says on standard error, once, what comes true of a stream."""
    said = False

    def take(update: Update) -> None:
        nonlocal said
        text = None if said else what(update)
        if text is not None:
            said = True
            printing.warn(f"cellwise live: {text}")

    return take


def outside_text(live: LiveFilter, update: Update) -> str | None:
    """That a sample lies outside what the model's data covered, and where; else None."""
    from cellwise.cell.plausibility.notice import outside_moment
    from cellwise.estimate.status import OUTSIDE

    sample, info = update.sample, update.info
    if not info.status & OUTSIDE:
        return None
    warm = live.known_temperature_C(sample)
    where = outside_moment(live.model.validity, info.soc, warm, sample.current_A)
    if where is None:
        return None
    grows = "not validated there, the standard deviation grows"
    return f"at {sample.time_s:.1f} s {where}: {grows}"


def state_row(update: Update) -> dict[str, Any]:
    """An update as values for JSON; what the filter predicts beside what was measured."""
    from cellwise.estimate.status import Status

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


def _power(model: CellModel, arguments: argparse.Namespace) -> PowerFollower | None:
    """What follows the power, and on standard error what limits nobody stated."""
    settings = forecast_options.power_of(arguments, model)
    if settings is None:
        return None
    from cellwise.estimate.power.along import PowerFollower

    for notice in settings.known.notices:
        print(f"cellwise live: {notice}", file=sys.stderr)
    return PowerFollower(settings)


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


def _filter(model: Any, stated: Stated, arguments: argparse.Namespace) -> LiveFilter:
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
    if (
        arguments.state
        and not arguments.fresh
        and not live.resume(arguments.state, time.time())
        and Path(arguments.state).exists()
    ):
        print(f"cellwise live: '{arguments.state}' is empty: started again", file=sys.stderr)
    return live


@contextmanager
def _appended(path: str) -> Iterator[IO[str]]:
    try:
        file = Path(path).open("a", encoding="utf-8")  # noqa: SIM115 -- closed below
    except OSError as error:
        raise InputError(
            f"'{path}', which cannot be written ({error.strerror})",
            "a place with write permission",
            "Choose another one.",
        ) from None
    with file:
        yield file


@contextmanager
def _stopped_by_signal() -> Iterator[None]:
    """A service manager's way to stop a program, and Ctrl-C, are the usual end of a stream."""
    import signal
    import threading

    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = {n: signal.signal(n, stop) for n in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _report_end(
    arguments: argparse.Namespace, followed: Followed, counts: Counts, viewed: bool
) -> None:
    """The end of a stream: one object, or a few lines for people."""
    last, live = counts.last, followed.live
    if last is None or live.start is None:
        return
    data = {
        **state_row(last),
        **followed.columns(last),
        "far_off": followed.far_off,
        "estimator": live.filter.name,
        "soc0": live.start.to_dict(),
        **counts.to_dict(),
    }
    if arguments.json:
        printing.print_json(data)
    elif viewed or arguments.output:
        slow = data["latency"]
        if followed.far_off is not None:
            printing.say(f"  ! {followed.far_off}")
        printing.say(
            f"{counts.samples:,} samples, SOC {last.info.soc:.4f} +- {2 * last.info.soc_std:.4f} "
            f"(start {live.start.soc:.4f} +- {2 * live.start.std:.4f}, {live.start.how}); "
            f"{counts.gaps} gap(s), {counts.late} late, {sum(counts.stray.values())} not readable, "
            f"{counts.outside} outside the model's data; latency "
            f"{slow['p50_ms']:.3f} ms, 99 % {slow['p99_ms']:.3f} ms, "
            f"{slow['missed_deadlines']} too late"
        )
