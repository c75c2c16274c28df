"""Loops over the states of a cell, written out before anything is compiled or printed.

What a filter does to every state, or to every entry of its covariance, stands once, as a loop over
the table of :mod:`cellwise.cell.description`; numba and C get a statement for each state. In a
function with :func:`unrolled`, for states ``i`` and ``j``,

- ``for i in STATES``, ``for i, j in triangle(STATES)``: the body for each;
- ``if i == j``, ``if i in BRANCHES``: only the branch that holds;
- ``p[i, j]`` and ``x.p[i, j]``: an entry of a covariance, ``p12`` and ``x.p12``;
- ``d.row[i]``: that of a column, ``x.state[i]``: the state itself, ``x.carry[i]`` what its sum
  keeps; ``t.a[i]``, ``t.g[i]``, ``p.r[i]``, ``p.tau[i]``: decay, drive, resistance, time constant
  (more in `CALLED`); ``name[i]``: a number that the function keeps for each, which ``name = {}``
  says (without decay 1, without drive 0);
- ``*(... for i in STATES)``: an argument for each; ``sum(... for i in STATES)``.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any, TypeAlias, TypeVar

from cellwise.cell.description import State, carry, entry


def row(state: State) -> str:
    """Name of its number in a column: ``s``, ``v1`` ... ``h``."""
    return state.letter if state.letter.isalpha() else f"v{state.letter}"


ByState: TypeAlias = Any  # a record that is read by its states, ``x.r[i]``: no type checker does
THERE = True  # ``a if THERE else b``: b where a state is not compiled in
Written = TypeVar("Written", bound=Callable[..., Any])
# How an attribute of one state is called; others: their name and the state's letter.
CALLED: dict[str, Callable[[State], str]] = {
    "state": lambda s: s.name,
    "carry": carry,
    "row": row,
    "r": lambda s: f"r{s.letter}_ohm",
    "R": lambda s: f"R{s.letter}_OHM",
    "tau": lambda s: f"tau{s.letter}_s",
    "r_activation": lambda s: f"r{s.letter}_activation_K",
    "tau_activation": lambda s: f"tau{s.letter}_activation_K",
    "d": lambda s: f"d{s.letter}_V",
    "a": lambda s: s.decay,
    "g": lambda s: s.drive,
}


def unrolled(function: Written) -> Written:
    """The function with its loops over states written out."""
    made: Written = _made(function, False)
    return made


def unrolled_by_option(function: Written) -> Written:
    """The same, each statement under the options of its states: ``if SLOW and HYSTERESIS``."""
    made: Written = _made(function, True)
    return made


def _made(function: Any, by_option: bool) -> Any:
    code = function.__code__
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    written = write_out(tree.body[0], function.__globals__, by_option)
    written.decorator_list = []
    tree.body[0] = ast.increment_lineno(written, code.co_firstlineno - 1)
    scope: dict[str, Any] = {}
    flags = code.co_flags & 0x1000000  # annotations stay text
    exec(compile(tree, code.co_filename, "exec", flags, dont_inherit=True), scope)
    made = FunctionType(scope[function.__name__].__code__, function.__globals__)
    made.__doc__, made.__annotations__ = function.__doc__, function.__annotations__
    made.__module__, made.__qualname__ = function.__module__, function.__qualname__
    return made


def write_out(node: Any, scope: dict[str, Any], by_option: bool = False) -> Any:
    """A function's tree with its loops over states written out; ``scope`` are its globals."""
    made = _copied(node)
    made.body = list(_block(made.body, _Bound(scope, {}, by_option)))
    return ast.fix_missing_locations(made)


def _copied(node: Any) -> Any:
    """A tree of its own: each start of a command waits for it, and `copy.deepcopy` is slow."""
    if isinstance(node, list):
        return [_copied(one) for one in node]
    if not isinstance(node, ast.AST):
        return node
    return type(node)(**{name: _copied(value) for name, value in vars(node).items()})


class _Bound(ast.NodeTransformer):
    """Expressions for the states that loops have bound."""

    def __init__(
        self,
        scope: dict[str, Any],
        states: dict[str, State],
        by_option: bool,
        held: tuple[str, ...] = (),
    ) -> None:
        self.scope, self.states, self.by_option, self.held = scope, states, by_option, held

    def with_states(self, states: dict[str, State]) -> _Bound:
        return _Bound(self.scope, self.states | states, self.by_option, self.held)

    def within(self) -> _Bound:
        """Inside a statement that stands under the options of its states."""
        held = (*self.held, *self.options())
        return _Bound(self.scope, self.states, self.by_option, held)

    def value(self, node: ast.expr) -> Any:
        """What an expression over states is before anything is compiled; else None."""
        try:
            return eval(ast.unparse(node), self.scope, self.states)
        except Exception:
            return None

    def visit_Subscript(self, node: ast.Subscript) -> Any:
        at = self.value(node.slice)
        pair = isinstance(at, tuple) and all(isinstance(s, State) for s in at)
        if not pair and not isinstance(at, State):
            return self.generic_visit(node)
        of: Any = node.value
        base: Any = None
        if isinstance(of, ast.Attribute):
            of, base = ast.Name(of.attr), of.value
        name = ast.unparse(of)
        if pair and base is None:
            name, base = "", of if name == "p" else None
        text = entry(*at) if pair else self._called(name, at, base)
        if not text:
            return ast.copy_location(ast.Constant(1.0 if name == "a" else 0.0), node)
        if base is None:
            return ast.copy_location(ast.Name(text, node.ctx), node)
        return ast.copy_location(ast.Attribute(self.visit(base), text, node.ctx), node)

    @staticmethod
    def _called(name: str, state: State, base: ast.expr | None) -> str:
        if name in CALLED and base is not None:
            return CALLED[name](state)
        return CALLED[name](state) if name in ("r", "R") else name + state.letter

    def visit_Call(self, node: ast.Call) -> Any:
        if ast.unparse(node.func) == "sum":
            terms = [*self._arguments(ast.Starred(node.args[0]))]
            total = terms[0]
            for term in terms[1:]:
                total = ast.BinOp(total, ast.Add(), term)
            return ast.copy_location(total, node)
        node.args = [more for a in node.args for more in self._arguments(a)]
        node.func = self.visit(node.func)
        return node

    def _arguments(self, node: ast.expr) -> Iterator[ast.expr]:
        if isinstance(node, ast.Starred) and isinstance(node.value, ast.GeneratorExp):
            (loop,) = node.value.generators
            for states in _turns(loop.target, self.value(loop.iter)):
                yield self.with_states(states).visit(_copied(node.value.elt))
        else:
            yield self.visit(node)

    def options(self) -> list[str]:
        """The options of the states that do not hold yet, in the order of the loops."""
        asked = dict.fromkeys(s.option.upper() for s in self.states.values() if s.option)
        return [option for option in asked if option not in self.held]

    def visit_IfExp(self, node: ast.IfExp) -> Any:
        asked = ast.unparse(node.test)
        if asked != "THERE":
            found = self.value(node.test) if self._is_over_states(node.test) else None
            if found is not None:
                return self.visit(node.body if found else node.orelse)
            return self.generic_visit(node)
        if not self.options():
            return self.visit(node.body)
        node.test = _all_of(self.options())
        return self.generic_visit(node)

    def _is_over_states(self, node: ast.expr) -> bool:
        return any(isinstance(n, ast.Name) and n.id in self.states for n in ast.walk(node))


def _turns(target: ast.expr, over: Any) -> Iterator[dict[str, State]]:
    """The states that each turn of a loop binds; none where it is no loop over states."""
    names = [ast.unparse(t) for t in (target.elts if isinstance(target, ast.Tuple) else [target])]
    for each in over if isinstance(over, tuple) else ():
        yield dict(zip(names, each if isinstance(each, tuple) else (each,), strict=True))


def _block(body: list[ast.stmt], bound: _Bound) -> Iterator[ast.stmt]:
    for node in body:
        yield from _statement(node, bound)


def _statement(node: Any, bound: _Bound) -> Iterator[ast.stmt]:
    if isinstance(node, ast.Assign | ast.AnnAssign) and ast.unparse(node.value or node) == "{}":
        return  # numbers for each state: names of their own
    if isinstance(node, ast.For):
        over = bound.value(node.iter)
        if isinstance(over, tuple):
            for states in _turns(node.target, over):
                yield from _block(_copied(node.body), bound.with_states(states))
            return
    if isinstance(node, ast.If) and bound._is_over_states(node.test):
        found = bound.value(node.test)
        if found is not None:
            yield from _block(node.body if found else node.orelse, bound)
            return
    kept = [n for n in ast.walk(node) if isinstance(n, ast.Name) and n.id == "THERE"]
    if isinstance(node, ast.For | ast.If | ast.While):
        for part in ("body", "orelse"):
            setattr(node, part, list(_block(getattr(node, part), bound.within())))
        for part in ("test", "iter"):
            if hasattr(node, part):
                setattr(node, part, bound.visit(getattr(node, part)))
    else:
        node = bound.visit(node)
    if bound.by_option and not kept and bound.options():
        node = ast.copy_location(ast.If(_all_of(bound.options()), [node], []), node)
    yield node


def _all_of(options: list[str]) -> ast.expr:
    return ast.parse(" and ".join(options), mode="eval").body
