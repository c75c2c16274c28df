"""Tables over SOC from single pulses: the paper's polynomials back, and what a spline must keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.pulse_fit.circuit import PulseFit, PulseParameters
from cellwise.identify.tables import cubic_fit, pulse_tables

# Table 4 of the LFP040AHA paper: a + b s + c s^2 + d s^3 in ohm and farad.
PAPER = {
    "r0": (3.551e-3, -6.172e-3, 8.993e-3, -4.267e-3),
    "r1": (9.601e-4, -1.154e-3, 1.611e-3, -5.716e-4),
    "r2": (6.169e-3, -2.678e-2, 4.690e-2, -2.485e-2),
    "c1": (5549.0, -1.359e4, 5.058e4, -3.397e4),
    "c2": (1.712e4, 8.510e4, -2.850e4, -4.243e4),
}
LEVELS = np.linspace(0.05, 0.95, 18)


def polynomial(name, soc):
    return np.polynomial.polynomial.polyval(soc, PAPER[name])


def pulse(soc, *, r0, r1, tau1, r2, tau2, share=0.01, method="varpro") -> PulseFit:
    value = PulseParameters(r0, r1, tau1, r2, tau2, 3.3)
    error = PulseParameters(*(share * np.asarray(value)))
    return PulseFit(method, float(soc), 10.0, 60.0, value, error, 1e-4, 1000)


def paper_pulses(levels=LEVELS, **changes) -> list[PulseFit]:
    """One pulse per level with the paper's parameters."""
    return [
        pulse(
            s,
            r0=polynomial("r0", s),
            r1=polynomial("r1", s),
            tau1=polynomial("r1", s) * polynomial("c1", s),
            r2=polynomial("r2", s),
            tau2=polynomial("r2", s) * polynomial("c2", s),
            **changes,
        )
        for s in levels
    ]


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_cubic_fit_lowers_its_degree_where_levels_are_few(levels):
    soc = np.repeat(np.linspace(0.2, 0.8, levels), 3)
    found = np.array(cubic_fit(soc, 1.0 + soc))
    assert np.all(found[levels:] == 0.0)
    np.testing.assert_allclose(
        np.polynomial.polynomial.polyval(np.unique(soc), found),
        1.0 + np.unique(soc) if levels > 1 else [1.0 + soc[0]],
        rtol=1e-12,
    )


@pytest.mark.parametrize("name", ["r0", "r1", "r2"])
def test_cubic_tables_are_the_papers_polynomials(name):
    tables = pulse_tables(paper_pulses(), kind="cubic")
    np.testing.assert_allclose(tables.cubic[f"{name}_ohm"], PAPER[name], rtol=1e-6)
    np.testing.assert_allclose(
        tables.values[f"{name}_ohm"], polynomial(name, tables.soc), rtol=1e-6
    )


def test_a_cubic_that_dips_below_zero_is_held_above_it():
    # Steep at the low end, four levels in the upper half: the cubic runs far below zero at SOC 0.
    pulses = [
        pulse(s, r0=1e-3 + 0.1 * (s - 0.5) ** 3, r1=1e-3, tau1=3.0, r2=1e-3, tau2=60.0)
        for s in (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
    ]
    table = pulse_tables(pulses, kind="cubic").values["r0_ohm"]
    assert np.polynomial.polynomial.polyval(0.0, cubic_fit(
        np.array([p.soc for p in pulses]), np.array([p.r0_ohm for p in pulses])
    )) < 0.0  # fmt: skip
    assert table.min() > 0.0


def test_a_spline_table_follows_the_pulses_within_their_spread():
    # Smoothing costs less than the 5 % by which pulses of one level differ anyway.
    tables = pulse_tables(paper_pulses())
    for name in ("r0", "r1", "r2"):
        at = np.interp(LEVELS, tables.soc, tables.values[f"{name}_ohm"])
        assert np.sqrt(np.mean((at / polynomial(name, LEVELS) - 1.0) ** 2)) < 0.05


def test_a_spline_table_is_held_level_where_no_pulse_has_been():
    # A steep end must not run off: beyond the pulses a table stays with what the nearest said.
    levels = np.linspace(0.3, 0.7, 9)
    pulses = [
        pulse(s, r0=0.02 * np.exp(-4.0 * s), r1=0.01, tau1=4.0, r2=0.015, tau2=80.0) for s in levels
    ]
    table = pulse_tables(pulses).values["r0_ohm"]
    assert table[0] == pytest.approx(0.02 * np.exp(-4.0 * 0.3), rel=0.3)
    assert table[-1] == pytest.approx(0.02 * np.exp(-4.0 * 0.7), rel=0.3)


def test_a_pulse_weighs_by_its_standard_error():
    # Two pulses at each level contradict each other; the one known to 1 % wins over 80 %.
    good = [
        pulse(s, r0=0.02, r1=0.01, tau1=4.0, r2=0.015, tau2=80.0) for s in np.linspace(0.1, 0.9, 9)
    ]
    bad = [replace(p, value=p.value._replace(r0_ohm=0.06), error=p.error._replace(r0_ohm=0.048))
           for p in good]  # fmt: skip
    table = pulse_tables([*good, *bad]).values["r0_ohm"]
    np.testing.assert_allclose(table, 0.02, rtol=0.05)


def test_what_a_pulse_does_not_show_is_left_out():
    # tau2 of infinite standard error must not enter its table, its R0 must.
    good = paper_pulses()
    wild = [replace(p, value=p.value._replace(tau2_s=1e5), error=p.error._replace(tau2_s=np.inf))
            for p in good]  # fmt: skip
    assert pulse_tables([*good, *wild]).values["tau2_s"].max() < 1e3


@pytest.mark.parametrize("name", ["tau1_s", "tau2_s"])
def test_refused_when_no_pulse_has_a_positive_time_constant(name):
    pulses = [replace(p, value=p.value._replace(**{name: 0.0})) for p in paper_pulses()]
    with pytest.raises(InputError, match=name):
        pulse_tables(pulses)


@pytest.mark.parametrize("name", ["r0_ohm", "r1_ohm", "r2_ohm"])
def test_a_branch_that_no_pulse_shows_is_small_beside_the_others(name):
    # Every fit put the whole answer into the other branches; the model still needs a number here.
    pulses = [replace(p, value=p.value._replace(**{name: 0.0})) for p in paper_pulses()]
    tables = pulse_tables(pulses).values
    others = sum(tables[k] for k in ("r0_ohm", "r1_ohm", "r2_ohm") if k != name)
    assert np.all(tables[name] > 0.0)
    assert np.all(tables[name] < 0.05 * others)
