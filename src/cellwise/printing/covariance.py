"""Prints the covariance algebra of the filters from their list of states: every entry, once.

P is carried as its upper triangle. Each function is a pattern over the states: what it does to the
entry of states i and j. The order of operations is that of the patterns.
"""

from __future__ import annotations

from collections.abc import Callable

from cellwise.cell.description import CELL, SOC, V1, V2, V3, State, entry, triangle
from cellwise.printing.text import head, wrapped_call

Pattern = Callable[[State, State], str]
PAIRS = triangle(CELL)
BRANCHES = (V1, V2, V3)
P, D = "p: Covariance", "d: Column"
OUTPUTS = "slope_V: float, m_V: float"


def of_p(a: State, b: State) -> str:
    """An entry of P."""
    return f"p.{entry(a, b)}"


def output_sum(of: Callable[[State], str]) -> str:
    """H times something: OCV slope and hysteresis, less the branches, the first by its factor."""
    s, v1, v2, v3, h = (of(state) for state in CELL)
    return f"(slope_V * {s} + m_V * {h}) - (({v1} + {v2}) + {v3})"


def head_of(title: str, arguments: str, result: str, text: str) -> list[str]:
    """All of a function but what it does."""
    first = wrapped_call(f"def {title}", arguments.split(", "), f" -> {result}:")
    return ["", "", "@inline", *first, f'    """{text}"""']


def matrix(title: str, arguments: str, text: str, pattern: Pattern) -> list[str]:
    """A function that returns a new covariance, entry by entry."""
    entries = [pattern(a, b) for a, b in PAIRS]
    return [
        *head_of(title, arguments, "Covariance", text),
        *wrapped_call("    return Covariance", entries),
    ]


def column_of(title: str, arguments: str, text: str, of: Callable[[State], str]) -> list[str]:
    """A function that returns a column, state by state."""
    return [
        *head_of(title, arguments, "Column", text),
        *wrapped_call("    return Column", [of(s) for s in CELL]),
    ]


def records() -> list[str]:
    """P and a column of it."""
    return [
        *("", "", "class Covariance(NamedTuple):"),
        f'    """Upper triangle of P over {", ".join(s.name for s in CELL)}."""',
        "",
        *(f"    {entry(a, b)}: float" for a, b in PAIRS),
        *("", "", "class Column(NamedTuple):"),
        '    """One number for each state: P H\', or a gain."""',
        "",
        *(f"    {s.letter_name}: float  # {s.meaning}" for s in CELL),
    ]


def driven(a: State, b: State) -> str:
    """The SOC drives the branches: x_j += f_j soc."""
    old, square = of_p(a, b), of_p(SOC, SOC)
    fa, fb = (f"f{s.letter}" if s in BRANCHES else "" for s in (a, b))
    with_a, with_b = of_p(SOC, b), of_p(SOC, a)
    if fa and a is b:
        return f"{old} + {fa} * (2.0 * {with_a} + {fa} * {square})"
    if fa and fb:
        return f"{old} + ({fa} * {with_a} + {fb} * {with_b} + {fa} * {fb} * {square})"
    if fa:
        return f"{old} + {fa} * {with_a}"
    return f"{old} + {fb} * {with_b}" if fb else old


def noise(a: State, b: State) -> str:
    """Noise of the current sensor, and the SOC's own."""
    if not (a.drive and b.drive):
        return of_p(a, b)
    common = f"{'soc_A2' if SOC in (a, b) else 'branch_A2'} * t.{a.drive} * t.{b.drive}"
    return f"{of_p(a, b)} + " + (f"({common} + ws)" if a is b is SOC else common)


def outer(a: State, b: State, column: str = "c") -> str:
    """An entry of a column times itself."""
    return f"{column}.{a.letter_name} * {column}.{b.letter_name}"


def with_two(a: State, b: State) -> str:
    """P and two outer products, beside the SOC."""
    more = f" + {outer(a, b)} + share * {outer(a, b, 'e')}"
    return of_p(a, b) + ("" if a is SOC else more)


def joseph(a: State, b: State) -> str:
    """What Joseph's form has beside P - K d'."""
    (ka, kb), (ca, cb) = ([f"{x}.{s.letter_name}" for s in (a, b)] for x in "kc")
    if a is b:
        return f"{of_p(a, b)} + {ka} * ({ka} * e - 2.0 * {ca})"
    return f"{of_p(a, b)} + ({ka} * {kb} * e - {ka} * {cb} - {kb} * {ca})"


def corrected(a: State, b: State) -> str:
    """P - K d', variances not below zero."""
    new = f"{of_p(a, b)} - k.{a.letter_name} * d.{b.letter_name}"
    return f"max({new}, {'VARIANCE_FLOOR' if a is SOC else '0.0'})" if a is b else new


def output() -> list[str]:
    """P H' and H P H'."""
    text = "P H', the covariance of every state with the voltage."
    lines = head_of("column", f"{P}, {OUTPUTS}", "Column", text)
    for s in CELL:
        lines.append(f"    {s.letter_name} = {output_sum(lambda o, s=s: of_p(s, o))}")  # type: ignore[misc]
    text = "H P H', the variance of the voltage that the state explains [V^2]."
    return [
        *lines,
        *wrapped_call("    return Column", [s.letter_name for s in CELL]),
        *head_of("explained", f"{D}, {OUTPUTS}", "float", text),
        f"    return {output_sum(lambda s: f'd.{s.letter_name}')}",
    ]


def moved() -> list[str]:
    """A state after a gain."""
    sums = [f"x.{s.name} + k.{s.letter_name} * innovation_V" for s in CELL]
    sums[-1] = f"min(max({sums[-1]}, -1.0), 1.0)"
    return [
        *head_of("moved", "x: CellState, k: Column, innovation_V: float", "CellState",
                 "State + k innovation."),
        *wrapped_call("    return CellState", [*sums, "x.heat_K", "x.slow_A"]),
    ]  # fmt: skip


def covariance_text() -> str:
    """The module."""
    c = f"{P}, c: Column"
    lines = [
        *head("Covariance of the filters over SOC, branches and hysteresis."),
        "from typing import NamedTuple",
        "",
        "from cellwise.cell.compiled import inline",
        "from cellwise.cell.equations import CellState, Transition",
        "",
        "VARIANCE_FLOOR = 1e-12",
        *records(),
        *matrix("uncorrelated", ", ".join(f"{entry(s, s)}: float" for s in CELL),
                "States that know nothing of each other.",
                lambda a, b: entry(a, b) if a is b else "0.0"),
        *matrix("decayed", f"{P}, t: Transition", "A P A' with the diagonal transition A.",
                lambda a, b: " * ".join(
                    [*(f"t.{s.decay}" for s in (a, b) if s.decay), of_p(a, b)])),
        *matrix("branches_noisy", ", ".join([P, *(f"w{s.letter}: float" for s in BRANCHES)]),
                "What each branch gains by itself.",
                lambda a, b: of_p(a, b) + (f" + w{a.letter}" if a is b in BRANCHES else "")),
        *matrix("noisy",
                f"{P}, t: Transition, soc_A2: float, branch_A2: float, ws: float",
                "A current of unknown size drives what it drives; ws is what SOC gains alone.",
                noise),
        *matrix("with_soc_variance", f"{P}, ss: float",
                "The same with another variance of SOC.",
                lambda a, b: "ss" if b is SOC else of_p(a, b)),
        *matrix("driven_by_soc", ", ".join([P, *(f"f{s.letter}: float" for s in BRANCHES)]),
                "A SOC that is off drives the branches by the resistances' slopes: x_j += f_j soc.",
                driven),
        *matrix("with_soc_row", f"{P}, ss: float, c: Column, factor: float",
                "The same with another variance of SOC, and factor c as its covariances.",
                lambda a, b: ("ss" if b is SOC else f"factor * c.{b.letter_name}")
                if a is SOC else of_p(a, b)),
        *matrix("without_outer", c,
                "P - c c' among the states beside SOC: the covariance given the SOC.",
                lambda a, b: of_p(a, b) + ("" if a is SOC else f" - {outer(a, b)}")),
        *matrix("with_outer", f"{c}, share: float, e: Column",
                "P + c c' + share e e' among the states beside SOC.", with_two),
        *matrix("joseph", f"{P}, k: Column, c: Column, e: float",
                "P where a gain k of one slope is judged by another: + e k k' - k c' - c k'.",
                joseph),
        *output(),
        *column_of("scaled", f"{D}, factor: float", "A column times a number: a gain.",
                   lambda s: f"d.{s.letter_name} * factor"),
        *matrix("corrected", f"{P}, k: Column, {D}",
                "P - k d', d = P H', after a voltage with the gain k.", corrected),
        *column_of("soc_row", f"{P}, factor: float", "SOC's row of P times a number.",
                   lambda s: f"{of_p(SOC, s)} * factor"),
        *moved(),
    ]  # fmt: skip
    return "\n".join([*lines, ""])
