"""The page of a diagnosis: the finding first, self-contained, figures equal to the diagnosis."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from cellwise.cell.simulate import simulate
from cellwise.diagnose.odds import Weighed
from cellwise.diagnose.result import LogRun
from cellwise.report.diagnosis.page import (
    cause_content,
    diagnose_page,
    diagnosis_sections,
    limits_table,
)
from cellwise.report.diagnosis.statements import (
    change,
    diagnosis_finding,
    probability,
    statement,
    unsure_lines,
    weights,
)
from cellwise.report.page.markup import finite
from cellwise.report.page.numerals import millivolt
from cellwise.report.page.section import pictures_of
from diagnosis_cases import CELL, VALUES, diagnosis, found, measured
from report_cases import Page
from virtual_tester import logged

# What a battery engineer must read of each of them, once.
SAID = {
    "current_offset": "98 mA too much",
    "current_gain": "3.2 % too much",
    "voltage_offset": "12.0 mV too little",
    "time_skew": "0.40 s after the current",
    "initial_soc": "starts at 85 % SOC, not at 90 %",
    "capacity": "2.700 Ah, 10 % less than the model's 3 Ah",
    "resistance_scale": "1.35 times",
    "ocv_shift": "−12.0 mV at 50 % SOC",
    "slow_diffusion": "12 mΩ with 17 min",
    "hysteresis": "18.0 mV to either side",
    "temperature_dependence": "1.34 times those at 25 °C",
    "rate_dependence": "0.800 times those at small currents",
    "charge_transfer": "exchange current is 0.550 times",
    "charge_asymmetry": "1.30 times those on discharge",
    "self_heating": "5 K per watt",
    "self_discharge": "20 mA",
}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    record = diagnosis("current_offset")
    text = diagnose_page(record, folder / "p.html", figures=folder / "f").read_text("utf-8")
    return record, text, Page(text), folder / "f"


def test_the_first_line_is_the_finding_in_the_figures_of_the_held_out_log(written):
    record, _, page, _ = written
    said = page.text_in("h1").replace("\N{NO-BREAK SPACE}", " ")
    held = record.runs[1].to_dict()
    before, after = (millivolt(held[f"rmse_{k}_V"]) for k in ("before", "corrected"))
    start = (
        "Keep the model, correct the log: the current sensor reads 98 mA too much; "
        f"held <&> (held out) {before} → {after}"
    )
    assert said.startswith(start.replace("\N{NO-BREAK SPACE}", " "))
    assert f"{after}.".replace("\N{NO-BREAK SPACE}", " ") in said


def test_the_figures_of_the_cell_and_of_the_log_stand_apart():
    """What `simulate` shows with the new model, and beside it what the corrected log adds."""
    record = diagnosis("current_offset", "capacity")
    run = record.runs[1]
    grown = replace(run, after=simulate(replace(CELL, capacity_Ah=2.5), run.log, 0.9))
    said = change(grown).replace("\N{NO-BREAK SPACE}", " ")
    for key in ("rmse_before_V", "rmse_after_V", "rmse_corrected_V"):
        assert millivolt(grown.to_dict()[key]).replace("\N{NO-BREAK SPACE}", " ") in said


@pytest.mark.parametrize("name", VALUES)
def test_every_cause_is_said_with_its_numbers(name):
    said = statement(found(name), diagnosis(name)).replace("\N{NO-BREAK SPACE}", " ")
    assert SAID[name] in said
    assert not said.endswith(".")


def test_a_sign_is_a_direction():
    little = found("current_offset", parameters={"offset_A": -0.05})
    assert "too little" in statement(little, diagnosis("current_offset"))
    early = found("time_skew", parameters={"skew_s": -0.4})
    assert "before the current" in statement(early, diagnosis("time_skew"))
    alone = found("voltage_offset", log="drive 2")
    assert statement(alone, diagnosis("voltage_offset")).endswith("too little in drive 2")


def test_none_and_undetermined_are_said():
    none = diagnosis()
    assert "no error beyond the stated one" in diagnosis_finding(none)
    assert millivolt(none.runs[1].before.rmse_V) in diagnosis_finding(none)
    rivals = (Weighed(("current_offset",), 0.6), Weighed(("current_gain",), 0.4))
    open_verdict = replace(none, verdict="undetermined", competing=rivals)
    assert "may be current offset, current gain or none" in diagnosis_finding(open_verdict)
    assert "current offset 60.0" in unsure_lines(open_verdict)[0]
    unsure = replace(none, competing=(Weighed((), 0.675), Weighed(("voltage_offset",), 0.18)))
    said = unsure_lines(unsure)[0].replace("\N{NO-BREAK SPACE}", " ")
    assert said == "Possible are none of the causes tried 67.5 % and voltage offset 18.0 %."
    quiet = replace(open_verdict, competing=(), reasons=("the log is too short",))
    assert "the log is too short" in diagnosis_finding(quiet)


def test_it_is_one_valid_file_and_loads_nothing(written):
    _, text, page, _ = written
    assert len(page.ids) == len(set(page.ids))
    inner = [a for a in (*page.addresses, *page.references) if a.startswith("#")]
    assert inner
    assert {a[1:] for a in inner} <= set(page.ids)
    assert not [a for a in page.addresses if not a.startswith(("#", "data:"))]
    assert "cell <b>" not in text
    assert "held <&>" not in text
    assert [a["type"] for a, _ in page.scripts] == ["application/json"]


def test_the_figures_for_machines_are_the_diagnosis(written):
    record, _, page, _ = written
    data = json.loads(page.scripts[0][1])
    expected = finite(record.to_dict())
    for key in set(expected) - {"anatomy"}:
        assert data[key] == expected[key]
    assert [g["used"] for g in data["logs"]] == ["fit", "holdout"]


def test_a_diagnosis_page_has_every_part(written):
    _, _, page, folder = written
    assert {"before-after", "causes", "evidence", "anatomy", "logs"} <= set(page.ids)
    names = {p.name for p in folder.iterdir()}
    assert {"anatomy-1.png", "before-after-1.png"} <= names
    text = " ".join(t for _, t in page.texts).replace("\N{NO-BREAK SPACE}", " ")
    for phrase in ("98 mA", "self discharge", "rest an hour at 50 %", "the log is corrected"):
        assert phrase in text


@pytest.mark.usefixtures("undrawn")
def test_what_to_measure_and_what_is_unsure_come_before_all_else(tmp_path):
    """Whatever a sensor did; one probability in the text, the table and the card."""
    weighed = (Weighed(("hysteresis",), 0.88), Weighed(("hysteresis", "ocv_shift"), 0.1166))
    record = diagnosis("hysteresis", competing=weighed, inseparable=(("hysteresis", "entropy"),))
    cause = replace(record.causes[0], probability=0.9966, prior_only=("gamma",))
    record = replace(record, causes=(cause,))
    page = Page(diagnose_page(record, tmp_path / "p.html").read_text("utf-8"))
    said = page.text_in("li").replace("\N{NO-BREAK SPACE}", " ")
    assert said.lstrip().startswith("Measure next: rest an hour")
    lines = ("Measure", "Probability of hysteresis 99.7 %.", "hysteresis and entropy", "A prop")
    assert [said.index(w) for w in lines] == sorted(said.index(w) for w in lines)
    every = " ".join(t for _, t in page.texts).replace("\N{NO-BREAK SPACE}", " ")
    assert "Hysteresis, probability 99.7 %" in every
    assert "100 %" not in every.split("Limits")[0]
    assert [w for _, w in weights(record)] == [
        probability(p) for p in (0.88, 0.1166, 0.0034, 0.9966)
    ]


def test_what_only_repeats_its_prior_is_folded_away():
    record = diagnosis("hysteresis")
    cause = replace(record.causes[0], prior_only=("gamma",))
    first, _, folded = cause_content(cause, record).partition("<details>")
    assert "<td>m_V" in first
    assert "<td>gamma" not in first
    assert "<td>gamma" in folded


def test_a_limit_that_the_logs_do_not_have_is_said():
    record = diagnosis("hysteresis", limits={"hysteresis": {"m_V": 0.016}})
    said = limits_table(record)
    assert "m_V 16" in said
    without = said.partition("These logs could show no change of")[2]
    assert "self discharge" in without
    assert "hysteresis" not in without


def test_the_headline_is_short(written):
    """Twenty words, a figure with its unit being one."""
    record, *_ = written
    for one in (record, diagnosis(), diagnosis("capacity")):
        assert len(diagnosis_finding(one).split(" ")) <= 22


def test_without_causes_nothing_is_drawn_twice():
    record = diagnosis()
    sections = diagnosis_sections(record, record.runs)
    assert "causes" not in [s.key for s in sections]
    title = sections[0].title
    assert title == "Measured and simulated"


@pytest.mark.usefixtures("undrawn")
def test_a_search_that_ended_before_it_began_has_a_page(tmp_path):
    why = "the log is too quiet: its current never leaves C/50"
    record = diagnosis(verdict="undetermined", candidates=(), soc0=(), reasons=(why,))
    page = Page(diagnose_page(record, tmp_path / "p.html").read_text("utf-8"))
    assert why in page.text_in("h1")
    assert "anatomy" in page.ids


@pytest.mark.usefixtures("undrawn")
def test_soc_before_and_after_is_reported(tmp_path):
    gain = {"log": "held", "soc_rmse_before": 0.031, "soc_rmse_after": 0.004}
    gain |= {"reference_capacity_Ah": 2.997, "reference": "stated"}
    record = diagnosis("current_offset", soc_gain=gain)
    page = Page(diagnose_page(record, tmp_path / "p.html").read_text("utf-8"))
    said = page.text_in("li").replace("\N{NO-BREAK SPACE}", " ")
    assert "3.10 % before, 0.40 % after, against the tester's counter over 2.997 Ah: stated" in said


def test_the_first_line_says_whether_to_adopt_and_every_loss():
    """The voltage gains, the SOC does not, or the other way round: one line says both."""
    record = diagnosis("capacity")
    true = replace(CELL, capacity_Ah=1.2)

    def run(log, used, cell):
        return LogRun(log, used, simulate(CELL, log, 0.9), simulate(cell, log, 0.9))

    def aged(name, seed):
        log = measured(name, seed, 0.0)
        return logged(true, log, 0.9)

    fitted = run(aged("drive", 0), "fit", true)
    good, bad = run(aged("one", 1), "holdout", true), run(measured("two", 2, 0.0), "holdout", true)
    gain = {"log": "one", "soc_rmse_before": 0.0107, "soc_rmse_after": 0.004}
    better = replace(record, runs=(fitted, good), soc_gain=gain)
    assert better.to_dict()["adopt"] is True
    assert diagnosis_finding(better).startswith("Adopt the extended model: the cell holds")
    unjudged = diagnosis_finding(replace(better, soc_gain=None))
    assert unjudged.startswith("Adopt the extended model for its voltage (SOC not judged)")
    for worse, said in (
        (replace(better, soc_gain={**gain, "soc_rmse_after": 0.0248}), "but SOC gets worse, 1.07"),
        (replace(better, runs=(fitted, good, bad)), "but two (held out) "),
    ):
        assert worse.to_dict()["adopt"] is False
        head = diagnosis_finding(worse)
        assert head.startswith("Do not adopt the extended model: the cell holds")
        assert said in head


@pytest.mark.usefixtures("undrawn")
def test_without_a_referee_no_gain_in_soc_is_claimed_and_the_page_says_why(tmp_path):
    record = diagnosis("capacity", no_soc_gain="the capacity is one of the causes")
    page = Page(diagnose_page(record, tmp_path / "p.html").read_text("utf-8"))
    said = page.text_in("li").replace("\N{NO-BREAK SPACE}", " ")
    assert "No gain in SOC is claimed: the capacity is one of the causes." in said


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("tried", [0, 1])
def test_few_candidates_are_enough(tried, tmp_path):
    record = diagnosis("current_offset")
    record = replace(record, candidates=record.candidates[:tried], holdout=())
    path = diagnose_page(record, tmp_path / "p.html")
    assert ("evidence" in Page(path.read_text("utf-8")).ids) == (tried > 0)


def test_titles_say_what_was_found_and_axes_have_names():
    record = diagnosis("current_offset")
    for picture in pictures_of(diagnosis_sections(record, record.runs)):
        axes = picture.figure.axes
        assert any(c.isdigit() for c in axes[0].get_title(loc="left")), picture.key
        assert "[" in axes[-1].get_xlabel(), picture.key
