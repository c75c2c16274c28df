"""Functions of the fixed step in MATLAB's language, from the Python that the NumPy file has.

MATLAB hands over values: a function gives back every record that it changes, behind its own result.
Counts are doubles, which hold a uint32 exactly; everything else is single, as in the C.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from numbers import Number

import numpy as np

# Words of the language, and what the printed text calls.
RESERVED = {
    "end", "function", "persistent", "global", "for", "while", "if", "else", "return", "break",
    "do", "until", "size", "numel", "single", "double", "abs", "struct", "mod", "fix", "bitor",
    "bitand", "true", "false", "pick", "u32", "sign_of",
}  # fmt: skip
OPERATORS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.LtE: "<=",
    ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "~=", ast.And: "&&", ast.Or: "||",
}  # fmt: skip
CONVERSIONS = {"F": "single", "U": "u32", "Count": "u32", "abs": "abs", "magnitude": "abs"}
RESULT = "r_"


def number(value: float | np.generic) -> str:
    """A number: a float32 as a single of the same bits, a count as it is."""
    if isinstance(value, float | np.floating):
        return f"single({float(value)!r})" if isinstance(value, np.float32) else repr(float(value))
    return str(int(value))


def struct(fields: Mapping[str, str]) -> str:
    """A record."""
    return f"struct({', '.join(f'{name!r}, {value}' for name, value in fields.items())})"


class Translation:
    """Functions that call one another, in MATLAB's language.

    Parameters
    ----------
    functions : mapping      without types, every float in ``F(...)`` where it is a float32
    tuples : mapping         fields of every named tuple
    numbers : mapping        values of names that are constants
    """

    def __init__(
        self,
        functions: Mapping[str, ast.FunctionDef],
        tuples: Mapping[str, Sequence[str]],
        numbers: Mapping[str, Number],
    ) -> None:
        self.functions, self.tuples, self.numbers = functions, tuples, numbers
        self.changed: dict[str, list[str]] = {name: [] for name in functions}
        grown = True
        while grown:
            grown = sum(self._grows(name) for name in functions) > 0

    def _grows(self, name: str) -> bool:
        """Whether more parameters of a function are known to be changed than before."""
        node = self.functions[name]
        found = set(self.changed[name])
        for one in ast.walk(node):
            if isinstance(one, ast.Attribute | ast.Subscript) and isinstance(one.ctx, ast.Store):
                found.add(_root(one))
            for argument in self._changed_arguments(one):
                found.add(_root(argument))
        kept = [a.arg for a in node.args.args if a.arg in found]
        grown = kept != self.changed[name]
        self.changed[name] = kept
        return grown

    def _changed_arguments(self, node: ast.AST) -> list[ast.expr]:
        """What a call changes of what it is handed."""
        if not (isinstance(node, ast.Call) and ast.unparse(node.func) in self.functions):
            return []
        name = ast.unparse(node.func)
        parameters = [a.arg for a in self.functions[name].args.args]
        pairs = zip(parameters, node.args, strict=True)
        return [argument for p, argument in pairs if p in self.changed[name]]

    def texts(self) -> Iterator[str]:
        """Every function."""
        for name in self.functions:
            yield "\n".join(_Function(self, name).lines())


def _root(node: ast.expr) -> str:
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


class _Function:
    """One function: statements that are written, and names of what stood in an expression."""

    def __init__(self, whole: Translation, name: str) -> None:
        self.whole, self.name, self.node = whole, name, whole.functions[name]
        self.said: list[str] = []
        self.hoisted = 0
        returned = [n.value for n in ast.walk(self.node) if isinstance(n, ast.Return) and n.value]
        most = max((len(v.elts) if isinstance(v, ast.Tuple) else 1 for v in returned), default=0)
        self.results = [f"{RESULT}{k or ''}" for k in range(most)]

    def lines(self) -> list[str]:
        """The function's text."""
        changed = [self._name(n) for n in self.whole.changed[self.name]]
        given = ", ".join(self._name(a.arg) for a in self.node.args.args)
        self._block(self.node.body, 1)
        head = f"function [{', '.join([*self.results, *changed])}] = {self.name}({given})"
        return [head, *self.said, "end"]

    # ---- statements

    def _say(self, text: str, depth: int) -> None:
        self.said.append("    " * depth + text)

    def _block(self, body: Sequence[ast.stmt], depth: int) -> None:
        for node in body:
            self._statement(node, depth)

    def _statement(self, node: ast.stmt, depth: int) -> None:
        match node:
            case ast.Assign(targets=[target], value=value):
                self._assign(target, value, depth)
            case ast.Expr(value=ast.Call() as call):
                self._call(
                    ["~"] * len(_Function(self.whole, self._called(call)).results), call, depth
                )
            case ast.If():
                self._say(f"if {self._of(node.test, depth)}", depth)
                self._block(node.body, depth + 1)
                if node.orelse:
                    self._say("else", depth)
                    self._block(node.orelse, depth + 1)
                self._say("end", depth)
            case ast.For(target=ast.Name() as target, iter=ast.Call(args=[most])):
                self._say(f"for {self._name(target.id)} = 0:{self._of(most, depth)} - 1", depth)
                self._block(node.body, depth + 1)
                self._say("end", depth)
            case ast.While(test=test):
                before = self.hoisted
                self._say(f"while {self._of(test, depth)}", depth)
                if self.hoisted != before:
                    raise ValueError(f"a call that changes, in '{ast.unparse(test)}'")
                self._block(node.body, depth + 1)
                self._say("end", depth)
            case ast.Return():
                self._return(node.value, depth)
            case ast.Break():
                self._say("break", depth)
            case _:
                raise ValueError(f"no MATLAB for '{ast.unparse(node)}' in {self.name}")

    def _assign(self, target: ast.expr, value: ast.expr, depth: int) -> None:
        if isinstance(value, ast.Call) and ast.unparse(value.func) in self.whole.functions:
            parts = target.elts if isinstance(target, ast.Tuple) else [target]
            self._call([self._of(part, depth) for part in parts], value, depth)
        else:
            text = self._of(value, depth)
            self._say(f"{self._of(target, depth)} = {text};", depth)

    def _return(self, value: ast.expr | None, depth: int) -> None:
        if isinstance(value, ast.Tuple):
            for name, part in zip(self.results, value.elts, strict=True):
                self._say(f"{name} = {self._of(part, depth)};", depth)
        elif value is not None:
            self._assign(ast.Name(RESULT, ast.Store()), value, depth)
        self._say("return", depth)

    def _called(self, node: ast.expr) -> str:
        name = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
        if name not in self.whole.functions:
            raise ValueError(f"no MATLAB for '{ast.unparse(node)}' in {self.name}")
        return name

    def _call(self, results: list[str], node: ast.Call, depth: int) -> None:
        """A call of its own, with what it gives and what it changes."""
        name = self._called(node)
        arguments = ", ".join(self._of(a, depth) for a in node.args)
        changed = [self._of(a, depth) for a in self.whole._changed_arguments(node)]
        self._say(f"[{', '.join([*results, *changed])}] = {name}({arguments});", depth)

    # ---- expressions

    def _name(self, name: str) -> str:
        taken = name in RESERVED or name in self.whole.functions
        return "k_" if name == "_" else f"{name}_" if taken else name

    def _of(self, node: ast.expr, depth: int) -> str:
        """An expression; a call in it that changes something is made before."""
        of = self._of
        match node:
            case ast.Constant(value=bool() as value):
                return str(value).lower()
            case ast.Constant(value=int() | float() as value):
                return repr(value)
            case ast.Name(id=name) if name in self.whole.numbers:
                return number(self.whole.numbers[name])  # type: ignore[arg-type]
            case ast.Name(id=name):
                return RESULT if name == RESULT else self._name(name)
            case ast.Attribute(value=value, attr="size"):
                return f"numel({of(value, depth)})"
            case ast.Attribute(value=value, attr=attr):
                return f"{of(value, depth)}.{attr}"
            case ast.Subscript(value=ast.Attribute(value=value, attr="shape"), slice=at):
                return f"size({of(value, depth)}, {of(at, depth)} + 1)"
            case ast.Subscript(value=value, slice=at):
                places = at.elts if isinstance(at, ast.Tuple) else [at]
                inside = ", ".join(f"{of(place, depth)} + 1" for place in places)
                return f"{of(value, depth)}({inside})"
            case ast.UnaryOp(op=op, operand=value):
                return f"{'-' if isinstance(op, ast.USub) else '~'}({of(value, depth)})"
            case ast.BinOp(left=a, op=ast.BitAnd(), right=b) if isinstance(a, ast.Compare):
                return f"({of(a, depth)} && {of(b, depth)})"
            case ast.BinOp(left=a, op=ast.BitAnd() | ast.BitOr() as op, right=b):
                name = "bitand" if isinstance(op, ast.BitAnd) else "bitor"
                return f"{name}({of(a, depth)}, {of(b, depth)})"
            case ast.BinOp(left=a, op=op, right=b) | ast.Compare(left=a, ops=[op], comparators=[b]):
                return f"({of(a, depth)} {OPERATORS[type(op)]} {of(b, depth)})"
            case ast.BoolOp(op=op, values=values):
                before = self.hoisted
                text = f" {OPERATORS[type(op)]} ".join(of(v, depth) for v in values)
                if self.hoisted != before:
                    raise ValueError(f"a call that changes, in '{ast.unparse(node)}'")
                return f"({text})"
            case ast.IfExp(test=test, body=a, orelse=b):
                return f"pick({of(test, depth)}, {of(a, depth)}, {of(b, depth)})"
            case ast.Call():
                return self._value_of_call(node, depth)
        raise ValueError(f"no MATLAB for '{ast.unparse(node)}' in {self.name}")

    def _value_of_call(self, node: ast.Call, depth: int) -> str:
        name = ast.unparse(node.func)
        if self.whole._changed_arguments(node):
            self.hoisted += 1
            held = f"t{self.hoisted}_"
            self._call([held], node, depth)
            return held
        arguments = [self._of(a, depth) for a in node.args]
        if name in self.whole.tuples:
            return struct(dict(zip(self.whole.tuples[name], arguments, strict=True)))
        if name == "math.copysign":
            return f"sign_of({arguments[1]})"
        if name in CONVERSIONS:
            return f"{CONVERSIONS[name]}({arguments[0]})"
        return f"{self._called(node)}({', '.join(arguments)})"
