"""What is printed is what stands in the tree; what the printer makes of a sentence."""

from __future__ import annotations

import ast
import shutil
import subprocess

import numpy as np
import pytest

from cellwise.estimate.fixed.options import Options, flags_of
from cellwise.export.c_tables import firmware_folder
from cellwise.printing.__main__ import main
from cellwise.printing.c99 import Function, Program
from cellwise.printing.chosen import chosen
from cellwise.printing.firmware import EVERYTHING, print_files
from cellwise.printing.text import WIDTH, broken, comment, float_literal

PROGRAM = Program(
    structs={"State": {"soc": "float", "soc_carry": "float"}}, constants={}, columns={}, sizes={}
)


def c_of(source):
    """A function in C, without white space at the ends of its lines."""
    read = chosen(ast.parse(source), {}, {})
    return [line.strip() for line in Function(read.body[0], PROGRAM, {}).text("f", True)]


def test_the_tree_holds_what_is_printed(capsys):
    assert main(["--check"]) == 0, f"python -m cellwise.printing: {capsys.readouterr().out}"


@pytest.mark.parametrize(
    ("python", "c"),
    [
        ("x.soc = a - b - (a - b)", "x->soc = (a - b) - (a - b);"),
        ("x.soc = a * (b / a) + b", "x->soc = (a * (b / a)) + b;"),
        ("x.soc = -(a * b)", "x->soc = -(a * b);"),
        ("x.soc = a if a < b else b", "x->soc = (a < b) ? a : b;"),
        ("x.soc = F(k) * a", "x->soc = (float)k * a;"),
        ("x.soc = a * b\n    x.soc = x.soc - a", "x->soc = (a * b) - a;"),
        ("x.soc = a\n    x.soc = b - x.soc", "x->soc = b - x->soc;"),
        ("x.soc = a\n    x.soc = x.soc - x.soc", "x->soc = x->soc - x->soc;"),
        # What is called with a record may read or change what is assigned.
        ("x.soc = a\n    x.soc = magnitude(x)", "x->soc = a;"),
        ("x.soc = a\n    x.soc = x.soc - magnitude(x)", "x->soc = a;"),
        ("y = magnitude(x)\n    y = y - x.soc\n    x.soc = y", "y = y - x->soc;"),
        ("y = a\n    y = b\n    x.soc = y", "const float y = b;"),
        ("if a < b:\n        return", "if (a < b) { return; }"),
        ("x.soc, x.soc_carry = add(x.soc, x.soc_carry, a)", "add(&x->soc, &x->soc_carry, a);"),
        ("n = U(k + 1)\n    x.soc = F(n)", "const uint32_t n = k + 1u;"),
        ("n = U(a * b)\n    x.soc = F(n)", "const uint32_t n = (uint32_t)(a * b);"),
    ],
)
def test_sentences_keep_their_order(python, c):
    found = c_of(f"def f(x: State, a: float, b: float, k: int) -> None:\n    {python}\n")
    assert c in found


def test_no_printed_file_is_longer_than_250_lines():
    """A part is read in one go: it is printed apart where it grows, by `FIRST`."""
    for name, text in print_files(EVERYTHING).items():
        assert text.count("\n") <= 250, name


def test_what_c_does_not_say_is_refused():
    for sentence in ("x.soc = [a]", "del a", "x.soc = a ** 2"):
        with pytest.raises((ValueError, KeyError)):
            c_of(f"def f(x: State, a: float) -> None:\n    {sentence}\n")


def test_lines_keep_the_width_and_their_words():
    line = "x = " + " + ".join(f"(a{k} * b{k})" for k in range(40)) + ";"
    pieces = broken(line, 4)
    assert all(len(p) <= WIDTH for p in pieces)
    assert " ".join(p.strip() for p in pieces) == line
    assert all(len(p) <= WIDTH for p in comment("word " * 60, 8))


def test_printed_literals_read_back_to_the_bit():
    values = np.random.default_rng(1).integers(0, 2**31, 2000).astype(np.uint32).view(np.float32)
    for value in [*values[np.isfinite(values)], *np.float32([0.5, 120, 1e-6, 2000, 0.015625, 0])]:
        text = float_literal(value).removesuffix("f")
        assert np.float32(float.fromhex(text) if "0x" in text else float(text)) == value


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
@pytest.mark.parametrize(
    "states",
    [
        (1, 1),
        *(pytest.param(few, marks=pytest.mark.slow) for few in ((0, 0), (0, 1), (1, 0))),
    ],
)
def test_every_set_of_options_is_c(states, tmp_path):
    """No name is undeclared or unused, whatever is compiled in."""
    slow, hysteresis = states
    effects = (
        "efficiency", "leak", "skew", "rate", "asymmetry", "transfer", "surface", "heating", "wide",
    )  # fmt: skip
    sizes = [(1, 0), (3, 0), (1, 161)]
    for k, (temperatures, arrhenius) in enumerate(sizes):
        sets = (effects, (), effects[k::2], effects[k::3])
        turn = k + slow + hysteresis  # half of them: each pair of choices meets somewhere
        for some in (sets[turn % 4], sets[(turn + 2) % 4]):
            options = Options(
                5, temperatures, slow, hysteresis, arrhenius,
                depth=arrhenius if "surface" in some else 0,
                **{e: int(e in some and (e != "heating" or k > 0)) for e in effects},
            )  # fmt: skip
            assert set(flags_of(options)) >= {e.upper() for e in effects}
            defines = [f"#define {n} {v}" for n, v in options.defines().items()]
            (tmp_path / "cell_table.h").write_text("\n".join(defines) + "\n")
            for name, text in print_files(options).items():
                (tmp_path / name).write_text(text)
            done = subprocess.run(
                ["gcc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only",
                 f"-I{firmware_folder()}", "cellwise_ekf.c"],
                cwd=tmp_path, capture_output=True, text=True, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr[:1000]
