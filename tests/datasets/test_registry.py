"""The registry says of every public original what a person needs to find and judge it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "datasets"
ORIGINALS = tomllib.loads((FOLDER / "registry.toml").read_text(encoding="utf-8"))["original"]
TEXTS = ("name", "cell", "chemistry", "lab", "doi", "url", "licence", "sign")
LISTS = ("window_V", "tests", "temperatures_C", "flaws")


@pytest.mark.parametrize("original", ORIGINALS, ids=[entry["name"] for entry in ORIGINALS])
def test_entry_is_complete(original):
    assert original.get("listing", "https://").startswith("https://")
    assert set(original) - {"listing"} == {*TEXTS, *LISTS, "nominal_Ah", "used_by_tests"}
    assert all(isinstance(original[key], str) and original[key] for key in TEXTS)
    assert all(isinstance(original[key], list) and original[key] for key in LISTS)
    assert 0.0 < original["window_V"][0] < original["window_V"][1] < 5.0
    assert original["nominal_Ah"] > 0.0
    assert isinstance(original["used_by_tests"], bool)
    assert original["doi"].startswith("10.") or original["doi"] in ("none", "not verified")


def test_names_are_unique():
    names = [entry["name"] for entry in ORIGINALS]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    "original",
    [entry for entry in ORIGINALS if entry["used_by_tests"]],
    ids=[entry["name"] for entry in ORIGINALS if entry["used_by_tests"]],
)
def test_entry_used_by_tests_has_its_folder(original, real_data):
    assert (real_data / original["name"]).is_dir()
