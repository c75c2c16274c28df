"""`python -m cellwise.printing [--check]`: print everything again, or say what differs."""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Sequence
from pathlib import Path

from cellwise.cell import equations
from cellwise.printing.firmware import EVERYTHING, print_files

# The repository's root: files are named from there.
SOURCE = Path(__file__).resolve().parents[3]

# The table of equations in the theory page: the lines of their code, as they are computed.
BEGIN, END = "<!-- printed: equations -->", "<!-- end of what is printed -->"

# Functions in the order of a step, and what a reader calls each.
SHOWN = (
    ("delayed_current", "sampling delay (`time_skew`)"),
    ("charge_used", "charge used (`charge_efficiency`, `self_discharge`)"),
    ("soc_step", "state of charge"),
    ("inverse_kelvin", "distance from the reference temperature"),
    ("thermal_factor", "Arrhenius factor"),
    ("lagged_current", "current behind the surface's lag (`surface_soc`)"),
    ("surface_soc", "SOC at the surface of the particles (`surface_soc`)"),
    ("at_temperature", "temperature (`temperature_dependence`, `entropy`)"),
    ("charge_transfer", "factor of a charge transfer"),
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


def statements(body: list[ast.stmt]) -> list[str]:
    """The assignments and the result of a function, guards left out: neutral values do nothing."""
    found: list[str] = []
    for node in body:
        match node:
            case ast.If(body=[*_, ast.Return(value=ast.Name())]):
                continue  # an effect that is absent
            case ast.If():
                found += statements(node.body)
            case ast.For():
                each = f"{ast.unparse(node.target)} in {ast.unparse(node.iter)}"
                found += [f"{text}, {each}" for text in statements(node.body)]
            case ast.Assign(value=ast.Attribute() | ast.Subscript()):
                continue  # a field under a shorter name
            case ast.Assign() | ast.AugAssign():
                found.append(ast.unparse(node))
            case ast.Return(value=ast.expr() as result):
                if not (isinstance(result, ast.Call) and ast.unparse(result.func)[:1].isupper()):
                    found.append(ast.unparse(result))
    return found


def parsed() -> dict[str, ast.FunctionDef]:
    """Every function of the equations, by its name."""
    files = sorted(Path(equations.__file__).parent.glob("*.py"))
    nodes = (n for f in files for n in ast.parse(f.read_text(encoding="utf-8")).body)
    return {n.name: n for n in nodes if isinstance(n, ast.FunctionDef)}


def table() -> list[str]:
    """One row for each function: what it is, its lines, its file and name."""
    functions = parsed()
    lines = ["| quantity | as computed | `cell/equations/` |", "|---|---|---|"]
    for name, title in SHOWN:
        written = "<br>".join(f"`{text}`" for text in statements(functions[name].body))
        home = getattr(equations, name).__module__.rpartition(".")[2]
        lines.append(f"| {title} | {written} | `{home}.{name}` |")
    return lines


def theory_text(page: Path) -> str:
    """The theory page with its table of equations printed again."""
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return "\n".join([before + BEGIN, "", *table(), "", END]) + after


def printed() -> dict[str, str]:
    """Texts of all that is printed, by their place in the repository."""
    theory = "docs/theory.md"
    files = {f"firmware_ref/{name}": text for name, text in print_files(EVERYTHING).items()}
    return {theory: theory_text(SOURCE / theory), **files}


def main(arguments: Sequence[str] | None = None) -> int:
    """Write every printed file; with ``--check`` only compare, 1 where one differs."""
    parser = argparse.ArgumentParser(prog="python -m cellwise.printing", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    options = parser.parse_args(arguments)
    differ = 0
    for name, new in printed().items():
        path = SOURCE / name
        if path.exists() and path.read_text(encoding="utf-8") == new:
            continue
        differ += 1
        sys.stdout.write(f"{name}{' differs' if options.check else ''}\n")
        if not options.check:
            path.write_text(new, encoding="utf-8")
    return 1 if options.check and differ else 0


if __name__ == "__main__":
    sys.exit(main())
