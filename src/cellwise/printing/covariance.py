"""Prints the covariance algebra of a filter from its list of states: every entry, once.

P is carried as its upper triangle. Each function is a pattern over the states: what it does to the
entry of states i and j. The order of operations is that of the patterns.
"""

from __future__ import annotations

from collections.abc import Callable

from cellwise.cell.description import CELL, OFFSET, SOC, State, entry, triangle
from cellwise.printing.text import head, wrapped_call

Pattern = Callable[[State, State], str]


def of_p(a: State, b: State) -> str:
    """An entry of P."""
    return f"p.{entry(a, b)}"


def output_sum(states: tuple[State, ...], of: Callable[[State], str]) -> str:
    """H times something: OCV slope and hysteresis, less the branches, plus R0 times the offset."""
    by = {s.letter: of(s) for s in states}
    if OFFSET in states:
        branches = f"fast * {by['1']} + ({by['2']} + {by['3']})"
        return f"(slope_V * {by['s']} + m_V * {by['h']}) + (r0_ohm * {by['o']} - ({branches}))"
    return f"(slope_V * {by['s']} + m_V * {by['h']}) - (({by['1']} + {by['2']}) + {by['3']})"


class CovariancePrinter:
    """The functions over one list of states; ``name`` is put before that of its records."""

    def __init__(self, states: tuple[State, ...], name: str = "") -> None:
        self.states, self.pairs = states, triangle(states)
        self.matrix, self.vector = f"{name}Covariance", f"{name}Column"
        self.p, self.d = f"p: {self.matrix}", f"d: {self.vector}"
        self.outputs = "slope_V: float, m_V: float"
        if OFFSET in states:
            self.outputs += ", fast: float, r0_ohm: float"

    def _function(self, title: str, arguments: str, result: str, text: str) -> list[str]:
        """All of a function but what it does."""
        first = wrapped_call(f"def {title}", arguments.split(", "), f" -> {result}:")
        return ["", "", "@inline", *first, f'    """{text}"""']

    def function(self, title: str, arguments: str, text: str, pattern: Pattern) -> list[str]:
        """A function that returns a new covariance, entry by entry."""
        return [
            *self._function(title, arguments, self.matrix, text),
            *wrapped_call(f"    return {self.matrix}", [pattern(a, b) for a, b in self.pairs]),
        ]

    def column_function(
        self, title: str, arguments: str, text: str, of: Callable[[State], str]
    ) -> list[str]:
        """A function that returns a column, state by state."""
        return [
            *self._function(title, arguments, self.vector, text),
            *wrapped_call(f"    return {self.vector}", [of(s) for s in self.states]),
        ]

    def records(self) -> list[str]:
        """P and a column of it."""
        return [
            *("", "", f"class {self.matrix}(NamedTuple):"),
            f'    """Upper triangle of P over {", ".join(s.name for s in self.states)}."""',
            "",
            *(f"    {entry(a, b)}: float" for a, b in self.pairs),
            *("", "", f"class {self.vector}(NamedTuple):"),
            '    """One number for each state: P H\', or a gain."""',
            "",
            *(f"    {s.letter_name}: float  # {s.meaning}" for s in self.states),
        ]

    def uncorrelated(self) -> list[str]:
        """Only the diagonal."""
        return self.function(
            "uncorrelated",
            ", ".join(f"{entry(s, s)}: float" for s in self.states),
            "States that know nothing of each other.",
            lambda a, b: entry(a, b) if a is b else "0.0",
        )

    def decayed(self) -> list[str]:
        """A diagonal transition."""
        return self.function(
            "decayed",
            f"{self.p}, t: Transition",
            "A P A' with the diagonal transition A.",
            lambda a, b: " * ".join([*(f"t.{s.decay}" for s in (a, b) if s.decay), of_p(a, b)]),
        )

    def coupled(self, title: str, source: State, targets: dict[State, str], text: str) -> list[str]:
        """x_t += c_t x_source for some states t."""

        def pattern(a: State, b: State) -> str:
            old, square = of_p(a, b), of_p(source, source)
            ca, cb = targets.get(a), targets.get(b)
            with_a, with_b = of_p(source, b), of_p(source, a)
            if ca and a is b:
                return f"{old} + {ca} * (2.0 * {with_a} + {ca} * {square})"
            if ca and cb:
                return f"{old} + ({ca} * {with_a} + {cb} * {with_b} + {ca} * {cb} * {square})"
            if ca:
                return f"{old} + {ca} * {with_a}"
            return f"{old} + {cb} * {with_b}" if cb else old

        arguments = ", ".join(f"{c}: float" for c in targets.values())
        return self.function(title, f"{self.p}, {arguments}", text, pattern)

    def noisy(self) -> list[str]:
        """Noise of the current sensor, and of each state alone."""
        shares = {s: f"w{s.letter}" for s in self.states if s.drive}

        def pattern(a: State, b: State) -> str:
            if not (a.drive and b.drive):
                return of_p(a, b)
            size = "soc_A2" if SOC in (a, b) else "branch_A2"
            common = f"{size} * t.{a.drive} * t.{b.drive}"
            return f"{of_p(a, b)} + " + (f"({common} + {shares[a]})" if a is b else common)

        alone = ", ".join(f"{w}: float" for w in shares.values())
        return self.function(
            "noisy",
            f"{self.p}, t: Transition, soc_A2: float, branch_A2: float, {alone}",
            "A current of unknown size drives what the current drives; w is what each gains alone.",
            pattern,
        )

    def branches_noisy(self) -> list[str]:
        """What each branch gains alone."""
        branches = [s for s in self.states if s.output == "-1"]
        return self.function(
            "branches_noisy",
            ", ".join([self.p, *(f"w{s.letter}: float" for s in branches)]),
            "What each branch gains by itself.",
            lambda a, b: of_p(a, b) + (f" + w{a.letter}" if a is b and a in branches else ""),
        )

    def soc_known(self) -> list[str]:
        """Another variance of SOC."""
        return self.function(
            "with_soc_variance",
            f"{self.p}, ss: float",
            "The same with another variance of SOC.",
            lambda a, b: "ss" if b is SOC else of_p(a, b),
        )

    def soc_row_set(self) -> list[str]:
        """Another row of SOC."""

        def pattern(a: State, b: State) -> str:
            row = "ss" if b is SOC else f"factor * c.{b.letter_name}"
            return row if a is SOC else of_p(a, b)

        return self.function(
            "with_soc_row",
            f"{self.p}, ss: float, c: {self.vector}, factor: float",
            "The same with another variance of SOC, and factor c as its covariances.",
            pattern,
        )

    def parameters_set(self) -> list[str]:
        """Other variances of the parameters that stand behind the cell's states."""
        names = [entry(a, b) for a, b in self.pairs if a not in CELL]
        return self.function(
            "with_parameters",
            ", ".join([self.p, *(f"{n}: float" for n in names)]),
            "The same with other variances of offset and capacity.",
            lambda a, b: of_p(a, b) if a in CELL else entry(a, b),
        )

    def column_of(self, state: State, name: str) -> list[str]:
        """One column of P."""
        return self.column_function(
            name,
            self.p,
            f"Covariance of every state with the {state.name.split('_')[0]}.",
            lambda s: of_p(state, s),
        )

    def given_soc(self) -> list[str]:
        """P less an outer product, and P plus two, for the states beside SOC."""

        def outer(a: State, b: State, column: str = "c") -> str:
            return f"{column}.{a.letter_name} * {column}.{b.letter_name}"

        def more(a: State, b: State) -> str:
            return f" + {outer(a, b)} + share * {outer(a, b, 'e')}"

        c = f"{self.p}, c: {self.vector}"
        less = "P - c c' among the states beside SOC: the covariance given the SOC."
        plus = "P + c c' + share e e' among the states beside SOC."
        return [
            *self.function(
                "without_outer",
                c,
                less,
                lambda a, b: of_p(a, b) + ("" if a is SOC else f" - {outer(a, b)}"),
            ),
            *self.function(
                "with_outer",
                f"{c}, share: float, e: {self.vector}",
                plus,
                lambda a, b: of_p(a, b) + ("" if a is SOC else more(a, b)),
            ),
        ]

    def column(self) -> list[str]:
        """P H' and H P H'."""
        names = [s.letter_name for s in self.states]
        text = "P H', the covariance of every state with the voltage."
        lines = self._function("column", f"{self.p}, {self.outputs}", self.vector, text)
        for s in self.states:
            total = output_sum(self.states, lambda o, s=s: of_p(s, o))  # type: ignore[misc]
            lines.append(f"    {s.letter_name} = {total}")
        text = "H P H', the variance of the voltage that the state explains [V^2]."
        return [
            *lines,
            *wrapped_call(f"    return {self.vector}", names),
            *self._function("explained", f"{self.d}, {self.outputs}", "float", text),
            f"    return {output_sum(self.states, lambda s: f'd.{s.letter_name}')}",
        ]

    def gain(self) -> list[str]:
        """A column times a number."""
        return self.column_function(
            "scaled",
            f"{self.d}, factor: float",
            "A column times a number: a gain.",
            lambda s: f"d.{s.letter_name} * factor",
        )

    def corrected(self) -> list[str]:
        """P - K d'."""

        def pattern(a: State, b: State) -> str:
            new = f"{of_p(a, b)} - k.{a.letter_name} * d.{b.letter_name}"
            least = "VARIANCE_FLOOR" if a is SOC else "0.0"
            return f"max({new}, {least})" if a is b else new

        return self.function(
            "corrected",
            f"{self.p}, k: {self.vector}, {self.d}",
            "P - k d', d = P H', after a voltage with the gain k.",
            pattern,
        )

    def rejudged(self, states: tuple[State, ...]) -> list[str]:
        """Joseph's form for a gain of one slope judged by another."""

        def pattern(a: State, b: State) -> str:
            if a not in states or b not in states:
                return of_p(a, b)
            (ka, kb), (ca, cb) = ([f"{x}.{s.letter_name}" for s in (a, b)] for x in "kc")
            if a is b:
                return f"{of_p(a, b)} + {ka} * ({ka} * e - 2.0 * {ca})"
            return f"{of_p(a, b)} + ({ka} * {kb} * e - {ka} * {cb} - {kb} * {ca})"

        return self.function(
            "rejudged",
            f"{self.p}, k: {self.vector}, c: {self.vector}, e: float",
            "P where a gain k of one slope is judged by another (Joseph): + e k k' - k c' - c k'.",
            pattern,
        )

    def row(self) -> list[str]:
        """SOC's row of P."""
        return self.column_function(
            "soc_row",
            f"{self.p}, factor: float",
            "SOC's row of P times a number.",
            lambda s: f"{of_p(SOC, s)} * factor",
        )

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
