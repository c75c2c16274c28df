"""What is stated behind a log's path: read in one place, believed everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise import CellLog, InputError, Stated, read_log, write_log
from cellwise.logs.cell_log import resample
from cellwise.notices import Code, Notice


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.csv", ("a.csv", None, None)),
        ("a.csv@25", ("a.csv", 25.0, None)),
        ("a.csv@-10", ("a.csv", -10.0, None)),
        ("a.csv@-7.5C", ("a.csv", -7.5, None)),
        ("a.csv@soc0=1", ("a.csv", None, 1.0)),
        ("a.csv@soc0=0", ("a.csv", None, 0.0)),
        ("a.csv@temperature_C=-20,soc0=0.5", ("a.csv", -20.0, 0.5)),
        ("a.csv@soc0=0.5, temperature_C=-20", ("a.csv", -20.0, 0.5)),
        ("a.csv@-20,soc0=1", ("a.csv", -20.0, 1.0)),
        ("me@work/a.csv", ("me@work/a.csv", None, None)),
        ("me@work/a.csv@40", ("me@work/a.csv", 40.0, None)),
    ],
)
def test_what_stands_behind_a_path(text, expected):
    found = Stated.parse(text)
    assert (found.path, found.temperature_C, found.soc0) == expected


@pytest.mark.parametrize(
    "text",
    [
        "a.csv@", "a.csv@hot", "a.csv@298", "a.csv@-300", "a.csv@nan", "a.csv@soc0=",
        "a.csv@soc0=1.2", "a.csv@soc0=-0.1", "a.csv@soc0=nan", "a.csv@soc0=inf",
        "a.csv@soc=1", "a.csv@temperature=-20", "a.csv@soc0=1,soc0=1", "a.csv@-20,-10", "@soc0=1",
        "a.csv@soc0=1,", "a.csv@soc0=1;temperature_C=0",
    ],
)  # fmt: skip
def test_what_cannot_be_stated(text):
    with pytest.raises(InputError):
        Stated.parse(text)


def test_a_stated_soc_in_per_cent_is_refused():
    with pytest.raises(InputError, match="Divide by 100"):
        Stated.parse("a.csv@soc0=95")


def test_a_file_whose_name_has_an_at_stays_whole(tmp_path):
    path = tmp_path / "cell@25.csv"
    path.touch()
    assert Stated.parse(str(path)) == Stated(str(path))
    assert Stated.parse(f"{path}@10") == Stated(str(path), 10.0)


@pytest.fixture
def drive() -> CellLog:
    time = np.arange(0.0, 60.0)
    return CellLog(time, np.ones(60), np.linspace(4.1, 4.0, 60), name="drive")


@pytest.fixture
def path(drive, tmp_path) -> str:
    return str(write_log(drive, tmp_path / "drive.csv"))


def test_read_log_takes_a_string_or_the_record(path):
    for given in (f"{path}@-20,soc0=0.9", Stated(path, -20.0, 0.9)):
        log = read_log(given)
        assert log.soc0 == 0.9
        np.testing.assert_array_equal(log.temperature_C, np.full(len(log), -20.0))
    assert read_log(path).soc0 is None


def test_a_measured_temperature_stays_and_a_contradiction_is_the_first_notice(drive):
    warm = replace(drive, temperature_C=np.full(60, 24.0), notices=(Notice(Code.GAP, "a gap"),))
    near = Stated("drive.csv", 25.0).applied(warm)
    assert near.notices == warm.notices
    far = Stated("drive.csv", -20.0).applied(warm)
    np.testing.assert_array_equal(far.temperature_C, warm.temperature_C)
    assert "-20 degC" in far.notices[0].text
    assert "24.0 degC" in far.notices[0].text
    assert far.notices[1:] == warm.notices


def test_the_start_belongs_to_the_first_row(drive):
    log = replace(drive, soc0=0.8)
    assert log.part(0, 20).soc0 == 0.8
    assert log.part(10, 20).soc0 is None
    assert log.rows(np.arange(60) > 5).soc0 is None
    assert log.rows(np.arange(60) < 5).soc0 == 0.8
    assert resample(log, 2.0).soc0 == 0.8
