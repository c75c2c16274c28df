r"""The states of a cell and its filters: what each does over an interval, what voltage it gives.

Over an interval of constant current I every state but the SOC is linear,

.. math:: x_i^{+} = a_i x_i + g_i I, \qquad v = v_0 + \sum_i H_i x_i

so transition, covariance and row of derivatives follow from three names a state: its decay a, its
drive g and its output H. The equations themselves, SOC's among them, stand in
:mod:`cellwise.cell.equations`; what is printed from this table says so in its head.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class State:
    """One state of a filter.

    Parameters
    ----------
    name : str      field of a state record, with its unit
    letter : str    how its entries of P are called: ``s1``, ``p12``; the SOC's come first
    symbol : str    in formulas
    decay : str     factor over an interval; empty: it stays as it is
    drive : str     what one ampere adds over an interval; empty: nothing
    output : str    derivative of the terminal voltage: ``slope``, ``-1``, ``m``, ``r0``
    option : str    option of the fixed step that compiles it in; empty: always there
    meaning : str   for people
    """

    name: str
    letter: str
    symbol: str
    decay: str
    drive: str
    output: str
    option: str
    meaning: str

    @property
    def letter_name(self) -> str:
        """Name of its number in a column: a letter alone, or ``v1``."""
        return f"v{self.letter}" if self.letter.isdigit() else self.letter


SOC = State("soc", "s", "z", "", "gs", "slope", "", "state of charge")
V1 = State("v1_V", "1", "v_1", "a1", "g1", "-1", "", "voltage of the fast branch")
V2 = State("v2_V", "2", "v_2", "a2", "g2", "-1", "", "voltage of the second branch")
V3 = State("v3_V", "3", "v_3", "a3", "g3", "-1", "slow", "voltage of the slow branch")
H = State("h", "h", "h", "ah", "", "m", "hysteresis", "hysteresis, -1 to 1")
OFFSET = State("offset_A", "o", "b", "", "", "r0", "offset", "what the current sensor adds")

# What each filter carries.
CELL = (SOC, V1, V2, V3, H)
FIXED = (*CELL, OFFSET)


def entry(a: State, b: State) -> str:
    """Name of the entry of P of two states, whichever comes first: ``ss``, ``s1``, ``p12``."""
    a, b = sorted((a, b), key=FIXED.index)
    return f"s{b.letter}" if a is SOC else f"p{a.letter}{b.letter}"


def triangle(states: tuple[State, ...]) -> tuple[tuple[State, State], ...]:
    """The pairs of the upper triangle, row by row."""
    return tuple((a, b) for i, a in enumerate(states) for b in states[i:])


@dataclass(frozen=True)
class Column:
    """A table over SOC and temperature.

    Parameters
    ----------
    field : str     name in a `CellPoint`, with its unit
    source : str    of the model, or ``effect.parameter``
    sloped : bool   goes on beyond 0..1 along its last segment, and its slope is looked up, too
    meaning : str   for people
    """

    field: str
    source: str
    sloped: bool
    meaning: str

    @property
    def number(self) -> str:
        """Name of its place in a row of the packed table."""
        return self.field.rsplit("_", 1)[0].upper()

    @property
    def slope(self) -> str:
        """Name of its slope in a `CellPoint`."""
        name, unit = self.field.rsplit("_", 1)
        return f"{name}_slope_{unit}"


COLUMNS = (
    Column("ocv_V", "ocv_V", True, "open-circuit voltage"),
    Column("r0_ohm", "r0_ohm", False, "ohmic resistance"),
    Column("r1_ohm", "r1_ohm", False, "resistance of the fast branch"),
    Column("tau1_s", "tau1_s", False, "time constant of the fast branch"),
    Column("r2_ohm", "r2_ohm", False, "resistance of the second branch"),
    Column("tau2_s", "tau2_s", False, "time constant of the second branch"),
    Column("r3_ohm", "slow_diffusion.r3_ohm", False, "resistance of the slow branch"),
    Column("tau3_s", "slow_diffusion.tau3_s", False, "time constant of the slow branch"),
    Column("m_V", "hysteresis.m_V", False, "half the gap between charge and discharge branch"),
    Column("error_V", "error", False, "the model's slow voltage error"),
    Column("entropy_V", "entropy.docv_dT_V_per_K", True, "change of the OCV per kelvin"),
)


@dataclass(frozen=True)
class Scalar:
    """A number of a cell that the equations read.

    Parameters
    ----------
    name : str      field of `CellScalars`, with its unit
    source : str    of the model, or ``effect.parameter``
    meaning : str   for people
    """

    name: str
    source: str
    meaning: str


SCALARS = (
    Scalar("charge_As", "capacity_Ah", "charge between SOC 1 and SOC 0"),
    Scalar("charge_efficiency", "charge_efficiency", "share of the charge put in that stays"),
    Scalar("activation_K", "temperature_dependence.activation_K", "of every resistance"),
    Scalar("reference_K", "temperature_dependence.reference_C", "where the tables hold"),
    Scalar("hysteresis_rate", "hysteresis.gamma", "e-folds of h per full charge"),
    Scalar("skew_s", "time_skew.skew_s", "sampling delay of the voltage after the current"),
    Scalar("rate_per_A", "rate_dependence.rate_h", "fall of R0, R1, R2 with the current"),
    Scalar("charge_scale", "charge_asymmetry.charge_scale", "factor on resistances on charge"),
    Scalar("leak_A", "self_discharge.leak_A", "self-discharge current"),
    Scalar("heating_K_per_W", "self_heating.rth_K_per_W", "thermal resistance to the surface"),
    Scalar("heating_s", "self_heating.thermal_s", "thermal time constant"),
    Scalar("branch_activation", "temperature_dependence.r0_K", "1 where one is not 0"),
    Scalar("r0_activation_K", "temperature_dependence.r0_K", "of R0 beside the common one"),
    Scalar("r1_activation_K", "temperature_dependence.r1_K", "of R1 beside the common one"),
    Scalar("tau1_activation_K", "temperature_dependence.tau1_K", "of tau1"),
    Scalar("r2_activation_K", "temperature_dependence.r2_K", "of R2 beside the common one"),
    Scalar("tau2_activation_K", "temperature_dependence.tau2_K", "of tau2"),
    Scalar("r3_activation_K", "temperature_dependence.r3_K", "of R3 beside the common one"),
    Scalar("tau3_activation_K", "temperature_dependence.tau3_K", "of tau3"),
    Scalar("asinh_per_V", "charge_transfer.asinh_per_V", "of the fast branch's charge transfer"),
    Scalar("surface_per_A", "surface_soc.depth_h", "SOC that the surface is below the mean"),
    Scalar("surface_s", "surface_soc.tau_s", "time constant of the current that it follows"),
    Scalar("surface_activation_K", "surface_soc.activation_K", "of that depth"),
    Scalar("surface_reference_K", "surface_soc.reference_C", "where that depth holds"),
    Scalar("entropy_K", "entropy.reference_C", "where the OCV holds; 0: no entropy term"),
)
