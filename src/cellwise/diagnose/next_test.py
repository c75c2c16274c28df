"""The shortest experiment that separates competing causes, from simulating all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.cell.equations import empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import start_hysteresis
from cellwise.diagnose.causes.catalogue import kept_coordinates
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.causes.sensitivity_kernels import Flow, voltage_rows
from cellwise.diagnose.decision.explanations import Explanation
from cellwise.diagnose.decision.outcome import Outcome
from cellwise.diagnose.fit.rows import Evidence
from cellwise.typing import FloatArray

STEP_S = 1.0
# A separation that a cell's own scatter cannot hide.
CLEAR_V = 3e-3
LONGER_LOG = (
    "A drive of this cell of at least an hour, from a rest at a known SOC, with rests inside"
)


@dataclass(frozen=True, eq=False)
class Experiment:
    """A test on the bench: current over time, from a known SOC."""

    name: str
    soc0: float
    current_C: FloatArray
    temperature_C: float = 25.0

    @property
    def hours(self) -> float:
        """Length [h]."""
        return self.current_C.size * STEP_S / 3600.0


@dataclass(frozen=True)
class Proposal:
    """An experiment and by how much it separates the alternatives [V RMS]."""

    name: str
    hours: float
    separation_V: float

    def text(self, alternatives: Sequence[str]) -> str:
        """What to do, for people."""
        names = " and ".join(r.replace("_", " ").replace("soc", "SOC") for r in alternatives[:2])
        verdict = "separates" if self.separation_V >= CLEAR_V else "barely separates"
        return (
            f"{self.name} ({self.hours:.2g} h): predicted to differ by "
            f"{1e3 * self.separation_V:.1f} mV RMS between {names}, which {verdict} them"
        )


def _steady(c_rate: float, hours: float) -> FloatArray:
    return np.full(int(hours * 3600 / STEP_S), c_rate)


def experiments() -> tuple[Experiment, ...]:
    """Tests that every laboratory can run, short ones first."""
    rest = _steady(0.0, 1.0)
    pulse = np.concatenate([_steady(c, 10 / 3600) for c in (2.0, 0.0, -2.0, 0.0, 0.5, 0.0)])
    pulses = np.concatenate([np.concatenate([pulse, _steady(0.0, 0.02)]) for _ in range(6)])
    cycle = np.concatenate([_steady(0.5, 0.25), _steady(-0.5, 0.25), _steady(0.0, 0.5)])
    return (
        Experiment("Pulses of 10 s at 2C and C/2, both directions, at half charge", 0.5, pulses),
        Experiment("The same pulses at 45 degC", 0.5, pulses, 45.0),
        Experiment("The same pulses at 0 degC", 0.5, pulses, 0.0),
        Experiment("A quarter of an hour of C/2 out and in again, then a rest", 0.5, cycle),
        Experiment(
            "1C from full for 50 minutes, then a rest",
            1.0,
            np.concatenate([_steady(1.0, 5 / 6), rest]),
        ),
        Experiment("C/5 from full for 4.5 hours", 1.0, _steady(0.2, 4.5)),
        Experiment("A rest of 24 hours at half charge, connected", 0.5, _steady(0.0, 24.0)),
        Experiment("C/20 from full for 19 hours", 1.0, _steady(0.05, 19.0)),
    )


def next_test(outcome: Outcome, model: CellModel, evidence: Evidence) -> str:
    """What to measure next; for any verdict but none.

    The experiment that would separate what competes; where one cause is left, the one in which it
    differs most from the model as it was; where nothing explains the error, the laboratory's tests
    where the error is.
    """
    if outcome.open_between:
        close = list(outcome.open_between)
    elif outcome.accepted:
        named = outcome.accepted[0].cause.name
        first = [e for e in outcome.first if named in e.names]
        close = first + [e for e in outcome.first if e not in first][:1]
    else:
        return _laboratory(model, evidence)
    proposal = propose(close)
    if proposal is None:
        return _laboratory(model, evidence)
    names = [" with ".join(e.names) for e in close[:2]]
    return proposal.text(names if len(names) > 1 else [*names, "the model as it was"])


def _laboratory(model: CellModel, evidence: Evidence) -> str:
    """Identification again, at the temperature of the logs."""
    middle = float(np.median(np.concatenate([g.temperature_C for g in evidence.logs])))
    return (
        f"HPPC at {middle:.0f} degC and C/20 from full at 25 degC with this cell as it is now: "
        f"they show apart whether resistances, OCV or capacity differ from the model's "
        f"({model.capacity_Ah:.4g} Ah)"
    )


def propose(alternatives: Sequence[Explanation]) -> Proposal | None:
    """The shortest experiment with a clear separation; else the one with the largest.

    A single alternative is separated from the model as it was.
    """
    if not alternatives:
        return None
    plain = alternatives[0].fit.coordinates
    best: Proposal | None = None
    for e in sorted(experiments(), key=lambda e: e.hours):
        one = _voltage(alternatives[0], e)
        two = _voltage(alternatives[1], e) if len(alternatives) > 1 else _simulated(plain, {}, e)
        # Where a start or a constant would do, only the shape counts for a known start: keep all.
        separation = float(np.sqrt(np.mean((one - two) ** 2)))
        found = Proposal(e.name, e.hours, separation)
        if separation >= CLEAR_V:
            return found
        if best is None or separation > best.separation_V:
            best = found
    return best


def _voltage(candidate: Explanation, experiment: Experiment) -> FloatArray:
    """Voltage that would be logged if the candidate were right."""
    coordinates = candidate.fit.coordinates
    keep = kept_coordinates(candidate.causes)
    # A known start: a cause that was the log's start predicts nothing new.
    z = {n: v for n, v in candidate.fit.z.items() if n in keep and ":" not in n}
    return _simulated(coordinates, z, experiment)


def _simulated(
    coordinates: Coordinates, z: Mapping[str, float], experiment: Experiment
) -> FloatArray:
    """Voltage that would be logged at a point in the coordinates."""
    inputs = coordinates.inputs(z)
    current = experiment.current_C * coordinates.model.capacity_Ah
    flow = (current - inputs.offset_A) / inputs.gain
    n = current.size
    voltage, soc = np.empty(n), np.empty(n)
    start = empty_state(experiment.soc0, start_hysteresis(experiment.soc0))
    voltage_rows(
        inputs.tables,
        start,
        Flow(np.full(n, STEP_S), flow, np.full(n, experiment.temperature_C)),
        inputs.added_V,
        1,
        voltage,
        soc,
    )
    return voltage
