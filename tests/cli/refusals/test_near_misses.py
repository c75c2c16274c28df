"""What a user nearly wrote: the refusal names it, and nothing is read as something else."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from cellwise import read_model
from cellwise.cli import main
from cellwise.diagnose import diagnose
from cellwise.errors import InputError


def test_an_option_that_is_nearly_one_is_named(model, drive, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["replay", "--model", model, drive, "--estimater", "ekf"])
    assert stopped.value.code == 2
    assert "did you mean '--estimator'?" in capsys.readouterr().err


def test_a_page_that_is_no_html_is_refused_before_the_work(model, drive, tmp_path, capsys):
    page = tmp_path / "out.pdf"
    assert main(["replay", "--model", model, drive, "--report", str(page)]) == 2
    assert "--figure-format pdf" in capsys.readouterr().err
    assert not page.exists()


@pytest.mark.parametrize("logs", ["x", ["x"], [None]])
def test_a_diagnosis_of_what_is_no_log_says_so(model, logs):
    with pytest.raises(InputError, match="log"):
        diagnose(read_model(model), logs)


@pytest.mark.slow
def test_remaining_time_in_c_compiles_without_a_warning(model, tmp_path):
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("no C compiler")
    out = tmp_path / "firmware"
    asked = ["--dt", "1", "--remaining", "3.0", "-o", str(out)]
    assert main(["export", "--model", model, *asked]) == 0
    sources = [str(p) for p in out.glob("cellwise*.c") if "example" not in p.name]
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    done = subprocess.run([gcc, *flags, *sources], capture_output=True, text=True, cwd=out)
    assert sources
    assert done.returncode == 0, done.stderr
