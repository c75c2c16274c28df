"""What the pages name exists: files, options, messages, records and their units."""

from __future__ import annotations

import argparse
import ast
import dataclasses
import inspect
import re

import pytest
from doc_blocks import DOCS, PAGES, REPOSITORY, page_blocks, page_name, prose

import cellwise
from cellwise.cell.effects import EFFECTS
from cellwise.cell.equations import CellState
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cli.command_line import build_parser
from cellwise.estimate.estimators import ESTIMATORS
from cellwise.estimate.filters.coulomb import CoulombInfo, CoulombState
from cellwise.estimate.filters.filter_state import EkfInfo, EkfState
from cellwise.estimate.replay import SocErrors
from cellwise.estimate.trace import Trace
from cellwise.identify.capacity.capacity_choice import CapacityRow
from cellwise.identify.capacity.capacity_test import CapacityTest
from cellwise.identify.hppc.pulse_quality import Pulse
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.pulse_fit.circuit import PulseParameters
from cellwise.logs import Gap
from sources import tree_of

WIDTH = 120
LATER = ("README.md",)  # figures are added to it as they are measured
PACKAGE = REPOSITORY / "src" / "cellwise"
# Unit of a name by its suffix.
UNITS = {**{unit: unit for unit in ("V", "A", "s", "ohm", "Ah", "K", "F")}, "C": "°C", "V2": "V²"}
RECORDS = (
    *(r for n in cellwise.__all__ if inspect.isclass(r := getattr(cellwise, n))),
    *EFFECTS.values(),
    InitialSoc, CellState, EkfState, EkfInfo, CoulombState, CoulombInfo, SocErrors, Trace, Gap,
    CapacityTest, CapacityRow, OcvCurve, PulseParameters, Pulse,
)  # fmt: skip


def fields(record):
    if dataclasses.is_dataclass(record):
        return [f.name for f in dataclasses.fields(record)]
    return list(getattr(record, "_fields", ()))


def nomenclature_rows():
    """Cells of the table of names: names, symbol, unit, meaning."""
    text = (DOCS / "nomenclature.md").read_text(encoding="utf-8")
    table = text.split("## Names")[1].split("### ")[0]
    for line in table.splitlines():
        cells = [c.strip() for c in line.strip().strip("|").split("|")]
        if line.startswith("| `"):
            yield re.findall(r"`(\w+)`", cells[0]), cells


def test_a_public_record_names_every_field_in_its_docstring():
    missing = {
        record.__name__: [f for f in fields(record) if not re.search(rf"\b{f}\b", record.__doc__)]
        for record in RECORDS
    }
    assert {name: left for name, left in missing.items() if left} == {}


def test_names_and_units_of_the_nomenclature_agree():
    for names, cells in nomenclature_rows():
        assert len(cells) == 4, cells
        for name in names:
            suffix = name.rpartition("_")[2]
            if name.endswith("_V_per_K"):
                assert cells[2] == "V/K", name
            elif name.endswith("_per_V"):
                assert cells[2] == "1/V", name
            elif "_" in name and suffix in UNITS and name != "rate_C":  # in C, not in degrees
                assert UNITS[suffix] in re.split(r",\s*", cells[2]), f"{name}: unit '{cells[2]}'"


def test_status_bits_are_those_of_the_code():
    text = (DOCS / "firmware.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \|", text, flags=re.M)
    assert [(int(bit), name) for bit, name in rows] == [(int(s), s.name) for s in cellwise.Status]


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)]+)\)", prose(page)):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        place = (page.parent / path).resolve() if path else page
        assert place.exists(), f"{page_name(page)} -> {target}"
        if anchor:
            assert anchor in anchors(place), f"{page_name(page)} -> {target}"


def anchors(page):
    """Anchors of a page's headings, as the usual renderers make them."""
    headings = re.findall(r"^#+ (.*)$", prose(page), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", h.strip().lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_files_that_are_named_exist(page):
    for name in re.findall(r"`((?:tests|datasets|docs|benchmarks)/[\w./]+\.\w+)`", prose(page)):
        assert (REPOSITORY / name).exists(), f"{page_name(page)}: {name}"
    for name in re.findall(
        r"`((?:cell|identify|estimate|logs|cli|report)/[\w/]+\.py)`", prose(page)
    ):
        assert (PACKAGE / name).exists(), f"{page_name(page)}: {name}"


def options(parser):
    found = set(parser._option_string_actions)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action.choices.values():
                found |= options(child)
    return found


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_options_that_are_named_exist(page):
    known = options(build_parser())
    for span in re.findall(r"`([^`\n]+)`", prose(page)):
        if span.startswith(("--", "cellwise ")):
            named = re.findall(r"(?<![\w-])--[a-z][\w-]+", span)
            assert set(named) <= known, f"{page_name(page)}: {span}"


def test_refusals_that_are_explained_occur_in_the_code():
    code = {text for path in PACKAGE.rglob("*.py") for text in strings(path)}
    page = (DOCS / "errors.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([^`]+)` \|", page, flags=re.M)
    assert len(rows) > 40
    for phrase in rows:
        parts = phrase.split("…")
        pattern = re.compile(".*".join(re.escape(part) for part in parts), flags=re.S)
        likely = (text for text in code if max(parts, key=len) in text)
        assert any(pattern.search(text) for text in likely), phrase


def strings(path):
    """Every string of a module, an ellipsis where something is filled in."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.JoinedStr):
            yield "".join(v.value if isinstance(v, ast.Constant) else "…" for v in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_estimators_that_are_explained_are_those_there_are():
    text = (DOCS / "errors.md").read_text(encoding="utf-8")
    (named,) = re.findall(r"\| `estimator '…'` \| one of (.*) \|", text)
    assert set(re.findall(r"`([^`]+)`", named)) == set(ESTIMATORS)


def test_equations_are_closed():
    """An odd number of dollar signs turns the rest of a page into an equation."""
    for page in PAGES:
        text = re.sub(r"`[^`]*`", "", prose(page))
        assert text.count("$$") % 2 == 0, page.name
        for number, line in enumerate(text.replace("$$", "").splitlines(), start=1):
            assert line.count("$") % 2 == 0, f"{page.name}, line {number}: {line}"


@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in LATER], ids=page_name)
def test_text_is_wrapped_at_one_width(page):
    """Tables and equations cannot be; what is printed into a page is."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(("|", "<", "$$"))]
    assert [line for line in lines if len(line) > WIDTH] == []


def test_every_page_is_in_the_index():
    for folder in (DOCS, DOCS / "decisions"):
        index = (folder / "README.md").read_text(encoding="utf-8")
        for page in folder.glob("*.md"):
            assert page.name == "README.md" or f"({page.name})" in index, page.name


MOST_WORDS = 30_000  # what one person reads in a few hours


def test_the_docs_stay_short():
    """A word has a letter or a digit: of a table's rules and an equation's signs nobody reads."""
    words = {p: re.findall(r"\S*\w\S*", p.read_text("utf-8")) for p in DOCS.rglob("*.md")}
    assert sum(len(found) for found in words.values()) <= MOST_WORDS


def test_pages_tell_nothing_of_this_machine():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"/(work|tmp|home|root)/", text), page.name
        assert page_blocks(page) is not None
