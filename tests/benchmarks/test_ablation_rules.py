"""A rule of the identification that is switched off by name is there."""

from __future__ import annotations

from importlib import import_module

import pytest
from benchmarks.ablation.identify_rules import RULES


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_every_switch_names_something_that_is_there(rule):
    for module, name, off in rule.names:
        assert getattr(import_module(module), name) is not off
