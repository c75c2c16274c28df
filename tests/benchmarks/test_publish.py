"""Results of the benchmarks: part by part, kept over a stop, with what broke off left out."""

from __future__ import annotations

import json
import sys
from types import ModuleType

import pytest
from benchmarks import publish
from benchmarks.figures import Figure
from benchmarks.parts import each_case


def figure(value: float) -> Figure:
    return Figure("a cell", "an error", value, "%", headline=True)


def broken() -> list[Figure]:
    raise ValueError("no rows")


def test_a_case_that_breaks_off_costs_only_its_own_rows():
    cases = (("first", lambda: [figure(1.0)]), ("second", broken), ("third", lambda: [figure(3.0)]))
    found = each_case(cases, lambda _: None)
    assert [f.value for f in found] == [1.0, None, 3.0]
    assert [f.failed for f in found] == [False, True, False]
    assert found[1].group == "second"
    assert "no rows" in found[1].note


@pytest.fixture
def parts(monkeypatch, tmp_path):
    """Two parts that count how often they are measured; the second may break off."""
    module = ModuleType("counted_parts")
    module.calls = {"good": 0, "bad": 0}
    module.breaks = True

    def good(data, say):
        module.calls["good"] += 1
        return [figure(1.0)]

    def bad(data, say):
        module.calls["bad"] += 1
        last = broken if module.breaks else lambda: [figure(3.0)]
        return each_case((("kept", lambda: [figure(2.0)]), ("lost", last)), say)

    module.good, module.bad = good, bad
    monkeypatch.setitem(sys.modules, module.__name__, module)
    named = {name: (module.__name__, name, False) for name in ("good", "bad")}
    monkeypatch.setattr(publish, "PARTS", named)
    monkeypatch.setattr(publish, "RESULTS", tmp_path / "accuracy.json")
    monkeypatch.setattr(publish, "print_pages", lambda results: None)
    monkeypatch.setattr(publish, "data_folder", lambda: tmp_path)
    monkeypatch.setattr(publish, "of_this_code", lambda commit: commit == "0123abcd")
    monkeypatch.setattr(publish, "commit_here", lambda: "0123abcd")
    return module


def values() -> list[float | None]:
    return [row["value"] for row in json.loads(publish.RESULTS.read_text())["figures"]]


def test_a_run_goes_on_where_it_broke_off(parts, capsys):
    assert publish.main([]) == 1
    assert "lost: ValueError: no rows" in capsys.readouterr().err
    assert values() == [1.0, 2.0, None]
    parts.breaks = False
    assert publish.main([]) == 0
    assert values() == [1.0, 2.0, 3.0]
    assert parts.calls == {"good": 1, "bad": 2}


def test_what_was_measured_of_other_code_is_measured_again(parts, monkeypatch):
    publish.main(["--only", "good"])
    assert values() == [1.0]
    monkeypatch.setattr(publish, "of_this_code", lambda commit: False)
    publish.main(["--only", "good"])
    publish.main(["--only", "good", "--again"])
    assert parts.calls == {"good": 3, "bad": 0}


def test_every_row_says_part_commit_and_day(parts):
    publish.main([])
    rows = json.loads(publish.RESULTS.read_text())["figures"]
    assert [row["part"] for row in rows] == ["good", "bad", "bad"]
    assert {row["commit"] for row in rows} == {"0123abcd"}
    assert all(row["date"] for row in rows)


def test_from_a_file_measures_nothing(parts):
    publish.main([])
    publish.main(["--from", str(publish.RESULTS)])
    assert parts.calls == {"good": 1, "bad": 1}
