"""EKF and UKF: what they share (start, online step, replay of a whole log), and each of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwise.arguments import check_kind, number
from cellwise.cell.compiled import announce, for_kernel
from cellwise.cell.description import CELL
from cellwise.cell.model import CellModel
from cellwise.cell.packed import row_of, size_of
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.cell.point_kernels import M
from cellwise.cell.simulate import check_soc0, check_soc0_std
from cellwise.errors import InputError
from cellwise.estimate.filters import filter_state as layout
from cellwise.estimate.filters.bank_kernels import (
    COMPONENTS,
    RECORD,
    empty_bank,
)
from cellwise.estimate.filters.filter_state import (
    EkfInfo,
    EkfStart,
    EkfState,
    TraceArrays,
    ekf_start,
)
from cellwise.estimate.filters.kalman_kernels import kalman_rows, kalman_step_of_rows
from cellwise.estimate.filters.sigma_kernels import SigmaScalars
from cellwise.estimate.noise import Noise, noise_for
from cellwise.estimate.sensing_kernels import MeasuredSample
from cellwise.estimate.trace import Trace
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.units import check_is_log
from cellwise.typing import FloatArray

STATES = len(CELL)
FIELDS = size_of(EkfState)
MOST_COMPONENTS = 101


class FilterOfModel:
    """A model, its noise, and where a state begins: what every Kalman filter here stands on.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None     None: from the model's own validation error
    """

    name = ""

    def __init__(self, model: CellModel | None = None, noise: Noise | None = None) -> None:
        self.model = model = check_is_model(model)
        self.noise = noise_for(model, noise)
        self._tables = model.parameters()
        self._default_C = model.usual_temperature_C

    def start(self, soc0: float, soc0_std: float = 0.15) -> EkfStart:
        """Start at ``soc0``, known to ``soc0_std``.

        Raises
        ------
        InputError        soc0 outside 0..1, soc0_std not above zero
        """
        soc0 = check_soc0(soc0)
        check_soc0_std(soc0_std)
        table = self._tables.table
        return EkfStart(
            soc=float(soc0),
            variance=float(soc0_std) ** 2,
            hysteresis_variance=1.0 if np.any(table[..., M]) else 0.0,
            temperature_C=self._default_C,
        )


def check_components(components: object) -> int:
    """How many filters look for a start that is not known.

    Raises
    ------
    InputError        no whole number from 1 to MOST_COMPONENTS
    """
    if (
        isinstance(components, bool)
        or not isinstance(components, int)
        or not 1 <= components <= MOST_COMPONENTS
    ):
        raise InputError(
            f"components = {components!r}",
            f"a whole number from 1 (one filter alone) to {MOST_COMPONENTS}",
            f"Leave it out for {COMPONENTS}.",
        )
    return components


class BankState(EkfState):
    """The estimate of a bank: ``bank`` has its components, which a step goes on with."""

    bank: FloatArray

    @classmethod
    def of_bank(cls, bank: FloatArray) -> BankState:
        """The state whose numbers these are."""
        state: BankState = cls._make(EkfState.of_row(bank[0, :FIELDS]))
        state.bank = bank
        return state


def bank_of(state: EkfState, components: int) -> FloatArray:
    """A state's memory: its components', or room for them."""
    if isinstance(state, BankState):
        return state.bank.copy()
    bank = empty_bank(components)
    bank[0, :FIELDS] = state.row()
    return bank


def state_of(bank: FloatArray) -> EkfState:
    """What a step carries on: the estimate alone, or with its components."""
    if bank[RECORD, 0] > 0.0:
        return BankState.of_bank(bank)
    return EkfState.of_row(bank[0, :FIELDS])


class KalmanFilter(FilterOfModel):
    """A filter over SOC, branch voltages and hysteresis: with sigma points, or by derivatives."""

    sigma: SigmaScalars | None = None

    def __init__(
        self,
        model: CellModel | None = None,
        noise: Noise | None = None,
        *,
        components: int = COMPONENTS,
    ) -> None:
        super().__init__(model, noise)
        self.components = check_components(components)
        self._noise = self.noise.scalars(self.model)
        self._unknown = self.start(0.5, 0.3)  # for a state that is no longer finite: know nothing
        self._constants = row_of(self._tables.cell, self._noise, self._unknown)

    def init(self, soc0: float, soc0_std: float = 0.15, current_A: float = 0.0) -> EkfState:
        """State at ``soc0`` that is known to ``soc0_std``; see :meth:`start`.

        ``current_A`` is what is held if the first current is missing. What the branches hold is
        guessed at the first sample: nearly nothing at rest, about half the load's steady voltage
        under load.
        """
        return ekf_start(self.start(soc0, soc0_std), float(current_A))

    def step(
        self,
        state: EkfState,
        current_A: float,
        voltage_V: float,
        temperature_C: float | None = None,
        *,
        dt_s: float,
        gap: bool = False,
    ) -> tuple[EkfState, EkfInfo]:
        """Take the sample that ends an interval of ``dt_s`` seconds.

        A missing voltage (NaN) gives a prediction, a missing current holds the last one for
        ``Noise.hold_s``, a missing temperature the last one that was measured, or the model's own;
        all are flagged in ``Info.status``.

        Raises
        ------
        InputError        dt_s negative or not finite; a state or a reading of another type
        """
        check_state(state, EkfState, self.name)
        reading = reading_from(current_A, voltage_V, temperature_C, dt_s, gap)
        announce(kalman_step_of_rows, f"the {self.name} step")
        bank, info = bank_of(state, self.components), np.empty(layout.OUTPUTS)
        tables = self._tables
        status = kalman_step_of_rows(
            tables.table, tables.grid_C, self._constants, self.sigma, bank, *reading, info
        )
        return state_of(bank), EkfInfo._make((*info.tolist(), status))

    def run(self, log: CellLog, soc0: float | None = None, soc0_std: float = 0.15) -> Trace:
        """Replay a whole log from `known_start`; the same steps in one compiled loop."""
        soc0, n = known_start(log, soc0), len(log)
        out = TraceArrays(np.empty((layout.OUTPUTS, n)), np.empty(n, dtype=np.int32))
        announce(kalman_rows, f"the estimator '{self.name}'")
        start, rows = self.start(soc0, soc0_std), log_arrays(log)
        bank, tables = empty_bank(self.components), self._tables
        kalman_rows(tables, self._noise, self.sigma, start, self._unknown, bank, rows, out)
        return Trace(**trace_fields(log, out))


def trace_fields(log: CellLog, out: TraceArrays) -> dict[str, Any]:
    """What every filter writes, by its name in a trace."""
    v = out.values
    return {
        "time_s": log.time_s,
        "soc": v[layout.OUT_SOC],
        "soc_std": v[layout.OUT_STD],
        "voltage_V": v[layout.OUT_VOLTAGE],
        "innovation_V": v[layout.OUT_INNOVATION],
        "innovation_variance_V2": v[layout.OUT_VARIANCE],
        "test_ratio": v[layout.OUT_RATIO],
        "status": out.status,
    }


def reading_from(
    current_A: float, voltage_V: float, temperature_C: float | None, dt_s: float, gap: bool
) -> MeasuredSample:
    """What an online step is given, as the kernels read it.

    Raises
    ------
    InputError        dt_s negative or not finite; a reading that is no number
    """
    interval = number("dt_s", dt_s, "seconds, at least 0", "Pass the interval's length.")
    if not (math.isfinite(interval) and interval >= 0.0):
        raise InputError(f"dt_s = {dt_s}", "seconds, at least 0", "Pass the interval's length.")
    return MeasuredSample(
        one_reading("current_A", current_A, "ampere"),
        one_reading("voltage_V", voltage_V, "volt"),
        math.nan if temperature_C is None else one_reading("temperature_C", temperature_C, "degC"),
        interval,
        bool(gap),
    )


def one_reading(name: str, value: object, unit: str) -> float:
    """One reading of one sensor.

    Raises
    ------
    InputError        no number
    """
    expected = f"a number in {unit}, nan where the reading is missing"
    return number(name, value, expected, "A step takes one sample; `run` takes a whole log.")


def check_state(state: object, kind: type, name: str) -> None:
    """Refuse what another estimator made, or nothing did.

    Raises
    ------
    InputError        another type
    """
    check_kind("state", state, kind, f"Begin with init(soc0) of the {name}, and pass on its own.")


def known_start(log: CellLog, soc0: float | None) -> float:
    """The SOC that a filter begins a log with; None: what is stated of the log.

    Raises
    ------
    InputError        what is no log; nothing is stated of it either
    """
    check_is_log(log)
    known = log.soc0 if soc0 is None else soc0
    if known is None:
        raise InputError(
            "soc0 = None for a log whose initial SOC is not stated",
            "a fraction from 0 to 1",
            "Write run(log, 0.9), say; replay(model, log) finds it in the log.",
        )
    return known


def log_arrays(log: CellLog) -> layout.LogArrays:
    """The rows of a log as the kernels read them."""
    check_is_log(log)
    # What the tester's counter says of a gap is not for the filter's eyes.
    return layout.LogArrays(
        for_kernel(log.interval_current_A),
        for_kernel(log.voltage_V),
        measured_temperature_C(log),
        log.interval_s,
        log.gap_rows,
    )


def measured_temperature_C(log: CellLog) -> FloatArray:
    """Temperature of every row as measured, NaN where nobody did, shape (rows,)."""
    if log.temperature_C is None:
        return np.full(len(log), np.nan)
    return for_kernel(log.temperature_C)


class Ekf(KalmanFilter):
    """EKF over SOC, branch voltages and hysteresis.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None     None: from the model's own validation error
    components : int          filters side by side while the SOC is not known; 1: one alone

    Examples
    --------
    >>> ekf = Ekf(model)                                            # doctest: +SKIP
    >>> state = ekf.init(soc0=0.5, soc0_std=0.2)                    # doctest: +SKIP
    >>> state, info = ekf.step(state, 1.2, 3.71, 25.0, dt_s=0.1)    # doctest: +SKIP
    """

    name = "ekf"


@dataclass(frozen=True)
class SigmaPoints:
    """Scaled sigma points of a state of five: spread alpha, prior beta, secondary kappa.

    The defaults put the outer points at sqrt(3) standard deviations with the weights of a
    three-point Gauss-Hermite rule, whatever the number of states. While the SOC's standard
    deviation is below ``resistances_from`` every point has the resistances of the mean, as in the
    EKF: a resistance that is off must not vouch for the SOC. 0: each has those of its own SOC.

    Source: E. Wan, R. van der Merwe, The unscented Kalman filter for nonlinear estimation, 2000,
    10.1109/ASSPCC.2000.882463.
    """

    alpha: float = 1.0
    beta: float = 0.0
    kappa: float = 3.0 - STATES
    resistances_from: float = 0.02

    def __post_init__(self) -> None:
        if not (
            np.all(np.isfinite([*vars(self).values()]))
            and self.alpha > 0.0
            and self.kappa > -STATES
            and self.resistances_from >= 0.0
        ):
            raise InputError(
                f"sigma points with {vars(self)}",
                f"alpha above 0, kappa above -{STATES}, resistances_from at least 0, all finite",
                "Leave them out, or give e.g. alpha = 1, beta = 0, kappa = -2.",
            )

    def scalars(self) -> SigmaScalars:
        """What the kernels take."""
        square = self.alpha**2 * (STATES + self.kappa)
        side = 0.5 / square
        centre = (square - STATES) / square + 1.0 - self.alpha**2 + self.beta
        centre += 2.0 * (STATES - 1) * side  # every point of that SOC
        curve = 2.0 * side * (0.5 - side) ** 2 + centre * side * side
        wide = float(self.resistances_from) ** 2
        return SigmaScalars(float(np.sqrt(square)), float(side), float(curve), wide)


class Ukf(KalmanFilter):
    """UKF over SOC, branch voltages and hysteresis.

    Parameters
    ----------
    model : CellModel
    noise : Noise or None     None: from the model's own validation error
    points : SigmaPoints      how far out the sigma points lie and how they weigh
    components : int          as of :class:`Ekf`
    """

    name = "ukf"

    def __init__(
        self,
        model: CellModel,
        noise: Noise | None = None,
        points: SigmaPoints | None = None,
        *,
        components: int = COMPONENTS,
    ) -> None:
        super().__init__(model, noise, components=components)
        self.points = SigmaPoints() if points is None else points
        self.sigma = self.points.scalars()
