"""A log through an estimator, and what is ahead of its end: remaining time, plans, a charger."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.arguments import check_kind
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import FAR_DEVIATIONS, ends_forecasts, withheld
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.estimate.adaptive import AdaptiveTrace
from cellwise.estimate.estimators import make_estimator
from cellwise.estimate.power.power_along_log import PowerTrace
from cellwise.estimate.power.state_of_power import Hold, PowerSettings
from cellwise.estimate.replay import Replay, expected_convergence_s, replay
from cellwise.estimate.sensor import Sensor, seen_by
from cellwise.forecast.charging import forecast_charge, limit_of, taper_of
from cellwise.forecast.display import PercentageDisplay, display_along, display_of
from cellwise.forecast.plan import Plan, PlanOutcome, forecast_plan
from cellwise.forecast.remaining import (
    Forecast,
    ForecastTrace,
    check_load,
    cutoff_of,
    forecast,
    forecast_at,
)
from cellwise.logs.cell_log import CellLog, resample
from cellwise.logs.checks.units import check_is_log
from cellwise.logs.files.source import ReadOptions, open_source
from cellwise.logs.formats.ros_bag import start_of as start_of_bag
from cellwise.logs.gaps import cut_at_pauses
from cellwise.logs.writing import write_columns
from cellwise.notices import Code, Notice, texts
from cellwise.typing import FloatArray
from cellwise.wording import Option
from cellwise.workflows.nearest_stock import StockDistance, nearest_stock
from cellwise.workflows.served import Served, each_that_serves
from cellwise.workflows.starts import start_of

# What an adaptive filter estimates beside the SOC, and what it holds at the model's.
ESTIMATED = (
    "offset_A", "offset_std_A", "gain", "gain_std", "capacity_Ah", "capacity_std_Ah",
    "resistance_scale", "resistance_std",
)  # fmt: skip
HELD = ("held_offset", "held_resistance", "held_charge")


@dataclass(frozen=True)
class ReplayRequest:
    """How a log is replayed.

    Parameters
    ----------
    estimator : str                    a name of ``ESTIMATORS``
    soc0, soc0_std : float or None     as of `replay`; they hold where a log begins, not behind a
                                       pause that nobody counted
    reference_soc0, reference_capacity_Ah : float or None    as of `replay`
    dt_s : float or None               resample to an even step [s]; None: the log's rows
    power : PowerSettings or None      the state of power beside it
    sensor : Sensor or None            as of `replay`; None: a car's
    """

    estimator: str = "ekf"
    soc0: float | None = None
    soc0_std: float | None = None
    reference_soc0: float | None = None
    reference_capacity_Ah: float | None = None
    dt_s: float | None = None
    power: PowerSettings | None = None
    sensor: Sensor | None = None


@dataclass(frozen=True)
class ForecastRequest:
    """What of a replay's end is foreseen.

    Parameters
    ----------
    hold : str                what of the load is held constant: power or current
    cutoff_V : float or None  of a cell; None: the model's
    load : float or None      how long, too, at a load of so many W of a cell (A if current is held)
    charge_limit_V, charge_end_A : float or None    of a charger; None: by the model
    plans : sequence of Plan  what lies ahead
    above : float             with which chance a plan ends above this SOC
    display : float or None   a displayed percentage that catches up over this share of the charge
    anyway : bool             foresee from a log that is far off the model, too
    """

    hold: Hold = "power"
    cutoff_V: float | None = None
    load: float | None = None
    charge_limit_V: float | None = None
    charge_end_A: float | None = None
    plans: Sequence[Plan] = ()
    above: float = 0.0
    display: float | None = None
    anyway: bool = False

    def shown(self, model: CellModel) -> PercentageDisplay | None:
        """How a percentage is displayed; None where it is not asked for.

        Raises
        ------
        InputError        a share out of range; no cutoff, or no charger's limit, is known
        """
        if self.display is None:
            return None
        limit_V = limit_of(model, self.charge_limit_V)
        taper_A = taper_of(model, self.charge_end_A)
        return display_of(model, cutoff_of(model, self.cutoff_V), limit_V, taper_A, self.display)


@dataclass(frozen=True)
class ReplayAndForecast:
    """A replay, when it was to converge, and what remains by it.

    ``far`` is why nothing is foreseen, None where it is; ``began`` the start that the whole log
    shows, as every other function finds it; ``nearest`` the stock model that is nearer than the
    one that the log is far off; ``wrong_start`` that the first voltages contradict a stated start.
    """

    replay: Replay
    far: Notice | None
    expected_s: float | None = None
    began: InitialSoc | None = None
    nearest: StockDistance | None = None
    wrong_start: Notice | None = None
    flight: ForecastTrace | None = None
    at_load: Forecast | None = None
    charge: ForecastTrace | None = None
    plan: PlanOutcome | None = None
    displayed_percent: FloatArray | None = None
    hold: Hold = "power"
    cutoff_V: float = math.nan

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What a person should know, of the forecast first."""
        of_start = () if self.wrong_start is None else (self.wrong_start,)
        of_flight = () if self.flight is None else self.flight.notices
        if self.far is None:
            return (*of_start, *of_flight, *self.replay.notices)
        far = self._withheld(self.far)
        return (*of_start, *(far if n == self.far else n for n in self.replay.notices))

    def _withheld(self, far: Notice) -> Notice:
        """What is far off, what is not said, and which stock model is nearer."""
        said = withheld(far)
        if self.nearest is None:
            return said
        text = f". Of the stock models {self.nearest.name} is the nearest, scaled with "
        off = f": typically {1e3 * self.nearest.typical_V:.0f} mV off"
        capacity = Option("capacity_Ah", float(f"{self.nearest.capacity_Ah:.3g}"))
        return said.followed_by(text, capacity, off)

    @property
    def critical(self) -> tuple[Notice, ...]:
        """Those up to the one for which nothing is foreseen; none where something is."""
        if self.far is None:
            return ()
        behind = len(self.notices) - len(self.replay.notices) + 1
        return self.notices[: self.replay.notices.index(self.far) + behind]

    @property
    def cells(self) -> int:
        """Cells of the pack that the log was read from; 1 of a cell's log."""
        return self.replay.log.series * self.replay.log.parallel

    @property
    def power(self) -> PowerTrace | None:
        """The state of power, unless the log is far off."""
        return None if self.far else self.replay.power

    def figures(self) -> dict[str, Any]:
        """The replay's figures; of a log that is far off no parameters and no power."""
        figures = self.replay.to_dict()
        left_out = {"parameters", "power"} if self.far else set()
        return {key: None if key in left_out else value for key, value in figures.items()}

    def to_dict(self) -> dict[str, Any]:
        """JSON values, keys as the command prints them."""
        shown, charge = self.displayed_percent, self.charge
        if charge is not None and charge.time_s[-1] < self.replay.log.time_s[-1]:
            charge = None  # no longer on the charger
        return {
            "log": self.replay.log.name,
            **self.figures(),
            "soc0_whole_log": None if self.began is None else self.began.to_dict(),
            "convergence_predicted_s": self.expected_s,
            "forecast": None if self.flight is None else self.flight.to_dict(),
            "forecast_charge": None if charge is None else charge.to_dict(),
            "forecast_plan": None if self.plan is None else self.plan.to_dict(),
            "displayed_percent": None if shown is None else float(shown[-1]),
            "forecast_given": None if self.at_load is None else self.at_load._asdict(),
            "notices": texts(self.notices),
        }

    def columns(self) -> dict[str, Any]:
        """What was said of every row; of a log that is far off no parameters and no power."""
        log, trace = self.replay.log, self.replay.trace
        columns = replace(self.replay, power=None).columns()
        columns |= {"current_A": log.interval_current_A, "measured_voltage_V": log.voltage_V}
        if isinstance(trace, AdaptiveTrace) and not self.far:
            columns |= {name: getattr(trace, name) for name in ESTIMATED}
            columns |= dict(zip(HELD, trace.held, strict=True))
        if self.displayed_percent is not None:
            columns["displayed_percent"] = self.displayed_percent
        return columns if self.power is None else columns | self.power.columns()


def check_replay(model: CellModel, asked: ReplayRequest, ahead: ForecastRequest) -> None:
    """Refuse what could only fail after the work is done.

    Raises
    ------
    InputError        an unknown estimator; a load that is none; a display out of range
    """
    make_estimator(asked.estimator, model)
    ahead.shown(model)
    if ahead.load is not None:
        check_load(ahead.load, ahead.hold)


def replay_and_forecast(
    model: CellModel,
    log: CellLog,
    asked: ReplayRequest | None = None,
    ahead: ForecastRequest | None = None,
    *,
    begins: bool = True,
) -> ReplayAndForecast:
    """Replay one stretch of a log, and say what is ahead of its end.

    Parameters
    ----------
    model : CellModel
    log : CellLog         without a pause that nobody counted (`replay_each` cuts there)
    asked, ahead : ReplayRequest, ForecastRequest    how to replay and forecast; None: defaults
    begins : bool         what is asked of the start holds; behind a pause it does not

    Returns
    -------
    ReplayAndForecast     as ``cellwise replay`` prints it

    Raises
    ------
    InputError            as `replay` and `forecast`; a start other than the log's stated one
    """
    check_is_model(model)
    check_is_log(log)
    asked, ahead = asked or ReplayRequest(), ahead or ForecastRequest()
    check_kind("asked", asked, ReplayRequest, "Write ReplayRequest('ekf', soc0=0.9), say.")
    check_kind("ahead", ahead, ForecastRequest, "Write ForecastRequest(load=10.0), say.")
    log = log if asked.dt_s is None else resample(log, asked.dt_s)
    found = replay(
        model,
        log,
        asked.estimator,
        sensor=asked.sensor,
        soc0=start_of(log.soc0, asked.soc0) if begins else None,
        soc0_std=asked.soc0_std if begins else None,
        reference_soc0=start_of(log.soc0, asked.reference_soc0, "reference_soc0"),
        reference_capacity_Ah=asked.reference_capacity_Ah if begins else None,
        power=asked.power or False,
    )
    model, noise = seen_by(model, asked.sensor)
    begun = found.start.how in ("given", "stated")
    far = None if ahead.anyway else ends_forecasts(found.model_mismatch, found.log)
    run = ReplayAndForecast(found, far, hold=ahead.hold, cutoff_V=cutoff_of(model, ahead.cutoff_V))
    if far is None:
        filter_ = make_estimator(asked.estimator, model, noise)
        run = replace(
            _with_forecasts(run, model, ahead),
            expected_s=expected_convergence_s(model, found, filter_),
            began=None if begun else initial_soc(model, found.log, whole_log=True),
        )
    elif far is found.model_mismatch:
        run = replace(run, nearest=nearest_stock(model, found.log))
    if begun and far in (None, found.model_mismatch):
        run = replace(run, wrong_start=_contradicted(model, found))
    how = ahead.shown(model)
    if how is None:
        return run
    return replace(run, displayed_percent=display_along(how, found, run.flight, run.charge))


def _contradicted(model: CellModel, found: Replay) -> Notice | None:
    """That a stated start is many deviations from the one that the first voltages show."""
    stated, seen = found.start, initial_soc(model, replace(found.log, soc0=None))
    if abs(seen.soc - stated.soc) <= FAR_DEVIATIONS * math.hypot(seen.std, stated.std):
        return None
    text = (
        f" begins at SOC {seen.soc:.2f} +- {2.0 * seen.std:.2f} by its voltages ({seen.how}), and "
        f"not at {stated.soc:.2f} as {stated.how}: "
    )
    said = (text, Option("soc0", letter="auto"), " takes what they show")
    return Notice(Code.START_CONTRADICTED, said, log=found.log.name)


def _with_forecasts(
    run: ReplayAndForecast, model: CellModel, ahead: ForecastRequest
) -> ReplayAndForecast:
    """The same with all that is foreseen."""
    found, cutoff_V, hold = run.replay, run.cutoff_V, ahead.hold
    at_load = None
    if ahead.load is not None:
        at_load = forecast_at(model, found, ahead.load, cutoff_V=cutoff_V, hold=hold)
    flight = forecast(model, found, cutoff_V=cutoff_V, hold=hold)
    charger = {"limit_V": ahead.charge_limit_V, "taper_A": ahead.charge_end_A}
    plan = None
    if ahead.plans:
        limits: dict[str, Any] = {"above": ahead.above, "cutoff_V": ahead.cutoff_V}
        plan = forecast_plan(model, found, ahead.plans, **limits)
    return replace(
        run,
        at_load=at_load,
        flight=None if flight is None else replace(flight, given=at_load),
        charge=forecast_charge(model, found, **charger),
        plan=plan,
    )


def replay_each(
    model: CellModel,
    logs: Sequence[CellLog],
    asked: ReplayRequest,
    ahead: ForecastRequest,
    follow: Callable[[str, int, int], object] = lambda what, done, total: None,
) -> Served[ReplayAndForecast]:
    """Replay logs, each cut where minutes passed that nobody counted.

    Parameters
    ----------
    logs : sequence of CellLog
    asked, ahead : ReplayRequest, ForecastRequest
    follow : callable     what is done, and how many of how many stretches are

    Raises
    ------
    InputError            as `replay_and_forecast`, where no stretch serves
    """
    parts = [(one, k == 0) for log in logs for k, one in enumerate(cut_at_pauses(log))]

    def replayed(at: int) -> ReplayAndForecast:
        log, begins = parts[at]
        follow(f"{asked.estimator} over {len(log):,} samples", at, len(parts))
        return replay_and_forecast(model, log, asked, ahead, begins=begins)

    return each_that_serves(range(len(parts)), replayed)


def write_replays(
    runs: Sequence[ReplayAndForecast], path: str | Path, reading: ReadOptions | None = None
) -> None:
    """Write the rows of a log's stretches: a table, or topics with a layout for Foxglove.

    Parameters
    ----------
    path : str or Path             .csv, .csv.gz, .parquet or .mcap
    reading : ReadOptions or None  how the log was read: of a bag, to find when it begins
    """
    parts = [run.columns() for run in runs]
    names = [name for name in parts[0] if all(name in part for part in parts)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
    if Path(path).suffix != ".mcap":
        write_columns(columns, Path(path))
        return
    from cellwise.report.viewer_files import write_foxglove, write_mcap

    log = runs[0].replay.log
    bag = log.format == "ros-bag"
    write_mcap(
        path, columns, start_of_bag(open_source(log.source, options=reading)) if bag else 0.0
    )
    write_foxglove(Path(path).with_suffix(".foxglove.json"))
