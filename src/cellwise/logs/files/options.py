"""What a user may say about a log that its file does not say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from cellwise.errors import InputError

FROM_FILE: Literal["auto"] = "auto"


@dataclass(frozen=True)
class ReadOptions:
    """How a log is to be read.

    Parameters
    ----------
    series : int or "auto"      cells in series: the voltage is divided by it; ``auto`` takes the
                                number that the file states
    parallel : int              cells in parallel: current and counter are divided by it
    channels : mapping          tidy column name, which gives the unit, to the name in the file:
                                ``{"current_mA": "I_pack"}``
    instance : int or None      which battery of a file that has several, counted from 0
    dbc : Path or None          the database of the CAN frames
    partial : bool              read a recording that was cut off as far as it goes
    decimal : str               decimal sign of a text: ``.``, ``,``, or ``auto`` by its first rows

    Raises
    ------
    InputError                  counts below one, an instance below zero, another decimal sign
    """

    series: int | Literal["auto"] = 1
    parallel: int = 1
    channels: Mapping[str, str] = field(default_factory=dict)
    instance: int | None = None
    dbc: Path | None = None
    partial: bool = False
    decimal: str = FROM_FILE

    def __post_init__(self) -> None:
        for name, count in (("series", self.series), ("parallel", self.parallel)):
            if count != FROM_FILE and not (isinstance(count, int) and count >= 1):
                raise InputError(
                    f"{name} = {count}", "a number of cells from 1 up", f"Give `{name}=4`, say."
                )
        if self.instance is not None and self.instance < 0:
            raise InputError(
                f"instance {self.instance}", "a battery's number from 0 up", "Count from 0."
            )
        if self.decimal not in (FROM_FILE, ".", ","):
            raise InputError(
                f"a decimal sign '{self.decimal}'", "'.', ',' or 'auto'", "Give `decimal=','`, say."
            )
        if self.dbc is not None and not Path(self.dbc).is_file():
            raise InputError(f"no DBC file '{self.dbc}'", "a CAN database", "Check the path.")


NOTHING_SAID = ReadOptions()
