"""cellwise data, papers, demo, and the program as it is installed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from cellwise.cli import main
from cellwise.data import list_datasets, list_originals, load_dataset
from cellwise.errors import InputError


def run_python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    return done.stdout.strip()


def test_data_list_names_everything_with_its_licence(run_json):
    found = run_json("data", "list")
    assert [e["name"] for e in found["embedded"]] == [e["name"] for e in list_datasets()]
    assert [e["name"] for e in found["originals"]] == [e["name"] for e in list_originals()]
    assert Path(found["folder"]).is_dir()
    for entry in found["embedded"]:
        assert (Path(found["folder"]) / entry["file"]).is_file()
        assert entry["parameter_doi"].startswith("10.")
    for entry in found["originals"]:
        assert entry["licence"]


def test_data_list_names_every_data_set(capsys):
    assert main(["data", "list"]) == 0
    text = capsys.readouterr().out
    for name in ("nmc_hppc", "lfp_cdc", "panasonic_18650pf"):
        assert name in text


def test_data_generate_without_pybamm_says_how_to_get_it(refused, monkeypatch, tmp_path):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr("cellwise.data.import_module", missing)
    assert "pip install 'pybamm>=" in refused("data", "generate", "-o", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists(), "nothing half made"


def test_an_unknown_data_set_lists_those_there_are():
    with pytest.raises(InputError, match=r"nmc_hppc.*lfp_cdc"):
        load_dataset("nmc_hpcp")


@pytest.mark.slow
def test_papers_prints_the_tables_of_both_papers(run_json):
    # What stands in the tables is tested with the benchmarks; here: both papers, as one object.
    found = run_json("papers")
    assert {"lfp", "ncr18650b", "seconds"} <= set(found)
    assert found["lfp"]
    assert set("abcdef") < set(found["lfp"]["ocv"][0]), "the OCV function of equation 8"
    assert found["ncr18650b"]


@pytest.mark.slow
def test_demo_writes_a_page_that_needs_no_network(capsys, tmp_path):
    out = tmp_path / "demo"
    assert main(["demo", "-o", str(out)]) == 0
    text = capsys.readouterr().out
    page = out / "index.html"
    assert page.is_file()
    assert text.rstrip().endswith(f"Open this page: {page}"), "ends by naming the page to open"
    html = page.read_text(encoding="utf-8")
    assert "<img" in html or "<svg" in html
    for far in ('src="http', 'href="http://', "<script src"):
        assert far not in html, "self-contained"
    assert json.loads((out / "nmc.json").read_text())["schema_version"] == 1


def test_the_installed_program():
    program = Path(sys.executable).with_name("cellwise")
    if not program.exists():
        pytest.skip("cellwise is importable here but not installed: no command to run")
    done = subprocess.run([program, "--version"], capture_output=True, text=True, check=True)
    name, version = done.stdout.split()
    assert name == "cellwise"
    assert version[0].isdigit()
    refused = subprocess.run([program, "inspect", "none.csv"], capture_output=True, text=True,
                             check=False)  # fmt: skip
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    assert refused.stdout == ""


@pytest.mark.parametrize("module", ["cellwise", "cellwise.cli", "cellwise.logs"])
def test_importing_loads_no_compiler(module):
    # Help and refusals must come at once: compilers and solvers are loaded where they are used.
    heavy = "('numba', 'scipy', 'matplotlib', 'pybamm', 'filterpy', 'pandas')"
    code = f"import {module}, sys; print([m for m in {heavy} if m in sys.modules])"
    assert run_python(code) == "[]"


def test_help_loads_no_compiler():
    code = (
        "import sys, contextlib, io\n"
        "from cellwise.cli import main\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        "    main(['identify', '--help'])\n"
        "print([m for m in ('numba', 'scipy', 'matplotlib') if m in sys.modules])"
    )
    assert run_python(code) == "[]"
