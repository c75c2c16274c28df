"""A stream followed as it comes: the filter, what is foreseen after every sample, who gets it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cellwise.cell.initial_soc.initial_soc import STATED_STD
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import FarOffStream
from cellwise.estimate.power.limits import LEAST_LOAD_C
from cellwise.estimate.power.power_along_log import PowerFollower
from cellwise.estimate.power.state_of_power import PowerSettings
from cellwise.estimate.sensor import Sensor, SensorReadings, assumed, seen_by
from cellwise.forecast.display import Displayed
from cellwise.forecast.outlook import Outlook
from cellwise.forecast.remaining import cutoff_of
from cellwise.live import Counts, LiveFilter, Update, open_source, run_live
from cellwise.live.followed import FollowedFilter, state_row
from cellwise.live.run import LatencyMeter, check_any
from cellwise.live.samples import Source
from cellwise.live.source import sender_to
from cellwise.logs import Stated
from cellwise.logs.files.source import ReadOptions
from cellwise.notices import Code, Notice
from cellwise.workflows.replaying import ForecastRequest
from cellwise.workflows.starts import start_of

Taker = Callable[[Update], object]


@dataclass(frozen=True)
class FollowRequest:
    """How a stream is followed.

    Parameters
    ----------
    estimator : str                  ``ekf`` or ``ukf``
    soc0, soc0_std : float or None   as of `LiveFilter`; what is stated behind the source's name
                                     comes first
    cells : int                      cells in series that are followed each by itself; 0: their mean
    sensor : Sensor or None          what the sensors are off by; None: as a car's
    power : PowerSettings or None    the state of power beside it
    sign : str                       ``auto``, ``charge-positive`` or ``discharge-positive``
    state : path or None             the filter goes on where this file says, and keeps it there
    fresh : bool                     it starts again, whatever the file says
    waits : bool                     for more, at a file's end
    deadline_s : float or None       as of `LatencyMeter`
    """

    estimator: str = "ekf"
    soc0: float | None = None
    soc0_std: float | None = None
    cells: int = 0
    sensor: Sensor | None = None
    power: PowerSettings | None = None
    sign: str = "auto"
    state: str | Path | None = None
    fresh: bool = False
    waits: bool = False
    deadline_s: float | None = None


@dataclass
class FollowedStream:
    """A source, the filter on it with what follows, and what was counted so far.

    ``notices``: what a person should know before the first sample.
    """

    source: Source
    followed: FollowedFilter
    asked: FollowRequest
    counts: Counts
    notices: tuple[Notice, ...] = ()
    reading: ReadOptions = field(default_factory=ReadOptions)

    def sender(self, to: str, every_s: float | None = None) -> tuple[Taker, Callable[[], object]]:
        """What reports every update to others, and what ends that.

        Parameters
        ----------
        to : str                  MESSAGE.SIGNAL of a CAN bus, mavlink:LINK, mqtt://HOST/PACK
        every_s : float or None   at most one message in so many seconds

        Raises
        ------
        InputError                no such receiver
        """
        least_A = LEAST_LOAD_C * self.followed.live.model.capacity_Ah
        out = sender_to(to, every_s, self.source, self.reading, least_A)
        return lambda update: out.take(update, self.followed.row), out.close

    def run(
        self,
        takers: Sequence[Taker] = (),
        *,
        look: Callable[[Counts], None] | None = None,
        save_every_s: float = 10.0,
        most_samples: int | None = None,
        idle_s: float | None = None,
    ) -> dict[str, Any]:
        """Follow the stream until it ends; its end as JSON values.

        Parameters
        ----------
        takers : sequence of callable     get every update, after what follows the filter
        look, save_every_s, most_samples, idle_s      as of `run_live`

        Raises
        ------
        InputError        the source gives up; no sample came, or none that a cell can give
        """

        def take(update: Update) -> None:
            for taker in (self.followed.take, *takers):
                taker(update)

        run_live(
            self.source,
            self.followed.live,
            take,
            counts=self.counts,
            look=look,
            state=self.asked.state,
            save_every_s=save_every_s,
            most_samples=most_samples,
            idle_s=idle_s,
        )
        check_any(self.source, self.counts)
        return self.to_dict()

    def to_dict(self) -> dict[str, Any]:
        """The last state and what was counted, as ``cellwise live --json`` prints it."""
        last, live, mismatch = self.counts.last, self.followed.live, self.followed.model_mismatch
        if last is None or live.start is None:
            return {}
        return {
            **state_row(last),
            **self.followed.columns(last),
            "far_off": None if mismatch is None else mismatch.text,
            "estimator": live.filter.name,
            "soc0": live.start.to_dict(),
            "sensor": assumed(self.asked.sensor, live.model.capacity_Ah),
            **self.counts.to_dict(),
        }


def follow_stream(
    model: CellModel,
    source: str,
    asked: FollowRequest | None = None,
    ahead: ForecastRequest | None = None,
    reading: ReadOptions | None = None,
) -> FollowedStream:
    """Open a stream and put a filter on it; `FollowedStream.run` follows it.

    Parameters
    ----------
    model : CellModel
    source : str          as of `open_source`: ``csv:FILE``, ``json:FILE``, ``can:can0``, ...;
                          ``json:FILE@soc0=1`` says how it begins
    asked, ahead          how it is followed, what is foreseen; None: as their defaults
    reading : ReadOptions or None     cells in series and in parallel, channels, database

    Raises
    ------
    InputError            no such source; a start other than the stated one; a state of another
                          model; as `LiveFilter` and `Outlook`
    """
    asked, ahead = asked or FollowRequest(), ahead or ForecastRequest()
    reading = reading or ReadOptions()
    seen = seen_by(model, asked.sensor)
    name, stated = stated_of(source)
    followed = _followed(seen, stated, asked, ahead)
    notices = () if asked.power is None else asked.power.known.notices
    if not _resumed(followed.live, asked):
        text = f"'{asked.state}' is empty: started again"
        notices = (*notices, Notice(Code.STATE_EMPTY, text))
    opened = open_source(name, reading, asked.sign, follow=asked.waits, cells=asked.cells)
    counts = Counts(latency=LatencyMeter(asked.deadline_s))
    return FollowedStream(opened, followed, asked, counts, notices, reading)


def stated_of(source: str) -> tuple[str, Stated]:
    """A source's name, and what is stated of its stream behind it."""
    kind, colon, rest = source.partition(":")
    stated = Stated.parse(rest if colon else kind)
    return f"{kind}:{stated.path}" if colon else stated.path, stated


def _followed(
    seen: SensorReadings, stated: Stated, asked: FollowRequest, ahead: ForecastRequest
) -> FollowedFilter:
    """The filter, and what is foreseen from it."""
    model, how = seen.model, ahead.shown(seen.model)
    charger = (ahead.charge_limit_V, ahead.charge_end_A)
    return FollowedFilter(
        _filter(seen, stated, asked),
        Outlook(model, cutoff_of(model, ahead.cutoff_V), ahead.load, *charger),
        None if asked.power is None else PowerFollower(asked.power),
        None if how is None else Displayed(how),
        None if ahead.anyway else FarOffStream(model, asked.sign),
    )


def _filter(seen: SensorReadings, stated: Stated, asked: FollowRequest) -> LiveFilter:
    soc0, std = start_of(stated.soc0, asked.soc0), asked.soc0_std
    return LiveFilter(
        seen.model,
        asked.estimator,
        noise=seen.noise,
        soc0=soc0 if stated.soc0 is None else stated.soc0,
        soc0_std=STATED_STD if std is None and stated.soc0 is not None else std,
        temperature_C=math.nan if stated.temperature_C is None else stated.temperature_C,
        cells=asked.cells,
    )


def _resumed(live: LiveFilter, asked: FollowRequest) -> bool:
    """Whether a state that was to be taken up could be; one that is not there yet is none."""
    if asked.state is None or asked.fresh:
        return True
    return live.resume(asked.state, time.time()) or not Path(asked.state).exists()
