"""The one way in which cellwise refuses an input."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, requires
from typing import Any

from cellwise.wording import Option, Text


class InputError(ValueError):
    """An input was refused: what was found, what was expected, what to do.

    Parameters
    ----------
    found : str       what the input holds, with the file, column or row where that helps
    expected : str    what cellwise needs in its place
    action : str      what the user can do about it

    Notes
    -----
    Commands print the message on standard error and exit with code 2. Arguments that it names are
    data (`cellwise.wording.arg`): ``options`` are those of the whole ``text``.
    """

    def __init__(self, found: str, expected: str, action: str) -> None:
        self.found = found
        self.expected = expected
        self.action = action
        self.text = Text("found ", found, "; expected ", expected, ". ", action)
        super().__init__(str(self.text))

    @property
    def options(self) -> tuple[Option, ...]:
        """The arguments that the message names, each with the value that it proposes."""
        return self.text.options

    def __reduce__(self) -> tuple[type[InputError], tuple[Any, ...]]:
        """What another process needs to raise it again."""
        return type(self), (self.found, self.expected, self.action)


class MachineError(InputError):
    """The machine failed, not the input: no space, no permission, a disk that does not answer.

    The same parts as :class:`InputError`, and the same exit code; but the same input may do
    another time, so a fleet tries it again.
    """


def not_installed(package: str, purpose: str, wanted: str = "") -> InputError:
    """The refusal of what needs a library that is missing.

    Parameters
    ----------
    package : str     its name in the registry
    purpose : str     what needs it
    wanted : str      its name in the message, where that says more
    """
    taken, python = _requirement(package)
    return InputError(
        f"{purpose}, for which {wanted or package} is not installed",
        f"the library {package}{python}",
        f"Install it: pip install {taken}",
    )


def _requirement(package: str) -> tuple[str, str]:
    """As pip takes it, with the versions that cellwise works with; and the Python it asks for."""
    try:
        known = requires("cellwise") or []
    except PackageNotFoundError:
        known = []
    own = [text for text in known if re.split(r"[^\w.-]", text)[0].lower() == package.lower()]
    if not own:
        return package, ""
    versions, _, marker = own[0].partition(";")
    python = re.search(r"python_version\s*>=\s*[\"']([\d.]+)", marker)
    return f"'{versions.strip()}'", f", from Python {python[1]} on" if python else ""
