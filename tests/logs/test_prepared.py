"""Logs that were read before: the same log, until the file or the way of reading changes."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from cellwise.fleet.store import read_prepared
from cellwise.logs import read_log, write_log
from cellwise.logs.cell_log import CHANNELS
from example_cells import random_log


@pytest.fixture
def path(tmp_path):
    log = random_log(np.random.default_rng(3), rows=400, temperature_C=(20.0, 30.0))
    voltage = 3.7 - 0.03 * log.current_A
    voltage[17] = np.nan
    from dataclasses import replace

    return write_log(replace(log, voltage_V=voltage), tmp_path / "log.parquet")


def same(one, other):
    for name in CHANNELS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_array_equal(a, b)
    told = ("name", "source", "format", "current_meaning", "notices")
    assert [getattr(one, n) for n in told] == [getattr(other, n) for n in told]


def test_it_is_the_log_that_was_read_and_the_second_time_not_parsed(path, tmp_path, monkeypatch):
    same(read_prepared(path, tmp_path / "cache"), read_log(path))
    assert len(os.listdir(tmp_path / "cache")) == 1
    monkeypatch.setattr("cellwise.fleet.store.read_log", None)
    same(read_prepared(path, tmp_path / "cache"), read_log(path))


def test_another_file_and_other_options_are_read_again(path, tmp_path):
    cache = tmp_path / "cache"
    first = read_prepared(path, cache)
    turned = read_prepared(path, cache, sign="charge-positive")
    np.testing.assert_array_equal(turned.current_A, -first.current_A)
    write_log(first.part(0, 100), path)
    os.utime(path, (time.time() + 5, time.time() + 5))
    assert len(read_prepared(path, cache)) == 100


def test_a_damaged_cache_is_passed_over(path, tmp_path):
    cache = tmp_path / "cache"
    read_prepared(path, cache)
    (place,) = cache.iterdir()
    whole = place.read_bytes()
    for damage in (b"", b"garbage", whole[: len(whole) // 2]):
        place.write_bytes(damage)
        same(read_prepared(path, cache), read_log(path))
