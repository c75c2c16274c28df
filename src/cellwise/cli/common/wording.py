"""The library's messages in the words of the command line: `series=4` is ``--series 4``."""

from __future__ import annotations

import ast
import re
import shlex

# A message names an argument as Python has it, between backticks.
ARGUMENT = re.compile(r"`([A-Za-z]\w*)=([^`]*)`")
# Where the option is not the argument's own name.
NAMES = {"channels": "channel", "dt_s": "dt", "limits": "voltage-limits"}
OPEN = "..."  # the argument, whatever its value


def in_options(text: str) -> str:
    """A message with every argument as the option of a command.

    ``series=4`` is ``--series 4``, ``partial=True`` is ``--partial``, ``refine=False`` is
    ``--no-refine``, ``channels={'time_s': 'COLUMN'}`` is ``--channel time_s=COLUMN``.
    """
    return ARGUMENT.sub(lambda found: _option(found[1], found[2]), text)


def _option(argument: str, value: str) -> str:
    name = NAMES.get(argument, argument).replace("_", "-").lower()
    if value == "False":
        return f"--no-{name}"
    if value.strip("{}") == OPEN or value == "True":
        return f"--{name}"
    try:
        plain = ast.literal_eval(value)
    except (SyntaxError, TypeError, ValueError):  # a word that stands for a value: MODEL, ...
        plain = value
    if isinstance(plain, dict):
        return " ".join(f"--{name} {key}={shlex.quote(str(one))}" for key, one in plain.items())
    return f"--{name} {shlex.quote(str(plain))}"
