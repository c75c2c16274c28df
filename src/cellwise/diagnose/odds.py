"""How rare causes are before any row is read, and how probable each is once all are.

Evidence is summed over blocks of time, and the blocks are weighted at random (Bayesian bootstrap):
where the noise is what the likelihood takes it for, that changes little; where a model is wrong
otherwise, what rests on a few blocks is no longer certain. The weights are those of
pseudo-Bayesian model averaging (Yao et al., 2018, doi:10.1214/17-BA1091).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.metrics import block_sums
from cellwise.diagnose.fit.rows import START, ScoredRows
from cellwise.typing import FloatArray


class Rare(NamedTuple):
    """Ln of the odds against causes before any row is read [nats].

    ``one_cause``: one diagnosis in fifty finds a cause where nobody expected one, and it may be any
    of twenty. ``further_age``: a cell ages as a whole, what else age does is no second coincidence,
    only one of a few ways. ``both``: what has lost charge has grown in resistance as often as not.
    ``since_baseline``: charge and material are lost over years; of ten cells that lost as much as
    logs show, one lost it between two logs of which the first is known to be good. ``law_holds``: a
    law that was found at another temperature holds as rarely as a cause comes elsewhere.
    """

    one_cause: float = math.log(50.0 * 20.0)
    further_age: float = math.log(10.0)
    both: float = math.log(2.0)
    since_baseline: float = math.log(10.0)
    law_holds: float = math.log(50.0)


class Naming(NamedTuple):
    """A cause is named from a probability of ``least`` on, a set of causes shown from ``shown`` on.

    ``draws``: random weights of the blocks of time. ``none`` is said where nothing is likelier than
    ``likely``. Where nothing is named ``reasons`` say why: a rest that lies ``refuted`` nats off
    (three standard deviations) refutes a claim on charge. A parameter known to no less than
    ``narrower`` of its prior only repeats it: the logs say less of it than the prior does.
    """

    least: float = 0.9
    shown: float = 0.02
    draws: int = 1000
    likely: float = 0.5
    reasons: int = 3
    refuted: float = 0.5 * 3.0**2
    narrower: float = math.sqrt(0.5)

    @property
    def nats(self) -> float:
        """Ln of the odds for a cause that is named."""
        return math.log(self.least / (1.0 - self.least))


RARE, NAMING = Rare(), Naming()
RESISTANCE = frozenset({"resistance_scale", "ohmic_resistance", "charge_transfer"})
AGE = frozenset(
    {
        "capacity",
        "resistance_scale",
        "ohmic_resistance",
        "charge_transfer",
        "lithium_inventory",
        "active_material_negative",
        "active_material_positive",
        "ocv_shift",
    }
)
# Outside the temperatures that the model was measured at these are expected: one of a few ways.
TEMPERATURE = frozenset({"entropy", "slow_diffusion", "self_heating"})
LAW = "temperature_dependence"


@dataclass(frozen=True)
class Rarity:
    """How rare sets are in one diagnosis.

    ``extrapolated``: the logs' temperature lies outside the model's; ``same_age``: a good log of
    the same cell is known, so that age is no more than one of many ways.
    """

    extrapolated: bool = False
    same_age: bool = False

    def hides(self, name: str) -> bool:
        """Whether a cause cannot be said to be there, however well it explains the logs.

        At a temperature that the model was not measured at, a cell that has aged and a law that
        does not hold there look alike: diffusion that the cold slows empties a cell early, too.
        """
        return self.extrapolated and name in AGE

    def nats(self, names: Collection[str]) -> float:
        """Ln of the odds against a set."""
        left = set(names)
        total = 0.0
        if self.extrapolated:
            total += RARE.further_age * len(left & TEMPERATURE)
            total += 0.0 if LAW in left else RARE.law_holds
            left -= TEMPERATURE | {LAW}
        age = left & AGE
        if age:
            kinds = int(bool(age & RESISTANCE)) + int(bool(age - RESISTANCE))
            both = RARE.further_age if self.same_age else RARE.both
            total += RARE.one_cause + both * (kinds - 1)
            total += RARE.further_age * (len(age) - kinds)
            if self.same_age and age - RESISTANCE:
                total += RARE.since_baseline
        return total + RARE.one_cause * len(left - age)


@dataclass(frozen=True)
class Weighed:
    """A set of causes and its probability among all that were weighed."""

    causes: tuple[str, ...]
    probability: float

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {"causes": list(self.causes), "probability": self.probability}


def weigh(
    sets: Sequence[tuple[tuple[str, ...], float, FloatArray]],
    evidence: ScoredRows,
    rng: np.random.Generator,
) -> tuple[Weighed, ...]:
    """Probability of every set of causes, most probable first.

    Parameters
    ----------
    sets : names, ln p of all rows less what the set's rarity costs, each row's part (rows,)
    """
    names, totals, terms = zip(*sets, strict=True)
    used = (evidence.role != START) & evidence.known
    blocks = block_sums(evidence.block[used], np.column_stack(terms)[used])
    many = len(blocks)
    draws = many * rng.dirichlet(np.ones(many), NAMING.draws)
    score = draws @ blocks + (np.array(totals) - blocks.sum(axis=0))
    weight = np.exp(score - score.max(axis=1, keepdims=True))
    share = (weight / weight.sum(axis=1, keepdims=True)).mean(axis=0)
    found = [Weighed(n, float(p)) for n, p in zip(names, share, strict=True)]
    return tuple(sorted(found, key=lambda w: -w.probability))


def probability_of(name: str, weighed: Sequence[Weighed]) -> float:
    """What the sets that hold a cause weigh together."""
    return float(sum(w.probability for w in weighed if name in w.causes))
