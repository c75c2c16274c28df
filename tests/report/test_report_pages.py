"""Pages: valid, self-contained, the finding first, the figures for machines equal to to_dict."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import matplotlib
import numpy as np
import pytest

from cellwise.cell.simulate import Simulation
from cellwise.errors import InputError
from cellwise.report.demo_page import demo_page
from cellwise.report.identification.measured_sections import pulse_pictures
from cellwise.report.identification.page import identify_page, identify_sections
from cellwise.report.page.markup import EMPTY, MOST, Markup, finite, table
from cellwise.report.page.picture import inline
from cellwise.report.page.section import Section, page_text, pictures_of, program, rendered
from cellwise.report.replay.page import replay_data, replay_page, replay_sections
from cellwise.report.replay.replay_section import replay_figures, replay_finding
from report_cases import Page, drive, hppc, identification, replay, simulation

NASTY = "<script>alert('1')</script> & \"$x_1^2$\" </svg> \\u003c"


def written(write, tmp_path, *args, **kwargs):
    text = write(*args, tmp_path / "page.html", **kwargs).read_text(encoding="utf-8")
    return text, Page(text)


@pytest.fixture(scope="module")
def laboratory():
    return identification()


@pytest.fixture(scope="module")
def road():
    log = drive()
    return [simulation(log)], [replay(log), replay(log, estimator="coulomb", forget_s=1e9)]


@pytest.fixture(scope="module")
def pages(tmp_path_factory, laboratory, road, without_pictures):
    """Every kind of page: name -> (text, parsed, the figures it should hold).

    The demo's page has all pictures of an identification's, which has them as captions here.
    """
    folder = tmp_path_factory.mktemp("pages")
    simulations, replays = road
    with without_pictures():
        identified = identify_page(laboratory, folder / "identify.html")
    done = {
        "identify": (identified, laboratory.to_dict()),
        "replay": (
            replay_page(replays, folder / "replay.html", simulations),
            replay_data(replays, simulations),
        ),
        "demo": (
            demo_page(laboratory, simulations, replays, folder / "demo.html"),
            {"identification": laboratory.to_dict(), **replay_data(replays, simulations)},
        ),
    }
    texts = {kind: path.read_text(encoding="utf-8") for kind, (path, _) in done.items()}
    return {kind: (texts[kind], Page(texts[kind]), done[kind][1]) for kind in done}


KINDS = pytest.mark.parametrize("kind", ["identify", "replay", "demo"])


@KINDS
def test_ids_are_unique_and_every_reference_has_its_target(pages, kind):
    _, parsed, _ = pages[kind]
    assert len(parsed.ids) == len(set(parsed.ids))
    inner = [a[1:] for a in (*parsed.addresses, *parsed.references) if a.startswith("#")]
    assert inner
    assert set(inner) <= set(parsed.ids)


@KINDS
def test_nothing_is_loaded_and_only_our_plots_run(pages, kind):
    text, parsed, _ = pages[kind]
    assert all(a.startswith(("#", "data:image/png;base64,")) for a in parsed.addresses)
    assert len(parsed.scripts) == 1
    running = [text for attrs, text in parsed.programs if "type" not in attrs]
    assert running == [program()]
    assert "http" not in program()
    assert not {"link", "iframe", "object", "embed", "img", "audio", "video"} & set(parsed.tags)
    assert "@import" not in text
    assert parsed.tags.count("style") == 1
    assert "url(http" not in text


@KINDS
def test_json_block_is_to_dict(pages, kind):
    _, parsed, expected = pages[kind]
    attrs, text = parsed.scripts[0]
    assert attrs["id"] == "cellwise-data"
    assert json.loads(text) == json.loads(json.dumps(expected))


@KINDS
def test_first_line_is_the_finding(pages, kind):
    _, parsed, _ = pages[kind]
    body = [(path, text) for path, text in parsed.texts if "body" in path]
    assert body[0][0][-1] == "h1"
    assert sum(character.isdigit() for character in body[0][1]) >= 3


def test_identify_page_says_the_numbers_of_the_identification(pages, laboratory):
    said = pages["identify"][1].text_in("h1").replace("\N{NO-BREAK SPACE}", " ")
    # RMSE of 0.01 sin(t / 50) is 0.01 / sqrt(2); 7 of the 10 short pulses are healthy.
    assert "3.000 Ah" in said or "3 Ah" in said
    assert f"{1e3 * laboratory.fit.rmse_V:.1f} mV" in said
    assert "7 of 10" in " ".join(t for _, t in pages["identify"][1].texts)


def test_identify_page_tells_all_that_was_asked(pages):
    text = " ".join(t for _, t in pages["identify"][1].texts).replace("\N{NO-BREAK SPACE}", " ")
    for word in ("a notice with <angle> brackets", "because 1 < 2 & pulse 4"):
        assert word in text
    for word in ("CC part", "CV part", "cc-average", "ends <early>"):
        assert word in text
    for word in ("RMSE", "MAE", "max", "mean", "sd", "95 % interval", "Where every number"):
        assert word in text
    for number in ("2.980 Ah", "2.900 Ah", "0.080 Ah"):  # total, CC and CV at 1C
        assert number in text


def test_taken_choice_is_marked(pages):
    text = pages["identify"][0]
    marked = [row.split("</td>")[0].rsplit(">", 1)[-1] for row in text.split('class="marked"')[1:]]
    assert marked == ["rate:C/20"]


def test_replay_finding_is_the_closed_form():
    # 0.3 exp(-t / 50) = 0.02 at t = 50 ln 15 = 135.4 s, and the stated deviation, 0.01 + 0.2
    # exp(-t / 60), at t = 60 ln 20 = 179.7 s; rows of 1 s.
    found = replay(drive(3600))
    assert (found.convergence_s, found.settled_s) == (136.0, 180.0)
    said = replay_finding(replay(drive(3600))).replace("\N{NO-BREAK SPACE}", " ")
    assert said.startswith("From 30 points off the EKF is within 2 % after 180 s and then holds ")
    rms = 0.3 * np.exp(-180 / 50) * np.sqrt(50.0 / 2.0 / (3600 - 180))  # of 0.3 exp(-t / 50)
    assert f"{100 * rms:.2f} % SOC RMSE" in said


def test_replay_findings_of_other_ends():
    never = replay_finding(replay(drive(), forget_s=1e9))
    assert "never comes within" in never
    right = replay_finding(replay(drive(), off=0.001))
    assert right.startswith("From the right initial SOC the EKF holds 0.0")
    blind = replay_finding(replay(drive(), reference=False))
    assert "there is no reference" in blind
    at_once = replay_finding(replay(drive(), off=-0.3, forget_s=0.05))
    assert "after" in at_once  # the first row is still 30 points off


def test_all_figures_of_the_contract_are_in_the_table():
    # Numbers that cannot be taken for one another, with what the page should make of each.
    run = replay(drive(3600))
    told = dict(replay_figures(run))
    text = {key.replace("\xa0", " "): value.replace("\xa0", " ") for key, value in told.items()}
    error = run.error
    assert text["SOC RMSE"] == f"{100 * np.sqrt(np.mean(error**2)):.2f} %"
    assert text["SOC MAE"] == f"{100 * np.mean(np.abs(error)):.2f} %"
    assert text["SOC max. error"] == "30.0 %"
    assert text["within 2 %, and stated so, after"] == "180 s"
    assert text["settled: SOC max. error"] == f"{100 * np.abs(error[136:]).max():.2f} %"
    assert text["initial SOC"] == "70 % ± 30 %, given"
    assert text["voltage RMSE, one step ahead"] == "7.1 mV"  # 0.01 cos
    assert text["NIS"] == "0.500"  # of 1e-4 cos squared over 1e-4
    assert text["time per step"] == "95 ns"
    assert "error inside 2σ" in text
    assert text["samples"] == "3\N{NARROW NO-BREAK SPACE}600"


def test_many_replays_are_rows_and_few_pictures():
    runs = [replay(drive(60), off=-0.01 * k) for k in range(8)]
    sections = {s.key: s for s in replay_sections(runs)}
    table_text = rendered(sections["figures"])
    assert table_text.count("<tr") == 9
    assert len(pictures_of([sections["soc"]])) == 1 + MOST.plots


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_page_of_several_logs_begins_with_where_the_battery_is_now(
    order, tmp_path, without_pictures
):
    runs = [replay(drive(seconds), reference=False) for seconds in (600, 1800)]
    ordered = [runs[k] for k in order]
    with without_pictures():
        text, _ = written(replay_page, tmp_path, ordered)
    headline = text[text.index("<h1") : text.index("</h1>")]
    ends = [f"{100 * run.trace.soc[-1]:.3g}" for run in ordered]
    assert ends[0] != ends[1]
    assert f"ends at {ends[1]}" in headline.replace("\xa0", " ")


def test_names_of_logs_are_escaped_everywhere(tmp_path, without_pictures):
    laboratory = identification(name=NASTY)
    model = replace(laboratory.model, name=NASTY, chemistry=NASTY)
    laboratory = replace(laboratory, model=model)
    log = replace(drive(), name=NASTY)
    with without_pictures():
        said = "".join(rendered(s) for s in identify_sections(laboratory))
    drawn = inline(pulse_pictures(laboratory)[0])
    assert "<script>alert" not in said + drawn
    text, parsed = written(replay_page, tmp_path, [replay(log)])
    assert "<script>alert" not in text
    assert len(parsed.scripts) == 1
    assert not any(NASTY in text for _, text in parsed.programs)
    assert any(NASTY in t for _, t in parsed.texts)
    assert json.loads(parsed.scripts[0][1])["replays"][0]["log"] == NASTY


@pytest.mark.slow
def test_page_of_a_million_rows_is_small(tmp_path):
    log = drive(1_000_000)
    log = replace(log, current_A=np.random.default_rng(1).normal(0, 5, len(log)), charge_Ah=None)
    error = np.random.default_rng(2).normal(0.0, 0.01, len(log))
    run = replay(log)
    sims = [Simulation(log, 1.0, log.voltage_V - error, run.trace.soc)]
    text, _ = written(lambda s, path: replay_page([run], path, s), tmp_path, sims)
    assert len(text.encode()) < 20_000_000  # every sample of six channels, two bytes each


@pytest.mark.parametrize(
    "case",
    [
        {"temperatures": (-10.0, 10.0, 25.0)},
        {"refined": False},
        {"refined": False, "method": "segments"},
        {"with_pulses": False},
        {"temperatures": tuple(np.arange(-20.0, 45.0, 8.0))},
    ],
    ids=["three temperatures", "pulses alone", "segments", "drives alone", "many temperatures"],
)
def test_every_kind_of_identification_has_its_sections(case, without_pictures):
    sections = {s.key: s for s in identify_sections(identification(**case))}
    assert ("pulses" in sections) == case.get("with_pulses", True)
    assert {"ocv", "capacity", "parameters", "fit", "provenance"} <= set(sections)
    with without_pictures():
        Page(rendered(sections["parameters"]))


def test_identification_without_capacity_tests_or_branches():
    found = identification()
    bare = replace(
        found,
        capacity_tests=(),
        capacities={"nominal": 3.0},
        capacity_choice="nominal",
        ocv=replace(found.ocv, discharge_V=None, charge_V=None),
        notices=(),
    )
    sections = {s.key: s for s in identify_sections(bare)}
    assert "CC part" not in rendered(sections["capacity"])


@pytest.mark.usefixtures("undrawn")
def test_replay_without_reference_and_without_variance(tmp_path):
    log = drive()
    _, parsed = written(
        lambda r, path: replay_page(r, path),
        tmp_path,
        [replay(log, reference=False), replay(log, estimator="coulomb", variance=False)],
    )
    block = json.loads(parsed.scripts[0][1])
    assert block["replays"][0]["soc_rmse"] is None
    assert block["replays"][1]["nis_mean"] is None


def test_log_with_missing_values_and_gaps(tmp_path):
    log = drive()
    voltage = log.voltage_V.copy()
    voltage[100:200] = np.nan
    time = log.time_s + np.where(log.time_s > 600, 50_000.0, 0.0)
    log = replace(log, voltage_V=voltage, time_s=time)
    sims = [simulation(log)]
    _, parsed = written(lambda s, path: replay_page([replay(log)], path, s), tmp_path, sims)
    assert parsed.ids


@pytest.mark.usefixtures("undrawn")
def test_pages_of_five_rows_are_written(tmp_path):
    log = hppc().part(0, 5)
    written(lambda s, path: replay_page([replay(log)], path, s), tmp_path, [simulation(log)])


def test_a_page_without_a_replay_is_refused(tmp_path):
    with pytest.raises(InputError, match="no replay"):
        replay_page([], tmp_path / "page.html")


def test_equal_data_give_equal_pictures(laboratory):
    first, second = (inline(pulse_pictures(laboratory)[0]) for _ in range(2))
    assert first == second


def test_missing_matplotlib_says_what_to_install(tmp_path, monkeypatch, laboratory):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match="pip install 'matplotlib>="):
        identify_page(laboratory, tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_settings_of_others_are_left_alone(laboratory):
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        before = dict(matplotlib.rcParams)
        inline(pulse_pictures(laboratory)[0])
        assert dict(matplotlib.rcParams) == before


@pytest.mark.usefixtures("undrawn")
def test_pictures_are_saved_beside_the_page(tmp_path):
    folder = tmp_path / "figures"
    replay_page([replay(drive())], tmp_path / "page.html", figures=folder)
    assert {p.name for p in folder.iterdir()} == {
        "replay-1-ekf-drive.png",
        "replay-1-ekf-drive.svg",
    }


@pytest.mark.usefixtures("undrawn")
def test_unwritable_page_is_refused(tmp_path):
    with pytest.raises(InputError, match="no folder"):
        replay_page([replay(drive(60))], tmp_path / "no such folder" / "page.html")


def test_json_values_are_finite():
    assert finite({"a": [float("nan"), 1, True, None, "x", np.float64(2.5)]}) == {
        "a": [None, 1, True, None, "x", 2.5]
    }


def test_table_marks_its_row_and_escapes():
    text = table(("<a>", "b"), [("x & y", 1), ("z", 2)], marked=1)
    assert "&lt;a&gt;" in text
    assert "x &amp; y" in text
    assert text.index('class="marked"') > text.index("x &amp; y")


def test_an_empty_section_is_left_out():
    sections = [Section("k", "t", (EMPTY,)), Section("m", "u", (Markup("<p>v</p>"),))]
    parsed = Page(page_text("f 1", "a", sections, {}, EMPTY))
    assert "k" not in parsed.ids
    assert "m" in parsed.ids
