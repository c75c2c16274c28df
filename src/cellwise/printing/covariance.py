"""Prints the covariance algebra of a filter from its list of states: every entry, once.

P is carried as its upper triangle. Each function is a pattern over the states: what it does to the
entry of states i and j. The order of operations is that of the patterns.
"""

from __future__ import annotations

from collections.abc import Callable

from cellwise.cell.description import CELL, OFFSET, SOC, State, entry, triangle
from cellwise.printing.text import head, wrapped_call

Pattern = Callable[[State, State], str]


def pair(states: tuple[State, ...], a: State, b: State) -> str:
    """Name of an entry, whichever comes first."""
    return entry(a, b) if states.index(a) <= states.index(b) else entry(b, a)


def output_sum(states: tuple[State, ...], of: Callable[[State], str]) -> str:
    """H times something: OCV slope and hysteresis, less the branches, plus R0 times the offset."""
    by = {s.letter: of(s) for s in states}
    if OFFSET in states:
        branches = f"fast * {by['1']} + tail * ({by['2']} + {by['3']})"
        return f"(slope_V * {by['s']} + m_V * {by['h']}) + (r0_ohm * {by['o']} - ({branches}))"
    return f"(slope_V * {by['s']} + m_V * {by['h']}) - (({by['1']} + {by['2']}) + {by['3']})"


class CovariancePrinter:
    """The functions over one list of states; ``name`` of its records, ``Covariance`` or other."""

    def __init__(self, states: tuple[State, ...], name: str = "", floor: str = "") -> None:
        self.states, self.name, self.floor = states, name, floor
        self.pairs = triangle(states)
        self.outputs = "slope_V: float, m_V: float"
        if OFFSET in states:
            self.outputs += ", fast: float, tail: float, r0_ohm: float"

    def function(
        self, title: str, arguments: str, text: str, pattern: Pattern, first: tuple[str, ...] = ()
    ) -> list[str]:
        """A function that returns a new covariance, entry by entry."""
        return [
            *("", "", "@inline"),
            *wrapped_call(f"def {title}", arguments.split(", "), f" -> {self.name}Covariance:"),
            f'    """{text}"""',
            *first,
            *wrapped_call(
                f"    return {self.name}Covariance", [pattern(a, b) for a, b in self.pairs]
            ),
        ]

    def records(self) -> list[str]:
        """P and a column of it."""
        return [
            *("", "", f"class {self.name}Covariance(NamedTuple):"),
            f'    """Upper triangle of P over {", ".join(s.name for s in self.states)}."""',
            "",
            *(f"    {entry(a, b)}: float" for a, b in self.pairs),
            *("", "", f"class {self.name}Column(NamedTuple):"),
            '    """One number for each state: P H\', or a gain."""',
            "",
            *(f"    {s.letter_name}: float  # {s.meaning}" for s in self.states),
        ]

    def uncorrelated(self) -> list[str]:
        """Only the diagonal."""
        arguments = ", ".join(f"{entry(s, s)}: float" for s in self.states)
        return self.function(
            "uncorrelated",
            arguments,
            "States that know nothing of each other.",
            lambda a, b: entry(a, b) if a is b else "0.0",
        )

    def decayed(self) -> list[str]:
        """A diagonal transition."""

        def pattern(a: State, b: State) -> str:
            factors = [f"t.{s.decay}" for s in (a, b) if s.decay]
            return " * ".join([*factors, f"p.{entry(a, b)}"])

        return self.function(
            "decayed",
            f"p: {self.name}Covariance, t: Transition",
            "A P A' with the diagonal transition A.",
            pattern,
        )

    def coupled(self, title: str, source: State, targets: dict[State, str], text: str) -> list[str]:
        """x_t += c_t x_source for some states t."""

        def pattern(a: State, b: State) -> str:
            old = f"p.{entry(a, b)}"
            ca, cb = targets.get(a), targets.get(b)
            with_a = f"p.{pair(self.states, source, b)}"
            with_b = f"p.{pair(self.states, source, a)}"
            square = f"p.{entry(source, source)}"
            if ca and a is b:
                return f"{old} + {ca} * (2.0 * {with_a} + {ca} * {square})"
            if ca and cb:
                return f"{old} + ({ca} * {with_a} + {cb} * {with_b} + {ca} * {cb} * {square})"
            if ca:
                return f"{old} + {ca} * {with_a}"
            if cb:
                return f"{old} + {cb} * {with_b}"
            return old

        arguments = ", ".join(f"{c}: float" for c in targets.values())
        return self.function(title, f"p: {self.name}Covariance, {arguments}", text, pattern)

    def noisy(self) -> list[str]:
        """Noise of the current sensor, and of each state alone."""
        shares = {s: f"w{s.letter}" for s in self.states if s.drive}

        def pattern(a: State, b: State) -> str:
            old = f"p.{entry(a, b)}"
            if not (a.drive and b.drive):
                return old
            size = "soc_A2" if a is SOC or b is SOC else "branch_A2"
            common = f"{size} * t.{a.drive} * t.{b.drive}"
            return f"{old} + ({common} + {shares[a]})" if a is b else f"{old} + {common}"

        alone = ", ".join(f"{w}: float" for w in shares.values())
        return self.function(
            "noisy",
            f"p: {self.name}Covariance, t: Transition, soc_A2: float, branch_A2: float, {alone}",
            "A current of unknown size drives what the current drives; w is what each gains alone.",
            pattern,
        )

    def branches_noisy(self) -> list[str]:
        """What each branch gains alone."""
        branches = [s for s in self.states if s.output == "-1"]

        def pattern(a: State, b: State) -> str:
            more = f" + w{a.letter}" if a is b and a in branches else ""
            return f"p.{entry(a, b)}{more}"

        arguments = ", ".join(f"w{s.letter}: float" for s in branches)
        return self.function(
            "branches_noisy",
            f"p: {self.name}Covariance, {arguments}",
            "What each branch gains by itself.",
            pattern,
        )

    def soc_known(self) -> list[str]:
        """Another variance of SOC."""
        return self.function(
            "with_soc_variance",
            f"p: {self.name}Covariance, ss: float",
            "The same with another variance of SOC.",
            lambda a, b: "ss" if a is b and a is SOC else f"p.{entry(a, b)}",
        )

    def soc_row_set(self) -> list[str]:
        """Another row of SOC."""
        return self.function(
            "with_soc_row",
            f"p: {self.name}Covariance, ss: float, c: {self.name}Column, factor: float",
            "The same with another variance of SOC, and factor c as its covariances.",
            lambda a, b: (
                "ss"
                if a is b and a is SOC
                else f"factor * c.{b.letter_name}"
                if a is SOC
                else f"p.{entry(a, b)}"
            ),
        )

    def parameters_set(self) -> list[str]:
        """Other variances of the parameters that stand behind the cell's states."""
        kept = [s for s in self.states if s not in CELL]
        names = [entry(a, b) for a, b in self.pairs if a in kept]
        return self.function(
            "with_parameters",
            f"p: {self.name}Covariance, " + ", ".join(f"{n}: float" for n in names),
            "The same with other variances of offset and capacity.",
            lambda a, b: entry(a, b) if a in kept else f"p.{entry(a, b)}",
        )

    def column_of(self, state: State, name: str) -> list[str]:
        """One column of P."""
        return [
            *("", "", "@inline"),
            f"def {name}(p: {self.name}Covariance) -> {self.name}Column:",
            f'    """Covariance of every state with the {state.name.split("_")[0]}."""',
            *wrapped_call(
                f"    return {self.name}Column",
                [f"p.{pair(self.states, state, s)}" for s in self.states],
            ),
        ]

    def given_soc(self) -> list[str]:
        """P less an outer product, for the states beside SOC."""
        return self.function(
            "without_outer",
            f"p: {self.name}Covariance, c: {self.name}Column",
            "P - c c' among the states beside SOC: the covariance given the SOC.",
            lambda a, b: (
                f"p.{entry(a, b)}"
                if a is SOC
                else f"p.{entry(a, b)} - c.{a.letter_name} * c.{b.letter_name}"
            ),
        )

    def plus_outer(self) -> list[str]:
        """P plus two outer products."""
        return self.function(
            "with_outer",
            f"p: {self.name}Covariance, c: {self.name}Column, share: float, e: {self.name}Column",
            "P + c c' + share e e' among the states beside SOC.",
            lambda a, b: (
                f"p.{entry(a, b)}"
                if a is SOC
                else f"p.{entry(a, b)} + c.{a.letter_name} * c.{b.letter_name}"
                f" + share * e.{a.letter_name} * e.{b.letter_name}"
            ),
        )

    def column(self) -> list[str]:
        """P H' and H P H'."""
        lines = [
            *("", "", "@inline"),
            *wrapped_call(
                "def column",
                [f"p: {self.name}Covariance", *self.outputs.split(", ")],
                f" -> {self.name}Column:",
            ),
            '    """P H\', the covariance of every state with the voltage."""',
        ]
        for s in self.states:
            total = output_sum(self.states, lambda o, s=s: f"p.{pair(self.states, s, o)}")  # type: ignore[misc]
            lines.append(f"    {s.letter_name} = {total}")
        lines += wrapped_call(f"    return {self.name}Column", [s.letter_name for s in self.states])
        lines += [
            *("", "", "@inline"),
            *wrapped_call(
                "def explained",
                [f"d: {self.name}Column", *self.outputs.split(", ")],
                " -> float:",
            ),
            '    """H P H\', the variance of the voltage that the state explains [V^2]."""',
            f"    return {output_sum(self.states, lambda s: f'd.{s.letter_name}')}",
        ]
        return lines

    def gain(self) -> list[str]:
        """A column times a number."""
        return [
            *("", "", "@inline"),
            f"def scaled(d: {self.name}Column, factor: float) -> {self.name}Column:",
            '    """A column times a number: a gain."""',
            *wrapped_call(
                f"    return {self.name}Column",
                [f"d.{s.letter_name} * factor" for s in self.states],
            ),
        ]

    def corrected(self) -> list[str]:
        """P - K d'."""

        def pattern(a: State, b: State) -> str:
            new = f"p.{entry(a, b)} - k.{a.letter_name} * d.{b.letter_name}"
            if a is not b:
                return new
            return f"max({new}, {'VARIANCE_FLOOR' if a is SOC else '0.0'})"

        return self.function(
            "corrected",
            f"p: {self.name}Covariance, k: {self.name}Column, d: {self.name}Column",
            "P - k d', d = P H', after a voltage with the gain k.",
            pattern,
        )

    def rejudged(self, states: tuple[State, ...]) -> list[str]:
        """Joseph's form for a gain of one slope judged by another."""

        def pattern(a: State, b: State) -> str:
            old = f"p.{entry(a, b)}"
            if a not in states or b not in states:
                return old
            ka, kb, ca, cb = (
                f"{x}.{s.letter_name}" for x, s in (("k", a), ("k", b), ("c", a), ("c", b))
            )
            if a is b:
                return f"{old} + {ka} * ({ka} * e - 2.0 * {ca})"
            return f"{old} + ({ka} * {kb} * e - {ka} * {cb} - {kb} * {ca})"

        return self.function(
            "rejudged",
            f"p: {self.name}Covariance, k: {self.name}Column, c: {self.name}Column, e: float",
            "P where a gain k of one slope is judged by another (Joseph): + e k k' - k c' - c k'.",
            pattern,
        )

    def row(self) -> list[str]:
        """SOC's row of P."""
        names = [f"p.{entry(SOC, s)} * factor" for s in self.states]
        return [
            *("", "", "@inline"),
            f"def soc_row(p: {self.name}Covariance, factor: float) -> {self.name}Column:",
            '    """SOC\'s row of P times a number."""',
            *wrapped_call(f"    return {self.name}Column", names),
        ]

    def text(self, title: str, extra: list[str]) -> str:
        """The module."""
        lines = [
            *head(title),
            "from typing import NamedTuple",
            "",
            "from cellwise.cell.compiled import inline",
            "from cellwise.cell.equations import Transition",
            "",
            "VARIANCE_FLOOR = 1e-12",
            *self.records(),
            *self.uncorrelated(),
            *self.decayed(),
            *self.branches_noisy(),
            *self.noisy(),
            *self.soc_known(),
            *extra,
            *self.column(),
            *self.gain(),
            *self.corrected(),
            *self.row(),
        ]
        return "\n".join([*lines, ""])
