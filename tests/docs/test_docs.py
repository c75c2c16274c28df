"""Every python and console block of the documentation runs.

Blocks of one page run in order, in one namespace and one empty folder. A block under
``<!-- needs data -->`` runs by itself, with $CELLWISE_DATA, where measured data are; one under
``<!-- exits 2 -->`` has commands that end with that code.
"""

from __future__ import annotations

import os
import shutil

import pytest
from doc_blocks import PAGES, page_blocks, page_name

from cellwise.cli import main

RUN = ("python", "console")
# Pages whose blocks run a whole command on whole logs; the tests of the commands run without them.
SLOW = ("README.md", "docs/benchmark.md", "docs/firmware.md", "docs/fleet.md", "docs/howto.md")
SLOW += ("docs/certificate.md", "docs/gallery.md", "docs/live.md", "docs/tutorial.md")
OTHER = ("", "text", "math", "toml", "json", "yaml")


@pytest.fixture(autouse=True)
def _nothing_is_counted(monkeypatch):
    """Instructions of an export: `make firmware` counts them, for minutes, on every core."""
    monkeypatch.setattr("cellwise.export.cross.cores_here", list)


RUNNING = [
    (page, [b for b in page_blocks(page) if b.language in RUN and not b.needs_data])
    for page in PAGES
]
WITH_DATA = [(page, b) for page in PAGES for b in page_blocks(page) if b.needs_data]


def run_block(page, block, namespace):
    if block.language == "python":
        # Blank lines in front: a traceback then names the page's own line.
        source = "\n" * (block.line - 1) + block.text
        exec(compile(source, str(page), "exec"), namespace)
        return
    for arguments in block.commands():
        if arguments[:1] == ["export"] and "--page" in arguments and not shutil.which("wasm-ld"):
            pytest.skip("no wasm-ld: apt-get install clang lld (`make pages` runs it)")
        expanded = [os.path.expandvars(a) for a in arguments]
        try:
            code = main(expanded)
        except SystemExit as stop:  # argparse refuses
            code = stop.code
        where = f"{page_name(page)}, block at line {block.line}: cellwise {' '.join(arguments)}"
        assert code == block.exit_code, where


@pytest.mark.parametrize(
    ("page", "blocks"),
    [
        pytest.param(
            p, b, id=page_name(p), marks=[pytest.mark.slow] if page_name(p) in SLOW else []
        )
        for p, b in RUNNING
        if b
    ],
)
def test_the_blocks_of_a_page_run(page, blocks, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "docs"}
    for block in blocks:
        run_block(page, block, namespace)


@pytest.mark.parametrize(
    ("page", "block"),
    [pytest.param(p, b, id=f"{page_name(p)}:{b.line}") for p, b in WITH_DATA],
)
def test_a_block_on_measured_data_runs(page, block, real_data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CELLWISE_DATA", str(real_data))
    run_block(page, block, {"__name__": "docs"})


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_no_block_escapes_the_tests(page):
    """A block in another language, or a console block without a command, would rot unseen."""
    for block in page_blocks(page):
        assert block.language in (*RUN, *OTHER), f"{page.name}:{block.line} '{block.language}'"
        if block.language == "console":
            said = [line for line in block.text.splitlines() if line.startswith("$ ")]
            assert said, f"{page.name}:{block.line} has no line that begins with '$ '"
        assert block.mark in ("", "needs data") or block.mark.startswith(("exits ", "not run")), (
            f"{page.name}:{block.line} mark '{block.mark}'"
        )
