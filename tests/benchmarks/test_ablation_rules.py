"""A rule of identification or filter that is switched off by name is there."""

from __future__ import annotations

from importlib import import_module

import pytest
from benchmarks.ablation.identify_rules import RULES
from benchmarks.ablation.joint_fit import RULES as RULES_OF_THE_FIT
from benchmarks.ablation.switches import SWITCHES as SWITCHES_OF_THE_FILTER

SWITCHES = [
    *((rule.name, rule.names) for rule in RULES),
    *((rule.name, rule.places) for rule in RULES_OF_THE_FIT),
    *((switch.name, switch.names) for switch in SWITCHES_OF_THE_FILTER if switch.names),
]


@pytest.mark.parametrize("names", [n for _, n in SWITCHES], ids=[n for n, _ in SWITCHES])
def test_every_switch_names_something_that_is_there(names):
    for module, name, off in names:
        assert getattr(import_module(module), name) is not off
