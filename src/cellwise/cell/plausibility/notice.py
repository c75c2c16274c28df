"""What a person should know of a log and a model, with its size, the most harmful first.

A log far off the model, one that leaves the model's data, what a simulated or filtered log shows.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import Entropy, TemperatureDependence
from cellwise.cell.metrics import NEAR_EMPTY, band_metrics, error_metrics
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import Validity
from cellwise.cell.plausibility.validity_kernels import extrapolation_V, validity_scalars
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.sign import contradiction, verify_sign
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray
from cellwise.wording import Option, Piece, RowPlace

# A charge or SOC that is wrong by the whole range is wrong by about this in voltage.
RANGE_V = 1.0


def _name(log: CellLog) -> str:
    return log.name or "the log"


def _usual_C(log: CellLog) -> float | None:
    """Median of the temperatures that were measured."""
    measured = log.temperature_C
    return None if measured is None or np.isnan(measured).all() else float(np.nanmedian(measured))


def in_order(found: Iterable[Notice], of_reading: Sequence[Notice] = ()) -> tuple[Notice, ...]:
    """Notices, the most harmful first, those of reading a log last.

    A channel that cannot be what it is taken for, such as a current of the wrong sign, comes before
    all: it turns every other figure into nonsense.
    """
    critical = [n for n in of_reading if n.is_critical]
    by_size = sorted(found, key=lambda n: -n.size_V)
    return tuple(dict.fromkeys((*critical, *by_size, *of_reading)))


# When the model's statement of its error does not hold for a log: it is another cell's. Half of its
# rows are beyond so many of the model's own deviations; of a model that is right, within 0.7.
FAR_DEVIATIONS = 3.0
FAR_ROWS = 4000  # of many, about so many
FAR_LOOKS = 3600  # at a stream that count, one a second
FEWEST_LOOKS = 30  # before, a start that is off says nothing
SIGN_LOOKS = 60  # its sign is asked at every of so many

# Where notices stand that name no voltage, by a voltage in their place [V].
FIRST_V = 1e3  # above what is said of a current or a SOC outside of the model's data
OUTSIDE_V = 100.0  # above each voltage of a cell, below what makes all figures meaningless
ASSUMED_V = 0.01  # about what ten kelvin do at 1C

# From where on something is said.
FEWEST_ROWS = 3  # fewer are a sensor's spikes
LEAST_SHARE = 1e-3  # of all rows: fewer are spikes, too
# Times the model's capacity: no cell holds so much more than another of its kind.
MOST_CHARGE = 1.15
LEAST_SOC = 5e-4  # beyond 0 to 1: it shows in three digits
LEAST_V = 1e-4  # no voltage is known better
NO_MODEL_V = 0.2  # off by so much it says no SOC: a cell's goes over 0.5 to 1.5 V
MOST_REJECTED = 0.1  # share of a filter's voltages


OTHER: tuple[Piece, ...] = (
    "a log of another cell, number of cells in series (",
    Option("series", letter="N"),
    "), capacity, temperature or age",
)
WITHHELD = "emaining time and health would be made of it: withheld ("


def times_stated(
    model: CellModel, log: CellLog, error_V: FloatArray, soc: FloatArray
) -> tuple[float, float]:
    """Median error of the rows, in standard deviations that the model states there, and in volts.

    Parameters
    ----------
    error_V : (n,) float      measured minus model, NaN where nothing was measured
    soc : (n,) float          where the model was
    """
    rows = np.flatnonzero(np.isfinite(error_V) & np.isfinite(soc))
    rows = rows[:: max(rows.size // FAR_ROWS, 1)]
    if rows.size == 0:
        return 0.0, 0.0
    stated_V = stated_error_V(model, log, soc, log.voltage_V - error_V)[rows]
    error = np.abs(error_V[rows])
    times = float(np.median(error / np.maximum(stated_V, 1e-6)))
    return times, float(np.median(error))


def find_mismatch(
    model: CellModel | None, log: CellLog, error_V: FloatArray, soc: FloatArray
) -> Notice | None:
    """What is said first of a log that is far off; None of one that is not, or without a model."""
    if model is None:
        return None
    times, typical_V = times_stated(model, log, error_V, soc)
    found = _said("", times, typical_V, _causes(model, log))
    return None if found is None else replace(found, log=_name(log))


def _causes(model: CellModel, log: CellLog) -> tuple[Piece, ...]:
    """Why a log may be far off: of a stock model that nobody scaled first its capacity."""
    if not model.is_stock or "scaled_from_Ah" in model.provenance:
        return OTHER
    held, moved = f"{model.capacity_Ah:.3g} Ah", float(np.ptp(log.counted_charge_Ah()))
    text = f"a cell of another capacity than this stock model's {held}, of which the log moves "
    return f"{text}{moved:.3g} (", Option("capacity_Ah", letter="X"), " scales it), ", *OTHER


def _said(
    what: str, times: float, typical_V: float, causes: tuple[Piece, ...] = OTHER
) -> Notice | None:
    little = typical_V < NO_MODEL_V  # else half as many deviations are enough
    most = FAR_DEVIATIONS if little else 0.5 * FAR_DEVIATIONS
    if times <= most or not math.isfinite(times):
        return None
    text = (
        f"{what} is FAR OFF this model: typically {1e3 * typical_V:.0f} mV, {times:.3g} times "
        "what the model states of itself"
    )
    said = (text, ": ", *causes, " than the model's?")
    return Notice(Code.FAR_OFF, said, size_V=FIRST_V)


class FarOffStream:
    """The same of a stream: of its last hour, by one look a second; ``notice`` says it.

    ``sign``: what its current was read as, which is compared with what the voltage does.
    """

    def __init__(self, model: CellModel, sign: str = "auto") -> None:
        self._model = model
        self._other = "discharge-positive" if sign == "charge-positive" else "charge-positive"
        other = Option("sign", self._other)
        self._causes: tuple[Piece, ...] = ("the sign of the current (", other, "), ", *OTHER)
        self._passed_s, self._looks = 0.0, 0
        self._measured: deque[tuple[float, float, float]] = deque(maxlen=FAR_LOOKS)
        self._contradicted = False
        self._since_s = math.inf
        self._seen: deque[tuple[float, float]] = deque(maxlen=FAR_LOOKS)
        self.notice: Notice | None = None

    def look(
        self,
        dt_s: float,
        current_A: float,
        error_V: float,
        soc: float,
        voltage_V: float,
        temperature_C: float,
    ) -> None:
        """One sample: measured minus predicted, where the model is; ``notice`` is true after it.

        Of many looks a few more move no median: the more there are, the less often it is taken.
        """
        self._since_s += dt_s
        self._passed_s += dt_s
        if self._since_s < 1.0 or not math.isfinite(error_V):
            return
        self._since_s = 0.0
        self._measured.append((self._passed_s, current_A, voltage_V + error_V))
        self._check_sign()
        warm = temperature_C if math.isfinite(temperature_C) else None
        stated_V = max(float(_stated_at(self._model, soc, voltage_V, warm)), 1e-6)
        self._seen.append((abs(error_V) / stated_V, abs(error_V)))
        looks = len(self._seen)
        if looks >= FEWEST_LOOKS and self._looks % (1 + looks // SIGN_LOOKS) == 0:
            times, typical_V = np.median(self._seen, axis=0).tolist()
            said = _said("the stream", times, typical_V, self._causes)
            self.notice = contradiction(self._other) if self._contradicted else said

    def _check_sign(self) -> None:
        """Ask what the sign of the last hour is, once a minute."""
        self._looks += 1
        if self._looks % SIGN_LOOKS:
            return
        time_s, current_A, voltage_V = np.array(self._measured).T
        if np.isfinite(current_A).any():
            log = CellLog(time_s, current_A, voltage_V)
            self._contradicted = verify_sign(log).verdict == "contradicted"


def ends_forecasts(far: Notice | None, log: CellLog) -> Notice | None:
    """Why nothing is foreseen from a log: a channel is not what it is taken for, or far off."""
    return next((n for n in log.notices if n.is_critical), far)


def withheld(far: Notice) -> Notice:
    """What is far off, and what is therefore not said."""
    begin = "; r" if far.is_critical else " R"  # one without a full stop, the other with one
    return far.followed_by(begin + WITHHELD, Option("anyway", True), " gives them)")


WARMED = (TemperatureDependence, Entropy)  # effects that follow the temperature


def outside_notices(validity: Validity, log: CellLog, soc: FloatArray) -> list[Notice]:
    """Which rows of a log lie outside what the model's data covered, and how far.

    A hair outside is inside (see :mod:`cellwise.cell.plausibility.validity`); what is not known,
    of the model or of the log, gives no notice.

    Parameters
    ----------
    soc : (n,) float      simulated, or estimated
    """
    found = list(_parts(validity, log, soc))
    if not found:
        return []
    text = (
        f" leaves what the model's data covered: {'; '.join(p.text for p in found)}. There the "
        "error is not validated and grows with the distance"
    )
    # First: every other figure is to be read with it. But a wrong cell or unit, too, drives SOC
    # and current out of their ranges, and is then the cause: only a temperature stands by itself.
    by_itself = any(p.channel == "temperature_C" for p in found)
    size_V = math.inf if by_itself else OUTSIDE_V
    return [Notice(Code.OUTSIDE_DATA, text, log=_name(log), size_V=size_V)]


def assumed_temperature_notices(model: CellModel, log: CellLog, assumed_C: float) -> list[Notice]:
    """That nobody measured the temperature on which the model depends, and what is assumed."""
    if _usual_C(log) is not None:
        return []
    if model.temperature_C.size == 1 and not any(isinstance(e, WARMED) for e in model.effects):
        return []
    text = (
        f"no temperature was measured in '{_name(log)}': {assumed_C:.0f} degC is "
        "assumed (LOG@10 states another)"
    )
    stated = Option("temperature_C")
    return [Notice(Code.TEMPERATURE_ASSUMED, text, option=stated, size_V=ASSUMED_V)]


def outside_moment(
    validity: Validity, soc: float, temperature_C: float, current_A: float
) -> str | None:
    """Which quantity of one moment lies outside, and where the data end; None inside."""
    bounds = validity.bounds()
    found = [
        f"{name} {value:.{digits}f}{unit} (the model's data: {low:.{digits}f} to {high:.{digits}f})"
        for name, value, bound, ends, digits, unit in (
            ("SOC", soc, bounds[:2], validity.soc, 2, ""),
            ("temperature", temperature_C, bounds[2:4], validity.temperature_C, 1, " degC"),
            ("current", current_A, bounds[4:], validity.current_A, 2, " A"),
        )
        if ends is not None and (value < bound[0] or value > bound[1])
        for low, high in (ends,)
    ]
    return ", ".join(found) or None


class Beyond(NamedTuple):
    """A channel that leaves the data on one side."""

    channel: str
    text: str


def _parts(validity: Validity, log: CellLog, soc: FloatArray) -> Iterator[Beyond]:
    """Of each side: the share of the rows beyond, where the data end, how far the rows go."""
    b = validity.bounds()
    for channel, values, low, high, written in (
        ("temperature_C", log.temperature_C, b.cold_C, b.warm_C, "{:.3g} degC"),
        ("soc", soc, b.soc_low, b.soc_high, "SOC {:.2f}"),
        ("current_A", log.current_A, b.charge_A, b.discharge_A, "{:.3g} A"),
    ):
        ends: tuple[float, float] | None = getattr(validity, channel)
        if values is None or ends is None:
            continue
        known = float(np.count_nonzero(np.isfinite(values))) or 1.0
        for side, end, beyond in (
            ("below", ends[0], values[values < low]),
            ("above", ends[1], values[values > high]),
        ):
            share = 100.0 * beyond.size / known
            if beyond.size >= FEWEST_ROWS and share >= 100.0 * LEAST_SHARE:
                furthest = float(beyond[np.argmax(np.abs(beyond - end))])
                text = (
                    f"{share:.{0 if share >= 1.0 else 1}f} % of the rows are {side} "
                    f"{written.format(end)}, where its data end, to {furthest:.3g}"
                )
                yield Beyond(channel, text)


def along_notices(
    model: CellModel | None, validity: Validity, log: CellLog, soc: FloatArray
) -> list[Notice]:
    """What a run along a log says of where it leads: outside the model's data, outside 0..1."""
    found = outside_notices(validity, log, soc) + soc_notices(log, soc)
    if model is not None:
        too_much = any(n.code is Code.TOO_MUCH_CHARGE for n in found)
        found += [] if too_much else charge_notices(model, log)
        found += assumed_temperature_notices(model, log, model.usual_temperature_C)
    return found


def soc_notices(log: CellLog, soc: FloatArray) -> list[Notice]:
    """A SOC outside 0..1, and more charge than such a cell holds.

    Parameters
    ----------
    soc : (n,) float      simulated, or counted
    """
    low, high = float(np.nanmin(soc)), float(np.nanmax(soc))
    outside = max(-low, high - 1.0)
    if outside <= LEAST_SOC:
        return []
    name = _name(log)
    ran = f"SOC from {low:.3f} to {high:.3f}, outside 0..1"
    moved = float(np.ptp(log.counted_charge_Ah()))
    if high - low > MOST_CHARGE:
        text = (
            f" moves {moved:.4g} Ah, {high - low:.3g} times the model's capacity ({ran}): the unit "
            "of the current (mA?), the cells in parallel ("
        )
        said = (text, Option("parallel", letter="N"), "), or a log of another cell?")
        # Before all others: every other figure follows from it.
        return [Notice(Code.TOO_MUCH_CHARGE, said, log=name, size_V=math.inf)]
    text = f" runs through {ran}, beginning at {soc[0]:.3f}: check the initial SOC ("
    said = (text, Option("soc0", letter="X"), " states it) and the capacity")
    return [Notice(Code.SOC_OUTSIDE, said, log=name, size_V=RANGE_V * outside)]


def charge_notices(model: CellModel, log: CellLog) -> list[Notice]:
    """More charge than the model's cell holds, which a filter does not follow: it stays in 0..1."""
    moved_Ah = float(np.ptp(log.counted_charge_Ah()))
    if not moved_Ah > MOST_CHARGE * model.capacity_Ah:
        return []
    text = (
        f" moves {moved_Ah:.4g} Ah, {moved_Ah / model.capacity_Ah:.3g} times the model's capacity: "
        "another capacity, the unit of the current (mA?), the cells in parallel ("
    )
    said = (text, Option("parallel", letter="N"), "), or an offset of the current over days?")
    return [Notice(Code.TOO_MUCH_CHARGE, said, log=_name(log), size_V=FIRST_V)]


def reference_notices(log: CellLog, reference: FloatArray | None) -> list[Notice]:
    """That a reference leaves 0..1 by more than capacities of one cell differ: it is no SOC."""
    if reference is None:
        return []
    low, high = float(np.nanmin(reference)), float(np.nanmax(reference))
    if max(-low, high - 1.0) <= MOST_CHARGE - 1.0:
        return []
    text = (
        f": the reference runs from SOC {low:.2f} to {high:.2f}, where no cell is: every error of "
        "the SOC is its own. Check "
    )
    said = (text, Option("reference_capacity_Ah", letter="X"), " and ",
            Option("reference_soc0", letter="X"))  # fmt: skip
    return [Notice(Code.SOC_OUTSIDE, said, log=_name(log), size_V=FIRST_V)]


def error_notices(
    model: CellModel | None, log: CellLog, error_V: FloatArray, soc: FloatArray
) -> list[Notice]:
    """An error beyond what the model states of itself, overall or at some SOC: where it is largest.

    A model of logs that contradict each other states a large error, so one of `NO_MODEL_V`
    is said whatever is stated.

    Parameters
    ----------
    error_V : (n,) float      measured minus model, NaN where nothing was measured
    soc : (n,) float
    """
    all_rows = error_metrics(error_V)
    if model is None or all_rows.samples == 0:
        return []
    stated_V = stated_error_V(model, log, soc, log.voltage_V - error_V)
    of_stated = error_V / np.maximum(stated_V, LEAST_V)
    everywhere = error_metrics(of_stated).rmse_V > FAR_DEVIATIONS
    somewhere = max(b.rmse_V for b in band_metrics(of_stated, soc)) > FAR_DEVIATIONS
    if not (everywhere or somewhere or all_rows.max_error_V >= NO_MODEL_V):
        return []
    row = int(np.nanargmax(np.abs(error_V)))
    at = round(float(soc[row]), 3) + 0.0  # no minus before zero
    said: tuple[Piece, ...] = (
        f" is up to {1e3 * all_rows.max_error_V:.0f} mV off (RMSE "
        f"{1e3 * all_rows.rmse_V:.0f} mV), most at SOC {at:.3f} ",
        RowPlace(f"after {(log.time_s[row] - log.time_s[0]) / 3600.0:.2f} h", range(row, row + 1)),
    )
    if everywhere:
        said += (": ", *OTHER, " than the model's, or another initial SOC?")
    elif at < NEAR_EMPTY:
        said += (": near empty, where the OCV is steep and the resistance high",)
    return [Notice(Code.MODEL_OFF, said, log=_name(log), size_V=all_rows.rmse_V)]


def prediction_notices(log: CellLog, rmse_V: float, rejected: float) -> list[Notice]:
    """A filter that used no voltage, or refuses many.

    Parameters
    ----------
    rmse_V : float        of the voltages predicted one step ahead; NaN: none was used
    rejected : float      share of the rows whose voltage was rejected
    """
    name = _name(log)
    if math.isnan(rmse_V) and np.any(np.isfinite(log.voltage_V)):
        text = f"no voltage of '{name}' was used: all are missing, or outside what a sensor reads"
        return [Notice(Code.VOLTAGE_UNUSED, f"{text} (another pack count?)", size_V=RANGE_V)]
    if math.isnan(rmse_V) or rejected < MOST_REJECTED:
        return []
    text = (
        f"the voltage of '{name}' is {1e3 * rmse_V:.0f} mV off one step ahead (RMSE) and was "
        f"rejected in {100.0 * rejected:.0f} % of the rows: "
    )
    size_V = max(rmse_V, RANGE_V * rejected)
    return [Notice(Code.VOLTAGE_REJECTED, (text, *OTHER, " than the model's?"), size_V=size_V)]


def stated_error_V(
    model: CellModel,
    log: CellLog,
    soc: FloatArray,
    voltage_V: FloatArray,
    *,
    other_resistance: float = 0.0,
) -> FloatArray:
    """Standard deviation of the voltage that the model states at every row, all time scales [V].

    Beyond the temperatures of the model's data it grows as the filters' error does.

    Parameters
    ----------
    soc, voltage_V : (n,) float      the model's, simulated or predicted
    other_resistance : float         share by which the cell's resistance may differ besides

    Returns
    -------
    (n,) float      at the log's median temperature
    """
    return _stated_at(model, soc, voltage_V, _usual_C(log), other_resistance)


def _stated_at(
    model: CellModel,
    soc: FloatArray | float,
    voltage_V: FloatArray | float,
    warm: float | None,
    other_resistance: float = 0.0,
) -> FloatArray:
    """The same at one temperature, None where it is not known [degC]."""
    at, error = np.clip(soc, 0.0, 1.0), model.error
    ocv = model.ocv_at(float(model.temperature_C[0]) if warm is None else warm)
    drop = np.interp(at, model.soc, ocv) - voltage_V
    share = np.where(drop >= 0.0, error.whole_share(1.0), error.whole_share(-1.0))
    share = np.hypot(share, other_resistance)
    slow = model.slow_error_V(at, warm)
    far, warm = validity_scalars(model), model.usual_temperature_C if warm is None else warm
    resting_V = extrapolation_V(far, warm, 0.0, 0.0)
    beyond = resting_V + (extrapolation_V(far, warm, 0.0, 1.0) - resting_V) * np.abs(drop)
    return np.asarray(np.sqrt(slow**2 + error.white_V**2 + (share * drop) ** 2 + beyond**2))
