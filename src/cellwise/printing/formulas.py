r"""Prints the equations as formulas into the theory page, from the text of `cell/equations/`."""

from __future__ import annotations

import ast
from pathlib import Path

from cellwise.cell import equations
from cellwise.printing.straight_line import parsed

BEGIN, END = "<!-- printed: equations -->", "<!-- end of what is printed -->"

# Functions in the order of a step, and what a reader calls each.
SHOWN = (
    ("seen_current", "sampling delay (`time_skew`)"),
    ("charge_used", "charge used (`charge_efficiency`, `self_discharge`)"),
    ("soc_step", "state of charge"),
    ("inverse_kelvin", "distance from the reference temperature"),
    ("thermal_factor", "Arrhenius factor"),
    ("followed", r"current $\bar I$ that the surface has followed (`surface_soc`)"),
    ("surface_soc", "SOC at the surface of the particles (`surface_soc`)"),
    ("at_temperature", "temperature (`temperature_dependence`, `entropy`)"),
    ("charge_transfer", "factor $f(u)$ of a charge transfer"),
    ("under_load", "load (`rate_dependence`, `charge_asymmetry`, `charge_transfer`)"),
    ("decay", "decay"),
    ("branch_gain", "gain of a branch"),
    ("relaxed", "branch voltage (`slow_diffusion` is the third)"),
    ("hysteresis_decay", "decay of the hysteresis"),
    ("hysteresis_step", "hysteresis"),
    ("polarisation", "polarisation"),
    ("loaded_voltage", "terminal voltage"),
    ("heat_step", "own heat (`self_heating`)"),
)
SYMBOLS = {
    "activation_K": "E",
    "branch_activation": "E_j",
    "above": "p",
    "ah": "a_h",
    "asinh_per_V": "k_1",
    "below": "q",
    "charge_As": r"3600\,Q",
    "charge_efficiency": r"\eta",
    "charge_scale": "c",
    "current_A": "I",
    "drive": "I",
    "dt_s": r"\Delta t",
    "entropy_K": "T_{ref}",
    "entropy_V": r"\frac{dOCV}{dT}",
    "entropy_slope_V": r"\frac{dOCV'}{dT}",
    "fall": r"\varphi",
    "folds": r"n_h",
    "gain": "g",
    "heat_K": r"\vartheta",
    "heating_K_per_W": "R_{th}",
    "heating_s": r"\tau_{th}",
    "hysteresis_rate": r"\gamma",
    "growth": r"\psi",
    "inverse_K": r"\beta",
    "kelvin": "T",
    "leak_A": "I_{sd}",
    "m_V": "M",
    "ocv": "OCV",
    "ocv_V": "OCV",
    "old": "x",
    "overvoltage": "u",
    "per_A": r"\delta",
    "polarisation_V": "v_p",
    "previous_A": "I_{-}",
    "r_ohm": "R",
    "rate_per_A": "k",
    "reference_K": "T_{ref}",
    "scale": r"\alpha",
    "depth": r"\lambda",
    "skew_s": r"\delta_s",
    "slope": "OCV'",
    "slow_A": r"\bar I",
    "soc": "z",
    "surface_activation_K": "E_s",
    "surface_per_A": r"\frac{d}{Q}",
    "surface_s": r"\tau_s",
    "tau_s": r"\tau",
    "temperature_C": r"T_{^\circ C}",
    "used": "I_u",
    "warmer": r"\Delta T",
    "ZERO_CELSIUS_K": "273.15",
}


def symbol(name: str) -> str:
    """A name in a formula: from the list, else its letters with what follows them as an index."""
    if name in SYMBOLS:
        return SYMBOLS[name]
    for start, letter in (("tau", r"\tau"), ("r", "R"), ("v", "V"), ("a", "a"), ("g", "g")):
        index = name.removeprefix(start)
        if index != name and index[:1].isdigit():
            energy = "_activation_K" in name
            j = index[0]
            return f"E_{{{letter}{j}}}" if energy else f"{letter}_{j}"
    return name.replace("_", r"\_")


def formula(node: ast.expr) -> str:
    """An expression as LaTeX, in the order in which it is computed."""
    if isinstance(node, ast.Name):
        return symbol(node.id)
    if isinstance(node, ast.Attribute):
        return symbol(node.attr)
    if isinstance(node, ast.Constant):
        return f"{float(str(node.value)):.9g}"
    if isinstance(node, ast.UnaryOp):
        return f"-{bracketed(node.operand)}"
    if isinstance(node, ast.BinOp):
        return operation(node)
    if isinstance(node, ast.Call):
        return call(node)
    if isinstance(node, ast.IfExp):
        test = f"{formula(node.test)}"
        return (
            rf"\begin{{cases}} {formula(node.body)} & {test} \\ {formula(node.orelse)} "
            r"& \text{else} \end{cases}"
        )
    if isinstance(node, ast.Compare):
        signs = {ast.Gt: ">", ast.Lt: "<", ast.NotEq: r"\ne", ast.Eq: "=", ast.LtE: r"\le"}
        return f"{formula(node.left)} {signs[type(node.ops[0])]} {formula(node.comparators[0])}"
    raise TypeError(f"no formula for {ast.unparse(node)}")


def operation(node: ast.BinOp) -> str:
    """A sum, a product, or a fraction."""
    if isinstance(node.op, ast.Div):
        return rf"\frac{{{formula(node.left)}}}{{{formula(node.right)}}}"
    if isinstance(node.op, ast.Mult):
        first, second = node.left, node.right
        if isinstance(second, ast.Constant):
            first, second = second, first
        return rf"{bracketed(first)}\, {bracketed(second)}"
    sign = "+" if isinstance(node.op, ast.Add) else "-"
    right = formula(node.right) if sign == "+" else bracketed(node.right)
    return f"{formula(node.left)} {sign} {right}"


def bracketed(node: ast.expr) -> str:
    """A sum in brackets, everything else without."""
    is_sum = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub)
    return rf"\left({formula(node)}\right)" if is_sum else formula(node)


def call(node: ast.Call) -> str:
    """A function: those of mathematics by their signs, ours by their names."""
    name = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
    given = [formula(a) for a in node.args]
    if name == "exp":
        return f"e^{{{given[0]}}}"
    if name == "abs":
        return rf"\left|{given[0]}\right|"
    if name == "copysign":
        return rf"\mathrm{{sgn}}\,{given[1]}"
    if name == "decay":
        return rf"e^{{-\frac{{{given[0]}}}{{{given[1]}}}}}"
    if name == "arrhenius":
        return rf"\alpha({given[1]})"
    if name == "transfer_resistance":
        return rf"{given[1]}\, f({given[0]}\, {given[1]}\, {given[2]})"
    if name == "charge_used":
        return "I_u"
    return rf"\{name}({', '.join(given)})"  # min and max


def reads(node: ast.expr, name: str) -> bool:
    """Whether an expression reads a name."""
    return any(isinstance(n, ast.Name) and n.id == name for n in ast.walk(node))


def in_one(body: list[ast.stmt]) -> list[ast.stmt]:
    """The same with assignments in a row to one name, each reading the last, as one (Horner)."""
    found: list[ast.stmt] = []
    for node in body:
        last = found[-1] if found else None
        if isinstance(node, ast.Assign) and isinstance(last, ast.Assign):
            name = ast.unparse(node.targets[0])
            if name == ast.unparse(last.targets[0]) and reads(node.value, name):
                found[-1] = ast.Assign(node.targets, put_in_place(node.value, name, last.value))
                continue
        found.append(node)
    return found


def put_in_place(node: ast.expr, name: str, value: ast.expr) -> ast.expr:
    """An expression with another one in place of a name."""
    if isinstance(node, ast.Name) and node.id == name:
        return value
    if isinstance(node, ast.BinOp):
        left, right = (put_in_place(side, name, value) for side in (node.left, node.right))
        return ast.BinOp(left, node.op, right)
    return node


def statements(body: list[ast.stmt]) -> list[str]:
    """The assignments and the result of a function, guards left out: neutral values do nothing."""
    found: list[str] = []
    for node in in_one(body):
        if isinstance(node, ast.If):
            last = node.body[-1]
            if not (isinstance(last, ast.Return) and isinstance(last.value, ast.Name)):
                found += statements(node.body)
        elif isinstance(node, ast.AugAssign):
            value = ast.BinOp(node.target, node.op, node.value)
            found.append(f"{formula(node.target)} := {formula(value)}")
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            if not isinstance(node.value, ast.Attribute):
                sign = ":=" if reads(node.value, node.targets[0].id) else "="
                found.append(f"{formula(node.targets[0])} {sign} {formula(node.value)}")
        elif isinstance(node, ast.Return) and node.value is not None:
            result = node.value
            if not (isinstance(result, ast.Call) and ast.unparse(result.func)[:1].isupper()):
                found.append(formula(result))
    return found


def table() -> list[str]:
    """One row for each function: what it is, its formulas, its file and name."""
    functions = parsed()
    lines = ["| quantity | formula | `cell/equations/` |", "|---|---|---|"]
    for name, title in SHOWN:
        given = [f"${text}$" for text in statements(functions[name].body)]
        home = getattr(equations, name).__module__.rpartition(".")[2]
        written = ", ".join(given).replace("|", chr(92) + "vert ")
        lines.append(f"| {title} | {written} | `{home}.{name}` |")
    return lines


def theory_text(page: Path) -> str:
    """The theory page with its table of equations printed again."""
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return "\n".join([before + BEGIN, "", *table(), "", END]) + after
