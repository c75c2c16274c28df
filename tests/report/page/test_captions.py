"""No caption names what is not drawn, on pages by hand and by the command on measured files."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from cellwise.cli import main
from cellwise.forecast.remaining import forecast
from cellwise.report.identification.page import identify_page
from cellwise.report.page import style
from cellwise.report.replay.page import replay_page
from diagnosis_cases import diagnosis
from page_cases import every_page
from report_cases import drive, identification, model, replay


def artists(figure, kind=object):
    """What is visible within the axes of a figure."""
    shown = (a for axes in figure.axes if axes.axison for a in axes.get_children())
    return [a for a in shown if isinstance(a, kind) and a.get_visible()]


def marked(figure):
    return any(line.get_marker() not in ("None", "", None) for line in artists(figure, Line2D))


def filled(figure):
    kinds = ("PolyCollection", "FillBetweenPolyCollection")
    return any(type(a).__name__ in kinds for a in artists(figure))


def boxed(figure):
    return any(a not in [x.patch for x in figure.axes] for a in artists(figure, Rectangle))


def named(word):
    return lambda figure: any(
        word in text
        for axes in figure.axes
        for text in (axes.get_ylabel(), axes.get_title(loc="left"),
                     *axes.get_legend_handles_labels()[1])
    )  # fmt: skip


# What a caption says, and what must be there.
NEEDED = {
    r"measured voltage|Measured voltage": named("measured"),
    r"predicted": named("predicted"),
    r"residual": named("residual"),
    r"\breference that": named("reference"),
    r"innovation": named("innovation"),
    r"the current\b(?! alone)": named("current"),
    r"simulated SOC": named("SOC"),
    r"(?<!no )\b[Bb]ands?\b": lambda f: filled(f) or boxed(f),
    r"\b[Dd]ots?\b": marked,
    r"\b[Bb]ars?\b": lambda f: boxed(f) or any(artists(f, LineCollection)),
    r"Shaded": boxed,
    r"thin marks": named("move"),
    **{f"{name.capitalize()}:": named(name) for name in style.VERDICTS},
}  # fmt: skip


def untrue(pictures):
    """Key, word of the caption that names what is not there."""
    return [
        (picture.key, word)
        for picture in pictures
        for word, there in NEEDED.items()
        if re.search(word, picture.caption) and not there(picture.figure)
    ]


def test_captions_of_pages_made_by_hand_are_true(drawn, tmp_path):
    every_page(tmp_path, diagnosis("current_offset"))
    every_page(tmp_path, diagnosis())
    identify_page(identification(refined=False), tmp_path / "plain.html")
    run = replay(drive())
    replay_page([run], tmp_path / "f.html", flights=[forecast(model(), run, cutoff_V=2.8)])
    replay_page([replace(run, reference_soc=None)], tmp_path / "r.html")
    assert len({p.key.split("-")[0] for p in drawn}) >= 8
    assert untrue(drawn) == []


def test_the_check_sees_what_is_missing(drawn, tmp_path):
    """A caption of a reference, a residual and of verdicts over a plot of none."""
    replay_page([replace(replay(drive()), reference_soc=None)], tmp_path / "r.html")
    (soc,) = drawn
    said = "The reference that was counted; the residual. Trimmed: cut."
    assert len(untrue([soc._replace(caption=said)])) == 3


@pytest.mark.slow
def test_pages_of_measured_files_by_the_command(drawn, real_data, tmp_path):
    """A flight without a temperature, a stock model's update, a life, a pack, a cold drive."""
    lipo, pages = str(tmp_path / "lipo.json"), iter(range(99))
    flight = str(real_data / "native/ardupilot_dronekit-la_log171.bin")
    warm, cold = (
        str(real_data / f"panasonic_18650pf/drive_{t}_us06.csv.gz") for t in ("p25", "p00")
    )
    life = [str(real_data / f"samsung_30q_ageing/d1_cellA_cycle{k}.csv.gz") for k in ("011", "401")]
    prior = ("--prior", "lipo-pouch", "--nominal-ah", "5.45", "-o", lipo)
    for command in (
        ("identify", "--drive", str(real_data / "lipo_5450/c2_cycle01.csv.gz"), *prior),
        ("replay", "--model", lipo, flight, "--series", "4", "--power"),
        ("history", "--model", "nmc-18650", "--capacity-ah", "3", *life),
        ("pack", "--model", "lmo-pouch", "--capacity-ah", "65",
         str(real_data / "leaf_pack/leaf_20170418.parquet")),
        ("diagnose", "--model", "nmc-18650", "--capacity-ah", "2.9", cold, "--holdout", warm,
         "--cause", "resistance_scale"),
    ):  # fmt: skip
        assert main([*command, "--report", str(tmp_path / f"{next(pages)}.html")]) == 0, command
    keys = " ".join(p.key for p in drawn)
    for kind in ("parameter", "flight", "power", "history", "pack", "before-after"):
        assert kind in keys
    assert untrue(drawn) == []
