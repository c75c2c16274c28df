"""CellModel: what is known of one kind of cell, validated and frozen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from cellwise.arguments import check_kind, number, numbers, shown
from cellwise.cell.description import State
from cellwise.cell.effects import (
    BRANCH_ACTIVATIONS,
    EFFECTS,
    Effect,
    Entropy,
    Hysteresis,
    SlowDiffusion,
    TemperatureDependence,
    check_effect,
    effect_table,
)
from cellwise.cell.equations import ZERO_CELSIUS_K, CellTables
from cellwise.cell.model_error import ModelError
from cellwise.cell.plausibility.validity import UNKNOWN, Validity, beyond_soc
from cellwise.cell.point_kernels import COLUMN_SOURCES, SCALAR_SOURCES, CellScalars
from cellwise.cell.posterior import Posterior, table_std
from cellwise.cell.unrolled import CALLED
from cellwise.errors import InputError
from cellwise.plotting import Line, Panel, Plottable, Summarised, Tabular
from cellwise.typing import FloatArray

E = TypeVar("E", bound=Effect)
# Share of the mean slope of the OCV over SOC by which its slope may be off where no data were.
UNKNOWN_SLOPE = 0.5
CAPACITY_STD = 0.02  # of a cell whose own tests the model is of: samples, and how it was tested


class ModelTables(NamedTuple):
    """The six tables in the order in which CellModel takes them, each of shape (points,)."""

    ocv_V: FloatArray
    r0_ohm: FloatArray
    r1_ohm: FloatArray
    tau1_s: FloatArray
    r2_ohm: FloatArray
    tau2_s: FloatArray


TABLES = ModelTables._fields
RESISTANCES = ("r0_ohm", "r1_ohm", "r2_ohm")

USUAL_C = 25.0  # where tests are made, and rooms are


# A model without a branch has one that nobody can see: 0.1 uV at 1 A.
NO_BRANCH_OHM = 1e-7
SOC_END = 0.005  # an OCV table that begins or ends no further inside reaches empty and full


@dataclass(frozen=True, eq=False, repr=False)
class CellModel(Plottable, Summarised, Tabular):
    """Second-order Thevenin model with SOC-indexed tables and effects.

    v = OCV(soc) - R0 I - V1 - V2 [- V3 + M h], discharge current positive.

    Parameters
    ----------
    capacity_Ah : float            charge between SOC 1 and SOC 0
    ocv_V : (temperatures, points) float
        over a uniform SOC grid from 0 to 1; a single temperature may be given as (points,); of
        another grid: :meth:`from_ocv`
    r0_ohm, r1_ohm, tau1_s, r2_ohm, tau2_s : (temperatures, points) float
        over the same grid; one row, or one number, stands for all; without r1 or r2 there is no
        such branch
    temperature_C : (temperatures,) float      ascending
    effects : tuple of Effect      extensions, at most one of a kind
    charge_efficiency : float      share of the charge put in that can be taken out, 0.5..1.05
    error : ModelError             voltage error on every time scale, from loads no fit has seen
    posterior : Posterior or None  what the fit left open; the error holds it already
    validity : Validity            SOC, temperature and current that its data covered
    voltage_min_V, voltage_max_V : float or None   the cell's limits
    name, chemistry : str
    provenance : mapping           where every number came from: log, method, standard error,
                                   capacity choice; JSON values only

    Raises
    ------
    InputError        a table that is not finite, not positive, of the wrong shape; an OCV that
                      falls with SOC; tau1 >= tau2; capacity not positive
    """

    capacity_Ah: float
    ocv_V: FloatArray
    r0_ohm: FloatArray
    r1_ohm: FloatArray = field(default_factory=lambda: np.array(NO_BRANCH_OHM))
    tau1_s: FloatArray = field(default_factory=lambda: np.array(10.0))
    r2_ohm: FloatArray = field(default_factory=lambda: np.array(NO_BRANCH_OHM))
    tau2_s: FloatArray = field(default_factory=lambda: np.array(1000.0))
    temperature_C: FloatArray = field(default_factory=lambda: np.array([USUAL_C]))
    effects: tuple[Effect, ...] = ()
    charge_efficiency: float = 1.0
    error: ModelError = field(default_factory=ModelError)
    posterior: Posterior | None = None
    validity: Validity = UNKNOWN
    voltage_min_V: float | None = None
    voltage_max_V: float | None = None
    name: str = ""
    chemistry: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        capacity = number("capacity_Ah", self.capacity_Ah, "a capacity above zero [Ah]")
        object.__setattr__(self, "capacity_Ah", capacity)
        shape = np.atleast_2d(numbers("ocv_V", self.ocv_V)).shape
        for name in (*TABLES, "temperature_C"):
            table = np.array(numbers(name, getattr(self, name)), ndmin=1)
            if name != "temperature_C":
                table = _spread_over(np.atleast_2d(table), shape)
            table.setflags(write=False)
            object.__setattr__(self, name, table)
        _check_parts(self)
        object.__setattr__(self, "effects", tuple(self.effects))
        check_model(self)

    @classmethod
    def from_ocv(
        cls,
        soc: ArrayLike,
        ocv_V: ArrayLike,
        *,
        capacity_Ah: float,
        r0_ohm: ArrayLike,
        r1_ohm: ArrayLike = NO_BRANCH_OHM,
        tau1_s: ArrayLike = 10.0,
        r2_ohm: ArrayLike = NO_BRANCH_OHM,
        tau2_s: ArrayLike = 1000.0,
        points: int = 201,
        error: ModelError | None = None,
        name: str = "",
    ) -> CellModel:
        """A model by hand, without identification: an OCV table and a few numbers.

        Parameters
        ----------
        soc, ocv_V : (n,) float           points of the OCV from SOC 0 to 1, at any spacing
        capacity_Ah : float               charge between SOC 1 and SOC 0
        r0_ohm, r1_ohm, tau1_s, r2_ohm, tau2_s : float or (n,) float
            one number for all SOC, or one at each of ``soc``; without r1 or r2 no such branch
        points : int                      of the even SOC grid, linear between the given ones
        error : ModelError or None        what its voltage may be off by; None: the usual 10 mV
        name : str

        Raises
        ------
        InputError        a SOC that is not from 0 to 1 in order, tables of other lengths, and what
                          the constructor refuses
        """
        given, order = _soc_points(numbers("soc", soc))
        grid = _even_grid(points)
        tables: dict[str, Any] = {}
        values = (ocv_V, r0_ohm, r1_ohm, tau1_s, r2_ohm, tau2_s)
        for key, value in zip(TABLES, values, strict=True):
            table = numbers(key, value)
            if table.shape not in ((), given.shape) or (key == "ocv_V" and table.ndim == 0):
                raise InputError(
                    f"{key} of shape {table.shape} at {given.size} points of SOC",
                    "a value at every point" + ("" if key == "ocv_V" else ", or one number"),
                    "Give both the same length.",
                )
            tables[key] = table if table.ndim == 0 else np.interp(grid, given, table[order])
        return cls(capacity_Ah, **tables, error=error or ModelError(), name=name)

    def columns(self) -> dict[str, FloatArray]:
        """The tables as columns, one row for each temperature and SOC, standard errors beside.

        ``r0_ohm`` and ``r0_std_ohm``, and so on, in the same unit (NaN: nobody knows it); the third
        branch and the hysteresis where the model has them.
        """
        slow, lag = self.effect(SlowDiffusion), self.effect(Hysteresis)
        tables = {name: getattr(self, name) for name in TABLES}
        if slow in self.effects:
            tables |= {"r3_ohm": slow.r3_ohm, "tau3_s": slow.tau3_s}
        if lag in self.effects:
            tables |= {"m_V": lag.m_V}
        found = {
            "temperature_C": np.repeat(self.temperature_C, self.points),
            "soc": np.tile(self.soc, self.temperature_C.size),
        }
        for name, value in tables.items():
            table = effect_table(value, self.ocv_V.shape)
            quantity, _, unit = name.rpartition("_")
            std = table_std(name, table, self.temperature_C, self.provenance, self.posterior)
            found |= {name: table.ravel(), f"{quantity}_std_{unit}": std.ravel()}
        return found

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """OCV, resistances and time constants over SOC, one curve for each temperature."""
        names = [f"{t:g} °C" for t in self.temperature_C] if self.temperature_C.size > 1 else [""]

        def lines(symbol: str, table: FloatArray, factor: float) -> list[Line]:
            return [
                Line(f"{symbol} {name}".strip(), self.soc, factor * row)
                for name, row in zip(names, table, strict=False)
            ]

        ohms = [("R0", self.r0_ohm), ("R1", self.r1_ohm), ("R2", self.r2_ohm)]
        taus = [("tau1", self.tau1_s), ("tau2", self.tau2_s)]
        return "SOC", (
            Panel("OCV [V]", tuple(lines("OCV", self.ocv_V, 1.0))),
            Panel("[mohm]", tuple(x for s, table in ohms for x in lines(s, table, 1e3))),
            Panel("[s]", tuple(x for s, table in taus for x in lines(s, table, 1.0))),
        )

    def facts(self) -> dict[str, str]:
        """Name to what a person asks first of a model, with units."""
        middle = self.points // 2
        r0, r1, r2 = (1e3 * table[:, middle] for table in (self.r0_ohm, self.r1_ohm, self.r2_ohm))
        at = [f"{t:g} degC" for t in self.temperature_C]
        ohms = (f"{a:.3g}, {b:.3g}, {c:.3g} mohm" for a, b, c in zip(r0, r1, r2, strict=True))
        known = self.validity.to_dict()
        return {
            "capacity": f"{self.capacity_Ah:.4g} Ah +- {2 * self.capacity_std_Ah:.2g}",
            "OCV": f"{self.ocv_V.min():.3f} to {self.ocv_V.max():.3f} V",
            "R0, R1, R2 at 50 % SOC": "; ".join(map(" at ".join, zip(ohms, at, strict=True))),
            "effects": ", ".join(e.name for e in self.effects) or "none",
            "its data": "; ".join(f"{k} {v[0]:.3g} to {v[1]:.3g}" for k, v in known.items() if v)
            or "not known",
        }

    def __repr__(self) -> str:
        grid = f"{self.points} SOC points"
        if self.temperature_C.size > 1:
            grid += f" x {self.temperature_C.size} temperatures"
        extra = ", ".join(e.name for e in self.effects)
        # Where the tables lie: a headline at another temperature would rest on the activation.
        of_tables = self.effect(TemperatureDependence)
        at_C = self.usual_temperature_C if self.temperature_C.size > 1 else of_tables.reference_C
        known = self.temperature_C.size > 1 or of_tables in self.effects
        where = f" at {at_C:.0f} degC" if known else ""
        r0_ohm = self.at_temperature(at_C).r0_ohm
        return (
            f"CellModel({self.name or 'unnamed'}: {self.capacity_Ah:.4g} Ah, {grid}, "
            f"OCV {self.ocv_V.min():.3f} to {self.ocv_V.max():.3f} V, "
            f"R0 {1e3 * np.median(r0_ohm):.3g} mohm{where}{', ' + extra if extra else ''})"
        )

    @property
    def points(self) -> int:
        """Number of SOC grid points."""
        return int(self.ocv_V.shape[1])

    @property
    def soc(self) -> FloatArray:
        """The uniform SOC grid, shape (points,)."""
        return _even_grid(self.points).copy()

    @property
    def c1_F(self) -> FloatArray:
        """Capacitance of the fast branch, tau1 / R1 [F]."""
        return np.asarray(self.tau1_s / self.r1_ohm)

    @property
    def c2_F(self) -> FloatArray:
        """Capacitance of the slow branch, tau2 / R2 [F]."""
        return np.asarray(self.tau2_s / self.r2_ohm)

    def slow_error_V(
        self, soc: FloatArray | float, temperature_C: float | None = None
    ) -> FloatArray:
        """Slow voltage error at a SOC and a temperature [V], beyond the data's SOC more.

        There the OCV's slope is known to half of its mean over SOC, so the error grows by that
        with the distance from the data.
        """
        return self._widened(self.error.at(soc, temperature_C), soc)

    def slow_error_tables_V(self) -> FloatArray:
        """The same on the model's grid, shape (temperatures, points)."""
        rows = [self.error.at(self.soc, float(t)) for t in self.temperature_C]
        return np.array([self._widened(row, self.soc) for row in rows])

    def _widened(self, validated: FloatArray, soc: FloatArray | float) -> FloatArray:
        if self.validity.soc is None:
            return validated
        beyond = self.unknown_slope_V * beyond_soc(self.validity, soc)
        return np.asarray(np.hypot(validated, beyond))

    @property
    def unknown_slope_V(self) -> float:
        """By how much the OCV's slope over SOC may be off where no data were [V]."""
        return UNKNOWN_SLOPE * float(np.mean(self.ocv_V[:, -1] - self.ocv_V[:, 0]))

    @property
    def capacity_std_Ah(self) -> float:
        """Standard deviation of the capacity of the cell it is for [Ah].

        By its posterior, else by what its provenance says.
        """
        if self.posterior is not None and self.posterior.capacity_std > 0.0:
            return self.posterior.capacity_std * self.capacity_Ah
        history = self.provenance.get("history")
        if isinstance(history, Mapping) and "capacity_std_Ah" in history:
            return float(history["capacity_std_Ah"])
        stock = self.provenance.get("stock")
        if isinstance(stock, Mapping) and "spread" in stock:
            return float(stock["spread"]["soc"]) * self.capacity_Ah
        return CAPACITY_STD * self.capacity_Ah

    @property
    def capacity_share(self) -> float:
        """By what share of it the cell in use may hold more or less, one deviation."""
        fitted = 0.0 if self.posterior is None else self.posterior.capacity_std
        return max(CAPACITY_STD, fitted)

    def effect(self, kind: type[E]) -> E:
        """The model's effect of one kind, or its neutral value."""
        for effect in self.effects:
            if isinstance(effect, kind):
                return effect
        return kind()

    def with_effect(self, effect: Effect) -> CellModel:
        """The model with one effect added or replaced."""
        check_kind("effect", effect, Effect, "Write Hysteresis(m_V=0.01, gamma=40.0), say.")
        others = tuple(e for e in self.effects if e.name != effect.name)
        return replace(self, effects=(*others, effect))

    def with_resistances(self, factor: float) -> CellModel:
        """The model with every resistance times a factor, that of a slow branch too."""
        factor = number("factor", factor, "a number above zero")
        slow = self.effect(SlowDiffusion)
        slower = replace(slow, r3_ohm=factor * np.asarray(slow.r3_ohm))
        changed = replace(self, **{n: factor * getattr(self, n) for n in RESISTANCES})
        return changed.with_effect(slower) if slow in self.effects else changed

    def parameters(self) -> CellTables:
        """What the kernels take: the packed table, its temperatures, the scalars."""
        table, grid, scalars = self._parameters
        return CellTables(table.copy(), grid.copy(), scalars)

    @cached_property
    def _parameters(self) -> CellTables:
        shape = self.ocv_V.shape
        columns = [effect_table(value_of(self, name), shape) for name in COLUMN_SOURCES.values()]
        table = np.ascontiguousarray(np.stack(columns, axis=-1))
        scalars = {}
        for name, source in SCALAR_SOURCES.items():
            value = float(value_of(self, source))
            convert = CONVERTED.get(name)
            scalars[name] = float(convert(self, value)) if convert else value
        return CellTables(table, np.ascontiguousarray(self.temperature_C), CellScalars(**scalars))

    def at_temperature(self, temperature_C: float) -> CellModel:
        """The model's tables at one temperature, linear between its own.

        Raises
        ------
        InputError        no temperature, or one in kelvin
        """
        temperature_C = _celsius(temperature_C)
        if self.temperature_C.size == 1:
            return self
        grid = self.temperature_C
        tables: dict[str, Any] = {
            n: _interpolate(grid, getattr(self, n), temperature_C) for n in TABLES
        }
        return replace(
            self,
            **tables,
            effects=tuple(self._effect_at(e, temperature_C) for e in self.effects),
            temperature_C=np.array([float(temperature_C)]),
        )

    @property
    def is_stock(self) -> bool:
        """Whether it is a stock model, scaled or not: of a cell of the kind, not of this one."""
        return "stock" in self.provenance

    @property
    def usual_temperature_C(self) -> float:
        """Taken where nobody measured [degC]: 25, or where the data come nearest to that."""
        low, high = float(self.temperature_C[0]), float(self.temperature_C[-1])
        several = low < high  # which may go on beyond the data
        if several or any(isinstance(e, TemperatureDependence) for e in self.effects):
            known = (low, high) if several else (USUAL_C, USUAL_C)
            low, high = self.validity.temperature_C or known
        return min(max(USUAL_C, low), high)

    def ocv_at(self, temperature_C: float) -> FloatArray:
        """OCV over the model's SOC at one temperature [V], as of :meth:`at_temperature`."""
        temperature_C = _celsius(temperature_C)
        if self.temperature_C.size == 1:
            return np.asarray(self.ocv_V[0])
        return _interpolate(self.temperature_C, self.ocv_V, temperature_C)

    def effect_at(self, kind: type[E], temperature_C: float) -> E:
        """One effect at one temperature, as of :meth:`at_temperature`."""
        effect = self.effect(kind)
        return effect if self.temperature_C.size == 1 else self._effect_at(effect, temperature_C)

    def _effect_at(self, effect: E, temperature_C: float) -> E:
        tables: dict[str, Any] = {
            key: _interpolate(self.temperature_C, value, temperature_C)[None, :]
            for key, value in vars(effect).items()
            if np.ndim(value) == 2
        }
        return replace(effect, **tables)


HOTTEST_C = 200.0  # no cell is a cell there: above, it is a temperature in kelvin


def _celsius(temperature_C: float) -> float:
    warm = number("temperature_C", temperature_C, "one temperature [degC]")
    if warm > HOTTEST_C:
        raise InputError(
            f"temperature_C = {warm:g}", "degrees Celsius", "Subtract 273.15 from kelvin."
        )
    return warm


@cache
def _even_grid(points: int) -> FloatArray:
    return np.linspace(0.0, 1.0, points)


def _interpolate(grid: FloatArray, table: FloatArray, temperature_C: float) -> FloatArray:
    if not grid[0] < temperature_C < grid[-1]:
        return np.array(table[0 if temperature_C <= grid[0] else -1], dtype=np.float64)
    low = int(np.searchsorted(grid, temperature_C, side="right")) - 1
    slope = (table[low + 1] - table[low]) / (grid[low + 1] - grid[low])
    return np.asarray(slope * (temperature_C - grid[low]) + table[low])


def _spread_over(table: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """A table that is one number or one row for all, at all; another is left as it is."""
    alike = table.shape[0] in (1, shape[0]) and table.shape[1] in (1, shape[-1])
    return np.array(np.broadcast_to(table, shape)) if alike else table


def _soc_points(soc: FloatArray) -> tuple[FloatArray, slice]:
    """SOC of the points of a table, ascending, and the order in which they were given.

    Raises
    ------
    InputError        not from 0 to 1, not in order
    """
    order = slice(None, None, -1 if soc.ndim == 1 and soc.size > 1 and soc[0] > soc[-1] else 1)
    points = soc[order] if soc.ndim == 1 else np.empty(0)
    rises = points.size > 1 and bool(np.all(np.diff(points) > 0.0))
    if not rises or abs(points[0]) > SOC_END or abs(points[-1] - 1.0) > SOC_END:
        ends = f" from {points[0]:g} to {points[-1]:g}" if points.size else ""
        raise InputError(
            f"soc of shape {soc.shape}{ends}" + ("" if rises or not ends else ", not in order"),
            "the SOC of every point of the OCV, from 0 to 1, in order",
            "Divide per cent by 100." if points.size and points[-1] > 2.0 else "Add the ends.",
        )
    return points, order


def _check_parts(model: CellModel) -> None:
    """Refuse what is beside the tables and of another type.

    Raises
    ------
    InputError        names it, what it is and what it should be
    """
    limits = {n: getattr(model, n) for n in ("voltage_min_V", "voltage_max_V")}
    for name, value in {"charge_efficiency": model.charge_efficiency, **limits}.items():
        if value is not None or name not in limits:
            object.__setattr__(model, name, number(name, value, "a number"))
    check_kind("error", model.error, ModelError, "Write ModelError.of_white_and_slow(0.002, 0.01).")
    check_kind("validity", model.validity, Validity, "Write Validity(soc=(0.0, 1.0)), say.")
    if not isinstance(model.provenance, Mapping):
        raise InputError(f"provenance = {shown(model.provenance)}", "a mapping", "Pass a dict.")
    if model.posterior is not None:
        check_kind("posterior", model.posterior, Posterior, "Leave it out.")
    effects = model.effects if isinstance(model.effects, (tuple, list)) else (model.effects,)
    for effect in effects:
        check_kind("effects", effect, Effect, "Write effects=(Hysteresis(m_V=0.01, gamma=40.0),).")


def check_model(model: CellModel) -> None:
    """Refuse a model that no kernel could run: see :class:`CellModel`."""
    for found, expected, action in _faults(model):
        raise InputError(found, expected, action)
    for effect in model.effects:
        check_effect(effect, (model.temperature_C.size, model.points))


def _faults(model: CellModel) -> Iterator[tuple[str, str, str]]:
    """What is wrong with a model: found, expected, what to do."""
    shape, temperature_C = model.ocv_V.shape, model.temperature_C
    if len(shape) != 2 or shape[1] < 2 or (shape[0],) != temperature_C.shape:
        found = f"OCV table of shape {shape} with {temperature_C.size} temperature(s)"
        expected = "one row per temperature and at least two SOC points"
        yield found, expected, "Give every table the shape (temperatures, soc points)."
    capacity, efficiency = model.capacity_Ah, model.charge_efficiency
    if not np.isfinite(capacity) or capacity <= 0:
        yield f"capacity_Ah = {capacity}", "a capacity above zero", "Check its unit: Ah."
    if not 0.5 <= efficiency <= 1.05:
        expected = "a share between 0.5 and 1.05"
        found = f"charge_efficiency = {efficiency}"
        yield found, expected, "Give it as a fraction, not in per cent."
    if not np.all(np.isfinite(temperature_C)) or np.any(np.diff(temperature_C) <= 0):
        found = f"temperatures {temperature_C.tolist()}"
        yield found, "finite temperatures that rise", "Sort the tables by temperature."
    limits = (model.voltage_min_V, model.voltage_max_V)
    known = [limit for limit in limits if limit is not None]
    if not np.all(np.isfinite(known)) or (len(known) == 2 and known[0] >= known[1]):
        found = "voltage_min_V = {}, voltage_max_V = {}".format(*limits)
        yield found, "finite limits, the lower below the upper", "Correct the limits."
    for name in TABLES:
        table = getattr(model, name)
        if table.shape != shape:
            found, expected = f"{name} of shape {table.shape}", f"shape {shape} as ocv_V"
            yield found, expected, "Interpolate it onto the OCV's grid."
        if not np.all(np.isfinite(table)):
            yield f"{name} with missing values", "finite values", "Check the fit."
        if name != "ocv_V" and np.any(table <= 0):
            yield f"{name} down to {table.min():g}", "values above zero", "Check the fit."
    rise_V = np.diff(model.ocv_V, axis=1).min(axis=0)
    if np.any(rise_V < 0):
        found = f"an OCV that falls with SOC near SOC {model.soc[int(np.argmin(rise_V))]:.3f}"
        yield found, "an OCV that never falls with SOC", "Fit it with the monotone spline."
    if np.any(model.tau1_s >= model.tau2_s):
        expected = "tau1 < tau2 at every point"
        yield "tau1_s >= tau2_s", expected, "Swap the branches where they cross."
    names = [e.name for e in model.effects]
    if len(set(names)) != len(names):
        yield f"effects {names}", "one effect of a kind", "Merge the double one."


# Scalars that are not taken over as they are: in other units, or 0 where nothing follows from them.
CONVERTED: dict[str, Callable[[CellModel, float], float]] = {
    "charge_As": lambda model, value: 3600.0 * value,
    "reference_K": lambda model, value: value + ZERO_CELSIUS_K,
    "hysteresis_rate": lambda model, value: value if np.any(model.effect(Hysteresis).m_V) else 0.0,
    "rate_per_A": lambda model, value: value / model.capacity_Ah,
    "surface_per_A": lambda model, value: value / model.capacity_Ah,
    "surface_reference_K": lambda model, value: value + ZERO_CELSIUS_K,
    "branch_activation": lambda model, value: float(_has_branch_activation(model)),
    "entropy_K": lambda model, value: (
        value + ZERO_CELSIUS_K if np.any(model.effect(Entropy).docv_dT_V_per_K) else 0.0
    ),
}


def value_of(model: CellModel, name: str) -> FloatArray | float:
    """What a source of `point_kernels` names: of the model, or ``effect.parameter``."""
    if name == "error":
        return model.slow_error_tables_V()
    holder, _, parameter = name.rpartition(".")
    value: FloatArray | float = getattr(
        model.effect(EFFECTS[holder]) if holder else model, parameter
    )
    return value


def branch_table(model: CellModel, kind: str, branch: State) -> FloatArray:
    """Resistance (``r``) or time constant (``tau``) of a branch, shape (temperatures, points)."""
    name = CALLED[kind](branch)
    return effect_table(value_of(model, COLUMN_SOURCES[name]), model.ocv_V.shape)


def _has_branch_activation(model: CellModel) -> bool:
    effect = model.effect(TemperatureDependence)
    return any(getattr(effect, f"{name}_K") != 0.0 for name in BRANCH_ACTIVATIONS)
