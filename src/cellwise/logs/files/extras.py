"""Libraries that only some formats need: imported on use, with a message that says what to do."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from cellwise.errors import InputError

INSTALL = "pip install 'cellwise[importers]'"


def need(module: str, purpose: str, package: str = "") -> Any:
    """Import a library of the extra ``importers``.

    Parameters
    ----------
    module : str      what to import
    purpose : str     what is to be read, for the message
    package : str     its name in the registry, where that is another one

    Raises
    ------
    InputError        it is not installed
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        wanted = package or module.partition(".")[0]
        if error.name is not None and error.name.partition(".")[0] != module.partition(".")[0]:
            wanted += f" ({error.name} is missing)"
        raise InputError(
            f"{purpose}, for which {wanted} is not installed",
            f"the library {package or module.partition('.')[0]}",
            f"Install it: {INSTALL}.",
        ) from None
