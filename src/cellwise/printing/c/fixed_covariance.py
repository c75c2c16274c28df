"""The covariance of the fixed step, printed from the table of the states.

Every function is a pattern over the states of :data:`cellwise.cell.description.FIXED`. The order of
operations within an expression belongs to the pattern: the bits depend on it.
"""

from __future__ import annotations

from itertools import groupby

from cellwise.cell.description import FIXED, OFFSET, SOC, V1, V2, V3, H, State, entry, triangle

BRANCHES = (V1, V2, V3)
OTHERS = (H, OFFSET)
PAIRS = triangle(FIXED)
ORDER = [
    "", "SLOW", "HYSTERESIS", "SLOW and HYSTERESIS", "OFFSET", "SLOW and OFFSET",
    "HYSTERESIS and OFFSET",
]  # fmt: skip
OUTPUT = {SOC: "slope", H: "p.m_V", OFFSET: "p.r0_ohm"}  # a branch's is -1

Line = tuple[tuple[State, ...], str]  # the states that it needs, what it says


def e(a: State, b: State) -> str:
    """The entry of P of two states."""
    return f"x.{entry(a, b)}"


def lines(*found: Line) -> str:
    """Lines under the options of their states, neighbours under one ``if``."""
    text: list[str] = []
    for option, group in groupby(found, _option):
        text += [f"    if {option}:"] if option else []
        text += [("        " if option else "    ") + line for _, line in group]
    return "\n".join(text)


def _option(line: Line) -> str:
    states = sorted(line[0], key=FIXED.index)
    return " and ".join(dict.fromkeys(s.option.upper() for s in states if s.option))


def by_option(found: list[Line]) -> list[Line]:
    """Option by option, what is always there first; each option after those it stands on."""
    return sorted(found, key=lambda line: ORDER.index(_option(line)))


def sound() -> str:
    """Every entry in its range."""
    found: list[Line] = []
    for a, b in PAIRS:
        test = f"not_negative({e(a, b)}, LARGE)" if a is b else f"size_within({e(a, b)}, LARGE)"
        found.append(((a, b), test))
    text = []
    for option, group in groupby(by_option(found), _option):
        for _, test in group:
            refused = f"{option} and not {test}" if option else f"not {test}"
            text += [f"    if {refused}:", "        return False"]
    text[-2] += "  # noqa: SIM103"
    return "\n".join([*text, "    return True"])


def forget() -> str:
    """Nothing off the diagonal."""
    found: list[Line] = [((a, b), f"{e(a, b)} = ZERO") for a, b in PAIRS if a is not b]
    return lines(*by_option(found))


def start() -> str:
    """The diagonal of a cell at rest."""
    known = {SOC: "soc_variance", H: "ONE", OFFSET: "c.offset_variance_A2"}
    return lines(*[((s,), f"{e(s, s)} = {known.get(s, 'ZERO')}") for s in FIXED])


def hysteresis(left: str, square: str) -> str:
    """What becomes of the row of h: a factor on each entry, and one on its variance."""
    found: list[Line] = [
        ((a, b), f"{e(a, b)} = {(square if a is b else left).format(e(a, b))}")
        for a, b in PAIRS
        if H in (a, b)
    ]
    return lines(*by_option([((*s,), text) for s, text in found]))


def relax() -> str:
    """Branches and their rows over an interval; the slow one is stated by what it loses."""
    found: list[Line] = [((s,), f"a{s.letter} = ONE - gain{s.letter}") for s in BRANCHES]
    for s in BRANCHES:
        v = f"x.{s.name}"
        step = f"gain{s.letter} * ((r{s.letter}_ohm * flow) - {v})"
        kept = f"{v}, x.v3_carry_V = add({v}, x.v3_carry_V, {step})"
        found.append(((s,), kept if s is V3 else f"{v} = {v} + ({step})"))
    for a, b in PAIRS:
        both, gain, r = e(a, b), f"gain{b.letter if a is SOC else a.letter}", f"r{a.letter}_ohm"
        if a in BRANCHES and b is a:
            driven = f"(square_A2 * ({r} * {r})) - {both}"
            found.append(((a,), f"{both} = {both} + (({gain} * (ONE + a{a.letter})) * ({driven}))"))
        elif a in BRANCHES and b in BRANCHES:
            slowly = f"{both} - ((gain2 + (gain3 * a2)) * {both})"
            decayed = f"(a{a.letter} * a{b.letter}) * {both}"
            found.append(((a, b), f"{both} = {slowly if (a, b) == (V2, V3) else decayed}"))
        elif a in BRANCHES or b in BRANCHES:
            found.append(((a, b), f"{both} = {both} - ({gain} * {both})"))
    return lines(*by_option(found))


def tilt() -> str:
    """F P F' where SOC drives branch i by f_i."""
    found: list[Line] = [
        ((s,), f"f{s.letter} = (w.rise{s.letter} * p.gain{s.letter}) * flow") for s in BRANCHES
    ]
    last: list[Line] = []
    for i, a in enumerate(BRANCHES):
        f, s = f"f{a.letter}", e(SOC, a)
        own = e(a, a)
        found.append(((a,), f"{own} = {own} + ({f} * ((TWO * {s}) + ({f} * x.ss)))"))
        for b in BRANCHES[i + 1 :]:
            g, t, both = f"f{b.letter}", e(SOC, b), e(a, b)
            sums = f"(({f} * {t}) + ({g} * {s})) + (({f} * {g}) * x.ss)"
            found.append(((a, b), f"{both} = {both} + ({sums})"))
        found += [((a, o), f"{e(a, o)} = {e(a, o)} + ({f} * {e(SOC, o)})") for o in OTHERS]
    for a in BRANCHES:
        last.append(((a,), f"{e(SOC, a)} = {e(SOC, a)} + (f{a.letter} * x.ss)"))
    return lines(*by_option(found), *last)


def spread_offset() -> str:
    """F P F' where the offset drives SOC and branch i by e_i."""
    driven = (SOC, *BRANCHES)
    found: list[Line] = []
    for s in driven:
        k = s.letter
        drive = "c.soc_per_A" if s is SOC else f"-(p.gain{k} * p.r{k}_ohm)"
        found += [((s,), f"e{k} = {drive}"), ((s,), f"c{k} = {e(s, OFFSET)} + (e{k} * x.poo)")]
    for a, b in PAIRS:
        i, j, both = a.letter, b.letter, e(a, b)
        if a is b and a in driven:
            found.append(((a,), f"{both} = {both} + (e{i} * ({e(a, OFFSET)} + c{i}))"))
        elif a in driven and b in driven:
            sums = f"(e{j} * {e(a, OFFSET)}) + (e{i} * c{j})"
            found.append(((a, b), f"{both} = {both} + ({sums})"))
        elif a in driven and b is H:
            found.append(((a, b), f"{both} = {both} + (e{i} * {e(H, OFFSET)})"))
    last: list[Line] = [((s,), f"{e(s, OFFSET)} = c{s.letter}") for s in driven]
    return lines(*by_option(found), *by_option(last))


def column_of() -> str:
    """P H' by its states, then H P H'; what is always there first, the slow branch after it."""
    first: list[Line] = []
    terms: list[Line] = []
    for s in FIXED:
        d = s.letter_name
        fast = f"{e(s, V1)} + {e(s, V2)}"
        base = f"(slope * {e(SOC, s)}) - ({f'({fast}) + {e(s, V3)}' if s is V3 else fast})"
        option = _option(((s,), ""))
        first.append(((), f"{d} = ({base}) if {option} else ZERO" if option else f"{d} = {base}"))
        own = [s] if s in OTHERS else []
        for t in (*own, *(t for t in (V3, *OTHERS) if t is not s)):
            term = f"- {e(s, t)}" if t is V3 else f"+ ({OUTPUT[t]} * {e(s, t)})"
            terms.append(((s, t), f"{d} = {d} {term}"))
    last: list[Line] = [((), "variance = (slope * s) - (v1 + v2)")]
    last += [((V3,), "variance = variance - v3")]
    last += [((s,), f"variance = variance + ({OUTPUT[s]} * {s.letter_name})") for s in OTHERS]
    return lines(*first, *by_option(terms), *last)


def move() -> str:
    """State + K innovation."""
    found: list[Line] = []
    for s in FIXED:
        d = s.letter_name
        v, step = f"x.{s.name}", f"(d.{d} * inverse) * innovation"
        said = f"{v} = {v} + ({step})"
        if s in (SOC, V3):
            carry = "x.soc_carry" if s is SOC else "x.v3_carry_V"
            said = f"{v}, {carry} = add({v}, {carry}, {step})"
        elif s in OTHERS:
            said = f"{v} = clip({v} + ({step}), -ONE, ONE)"
            if s is OFFSET:
                found.append(((s,), f"offset_A = {v} + ({step})"))
                said = f"{v} = clip(offset_A, -c.current_limit_A, c.current_limit_A)"
        found.append(((s,), said))
    return lines(*found)


def narrow() -> str:
    """P - K d', row by row."""
    found: list[Line] = []
    for a, b in PAIRS:
        both, less = e(a, b), f"(k * d.{b.letter_name})"
        if a is b:
            found.append(((a,), f"k = d.{a.letter_name} * inverse"))
        if b is SOC:
            found.append(((), f"add_variance(x, -{less})"))
            found.append(((), f"x.ss = {FLOOR}"))
        elif a is b:
            found.append(((a,), f"{both} = at_least({both} - {less}, ZERO)"))
        else:
            found.append(((a, b), f"{both} = {both} - {less}"))
    return lines(*found)


def rejudge() -> str:
    """Joseph's form for a gain that was that of another slope, entry by entry."""
    found: list[Line] = []
    for s in FIXED:
        d = s.letter_name
        found.append(((s,), f"k{s.letter} = d.{d} * inverse"))
        found.append(((s,), f"c{s.letter} = less * {e(SOC, s)}"))
    for a, b in PAIRS:
        i, j, both = a.letter, b.letter, e(a, b)
        wider = "wider" if b is SOC else f"rejudged(k{i}, k{j}, c{i}, c{j}, e)"
        found.append(((a, b), f"{both} = {both} + {wider}"))
    return lines(*by_option(found))


FLOOR = "clip(x.ss, VARIANCE_FLOOR, LARGE) if WIDE else at_least(x.ss, VARIANCE_FLOOR)"


def print_covariance() -> str:
    """The whole module."""
    patterns = {
        "forget": forget(), "sound": sound(), "start": start(), "relax": relax(), "tilt": tilt(),
        "fade": hysteresis("keep * {}", "(keep * keep) * {}"), "offset": spread_offset(),
        "unknown": hysteresis("ZERO", "ONE"), "column": column_of(), "move": move(),
        "narrow": narrow(), "rejudge": rejudge(),
    }  # fmt: skip
    found = TEMPLATE
    for name, pattern in patterns.items():
        found = found.replace(f"    [{name}]", pattern)
    return found


TEMPLATE = '''"""Covariance of the fixed step: what a step does to P and to the state through it.

Printed from the table of states in ``cellwise.cell.description`` by ``python -m cellwise.printing``
(``fixed_covariance``); do not edit.
"""

from __future__ import annotations

from typing import NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    GROW,
    LARGE,
    ONE,
    TWO,
    VARIANCE_FLOOR,
    ZERO,
    Constants,
    Flag,
    Float,
    HysteresisFloat,
    OffsetFloat,
    SlowFloat,
    State,
    add,
    at_least,
    clip,
    not_negative,
    size_within,
)
from cellwise.estimate.fixed.lookup import Point, Slopes
from cellwise.estimate.fixed.options import HYSTERESIS, OFFSET, SLOW, WIDE


class Column(NamedTuple):
    """P H', with H = [slope, -1, -1, -1, m, r0], and the innovation variance it explains."""

    s: Float
    v1: Float
    v2: Float
    v3: SlowFloat
    h: HysteresisFloat
    o: OffsetFloat
    variance: Float


def add_variance(x: State, value: Float) -> None:
    """A variance of SOC that is large changes by less than rounding keeps of it."""
    if WIDE:
        x.ss, x.ss_carry = add(x.ss, x.ss_carry, value)
    else:
        x.ss = x.ss + value


def covariance_is_sound(x: State) -> Flag:
    """Every entry in its range."""
    [sound]


def forget_correlations(x: State) -> None:
    """Only the diagonal stays."""
    [forget]


def start_covariance(c: Constants, x: State, soc_variance: Float) -> None:
    """SOC known with a variance, branches at rest, nothing known of hysteresis."""
    forget_correlations(x)
    [start]


def relax(
    x: State,
    r1_ohm: Float,
    gain1: Float,
    r2_ohm: Float,
    gain2: Float,
    r3_ohm: SlowFloat,
    gain3: SlowFloat,
    flow: Float,
    square_A2: Float,
) -> None:
    """The branches over one interval of constant current, exactly, and their covariance.

    A current that is not known to ``square_A2`` drives them too; 1 - a^2 keeps the stationary
    spread independent of the time step. What decays slowly is stated by how much it loses: 1 - 1e-5
    as a float is off by 0.3 % of that.
    """
    [relax]


def fade_hysteresis(x: State, keep: Float) -> None:
    """The row of h where a share of h is kept."""
    [fade]


def forget_hysteresis(x: State) -> None:
    """Nothing is known of h."""
    [unknown]


def tilt(x: State, p: Point, w: Slopes, flow: Float) -> None:
    """A SOC that is off drives the branches by the resistances' slopes."""
    [tilt]


def spread_offset(c: Constants, x: State, p: Point) -> None:
    """The sensor's offset drives every state that the current drives.

    The offset's column of P has decayed already; e is what one ampere of offset does to a state in
    one step.
    """
    [offset]
    x.poo = x.poo * GROW
    if x.poo < c.offset_variance_A2:
        x.poo = x.poo + c.offset_walk_A2


def column_of(x: State, p: Point, slope: Float) -> Column:
    """The column, and the innovation variance that the state explains."""
    [column]
    variance = variance if variance > ZERO else ZERO
    return Column(s, v1, v2, v3, h, o, variance)


def move(c: Constants, x: State, d: Column, inverse: Float, innovation: Float) -> None:
    """State + K innovation."""
    [move]


def narrow(x: State, d: Column, inverse: Float) -> None:
    """P - K d', row by row."""
    [narrow]


def rejudged(ki: Float, kj: Float, ci: Float, cj: Float, e: Float) -> Float:
    """What is added to an entry of P when a gain of one slope is judged by another (Joseph)."""
    return ((ki * kj) * e) - ((ki * cj) + (kj * ci))


def rejudge_covariance(
    x: State, d: Column, inverse: Float, less: Float, e: Float, wider: Float
) -> None:
    """The gain was that of another slope: by ``less`` than what it is judged by."""
    [rejudge]
'''
