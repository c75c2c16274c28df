"""An installation that nobody can write to, and a home neither: commands run without a cache."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import cellwise
from cellwise.files import embedded_folder

SIMULATE = ("simulate", "--model", "nmc-18650", "--soc0", "0.9", "--json")
SAID = "no place to keep compiled kernels"


def unprivileged():
    """What takes root's right to write anywhere from a command; empty for other users."""
    if os.name != "posix":
        pytest.skip("permissions of POSIX")
    if os.geteuid() != 0:
        return []
    if shutil.which("setpriv") is None:
        pytest.skip("root may write anywhere, and there is no setpriv")
    return ["setpriv", "--bounding-set=-all", "--inh-caps=-all"]


@pytest.fixture(scope="module")
def installation(tmp_path_factory):
    """The package as a wheel lays it out, read-only, without anything compiled."""
    site = tmp_path_factory.mktemp("site")
    package = site / "cellwise"
    without = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(cellwise.__file__).parent, package, ignore=without)
    shutil.copytree(embedded_folder(), package / "_datasets", ignore=without, dirs_exist_ok=True)
    shutil.copytree(
        Path(__file__).parents[3] / "firmware_ref",
        package / "_firmware",
        ignore=without,
        dirs_exist_ok=True,
    )
    for path in (*site.rglob("*"), site):
        path.chmod(0o555 if path.is_dir() else 0o444)
    yield site
    for path in (site, *site.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)


def run(installation, *arguments, cwd):
    kept = {k: v for k, v in os.environ.items() if k in ("PATH", "LANG", "TMPDIR")}
    environment = kept | {"PYTHONPATH": str(installation), "HOME": str(installation)}
    return subprocess.run(
        [*unprivileged(), sys.executable, "-m", "cellwise", *arguments],
        env=environment, cwd=cwd, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip


@pytest.mark.slow
def test_a_read_only_installation_without_a_home_runs(installation, tmp_path):
    probe = [*unprivileged(), sys.executable, "-c", "open('probe', 'w')"]
    refused = subprocess.run(probe, cwd=installation, capture_output=True, text=True, check=False)
    assert "PermissionError" in refused.stderr  # else nothing is tested here
    log = installation / "cellwise" / "_datasets" / "nmc" / "drive_b.parquet"
    done = run(installation, *SIMULATE, str(log), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert '"rmse_V"' in done.stdout
    assert done.stderr.count(SAID) == 1
    assert "Traceback" not in done.stderr
    assert "internal error" not in done.stderr
    assert not [p for p in installation.rglob("*") if p.suffix in (".nbi", ".nbc", ".pyc")]
