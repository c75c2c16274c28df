"""Pictures and plots: axes with units, titles with numbers, files of every kind, values."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.report.demo_page import demo_sections
from cellwise.report.identification.page import identify_sections
from cellwise.report.identification.parameter_section import pulse_values, table_error
from cellwise.report.identification.simulation_section import simulation_blocks
from cellwise.report.page.markup import MOST
from cellwise.report.page.picture import save_figure, save_figures
from cellwise.report.page.plot import Plot, robust_limits, worst_part
from cellwise.report.page.section import pictures_of
from cellwise.report.page.style import VERDICTS
from report_cases import (
    R0_ERROR,
    R1_ERROR,
    TAU1_ERROR,
    drive,
    identification,
    replay,
    simulation,
)

UNIT = re.compile(r"\[.+\]$")


@pytest.fixture(scope="module")
def laboratory():
    return identification()


@pytest.fixture(scope="module")
def pictures(laboratory):
    log = drive()
    replays = [replay(log), replay(log, estimator="coulomb", forget_s=1e9)]
    return pictures_of(demo_sections(laboratory, [simulation(log)], replays))


def test_every_axis_has_its_unit(pictures):
    for picture in pictures:
        axes = picture.figure.axes
        for one in axes:
            assert UNIT.search(one.get_ylabel()), (picture.key, one.get_ylabel())
        assert UNIT.search(axes[-1].get_xlabel()), picture.key


def test_every_picture_has_a_title_with_a_number_and_a_key_of_its_own(pictures):
    for picture in pictures:
        titles = [axes.get_title(loc="left") for axes in picture.figure.axes]
        assert any(re.search(r"\d", title) for title in titles), picture.key
    keys = [p.key for p in pictures]
    assert len(keys) == len(set(keys))
    assert all(re.fullmatch(r"[a-z0-9-]+", key) for key in keys)


def test_figures_are_written_as_png_svg_and_pdf(tmp_path, pictures):
    for one in (pictures[0], pictures[-1]):  # a plot over time, a picture
        figure = one.figure
        assert save_figure(figure, tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
        root = ElementTree.fromstring(save_figure(figure, tmp_path / "a.svg").read_text())
        assert root.tag.endswith("svg")
        assert save_figure(figure, tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    assert isinstance(pictures[0], Plot) != isinstance(pictures[-1], Plot)
    with pytest.raises(InputError, match="png"):
        save_figure(figure, tmp_path / "a.bmp")


def test_figures_go_to_a_new_folder_and_not_into_a_file(tmp_path, pictures):
    made = save_figures(pictures[-1:], tmp_path / "new" / "folder", (".png",))
    assert [path.stem for path in made] == [pictures[-1].key]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="folder"):
        save_figures(pictures[:1], tmp_path / "file")


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
    keys = [b.key for b in simulation_blocks(sims) if isinstance(b, Plot)]
    assert len(keys) == MOST.plots
    assert keys[0].startswith(f"simulation-{13 - MOST.plots}-")  # the least of the worst


def test_the_worst_minutes_are_those_of_a_burst():
    log = drive(10_000)
    error = np.full(len(log), 0.001)
    error[7000:7050] = 0.1
    part = worst_part(log, error)
    assert part.start < 7000 < 7050 < part.stop
    assert abs(0.5 * (part.start + part.stop) - 7025) < 130
    assert worst_part(log, error, log.time_s < 5000).stop < 7000


def test_one_outlier_does_not_set_the_axis():
    values = np.concatenate((np.sin(np.arange(5000.0)), [40.0]))
    low, high = robust_limits(values)
    assert 1.0 < high == -low < 3.0
    assert robust_limits(values[:-1]) is None
    assert robust_limits(np.array([np.nan, np.nan])) is None
