"""The shortest test that would separate what remains, from simulating what competes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cellwise.cell.equations import empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate_rows, start_hysteresis
from cellwise.diagnose.causes.catalogue import kept_coordinates
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.decision.outcome import Outcome
from cellwise.diagnose.decision.search import Explanation
from cellwise.diagnose.fit.rows import Evidence
from cellwise.typing import FloatArray

LONGER_LOG = (
    "A drive of this cell of at least an hour, from a rest at a known SOC, with rests inside"
)
CLEAR_V = 3e-3  # a separation that a cell's own scatter cannot hide


class Experiment(NamedTuple):
    """A test on the bench: its steps (current in units of 1C, seconds), so many times over."""

    name: str
    soc0: float
    steps: tuple[tuple[float, float], ...]
    times: int = 1
    temperature_C: float = 25.0

    @property
    def current_C(self) -> FloatArray:
        """A row each second."""
        rates, seconds = np.array(self.steps * self.times).T
        return np.repeat(rates, seconds.astype(np.int64))


PULSES = (*((c, 10.0) for c in (2.0, 0.0, -2.0, 0.0, 0.5, 0.0)), (0.0, 72.0))
# Tests that every laboratory can run, short ones first.
EXPERIMENTS = (
    Experiment("Pulses of 10 s at 2C and C/2, both directions, at half charge", 0.5, PULSES, 6),
    Experiment("The same pulses at 45 degC", 0.5, PULSES, 6, 45.0),
    Experiment("The same pulses at 0 degC", 0.5, PULSES, 6, 0.0),
    Experiment(
        "A quarter of an hour of C/2 out and in again, then a rest",
        0.5,
        ((0.5, 900.0), (-0.5, 900.0), (0.0, 1800.0)),
    ),
    Experiment("1C from full for 50 minutes, then a rest", 1.0, ((1.0, 3000.0), (0.0, 3600.0))),
    Experiment("C/5 from full for 4.5 hours", 1.0, ((0.2, 4.5 * 3600.0),)),
    Experiment("C/20 from full for 19 hours", 1.0, ((0.05, 19.0 * 3600.0),)),
    Experiment("A rest of 24 hours at half charge, connected", 0.5, ((0.0, 86_400.0),)),
)


def next_test(outcome: Outcome, model: CellModel, evidence: Evidence) -> str:
    """What to measure next; for any verdict but none.

    The experiment that would separate what competes; where one cause is left, the one in which it
    differs most from the model as it was; where nothing explains the error, the laboratory's tests
    where the error is.
    """
    close = list(outcome.open_between)
    if outcome.accepted:
        named = outcome.accepted[0].cause.name
        first = [e for e in outcome.first if named in e.names]
        close = first + [e for e in outcome.first if e not in first][:1]
    if close:
        return _separating(close)
    middle = float(np.median(np.concatenate([g.temperature_C for g in evidence.logs])))
    return (
        f"HPPC at {middle:.0f} degC and C/20 from full at 25 degC with this cell as it is now: "
        f"they show apart whether resistances, OCV or capacity differ from the model's "
        f"({model.capacity_Ah:.4g} Ah)"
    )


def _separating(close: Sequence[Explanation]) -> str:
    """The shortest experiment with a clear separation; else the one with the largest.

    A single explanation is separated from the model as it was.
    """
    plain = close[0].fit.coordinates
    found: list[tuple[float, Experiment]] = []
    for e in EXPERIMENTS:
        one = _voltage(close[0], e)
        two = _voltage(close[1], e) if len(close) > 1 else _simulated(plain, {}, e)
        found.append((float(np.sqrt(np.mean((one - two) ** 2))), e))
        if found[-1][0] >= CLEAR_V:
            break
    separation_V, best = max(found, key=lambda f: f[0])
    names = [" with ".join(e.names) for e in close[:2]]
    names = [n.replace("_", " ").replace("soc", "SOC") for n in names]
    other = names[1] if len(names) > 1 else "the model as it was"
    verdict = "separates" if separation_V >= CLEAR_V else "barely separates"
    return (
        f"{best.name} ({best.current_C.size / 3600.0:.2g} h): predicted to differ by "
        f"{1e3 * separation_V:.1f} mV RMS between {names[0]} and {other}, which {verdict} them"
    )


def _voltage(candidate: Explanation, experiment: Experiment) -> FloatArray:
    """Voltage that would be logged if the candidate were right."""
    keep = kept_coordinates(candidate.causes)
    # A known start: a cause that was the log's start predicts nothing new.
    z = {n: v for n, v in candidate.fit.z.items() if n in keep and not n.startswith("soc0:")}
    z = {n.partition(":")[0]: v for n, v in z.items()}
    return _simulated(candidate.fit.coordinates, z, experiment)


def _simulated(
    coordinates: Coordinates, z: Mapping[str, float], experiment: Experiment
) -> FloatArray:
    """Voltage that would be logged at a point in the coordinates."""
    inputs = coordinates.inputs(z)
    current = experiment.current_C * coordinates.model.capacity_Ah
    flow = (current - inputs.offset_A) / inputs.gain
    voltage, soc = np.empty(flow.size), np.empty(flow.size)
    start = empty_state(experiment.soc0, start_hysteresis(experiment.soc0))
    dt, warm = np.ones(flow.size), np.full(flow.size, experiment.temperature_C)
    simulate_rows(inputs.tables, start, dt, flow, warm, voltage, soc)
    return voltage + inputs.added_V
