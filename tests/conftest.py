"""Shared fixtures: where the measured data are, and what is skipped without them."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import tempfile
from itertools import chain
from pathlib import Path

import pytest
from hypothesis import settings

# The first call of a kernel compiles it, which is no property of the example.
settings.register_profile("compiled", deadline=None, derandomize=True)
settings.load_profile("compiled")
# As `make test` runs them.
settings.register_profile("quick", settings.get_profile("compiled"), max_examples=25)
REPOSITORY = Path(__file__).resolve().parents[1]
FUZZ_SEED = "CELLWISE_FUZZ_SEED"
KEPT = "CELLWISE_TESTS_KEPT"  # a folder of what all workers of a run need
KERNEL = re.compile(r"^ *@(?:inline|kernel|rows|cached)\b|^from numba\b", re.MULTILINE)
IMPORTED = re.compile(r"^ *from (cellwise[.\w]*) import", re.MULTILINE)


def pytest_configure(config: pytest.Config) -> None:
    """No compiled code of an older source: numba's cache does not see what a kernel inlines."""
    os.environ.setdefault("CELLWISE_QUIET", "1")
    # Fresh in every run and the same in all its workers, which inherit the environment.
    os.environ.setdefault(FUZZ_SEED, str(secrets.randbelow(2**32)))
    if hasattr(config, "workerinput"):
        return
    os.environ[KEPT] = tempfile.mkdtemp(prefix="cellwise_tests_")
    config.add_cleanup(lambda: shutil.rmtree(os.environ[KEPT], ignore_errors=True))
    package = REPOSITORY / "src" / "cellwise"
    sources = [path.stat().st_mtime for path in compiled_sources(package)]
    caches = [*chain(package.rglob("*.nbi"), package.rglob("*.nbc"))]
    if caches and min(path.stat().st_mtime for path in caches) < max(sources):
        for path in caches:
            path.unlink(missing_ok=True)


def compiled_sources(package: Path) -> set[Path]:
    """Files with kernels and all that these import: what compiled code is made of."""
    text = {path: path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    waiting = [path for path, source in text.items() if KERNEL.search(source)]
    found = set(waiting)
    while waiting:
        for module in IMPORTED.findall(text[waiting.pop()]):
            place = package.parent / module.replace(".", "/")
            for path in (place.with_suffix(".py"), place / "__init__.py"):
                if path in text and path not in found:
                    found.add(path)
                    waiting.append(path)
    return found


def pytest_report_header() -> str:
    return f"mutated files: {FUZZ_SEED}={os.environ[FUZZ_SEED]} runs the same ones again"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Measured cells are long logs: what reads them is slow."""
    for item in items:
        if "real_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


def measured_data_folder() -> Path | None:
    """Folder with the measured cells: $CELLWISE_DATA, else ../shared/data beside the project."""
    named = os.environ.get("CELLWISE_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    return folder if folder.is_dir() else None


@pytest.fixture(scope="session")
def real_data() -> Path:
    folder = measured_data_folder()
    if folder is None:
        pytest.skip("no measured cells: set CELLWISE_DATA to the folder that holds them")
    return folder


@pytest.fixture(scope="session")
def datasets() -> Path:
    return REPOSITORY / "datasets"


@pytest.fixture
def drawn(monkeypatch):
    """Every picture and plot that a page takes in."""
    from cellwise.report.page.markup import Markup

    taken = []

    def take(picture):
        taken.append(picture)
        return Markup("<figure id='f'></figure>")

    for how in ("inline", "trace"):
        monkeypatch.setattr(f"cellwise.report.page.section.{how}", take)
    return taken
