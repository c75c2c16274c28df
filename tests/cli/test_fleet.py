"""cellwise fleet as a program."""

from __future__ import annotations

import shutil

import pytest

from cellwise.data import datasets_folder

pytest.importorskip("distributed")


@pytest.fixture
def logs(tmp_path):
    place = tmp_path / "logs"
    place.mkdir()
    for name in ("drive_a", "drive_b"):
        shutil.copy(datasets_folder() / "nmc" / f"{name}.parquet", place)
    (place / "broken.parquet").write_bytes(b"PAR1 and nothing more")
    return place


def test_fleet_replay_prints_one_object_and_resumes(model, logs, tmp_path, run_json):
    more = (str(logs), "-o", str(tmp_path / "out"), "--scheduler", "local", "--workers", "1",
            "--cache", str(tmp_path / "cache"))  # fmt: skip
    found = run_json("fleet", "replay", "--model", model, *more)
    assert (found["logs"], found["done"], found["failed"], found["resumed"]) == (3, 3, 1, 0)
    found = run_json("fleet", "replay", "--model", model, *more)
    assert (found["done"], found["resumed"]) == (0, 3)
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(tmp_path / "out").to_pydict()
    assert sorted(table["log"]) == ["broken.parquet", "drive_a.parquet", "drive_b.parquet"]
    whole = run_json("replay", "--model", model, str(logs / "drive_b.parquet"))
    at = table["log"].index("drive_b.parquet")
    assert table["soc_final"][at] == pytest.approx(whole["soc_final"], abs=1e-9)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_no_answer_at_an_address_is_refused(model, logs, tmp_path, refused):
    out = ("-o", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:9")
    assert "no scheduler" in refused("fleet", "replay", "--model", model, str(logs), *out)
    assert not list((tmp_path / "out").glob("part*"))
