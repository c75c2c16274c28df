"""A frozen suite knows its logs by content, runs anyone's filter, and gives its row."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import leaderboard as tool

from cellwise import list_datasets, load_dataset
from cellwise.benchmark.known_logs import differs, find_known, known_log
from cellwise.benchmark.leaderboard import leaderboard, parts_of
from cellwise.benchmark.run_suite import run_suite
from cellwise.benchmark.standings import COLUMNS, standings
from cellwise.benchmark.suite import read_suite, shipped_suites, with_estimators
from cellwise.cell.model_file import write_model
from cellwise.cli import main
from cellwise.data import datasets_folder, list_originals
from cellwise.errors import InputError
from cellwise.logs import read_log, write_log
from example_cells import curved_cell

SUITE = """
frozen = 1
estimators = ["ekf"]
start_errors = [0.0, -0.2]
faults = ["drop-outs"]
dt_s = 120.0
[slow]
dt_s = 600.0
start_errors = [-0.2]
faults = ["none"]
[[cell]]
name = "cell"
model = "cell.json"
[[log]]
cell = "cell"
log = "embedded:nmc_drive_b"
[[log]]
cell = "cell"
log = "embedded:nmc_drive_b"
from_soc = 0.6
"""
ADAPTER = '''
class Net:
    """Any function of the sample and its own past may stand here."""

    def __init__(self, model):
        self.ampere_seconds = 3600.0 * model.capacity_Ah

    def start(self, soc0, soc0_std):
        self.soc = soc0

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        if current_A == current_A:
            self.soc -= current_A * dt_s / self.ampere_seconds
        return self.soc
'''


@pytest.fixture(scope="module")
def suite_file(tmp_path_factory):
    """A small frozen suite on embedded data."""
    folder = tmp_path_factory.mktemp("suite")
    entry = next(e for e in list_datasets() if e["name"] == "nmc_drive_b")
    cell = replace(curved_cell(), capacity_Ah=float(entry["true_capacity_Ah"]))
    write_model(cell, folder / "cell.json")
    (folder / "net.py").write_text(ADAPTER)
    file = datasets_folder() / entry["file"]
    known = vars(known_log("embedded:nmc_drive_b", file, "nmc"))
    tables = "\n".join(f"{k} = {json.dumps(v)}" for k, v in known.items())
    (folder / "small.toml").write_text(f"{SUITE}\n[[data]]\n{tables}\n")
    return folder / "small.toml"


@pytest.fixture(scope="module")
def result(suite_file, tmp_path_factory):
    suite = with_estimators(read_suite(suite_file), ("net.py:Net",))
    out = tmp_path_factory.mktemp("out")
    run_suite(suite, out, page=False)
    return out


def test_the_row_says_who_what_and_with_what(result, suite_file):
    found = json.loads((result / "leaderboard.json").read_text())
    assert found["suite_sha256"] == read_suite(suite_file).sha256
    assert found["data"] == "the suite's own files"
    assert len(found["adapters"]["Net"]) == 64
    assert "numpy" in found["made_with"]
    assert isinstance(found["seed"], int)
    rows = {row["estimator"]: row for row in found["rows"]}
    assert {"Net", "ekf", "coulomb"} <= set(rows)
    assert "filterpy-ekf" not in rows  # fewer runs
    # Counting is only as good as its start.
    stand = {s.estimator: s for s in standings({n: row["runs"] for n, row in rows.items()})}
    net, ekf = stand["Net"], stand["ekf"]
    assert net.easy < 0.05 < net.wrong_start
    assert net.easy == pytest.approx(stand["coulomb"].easy, abs=0.01)
    assert (net.failed, ekf.against) == (0, None)
    assert net.against[0] > 0.0


def test_the_table_of_every_run_says_seed_and_versions(result):
    head, first, *_ = (result / "results.csv").read_text().splitlines()
    assert head.endswith("seed,made_with")
    assert "cellwise" in first


def test_a_row_is_added_and_printed_in_order(result, tmp_path, monkeypatch):
    small = replace(read_suite(suite_of(result)), name="small")
    monkeypatch.setattr(tool, "read_suite", lambda name: small)
    kept = tmp_path / "leaderboard"
    for only in ("Net", "ekf"):
        (path,) = tool.add(result / "leaderboard.json", "a person", "counts", only, kept)
        assert path.stem == only
    page = tool.printed(f"before {tool.BEGIN} old {tool.END} after", kept)
    assert page.startswith("before")
    assert page.endswith("after")
    assert " old " not in page
    # Counting from a wrong start comes last.
    assert page.index("| ekf |") < page.index("| Net |")
    assert "a person" in page
    assert tool.printed(page, kept) == page


def suite_of(result):
    sha = json.loads((result / "leaderboard.json").read_text())["suite_sha256"]
    return next(p for p in result.parent.glob("suite*/small.toml") if read_suite(p).sha256 == sha)


def run_of(log, figure, **more):
    return {
        "fault": "none", "start_error": -0.3, "soc0_true": 0.6, "dt_s": 1.0, "problem": "",
        "log": log, "settled_rmse": figure, "settled_max": figure, "soc_final_error": figure,
        "convergence_s": 60.0, "coverage_2sigma": 1.0, "interval_score": 0.1, "band_width": 0.1,
        "ns_per_step": 1.0, "easy": False, "quick": False, **more,
    }  # fmt: skip


def test_an_estimator_that_fails_somewhere_has_no_figure_over_all():
    rows = [run_of(log, 0.01, estimator="ekf") for log in "ab"]
    rows += [run_of("a", 0.01, estimator="mine")]
    rows += [run_of("b", float("nan"), estimator="mine", problem="out of ideas")]
    found = leaderboard("suite", "0" * 64, rows)
    stand = {s.estimator: s for s in standings({r["estimator"]: r["runs"] for r in found["rows"]})}
    assert (stand["ekf"].rank, stand["mine"].rank, stand["mine"].failed) == (1, None, 1)
    assert COLUMNS["hard runs"](stand["mine"]) == "-"


def test_ranks_are_as_sure_as_the_logs_make_them():
    """Better on every log is better in every draw; better on one of two halves is neither."""
    logs = "abcdefgh"
    rows = {
        "best": [run_of(g, 0.01) for g in logs],
        "even": [run_of(g, 0.02 if k % 2 else 0.04) for k, g in enumerate(logs)],
        "odd": [run_of(g, 0.0401 if k % 2 else 0.02) for k, g in enumerate(logs)],
        "fails late": [run_of(g, 0.001) for g in logs[:-1]],
    }
    # Easy runs have no part in it.
    for name, figure in (("best", 0.5), ("even", 0.0), ("odd", 0.0), ("fails late", 0.0)):
        rows[name].append(run_of("a", figure, start_error=0.0, easy=True))
    found = standings(rows)
    assert [(s.estimator, s.rank) for s in found] == [("best", 1), ("even", 2), ("odd", 3)]
    assert (found[0].low, found[0].high) == (1, 1)
    assert [(s.low, s.high) for s in found[1:]] == [(2, 3), (2, 3)]
    assert found[0].hard == pytest.approx(0.01)
    assert found[0].easy == pytest.approx(0.5)


def test_logs_count_once_however_many_runs_they_have():
    few = [run_of("a", 0.02), *(run_of("b", 0.0, fault=f"{k}") for k in range(9))]
    (only,) = standings({"mine": few})
    assert only.hard == pytest.approx(0.01)


def test_a_row_from_elsewhere_is_checked_and_drawn_in(result, tmp_path, capsys):
    for name in ("leaderboard.json", "results.csv"):
        shutil.copy(result / name, tmp_path / name)
    found = json.loads((tmp_path / "leaderboard.json").read_text())
    row = next(r for r in found.pop("rows") if r["estimator"] == "Net")
    row["estimator"], place = "Theirs", tmp_path / "row.json"
    submit = ["benchmark", "submit", str(place), "-o", str(tmp_path), "--no-page"]
    place.write_text(json.dumps({**found, "by": "somebody", "row": row}))
    assert main([*submit, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["submitted"] == ["Theirs"]
    table = (tmp_path / "leaderboard.md").read_text()
    assert "| Theirs |" in table
    assert "somebody" in table
    wrong = {
        "suite_sha256": {**found, "suite_sha256": "0" * 64, "row": row},
        "not the suite's": {**found, "row": {**row, "runs": row["runs"][1:]}},
        "no 'made_with'": {k: v for k, v in {**found, "row": row}.items() if k != "made_with"},
        "a fraction": {**found, "row": {**row, "runs": [{**row["runs"][0], "settled_rmse": 3.0}]}},
    }
    before = (tmp_path / "leaderboard.json").read_bytes()
    for said, text in wrong.items():
        place.write_text(json.dumps(text))
        assert main(submit) == 2
        assert said in capsys.readouterr().err
    assert (tmp_path / "leaderboard.json").read_bytes() == before


def test_training_and_test_logs_cannot_be_mixed_up(suite_file, tmp_path):
    """A judged log among the tests of any cell is refused, whatever either is called."""
    text = suite_file.read_text()
    known = text[text.index("[[data]]") :].replace("embedded:nmc_drive_b", "copied.csv", 1)
    cell = '[[cell]]\nname = "another"\ndrive = ["copied.csv"]\n'
    (tmp_path / "mixed.toml").write_text(f"{text}\n{cell}\n{known}")
    with pytest.raises(InputError, match="test of a cell too"):
        read_suite(tmp_path / "mixed.toml")


def test_a_log_is_known_by_what_it_holds(tmp_path):
    log = load_dataset("nmc_drive_b")
    path = write_log(log, tmp_path / "drive.csv")
    known = known_log("cell/drive.csv", path, "nmc")
    assert find_known(known, (path,), None) == (path, True)
    rounded = replace(log, voltage_V=np.round(log.voltage_V, 4)).rows(np.arange(len(log)) != 100)
    (tmp_path / "data" / "nmc").mkdir(parents=True)
    copy = write_log(rounded, tmp_path / "data" / "nmc" / "anything.parquet")
    catalogue = tmp_path / "data" / "nmc" / "catalogue.toml"
    catalogue.write_text(
        f'[[dataset]]\nname = "x"\nfile = "anything.parquet"\nrows = {len(rounded)}\n'
        f"duration_s = {rounded.duration_s}\n"
    )
    gone = (tmp_path / "none",)
    assert find_known(known, gone, tmp_path / "data") == (copy, False)
    other = replace(log, voltage_V=log.voltage_V + 0.01)
    assert "lowest" in differs(known, other)
    assert "throughput" in differs(known, replace(log, current_A=1.01 * log.current_A))
    assert "rows" in differs(known, log.part(0, len(log) // 2))
    write_log(other, path)
    with pytest.raises(InputError, match="frozen with"):
        find_known(known, (path,), None)
    with pytest.raises(InputError, match="cellwise data fetch nmc"):
        find_known(known, gone, None)


def test_a_frozen_suite_needs_to_know_every_log(suite_file, tmp_path):
    text = suite_file.read_text().partition("[[data]]")[0]
    write_model(curved_cell(), tmp_path / "cell.json")
    (tmp_path / "open.toml").write_text(text)
    with pytest.raises(InputError, match=r"without \[\[data\]\]"):
        read_suite(tmp_path / "open.toml")


def test_the_page_is_what_the_kept_rows_say():
    assert tool.main(["print", "--check"]) == 0
    for folder in (tool.DOCS / "leaderboard").iterdir():
        suite = read_suite(folder.name)
        assert suite.frozen
        for path in folder.glob("*.json"):
            assert json.loads(path.read_text())["suite_sha256"] == suite.sha256, path.name


def test_frozen_suites_have_public_logs_only():
    originals = {o["name"] for o in list_originals()}
    frozen = [read_suite(n) for n in shipped_suites() if read_suite(n).frozen]
    assert frozen
    for suite in frozen:
        assert {one.original for one in suite.data} <= originals
        assert any(log.from_soc for log in suite.logs)
        assert suite.faults


@pytest.mark.slow
@pytest.mark.parametrize(
    ("original", "converted"),
    [
        ("native/digatron_panasonic_c20_25degC.mat", "panasonic_18650pf/ocv_c20_p25.csv.gz"),
        ("native/arbin_a123_ocv_p25_s1.csv", "plett_a123/ocv_p25_s1.csv.gz"),
    ],
)
def test_an_original_is_known_as_what_it_was_converted_to(real_data, original, converted):
    known = known_log(converted, real_data / converted)
    assert differs(known, read_log(real_data / original)) is None


def test_a_quick_cut_alone_is_not_called_the_whole_suite():
    row = json.loads(
        (
            Path(tool.__file__).parents[1] / "docs" / "leaderboard" / "public-1" / "ekf.json"
        ).read_text(encoding="utf-8")
    )
    entry = {"row": row.get("row", row), "made_with": ""}
    whole = [part.title.partition(":")[0] for part in parts_of([entry])]
    quick = {**entry["row"], "runs": [r for r in entry["row"]["runs"] if r["quick"]]}
    alone = [part.title.partition(":")[0] for part in parts_of([{**entry, "row": quick}])]
    assert (whole, alone) == (["Whole suite", "Quick cut"], ["Quick cut"])
