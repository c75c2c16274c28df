"""What the physics laboratory counts as right, and what its changes do to a world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.physics_laboratory.changes import CHANGES, FAMILIES, INSEPARABLE, World
from benchmarks.physics_laboratory.score import Judged, report

RIGHT = Judged("x", "single", ("contact_resistance",), False, "ohmic_resistance",
               ("ohmic_resistance",), (), 1.0)  # fmt: skip


@pytest.mark.parametrize("change", CHANGES.values(), ids=lambda c: c.name)
def test_what_was_done_is_acceptable_and_what_is_acceptable_is_there(change):
    assert change.exact in change.acceptable <= change.there


@pytest.mark.parametrize("change", CHANGES.values(), ids=lambda c: c.name)
def test_every_change_changes_one_of_cell_and_instrument(change):
    world = change.put(World(), 0.5 * change.most, 2.0)
    assert world != World()
    assert change.put(world, 0.5 * change.most, 2.0) == world  # absolute, not on top


def test_families_and_groups_name_changes_and_causes_that_there_are():
    assert {n for family in FAMILIES for n in family} <= set(CHANGES)
    every = frozenset[str]().union(*(c.there for c in CHANGES.values()))
    assert all(group <= every for group in INSEPARABLE)


def test_an_exact_first_cause_is_right_and_another_one_is_not():
    assert RIGHT.exact
    assert RIGHT.acceptable
    assert not replace(RIGHT, verdict="hysteresis", named=("hysteresis",)).acceptable


def test_a_name_that_describes_it_is_acceptable_but_not_exact():
    said = replace(RIGHT, verdict="resistance_scale", named=("resistance_scale",))
    assert said.acceptable
    assert not said.exact
    assert not said.false_names


def test_undetermined_counts_only_within_a_declared_group_that_holds_the_exact_cause():
    unsure = replace(RIGHT, verdict="undetermined", named=())
    within = (("ohmic_resistance",), ("charge_transfer",))
    assert replace(unsure, competing=within).acceptable
    assert not unsure.acceptable
    assert not replace(unsure, competing=within[:1]).acceptable
    assert not replace(unsure, competing=(("hysteresis",), ("ohmic_resistance",))).acceptable
    assert not replace(unsure, competing=(("rate_dependence",), ("charge_transfer",))).acceptable


def test_causes_beside_the_right_one_that_are_not_there_are_counted():
    said = replace(RIGHT, named=("ohmic_resistance", "hysteresis"))
    assert said.false_names == ("hysteresis",)
    assert "causes named: 2, of them not there: 1" in report([said])


def test_a_pair_needs_a_cause_for_each():
    pair = replace(RIGHT, kind="pairs", changes=("contact_resistance", "time_skew"))
    assert not pair.all_named
    assert replace(pair, named=("resistance_scale", "time_skew")).all_named


def test_nothing_changed_is_right_only_as_none():
    clean = replace(RIGHT, kind="none", changes=(), verdict="none", named=())
    assert clean.acceptable
    assert not replace(clean, verdict="undetermined").acceptable


def test_sizes_are_of_what_the_log_shows():
    sized = [c for c in CHANGES.values() if c.sized]
    assert all(np.isfinite(c.most) and c.most > 0.0 for c in sized)
