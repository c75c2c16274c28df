"""Notices are data: codes that docs list, options and rows beside the text, no parse of a text."""

from __future__ import annotations

import ast
import json
import pickle
import re
import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from cellwise.cli.common.printing import in_command, rendered
from cellwise.errors import not_installed
from cellwise.notices import Code, Notice, Severity, critical_first, from_json, texts, to_json
from cellwise.wording import Option, in_python, place

SOURCE = Path(__file__).parents[1] / "src" / "cellwise"
DOCS = Path(__file__).parents[1] / "docs"
WRONG = Notice(Code.CURRENT_ZERO, "the current LOOKS WRONG: it is 0 throughout")
SIGN = Notice(Code.SIGN_ASSUMED, ("else ", Option("sign", "charge-positive")), log="a")
LONG = Notice(
    Code.IMPOSSIBLE_VALUE,
    ("9 V in ", place(range(4, 7)), " (", Option("series", letter="N"), ")"),
    size_V=float("inf"),
)
COLUMN = Notice(Code.TIME_UNIT, ("in hours (", Option("channels", ("time_h", "COLUMN")), ")?"))


def test_a_notice_states_what_an_option_and_a_link_are_made_of():
    assert (SIGN.argument, SIGN.value) == ("sign", "charge-positive")
    assert (LONG.argument, LONG.value, LONG.rows) == ("series", None, range(4, 7))
    assert (WRONG.argument, WRONG.value, WRONG.rows) == ("", None, None)
    assert LONG.severity is Severity.CRITICAL
    assert not SIGN.is_critical


def test_the_same_text_for_python_and_for_a_command():
    assert texts([SIGN, LONG]) == [
        "'a'else `sign='charge-positive'`",
        "9 V in rows 5 to 7 (`series=N`)",
    ]
    assert rendered([SIGN, LONG, COLUMN]) == [
        "'a'else --sign charge-positive",
        "9 V in rows 5 to 7 (--series N)",
        "in hours (--channel time_h=COLUMN)?",
    ]
    assert COLUMN.text == "in hours (`channels={'time_h': 'COLUMN'}`)?"


@pytest.mark.parametrize(
    ("option", "python", "command"),
    [
        (Option("anyway", True), "`anyway=True`", "--anyway"),
        (Option("refine", False), "`refine=False`", "--no-refine"),
        (Option("dt_s", 0.5), "`dt_s=0.5`", "--dt 0.5"),
        (Option("series", "auto"), "`series='auto'`", "--series auto"),
        (Option("channels", ("time_s", "a b")), "`channels={'time_s': 'a b'}`",
         "--channel time_s='a b'"),
    ],
)  # fmt: skip
def test_an_option_as_python_and_a_command_write_it(option, python, command):
    assert in_python(option) == python
    assert in_command(option) == command


@pytest.mark.parametrize("notice", [WRONG, SIGN, LONG, COLUMN])
def test_a_notice_comes_back_from_a_file_and_another_process(notice):
    assert from_json(json.loads(json.dumps(to_json(notice)))) == notice.__class__(
        notice.code,
        notice.pieces,
        notice.log,
        notice.rows,
        notice.option,
        notice.size_V,
        notice.column,
    )
    assert pickle.loads(pickle.dumps(notice)) == notice


def test_the_grave_ones_come_first_each_once():
    assert critical_first([SIGN, WRONG, SIGN]) == [WRONG, SIGN]


def test_a_notice_of_one_of_several_logs_begins_with_its_name():
    assert WRONG.of_log("b").text == "'b': " + WRONG.text
    assert SIGN.of_log("b") == SIGN  # it names its own


def test_codes_are_short_words_each_once():
    words = [code.word for code in Code]
    assert len(set(words)) == len(words)
    assert all(re.fullmatch(r"[a-z]+(-[a-z]+){0,3}", word) for word in words)


def test_the_site_lists_every_code():
    for library in ("mkdocs", "latex2mathml"):
        pytest.importorskip(library)
    hooks = runpy.run_path(str(DOCS / "site_hooks.py"))
    page = hooks["on_page_markdown"]((DOCS / "errors.md").read_text("utf-8"))
    rows = re.findall(r"^\| `([a-z-]+)` \| (\w+) \| (.+) \|$", page, re.M)
    assert rows == [(code.word, str(code.severity), code.meaning) for code in Code]


def test_every_code_is_said_somewhere():
    source = "".join(path.read_text("utf-8") for path in SOURCE.rglob("*.py"))
    assert [c.name for c in Code if len(re.findall(rf"Code\.{c.name}\b", source)) == 0] == []


# ---- nobody parses a notice's text ----

HOLDERS = {"notices", "model_mismatch", "mismatches", "contradictions"}  # fields that hold notices
METHODS = {"rendered", "behind_name"}  # what gives the text of a notice
FIELDS = {"text", "head", "said", "before"}  # fields of a notice that are text
SEARCHES = {
    "startswith", "endswith", "find", "rfind", "index", "rindex", "partition", "rpartition",
    "split", "rsplit", "removeprefix", "removesuffix", "replace", "count",
}  # fmt: skip
PATTERNS = {"search", "match", "fullmatch", "findall", "finditer", "sub", "split"}


def parses(source: str) -> list[int]:
    """Lines that search in the text of a notice: of one that comes out of `notices`."""
    found: list[int] = []
    for scope in ast.walk(ast.parse(source)):
        if isinstance(scope, ast.FunctionDef):
            found += _parses_in(scope)
    return sorted(set(found))


def _parses_in(scope: ast.AST) -> Iterator[int]:
    notices, words = {"notice"}, set[str]()  # names of notices, and of their texts

    def of_notices(node: ast.AST) -> bool:
        """Whether a node is a notice, or some of them."""
        return any(
            getattr(one, "attr", "") in HOLDERS or getattr(one, "id", "") in notices
            for one in ast.walk(node)
        )

    def is_text(node: ast.AST) -> bool:
        return any(is_word(one) for one in ast.walk(node))

    def is_word(node: ast.AST) -> bool:
        if isinstance(node, ast.Name):
            return node.id in words
        if isinstance(node, ast.Attribute):
            return node.attr in FIELDS and of_notices(node.value)
        if not isinstance(node, ast.Call):
            return False
        if isinstance(node.func, ast.Name):
            name = node.func.id
            return name == "texts" or (name in ("str", "map") and of_notices(node))
        return getattr(node.func, "attr", "") in METHODS

    def bind(target: ast.AST, value: ast.AST) -> None:
        for name in (n.id for n in ast.walk(target) if isinstance(n, ast.Name)):
            if is_text(value):
                words.add(name)
            elif of_notices(value):
                notices.add(name)

    for _ in range(2):  # a name may be bound below its use in a loop
        for node in ast.walk(scope):
            if isinstance(node, (ast.For, ast.comprehension)):
                bind(node.target, node.iter)
            elif isinstance(node, ast.Assign):
                for target in node.targets:
                    bind(target, node.value)
            elif isinstance(node, (ast.NamedExpr, ast.AnnAssign)) and node.value is not None:
                bind(node.target, node.value)
    for node in ast.walk(scope):
        if isinstance(node, ast.Compare):
            inside = any(isinstance(op, (ast.In, ast.NotIn)) for op in node.ops)
            if inside and any(map(is_text, node.comparators)):
                yield node.lineno
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            of_string = node.func.attr in SEARCHES and is_text(node.func.value)
            by_pattern = node.func.attr in PATTERNS and any(map(is_text, node.args))
            if of_string or by_pattern:
                yield node.lineno


@pytest.mark.parametrize(
    "line",
    [
        'any("LOOKS WRONG" in n.text for n in log.notices)',
        "any(MARK in n.text for n in log.notices)",
        '[t for t in texts(log.notices) if "series" in t]',
        "PLACES.search(notice.text)",
        're.findall("row", str(log.notices[0]))',
        'run.model_mismatch.text.partition(": ")[0]',
        "next(m[1] for n in log.notices if (m := SIGN.search(n.text)))",
        "[n for n in notices if n.text.startswith('a pack of')]",
    ],
)
def test_a_parse_of_a_notices_text_is_found(line):
    assert parses(f"def f(log, notices):\n    for notice in notices: pass\n    x = {line}") or (
        "notices if" in line and parses(f"def f(log):\n    notices = log.notices\n    x = {line}")
    )


def test_nothing_parses_the_text_of_a_notice():
    found = {
        str(path.relative_to(SOURCE)): lines
        for path in sorted(SOURCE.rglob("*.py"))
        if (lines := parses(path.read_text("utf-8")))
    }
    assert found == {}


def test_a_missing_library_is_proposed_with_the_versions_that_work():
    message = str(not_installed("orangebox", "a log of Betaflight"))
    proposed = message.split("pip install ")[1].strip("'")
    asked = Requirement(proposed)
    assert asked.name == "orangebox"
    assert "0.5.0" not in asked.specifier
    assert str(not_installed("nobodys", "a log")).endswith("pip install nobodys")
