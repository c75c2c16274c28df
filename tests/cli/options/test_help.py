"""The help of a command ends with what it requires and two examples that it takes."""

from __future__ import annotations

import argparse
import shlex

import pytest

from cellwise.cli.command_line import build_parser


def leaves(parser):
    inner = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not inner:
        yield parser
    for action in inner:
        for command in action.choices.values():
            yield from leaves(command)


COMMANDS = {parser.prog.partition(" ")[2]: parser for parser in leaves(build_parser())}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_ends_with_examples_that_the_command_takes(name):
    said = COMMANDS[name].format_help().split("examples:\n")[1].splitlines()
    assert len(said) == 2
    for line in said:
        words = shlex.split(line.partition(" < ")[0])
        assert words[0] == "cellwise"
        parsed = build_parser().parse_args(words[1:])
        assert parsed.command == name.split()[0]
