"""The library speaks of arguments, a command of its options: no message stands twice."""

from __future__ import annotations

import argparse
import ast
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cellwise
from cellwise import CellLog, InputError, write_log
from cellwise.cli.command_line import build_parser
from cellwise.cli.common.printing import ARGUMENT, in_command, in_options
from cellwise.logs import read_log
from cellwise.notices import Option
from sources import tree_of

SOURCE = Path(cellwise.__file__).parent
# Options of other programs, and of `python -m cellwise.printing`; the variables of a style sheet.
OTHERS = ("cli", "printing", "report/page", "export/cross.py", "export/page.py")
OTHERS += ("export/package.py",)
OPTION = re.compile(r"(?<![\w-])--[a-z]")


def texts():
    """Every string of the library that is no docstring, with its place."""
    for path in sorted(SOURCE.rglob("*.py")):
        name = path.relative_to(SOURCE).as_posix()
        if name.startswith(OTHERS):
            continue
        tree = tree_of(path)
        said = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
        inside = {id(p) for n in ast.walk(tree) if isinstance(n, ast.JoinedStr) for p in n.values}
        for node in ast.walk(tree):
            if id(node) in said or id(node) in inside:
                continue
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield f"{name}:{node.lineno}", node.value
            elif isinstance(node, ast.JoinedStr):
                parts = (p.value if isinstance(p, ast.Constant) else "{}" for p in node.values)
                yield f"{name}:{node.lineno}", "".join(parts)


@pytest.fixture(scope="module")
def library():
    return dict(texts())


@pytest.fixture(scope="module")
def options():
    """Every option of every command."""

    def of(parser):
        for action in parser._actions:
            yield from action.option_strings
            if isinstance(action, argparse._SubParsersAction):
                for command in action.choices.values():
                    yield from of(command)

    return set(of(build_parser()))


def test_no_message_of_the_library_names_an_option(library):
    assert [place for place, text in library.items() if OPTION.search(text)] == []


def test_every_argument_that_a_message_names_is_an_option_of_a_command(library, options):
    named = {
        (place, option)
        for place, text in library.items()
        for found in ARGUMENT.finditer(text)
        for option in in_options(found[0]).split()
        if option.startswith("--")
    }
    assert len(named) > 30
    assert [(place, option) for place, option in named if option not in options] == []


def test_every_argument_that_a_notice_proposes_is_an_option_of_a_command(options):
    proposed = {
        node.args[0].value
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Call)
        and getattr(node.func, "id", "") == "Option"
        and node.args
        and isinstance(node.args[0], ast.Constant)
    }
    assert {"sign", "series", "parallel", "soc0", "channels", "instance"} <= proposed
    written = {in_command(Option(name, letter="X")).split()[0] for name in proposed}
    assert written <= options


@pytest.mark.parametrize(
    ("library", "command"),
    [
        ("Give `series=4`.", "Give --series 4."),
        ("Give `sign='charge-positive'`.", "Give --sign charge-positive."),
        ("with `partial=True`.", "with --partial."),
        ("Leave out `refine=False`.", "Leave out --no-refine."),
        ("`nominal_Ah=X` or `capacity=LOG`", "--nominal-ah X or --capacity LOG"),
        ("`channels={'time_s': 'Total Time'}`", "--channel time_s='Total Time'"),
        ("`channels={'a_V': 'x', 'b_V': 'y'}`", "--channel a_V=x --channel b_V=y"),
        ("omit `instance=...`, `channels={...}`", "omit --instance, --channel"),
        ("`dt_s=0.1`", "--dt 0.1"),
        ("`code` and 'a=b'", "`code` and 'a=b'"),
    ],
)
def test_an_argument_is_said_as_the_option(library, command):
    assert in_options(library) == command


def test_python_and_command_say_the_same_each_in_its_words(tmp_path, refused, run_json):
    path = tmp_path / "pack.csv"
    time_s = np.arange(100.0)
    write_log(CellLog(time_s, np.sin(time_s), 15.0 - 0.01 * np.sin(time_s)), path)
    notices = read_log(path).notices
    assert any("`series=N`" in n.text for n in notices)
    assert any("--series N" in n for n in run_json("inspect", str(path))["notices"])
    with pytest.raises(InputError, match="Give `series=4`, say"):
        read_log(path, series=0)
    assert "Give --series 4, say" in refused("inspect", str(path), "--series", "0")


def parsers(parser):
    """Every command and every action of one."""
    for part in parser._actions:
        if isinstance(part, argparse._SubParsersAction):
            for inner in part.choices.values():
                yield inner
                yield from parsers(inner)


def test_the_help_of_every_command_says_what_it_does_and_ends_with_examples_that_it_takes():
    found = list(parsers(build_parser()))
    assert len(found) > 20
    for parser in found:
        said = parser.format_help()
        assert parser.description.endswith("."), parser.prog
        assert "--debug" in said, parser.prog
        inner = any(isinstance(part, argparse._SubParsersAction) for part in parser._actions)
        for part in parser._actions:
            named = not part.option_strings and not isinstance(part, argparse._SubParsersAction)
            assert part.help or not named, (parser.prog, part.dest)
        examples = said.split("examples:\n")[1].splitlines() if not inner else []
        assert len(examples) == (0 if inner else 2), parser.prog
        for line in examples:
            words = shlex.split(line.partition(" < ")[0])
            assert words[0] == "cellwise"
            assert build_parser().parse_args(words[1:]).command == parser.prog.split()[1]


@pytest.mark.parametrize("before", [True, False])
def test_debug_is_understood_before_an_action_and_behind_it(before):
    rest = ["replay", "logs", "--model", "m.json", "-o", "out"]
    words = ["fleet", "--debug", *rest] if before else ["fleet", *rest, "--debug"]
    assert build_parser().parse_args(words).debug is True
    assert build_parser().parse_args(["fleet", *rest]).debug is False


def test_a_line_of_megabytes_is_no_message(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("a" * 200_000 + "\n1,2,3\n")
    with pytest.raises(InputError) as caught:
        read_log(path)
    assert len(str(caught.value)) < 1500


def test_a_help_waits_for_no_numerics():
    """Numpy alone takes longer than all the rest of a help."""
    told = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "cellwise", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Usage" in told.stdout or "usage" in told.stdout
    assert not re.search(r"\| +(numpy|scipy|numba|pyarrow)$", told.stderr, re.M)
