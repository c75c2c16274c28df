"""The public face: every name is there, says what it is, and every quantity carries its unit."""

from __future__ import annotations

import dataclasses
import inspect
import re
import types

import pytest

import cellwise
from cellwise import InputError

UNITS = ("_A", "_V", "_s", "_C", "_K", "_Ah", "_As", "_ohm", "_F", "_V2", "_Hz", "_h", "_ns")
# A number called after one of these is a physical quantity; what is called otherwise has no unit:
# a share, a count, a SOC.
QUANTITIES = re.compile(
    r"^(current|voltage|time|temperature|capacity|charge|resistance|ocv|r[0-3]|tau[1-3]?|c[12]|"
    r"dt|duration|interval|skew|nominal|innovation|error|white|slow|correlation|limit|activation|"
    r"offset)(_|$)"
)
OF_SOC = ("error",)
PURE = ("_share", "_soc", "_scale", "_factor", "_efficiency", "resistance_std")  # without a unit


def public(kind) -> list[str]:
    return [n for n in cellwise.__all__ if kind(getattr(cellwise, n))]


def is_function(value) -> bool:
    return isinstance(value, types.FunctionType)


def methods_of(cls) -> dict[str, types.FunctionType]:
    return {n: m for n, m in vars(cls).items() if is_function(m) and not n.startswith("_")}


CLASSES = {n: getattr(cellwise, n) for n in public(inspect.isclass)}
FUNCTIONS = {n: getattr(cellwise, n) for n in public(is_function)} | {
    f"{c}.{n}": method for c, cls in CLASSES.items() for n, method in methods_of(cls).items()
}
RECORDS = [n for n, cls in CLASSES.items() if dataclasses.is_dataclass(cls)]


def is_number(annotation: object) -> bool:
    """A float or an array of them; maps and tuples of records have names of their own."""
    return bool(re.match(r"(float|FloatArray|tuple\[float)", str(annotation)))


def numbers_of(function) -> list[str]:
    parameters = inspect.signature(function).parameters.values()
    return [p.name for p in parameters if is_number(p.annotation)]


def carries_unit(name: str) -> bool:
    return not QUANTITIES.match(name) or name.endswith((*UNITS, *PURE)) or name in OF_SOC


def test_dir_of_the_package_is_its_all():
    assert dir(cellwise) == cellwise.__all__
    assert len(set(cellwise.__all__)) == len(cellwise.__all__)


@pytest.mark.parametrize("name", cellwise.__all__)
def test_every_name_resolves_and_has_a_docstring(name):
    value = getattr(cellwise, name)
    assert callable(value), "a class or a function, never a folder"
    text = inspect.getdoc(value)
    assert text
    assert text.splitlines()[0].endswith("."), "one sentence that says what it is"


def test_pytest_collects_no_public_name():
    """Imported into a test module, such a name would be taken for a test and warned about."""
    assert not [n for n in cellwise.__all__ if n.startswith(("Test", "test"))]


def test_star_import_gives_the_same():
    names: dict[str, object] = {}
    exec("from cellwise import *", names)
    assert {n for n in names if not n.startswith("__")} == set(cellwise.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'magic'"):
        cellwise.magic  # noqa: B018


def test_the_version_is_that_of_the_installed_package(capsys):
    from cellwise.cli import main

    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out.strip() == f"cellwise {cellwise.__version__}"


def test_the_package_is_typed():
    from importlib.resources import files

    assert (files("cellwise") / "py.typed").is_file()


def test_numbers_that_are_passed_carry_their_unit_and_are_explained():
    """A unit or "soc" in the name says it; any other number needs a word."""
    for name, function in FUNCTIONS.items():
        assert inspect.getdoc(function), name
        owner = CLASSES.get(name.partition(".")[0], function)
        text = f"{inspect.getdoc(function)} {inspect.getdoc(owner)}"
        for number in numbers_of(function):
            assert carries_unit(number), f"{name}({number}): of which unit?"
            named = number.endswith(UNITS) or number.startswith("soc")
            assert named or number in text, f"{name} does not say what {number} is"


def test_records_are_frozen_and_their_quantities_carry_their_unit():
    for name in RECORDS:
        record = CLASSES[name]
        assert record.__dataclass_params__.frozen, name
        numbers = [f.name for f in dataclasses.fields(record) if is_number(f.type)]
        for n, value in vars(record).items():
            if isinstance(value, property) and is_number(value.fget.__annotations__.get("return")):
                numbers.append(n)
        for number in numbers:
            assert carries_unit(number), f"{name}.{number}: of which unit?"


def test_a_refusal_says_found_expected_and_what_to_do():
    error = InputError("three pulses", "at least five", "Add pulses.")
    assert isinstance(error, ValueError)
    assert str(error) == "found three pulses; expected at least five. Add pulses."
    assert (error.found, error.expected, error.action) == (
        "three pulses", "at least five", "Add pulses."
    )  # fmt: skip
