"""The causes that cellwise knows: meaning, parameters, signature, what they are confused with.

They stand in `causes.toml`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any, Literal

from cellwise.diagnose.causes.coordinates import (
    OCV_NAMES,
    UNSEEN_OCV_NAMES,
    UNSEEN_R_NAMES,
    Coordinates,
)

Kind = Literal["measurement", "start", "cell"]
Values = dict[str, float]


@dataclass(frozen=True)
class Parameter:
    """One number of a cause.

    ``coordinate`` is how the fit moves it (:mod:`cellwise.diagnose.causes.coordinates`),
    ``wide`` the prior standard deviation of a fault in that coordinate, in units of
    ``per``: 1, the capacity in Ah ("capacity"), or the interval of the log ("interval").
    """

    name: str
    unit: str
    neutral: float
    bounds: tuple[float, float]
    coordinate: str
    wide: float
    per: Literal["one", "capacity"] = "one"

    @property
    def key(self) -> str:
        """Name of its coordinate in a point: of the first log where every log has its own."""
        return "soc0:0" if self.coordinate == "soc0" else self.coordinate

    def value(self, x: float, coordinates: Coordinates, soc0: float) -> float:
        """What people see at ``x`` in its coordinate; ``soc0``: the first log's stated start."""
        start = self.coordinate == "soc0"
        return soc0 + x if start else coordinates.value_of(self.coordinate, x)


@dataclass(frozen=True)
class Cause:
    """A reason for a simulation to be wrong.

    ``kind`` says what is corrected: the log ("measurement"), where it starts ("start") or the model
    ("cell"). ``shape`` is a coordinate that means nothing while the effect is neutral, with the
    values from which the search starts; ``beginnings`` are values of its first coordinate to start
    from, where a fit that starts at neutral may stop half way. ``forms`` are other shapes that it
    may have, as causes of the same name: of those that a model can have the likeliest counts.
    """

    name: str
    kind: Kind
    meaning: str
    term: str
    signature: str
    parameters: tuple[Parameter, ...]
    confused_with: tuple[str, ...]
    shape: tuple[str, tuple[float, ...]] | None = None
    beginnings: tuple[float, ...] = ()
    forms: tuple[Cause, ...] = ()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates that are estimated for it."""
        return tuple(p.coordinate for p in self.parameters)

    def values(self, coordinates: Coordinates, z: Mapping[str, float], soc0: float) -> Values:
        """Its parameters at a point as people see them."""
        return {p.name: p.value(z.get(p.key, 0.0), coordinates, soc0) for p in self.parameters}

    @property
    def log(self) -> int | None:
        """Number of the one log that it is of; None: of all."""
        _, of_log, number = self.parameters[0].coordinate.partition(":")
        return int(number) if of_log else None


# By what `causes.toml` calls them: coordinates at even knots over SOC.
_KNOTS = {"ocv": OCV_NAMES, "unseen_r": UNSEEN_R_NAMES, "unseen_ocv": UNSEEN_OCV_NAMES}


def _parameters(entry: dict[str, Any]) -> Iterator[Parameter]:
    """The parameter of an entry; at knots one for each, in thousandths of SOC in its name."""
    entry = {"neutral": 0.0, **entry, "bounds": tuple(entry["bounds"])}
    if "knots" not in entry:
        yield Parameter(**entry)
        return
    names, unit = _KNOTS[entry.pop("knots")], entry["unit"].replace("/", "_per_")
    for k, coordinate in enumerate(names):
        name = f"{entry['name']}_{1000 * k // (len(names) - 1):04d}_{unit}"
        yield Parameter(**{**entry, "name": name, "coordinate": coordinate})


def _cause(entry: dict[str, Any]) -> Cause:
    """The cause of a table of `causes.toml`."""
    parameters = tuple(p for one in entry.pop("parameter") for p in _parameters(one))
    forms = tuple(map(_cause, entry.pop("form", ())))
    if "shape" in entry:
        name, values = entry["shape"]
        entry["shape"] = name, tuple(values)
    for field in {"confused_with", "beginnings"} & set(entry):
        entry[field] = tuple(entry[field])
    return Cause(**entry, parameters=parameters, forms=forms)


_FILE = tomllib.loads((files(__package__) / "causes.toml").read_text(encoding="utf-8"))
CAUSES: dict[str, Cause] = {entry["name"]: _cause(entry) for entry in _FILE["cause"]}
SENSOR_FAULT = _cause(_FILE["sensor_fault"])
UNSEEN_TEMPERATURE = replace(
    CAUSES["temperature_dependence"],
    meaning=_FILE["unseen_temperature"]["meaning"],
    parameters=(
        *CAUSES["temperature_dependence"].parameters,
        *(p for one in _FILE["unseen_temperature"]["parameter"] for p in _parameters(one)),
    ),
)


def known_cause(name: str) -> Cause:
    """A cause by its name, whether it is fitted or found in the logs alone."""
    return SENSOR_FAULT if name == SENSOR_FAULT.name else CAUSES[name]


# On cells of simulated physics it took the place of a contact resistance, a slow diffusion and a
# resistance, and was the first cause of none of five cells whose exchange current had changed.
ON_REQUEST = frozenset({"charge_transfer"})


def forms_of(cause: Cause, coordinates: Coordinates, logs: Sequence[int] = ()) -> tuple[Cause, ...]:
    """A cause in every form that it can have in a model; of one of several ``logs`` alone, too."""
    others = [f for f in cause.forms if all(coordinates.possible(n) for n in f.coordinates)]
    if cause.name == "voltage_offset":
        others += [_in_one_log(cause, k) for k in logs]
    return (cause, *others)


def _in_one_log(cause: Cause, log: int) -> Cause:
    """What a sensor does in one log alone: every log may have its own sensor, as its own start."""
    return replace(
        cause,
        meaning=f"{cause.meaning[:-1]} in log {log + 1} alone.",
        parameters=tuple(replace(p, coordinate=f"{p.coordinate}:{log}") for p in cause.parameters),
    )


def kept_coordinates(causes: Iterable[Cause]) -> set[str]:
    """Coordinates that the causes move, and the activation that self-heating needs."""
    kept = set()
    for c in causes:
        kept |= set(c.coordinates)
        if c.name == "self_heating":
            kept.add("activation_K")
    return kept
