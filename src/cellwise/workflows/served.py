"""Many logs at once: what is made of those that serve, and what was refused of the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Generic, NamedTuple, TypeVar

from cellwise.errors import InputError, MachineError

Item = TypeVar("Item")
Made = TypeVar("Made")


class Served(NamedTuple, Generic[Made]):
    """What was made, in order, and the refusals of what was left out."""

    made: list[Made]
    refused: list[InputError]


def each_that_serves(items: Iterable[Item], do: Callable[[Item], Made]) -> Served[Made]:
    """What is made of each; one of several that is refused is left out.

    Raises
    ------
    InputError        as ``do``, of the first where none serves
    MachineError      the machine failed, not the input
    """
    made, refused = [], []
    for item in items:
        try:
            made.append(do(item))
        except MachineError:
            raise
        except InputError as error:
            refused.append(error)
    if refused and not made:
        raise refused[0]
    return Served(made, refused)
