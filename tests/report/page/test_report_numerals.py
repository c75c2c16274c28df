"""Numbers in words: digits, units, minus signs."""

from __future__ import annotations

import pytest

from cellwise.report.page import numerals as n


def plain(text):
    return text.replace("\N{NO-BREAK SPACE}", " ").replace("\N{NARROW NO-BREAK SPACE}", " ")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (123456.7, "123000"),
        (1234.5, "1230"),
        (3.0, "3"),
        (2.9973, "3.00"),
        (-0.01234, "−0.0123"),
        (1e-7, "1.00e−07"),
        (0.0, "0"),
        (float("nan"), "–"),
        (None, "–"),
        (9.999, "10.0"),
    ],
)
def test_three_digits(value, said):
    assert n.significant(value) == said


@pytest.mark.parametrize(
    ("volt", "said"),
    [(0.0089, "8.9 mV"), (0.1234, "123 mV"), (-0.00047, "−0.47 mV"), (float("inf"), "–")],
)
def test_millivolt(volt, said):
    assert plain(n.millivolt(volt)) == said


@pytest.mark.parametrize(
    ("share", "said"), [(0.0026, "0.26 %"), (0.123, "12.3 %"), (1.0, "100 %"), (None, "–")]
)
def test_percent(share, said):
    assert plain(n.percent(share)) == said


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.5, "0.50 s"), (12.0, "12 s"), (230.0, "230 s"), (299.9, "5 min"), (4500.0, "75 min"),
     (16_000.0, "4.4 h"), (None, "–")],
)  # fmt: skip
def test_duration(seconds, said):
    assert plain(n.duration(seconds)) == said


@pytest.mark.parametrize(
    ("times", "said"),
    [((287.0, 30.0, 390.0), "4.8 min (0.5 to 6.5)"), ((5.0, 0.0, 100.0), "5 s (0 to 100)"),
     ((5.0, 5.0, float("nan")), "5 s")],
)  # fmt: skip
def test_a_time_and_its_band_have_one_unit(times, said):
    assert plain(n.duration_between(*times)) == said


def test_units_suit_the_size():
    assert n.ohm_unit(5e-5) == (1e6, "µΩ")
    assert n.ohm_unit(0.02) == (1e3, "mΩ")
    assert n.ohm_unit(3.0) == (1.0, "Ω")
    assert n.time_unit(7201.0) == (3600.0, "h")


def test_words():
    assert n.listed(["a"]) == "a"
    assert n.listed(["a", "b", "c"]) == "a, b and c"
    assert plain(n.plural(1, "log")) == "1 log"
    assert plain(n.plural(2, "log")) == "2 logs"
    assert plain(n.counted(1234567)) == "1 234 567"
    assert plain(n.celsius(-10.0)) == "−10 °C"
    assert plain(n.ampere_hours(0.08, 2.98)) == "0.080 Ah"
    assert plain(n.points(0.997)) == "99.7 %"
