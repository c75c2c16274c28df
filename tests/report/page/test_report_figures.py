"""Pictures: axes with units, titles with numbers, files of every kind, values as computed."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.report import Picture, figure_png, hero_figure, save_figure, save_figures
from cellwise.report.demo_page import demo_sections
from cellwise.report.identification.page import identify_sections
from cellwise.report.identification.parameter_section import pulse_values, table_error
from cellwise.report.identification.simulation_section import simulation_pictures
from cellwise.report.page.markup import MOST
from cellwise.report.page.section import pictures_of
from cellwise.report.page.style import VERDICTS
from cellwise.report.page.traces import robust_limit, worst_window
from cellwise.report.replay.page import replay_sections
from report_cases import (
    R0_ERROR,
    R1_ERROR,
    TAU1_ERROR,
    drive,
    identification,
    replay,
    simulation,
)

UNIT = re.compile(r"\[.+\]$|, \+ discharge$")
WORDS = {"choice"}


@pytest.fixture(scope="module")
def laboratory():
    return identification()


@pytest.fixture(scope="module")
def pictures(laboratory):
    log = drive()
    replays = [replay(log), replay(log, estimator="coulomb", forget_s=1e9)]
    sims = [simulation(log)]
    return [
        *pictures_of(identify_sections(laboratory)),
        *pictures_of(replay_sections(replays, sims)),
        *pictures_of(demo_sections(laboratory, sims, replays)),
    ]


def visible(axes):
    return axes.axison


def test_every_axis_has_its_unit(pictures):
    for picture in pictures:
        for axes in filter(visible, picture.figure.axes):
            y = axes.get_ylabel()
            assert UNIT.search(y) or y in WORDS, (picture.key, y)
            x = axes.get_xlabel()
            # Without a label the axis is that of the panel below, and shows no numbers.
            assert UNIT.search(x) or (x == "" and not axes.xaxis.get_tick_params()["labelbottom"])


def test_every_picture_has_a_title_with_a_number_and_a_caption(pictures):
    for picture in pictures:
        titles = [axes.get_title(loc="left") for axes in picture.figure.axes]
        assert any(re.search(r"\d", title) for title in titles), picture.key
        assert len(picture.caption) > 60


def test_keys_are_unique_and_plain(pictures, laboratory):
    keys = [p.key for p in pictures_of(demo_sections(laboratory, [], []))]
    assert len(keys) == len(set(keys))
    assert all(re.fullmatch(r"[a-z0-9-]+", p.key) for p in pictures)


def test_files_of_every_kind(tmp_path, pictures):
    figure = pictures[0].figure
    assert save_figure(figure, tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    root = ElementTree.fromstring(save_figure(figure, tmp_path / "a.svg").read_text())
    assert root.tag.endswith("svg")
    assert save_figure(figure, tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(InputError, match="png"):
        save_figure(figure, tmp_path / "a.bmp")


def test_folder_of_figures(tmp_path, pictures):
    made = save_figures(pictures[:1], tmp_path / "new" / "folder", (".png",))
    assert [path.name for path in made] == ["ocv.png"]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="folder"):
        save_figures(pictures[:1], tmp_path / "file")


def test_png_has_the_asked_resolution(pictures):
    data = figure_png(pictures[0].figure, dpi=50)
    assert int.from_bytes(data[16:20], "big") == 500  # ten inches


def test_hero_figure(tmp_path, laboratory):
    log = drive()
    path = hero_figure(laboratory, simulation(log), replay(log), tmp_path / "hero.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    hero_figure(laboratory, simulation(log), replay(log, reference=False), tmp_path / "hero.svg")


def test_pulses_are_drawn_at_their_soc_and_current(laboratory):
    picture = next(p for p in pictures_of(identify_sections(laboratory)) if p.key == "pulses")
    lines = {line.get_label().split(" ")[0]: line for line in picture.figure.axes[0].lines}
    found = laboratory.temperatures[0].pulse_sets[0]
    charge = found.log.counted_charge_Ah()
    for quality in VERDICTS:
        mine = [p for p in found.pulses if p.role == "pulse" and p.quality == quality]
        x, y = lines[quality].get_data()
        np.testing.assert_allclose(x, [100 - 100 * charge[p.start - 1] / 3.0 for p in mine])
        np.testing.assert_allclose(y, [p.current_A for p in mine])
    assert lines["move"].get_xdata().size == 5


def test_error_bands_are_the_refinements(laboratory):
    found, soc = laboratory.temperatures[0], np.linspace(0, 1, 7)
    np.testing.assert_allclose(table_error(found, "r0_ohm", soc), R0_ERROR)
    np.testing.assert_allclose(table_error(found, "tau1_s", soc), TAU1_ERROR)
    np.testing.assert_allclose(table_error(found, "r1_ohm", soc), R1_ERROR)
    assert table_error(found, "dc_ohm", soc) is None
    assert table_error(identification(refined=False).temperatures[0], "r0_ohm", soc) is None


def test_values_of_pulses_and_what_they_show(laboratory):
    tau1 = pulse_values(laboratory.temperatures[0], "tau1_s")
    np.testing.assert_allclose(tau1.value, 4.5)
    np.testing.assert_allclose(tau1.error, 0.3)
    assert tau1.known.all()
    # An error of 40 s on 95 s is more than what counts as known.
    assert not pulse_values(laboratory.temperatures[0], "tau2_s").known.any()
    assert pulse_values(laboratory.temperatures[0], "r3_ohm") is None
    segments = identification(method="segments").temperatures[0]
    assert pulse_values(segments, "tau2_s").known.all()


def test_of_very_many_logs_the_worst_are_shown():
    log = drive(60)
    sims = [simulation(log, np.full(60, 0.001 * (k % 12))) for k in range(12)]
    keys = [p.key for p in simulation_pictures(sims)]
    assert len(keys) == MOST.simulations
    assert keys[0].startswith("simulation-5-")  # 4 mV is the eighth largest


def test_worst_window_finds_a_burst():
    time = np.arange(10_000.0)
    error = np.full(time.size, 0.001)
    error[7000:7050] = 0.1
    start, stop = worst_window(time, error, 300.0)
    assert start < 7000
    assert stop > 7050
    assert abs(0.5 * (start + stop) - 7025) < 5  # in the middle
    start, stop = worst_window(time, error, 300.0, allowed=time < 5000)
    assert stop < 7000


def test_one_outlier_does_not_set_the_axis():
    values = np.concatenate((np.sin(np.arange(5000.0)), [40.0]))
    limit, beyond = robust_limit(values)
    assert beyond
    assert 1.0 < limit < 3.0
    limit, beyond = robust_limit(values[:-1])
    assert not beyond
    assert limit > 1.0
    assert robust_limit(np.array([np.nan, np.nan])) == (1.0, False)


def test_outlier_is_said_in_words():
    log = drive()
    error = 0.001 * np.sin(log.time_s)
    error[50] = -0.4
    figure = simulation_pictures([simulation(log, error)])[0].figure
    said = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert any("−400 mV" in text for text in said)


def test_picture_is_a_plain_record(pictures):
    assert isinstance(pictures[0], Picture)
