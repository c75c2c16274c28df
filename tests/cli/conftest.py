"""One identification for all tests of commands, and ways to run them."""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from cellwise.cli import main
from cellwise.data import datasets_folder

NMC = datasets_folder() / "nmc"
# An argument as Python has it: a command writes its own option.
IN_PYTHON = re.compile(r"`[A-Za-z]\w*=[^`]*`")


@dataclass(frozen=True)
class Identified:
    """What ``cellwise identify --json`` printed, and the model it wrote."""

    printed: dict[str, Any]
    path: Path
    stderr: str


@pytest.fixture(scope="session")
def identified(tmp_path_factory) -> Identified:
    path = tmp_path_factory.mktemp("identified") / "nmc.json"
    tests = ["--hppc", "hppc", "--ocv", "ocv_c20", "--capacity", "cap_c5", "--drive", "drive_c"]
    places = [w if w.startswith("--") else str(NMC / f"{w}.parquet") for w in tests]
    found, said = printed("identify", *places, "--nominal-ah", "5", "-o", str(path))
    return Identified(found, path, said)


@pytest.fixture(scope="session")
def model(identified) -> str:
    return str(identified.path)


@pytest.fixture(scope="session")
def drive() -> str:
    return str(NMC / "drive_b.parquet")


def printed(*arguments: object) -> tuple[dict[str, Any], str]:
    """Run a command with ``--json`` that must succeed: its one object, and standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([*map(str, arguments), "--json"])
    assert code == 0, err.getvalue()
    assert not IN_PYTHON.search(out.getvalue() + err.getvalue())
    return one_object(out.getvalue()), err.getvalue()


@pytest.fixture(scope="session")
def run_json() -> Callable[..., dict[str, Any]]:
    """The one object of a command that must succeed."""
    return lambda *arguments: printed(*arguments)[0]


@pytest.fixture
def refused(capsys) -> Callable[..., str]:
    """Run a command that must be refused: its one message."""

    def run(*arguments: str) -> str:
        capsys.readouterr()
        try:
            code = main(list(arguments))
        except SystemExit as stop:  # the parser refuses by itself
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        assert code == 2
        assert captured.out == ""
        assert "Traceback" not in captured.err
        assert not IN_PYTHON.search(captured.err)
        lines = captured.err.splitlines()
        assert len(lines) == 1, "one message"
        assert "; expected " in lines[0], "what was found, what was expected, what to do"
        return lines[0]

    return run


def one_object(text: str) -> dict[str, Any]:
    """The single JSON object in a command's output, strict: no NaN, no second line."""

    def no_constant(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    found = json.loads(text, parse_constant=no_constant)
    assert isinstance(found, dict)
    assert text.count("\n") == 1
    return found
