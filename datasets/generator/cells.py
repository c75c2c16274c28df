"""The two physical cells behind the embedded data: published parameter sets, nothing fitted here.

The numbers of the physics live in PyBaMM's parameter sets; this page only names them, gives the
limits a laboratory would set on its tester and says which parameters were changed and why.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class CellSetup:
    """One cell as a laboratory knows it, and the parameter set that plays it.

    Attributes
    ----------
    key : str                  folder and prefix of its files
    cell, chemistry : str      what the parameter set describes
    parameter_set : str        name in PyBaMM
    parameter_doi : str        the paper that published the parameters
    nominal_Ah : float         rated capacity [Ah]; C rates refer to it
    lower_V, upper_V : float   voltage window [V]
    charge_cutoff_A : float    current that ends a constant-voltage charge [A]
    discharge_cutoff_A : float current that ends a constant-voltage discharge [A]
    thermal : str              PyBaMM's thermal option, "lumped" or "isothermal"
    stretch : float            how strongly the particle mesh is refined towards the surface
    electrode_points : int     mesh points across each electrode
    changes : mapping          parameters that differ from the published set
    borrowed : tuple           (other set, names of the parameters taken from it)
    """

    key: str
    cell: str
    chemistry: str
    parameter_set: str
    parameter_doi: str
    nominal_Ah: float
    lower_V: float
    upper_V: float
    charge_cutoff_A: float
    discharge_cutoff_A: float
    thermal: str
    stretch: float = 1.5
    electrode_points: int = 16
    changes: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    borrowed: tuple[str, tuple[str, ...]] | None = None

    @property
    def has_thermocouple(self) -> bool:
        """Whether the log carries a temperature column."""
        return self.thermal != "isothermal"


NMC = CellSetup(
    key="nmc",
    cell="LG M50 (21700)",
    chemistry="NMC811 / graphite-SiOx",
    parameter_set="Chen2020",
    parameter_doi="10.1149/1945-7111/ab9050",
    nominal_Ah=5.0,
    lower_V=2.5,
    upper_V=4.2,
    charge_cutoff_A=0.05,
    discharge_cutoff_A=0.05,
    thermal="lumped",
    # Its slow cathode needs a fine surface: within 1 mV of a mesh six times finer 0.1 s after an
    # edge of 2C. The lfp mesh is within 0.1 mV as it stands.
    stretch=5.0,
    electrode_points=20,
    # A chamber with a fan: the published 10 W/m2K is still air and would let a drive heat the
    # cell by some 20 K, far more than laboratories report for such tests.
    changes=MappingProxyType({"Total heat transfer coefficient [W.m-2.K-1]": 30.0}),
    # The same cell's diffusivities and conductivity with Arrhenius factors that are one at 25 degC
    # (O'Kane et al., 10.1039/D2CP00417H); in Chen2020 they do not know the temperature.
    borrowed=(
        "OKane2022",
        (
            "Negative particle diffusivity [m2.s-1]",
            "Positive particle diffusivity [m2.s-1]",
            "Electrolyte diffusivity [m2.s-1]",
            "Electrolyte conductivity [S.m-1]",
        ),
    ),
)

LFP = CellSetup(
    key="lfp",
    cell="A123 26650 class",
    chemistry="LFP / graphite",
    parameter_set="Prada2013",
    parameter_doi="10.1149/2.053304jes",
    nominal_Ah=2.3,
    lower_V=2.0,
    upper_V=3.6,
    charge_cutoff_A=0.115,
    discharge_cutoff_A=0.023,
    thermal="isothermal",
    # PyBaMM's set takes the graphite's potential and kinetics from Chen2020 but keeps a graphite
    # diffusivity of 3e-15 m2/s, with which the cell gives 57 % of its capacity at 3C; the real
    # cell is a power cell. The diffusivity now comes from the same source as the graphite.
    changes=MappingProxyType({"Negative particle diffusivity [m2.s-1]": 3.3e-14}),
)

CELLS: Mapping[str, CellSetup] = MappingProxyType({cell.key: cell for cell in (NMC, LFP)})
