"""What cannot be exported is refused before the work, and nothing is written."""

from __future__ import annotations

import shutil

import pytest

from cellwise.cell.effects import Hysteresis
from cellwise.cli.common.usage import sections
from cellwise.export.c_tables import firmware_folder
from example_cells import curved_cell

CLANG = "apt-get install clang lld"


@pytest.mark.parametrize(
    ("format_", "name", "extra"),
    [
        ("fmu", "out.fmu", "pip install 'fmpy>="),
        ("can", "gauge.dbc", "pip install 'cantools>="),
        ("pybamm", "cell.json", "pip install 'pybamm>="),
        ("page", "page.html", CLANG),
    ],
)
def test_what_a_format_needs_and_does_not_have(
    refused, tmp_path, monkeypatch, format_, name, extra
):
    """A library, a compiler; a time step; a name that ends as the format does."""
    if format_ == "fmu" and shutil.which("gcc") is None:
        pytest.skip("no gcc: apt-get install gcc")
    monkeypatch.setattr("cellwise.export.firmware.find_spec", lambda name: None)
    monkeypatch.setattr(
        "cellwise.export.page.shutil.which", lambda name: "cc" if name == "cc" else None
    )
    assert extra in refused(f"--{format_}", tmp_path / name, "--dt", 1)
    suffix = name.partition(".")[2]
    assert f".{suffix}" in refused(f"--{format_}", tmp_path / "out.zip", "--dt", 1)
    said = "--report without -o" if format_ != "fmu" else "no time step"
    assert said in refused(f"--{format_}", tmp_path / name, "--report", tmp_path / "a.html")


def test_names_and_effects_that_a_format_has_no_place_for(refused, tmp_path):
    pytest.importorskip("cantools")
    assert "name of C" in refused("--can", tmp_path / "1 bus.dbc")
    model = curved_cell(effects=(Hysteresis(0.02, 50.0),))
    assert "--without hysteresis" in refused("--pybamm", tmp_path / "cell.py", model=model)


def test_a_layout_needs_its_folder_and_foxbms_whole_milliseconds(refused, tmp_path):
    layout = ("--layout", "foxbms", "--dt")
    assert "-o DIR" in refused(*layout, 0.0305, "--fmu", tmp_path / "a.fmu")
    assert "milliseconds" in refused(*layout, 0.03051, "-o", tmp_path / "out")


def test_the_layouts_of_the_command_are_those_there_are():
    there = [path.name for path in (firmware_folder() / "layouts").iterdir() if path.is_dir()]
    said = sections()["export"][2].split("--layout ")[1].split()[0]
    assert set(said.split("|")) == set(there)
