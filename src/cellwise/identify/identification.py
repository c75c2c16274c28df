"""What identification takes and what it gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from cellwise.arguments import check_kind, choice, number, shown
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.metrics import ErrorMetrics
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation
from cellwise.errors import InputError
from cellwise.fit.solve import FitResult
from cellwise.identify.capacity.capacity_test import CapacityTest
from cellwise.identify.hppc.pulse_quality import Pulse
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.pulse_fit.circuit import PulseFit
from cellwise.identify.pulse_fit.fit_pulse import Method, fit_pulse
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.identify.tables import TableKind
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice, texts
from cellwise.plotting import Panel, Plottable, Summarised, Tabular
from cellwise.typing import BoolArray, FloatArray

REFERENCE_C = 25.0


@dataclass(frozen=True)
class IdentifySettings:
    """How to identify.

    Parameters
    ----------
    nominal_Ah : float or None         rated capacity; what rates are named after
    capacity_choice : str or None      which capacity defines SOC; None: the slowest discharge
    method : str                       how single pulses are fitted
    tables : str                       ``spline`` or the paper's ``cubic`` over SOC
    refine : bool                      fit whole logs; else the tables are those of single pulses
    branches : int                     2 (plain Thevenin) or 3 (with the slow branch)
    hysteresis : bool or None          None: where the cell is of the class of LFP
    temperature_C : float or None      temperature of the tests where no log measures it
    prior : CellModel or None          a model of such a cell to start from, of any capacity; of a
                                       stock model, as with None, the class of its chemistry
    name, chemistry : str              written into the model
    without_lineage : tuple of str     stock models left out of the prior, with all of their cells

    Raises
    ------
    InputError        a method, tables or branches that there are not; what is no number, no model
    """

    nominal_Ah: float | None = None
    capacity_choice: str | None = None
    method: Method = "varpro"
    tables: TableKind = "spline"
    refine: bool = True
    branches: int = 3
    hysteresis: bool | None = None
    temperature_C: float | None = None
    prior: CellModel | None = None
    without_lineage: tuple[str, ...] = ()
    name: str = ""
    chemistry: str = ""

    def __post_init__(self) -> None:
        for field_, names in (("method", get_args(Method)), ("tables", get_args(TableKind))):
            object.__setattr__(self, field_, choice(field_, getattr(self, field_), names))
        if self.branches not in (2, 3):
            raise InputError(f"branches = {shown(self.branches)}", "2 or 3", "Choose one of them.")
        for field_ in ("nominal_Ah", "temperature_C"):
            if (value := getattr(self, field_)) is not None:
                object.__setattr__(self, field_, number(field_, value, "a number, or None"))
        if self.prior is not None:
            check_kind("prior", self.prior, CellModel, "Write stock_model('nmc-18650'), say.")


@dataclass(frozen=True, eq=False)
class CellTests:
    """Logs of one cell by what they are; an HPPC or drive log may say its temperature [degC].

    Parameters
    ----------
    hppc, drive : a log, logs, or pairs of a log and its stated temperature [degC] or None
    ocv, capacity : a log, or logs

    Raises
    ------
    InputError        something else
    """

    hppc: tuple[tuple[CellLog, float | None], ...] = ()
    ocv: tuple[CellLog, ...] = ()
    capacity: tuple[CellLog, ...] = ()
    drive: tuple[tuple[CellLog, float | None], ...] = ()

    def __post_init__(self) -> None:
        for name in ("hppc", "drive"):
            object.__setattr__(self, name, tuple(_pairs(getattr(self, name), name)))
        for name in ("ocv", "capacity"):
            pairs = _pairs(getattr(self, name), name)
            object.__setattr__(self, name, tuple(log for log, _ in pairs))

    def logs(self) -> tuple[CellLog, ...]:
        """Every log once."""
        driven = [log for log, _ in (*self.hppc, *self.drive)]
        every = {id(log): log for log in (*driven, *self.ocv, *self.capacity)}
        return tuple(every.values())

    def only(self, keep: Callable[[CellLog], bool]) -> CellTests:
        """Those of the logs that are wanted."""
        return CellTests(
            hppc=tuple(pair for pair in self.hppc if keep(pair[0])),
            ocv=tuple(filter(keep, self.ocv)),
            capacity=tuple(filter(keep, self.capacity)),
            drive=tuple(pair for pair in self.drive if keep(pair[0])),
        )

    def sources(self) -> dict[str, list[str]]:
        """Where the logs of each kind came from, for a model's provenance."""
        kinds = {
            "hppc": [log for log, _ in self.hppc],
            "ocv": self.ocv,
            "capacity": self.capacity,
            "drive": [log for log, _ in self.drive],
        }
        return {k: list(dict.fromkeys(o.source or o.name for o in v)) for k, v in kinds.items()}


def _pairs(logs: Any, name: str) -> list[tuple[CellLog, float | None]]:
    """Logs with the temperature that is stated of each, whichever way they were given."""
    several = isinstance(logs, (tuple, list)) and not _is_pair(logs)
    pairs = [
        (one, None) if isinstance(one, CellLog) else one for one in (logs if several else [logs])
    ]
    for one in pairs:
        if not _is_pair(one):
            raise InputError(
                f"{name} of CellTests with a {type(one).__name__}",
                "a log, logs, or pairs of a log and its temperature [degC]",
                f"Write CellTests({name}=read_log('a.csv')) or "
                f"CellTests({name}=[(cold, -10.0), (warm, 25.0)]).",
            )
    return [(log, stated) for log, stated in pairs]


def _is_pair(one: Any) -> bool:
    """Whether it is a log and its temperature or None."""
    return (
        isinstance(one, (tuple, list))
        and len(one) == 2
        and isinstance(one[0], CellLog)
        and (one[1] is None or (isinstance(one[1], (int, float)) and not isinstance(one[1], bool)))
    )


def log_temperature_C(log: CellLog, stated: float | None, default: float = REFERENCE_C) -> float:
    """Temperature of a log: stated, else its measured median, else the default [degC]."""
    if stated is not None:
        return float(stated)
    if log.temperature_C is not None and np.any(np.isfinite(log.temperature_C)):
        return float(np.nanmedian(log.temperature_C))
    return default


@dataclass(frozen=True, eq=False)
class PulseSet:
    """The pulses of one HPPC log, the ``windows`` of those that are healthy, and how to fit them.

    ``anchor`` is where the log begins.
    """

    log: CellLog
    anchor: InitialSoc
    pulses: tuple[Pulse, ...]
    windows: tuple[PulseData, ...]
    method: Method = "varpro"

    @cached_property
    def fits(self) -> tuple[PulseFit, ...]:
        """Their parameters, of those with enough rows; fitted when first asked for."""
        rng = np.random.default_rng(0)  # one for all: alike draws of a swarm would err alike
        found = []
        for window in self.windows:
            with suppress(InputError):  # too few rows
                found.append(fit_pulse(window, self.method, rng))
        return tuple(found)


@dataclass(frozen=True, eq=False)
class TemperatureResult:
    """Everything found at one temperature."""

    temperature_C: float
    pulse_sets: tuple[PulseSet, ...]
    refinement: FitResult | None


class Start(NamedTuple):
    """A log, the SOC at which it begins, the rows that are compared, and why it is left out.

    ``rows`` None: all; ``left_out`` empty: it takes part in the fit; ``capacity_scale``: what its
    cell held over the capacity of the model.
    """

    log: CellLog
    soc0: float
    rows: BoolArray | None = None
    left_out: str = ""
    capacity_scale: float = 1.0


@dataclass(frozen=True)
class Decided:
    """An effect that was tried: whether the model has it, its gain on held-out loads, and why."""

    name: str
    accepted: bool
    gain: float | None
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """As the command prints it."""
        return vars(self)


class LogErrors(NamedTuple):
    """RMSE of the fit and of the plain model over one log, fitted on it or without it [V]."""

    log: str
    left_out: bool
    fit_V: float
    plain_V: float


class PlainComparison(NamedTuple):
    """The fit against a plain model of the same logs.

    ``fit_V``, ``plain_V``: RMSE over all own logs and all that were left out, each of the same
    weight [V]; ``gain`` the 95 % interval of what the fit gains; ``reason``: why the plain model
    is handed out, empty where the fit is.
    """

    fit_V: float
    plain_V: float
    gain: tuple[float, float]
    logs: tuple[LogErrors, ...]
    reason: str

    @property
    def notice(self) -> Notice | None:
        """What a person must read first; None where the fit is handed out."""
        if not self.reason:
            return None
        text = (
            f"{self.reason}: the plain one is handed out (low-rate curve, R0, two branches, no "
            "effects, a wide posterior). A fault of the logs, of a chemistry or prior that was "
            "stated, or of the fit: please report that"
        )
        return Notice(Code.PLAIN_MODEL, text)

    def to_dict(self) -> dict[str, Any]:
        """As the command prints it."""
        return {
            "handed_out": "plain" if self.reason else "fit",
            "fit_rmse_V": self.fit_V,
            "plain_rmse_V": self.plain_V,
            "gain": list(self.gain),
            "logs": [
                {"log": x.log, "left_out": x.left_out, "fit_rmse_V": x.fit_V,
                 "plain_rmse_V": x.plain_V}
                for x in self.logs
            ],
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Fitted:
    """What a fit gives, of laboratory tests or from a prior: the model and where it comes from.

    Of a `FitResult` (unknowns) a `JointFit` makes a model with effects, this adds its error, OCV
    and pulses, and an `Identification` the own logs.
    ``starts`` holds every log that was given; ``provenance`` the stations' own entries.
    """

    model: CellModel
    ocv: OcvCurve
    starts: tuple[Start, ...]
    temperatures: tuple[TemperatureResult, ...]
    decided: tuple[Decided, ...] = ()
    choices_Ah: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    contradictions: tuple[Notice, ...] = ()
    notices: tuple[Notice, ...] = ()
    plain: PlainComparison | None = None


Role = Literal["hppc", "ocv", "capacity", "drive"]


@dataclass(frozen=True, eq=False)
class OwnLog:
    """A log of the identification simulated back from ``start``, where its model finds it to begin.

    ``used`` says whether it took part in the fit; ``compared`` are the rows that did (None: all);
    ``sides_V`` the RMSE of discharge and charge of a low-rate or capacity test; ``reason`` why it
    did not take part, or what remains and where that comes from; ``prior_rmse_V`` what the model
    that was updated leaves of the rows compared (None: no prior, or no part in the fit) [V].
    """

    role: Role
    used: bool
    simulation: Simulation
    start: InitialSoc
    compared: BoolArray | None
    sides_V: Mapping[str, float]
    reason: str
    prior_rmse_V: float | None = None

    @property
    def compared_V(self) -> FloatArray:
        """Errors of the rows that were compared [V]."""
        error = self.simulation.residual_V
        return error if self.compared is None else error[self.compared]

    def to_dict(self) -> dict[str, Any]:
        """As the command prints it."""
        s = self.simulation
        return {
            "log": s.log.name,
            "role": self.role,
            "used": self.used,
            "soc0": s.soc0,
            "soc0_std": self.start.std,
            "soc0_how": self.start.how,
            "rmse_V": s.rmse_V,
            "rmse_above_10pct_V": s.rmse_above_10pct_V,
            "prior_rmse_V": self.prior_rmse_V,
            **{f"{name}_rmse_V": value for name, value in self.sides_V.items()},
            "reason": self.reason,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Plottable, Summarised, Tabular):
    """A model and all that led to it.

    ``contradictions`` are those of ``notices`` that say which logs do not go together, by numbers:
    what a person must read before the figures, after why the plain model is handed out, if it is.
    ``plain`` is how it compares with the fit; None of pulses alone. ``capacities`` are all choices
    [Ah], ``capacity_choice`` the one that was taken, ``capacity_tests`` what they are made of;
    ``ocv`` is the curve of the tests, ``temperatures`` hold the pulses of each; ``own_logs`` are
    all logs simulated back, ``decided`` the effects that were tried, ``seconds`` what it took.
    """

    model: CellModel
    capacity_choice: str
    capacities: Mapping[str, float]
    capacity_tests: tuple[CapacityTest, ...]
    ocv: OcvCurve
    temperatures: tuple[TemperatureResult, ...]
    own_logs: tuple[OwnLog, ...]
    decided: tuple[Decided, ...]
    fit: ErrorMetrics
    notices: tuple[Notice, ...]
    seconds: float
    contradictions: tuple[Notice, ...] = ()
    plain: PlainComparison | None = None

    @property
    def simulations(self) -> tuple[Simulation, ...]:
        """The pulse tests and drives that took part in the fit, simulated back."""
        return tuple(o.simulation for o in self.own_logs if o.used and o.role in ("hppc", "drive"))

    @property
    def pulse_counts(self) -> dict[str, int]:
        """Number of pulses by quality, moves left out."""
        counts = dict.fromkeys(("healthy", "trimmed", "distorted", "spurious"), 0)
        for found in self.temperatures:
            for one in found.pulse_sets:
                short = [p for p in one.pulses if p.role == "pulse"] or list(one.pulses)
                for pulse in short:
                    counts[pulse.quality] += 1
        return counts

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """As of its model."""
        return self.model.panels()

    def columns(self) -> dict[str, FloatArray]:
        """The tables of its model with their standard errors."""
        return self.model.columns()

    def facts(self) -> dict[str, str]:
        """Of its model, then how well it says its own logs again."""
        counts = self.pulse_counts
        return {
            **self.model.facts(),
            "capacity by": self.capacity_choice,
            "RMSE on its own logs": "; ".join(
                f"{s.log.name or 'log'} {1e3 * s.rmse_V:.1f} mV" for s in self.simulations
            ),
            "healthy pulses": f"{counts['healthy']} of {sum(counts.values())}",
            "notices": "; ".join(texts(self.notices)) or "none",
        }

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON values, keys as the command prints them."""
        return {
            "capacity_Ah": self.model.capacity_Ah,
            "capacity_choice": self.capacity_choice,
            "capacities": dict(self.capacities),
            "pulses": self.pulse_counts,
            "fit": {
                "rmse_V": self.fit.rmse_V,
                "mae_V": self.fit.mae_V,
                "max_error_V": self.fit.max_error_V,
                "logs": {
                    s.log.name or f"log {k}": s.rmse_V for k, s in enumerate(self.simulations)
                },
            },
            "temperatures_C": [t.temperature_C for t in self.temperatures],
            "own_logs": [o.to_dict() for o in self.own_logs],
            "plain_model": None if self.plain is None else self.plain.to_dict(),
            "effects": self._effects(),
            "validity": self.model.validity.to_dict(),
            "posterior": None if self.model.posterior is None else self.model.posterior.to_dict(),
            "error": self.model.error.to_dict(),
            "notices": texts(self.notices),
            "seconds": self.seconds,
        }

    def _effects(self) -> list[dict[str, Any]]:
        """Effects that were tried, and those that the model has without a trial."""
        rows = {d.name: d for d in self.decided}
        for effect in self.model.effects:
            why = "part of every model whose logs can show it"
            rows.setdefault(effect.name, Decided(effect.name, True, None, why))
        return [d.to_dict() for d in rows.values()]

    def __repr__(self) -> str:
        return (
            f"Identification({self.model!r}, capacity by {self.capacity_choice}, "
            f"RMSE {1e3 * self.fit.rmse_V:.1f} mV on its own logs, {self.seconds:.1f} s)"
        )
