"""What newcomers got who took a stock model, stated a wrong label, or gave a folder to `start`.

Each answer was absurd once. A line that a refusal proposes is run as it stands.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import replace

import pytest

import cellwise as cw
from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.stock import named_model, stock_model
from cellwise.cli import main
from cellwise.cli.common.parser import AT_HAND, MODEL
from cellwise.logs.writing import write_columns
from cellwise.notices import Code
from cellwise.workflows.nearest_stock import nearest_stock
from cellwise.workflows.replaying import replay_and_forecast
from emulated_packs import emulated_pack
from example_cells import curved_cell


def said(capsys, *arguments, code=0):
    """What a command prints on both streams."""
    capsys.readouterr()
    try:
        ended = main(list(arguments))
    except SystemExit as refusal:
        ended = refusal.code
    assert ended == code
    return "".join(capsys.readouterr())


def proposed(capsys, *arguments):
    """The line that a refusal writes out, as words."""
    return shlex.split(said(capsys, *arguments, code=2).partition("Add it: cellwise ")[2])


def test_the_model_that_a_refusal_proposes_is_not_far_off(capsys):
    line = proposed(capsys, "replay", "nmc_drive_b")
    assert line[:2] == ["replay", "nmc_drive_b"]
    assert "FAR OFF" not in said(capsys, *line)


def test_for_a_log_of_ones_own_it_is_said_that_it_is_a_stock_model(capsys):
    refusal = said(capsys, "replay", "mine.csv", code=2)
    assert f"a stock model of a {stock_model(AT_HAND[MODEL]).capacity_Ah:.2g} Ah" in refusal
    assert "--capacity-ah X" in refusal


@pytest.mark.parametrize(
    ("given", "nearest"),
    [
        (("nmc-18650", None, "nmc_drive_b"), "nmc-18650"),
        (("lfp-26650", 5.0, "nmc_drive_b"), "nmc-18650"),
        (("nmc-18650", 2.3, "lfp_cdc"), "lfp-26650"),
    ],
    ids=["another size", "another chemistry", "lfp"],
)
def test_of_a_log_far_off_a_stock_model_the_nearest_one_is_named(given, nearest):
    name, capacity_Ah, log = given
    run = replay_and_forecast(named_model(name, capacity_Ah), cw.load_dataset(log))
    first = run.notices[0]
    assert first.code is Code.FAR_OFF
    assert f"Of the stock models {nearest} is the nearest" in first.text
    assert ("another capacity than this stock model's" in first.text) == (capacity_Ah is None)
    (option,) = (o for o in first.text.options if o.argument == "capacity_Ah" and o.value)
    again = replay_and_forecast(named_model(nearest, option.value), run.replay.log)
    assert again.far is None


def test_no_stock_model_is_named_where_none_is_near():
    log, model = cw.load_dataset("nmc_drive_b"), named_model("lfp-26650", 5.0)
    assert nearest_stock(model, log).name == "nmc-18650"
    assert nearest_stock(model, replace(log, voltage_V=0.3 * log.voltage_V)) is None
    assert nearest_stock(curved_cell(), log) is None


def test_nothing_is_said_of_the_start_by_a_model_that_the_log_is_far_off(capsys):
    shown = said(capsys, "replay", "--model", "lfp-26650", "--capacity-ah", "5", "nmc_drive_b")
    assert "FAR OFF" in shown
    assert "seen afterwards" not in shown
    assert "by model and current" not in shown


@pytest.mark.parametrize(("soc0", "wrong"), [(1.0, False), (0.97, False), (0.2, True)])
def test_a_stated_start_that_the_first_voltages_contradict_is_said_first(soc0, wrong):
    log = replace(cw.load_dataset("nmc_drive_b"), soc0=soc0)
    run = replay_and_forecast(named_model("nmc-18650", 5.0), log)
    assert (run.notices[0].code is Code.START_CONTRADICTED) == wrong
    assert not wrong or "by its voltages" in run.notices[0].text
    assert wrong or run.critical == ()


def test_a_reference_that_leaves_the_cell_is_said_before_its_errors():
    model, log = named_model("nmc-18650", 5.0), cw.load_dataset("nmc_drive_b")
    right = cw.replay(model, log, soc0=1.0, reference_capacity_Ah=5.0)
    wrong = cw.replay(model, log, soc0=1.0, reference_capacity_Ah=2.0)
    assert not any("the reference runs" in n.text for n in right.notices)
    assert "the reference runs from SOC -1." in wrong.notices[0].text


@pytest.mark.parametrize(("capacity_Ah", "said_so"), [(5.0, False), (4.0, True)])
def test_more_charge_than_the_stated_capacity_is_said_of_a_replay(capacity_Ah, said_so):
    """A filter holds the SOC within 0..1, so nothing was said: 4.7 Ah out of 4."""
    run = cw.replay(named_model("nmc-18650", capacity_Ah), cw.load_dataset("nmc_drive_b"))
    assert any(n.code is Code.TOO_MUCH_CHARGE for n in run.notices) == said_so


def test_no_band_of_the_soc_is_wider_than_a_cell(capsys):
    shown = said(capsys, "replay", "--model", "nmc-18650", "--capacity-ah", "50", "nmc_drive_b")
    bands = [float(b) for b in re.findall(r"±\s([0-9.]+)\s%", shown)]
    assert bands
    assert max(bands) <= 100.0


def test_one_log_shows_no_change(capsys):
    shown = said(capsys, "history", "--model", "nmc-18650", "--capacity-ah", "5", "nmc_drive_b")
    assert "one log shows no change" in shown
    assert "throughput_Ah" not in shown


@pytest.mark.parametrize(("capacity_Ah", "said_so"), [("5", False), ("10", True)])
def test_a_life_that_begins_at_another_capacity_is_said(capacity_Ah, said_so, capsys):
    """Half of a capacity that was typed twice too large is no ageing."""
    drives = ["nmc_drive_a", "nmc_drive_b"]
    shown = said(capsys, "history", "--model", "nmc-18650", "--capacity-ah", capacity_Ah, *drives)
    assert ("the capacity is another cell's" in shown) == said_so


def test_a_history_says_that_its_currents_are_no_such_cells(run_json):
    """Days of a car's cell of 30 Ah by a model of 2.8: "use now: 2.8 +- 1.1 Ah", and no word."""
    drive = ("nmc_drive_b", "--anyway")
    of_size = run_json("history", "--model", "nmc-18650", "--capacity-ah", "5", *drive)
    small = run_json("history", "--model", "nmc-18650", "--capacity-ah", "2.2", *drive)
    assert not any("model's data covered" in text for text in of_size["notices"])
    assert any("where its data end, to 14.5" in text for text in small["notices"])


@pytest.mark.parametrize("whole", [False, True])
def test_start_takes_no_part_of_a_discharge_for_the_capacity(tmp_path, run_json, whole):
    log = cw.load_dataset("nmc_hppc")
    if not whole:
        log = log.part(0, len(log) // 4)
    cw.write_log(log, tmp_path / "pulses.csv")
    found = run_json("start", str(tmp_path))
    (command,) = found["commands"]
    nominal = command.partition("--nominal-ah ")[2].split()[0]
    assert any("rated capacity" in text for text in found["missing"]) != whole
    assert (nominal == "X") != whole
    assert not whole or float(nominal) == pytest.approx(5.09, abs=0.05)


def test_the_resistance_of_a_headline_is_where_the_tables_lie():
    at_cold = replace(curved_cell(), effects=(TemperatureDependence(3000.0, -20.0),))
    assert "mohm at -20 degC" in repr(at_cold)
    assert "degC" not in repr(replace(curved_cell(), effects=()))


def test_a_wrong_start_is_not_another_cell():
    model, log = named_model("nmc-18650", 5.0), cw.load_dataset("nmc_drive_b")
    (reason,) = cw.diagnose(model, log, soc0=0.5).reasons
    assert "the start is wrong" in reason
    assert "another cell" not in reason


def test_a_nominal_capacity_in_milliampere_hours_is_asked_about(tmp_path, capsys):
    out = ("-o", str(tmp_path / "m.json"))
    refused = said(capsys, "identify", "--hppc", "nmc_hppc", "--nominal-ah", "5000", *out, code=2)
    assert "5000 Ah (mAh for Ah?)" in refused


def test_the_charge_of_a_pack_is_said_with_its_band(tmp_path, run_json, capsys):
    """A stock model's capacity, which a few miles do not show, stood there to the hundredth."""
    _, pack = emulated_pack(4, hours=0.5, soc0=0.6)
    place = str(tmp_path / "pack.csv")
    write_columns(pack.columns(), tmp_path / "pack.csv")
    given = ("pack", "--model", "nca-18650", place)
    std = max(cell["capacity_std_Ah"] for cell in run_json(*given)["per_cell"])
    line = next(one for one in said(capsys, *given).splitlines() if "usable as" in one)
    (band,) = re.findall(r"± ([0-9.]+)", line)
    assert float(band) == pytest.approx(2.0 * std, rel=0.1)
    assert "Wh" in line
