"""The library speaks of arguments, a command of its options: no message stands twice."""

from __future__ import annotations

import argparse
import ast
import pickle
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
from cellwise.cli.common.printing import in_command, worded
from cellwise.cli.common.usage import sections
from cellwise.logs import read_log
from cellwise.wording import Option, Text, arg, joined_texts, within
from sources import tree_of

SOURCE = Path(cellwise.__file__).parent
# Options of other programs, and of `python -m cellwise.printing`; the variables of a style sheet.
OTHERS = ("cli", "printing", "report/page", "export/cross.py", "export/page.py")
OTHERS += ("export/package.py", "wording.py")
OPTION = re.compile(r"(?<![\w-])--[a-z]")
IN_PYTHON = re.compile(r"`[A-Za-z{][\w}]*=[^`]*`")


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


def test_no_text_of_the_library_writes_an_argument_that_is_no_data(library):
    assert [place for place, text in library.items() if IN_PYTHON.search(text)] == []


def test_every_argument_that_a_text_names_is_an_option_of_a_command(options):
    named = {
        node.args[0].value
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Call)
        and getattr(node.func, "id", "") in ("Option", "arg")
        and node.args
        and isinstance(node.args[0], ast.Constant)
    }
    assert {"sign", "series", "parallel", "soc0", "channels", "instance", "dt_s"} <= named
    assert len(named) > 20
    off = {"refine": False}  # what is on already has only the option that turns it off
    written = {n: in_command(Option(n, off.get(n, "X"))).split()[0] for n in named}
    assert {name: option for name, option in written.items() if option not in options} == {}


@pytest.mark.parametrize(
    ("text", "python", "command"),
    [
        ("Give " + arg("series", 4) + ".", "Give `series=4`.", "Give --series 4."),
        (arg("sign", "charge-positive"), "`sign='charge-positive'`", "--sign charge-positive"),
        (arg("partial", True), "`partial=True`", "--partial"),
        (arg("refine", False), "`refine=False`", "--no-refine"),
        (
            arg("nominal_Ah", letter="X") + " or " + arg("capacity", letter="LOG"),
            "`nominal_Ah=X` or `capacity=LOG`",
            "--nominal-ah X or --capacity LOG",
        ),
        (
            arg("channels", ("time_s", "Total Time")),
            "`channels={'time_s': 'Total Time'}`",
            "--channel time_s='Total Time'",
        ),
        (
            arg("channels", (("a_V", "x"), ("b_V", "y"))),
            "`channels={'a_V': 'x', 'b_V': 'y'}`",
            "--channel a_V=x --channel b_V=y",
        ),
        (
            joined_texts([arg("instance", letter="..."), arg("channels", letter="{...}")], ", "),
            "`instance=...`, `channels={...}`",
            "--instance, --channel",
        ),
        ("Or: " + within("Give " + arg("dt_s", 0.1)), "Or: give `dt_s=0.1`", "Or: give --dt 0.1"),
        # Text that looks like an argument is none: a name of a file, say.
        ("a log '`soc0=1`.csv'", "a log '`soc0=1`.csv'", "a log '`soc0=1`.csv'"),
    ],
)
def test_an_argument_is_said_as_the_option(text, python, command):
    assert text == python
    assert worded(text) == command
    assert worded(pickle.loads(pickle.dumps(text))) == command  # from another process


def test_every_option_of_every_command_is_rendered_from_its_argument():
    """What a refusal names comes out as the very option, whatever the command."""
    seen = 0
    for command in parsers(build_parser()):
        for action in command._actions:
            if not action.option_strings or action.dest == "help":
                continue
            argument = {"dt": "dt_s", "voltage_limits": "limits", "channel": "channels"}.get(
                action.dest, action.dest
            )
            off = action.option_strings[0].startswith("--no-")
            flag = action.nargs == 0
            value = not off if flag else ("time_s", "A") if argument == "channels" else 1
            argument = argument.removeprefix("no_")
            refusal = InputError("a", "b", "Give " + arg(argument, value) + ".")
            said = worded(refusal.text).removeprefix("found a; expected b. Give ").rstrip(".")
            assert refusal.options == (Option(argument, value),)
            assert said.split()[0].lower() in action.option_strings, action.option_strings
            assert f"`{argument}=" in str(refusal)
            seen += 1
    assert seen > 150


def test_a_refusal_keeps_what_it_names_on_its_way_from_another_process():
    refusal = pickle.loads(pickle.dumps(InputError("a", "b", "Give " + arg("dt_s", 1) + ".")))
    assert refusal.options == (Option("dt_s", 1),)
    assert worded(refusal.text) == "found a; expected b. Give --dt 1."
    assert isinstance(refusal.action, Text)


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


def test_the_commands_are_listed_in_the_order_of_work_on_one_screen():
    said = build_parser().format_help().splitlines()
    assert len(said) <= 24
    assert max(map(len, said)) <= 80
    listed = [line[9:].split()[0] for line in said[2:]]
    work = ["start", "identify", "simulate", "replay", "diagnose", "export", "certify"]
    assert sorted(listed) == sorted({name.partition(" ")[0] for name in sections()})
    assert [name for name in listed if name in work] == work


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
