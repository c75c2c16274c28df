"""The parser of a command, which refuses as the house does: found, expected, what to do."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, NoReturn

from cellwise.errors import InputError

REFUSED = 2
HELP = {"-h", "--help"}
MODEL = "MODEL"
# What is there wherever cellwise is installed: a line that names it runs.
AT_HAND = {MODEL: "nmc-18650", "LOG": "nmc_drive_a", "FOLDER": "."}
EMBEDDED, SCALED = "nmc_", ("--capacity-ah", "5")  # logs that are at hand, of a cell of 5 Ah
# What a command needs beside its required arguments, for a line that has no word yet.
BESIDE = {
    "cellwise identify": ("--hppc", "nmc_hppc", "--ocv", "nmc_ocv_c20", "--nominal-ah", "5"),
    "cellwise export": ("--dt", "1", "-o", "firmware"),
}


class CommandParser(argparse.ArgumentParser):
    """An ``ArgumentParser`` whose refusals are one :class:`InputError` each, without the usage.

    Parameters
    ----------
    examples : tuple of str     lines of the command's help; values of outputs are proposed as there
    """

    def __init__(self, *, examples: tuple[str, ...] = (), **settings: Any) -> None:
        self.examples = examples
        super().__init__(exit_on_error=False, **settings)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """As the base class, which would refuse what is missing with its usage."""
        words = list(sys.argv[1:] if args is None else args)
        needed = [a for a in self._actions if a.required and not HELP.intersection(words)]
        try:
            parsed, unknown = self._parsed(words, namespace, needed)
        except argparse.ArgumentError as error:
            self._refuse_value(error)
        missing = [a for a in needed if getattr(parsed, a.dest, None) in (None, [])]
        if missing:
            given = self._models_among(missing, parsed, unknown)
            if given:
                words = [word for word in words if word not in given]
                parsed, unknown = self._parsed(words, None, needed)
                missing = [a for a in needed if getattr(parsed, a.dest, None) in (None, [])]
            if unknown:
                self.refuse_unknown(unknown)
            self._refuse_missing(missing, words, given)
        return parsed, unknown

    def _models_among(
        self, missing: Sequence[argparse.Action], parsed: argparse.Namespace, unknown: Sequence[str]
    ) -> list[str]:
        """A model file that stands where a log does, or where nothing does, without its option."""
        if not any(action.metavar == MODEL for action in missing):
            return []
        free = list(unknown)
        for action in self._actions:
            value = [] if action.option_strings else getattr(parsed, action.dest, None) or []
            free += [value] if isinstance(value, str) else value
        return [word for word in free if word.endswith(".json")][:1]

    def _parsed(
        self,
        words: list[str],
        namespace: argparse.Namespace | None,
        needed: Sequence[argparse.Action],
    ) -> tuple[argparse.Namespace, list[str]]:
        for action in needed:
            action.required = False
        try:
            return super().parse_known_args(words, namespace)
        finally:
            for action in needed:
                action.required = True

    def refuse(self, found: str, expected: str, action: str) -> NoReturn:
        """End with the house's message on standard error.

        Raises
        ------
        SystemExit        always, with the code of a refusal
        """
        self.exit(REFUSED, f"{self.prog}: {InputError(found, expected, action).text}\n")

    def error(self, message: str) -> NoReturn:
        """What the base class refuses by itself: an option that may be one of several."""
        self.refuse(message, f"what `{self.prog} --help` lists", "Write it out.")

    def refuse_unknown(self, unknown: Sequence[str]) -> NoReturn:
        """Refuse what is no option of this command, with the one that it is like."""
        known = self._option_string_actions
        like = [get_close_matches(word.partition("=")[0], known, 1) for word in unknown]
        meant = ", ".join(dict.fromkeys(f"'{names[0]}'" for names in like if names))
        self.refuse(
            f"unrecognized arguments: {' '.join(unknown)}",
            f"what `{self.prog} --help` lists",
            f"Did you mean {meant}?" if meant else "Leave them out.",
        )

    def _refuse_value(self, error: argparse.ArgumentError) -> NoReturn:
        """Refuse a value that an argument cannot take."""
        action = next(
            (a for a in self._actions if argparse._get_action_name(a) == error.argument_name), None
        )
        found = f"{error.argument_name}: {error.message}" if error.argument_name else error.message
        if action is None:
            self.error(found)
        found, expected = found.partition(" (choose from")[0], _described(action)
        choices = [str(one) for one in action.choices or ()]
        like = get_close_matches(found.rpartition(": ")[2].strip("'"), choices, 1)
        way_out = f"Did you mean '{like[0]}'?" if like else f"Correct it: {self.prog} --help"
        self.refuse(found, expected, way_out)

    def _refuse_missing(
        self, missing: Sequence[argparse.Action], words: list[str], given: list[str]
    ) -> NoReturn:
        """Refuse a line without what its command needs, and write the line that has it."""
        names = " and no ".join(_name(action) for action in missing)
        expected = ", and ".join(_described(action) for action in missing)
        line = self._completed(missing, words, given)
        action = f"Add it: {line}" if line else f"See {self.prog} --help"
        stock = AT_HAND[MODEL] in shlex.split(line) and SCALED[0] not in line
        if stock and SCALED[0] in self._option_string_actions:
            expected += (
                f"; {AT_HAND[MODEL]} is a stock model of a 2.8 Ah cell, which {SCALED[0]} X "
            )
            expected += "scales to yours"
        self.refuse(f"no {names}", expected, action)

    def _completed(
        self, missing: Sequence[argparse.Action], words: list[str], given: list[str]
    ) -> str:
        """The line with what it lacks, as it runs anywhere; empty where nothing would.

        ``given`` is a model file of the line that had no option.
        """
        shown = shlex.split(self.examples[0])[1:] if self.examples else []
        before: list[str] = []
        behind: list[str] = []
        for action in missing:
            name = action.option_strings[0] if action.option_strings else ""
            value = AT_HAND.get(str(action.metavar)) if action.dest != "output" else None
            if given and action.metavar == MODEL:
                value = given[0]
            if value is None and name in shown:
                value = shown[shown.index(name) + 1]
            if value is None:
                return ""
            (behind if name else before).extend([name, value] if name else [value])
        words = words or list(BESIDE.get(self.prog, ()))
        if AT_HAND[MODEL] in behind and SCALED[0] in self._option_string_actions:
            embedded = any(word.startswith(EMBEDDED) for word in (*before, *words))
            behind += SCALED if embedded and SCALED[0] not in words else ()
        return shlex.join([*self.prog.split(), *before, *words, *behind])


def _name(action: argparse.Action) -> str:
    """An argument as it is typed."""
    return action.option_strings[0] if action.option_strings else str(action.metavar)


def _described(action: argparse.Action) -> str:
    """What an argument takes."""
    if isinstance(action, argparse._SubParsersAction):
        return "one of " + ", ".join(action.choices)
    metavar = action.metavar or ""
    value = metavar if isinstance(metavar, str) else " ".join(metavar)
    if action.choices:
        value = "|".join(str(one) for one in action.choices)
    kinds = (("a number", float), ("a whole number", int))
    kind = next((kind for kind, of in kinds if action.type is of), "")
    said = " ".join([*action.option_strings[:1], value]).strip()
    return ": ".join(filter(None, (said, kind, (action.help or "").replace("%%", "%"))))
