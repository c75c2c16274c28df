"""The one way in which cellwise refuses an input."""

from __future__ import annotations

from typing import Any


class InputError(ValueError):
    """An input was refused: what was found, what was expected, what to do.

    Parameters
    ----------
    found : str       what the input holds, with the file, column or row where that helps
    expected : str    what cellwise needs in its place
    action : str      what the user can do about it

    Notes
    -----
    Commands print the message on standard error and exit with code 2.
    """

    def __init__(self, found: str, expected: str, action: str) -> None:
        self.found = found
        self.expected = expected
        self.action = action
        super().__init__(f"found {found}; expected {expected}. {action}")

    def __reduce__(self) -> tuple[type[InputError], tuple[Any, ...]]:
        """What another process needs to raise it again."""
        return type(self), (self.found, self.expected, self.action)


class MachineError(InputError):
    """The machine failed, not the input: no space, no permission, a disk that does not answer.

    The same parts as :class:`InputError`, and the same exit code; but the same input may do
    another time, so a fleet tries it again.
    """
