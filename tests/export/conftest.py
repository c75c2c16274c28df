"""One way to export by the command, and one C compiler without a warning."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
from collections.abc import Callable
from typing import Any

import pytest

from cellwise.cell.model_file import write_model
from cellwise.cli import main
from cellwise.export.c_tables import STRICT_FLAGS, WARNING_FLAGS
from example_cells import curved_cell


@pytest.fixture
def export(tmp_path) -> Callable[..., dict[str, Any]]:
    """`cellwise export` of a model with options: what it printed."""

    def run(*arguments: object, model: Any = None) -> dict[str, Any]:
        write_model(model or curved_cell(), tmp_path / "model.json")
        said = ["export", "--model", tmp_path / "model.json", *arguments, "--json"]
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert main(list(map(str, said))) == 0
        return json.loads(printed.getvalue())

    return run


@pytest.fixture
def refused(tmp_path, capsys) -> Callable[..., str]:
    """The message of an export that must be refused and leave nothing behind."""

    def run(*arguments: object, model: Any = None) -> str:
        write_model(model or curved_cell(), tmp_path / "model.json")
        said = ["export", "--model", tmp_path / "model.json", *arguments]
        assert main(list(map(str, said))) == 2
        assert [p.name for p in tmp_path.iterdir()] == ["model.json"]
        return capsys.readouterr().err

    return run


@pytest.fixture
def no_cross_compiler(monkeypatch):
    """Counting instructions takes long."""
    monkeypatch.setattr("cellwise.export.cross.has_tools", lambda core: False)


@pytest.fixture
def built(tmp_path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Compile sources of a folder strictly, without a warning, and run the program."""

    def run(folder, sources, *options) -> subprocess.CompletedProcess[str]:
        program = str(tmp_path / "program")
        command = ["gcc", "-O2", *STRICT_FLAGS, *WARNING_FLAGS, *options, *sources, "-o", program]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return subprocess.run([program], capture_output=True, text=True, check=False)

    return run
