"""The documentation site builds without the network."""

from __future__ import annotations

import html
import re
import subprocess
import sys

import pytest
from doc_blocks import DOCS, REPOSITORY

import cellwise


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    for library in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        pytest.importorskip(library)
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(out)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return out


@pytest.mark.slow
def test_every_page_is_there(site):
    for page in DOCS.rglob("*.md"):
        place = page.relative_to(DOCS).with_suffix(".html")
        if place.name == "README.html":
            place = place.with_name("index.html")
        assert (site / place).is_file(), place


@pytest.mark.slow
def test_the_api_has_every_public_name_with_its_docstring(site):
    text = (site / "api.html").read_text(encoding="utf-8")
    for name in cellwise.__all__:
        assert re.search(rf'id="cellwise\.[\w.]*\.{name}"', text), name
    assert "terminal voltage" in text


@pytest.mark.slow
def test_equations_are_mathml_and_none_is_left(site):
    text = (site / "theory.html").read_text(encoding="utf-8")
    assert text.count("<math") > 50
    visible = re.sub(r"<(math|script|code|pre|style)\b.*?</\1>", "", text, flags=re.S)
    assert "$$" not in visible
    assert not re.search(r"\\(frac|Delta|mathrm)", visible)


@pytest.mark.slow
def test_the_examples_stand_on_their_page_whole(site):
    page = (site / "examples.html").read_text(encoding="utf-8")
    text = html.unescape(re.sub(r"<[^>]+>", "", page))
    for path in (REPOSITORY / "examples").glob("*.py"):
        for line in (path.read_text(encoding="utf-8").splitlines()[k] for k in (0, -1)):
            assert line in text, (path.name, line)


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for tag in re.findall(r"<(?:script|img|link|iframe)\b[^>]*>", text):
            address = re.search(r'(?:src|href)="(https?:)?//', tag)
            assert not address or 'rel="canonical"' in tag, f"{page.name}: {tag}"
