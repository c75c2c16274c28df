"""Every estimator by its name, loaded when it is asked for; and an estimator of one's own."""

from __future__ import annotations

from importlib import import_module
from typing import NamedTuple, Protocol, cast

import numpy as np

from cellwise.arguments import choice, number, shown
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

# Where each stands: baselines need filterpy, the firmware a C compiler and the room above this one.
HOMES = {
    "coulomb": "cellwise.estimate.filters.coulomb:Coulomb",
    "ekf": "cellwise.estimate.filters.kalman:Ekf",
    "ukf": "cellwise.estimate.filters.kalman:Ukf",
    "adaptive": "cellwise.estimate.adaptive:Adaptive",
    "rest-ocv": "cellwise.estimate.filters.coulomb:RestOcv",
    "fixed-step": "cellwise.estimate.fixed.fixed_step:FixedStep",
    "firmware": "cellwise.export.firmware:Firmware",
    "filterpy-ekf": "cellwise.estimate.filters.filterpy_filters:FilterpyEkf",
    "filterpy-ukf": "cellwise.estimate.filters.filterpy_filters:FilterpyUkf",
}
ESTIMATORS = tuple(HOMES)


class FilterOutput(NamedTuple):
    """What a filter gives after a sample; what it does not know is NaN.

    ``soc`` is a fraction, ``soc_std`` its standard deviation; ``voltage_V`` is predicted before the
    sample's own voltage was used, ``voltage_std_V`` how well.
    """

    soc: float
    soc_std: float = float("nan")
    voltage_V: float = float("nan")
    voltage_std_V: float = float("nan")


class OnlineFilter(Protocol):
    """What an estimator of one's own has to offer, in `replay` and in the benchmark alike."""

    def start(self, soc0: float, soc0_std: float) -> None:
        """Forget everything; the SOC is ``soc0``, known to ``soc0_std``."""
        ...

    def step(
        self, current_A: float, voltage_V: float, temperature_C: float, dt_s: float
    ) -> FilterOutput | float:
        """Take the sample that ends an interval; the SOC, or a :class:`FilterOutput`.

        Positive current is discharge, and flowed during the interval. A missing reading is NaN;
        the first sample has ``dt_s`` = 0, and in a gap of the log the current is unknown.
        """
        ...


class Estimator(Protocol):
    """What replays a log at once: cellwise's own filters, and :class:`Adapted`."""

    name: str

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Estimate over a whole log from an initial SOC and its standard deviation."""
        ...


class Adapted:
    """An online filter as an estimator that replays logs."""

    def __init__(self, name: str, model: CellModel, filter_: OnlineFilter) -> None:
        self.name = name
        self.filter = filter_
        self._model = model

    def run(self, log: CellLog, soc0: float, soc0_std: float = 0.15) -> Trace:
        """Hand a whole log to the filter, sample by sample."""
        outputs = np.full((4, len(log)), np.nan)
        self.filter.start(soc0, soc0_std)
        for k, row in enumerate(samples(self._model, log).T.tolist()):
            answer = self.filter.step(*row)
            parts = answer if isinstance(answer, tuple) else (one_soc(answer, self.name),)
            outputs[: len(parts), k] = parts
        return trace_of(log, *outputs)


def one_soc(answer: object, name: str) -> float:
    """The SOC that somebody's filter answers with.

    Raises
    ------
    InputError        no number
    """
    return number(f"what {name}.step gives", answer, "the SOC, or a FilterOutput")


def samples(model: CellModel, log: CellLog) -> FloatArray:
    """Current, voltage, temperature, interval of every row, shape (4, n), as `step` takes them."""
    current = np.array(log.interval_current_A)
    current[log.gap_rows] = np.nan
    temperature = known_temperature_C(model, log)
    return np.vstack((current, log.voltage_V, temperature, log.interval_s))


def trace_of(
    log: CellLog,
    soc: FloatArray,
    std: FloatArray,
    voltage: FloatArray,
    voltage_std: FloatArray | None = None,
) -> Trace:
    """What somebody's filter answered, as ours answer."""
    missing = np.full(len(log), np.nan)
    variance = missing if voltage_std is None else voltage_std**2
    status = np.zeros(len(log), dtype=np.int32)
    left = log.voltage_V - voltage
    return Trace(log.time_s, soc, std, voltage, left, variance, missing, status)


def make_estimator(name: str, model: CellModel, noise: Noise | None = None) -> Estimator:
    """An estimator by its name in the command line, in any case.

    Raises
    ------
    InputError        a name that is not known
    """
    module, kind = HOMES[choice("estimator", name, ESTIMATORS)].split(":")
    return cast(Estimator, getattr(import_module(module), kind)(model, noise))


def estimator_of(
    given: str | Estimator | OnlineFilter, model: CellModel, noise: Noise | None = None
) -> Estimator:
    """What replays a log, from whatever was given: a name, a filter, an estimator of one's own.

    Raises
    ------
    InputError        something else
    """
    if isinstance(given, str):
        return make_estimator(given, model, noise)
    online = all(callable(getattr(given, name, None)) for name in ("start", "step"))
    if isinstance(given, type) or not (online or hasattr(given, "run")):
        kind = getattr(given, "__name__", "Ekf")
        raise InputError(
            f"estimator = {shown(given)}",
            f"a name of {', '.join(ESTIMATORS)}, a filter, or an object with start and step",
            f"Write replay(model, log, 'ekf', soc0=0.9), or make the filter: {kind}(model).",
        )
    if hasattr(given, "run"):
        return cast(Estimator, given)
    return Adapted(str(getattr(given, "name", type(given).__name__)), model, given)
