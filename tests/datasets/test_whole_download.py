"""All originals of a frozen suite: from a web server, by their lists, to the suite's own logs."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
import sys

import pytest

from cellwise.benchmark.known_logs import find_known
from cellwise.benchmark.suite import read_suite
from cellwise.cli import main


@pytest.fixture
def served(tmp_path, real_data):
    """Folder and address of a server of the suite's originals, renamed, each with its list."""
    folder = tmp_path / "served"
    for k, known in enumerate(read_suite("public-1").data):
        original, _, _ = known.log.partition("/")
        place = folder / original / f"test {k:02d}.csv.gz"
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(real_data / known.log, place)
        with (place.parent / "SHA256SUMS").open("a") as sums:
            sums.write(f"{hashlib.sha256(place.read_bytes()).hexdigest()}  {place.name}\n")
    command = [sys.executable, "-u", "-m", "http.server", "0", "--bind", "127.0.0.1"]
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as server:
        port = re.search(r"port (\d+)", server.stdout.readline()).group(1)
        yield folder, f"http://127.0.0.1:{port}"
        server.terminate()


@pytest.mark.slow
def test_a_suite_finds_all_its_logs_in_a_whole_download(served, tmp_path, capsys):
    folder, url = served
    originals = sorted(place.name for place in folder.iterdir())
    assert len(originals) == 3
    for name in originals:
        raw, data = tmp_path / "raw" / name, tmp_path / "data" / name
        fetch = ["data", "fetch", name, "-o", str(raw), "--listing", f"{url}/{name}/SHA256SUMS"]
        files = sorted((folder / name).glob("test*"))
        whole = files[-1].read_bytes()
        files[-1].write_bytes(whole[: len(whole) // 2])
        assert main(fetch) == 2
        assert "was not kept" in capsys.readouterr().err
        before = {path.name: path.stat().st_mtime_ns for path in raw.iterdir()}
        assert len(before) == len(files) - 1
        files[-1].write_bytes(whole)
        assert main(fetch) == 0
        after = {path.name: path.stat().st_mtime_ns for path in raw.iterdir()}
        assert len(after) == len(files)
        assert before.items() <= after.items()  # what was whole is not fetched again
        assert main(["data", "import", name, str(raw), "-o", str(data)]) == 0
    for known in read_suite("public-1").data:
        assert not find_known(known, (), tmp_path / "data")[1]  # found, and under another name
