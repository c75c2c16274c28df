"""The cells of the laboratory: published parameter sets of PyBaMM, nothing fitted here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Purpose = Literal["development", "validation"]

_ARRHENIUS = (
    "Negative particle diffusivity [m2.s-1]",
    "Positive particle diffusivity [m2.s-1]",
    "Electrolyte diffusivity [m2.s-1]",
    "Electrolyte conductivity [S.m-1]",
)


@dataclass(frozen=True)
class PublishedCell:
    """A parameter set, and what a laboratory would know of the cell.

    ``largest_C`` is the rate that its drives reach; ``flat`` an OCV too flat to read a start from;
    ``thermal`` and ``arrhenius`` whether the set knows heat and what temperature does;
    ``purpose`` whether anybody may look at it while developing.
    """

    name: str
    purpose: Purpose
    largest_C: float
    flat: bool = False
    thermal: bool = True
    arrhenius: bool = True
    borrowed: tuple[str, tuple[str, ...]] | None = None
    changes: tuple[tuple[str, float], ...] = ()


CELLS: dict[str, PublishedCell] = {
    c.name: c
    for c in (
        # Chen2020's diffusivities know no temperature; O'Kane's are the same cell's at 25 degC.
        PublishedCell("Chen2020", "development", 1.2, borrowed=("OKane2022", _ARRHENIUS)),
        PublishedCell("Marquis2019", "development", 1.5),
        PublishedCell("Mohtat2020", "development", 2.0),
        # Its graphite diffusivity is Chen2020's, as its graphite (see datasets/generator/cells.py).
        PublishedCell(
            "Prada2013",
            "development",
            2.0,
            flat=True,
            thermal=False,
            arrhenius=False,
            changes=(("Negative particle diffusivity [m2.s-1]", 3.3e-14),),
        ),
        PublishedCell("Ai2020", "validation", 1.5),
        PublishedCell("Ecker2015", "validation", 2.0),
        PublishedCell("ORegan2022", "validation", 1.0),
        PublishedCell("NCA_Kim2011", "validation", 2.0),
        PublishedCell("Ramadass2004", "validation", 1.0, thermal=False, arrhenius=False),
    )
}


def cells_for(purpose: str) -> list[PublishedCell]:
    """Cells of one purpose, all, or the one of a name."""
    return [c for c in CELLS.values() if purpose in (c.purpose, c.name, "all")]
