"""When a cause is accepted: how much it must explain, how clearly, and of what it may be a part."""

from __future__ import annotations

from collections.abc import Sequence

from cellwise.diagnose.decision.candidates import Candidate, difference
from cellwise.diagnose.decision.posterior import PRIOR_NATS
from cellwise.diagnose.fit.gain import Gain
from cellwise.diagnose.fit.least_squares import Prior
from cellwise.diagnose.fit.rows import Evidence

# Nats by which an explanation must be better than none.
LEAST_SCORE = PRIOR_NATS
# A model claims to be right within an error, and an error within that claim needs no cause: a
# cause must take more than the claim's square off the mean squared error. A model that proves
# better than its claim is taken at CLAIM_FACTOR times what a cause leaves.
CLAIM_FACTOR = 3.0
LEAST_GAIN = 0.02
LEAST_CHANGE_V = 2e-4
# Alternatives closer than this, or than so many standard errors, cannot be separated.
CLEAR_SCORE = 1.0
CLEAR_SIGMAS = 0.3
# Of these the first says less and the second can do all that the first does: unless the second is
# ahead by SIMPLER nats, the first is what happened.
SIMPLER = 10.0
# A candidate behind the likeliest by less than the scatter of the difference may still be right;
# one that by itself leaves this much less of the held-out error than another is preferred.
CLOSE_SIGMAS = 1.0
CLOSE_GAIN = 0.2
OUTSIDE_K = 8.0
OUTSIDE_SHARE = 0.9
# No temperature lets a cell hold so much more than the model (ln of the capacity's ratio).
MOST_GROWTH = 0.05
# A current read so much too low is the same as a cell that has lost as much capacity and gained as
# much resistance: age does that to every cell, and few sensors are so far off. Unless the sensor is
# ahead by SIMPLER nats, it is age.
AGED_GAIN = 0.94
# Of an OCV's change a constant part that explains four fifths goes first; the rest may follow.
MOST_OF_WHOLE = {"voltage_offset": 0.8}
PART_OF = {
    "voltage_offset": "ocv_shift",
    "temperature_dependence": "self_heating",
}


def immaterial(candidate: Candidate, alone: Gain, together: Gain, claim_V: float) -> str:
    """Why a candidate's gain does not count; empty if it does.

    ``alone`` is the gain of the causes by themselves, which is what an extended model brings;
    ``together`` that on top of the fitted tolerances, where a small effect shows clearer. Where
    a few hours carry most of the squared error, the likelihood, which knows how wrong the model
    may be there, shows what they do not.
    ``claim_V`` is the error that the model states of itself.
    """
    name = candidate.name
    lows = (alone.low, alone.low_in_size, together.low, together.low_in_size, candidate.held_low)
    if alone.gain <= 0.0 or max(lows) <= 0.0:
        return f"{name} fits, but its gain on held-out data is not significant"
    saved = max(
        alone.held_before_V - alone.held_after_V, alone.before_in_size_V - alone.after_in_size_V
    )
    claim = min(claim_V, CLAIM_FACTOR * min(alone.held_after_V, alone.after_in_size_V))
    square = max(
        alone.held_before_V**2 - alone.held_after_V**2,
        alone.train_before_V**2 - alone.train_after_V**2,
        alone.before_in_size_V**2 - alone.after_in_size_V**2,
    )
    small = max(alone.gain, alone.gain_in_size) < LEAST_GAIN or saved < LEAST_CHANGE_V
    if small or square < claim * claim:
        return (
            f"{name} reduces the error by {1e3 * saved:.2f} mV, less than the model's stated error"
        )
    return ""


def significance_of(candidate: Candidate, alone: Gain, together: Gain) -> str:
    """What makes a gain significant where the interval of its plain RMSE holds zero."""
    if alone.low_in_size > 0.0:
        return (
            "with every row over the model's error there it gains "
            f"{100 * alone.gain_in_size:.0f} % (at least {100 * alone.low_in_size:.0f} %)"
        )
    most = max(together.low, together.low_in_size)
    if most > 0.0:
        return f"on top of the tolerances it gains at least {100 * most:.0f} %"
    return f"held-out rows are at least e^{candidate.held_low:.0f} times as likely with it"


def likelier_first(ranked: list[Candidate], extrapolated: bool) -> tuple[Candidate, ...]:
    """The best first, but for what was more likely before any row was read.

    A cause that another contains goes before it if it explains as much. ``extrapolated``: the logs
    are of temperatures that the model was not measured at; there a change of the cell that
    explains nearly as much goes before a fault of the instrument.
    """
    best = ranked[0]
    if extrapolated and best.cause.kind == "measurement":
        for k, other in enumerate(ranked[1:], 1):
            whole = PART_OF.get(best.name) == other.name
            grown = other.fit.z.get("ln_capacity", 0.0) > MOST_GROWTH
            near = other.cause.kind == "cell" and other.score > OUTSIDE_SHARE * best.score
            if near and not whole and not grown:
                return (other, *ranked[:k], *ranked[k + 1 :])
    for k, other in enumerate(ranked[1:], 1):
        most = MOST_OF_WHOLE.get(other.name, 1.0) * best.score
        if PART_OF.get(other.name) == best.name and other.score > min(most, best.score - SIMPLER):
            return (other, best, *ranked[1:k], *ranked[k + 1 :])
    return tuple(ranked)


def unphysical(candidate: Candidate, prior: Prior) -> str:
    """Whether what switches an effect on has stayed off, or a value stands at its bound."""
    z = candidate.fit.z
    if candidate.cause.shape is not None:
        switch = candidate.cause.parameters[0]
        if z.get(switch.coordinate, 0.0) == 0.0:
            return f"{candidate.name} fits best with {switch.name} at zero"
    for p in candidate.cause.parameters:
        x = z.get(p.coordinate)
        if x is not None and x in (prior.low.get(p.coordinate), prior.high.get(p.coordinate)):
            return f"{candidate.name} would need {p.name} outside its physical bounds"
    return ""


def alternatives_to(
    ranked: Sequence[Candidate], evidence: Evidence, extrapolated: bool
) -> tuple[Candidate, ...]:
    """Those that explain as much as the first one.

    Not what the first is a part of; nor, where the model is ``extrapolated`` in temperature, a
    fault of the instrument beside a change of the cell.
    """
    alternatives, best = [], ranked[0].cause.kind
    for other in ranked[1:]:
        ahead, error = difference(ranked[0], other, evidence)
        if PART_OF.get(ranked[0].name) == other.name:
            continue
        if extrapolated and (best, other.cause.kind) == ("cell", "measurement"):
            continue
        if other.score >= LEAST_SCORE and ahead < max(CLEAR_SCORE, CLEAR_SIGMAS * error):
            alternatives.append(other)
    return tuple(alternatives)


def close_candidates(ranked: Sequence[Candidate], evidence: Evidence) -> list[Candidate]:
    """The first one and those that it does not surely beat."""
    close = [ranked[0]]
    for other in ranked[1:]:
        ahead, error = difference(ranked[0], other, evidence)
        if other.score >= LEAST_SCORE and ahead < CLOSE_SIGMAS * error:
            close.append(other)
    return close


def predicts_worse(one: Candidate, lead: Candidate, gain: Gain, extrapolated: bool) -> bool:
    """Whether another candidate by itself predicts held-out rows so much better.

    ``gain`` is the lead's over the one.
    """
    if one is lead:
        return False
    if extrapolated and (one.cause.kind, lead.cause.kind) == ("cell", "measurement"):
        return False
    sure = max(gain.low, gain.low_in_size) > 0.0
    return sure and min(gain.gain, gain.gain_in_size) > CLOSE_GAIN
