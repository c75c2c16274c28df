"""A layout of PlotJuggler beside the rows: every curve is a column, in four plots."""

from __future__ import annotations

import csv
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cellwise import load_dataset, write_log, write_model
from example_cells import curved_cell


def files(tmp_path):
    write_model(curved_cell(), tmp_path / "model.json")
    write_log(load_dataset("nmc_drive_b").part(0, 300), tmp_path / "drive.csv")
    return str(tmp_path / "model.json"), str(tmp_path / "drive.csv")


def test_the_layout_names_the_rows_and_their_columns(tmp_path, run_json):
    model, drive = files(tmp_path)
    out, layout = tmp_path / "rows.csv", tmp_path / "rows.xml"
    run_json(
        "replay", "--model", model, drive, "--soc0", "0.9", "--reference-capacity-ah", "5",
        "-o", str(out), "--plotjuggler", str(layout),
    )  # fmt: skip
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    root = ElementTree.parse(layout).getroot()
    plots = [[c.get("name") for c in plot.iter("curve")] for plot in root.iter("plot")]
    assert plots == [
        ["measured_voltage_V", "voltage_V"],
        ["current_A"],
        ["soc", "reference_soc"],
        ["innovation_V"],
    ]
    assert {name for plot in plots for name in plot} <= set(rows[0])
    (splitter,) = root.iter("DockSplitter")
    assert splitter.get("count") == str(len(plots))
    (file,) = root.iter("fileInfo")
    assert Path(layout.parent, file.get("filename")) == out
    (axis,) = root.iter("parameters")
    assert axis.get("time_axis") in rows[0]
    moved = np.array([float(r["measured_voltage_V"]) - float(r["voltage_V"]) for r in rows])
    np.testing.assert_allclose(moved, [float(r["innovation_V"]) for r in rows], atol=1e-9)


def test_a_layout_needs_rows_as_csv(tmp_path, refused):
    model, drive = files(tmp_path)
    layout = str(tmp_path / "rows.xml")
    for more in ([], ["-o", str(tmp_path / "rows.parquet")]):
        said = refused("replay", "--model", model, drive, *more, "--plotjuggler", layout)
        assert "Add -o OUT.csv" in said
