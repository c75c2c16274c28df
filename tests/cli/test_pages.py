"""What the pages of the commands lead with: adopt or not, what is left at the usual load."""

from __future__ import annotations

import re
from html import unescape

import numpy as np
import pytest

from cellwise.logs import read_log, write_log
from diagnosis_cases import odd_sensor
from example_cells import curved_cell

START = 0.9
OFFSET_A = 0.1


def text_of(page, tag):
    """What stands in the elements of a kind, as a reader has it."""
    parts = re.findall(rf"<{tag}[ >].*?</{tag}>", page.read_text("utf-8"), flags=re.S)
    plain = unescape(re.sub(r"<[^>]*>", " ", "\n".join(parts)))
    return plain.replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.usefixtures("drawn")
def test_an_extension_that_makes_soc_worse_is_not_to_be_adopted(run_json, capsys, tmp_path):
    """An OCV that is moved explains the voltages of an odd sensor, and loses its SOC."""
    from cellwise.cli import main

    folder, cell = odd_sensor(tmp_path, OFFSET_A, counted=True), curved_cell()
    page, new = tmp_path / "page.html", tmp_path / "new.json"
    command = ("diagnose", "--model", str(folder / "cell.json"), str(folder / "drive.csv"),
               "--holdout", str(folder / "held.csv"), "--soc0", str(START), "--cause", "ocv_shift",
               "--reference-capacity-ah", str(cell.capacity_Ah))  # fmt: skip
    found = run_json(*command, "-o", str(new), "--report", str(page))
    held = next(r for r in found["logs"] if r["used"] == "holdout")
    gain = found["soc_gain"]
    assert found["verdict"] == "ocv_shift"
    assert held["rmse_after_V"] < 0.5 * held["rmse_before_V"]
    assert gain["soc_rmse_after"] > 2.0 * gain["soc_rmse_before"]
    assert found["adopt"] is False
    before, after = (f"{100 * gain[f'soc_rmse_{k}']:.2f} %" for k in ("before", "after"))
    headline = text_of(page, "h1")
    assert headline.split()[:6] == ["Do", "not", "adopt", "the", "extended", "model:"]
    assert f"but SOC gets worse, {before} → {after} RMSE" in headline
    capsys.readouterr()
    assert main(list(command)) == 0
    said = capsys.readouterr().out.replace("\N{NO-BREAK SPACE}", " ")
    assert " ".join(headline.split()) in " ".join(said.split())
    # One figure of each log: in the JSON, on the page, by `simulate` with the model written.
    one = run_json("simulate", "--model", str(new), str(folder / "held.csv"), "--soc0", str(START))
    assert one["rmse_V"] == pytest.approx(held["rmse_after_V"], rel=1e-9)
    assert f"{1e3 * one['rmse_V']:.1f} mV" in text_of(page, "dl")
    assert f"{1e3 * one['rmse_V']:.1f} mV" in text_of(page, "table")


def test_what_is_left_is_shown_at_the_usual_load_with_its_band(
    model, drive, run_json, drawn, tmp_path
):
    page = tmp_path / "page.html"
    found = run_json("replay", "--model", model, drive, "--report", str(page))
    usual = found["forecast"]["typical"]
    headline = text_of(page, "h1")
    minutes = (usual["remaining_s"], *usual["remaining_s_band"])
    whole = [float(n) for n in re.findall(r"\d+(?:\.\d+)?", headline.partition(":")[2])][:3]
    scale = 3600.0 if " h (" in headline else 60.0 if " min (" in headline else 1.0
    assert whole == pytest.approx([m / scale for m in minutes], rel=0.06, abs=0.06)
    assert headline.rstrip().endswith("A.")
    assert "left at the usual" in headline
    assert "usual load" in text_of(page, "thead")
    # The drive ends at a rest: the little that its last minute holds is no load to go on with.
    assert found["forecast"]["stands"]
    assert "last minute" not in text_of(page, "thead")
    assert drawn[0].key.startswith("flight")
    above, below, _ = drawn[0].figure.axes
    for axes in (above, below):
        (line,), (band,) = axes.lines, axes.collections
        left = line.get_ydata()
        # It falls with the charge and does not swing with every bend, as the last minute's does.
        assert np.abs(np.diff(left)).max() < 0.05 * np.ptp(left)
        low, high = band.get_datalim(axes.transData).intervaly
        assert low < left.min() < left.max() < high


def test_several_logs_lead_with_the_last_one(model, drive, run_json, drawn, tmp_path):
    """A day that is cut at its pauses: what is left now, and a row for each part."""
    log = read_log(drive)
    parts = [log.part(0, 2000), log.part(2000, 4000), log.part(4000, 5500)]
    day = tmp_path / "day"
    day.mkdir()
    for k, part in enumerate(parts):
        write_log(part, day / f"part_{k}.csv")
    page = tmp_path / "page.html"
    run_json("replay", "--model", model, str(day), "--report", str(page))
    keys = [p.key for p in drawn]
    assert [k for k in keys if k.startswith("flight")] == ["flight-part-2"]
    assert "part-2" in keys[1], "SOC of the log that the headline is about comes first"
    tables = text_of(page, "table")
    assert all(f"part_{k}" in tables for k in range(3))
    assert "left at the usual" in text_of(page, "h1")
